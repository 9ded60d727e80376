#pragma once

#include <cstdint>
#include <functional>
#include <glm/glm.hpp>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/fit/options.h"
#include "core/math/light.h"
#include "core/math/shadow_projection.h"
#include "core/reference/artefacts.h"
#include "core/reference/study_setup.h"
#include "core/scene/scene.h"

namespace shadowfit {

/// A way of making light matrices that takes part in a comparison.
struct MethodVariant {
  std::string name;  ///< As in tables; unique in a comparison.
  Options options;
  MapSize map_size;
};

struct LightSet {
  LightPlacement placement = LightPlacement::kNear;
  int count = 500;
};

/// TR-07-07, section 3: its sizes are the defaults.
struct ComparisonOptions {
  std::vector<LightSet> sets = {LightSet{}};
  uint64_t seed = 1;
  std::vector<MethodVariant> methods;
  MapSize screen{750, 750};
  MapSize samples{180, 180};
  ViewOptions view;
  /// 0: one view, the scene's own or `stand_point`. Otherwise so many seeded stand points, which take the
  /// lights in turn.
  int views = 0;
  std::optional<StandPoint> stand_point;
  /// Count artefacts for the first so many lights of each set: they take about three times as long again.
  int artefact_lights = 10;
  /// Above 0: bound how far each of the default method's single maps is from the best one, to this tolerance
  /// (core/fit/certify.h), giving up after so many seconds.
  double certify_tolerance = 0.0;
  double certify_seconds = 60.0;
  /// Measure what frames of several lights cost, in the first view with the first set's lights.
  bool frame_times = false;
  /// Results are kept here light by light, and read back by the next run; empty keeps nothing.
  std::string folder;
};

/// Pixels of the screen that a renderer gets wrong with a method's map, and why.
struct ArtefactRecord {
  ArtefactCounts counts;  ///< With 24 bits of depth and the safe bias of the small depth buffer.
  int flicker = 0;        ///< Whose answer changes, depth errors aside, when the camera turns by a degree.
};

/// How far one light's single map is from the best one by the `edge` metric: between least_gap and most_gap,
/// as shares of the best one's.
struct CertificateRecord {
  double tolerance = 0.0;  ///< That was asked for.
  double time_limit = 0.0;
  bool complete = false;  ///< The best one is known to the tolerance.
  double least_gap = 0.0;
  double most_gap = 0.0;  ///< 0 where incomplete and nothing is known.
  double seconds = 0.0;
};

/// One method's answer for one light.
struct MethodRecord {
  int wrong_pixels = 0;
  double predicted_pixels = 0.0;
  double milliseconds = 0.0;  ///< Processor time from decoded frame to matrix, median of three.
  int boundary_samples = 0;
  int evaluations = 0;
  std::string note;  ///< A fallback's reason, or "failed: ..."; then the count is that of no map at all.
  std::optional<ArtefactRecord> artefacts;
  std::optional<CertificateRecord> certificate;  ///< Where asked for, and the default method made one map.
};

struct LightRecord {
  LightPlacement placement = LightPlacement::kNear;
  int index = 0;  ///< In its set.
  int view = 0;
  Light light;
  int concerned_pixels = 0;
  int shadowed_pixels = 0;
  std::vector<MethodRecord> methods;  ///< In the order of ComparisonOptions::methods.
};

/// TR-07-07's Tables 2 and 3, for the optimizer: what a frame costs with so many lights on maps of a size.
struct FrameTime {
  int lights = 1;
  MapSize map_size;
  /// In the order of ComparisonOptions::methods; milliseconds on one thread, fastest of nine.
  struct Stages {
    double sampling = 0.0;  ///< Unprojection, boundary and hull samples, for all lights at once.
    double total = 0.0;     ///< From decoded frame to all matrices.
  };
  std::vector<Stages> methods;
};

struct Comparison {
  std::string scene;
  size_t triangles = 0;
  ComparisonOptions options;             ///< view.far and stand points resolved.
  std::vector<StandPoint> stand_points;  ///< By LightRecord::view.
  std::vector<LightRecord> lights;       ///< Set by set.
  std::vector<FrameTime> times;          ///< Where ComparisonOptions::frame_times asks for them.
};

/// Called after each light with the number done and the number of all.
using ComparisonProgress = std::function<void(int done, int total)>;

/// Every method's wrong pixels against Embree truth, for every light. Matrices are made on the calling
/// thread, one light at a time, so that times are those of one thread; rays use all cores. InvalidArgument
/// for options that mean nothing; FailedPrecondition where `folder` holds another comparison's results.
absl::StatusOr<Comparison> RunComparison(const Scene& scene, const ComparisonOptions& options,
                                         const ComparisonProgress& progress);

}  // namespace shadowfit
