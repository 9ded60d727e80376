#include "core/scene/procedural.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_format.h"
#include "core/scene/generating.h"
#include "core/scene/patches.h"
#include "core/scene/random.h"

namespace shadowfit {
namespace {

constexpr double kPi = std::numbers::pi;

Mesh& AddMesh(Scene* scene, int material) {
  scene->instances.push_back({.mesh = static_cast<int>(scene->meshes.size())});
  Mesh& mesh = scene->meshes.emplace_back();
  mesh.material = material;
  return mesh;
}

void AddTriangle(Mesh* mesh, const glm::dvec3& a, const glm::dvec3& b, const glm::dvec3& c) {
  const auto base = static_cast<uint32_t>(mesh->positions.size());
  mesh->positions.insert(mesh->positions.end(), {glm::vec3(a), glm::vec3(b), glm::vec3(c)});
  mesh->triangles.emplace_back(base, base + 1, base + 2);
}

/// A randomly turned, roughly equilateral triangle of the given area.
void AddRandomTriangle(Mesh* mesh, const glm::dvec3& center, double area, Random* random) {
  const glm::dvec3 normal = random->Direction();
  const glm::dvec3 x = glm::normalize(glm::cross(normal, random->Direction()));
  const glm::dvec3 y = glm::cross(normal, x);
  // An equilateral triangle of circumradius R has area 3/4 sqrt(3) R^2.
  const double radius = std::sqrt(area * 4.0 / (3.0 * std::numbers::sqrt3));
  const double third = 2.0 * kPi / 3.0;
  const auto corner = [&](int i) {
    return center + radius * (std::cos(i * third) * x + std::sin(i * third) * y);
  };
  AddTriangle(mesh, corner(0), corner(1), corner(2));
}

void AddFloor(Scene* scene, double half_side) {
  Mesh& mesh = AddMesh(scene, AddMaterial(scene, "floor", {0.6f, 0.58f, 0.55f}));
  const auto s = static_cast<float>(half_side);
  mesh.positions = {{-s, -s, 0}, {s, -s, 0}, {s, s, 0}, {-s, s, 0}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
}

void AddColumn(Patches* patches, const glm::dvec3& foot, double height, double radius) {
  const double block = 2.8 * radius;
  patches->AddBox(Patches::Standing(foot), {block, block, 0.25});
  patches->AddTorus(Patches::Standing(foot + glm::dvec3(0, 0, 0.25 + 0.2 * radius)), radius, 0.2 * radius);
  patches->AddRod(foot + glm::dvec3(0, 0, 0.25), foot + glm::dvec3(0, 0, height - 0.25), radius,
                  0.85 * radius);
  patches->AddBox(Patches::Standing(foot + glm::dvec3(0, 0, height - 0.25)), {block, block, 0.25});
}

/// Posts a metre apart with three bars.
void AddRailing(Patches* patches, const glm::dvec3& from, const glm::dvec3& to) {
  const int posts = static_cast<int>(std::ceil(glm::length(to - from)));
  for (int i = 0; i <= posts; ++i) {
    const glm::dvec3 foot = from + (to - from) * (double(i) / posts);
    patches->AddRod(foot, foot + glm::dvec3(0, 0, 1.1), 0.025, 0.025);
  }
  for (const double height : {0.35, 0.7, 1.05}) {
    patches->AddRod(from + glm::dvec3(0, 0, height), to + glm::dvec3(0, 0, height), 0.018, 0.018);
  }
}

void AddStairs(Patches* patches, const Patches::Frame& frame, int steps, double width) {
  constexpr double kRise = 0.17;
  constexpr double kRun = 0.3;
  for (int i = 0; i < steps; ++i) {
    // Each step reaches down to the floor, as a solid flight does.
    Patches::Frame step = frame;
    step.origin = frame.At(0.0, (i + 0.5) * kRun, 0.0);
    patches->AddBox(step, {width, kRun, (i + 1) * kRise});
  }
}

void AddBench(Patches* patches, const Patches::Frame& frame) {
  for (const double x : {-0.7, 0.7}) {
    Patches::Frame leg = frame;
    leg.origin = frame.At(x, 0.0, 0.0);
    patches->AddBox(leg, {0.08, 0.4, 0.42});
  }
  for (const double y : {-0.16, 0.0, 0.16}) {
    Patches::Frame slat = frame;
    slat.origin = frame.At(0.0, y, 0.42);
    patches->AddBox(slat, {1.8, 0.12, 0.04});
  }
}

void AddTable(Patches* patches, const Patches::Frame& frame, const glm::dvec3& size) {
  for (const double x : {-0.45, 0.45}) {
    for (const double y : {-0.42, 0.42}) {
      const glm::dvec3 foot = frame.At(x * size.x, y * size.y, 0.0);
      patches->AddRod(foot, foot + (size.z - 0.04) * frame.z, 0.03, 0.035);
    }
  }
  Patches::Frame top = frame;
  top.origin = frame.At(0.0, 0.0, size.z - 0.04);
  patches->AddBox(top, {size.x, size.y, 0.04});
}

void AddChair(Patches* patches, const Patches::Frame& frame) {
  AddTable(patches, frame, {0.45, 0.45, 0.46});
  for (const double x : {-0.2, 0.2}) {
    const glm::dvec3 foot = frame.At(x, 0.21, 0.46);
    patches->AddRod(foot, foot + 0.5 * frame.z, 0.018, 0.015);
  }
  Patches::Frame back = frame;
  back.origin = frame.At(0.0, 0.21, 0.75);
  patches->AddBox(back, {0.44, 0.025, 0.16});
}

/// A trunk that splits into branches; `tips` receives where the leaves gather.
void AddTree(Patches* patches, const glm::dvec3& foot, double height, Random* random,
             std::vector<glm::dvec3>* tips) {
  const glm::dvec3 fork =
      foot + glm::dvec3(random->Uniform(-0.15, 0.15), random->Uniform(-0.15, 0.15), 0.45 * height);
  patches->AddRod(foot, fork, 0.16, 0.11);
  for (int i = 0; i < 6; ++i) {
    const double angle = (i + random->Uniform(-0.3, 0.3)) * kPi / 3.0;
    const double reach = random->Uniform(0.5, 0.9) * 0.3 * height;
    const glm::dvec3 knee = fork + glm::dvec3(reach * std::cos(angle), reach * std::sin(angle),
                                              random->Uniform(0.1, 0.3) * height);
    patches->AddRod(fork, knee, 0.07, 0.04);
    for (int j = 0; j < 4; ++j) {
      glm::dvec3 way = random->Direction();
      way.z = std::abs(way.z);
      const glm::dvec3 tip = knee + random->Uniform(0.12, 0.22) * height * way;
      patches->AddRod(knee, tip, 0.03, 0.01);
      tips->push_back(tip);
    }
  }
}

/// Free places on the floor for the loose objects.
class Places {
 public:
  explicit Places(Random* random) : random_(random) {}
  void Reserve(glm::dvec2 center, double radius) { taken_.push_back({center, radius}); }
  /// A random place within `reach` of the origin that is free in `radius`; taken from now on. Where the floor
  /// is full, the freest of many tries.
  glm::dvec3 Take(double reach, double radius) {
    glm::dvec2 best(0.0);
    double best_room = -1e300;
    for (int attempt = 0; attempt < 200 && best_room < 0.0; ++attempt) {
      const glm::dvec2 p(random_->Uniform(-reach, reach), random_->Uniform(-reach, reach));
      double room = 1e300;
      for (const Circle& circle : taken_) {
        room = std::min(room, glm::length(p - circle.center) - circle.radius - radius);
      }
      if (room > best_room) {
        best_room = room;
        best = p;
      }
    }
    Reserve(best, radius);
    return {best, 0.0};
  }

 private:
  struct Circle {
    glm::dvec2 center;
    double radius;
  };
  Random* random_;
  std::vector<Circle> taken_;
};

/// A wall along the frame's x axis from 0 to length with a regular row of window openings.
void AddWindowWall(Patches* patches, const Patches::Frame& frame, double length, double height,
                   double thickness, int windows) {
  constexpr double kSill = 1.1;
  constexpr double kLintel = 4.2;
  constexpr double kOpening = 1.6;
  const auto block = [&](double x0, double x1, double z0, double z1) {
    Patches::Frame part = frame;
    part.origin = frame.At(0.5 * (x0 + x1), 0.0, z0);
    patches->AddBox(part, {x1 - x0, thickness, z1 - z0});
  };
  block(0.0, length, 0.0, kSill);
  block(0.0, length, kLintel, height);
  double x = 0.0;
  for (int i = 0; i < windows; ++i) {
    const double middle = (i + 0.5) * length / windows;
    block(x, middle - 0.5 * kOpening, kSill, kLintel);
    x = middle + 0.5 * kOpening;
    // A cross of glazing bars.
    patches->AddRod(frame.At(middle, 0.0, kSill), frame.At(middle, 0.0, kLintel), 0.02, 0.02);
    for (const double z : {2.1, 3.2}) {
      patches->AddRod(frame.At(middle - 0.5 * kOpening, 0.0, z), frame.At(x, 0.0, z), 0.02, 0.02);
    }
  }
  block(x, length, kSill, kLintel);
}

/// Value noise of a lattice with smooth interpolation, in [-1,1].
double LatticeNoise(uint64_t seed, double x, double y) {
  const auto value = [seed](double i, double j) {
    Random random(seed ^ (static_cast<uint64_t>(static_cast<int64_t>(i)) * 0x9e3779b97f4a7c15u) ^
                  (static_cast<uint64_t>(static_cast<int64_t>(j)) * 0xc2b2ae3d27d4eb4fu));
    return random.Uniform(-1.0, 1.0);
  };
  const double i = std::floor(x);
  const double j = std::floor(y);
  const auto smooth = [](double t) { return t * t * (3.0 - 2.0 * t); };
  const double a = smooth(x - i);
  const double b = smooth(y - j);
  return (1.0 - b) * ((1.0 - a) * value(i, j) + a * value(i + 1, j)) +
         b * ((1.0 - a) * value(i, j + 1) + a * value(i + 1, j + 1));
}

}  // namespace

absl::StatusOr<Scene> MakePlaza(size_t triangles, uint64_t seed) {
  Scene scene;
  scene.name = "plaza";
  const int paving = AddMaterial(&scene, "paving", {0.62f, 0.6f, 0.56f});
  const int stone = AddMaterial(&scene, "stone", {0.78f, 0.75f, 0.68f});
  const int metal = AddMaterial(&scene, "metal", {0.35f, 0.38f, 0.4f});
  const int paint = AddMaterial(&scene, "paint", {0.7f, 0.32f, 0.22f});
  const int wood = AddMaterial(&scene, "wood", {0.42f, 0.3f, 0.2f});
  const int leaf = AddMaterial(&scene, "leaf", {0.25f, 0.45f, 0.15f});

  Random random(seed);
  Places places(&random);
  Patches patches;

  patches.SetMaterial(paving);
  patches.SetDetail(0.35);  // Flat: its triangles serve nobody.
  patches.AddQuad({-30.0, -30.0, 0.0}, {60.0, 0.0, 0.0}, {0.0, 60.0, 0.0});

  patches.SetMaterial(stone);
  patches.SetDetail(1.0);
  for (int i = 0; i < 7; ++i) {
    const glm::dvec3 foot(-12.0 + 4.0 * i, 10.0, 0.0);
    AddColumn(&patches, foot, 4.5, 0.32);
    places.Reserve(foot, 1.2);
  }
  patches.AddBox(Patches::Standing({0.0, 10.0, 4.5}), {25.5, 0.9, 0.5});
  for (int i = 0; i < 5; ++i) {
    const glm::dvec3 foot(13.0, -9.0 + 4.0 * i, 0.0);
    AddColumn(&patches, foot, 3.6, 0.26);
    places.Reserve(foot, 1.0);
  }
  for (int i = 0; i < 3; ++i) {
    const Patches::Frame arch = Patches::Standing({-7.0 + 3.6 * i, 4.6, 2.2}, 0.12);
    for (const double side : {-1.0, 1.0}) {
      const glm::dvec3 pillar = arch.At(side * 1.45, 0.0, -2.2);
      patches.AddBox(Patches::Standing(pillar, 0.12), {0.5, 0.7, 2.2});
      places.Reserve(pillar, 0.8);
    }
    patches.AddArch(arch, 1.2, 0.5, 0.7);
  }
  AddStairs(&patches, Patches::Standing({-9.5, -3.0, 0.0}, 0.5), 9, 2.6);
  places.Reserve({-10.2, -1.8}, 2.6);
  for (int i = 0; i < 6; ++i) {  // The stepped pyramid.
    const double side = 4.2 - 0.7 * i;
    patches.AddBox(Patches::Standing({7.5, 4.5, 0.3 * i}, 0.3), {side, side, 0.3});
  }
  places.Reserve({7.5, 4.5}, 3.2);
  patches.AddRod({7.5, 4.5, 1.8}, {7.5, 4.5, 4.6}, 0.22, 0.02);  // A needle on top.
  // The fountain.
  patches.AddTorus(Patches::Standing({3.0, -2.5, 0.3}), 1.9, 0.3);
  patches.AddRod({3.0, -2.5, 0.0}, {3.0, -2.5, 1.4}, 0.25, 0.15);
  patches.AddSphere({3.0, -2.5, 1.6}, 0.35);
  patches.AddTorus(Patches::Standing({3.0, -2.5, 1.2}), 0.7, 0.07);
  places.Reserve({3.0, -2.5}, 2.5);

  patches.SetMaterial(metal);
  for (const auto& [from, to] : {std::pair(glm::dvec3(-14.0, -6.8, 0.0), glm::dvec3(-5.5, -6.2, 0.0)),
                                 std::pair(glm::dvec3(2.0, -8.8, 0.0), glm::dvec3(9.0, -6.5, 0.0)),
                                 std::pair(glm::dvec3(-14.0, -2.0, 0.0), glm::dvec3(-14.0, 8.0, 0.0))}) {
    AddRailing(&patches, from, to);
    for (int i = 0; i <= 10; ++i) places.Reserve(glm::dvec2(from + 0.1 * i * (to - from)), 0.6);
  }
  // A tilted ring on a pedestal.
  Patches::Frame ring{{-3.0, -4.5, 1.9}, glm::normalize(glm::dvec3(1.0, 0.3, 0.2)), {}, {}};
  ring.z = glm::normalize(glm::cross(ring.x, glm::dvec3(0.1, 0.3, 1.0)));
  ring.y = glm::cross(ring.z, ring.x);
  patches.AddTorus(ring, 0.9, 0.09);
  places.Reserve({-3.0, -4.5}, 1.2);
  // Keep clear of the stand point.
  places.Reserve(glm::dvec2(PlazaStandPoint().ws_eye), 3.5);

  for (int i = 0; i < 9; ++i) {
    const glm::dvec3 foot = places.Take(15.0, 0.5);
    const double height = random.Uniform(3.5, 6.0);
    const double radius = random.Uniform(0.03, 0.06);
    patches.AddRod(foot, foot + glm::dvec3(0, 0, height), radius, 0.7 * radius);
    patches.AddSphere(foot + glm::dvec3(0, 0, height + 0.15), 0.18);
  }

  patches.SetMaterial(stone);
  patches.AddBox(Patches::Standing({-3.0, -4.5, 0.0}, 0.4), {0.9, 0.9, 0.95});
  for (int i = 0; i < 6; ++i) {
    const glm::dvec3 foot = places.Take(13.0, 1.0);
    const double radius = random.Uniform(0.35, 0.7);
    const double pedestal = random.Uniform(0.4, 1.1);
    patches.AddBox(Patches::Standing(foot, random.Uniform(0.0, kPi)), {1.2 * radius, 1.2 * radius, pedestal});
    patches.AddSphere(foot + glm::dvec3(0, 0, pedestal + radius), radius);
  }

  patches.SetMaterial(paint);
  for (int i = 0; i < 10; ++i) {
    const glm::dvec3 size(random.Uniform(0.4, 1.4), random.Uniform(0.4, 1.4), random.Uniform(0.4, 1.6));
    const Patches::Frame frame =
        Patches::Standing(places.Take(14.0, 0.5 * glm::length(glm::dvec2(size))), random.Uniform(0.0, kPi));
    patches.AddBox(frame, size);
    if (i % 3 == 0) {
      patches.AddBox(Patches::Standing(frame.At(0.05, -0.05, size.z), random.Uniform(0.0, kPi)), 0.55 * size);
    }
  }

  patches.SetMaterial(wood);
  for (int i = 0; i < 5; ++i) {
    AddBench(&patches, Patches::Standing(places.Take(12.0, 1.1), random.Uniform(0.0, kPi)));
  }
  std::vector<glm::dvec3> tips;
  for (int i = 0; i < 6; ++i) {
    AddTree(&patches, places.Take(17.0, 2.0), random.Uniform(4.5, 6.5), &random, &tips);
  }

  const size_t least = patches.LeastTriangles();
  if (triangles < least) return TooFew("plaza", triangles, least);
  const size_t wanted_leaves = triangles / 4;
  const size_t solid = patches.Tessellate(std::max(least, triangles - wanted_leaves), &scene);

  // As many leaves as make the count exact, at a fixed total area.
  const size_t leaves = triangles - solid;
  Mesh& foliage = AddMesh(&scene, leaf);
  foliage.positions.reserve(3 * leaves);
  foliage.triangles.reserve(leaves);
  const double leaf_area = leaves > 0 ? 150.0 / static_cast<double>(leaves) : 0.0;
  for (size_t i = 0; i < leaves; ++i) {
    const glm::dvec3& tip = tips[random.Next() % tips.size()];
    const glm::dvec3 offset = 0.75 * std::cbrt(random.Uniform(0.0, 1.0)) * random.Direction();
    AddRandomTriangle(&foliage, tip + offset, leaf_area, &random);
  }
  if (leaves == 0) {
    scene.meshes.pop_back();
    scene.instances.pop_back();
  }
  return scene;
}

StandPoint PlazaStandPoint() { return {{-8.5, -13.5, 1.7}, {1.5, 2.0, 0.3}}; }

absl::StatusOr<Scene> MakeHall(size_t triangles, uint64_t seed) {
  constexpr double kLength = 30.0;
  constexpr double kWidth = 16.0;
  constexpr double kHeight = 8.0;
  constexpr double kWall = 0.4;
  constexpr double kAisle = 3.6;     // From wall to columns.
  constexpr double kSkylight = 4.0;  // Width of the opening along the nave.
  constexpr int kBays = 7;

  Scene scene;
  scene.name = "hall";
  const int plaster = AddMaterial(&scene, "plaster", {0.8f, 0.77f, 0.7f});
  const int tiles = AddMaterial(&scene, "tiles", {0.55f, 0.45f, 0.38f});
  const int stone = AddMaterial(&scene, "stone", {0.7f, 0.68f, 0.63f});
  const int wood = AddMaterial(&scene, "wood", {0.4f, 0.27f, 0.17f});
  const int brass = AddMaterial(&scene, "brass", {0.6f, 0.5f, 0.25f});
  Random random(seed);
  Patches patches;

  patches.SetDetail(0.5);
  patches.SetMaterial(tiles);
  patches.AddQuad({-0.5 * kLength, -0.5 * kWidth, 0.0}, {kLength, 0.0, 0.0}, {0.0, kWidth, 0.0});
  patches.SetMaterial(plaster);
  const glm::dvec2 half(0.5 * kLength, 0.5 * kWidth);
  AddWindowWall(&patches, Patches::Standing({-half.x, -half.y - 0.5 * kWall, 0.0}), kLength, kHeight, kWall,
                7);
  AddWindowWall(&patches, Patches::Standing({-half.x, half.y + 0.5 * kWall, 0.0}), kLength, kHeight, kWall,
                7);
  AddWindowWall(&patches, Patches::Standing({half.x + 0.5 * kWall, -half.y, 0.0}, 0.5 * kPi), kWidth, kHeight,
                kWall, 3);
  AddWindowWall(&patches, Patches::Standing({-half.x - 0.5 * kWall, -half.y, 0.0}, 0.5 * kPi), kWidth,
                kHeight, kWall, 3);
  // The ceiling leaves a skylight with beams across.
  const double roof = 0.5 * (kWidth - kSkylight);
  for (const double side : {-1.0, 1.0}) {
    patches.AddBox(Patches::Standing({0.0, side * (0.5 * kSkylight + 0.5 * roof), kHeight}),
                   {kLength, roof, 0.3});
  }
  patches.SetMaterial(wood);
  for (int i = 0; i <= 14; ++i) {
    patches.AddBox(Patches::Standing({-half.x + 0.5 + i * (kLength - 1.0) / 14, 0.0, kHeight}),
                   {0.15, kSkylight, 0.25});
  }

  // Columns with arches between them and a gallery above the aisles.
  patches.SetDetail(1.0);
  patches.SetMaterial(stone);
  const double bay = kLength / kBays;
  for (const double side : {-1.0, 1.0}) {
    const double y = side * (half.y - kAisle);
    for (int i = 1; i < kBays; ++i) {
      AddColumn(&patches, {-half.x + i * bay, y, 0.0}, 3.4, 0.28);
      AddColumn(&patches, {-half.x + i * bay, y, 5.6}, kHeight - 5.6, 0.2);
    }
    for (int i = 0; i < kBays; ++i) {
      patches.AddArch(Patches::Standing({-half.x + (i + 0.5) * bay, y, 3.4}), 0.5 * bay - 0.35, 0.35, 0.5);
    }
    patches.AddBox(Patches::Standing({0.0, side * (half.y - 0.5 * kAisle), 5.4}), {kLength, kAisle, 0.2});
    for (int i = 0; i < 2 * kBays * 4; ++i) {  // Balusters and their rail.
      const glm::dvec3 foot(-half.x + (i + 0.5) * kLength / (2 * kBays * 4), y - side * 0.2, 5.6);
      patches.AddRod(foot, foot + glm::dvec3(0, 0, 0.9), 0.035, 0.025);
    }
    patches.AddBox(Patches::Standing({0.0, y - side * 0.2, 6.5}), {kLength, 0.12, 0.08});
  }

  patches.SetMaterial(wood);
  for (int i = 0; i < 4; ++i) {
    const Patches::Frame table =
        Patches::Standing({-9.0 + 6.0 * i, random.Uniform(-0.6, 0.6), 0.0}, random.Uniform(-0.2, 0.2));
    AddTable(&patches, table, {2.4, 1.1, 0.76});
    for (const double x : {-0.7, 0.0, 0.7}) {
      for (const double side : {-1.0, 1.0}) {
        const glm::dvec3 at = table.At(x + random.Uniform(-0.1, 0.1), side * random.Uniform(0.75, 1.0), 0.0);
        const double turn = random.Uniform(-0.3, 0.3) + (side > 0.0 ? 0.0 : kPi);
        AddChair(&patches, Patches::Standing(at, turn));
      }
    }
    // A bowl and a few books on the table.
    patches.AddSphere(table.At(random.Uniform(-0.3, 0.3), 0.1, 0.86), 0.1);
    for (int book = 0; book < 3; ++book) {
      patches.AddBox(Patches::Standing(table.At(random.Uniform(-1.0, 1.0), random.Uniform(-0.4, 0.4), 0.76),
                                       random.Uniform(0.0, kPi)),
                     {0.2, 0.28, random.Uniform(0.02, 0.06)});
    }
  }
  for (int i = 0; i < 5; ++i) {  // Shelves between the windows of one aisle.
    const Patches::Frame shelf = Patches::Standing({-half.x + (i + 1.0) * kLength / 7, half.y - 0.25, 0.0});
    for (const double x : {-0.75, 0.75}) {
      Patches::Frame side = shelf;
      side.origin = shelf.At(x, 0.0, 0.0);
      patches.AddBox(side, {0.04, 0.4, 2.2});
    }
    for (int board = 0; board < 6; ++board) {
      Patches::Frame plank = shelf;
      plank.origin = shelf.At(0.0, 0.0, 0.1 + 0.4 * board);
      patches.AddBox(plank, {1.46, 0.4, 0.03});
    }
  }
  AddStairs(&patches, Patches::Standing({half.x - 6.5, -half.y + 1.2, 0.0}, -0.5 * kPi), 14, 1.6);

  patches.SetMaterial(brass);
  for (int i = 0; i < 3; ++i) {
    const glm::dvec3 center(-9.0 + 9.0 * i, 0.0, 4.6);
    patches.AddRod(center, center + glm::dvec3(0, 0, kHeight - 4.6), 0.015, 0.015);
    patches.AddTorus(Patches::Standing(center), 0.9, 0.03);
    for (int arm = 0; arm < 8; ++arm) {
      const double angle = arm * kPi / 4.0;
      const glm::dvec3 end = center + 0.9 * glm::dvec3(std::cos(angle), std::sin(angle), 0.0);
      patches.AddRod(center, end, 0.012, 0.012);
      patches.AddRod(end, end + glm::dvec3(0, 0, 0.16), 0.02, 0.02);
    }
  }

  const size_t least = patches.LeastTriangles();
  if (triangles < least) return TooFew("hall", triangles, least);
  patches.Tessellate(triangles, &scene);
  return scene;
}

StandPoint HallStandPoint() { return {{-13.2, -2.6, 1.7}, {4.0, 1.6, 1.6}}; }

Scene MakeRandomTriangles(size_t triangles, uint64_t seed) {
  Scene scene;
  scene.name = "random";
  AddFloor(&scene, 10.0);
  Mesh& mesh = AddMesh(&scene, AddMaterial(&scene, "confetti", {0.7f, 0.3f, 0.3f}));
  Random random(seed);
  const double area = 40.0 / static_cast<double>(triangles);
  for (size_t i = 0; i < triangles; ++i) {
    const double x = random.Uniform(-5.0, 5.0);
    const double y = random.Uniform(-5.0, 5.0);
    AddRandomTriangle(&mesh, {x, y, random.Uniform(0.5, 5.0)}, area, &random);
  }
  return scene;
}

Scene MakeTerrain(int cells, uint64_t seed) {
  Scene scene;
  scene.name = "terrain";
  Mesh& mesh = AddMesh(&scene, AddMaterial(&scene, "soil", {0.5f, 0.45f, 0.3f}));
  const auto height = [&](double x, double y) {
    double sum = 0.0;
    double amplitude = 4.0;
    double frequency = 0.06;
    for (uint64_t octave = 0; octave < 6; ++octave) {
      sum += amplitude * LatticeNoise(seed + octave, x * frequency, y * frequency);
      amplitude *= 0.5;
      frequency *= 2.0;
    }
    return sum;
  };
  for (int j = 0; j <= cells; ++j) {
    for (int i = 0; i <= cells; ++i) {
      const double x = -50.0 + 100.0 * i / cells;
      const double y = -50.0 + 100.0 * j / cells;
      mesh.positions.emplace_back(x, y, height(x, y));
    }
  }
  const auto row = static_cast<uint32_t>(cells) + 1;
  for (uint32_t j = 0; j + 1 < row; ++j) {
    for (uint32_t i = 0; i + 1 < row; ++i) {
      const uint32_t a = j * row + i;
      mesh.triangles.emplace_back(a, a + 1, a + row + 1);
      mesh.triangles.emplace_back(a, a + row + 1, a + row);
    }
  }
  return scene;
}

Scene MakeHairBall(size_t hairs, float opacity, uint64_t seed) {
  constexpr int kSegments = 8;
  constexpr double kWidth = 0.004;
  Scene scene;
  scene.name = "hairball";
  AddFloor(&scene, 8.0);
  const int material = AddMaterial(&scene, "hair", {0.4f, 0.25f, 0.15f});
  scene.materials[static_cast<size_t>(material)].transmittance = glm::vec3(1.0f - opacity);
  Mesh& mesh = AddMesh(&scene, material);
  Random random(seed);
  const glm::dvec3 center(0.0, 0.0, 2.5);
  for (size_t hair = 0; hair < hairs; ++hair) {
    glm::dvec3 way = random.Direction();
    const glm::dvec3 side = glm::normalize(glm::cross(way, random.Direction()));
    glm::dvec3 point = center + 0.5 * way;
    const glm::dvec3 bend = 0.15 * random.Direction();
    const auto base = static_cast<uint32_t>(mesh.positions.size());
    for (int i = 0; i <= kSegments; ++i) {
      const double width = kWidth * (1.0 - 0.8 * i / kSegments);
      mesh.positions.emplace_back(point - 0.5 * width * side);
      mesh.positions.emplace_back(point + 0.5 * width * side);
      way = glm::normalize(way + bend);
      point += 1.5 / kSegments * way;
    }
    for (uint32_t i = 0; i < kSegments; ++i) {
      const uint32_t a = base + 2 * i;
      mesh.triangles.emplace_back(a, a + 1, a + 3);
      mesh.triangles.emplace_back(a, a + 3, a + 2);
    }
  }
  return scene;
}

DuelingFrusta MakeDuelingFrusta() {
  DuelingFrusta dueling;
  Scene& scene = dueling.scene;
  scene.name = "dueling";
  AddFloor(&scene, 40.0);
  Patches patches;
  patches.SetMaterial(AddMaterial(&scene, "post", {0.6f, 0.35f, 0.25f}));
  for (int row = 0; row < 8; ++row) {
    for (int column = -3; column <= 3; ++column) {
      const double shift = row % 2 == 0 ? 0.0 : 0.9;
      patches.AddBox(Patches::Standing({1.8 * column + shift, 2.0 + 2.5 * row, 0.0}, 0.2 * row),
                     {0.35, 0.35, 1.2 + 0.1 * row});
    }
  }
  patches.Tessellate(patches.LeastTriangles(), &scene);
  dueling.stand_point = {{0.0, -2.0, 1.7}, {0.0, 15.0, 0.8}};
  dueling.ws_light = {1.0, 26.0, 5.0};
  return dueling;
}

absl::StatusOr<Scene> MakeProceduralScene(std::string_view name) {
  const size_t colon = name.find(':');
  const std::string_view base = name.substr(0, colon);
  std::optional<size_t> triangles;
  if (colon != std::string_view::npos) {
    const std::string text(name.substr(colon + 1));
    uint64_t number = 0;
    if (!absl::SimpleAtoi(text, &number) || number == 0 || number > 100'000'000) {
      return absl::InvalidArgumentError(absl::StrFormat(
          "scene \"%s\": \"%s\" is no number of triangles between 1 and 100000000", name, text));
    }
    triangles = number;
  }
  if (base == "plaza") return MakePlaza(triangles.value_or(kPaperTriangles));
  if (base == "hall") return MakeHall(triangles.value_or(400'000));
  if (base == "city") return MakeCity(triangles.value_or(200'000));
  if (base == "warehouse") return MakeWarehouse(triangles.value_or(100'000));
  if (base == "random") return MakeRandomTriangles(triangles.value_or(100'000), 1);
  if (base == "terrain") {
    const double cells = std::sqrt(static_cast<double>(triangles.value_or(500'000)) / 2.0);
    return MakeTerrain(std::max(1, static_cast<int>(cells)), 1);
  }
  if (base == "hairball") return MakeHairBall((triangles.value_or(800'000) + 15) / 16, 0.1f, 1);
  if (base == "dueling") return MakeDuelingFrusta().scene;
  return absl::NotFoundError(absl::StrFormat("scene \"%s\": no generated scene has this name", base));
}

std::optional<StandPoint> ProceduralStandPoint(std::string_view scene_name) {
  if (scene_name == "plaza") return PlazaStandPoint();
  if (scene_name == "hall") return HallStandPoint();
  if (scene_name == "city") return CityStandPoint();
  if (scene_name == "warehouse") return WarehouseStandPoint();
  if (scene_name == "dueling") return MakeDuelingFrusta().stand_point;
  return std::nullopt;
}

}  // namespace shadowfit
