#include "core/scene/patches.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace shadowfit {
namespace {

constexpr double kPi = std::numbers::pi;

/// The unit square [-1,1]^2 onto the unit disc, without the degenerate centre of polar coordinates (Shirley,
/// Chiu 1997).
glm::dvec2 DiscFromSquare(double a, double b) {
  if (a == 0.0 && b == 0.0) return {0.0, 0.0};
  if (std::abs(a) > std::abs(b)) {
    const double phi = 0.25 * kPi * b / a;
    return a * glm::dvec2(std::cos(phi), std::sin(phi));
  }
  const double phi = 0.5 * kPi - 0.25 * kPi * a / b;
  return b * glm::dvec2(std::cos(phi), std::sin(phi));
}

/// A right-handed frame around the unit vector z.
Patches::Frame FrameAlong(const glm::dvec3& origin, const glm::dvec3& z) {
  const glm::dvec3 helper = std::abs(z.z) < 0.9 ? glm::dvec3(0, 0, 1) : glm::dvec3(1, 0, 0);
  const glm::dvec3 x = glm::normalize(glm::cross(helper, z));
  return {origin, x, glm::cross(z, x), z};
}

}  // namespace

Patches::Frame Patches::Standing(const glm::dvec3& origin, double turn) {
  const double c = std::cos(turn);
  const double s = std::sin(turn);
  return {origin, {c, s, 0.0}, {-s, c, 0.0}, {0.0, 0.0, 1.0}};
}

void Patches::AddPatch(double length_u, double length_v, int least_u, int least_v, Surface surface) {
  patches_.push_back(
      {detail_ * length_u, detail_ * length_v, least_u, least_v, material_, std::move(surface)});
}

void Patches::AddQuad(const glm::dvec3& corner, const glm::dvec3& u, const glm::dvec3& v) {
  AddPatch(glm::length(u), glm::length(v), 1, 1, [=](double a, double b) { return corner + a * u + b * v; });
}

void Patches::AddBox(const Frame& frame, const glm::dvec3& size) {
  const glm::dvec3 x = size.x * frame.x;
  const glm::dvec3 y = size.y * frame.y;
  const glm::dvec3 z = size.z * frame.z;
  const glm::dvec3 low = frame.origin - 0.5 * x - 0.5 * y;
  const glm::dvec3 high = low + x + y + z;
  AddQuad(low, y, x);
  AddQuad(low, x, z);
  AddQuad(low, z, y);
  AddQuad(high, -x, -y);
  AddQuad(high, -z, -x);
  AddQuad(high, -y, -z);
}

void Patches::AddSphere(const glm::dvec3& center, double radius) {
  // A cube blown up: no poles, where longitude and latitude would pile up slivers.
  const double side = 0.5 * kPi * radius;
  for (int axis = 0; axis < 3; ++axis) {
    for (const double sign : {-1.0, 1.0}) {
      AddPatch(side, side, 2, 2, [=](double u, double v) {
        glm::dvec3 p;
        p[axis] = sign;
        p[(axis + 1) % 3] = sign * std::tan(0.25 * kPi * (2.0 * u - 1.0));
        p[(axis + 2) % 3] = std::tan(0.25 * kPi * (2.0 * v - 1.0));
        return center + radius * glm::normalize(p);
      });
    }
  }
}

void Patches::AddRod(const glm::dvec3& from, const glm::dvec3& to, double from_radius, double to_radius) {
  const double length = glm::length(to - from);
  const Frame frame = FrameAlong(from, (to - from) / length);
  const double around = 2.0 * kPi * std::max(from_radius, to_radius);
  AddPatch(around, length, 6, 1, [=](double u, double v) {
    // u = 1 takes the same vertex as u = 0, which closes the seam to the last bit.
    const double angle = u < 1.0 ? 2.0 * kPi * u : 0.0;
    const double radius = from_radius + v * (to_radius - from_radius);
    return frame.At(radius * std::cos(angle), radius * std::sin(angle), v * length);
  });
  for (const auto& [radius, height, sign] :
       {std::tuple(from_radius, 0.0, -1.0), std::tuple(to_radius, length, 1.0)}) {
    if (radius == 0.0) continue;
    AddPatch(2.0 * radius, 2.0 * radius, 2, 2,
             [=, radius = radius, height = height, sign = sign](double u, double v) {
               const glm::dvec2 p = radius * DiscFromSquare(sign * (2.0 * u - 1.0), 2.0 * v - 1.0);
               return frame.At(p.x, p.y, height);
             });
  }
}

void Patches::AddTorus(const Frame& frame, double ring_radius, double tube_radius) {
  AddPatch(2.0 * kPi * ring_radius, 2.0 * kPi * tube_radius, 8, 5, [=](double u, double v) {
    const double a = u < 1.0 ? 2.0 * kPi * u : 0.0;
    const double b = v < 1.0 ? 2.0 * kPi * v : 0.0;
    const double radius = ring_radius + tube_radius * std::cos(b);
    return frame.At(radius * std::cos(a), radius * std::sin(a), tube_radius * std::sin(b));
  });
}

void Patches::AddArch(const Frame& frame, double inner_radius, double thickness, double depth) {
  const double outer_radius = inner_radius + thickness;
  const auto at = [=](double radius, double u, double y) {
    return frame.At(-radius * std::cos(kPi * u), y, radius * std::sin(kPi * u));
  };
  const double half = 0.5 * depth;
  AddPatch(kPi * outer_radius, depth, 8, 1,
           [=](double u, double v) { return at(outer_radius, u, v * depth - half); });
  AddPatch(kPi * inner_radius, depth, 8, 1,
           [=](double u, double v) { return at(inner_radius, u, half - v * depth); });
  for (const double sign : {-1.0, 1.0}) {
    AddPatch(kPi * outer_radius, thickness, 8, 1, [=](double u, double v) {
      const double radius = sign < 0.0 ? inner_radius + v * thickness : outer_radius - v * thickness;
      return at(radius, u, sign * half);
    });
    const double u_end = sign < 0.0 ? 0.0 : 1.0;
    AddPatch(thickness, depth, 1, 1, [=](double u, double v) {
      return at(inner_radius + u * thickness, u_end, -sign * (v * depth - half));
    });
  }
}

int Patches::Patch::CountU(double density) const {
  return std::max(least_u, static_cast<int>(std::floor(cells_u * density)));
}

int Patches::Patch::CountV(double density) const {
  return std::max(least_v, static_cast<int>(std::floor(cells_v * density)));
}

size_t Patches::Triangles(double density) const {
  size_t count = 0;
  for (const Patch& patch : patches_) {
    count += 2 * static_cast<size_t>(patch.CountU(density)) * static_cast<size_t>(patch.CountV(density));
  }
  return count;
}

size_t Patches::LeastTriangles() const { return Triangles(0.0); }

size_t Patches::Tessellate(size_t triangles, Scene* scene) const {
  // The largest density that the budget allows, in cells a metre.
  double low = 0.0;
  double high = 1.0;
  while (high < 1e6 && Triangles(high) <= triangles) high *= 2.0;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (Triangles(middle) <= triangles ? low : high) = middle;
  }

  std::vector<int> mesh_of_material(scene->materials.size(), -1);
  size_t count = 0;
  for (const Patch& patch : patches_) {
    int& mesh_index = mesh_of_material[static_cast<size_t>(patch.material)];
    if (mesh_index < 0) {
      mesh_index = static_cast<int>(scene->meshes.size());
      scene->meshes.emplace_back().material = patch.material;
      scene->instances.push_back({.mesh = mesh_index});
    }
    Mesh& mesh = scene->meshes[static_cast<size_t>(mesh_index)];
    const int count_u = patch.CountU(low);
    const int count_v = patch.CountV(low);
    const auto base = static_cast<uint32_t>(mesh.positions.size());
    for (int j = 0; j <= count_v; ++j) {
      for (int i = 0; i <= count_u; ++i) {
        mesh.positions.emplace_back(patch.surface(double(i) / count_u, double(j) / count_v));
      }
    }
    const auto row = static_cast<uint32_t>(count_u) + 1;
    for (uint32_t j = 0; j < static_cast<uint32_t>(count_v); ++j) {
      for (uint32_t i = 0; i < static_cast<uint32_t>(count_u); ++i) {
        const uint32_t a = base + j * row + i;
        mesh.triangles.emplace_back(a, a + 1, a + row + 1);
        mesh.triangles.emplace_back(a, a + row + 1, a + row);
      }
    }
    count += 2 * static_cast<size_t>(count_u) * static_cast<size_t>(count_v);
  }
  return count;
}

}  // namespace shadowfit
