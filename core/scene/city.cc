#include "core/scene/generating.h"
#include "core/scene/patches.h"
#include "core/scene/procedural.h"
#include "core/scene/random.h"

namespace shadowfit {
namespace {

constexpr int kBlocksEachWay = 8;  ///< From the middle block.
constexpr double kBlock = 34.0;    ///< From street to street.

glm::dvec3 Corner(int column, int row) { return {kBlock * column, kBlock * row, 0.0}; }

/// A tower of some storeys with what stands on roofs.
void AddTower(Patches* patches, const glm::dvec3& foot, Random* random) {
  const double height = random->Uniform(6.0, 60.0);
  const double width = random->Uniform(16.0, 26.0);
  const double depth = random->Uniform(16.0, 26.0);
  patches->AddBox(Patches::Standing(foot), {width, depth, height});
  for (int i = 0; i < 3; ++i) {
    // One after the other: the order in which arguments are evaluated is the compiler's.
    const double y = random->Uniform(-6.0, 6.0);
    const double x = random->Uniform(-6.0, 6.0);
    const glm::dvec3 roof = foot + glm::dvec3(x, y, height);
    patches->AddBox(Patches::Standing(roof),
                    {random->Uniform(0.6, 4.0), random->Uniform(0.6, 4.0), random->Uniform(1.0, 2.5)});
  }
}

void AddStreetLamp(Patches* patches, const glm::dvec3& foot) {
  patches->AddRod(foot, foot + glm::dvec3(0, 0, 5.0), 0.09, 0.06);
  patches->AddBox(Patches::Standing(foot + glm::dvec3(0.6, 0, 5.0)), {1.4, 0.2, 0.12});
}

void AddCar(Patches* patches, const Patches::Frame& frame) {
  patches->AddBox({frame.At(0, 0, 0.25), frame.x, frame.y, frame.z}, {1.8, 4.2, 0.6});
  patches->AddBox({frame.At(0, -0.2, 0.85), frame.x, frame.y, frame.z}, {1.6, 2.2, 0.55});
}

}  // namespace

absl::StatusOr<Scene> MakeCity(size_t triangles, uint64_t seed) {
  Scene scene;
  scene.name = "city";
  const int asphalt = AddMaterial(&scene, "asphalt", {0.3f, 0.3f, 0.32f});
  const int concrete = AddMaterial(&scene, "concrete", {0.7f, 0.68f, 0.64f});
  const int metal = AddMaterial(&scene, "metal", {0.4f, 0.42f, 0.45f});

  Random random(seed);
  Patches patches;
  patches.SetMaterial(asphalt);
  patches.SetDetail(0.1);  // Flat.
  const double half = (kBlocksEachWay + 1) * kBlock;
  patches.AddQuad({-half, -half, 0.0}, {2.0 * half, 0.0, 0.0}, {0.0, 2.0 * half, 0.0});
  patches.SetDetail(0.3);
  for (int column = -kBlocksEachWay; column <= kBlocksEachWay; ++column) {
    for (int row = -kBlocksEachWay; row <= kBlocksEachWay; ++row) {
      if ((column + row) % 7 == 0) continue;  // A square.
      patches.SetMaterial(concrete);
      AddTower(&patches, Corner(column, row), &random);
      // Along the street to the right of it.
      const glm::dvec3 street = Corner(column, row) + glm::dvec3(0.5 * kBlock, 0, 0);
      const auto along = [&] { return random.Uniform(-0.45 * kBlock, 0.45 * kBlock); };
      patches.SetMaterial(metal);
      for (int i = 0; i < 4; ++i) {
        const double y = along();
        AddStreetLamp(&patches, street + glm::dvec3(random.Uniform(-3.5, -2.5), y, 0.0));
      }
      for (int i = 0; i < 3; ++i) {
        const double y = along();
        const glm::dvec3 place = street + glm::dvec3(random.Uniform(2.0, 3.0), y, 0.0);
        AddCar(&patches, Patches::Standing(place, random.Uniform(-0.1, 0.1)));
      }
    }
  }
  const size_t least = patches.LeastTriangles();
  if (triangles < least) return TooFew("city", triangles, least);
  patches.Tessellate(triangles, &scene);
  return scene;
}

StandPoint CityStandPoint() { return {{0.5 * kBlock, -1.6 * kBlock, 1.7}, {0.5 * kBlock, 0.0, 6.0}}; }

}  // namespace shadowfit
