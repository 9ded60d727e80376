#include "server/scene_decoder.h"

#include <google/protobuf/io/zero_copy_stream_impl_lite.h>

#include <algorithm>
#include <bit>
#include <cstring>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "shadowfit/v1/scene.pb.h"

namespace shadowfit {
namespace {

static_assert(std::endian::native == std::endian::little,
              "arrays are little-endian and are copied as they are");

constexpr uint32_t kMaxTextureSide = 16384;
/// Protobuf counts bytes in an int.
constexpr size_t kMostBytes = std::numeric_limits<int>::max();

absl::Status FieldError(const std::string& path, const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat(path, ": ", what));
}

constexpr char kDecoding[] = "the decoding of a scene";
/// Between two looks at the cancellation.
constexpr int kBytesOfPoll = 1 << 20;
constexpr int kElementsOfPoll = 1 << 10;

/// What is left of the bytes seems to be missing once cancelled.
class CancellableStream : public google::protobuf::io::ArrayInputStream {
 public:
  CancellableStream(const std::string& bytes, const Cancellation* cancellation)
      : ArrayInputStream(bytes.data(), static_cast<int>(bytes.size()), kBytesOfPoll),
        cancellation_(cancellation) {}

  bool Next(const void** data, int* size) override {
    return !IsCancelled(cancellation_) && ArrayInputStream::Next(data, size);
  }

 private:
  const Cancellation* const cancellation_;
};

/// What messages refer to.
struct Decoding {
  const v1::SceneData& data;
  const Cancellation* cancellation;
};

/// Indices are int in core.
absl::Status CheckIndex(uint32_t index, int count, const std::string& path) {
  if (index < static_cast<uint32_t>(count)) return absl::OkStatus();
  return FieldError(path, absl::StrFormat("%d, but there are %d", index, count));
}

template <typename T>
absl::Status DecodeArray(const std::string& bytes, uint32_t count, const std::string& path,
                         std::string_view counted, const Decoding& decoding, std::vector<T>* out) {
  const uint64_t expected = uint64_t{count} * sizeof(T);
  if (bytes.size() != expected) {
    return FieldError(path, absl::StrFormat("%d bytes, %d %s of %d bytes are %d", bytes.size(), count,
                                            std::string(counted), sizeof(T), expected));
  }
  out->reserve(count);
  while (out->size() < count) {
    if (absl::Status status = CancellationStatus(decoding.cancellation, kDecoding); !status.ok())
      return status;
    const size_t begin = out->size(), end = std::min<size_t>(count, begin + kBytesOfPoll / sizeof(T));
    out->resize(end);
    std::memcpy(out->data() + begin, bytes.data() + begin * sizeof(T), (end - begin) * sizeof(T));
  }
  return absl::OkStatus();
}

absl::Status DecodeMesh(const v1::Mesh& mesh, const Decoding& decoding, const std::string& path, Mesh* out) {
  absl::Status status = CheckIndex(mesh.material(), decoding.data.materials_size(), path + ".material");
  status.Update(DecodeArray(mesh.triangles(), mesh.triangle_count(), path + ".triangles", "triangles",
                            decoding, &out->triangles));
  status.Update(DecodeArray(mesh.positions(), mesh.vertex_count(), path + ".positions", "vertices", decoding,
                            &out->positions));
  if (!mesh.texture_coordinates().empty()) {
    status.Update(DecodeArray(mesh.texture_coordinates(), mesh.vertex_count(), path + ".texture_coordinates",
                              "vertices", decoding, &out->uvs));
  }
  out->material = static_cast<int>(mesh.material());
  return status;
}

absl::Status DecodeMaterial(const v1::Material& material, const Decoding& decoding, const std::string& path,
                            Material* out) {
  if (material.has_alpha_texture()) {
    absl::Status status =
        CheckIndex(material.alpha_texture(), decoding.data.alpha_textures_size(), path + ".alpha_texture");
    if (!status.ok()) return status;
    out->alpha_texture = static_cast<int>(material.alpha_texture());
  }
  if (material.alpha_cutoff() > 255) {
    return FieldError(path + ".alpha_cutoff",
                      absl::StrFormat("%d is outside 0 to 255", material.alpha_cutoff()));
  }
  out->alpha_cutoff = static_cast<uint8_t>(material.alpha_cutoff());
  const v1::Vector3f& t = material.transmittance();
  out->transmittance = {t.x(), t.y(), t.z()};
  return absl::OkStatus();
}

absl::Status DecodeTexture(const v1::AlphaTexture& texture, const Decoding& decoding, const std::string& path,
                           AlphaTexture* out) {
  for (const auto& [value, name] :
       {std::pair(texture.width(), ".width"), std::pair(texture.height(), ".height")}) {
    if (value < 1 || value > kMaxTextureSide) {
      return FieldError(path + name, absl::StrFormat("%d is outside 1 to %d", value, kMaxTextureSide));
    }
  }
  out->width = static_cast<int>(texture.width());
  out->height = static_cast<int>(texture.height());
  return DecodeArray(texture.alpha(), texture.width() * texture.height(), path + ".alpha", "texels", decoding,
                     &out->alpha);
}

absl::Status DecodeInstance(const v1::Instance& instance, const Decoding& decoding, const std::string& path,
                            Instance* out) {
  if (absl::Status status = CheckIndex(instance.mesh(), decoding.data.meshes_size(), path + ".mesh");
      !status.ok()) {
    return status;
  }
  out->mesh = static_cast<int>(instance.mesh());
  if (instance.world_from_object().empty()) return absl::OkStatus();
  return DecodeTransform(instance.world_from_object(), path + ".world_from_object", &out->world_from_object);
}

}  // namespace

absl::Status DecodeTransform(const google::protobuf::RepeatedField<float>& numbers, const std::string& path,
                             glm::mat4x3* out) {
  if (numbers.size() != 12)
    return FieldError(path, absl::StrFormat("%d entries, 12 expected", numbers.size()));
  for (int i = 0; i < 12; ++i) (*out)[i / 3][i % 3] = numbers[i];
  return absl::OkStatus();
}

absl::StatusOr<Scene> DecodeScene(std::string bytes, const Cancellation* cancellation) {
  if (bytes.size() > kMostBytes) {
    return FieldError("data", absl::StrFormat("%d bytes, at most %d", bytes.size(), kMostBytes));
  }
  v1::SceneData data;
  CancellableStream stream(bytes, cancellation);
  const bool parsed = data.ParseFromZeroCopyStream(&stream);
  if (absl::Status status = CancellationStatus(cancellation, kDecoding); !status.ok()) return status;
  if (!parsed) return FieldError("data", "not a serialized SceneData");
  bytes = {};
  Scene scene;
  const Decoding decoding = {data, cancellation};
  const auto decode_all = [&decoding](const auto& wire, auto* out, const char* name, const auto& decode) {
    out->resize(static_cast<size_t>(wire.size()));
    for (int i = 0; i < wire.size(); ++i) {
      absl::Status status;
      if (i % kElementsOfPoll == 0) status = CancellationStatus(decoding.cancellation, kDecoding);
      status.Update(
          decode(wire[i], decoding, absl::StrFormat("%s[%d]", name, i), &(*out)[static_cast<size_t>(i)]));
      if (!status.ok()) return status;
    }
    return absl::OkStatus();
  };
  absl::Status status = decode_all(data.materials(), &scene.materials, "materials", DecodeMaterial);
  if (status.ok()) {
    status = decode_all(data.alpha_textures(), &scene.alpha_textures, "alpha_textures", DecodeTexture);
  }
  if (status.ok()) status = decode_all(data.meshes(), &scene.meshes, "meshes", DecodeMesh);
  if (status.ok()) status = decode_all(data.instances(), &scene.instances, "instances", DecodeInstance);
  if (!status.ok()) return status;
  return scene;
}

}  // namespace shadowfit
