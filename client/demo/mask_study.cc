#include "client/demo/mask_study.h"

#include <algorithm>
#include <chrono>
#include <utility>

#include "absl/strings/str_format.h"
#include "client/demo/walk_record.h"
#include "client/demo/wire_encoding.h"
#include "client/mask_bits.h"
#include "client/scene_io/scene_to_wire.h"
#include "core/reference/shadow_map_test.h"

namespace shadowfit {
namespace {

constexpr std::chrono::seconds kUploadTimeout{60};

/// A mask's bits for the pixels that the light concerns.
absl::StatusOr<ShadowMask> Decode(const v1::LightMask& mask, const VisibleSurface& surface,
                                  const ShadowMask& truth) {
  if (mask.bits().size() != MaskRowBytes(surface.width) * static_cast<size_t>(surface.height)) {
    return absl::InternalError(absl::StrFormat("the service answered a mask of %d bytes for %dx%d pixels",
                                               mask.bits().size(), surface.width, surface.height));
  }
  ShadowMask decoded(truth.size(), PixelLight::kNotConcerned);
  for (size_t i = 0; i < truth.size(); ++i) {
    if (truth[i] == PixelLight::kNotConcerned) continue;
    const size_t x = i % static_cast<size_t>(surface.width);
    const size_t y = i / static_cast<size_t>(surface.width);
    decoded[i] = MaskBit(mask, surface.width, x, y) ? PixelLight::kShadowed : PixelLight::kLit;
  }
  return decoded;
}

}  // namespace

MaskStudy::MaskStudy(Client* client, PackedScene scene, std::vector<SceneLight> lights)
    : client_(client), scene_(std::move(scene)), lights_(std::move(lights)) {
  for (const SceneLight& light : lights_) figures_.lights.emplace_back().light = light.name;
}

absl::StatusOr<std::unique_ptr<MaskStudy>> MaskStudy::Create(Client* client, const Scene& scene,
                                                             const Walk& walk) {
  std::unique_ptr<MaskStudy> study(new MaskStudy(client, PackScene(SceneToWire(scene)), walk.lights));
  CallOptions call;
  call.timeout = kUploadTimeout;
  const auto start = std::chrono::steady_clock::now();
  const absl::StatusOr<v1::UploadSceneResponse> uploaded = client->UploadScene(study->scene_, call);
  if (!uploaded.ok()) return uploaded.status();
  study->figures_.upload_seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return study;
}

absl::StatusOr<std::vector<ShadowMask>> MaskStudy::AddFrame(size_t frame, const CameraMatrices& camera,
                                                            const VisibleSurface& surface,
                                                            std::span<const ShadowMask> truth,
                                                            std::span<const ShadowMask> by_map) {
  v1::MaskFrame request;
  request.set_frame_id(frame);
  request.set_scene_digest(scene_.digest);
  Encode(camera, request.mutable_camera());
  EncodeDepth(surface.width, surface.height, surface.depth, request.add_layers()->mutable_depth());
  for (size_t i = 0; i < lights_.size(); ++i) {
    v1::Light* light = request.add_lights();
    light->set_id(static_cast<uint32_t>(i));
    Encode(lights_[i].light, light);
  }
  const absl::StatusOr<v1::MaskResult> result = client_->RenderMasks(request, &scene_);
  if (!result.ok()) return result.status();
  if (static_cast<size_t>(result->lights_size()) != lights_.size()) {
    return absl::InternalError(absl::StrFormat("the service answered %d masks for %d lights",
                                               result->lights_size(), lights_.size()));
  }
  figures_.frames.push_back(static_cast<int>(frame));
  std::vector<ShadowMask> masks;
  for (size_t i = 0; i < lights_.size(); ++i) {
    const v1::LightMask& light = result->lights(static_cast<int>(i));
    absl::StatusOr<ShadowMask> mask = Decode(light, surface, truth[i]);
    if (!mask.ok()) return mask.status();
    MaskRecord& record = figures_.lights[i];
    record.wrong_by_map.push_back(CountWrongPixels(truth[i], by_map[i]));
    record.wrong_by_mask.push_back(CountWrongPixels(truth[i], *mask));
    record.undecided.push_back(static_cast<int>(light.undecided_samples()));
    record.mask_ms.push_back(1e3 * light.seconds());
    masks.push_back(*std::move(mask));
  }
  return masks;
}

Picture ShadowPicture(const VisibleSurface& surface, std::span<const ShadowMask> shadows) {
  Picture picture{surface.width, surface.height, {}};
  picture.rgb.reserve(3 * surface.size());
  for (size_t i = 0; i < surface.size(); ++i) {
    const auto lit =
        static_cast<size_t>(std::count_if(shadows.begin(), shadows.end(), [i](const ShadowMask& shadow) {
          return shadow[i] == PixelLight::kLit;
        }));
    const auto grey = surface.primitive[i] == kNoPrimitive
                          ? uint8_t{0}
                          : static_cast<uint8_t>(48 + 207 * lit / shadows.size());
    picture.rgb.insert(picture.rgb.end(), 3, grey);
  }
  return picture;
}

nlohmann::json MaskJson(const MaskFigures& figures) {
  nlohmann::json document{{"frames", figures.frames},
                          {"uploadSeconds", figures.upload_seconds},
                          {"lights", nlohmann::json::array()}};
  for (const MaskRecord& record : figures.lights) {
    document["lights"].push_back({{"name", record.light},
                                  {"wrongPixelsOfMap", record.wrong_by_map},
                                  {"wrongPixelsOfMask", record.wrong_by_mask},
                                  {"undecidedPixels", record.undecided},
                                  {"maskMilliseconds", record.mask_ms}});
  }
  return document;
}

std::string MaskTable(const MaskFigures& figures) {
  std::string text = absl::StrFormat(
      "\nAlias-free masks beside the maps of the default method, means of %d frames of the walk\n\n%-15s "
      "%14s %14s %10s %9s\n",
      figures.frames.size(), "light", "wrong by map", "wrong by mask", "undecided", "ms");
  for (const MaskRecord& record : figures.lights) {
    absl::StrAppendFormat(&text, "%-15s %14.0f %14.1f %10.1f %9.1f\n", record.light,
                          Mean(record.wrong_by_map), Mean(record.wrong_by_mask), Mean(record.undecided),
                          Mean(record.mask_ms));
  }
  return text;
}

}  // namespace shadowfit
