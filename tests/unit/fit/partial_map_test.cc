#include "core/fit/partial_map.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "core/fit/frame_optimizer.h"
#include "tests/support/analytic_scene.h"

namespace shadowfit {
namespace {

using testing::OwnedFrame;
using testing::Uniform;

LightSummary Optimize(const FrameRequest& request, Method method, bool free_aspect = false) {
  Options options;
  options.method = method;
  options.standard.divide_where_needed = false;
  options.standard.free_aspect = free_aspect;
  FrameSummary summary;
  const absl::Status status = FrameOptimizer().Optimize(request, options, Cancellation(), &summary);
  EXPECT_TRUE(status.ok()) << status;
  return summary.lights[0];
}

// A lamp among the spheres, beside the viewer: there is shadow all around it.
TEST(PartialMap, IsPredictedNoWorseThanAnyBaselineNorWithAFreeAspect) {
  std::mt19937 random(8);
  int partial = 0;
  int better = 0;
  for (int trial = 0; trial < 150; ++trial) {
    LightRequest light;
    light.light = PointLight{{Uniform(random, -2, 2), Uniform(random, -3, 3), Uniform(random, 0.3, 1.5)}};
    light.map_size = {64, 64};
    OwnedFrame frame =
        testing::Draw(testing::RandomSpheres(random, 20),
                      testing::WalkThroughCamera(random, static_cast<ClipDepth>(trial % 3)), 64, 64, {light});
    frame.request.screen = {128, 128};
    const LightSummary fit = Optimize(frame.request, Method::kDefault);
    if (fit.outcome != FitOutcome::kFallback || fit.sample_source != SampleSource::kShadowBoundary) continue;
    ++partial;
    EXPECT_FALSE(fit.note.empty());
    EXPECT_TRUE(fit.further_maps.empty());
    double least = 1e300;
    for (const Method method :
         {Method::kNormal, Method::kFocused, Method::kLispsm, Method::kPlaneOptimal, Method::kPaper}) {
      least = std::min(least, Optimize(frame.request, method).predicted_misclassified_pixels);
    }
    EXPECT_LE(fit.predicted_misclassified_pixels, least * (1.0 + 1e-9)) << "trial " << trial;
    better += fit.predicted_misclassified_pixels < 0.95 * least;
    EXPECT_LE(Optimize(frame.request, Method::kDefault, true).predicted_misclassified_pixels,
              fit.predicted_misclassified_pixels * (1.0 + 1e-9))
        << "trial " << trial;
  }
  EXPECT_GT(partial, 20);
  EXPECT_GT(better, partial / 4);
}

}  // namespace
}  // namespace shadowfit
