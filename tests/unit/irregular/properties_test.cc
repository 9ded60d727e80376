// Properties of masks on random tiny scenes. Where one does not hold, triangles and samples are left out for
// as long as it still does not, and what remains is printed.

#include <gtest/gtest.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/irregular/shadow_masks.h"
#include "core/math/ray_space.h"
#include "tests/unit/irregular/mask_oracle.h"
#include "tests/unit/irregular/random_scenes.h"

namespace shadowfit {
namespace {

constexpr int kWidth = 24;
constexpr int kHeight = 8;
constexpr size_t kPoints = size_t{kWidth} * kHeight;

struct Example {
  std::vector<glm::vec3> positions;
  std::vector<glm::uvec3> triangles;
  Light light;
  std::vector<glm::vec3> points;  ///< NaN: none.
};

/// Why a property does not hold.
using Property = std::function<std::optional<std::string>(const Example&)>;

struct Outcome {
  std::vector<bool> in_shadow;
  size_t undecided = 0;

  bool operator==(const Outcome&) const = default;
};

Outcome Render(const Example& example, MaskMethod method = MaskMethod::kGrid, int threads = 0,
               MaskPieces pieces = MaskPieces::kAuto) {
  Scene casters;
  if (!example.triangles.empty()) casters = OneMeshScene(example.positions, example.triangles);
  const auto scene = MaskScene::Create(casters);
  EXPECT_TRUE(scene.ok()) << scene.status();
  ReceiverLayer layer;
  layer.ws_positions = BottomFirst(example.points.data(), kWidth, kHeight);
  MaskRequest request;
  request.scene = &*scene;
  request.layers = {&layer, 1};
  request.lights = {&example.light, 1};
  request.method = method;
  request.pieces = pieces;
  MaskRenderer renderer;
  Outcome outcome;
  const auto render = [&] {
    const auto masks = renderer.Render(request);
    EXPECT_TRUE(masks.ok()) << masks.status();
    if (!masks.ok()) return;
    outcome.undecided = (*masks)[0].undecided_samples;
    for (size_t i = 0; i < kPoints; ++i) {
      outcome.in_shadow.push_back(
          (*masks)[0].InShadow(0, kHeight, static_cast<int>(i % kWidth), static_cast<int>(i / kWidth)));
    }
  };
  threads > 0 ? tbb::task_arena(threads).execute(render) : render();
  return outcome;
}

/// Leaves out parts of what is in `count` places, halves first, while `fails` says so of the rest.
void ShrinkList(size_t count, const std::function<bool(const std::vector<bool>& kept)>& fails) {
  std::vector<bool> kept(count, true);
  for (size_t part = std::max<size_t>(count / 2, 1); part > 0; part = part > 1 ? (part + 1) / 2 : 0) {
    bool shrunk = true;
    while (shrunk) {
      shrunk = false;
      for (size_t first = 0; first < count; first += part) {
        std::vector<bool> fewer = kept;
        for (size_t i = first; i < std::min(count, first + part); ++i) fewer[i] = false;
        if (fewer == kept || !fails(fewer)) continue;
        kept = fewer;
        shrunk = true;
      }
    }
  }
}

Example Shrink(Example example, const Property& property) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  for (int round = 0; round < 2; ++round) {
    const Example before = example;
    ShrinkList(before.triangles.size(), [&](const std::vector<bool>& kept) {
      Example fewer = before;
      fewer.triangles.clear();
      for (size_t i = 0; i < kept.size(); ++i) {
        if (kept[i]) fewer.triangles.push_back(before.triangles[i]);
      }
      if (!property(fewer)) return false;
      example.triangles = fewer.triangles;
      return true;
    });
    const Example with_points = example;
    ShrinkList(kPoints, [&](const std::vector<bool>& kept) {
      Example fewer = with_points;
      for (size_t i = 0; i < kPoints; ++i) {
        if (!kept[i]) fewer.points[i] = glm::vec3(kNan);
      }
      if (!property(fewer)) return false;
      example.points = fewer.points;
      return true;
    });
  }
  return example;
}

size_t PointCount(const Example& example) {
  return static_cast<size_t>(std::count_if(example.points.begin(), example.points.end(),
                                           [](const glm::vec3& p) { return !std::isnan(p.x); }));
}

/// Hexadecimal: exactly what failed.
std::string Describe(const Example& example) {
  const auto vector = [](const auto& v) { return absl::StrFormat("{%a, %a, %a}", v.x, v.y, v.z); };
  std::string text;
  for (const glm::uvec3& t : example.triangles) {
    absl::StrAppend(&text, "  triangle ", vector(example.positions[t.x]), " ", vector(example.positions[t.y]),
                    " ", vector(example.positions[t.z]), "\n");
  }
  for (size_t i = 0; i < kPoints; ++i) {
    if (!std::isnan(example.points[i].x)) {
      absl::StrAppend(&text, "  sample ", i, " at ", vector(example.points[i]), "\n");
    }
  }
  if (const auto* point = std::get_if<PointLight>(&example.light)) {
    absl::StrAppend(&text, "  point light at ", vector(point->ws_position));
  } else if (const auto* spot = std::get_if<SpotLight>(&example.light)) {
    absl::StrAppend(&text, "  spot light at ", vector(spot->ws_position), " towards ",
                    vector(spot->ws_direction));
  } else {
    absl::StrAppend(&text, "  directional light along ",
                    vector(std::get<DirectionalLight>(example.light).ws_direction));
  }
  return text;
}

Example RandomExample(RandomScenes* scenes) {
  const Scene scene = scenes->Next();
  Example example{scene.meshes[0].positions, scene.meshes[0].triangles, scenes->NextLight(), {}};
  example.points = scenes->Receivers(scene, kPoints);
  return example;
}

void Check(uint32_t seed, int scene_count, const Property& property) {
  RandomScenes scenes(seed);
  for (int n = 0; n < scene_count; ++n) {
    const Example example = RandomExample(&scenes);
    if (!property(example)) continue;
    const Example least = Shrink(example, property);
    FAIL() << "seed " << seed << ", scene " << n << ": " << *property(least) << "; of it remains:\n"
           << Describe(least);
  }
}

TEST(MaskProperties, MethodsAndThreadsAgree) {
  Check(61, 400, [](const Example& example) -> std::optional<std::string> {
    const Outcome exhaustive = Render(example, MaskMethod::kExhaustive, 1);
    if (Render(example, MaskMethod::kGrid, 1) != exhaustive) return "default differs from exhaustive";
    if (Render(example, MaskMethod::kGrid, 3) != exhaustive) return "default differs with three threads";
    if (Render(example, MaskMethod::kGrid, 2, MaskPieces::kFrame) != exhaustive) return "all at once differs";
    if (Render(example, MaskMethod::kBsp, 2) != exhaustive) return "bsp differs from exhaustive";
    return std::nullopt;
  });
}

TEST(MaskProperties, CastersAddShadowAndTheirOrderDoesNotMatter) {
  Check(62, 400, [](const Example& example) -> std::optional<std::string> {
    const Outcome all = Render(example);
    Example other = example;
    std::shuffle(other.triangles.begin(), other.triangles.end(), std::mt19937(1));
    if (Render(other) != all) return "another order of triangles gives another answer";
    other.triangles.resize((other.triangles.size() + 1) / 2);
    const Outcome fewer = Render(other);
    for (size_t i = 0; i < kPoints; ++i) {
      if (fewer.in_shadow[i] && !all.in_shadow[i]) return absl::StrCat("casters light sample ", i);
    }
    return std::nullopt;
  });
}

/// Other samples change the layout, and a directional light's origin, but for a point or spot light not the
/// answer.
TEST(MaskProperties, SamplesDoNotDependOnEachOther) {
  Check(63, 400, [](const Example& example) -> std::optional<std::string> {
    if (std::holds_alternative<DirectionalLight>(example.light)) return std::nullopt;
    const Outcome all = Render(example);
    Example other = example;
    for (size_t i = 0; i < kPoints; ++i) {
      if (i % 3 != 0) other.points[i] = glm::vec3(std::numeric_limits<float>::quiet_NaN());
    }
    const Outcome fewer = Render(other, MaskMethod::kExhaustive);
    for (size_t i = 0; i < kPoints; i += 3) {
      if (fewer.in_shadow[i] != all.in_shadow[i]) return absl::StrCat("sample ", i, " alone differs");
    }
    return std::nullopt;
  });
}

/// What fails for one sample of one triangle comes out as these alone.
TEST(MaskProperties, FailuresShrinkToTheirCause) {
  RandomScenes scenes(64);
  size_t shrunk = 0;
  for (int n = 0; n < 40; ++n) {
    const Example example = RandomExample(&scenes);
    const Property no_shadow = [](const Example& e) -> std::optional<std::string> {
      const Outcome outcome = Render(e);
      if (std::find(outcome.in_shadow.begin(), outcome.in_shadow.end(), true) == outcome.in_shadow.end()) {
        return std::nullopt;
      }
      return "a sample is in shadow";
    };
    if (!no_shadow(example)) continue;
    const Example least = Shrink(example, no_shadow);
    EXPECT_TRUE(no_shadow(least).has_value());
    EXPECT_EQ(least.triangles.size(), 1u) << Describe(least);
    EXPECT_EQ(PointCount(least), 1u) << Describe(least);
    ++shrunk;
  }
  EXPECT_GT(shrunk, 20u);
}

}  // namespace
}  // namespace shadowfit
