#include <cstdlib>

#include "core/scene/generating.h"
#include "core/scene/patches.h"
#include "core/scene/procedural.h"
#include "core/scene/random.h"

namespace shadowfit {
namespace {

constexpr double kHalfWidth = 40.0;
constexpr double kHalfDepth = 60.0;
constexpr double kHeight = 9.0;
constexpr double kWall = 0.2;

constexpr int kRowsEachWay = 4;      ///< Of shelves, from the middle one.
constexpr double kRow = 8.5;         ///< From row to row.
constexpr int kBaysEachWay = 10;     ///< Of a row.
constexpr double kBay = 5.0;         ///< From bay to bay.
constexpr int kCrossAisleBays = 2;   ///< On both sides of the middle: none there.
constexpr double kShelfDepth = 1.2;  ///< Across the row.

struct Materials {
  int concrete;
  int steel;
  int cardboard;
};

void AddShell(Patches* patches) {
  const glm::dvec3 size{2.0 * kHalfWidth, 2.0 * kHalfDepth, kWall};
  patches->AddBox(Patches::Standing({0.0, 0.0, -kWall}), size);
  patches->AddBox(Patches::Standing({0.0, 0.0, kHeight}), size);
  for (const double side : {-1.0, 1.0}) {
    patches->AddBox(Patches::Standing({side * (kHalfWidth + 0.5 * kWall), 0.0, 0.0}),
                    {kWall, 2.0 * kHalfDepth, kHeight});
    patches->AddBox(Patches::Standing({0.0, side * (kHalfDepth + 0.5 * kWall), 0.0}),
                    {2.0 * kHalfWidth, kWall, kHeight});
  }
  constexpr double kBeam = 0.8;
  for (int i = -6; i <= 6; ++i) {
    patches->AddBox(Patches::Standing({0.0, 9.0 * i, kHeight - kBeam}), {2.0 * kHalfWidth, 0.3, kBeam});
  }
}

/// Four boards between two posts, most of them full.
void AddBay(Patches* patches, const glm::dvec3& foot, const Materials& materials, Random* random) {
  constexpr double kBoard = 0.1;
  constexpr double kBoardLength = 4.8;
  for (const double level : {0.1, 1.95, 3.95, 5.95}) {
    patches->SetMaterial(materials.steel);
    const glm::dvec3 board = foot + glm::dvec3(0.0, 0.0, level);
    patches->AddBox(Patches::Standing(board), {kShelfDepth, kBoardLength, kBoard});
    patches->SetMaterial(materials.cardboard);
    for (const double along : {-1.6, 0.0, 1.6}) {
      if (random->Uniform(0.0, 1.0) > 0.7) continue;
      // One after the other: the order in which arguments are evaluated is the compiler's.
      const double height = random->Uniform(0.6, 1.6);
      const double aside = random->Uniform(-0.1, 0.1);
      const double turn = random->Uniform(-0.1, 0.1);
      patches->AddBox(Patches::Standing(board + glm::dvec3(aside, along, kBoard), turn), {1.0, 1.2, height});
    }
  }
  patches->SetMaterial(materials.steel);
  for (const double side : {-0.55, 0.55}) {
    patches->AddBox(Patches::Standing(foot + glm::dvec3(side, -2.45, 0.0)), {0.1, 0.1, 7.0});
  }
}

}  // namespace

absl::StatusOr<Scene> MakeWarehouse(size_t triangles, uint64_t seed) {
  Scene scene;
  scene.name = "warehouse";
  const Materials materials{AddMaterial(&scene, "concrete", {0.7f, 0.68f, 0.64f}),
                            AddMaterial(&scene, "steel", {0.25f, 0.35f, 0.55f}),
                            AddMaterial(&scene, "cardboard", {0.6f, 0.45f, 0.3f})};
  Random random(seed);
  Patches patches;
  patches.SetMaterial(materials.concrete);
  patches.SetDetail(0.1);  // Flat.
  AddShell(&patches);
  patches.SetDetail(0.3);
  for (int row = -kRowsEachWay; row <= kRowsEachWay; ++row) {
    for (int bay = -kBaysEachWay; bay <= kBaysEachWay; ++bay) {
      if (std::abs(bay) < kCrossAisleBays) continue;
      AddBay(&patches, {kRow * row, kBay * bay, 0.0}, materials, &random);
    }
  }
  const size_t least = patches.LeastTriangles();
  if (triangles < least) return TooFew("warehouse", triangles, least);
  patches.Tessellate(triangles, &scene);
  return scene;
}

StandPoint WarehouseStandPoint() { return {{0.5 * kRow, -18.0, 1.7}, {0.5 * kRow, 40.0, 2.5}}; }

}  // namespace shadowfit
