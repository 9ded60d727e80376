#include "client/compare/certificate_study.h"

#include <utility>
#include <vector>

#include "core/fit/certify.h"
#include "core/fit/ray_hull.h"
#include "core/fit/single_map_fit.h"
#include "core/fit/whitened_samples.h"
#include "core/frame/frame_sampler.h"

namespace shadowfit {

std::optional<CertificateRecord> CertifyFit(const ViewStudy& view, const LightStudy& light,
                                            const FrameRequest& request, const DefaultOptions& options,
                                            const LightSummary& fit, double tolerance, double time_limit) {
  if (!fit.further_maps.empty()) return std::nullopt;
  FrameSampler sampler;
  FrameExtent extent;
  std::vector<LightSamples> samples;
  sampler.Sample(view.camera, request.depth, request.bits, {&light.ray_space, 1}, request.screen, &extent,
                 &samples);
  LightProblem problem;
  problem.camera = &view.camera;
  problem.light = &light.light;
  problem.ray_space = &light.ray_space;
  problem.samples = samples.data();
  problem.map_size = request.lights[0].map_size;
  problem.ws_scene_bounds = *request.ws_scene_bounds;
  const RayHull hull = MakeFitHull(problem);
  if (!hull.complete) return std::nullopt;
  const WhitenedSamples whitened = Whiten(problem, hull);
  const ShadowProjection projection = FitSingleMap(problem, options).projection;
  const std::optional<TexelGrid> grid =
      GridOf(projection.texel_from_ray * glm::inverse(whitened.whitened_from_ray));
  if (!grid) return std::nullopt;
  const WhitenedSamples tangent = TangentAt(whitened, *grid);
  const Certificate certificate = Certify(tangent, problem.map_size, options.free_aspect, projection,
                                          {tolerance, time_limit}, Cancellation());
  return CertificateRecord{
      tolerance,          time_limit, certificate.complete, certificate.LeastGap(), certificate.MostGap(),
      certificate.seconds};
}

}  // namespace shadowfit
