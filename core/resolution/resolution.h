#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "core/cancellation.h"
#include "core/frame/camera.h"
#include "core/frame/images.h"
#include "core/math/light.h"
#include "core/math/shadow_projection.h"

/// How large a shadow map must be. After "Resolution Estimation for Shadow Mapping", sections 3.1 and 3.2:
/// every visible pixel is a patch of the scene, with bilinearly interpolated depth at its four corners.
/// Projected into the light's picture, the patches' bounds are the tight light frustum, and the smallest
/// width and height of a patch's bounding box are how large a texel may be.
namespace shadowfit {

inline constexpr int kMaxResolution = 65536;
inline constexpr int kMaxDepthBufferSide = 16384;

struct ResolutionOptions {
  /// No side of a map is recommended larger, rounding included. From 1 to kMaxResolution, and at least 8 with
  /// kMultipleOf8.
  int max_size = 4096;
  SizeRounding rounding = SizeRounding::kExact;
  /// Share of the visible pixels, per axis, whose patch is to get a whole texel, in (0, 100]. 100 is the
  /// paper's minimum, which a single outlier rules. Below 100 the answer is rounded up to the next bin of the
  /// histogram, at most 3.2 %.
  double percentile = 100.0;
  /// Report how many texels each pixel would need.
  bool histogram = false;
};

/// InvalidArgument where an option is out of range; the message begins with the member.
absl::Status Validate(const ResolutionOptions& options);

struct ResolutionLight {
  uint32_t id = 0;  ///< Unique in a request.
  Light light;
  /// A world-to-clip matrix of this light (errors call it previous_world_to_shadow_clip), to be judged as it
  /// is (only its depth row does not matter). None: the light's ordinary projection: a spot's square frustum,
  /// a directional light's orthographic one, six faces of a cube around a point light, all with their axes
  /// turned towards the camera's.
  std::optional<glm::dmat4> clip_from_world;
};

struct ResolutionRequest {
  CameraMatrices camera;
  DepthView depth;  ///< Borrowed; at most kMaxDepthBufferSide a side. At the picture's own resolution for an
                    ///< exact answer.
  MapSize screen;   ///< Of the final picture. Zero: that of the depth buffer.
  std::vector<ResolutionLight> lights;
  ClipDepth output_clip_depth = ClipDepth::kNegativeOneToOne;  ///< Of MapEstimate::clip_from_world.
};

/// Pixels whose patch needs at most `texels` along one axis of the map, and more than the bin before.
struct ResolutionBin {
  double texels = 0.0;
  int64_t pixels = 0;
};

/// One shadow map's tight frustum and needed resolution.
struct MapEstimate {
  /// Visible pixels inside the light's volume, to within rounding at its edge. 0: the light reaches nothing
  /// visible, and the other members say so with a map of least size over the whole volume.
  int64_t pixels = 0;
  /// The tight frustum, which holds every visible point inside the volume and its patch, in the clip
  /// coordinates x/w, y/w of the judged projection, within [-1,1]; for the ordinary projection of a
  /// directional light in world units.
  glm::dvec2 crop_min{-1.0};
  glm::dvec2 crop_max{1.0};
  glm::dvec2 smallest_patch{0.0};  ///< Least width and least height of a patch, in the same coordinates.
  /// Width and height that satisfy the percentile, before limit and rounding. Finite: at most kNeedCeiling.
  /// Exact within the limit to kTexelTolerance; beyond it, short of the truth by no more than kNeedTolerance.
  glm::dvec2 needed{0.0};
  MapSize recommended;   ///< `needed`, limited and rounded.
  bool limited = false;  ///< The limit took something away.
  /// The cropped map of the recommended size, and the depths that its visible receivers span.
  ShadowProjection projection;
  DepthRange depth_range;
  glm::dmat4 clip_from_world{1.0};  ///< The same as a matrix, in the request's output convention.
  /// Needed texels along x and y, by increasing need; empty unless asked for.
  std::vector<ResolutionBin> histogram_x;
  std::vector<ResolutionBin> histogram_y;
};

inline constexpr double kNeedCeiling = 1e12;
inline constexpr double kNeedTolerance = 1e-3;  ///< Relative.

struct LightEstimate {
  uint32_t id = 0;
  /// One map; six faces for a point light without a matrix: ahead, behind, right, left, above and below as
  /// the camera looks.
  std::vector<MapEstimate> maps;
  /// Size of the light's map; for a set of faces, the size that serves each of them.
  MapSize recommended;
};

struct ResolutionSummary {
  std::vector<LightEstimate> lights;  ///< In the order of the request.
  double seconds = 0.0;
  int tiles = 0;          ///< Pieces of the picture times maps.
  int settled_tiles = 0;  ///< Of these, how many were computed in double precision.
  /// Pixels that were projected one by one, as a share of the picture's times maps. Of the others, what they
  /// have in common with their neighbours tells enough.
  double visited_share = 0.0;
};

/// Keeps its working memory between calls: use one estimator a stream, from one thread at a time. The
/// recommended sizes are exact, as if all arithmetic were in double precision: float is used where, by a
/// bound on its error, it cannot change them.
class ResolutionEstimator {
 public:
  ResolutionEstimator();
  ~ResolutionEstimator();
  ResolutionEstimator(ResolutionEstimator&&) noexcept;
  ResolutionEstimator& operator=(ResolutionEstimator&&) noexcept;

  /// InvalidArgument where the request or an option is malformed; the message begins with the field, as
  /// "lights[2].spot.direction: zero-length vector". Cancelled or DeadlineExceeded where `cancellation` asks
  /// for it.
  absl::Status Estimate(const ResolutionRequest& request, const ResolutionOptions& options,
                        const Cancellation& cancellation, ResolutionSummary* summary);

 private:
  struct Workspace;
  class Settler;

  /// Settles what the tiles of one map left open.
  MapEstimate EstimateMap(const ResolutionRequest& request, const ResolutionOptions& options,
                          const RaySpace& ray_space, int map, const Cancellation& cancellation);

  std::unique_ptr<Workspace> workspace_;
};

/// `needed` texels rounded up as asked, at most `max_size`. A need that exceeds a whole number by less than
/// kTexelTolerance is that number: a picture that fits texel for texel must not grow by rounding errors.
int RoundedSize(double needed, SizeRounding rounding, int max_size);

inline constexpr double kTexelTolerance = 1.0 / 64.0;

}  // namespace shadowfit
