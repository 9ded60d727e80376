#pragma once

#include <cstddef>
#include <functional>
#include <glm/glm.hpp>
#include <vector>

#include "core/scene/scene.h"

namespace shadowfit {

/// Solids made of curved patches, each a map of the unit square, that are cut into triangles only once the
/// number of triangles is known. Lengths in metres, Z up. Shapes are closed where nothing else is said.
class Patches {
 public:
  using Surface = std::function<glm::dvec3(double u, double v)>;

  /// A right-handed frame: origin and three orthogonal axes.
  struct Frame {
    glm::dvec3 origin{0.0};
    glm::dvec3 x{1.0, 0.0, 0.0};
    glm::dvec3 y{0.0, 1.0, 0.0};
    glm::dvec3 z{0.0, 0.0, 1.0};
    glm::dvec3 At(double a, double b, double c) const { return origin + a * x + b * y + c * z; }
  };
  /// Turned about the vertical by `turn` radians.
  static Frame Standing(const glm::dvec3& origin, double turn = 0.0);

  /// Shapes are added with this material and detail from now on. Detail multiplies the density of triangles
  /// along both sides of a patch.
  void SetMaterial(int material) { material_ = material; }
  void SetDetail(double detail) { detail_ = detail; }

  /// `length_u` and `length_v` are the patch's extents in metres, which its cells follow; it has at least
  /// `least_u` x `least_v` cells.
  void AddPatch(double length_u, double length_v, int least_u, int least_v, Surface surface);

  void AddQuad(const glm::dvec3& corner, const glm::dvec3& u, const glm::dvec3& v);
  /// The box [-size.x/2, size.x/2] x [-size.y/2, size.y/2] x [0, size.z] of the frame.
  void AddBox(const Frame& frame, const glm::dvec3& size);
  void AddSphere(const glm::dvec3& center, double radius);
  /// A tapered rod with flat ends.
  void AddRod(const glm::dvec3& from, const glm::dvec3& to, double from_radius, double to_radius);
  /// Around the frame's z axis.
  void AddTorus(const Frame& frame, double ring_radius, double tube_radius);
  /// A half ring of rectangular section standing on the frame's x axis: spans 2 * inner_radius, `thickness`
  /// in the ring's plane, `depth` along y.
  void AddArch(const Frame& frame, double inner_radius, double thickness, double depth);

  /// Triangles with every patch at its coarsest.
  size_t LeastTriangles() const;
  /// Adds the patches to the scene as one mesh a material, as finely as at most `triangles` triangles allow;
  /// returns their number.
  size_t Tessellate(size_t triangles, Scene* scene) const;

 private:
  struct Patch {
    double cells_u = 0.0;  ///< Cells at density 1.
    double cells_v = 0.0;
    int least_u = 1;
    int least_v = 1;
    int material = 0;
    Surface surface;

    int CountU(double density) const;
    int CountV(double density) const;
  };

  size_t Triangles(double density) const;

  std::vector<Patch> patches_;
  int material_ = 0;
  double detail_ = 1.0;
};

}  // namespace shadowfit
