#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <optional>
#include <string_view>

#include "absl/status/statusor.h"
#include "core/scene/scene.h"

namespace shadowfit {

// Generated scenes: metres, Z up, the floor at z = 0 around the origin. The same arguments give the same
// scene everywhere.

/// Triangles of the scene of TR-07-07.
inline constexpr size_t kPaperTriangles = 1'137'772;

/// Where a walk through a generated scene might stand.
struct StandPoint {
  glm::dvec3 ws_eye{0.0};
  glm::dvec3 ws_target{0.0};
};

/// "A few dozen objects on or near a floor": a square of 60 m with a colonnade, arches, stairs, a stepped
/// pyramid, railings, thin poles, benches, spheres, boxes, a fountain and trees whose leaves are single
/// triangles. Has exactly `triangles` triangles; the leaves are a quarter of them. `seed` moves the loose
/// objects. InvalidArgument below the few thousand triangles that the shapes need.
absl::StatusOr<Scene> MakePlaza(size_t triangles = kPaperTriangles, uint64_t seed = 1);
StandPoint PlazaStandPoint();

/// An enclosed arcade of 30 x 16 x 8 m: walls with windows, vaulted aisles behind columns, a ceiling with a
/// long skylight, tables, chairs, shelves and chandeliers. At most `triangles` triangles, within a few per
/// cent of them. InvalidArgument below the few thousand that the shapes need.
absl::StatusOr<Scene> MakeHall(size_t triangles = 400'000, uint64_t seed = 1);
StandPoint HallStandPoint();

/// Streets 34 m apart between towers of 6 to 60 m, over 600 m, with street lamps and cars: shadows that reach
/// far beyond what a walker sees of them. At most `triangles` triangles. InvalidArgument below the tens of
/// thousands that the shapes need.
absl::StatusOr<Scene> MakeCity(size_t triangles = 200'000, uint64_t seed = 1);
StandPoint CityStandPoint();

/// A closed hall of 80 x 120 x 9 m with rows of shelves full of boxes: lamps inside it graze boards and the
/// sides of boxes. At most `triangles` triangles. InvalidArgument below the tens of thousands that the shapes
/// need.
absl::StatusOr<Scene> MakeWarehouse(size_t triangles = 100'000, uint64_t seed = 1);
StandPoint WarehouseStandPoint();

/// `triangles` random triangles of 40 square metres in all, in the box [-5,5]^2 x [0.5,5] above a floor of
/// two more. triangles >= 1.
Scene MakeRandomTriangles(size_t triangles, uint64_t seed);

/// A connected height field of fractal noise over [-50,50]^2 with `cells` x `cells` squares of two triangles,
/// hills of some 8 m. cells >= 1.
Scene MakeTerrain(int cells, uint64_t seed);

/// A ball of radius 2 m, 2.5 m above a floor, of curved hairs, each a chain of thin ribbons; 16 triangles a
/// hair. `opacity` in (0,1] of every hair. hairs >= 1.
Scene MakeHairBall(size_t hairs, float opacity, uint64_t seed);

/// The configuration that warps cannot serve: the light, low above the floor, shines towards a viewer who
/// looks towards it, past rows of posts between the two.
struct DuelingFrusta {
  Scene scene;
  StandPoint stand_point;
  glm::dvec3 ws_light{0.0};
};
DuelingFrusta MakeDuelingFrusta();

/// A generated scene by name: "plaza", "hall", "city", "warehouse", "random", "terrain", "hairball" or
/// "dueling", with ":TRIANGLES" behind the name for another size than the usual one. NotFound for other
/// names, InvalidArgument for a size that is no number or does not suit.
absl::StatusOr<Scene> MakeProceduralScene(std::string_view name);

/// The stand point that belongs to a scene made by MakeProceduralScene, by Scene::name; none where the scene
/// prescribes none.
std::optional<StandPoint> ProceduralStandPoint(std::string_view scene_name);

}  // namespace shadowfit
