#include "core/fit/trim_shadow.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "absl/functional/function_ref.h"
#include "core/fit/metric.h"
#include "core/fit/prediction.h"
#include "core/fit/sample_parts.h"
#include "core/fit/single_map_fit.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/fit/trim_shadow.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/math/double_lanes-inl.h"

#ifndef SHADOWFIT_FIT_TRIM_SHADOW_ONCE
#define SHADOWFIT_FIT_TRIM_SHADOW_ONCE
namespace shadowfit {

/// From where to where hull samples' footprints reach on a map, as shares of its width (x) and height (y). Of
/// what is behind the map all are NaN.
struct Reaches {
  std::vector<float> low_x;
  std::vector<float> high_x;
  std::vector<float> low_y;
  std::vector<float> high_y;
};

}  // namespace shadowfit
#endif

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

/// Of at least a vector of samples.
void FindReaches(const LightSamples& samples, const ShadowProjection& map, Reaches* reaches) {
  const DoubleLanes d;
  const hn::Rebind<float, DoubleLanes> df;
  const size_t lanes = hn::Lanes(d);
  const size_t count = samples.hull_rays.size();
  const auto reach = hn::Set(d, LightSamples::kFootprintReach);
  const auto nothing = hn::Set(d, std::numeric_limits<double>::quiet_NaN());
  const auto one = hn::Set(d, 1.0);
  glm::dmat3 share_from_texel(1.0);
  share_from_texel[0][0] = 1.0 / map.size.width;
  share_from_texel[1][1] = 1.0 / map.size.height;
  const glm::dmat3 share_from_ray = share_from_texel * map.texel_from_ray;
  for (size_t next = 0; next < count; next += lanes) {
    // The last vector has some samples of the one before again.
    const size_t i = std::min(next, count - lanes);
    const auto mapped = [&](const std::vector<glm::dvec3>& rays) {
      return Times(share_from_ray, LoadPoints(&rays[i].x));
    };
    const Doubles3 h = mapped(samples.hull_rays);
    const Doubles3 d1 = Scaled(mapped(samples.hull_rays_dx1), reach);
    const Doubles3 d2 = Scaled(mapped(samples.hull_rays_dx2), reach);
    const Doubles3 corners[4] = {Minus(Minus(h, d1), d2), Plus(Minus(h, d1), d2), Minus(Plus(h, d1), d2),
                                 Plus(Plus(h, d1), d2)};
    auto in_front = hn::Gt(h.z, hn::Zero(d));
    const auto per_w = [&](const Doubles3& v) { return hn::Div(one, v.z); };
    const Doubles inverse_w = per_w(h);
    const Doubles x = hn::Mul(h.x, inverse_w);
    const Doubles y = hn::Mul(h.y, inverse_w);
    Doubles low_x = x;
    Doubles high_x = x;
    Doubles low_y = y;
    Doubles high_y = y;
    for (const Doubles3& corner : corners) {
      in_front = hn::And(in_front, hn::Gt(corner.z, hn::Zero(d)));
      const Doubles corner_inverse_w = per_w(corner);
      const Doubles corner_x = hn::Mul(corner.x, corner_inverse_w);
      const Doubles corner_y = hn::Mul(corner.y, corner_inverse_w);
      low_x = hn::Min(low_x, corner_x);
      high_x = hn::Max(high_x, corner_x);
      low_y = hn::Min(low_y, corner_y);
      high_y = hn::Max(high_y, corner_y);
    }
    const auto store = [&](Doubles v, std::vector<float>* to) {
      hn::StoreU(hn::DemoteTo(df, hn::IfThenElse(in_front, v, nothing)), df, to->data() + i);
    };
    store(low_x, &reaches->low_x);
    store(high_x, &reaches->high_x);
    store(low_y, &reaches->low_y);
    store(high_y, &reaches->high_y);
  }
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {
namespace {

HWY_EXPORT(FindReaches);

/// A cut that is worth a change of all texels, as a share of the pixels that are predicted to be wrong.
constexpr double kLeastTrimGain = 0.005;

/// Cuts of one map; each takes a fit.
constexpr int kMostCuts = 4;

/// The share of a map that a cut may take, and the bins of places by which it is chosen.
constexpr float kWidestCut = 0.5f;
constexpr size_t kBins = 48;

/// Fewer samples than this are all needed; at least the lanes of a vector.
constexpr size_t kFewest = 32;

/// Edges that a cut and the fit after it are chosen by; whether they are better is asked of all.
constexpr size_t kMostEdgeSamples = 1024;

/// A side of a map moved inwards.
struct Cut {
  bool along_x = true;  ///< The side bounds x; y otherwise.
  bool from_low = true;
  float share = 0.0f;  ///< Of the map's width or height.
  double gain = 0.0;   ///< Pixels, roughly.
};

/// The map that a cut leaves.
ShadowProjection Apply(const Cut& cut, const ShadowProjection& map) {
  const glm::length_t axis = cut.along_x ? 0 : 1;
  const double length = cut.along_x ? map.size.width : map.size.height;
  const double scale = 1.0 / (1.0 - static_cast<double>(cut.share));
  glm::dmat3 cut_from_texel(1.0);
  cut_from_texel[axis][axis] = scale;
  if (cut.from_low) cut_from_texel[2][axis] = -scale * static_cast<double>(cut.share) * length;
  return {cut_from_texel * map.texel_from_ray, map.size};
}

/// One map and the samples that it has.
class Trimmer {
 public:
  Trimmer(const LightProblem& problem, const DefaultOptions& options, std::span<ShadowProjection> maps,
          size_t which)
      : problem_(problem),
        options_(options),
        maps_(maps),
        map_(maps[which]),
        requested_size_(problem.map_size),
        samples_(problem.samples),
        stays_(problem.samples->hull_in_shadow) {
    // The map as it is has the valley; a cut moves its floor.
    options_.most_maps = 1;
    options_.keep_within = 0.0;
    options_.glance_samples = 0;
    options_.search_directions = 2;
    options_.starts = 1;
    options_.descents = 1;
    options_.evaluations_to_polish = 10;
    if (maps_.size() == 1) return;
    for (const ShadowProjection& map : maps_) {
      if (&map != &map_) others_.push_back(map);
    }
    const double aspect = static_cast<double>(problem_.map_size.width) / problem_.map_size.height;
    requested_size_ = SizeOfTexels(map_.size.texels(), aspect);
    KeepSamples([&](const glm::dvec3& ray) {
      const auto holds = [&](const ShadowProjection& map) { return map.Holds(ray); };
      return map_.Holds(ray) &&
             std::none_of(maps.begin(), maps.begin() + static_cast<std::ptrdiff_t>(which), holds);
    });
  }

  /// Returns what the maps are predicted to get wrong, which is `predicted` before.
  PredictedPixels Trim(PredictedPixels predicted) {
    // What earlier maps hold this one need not, nor what it does not hold.
    if (maps_.size() > 1 || !HoldShadow(*samples_, maps_)) FitToWhatIsLeft(&FitSingleMap, &predicted);
    for (int cuts = 0; cuts < kMostCuts && samples_->hull_rays.size() >= kFewest; ++cuts) {
      if (IsCancelled(problem_.cancellation)) break;
      const std::array<Cut, 4> best = BestCuts();
      const bool made = std::any_of(best.begin(), best.end(), [&](const Cut& cut) {
        return cut.gain > kLeastTrimGain * predicted.Total() && Make(cut, &predicted);
      });
      if (!made) break;
      FitToWhatIsLeft(&RefitSingleMap, &predicted);
    }
    return predicted;
  }

  int evaluations() const { return evaluations_; }

 private:
  /// Of each side the best one, the best of all first.
  std::array<Cut, 4> BestCuts() {
    const size_t count = samples_->hull_rays.size();
    for (std::vector<float>* ends : {&reaches_.low_x, &reaches_.high_x, &reaches_.low_y, &reaches_.high_y}) {
      ends->resize(count);
    }
    HWY_DYNAMIC_DISPATCH(FindReaches)(*samples_, map_, &reaches_);
    edges_ = {};
    for (const BoundarySamples* boundary : samples_->Boundaries()) AppendEdges(*boundary, map_, &edges_);
    pixels_per_place_ = problem_.sampler->PlacesOfShadow(*problem_.camera, *problem_.ray_space,
                                                         problem_.light_in_frame, map_, others_, &shadow_);
    const std::array<Cut, 2> x = BestCutsAlong(true);
    const std::array<Cut, 2> y = BestCutsAlong(false);
    std::array<Cut, 4> cuts = {x[0], x[1], y[0], y[1]};
    std::sort(cuts.begin(), cuts.end(), [](const Cut& a, const Cut& b) { return a.gain > b.gain; });
    return cuts;
  }

  /// Of the low and of the high side. What a cut lets go of, for every place of it, is added up by bins.
  std::array<Cut, 2> BestCutsAlong(bool along_x) const {
    std::array<std::array<Bin, kBins>, 2> sides{};
    const std::vector<float>& low = along_x ? reaches_.low_x : reaches_.low_y;
    const std::vector<float>& high = along_x ? reaches_.high_x : reaches_.high_y;
    const auto lies = [&](size_t side, float share) -> Bin& {
      Bin& bin = sides[side][BinOf(share)];
      bin.nearest = std::min(bin.nearest, share);
      return bin;
    };
    for (size_t i = 0; i < low.size(); ++i) {
      if (stays_[i] == 0) continue;
      // What lies beyond the widest cut bounds none; most samples lie beyond that of one side. NaN, too.
      if (low[i] < kWidestCut) lies(0, low[i]);
      if (1.0f - high[i] < kWidestCut) lies(1, 1.0f - high[i]);
    }
    const LaneList<float>& shadow = along_x ? shadow_.x : shadow_.y;
    for (size_t i = 0; i < shadow.size(); ++i) {
      const float place = shadow[i];
      (place < 0.5f ? lies(0, place) : lies(1, 1.0f - place)).shadow += 1.0f;
    }
    const std::vector<float>& slopes = along_x ? edges_.per_width : edges_.per_height;
    const std::vector<float>& places = along_x ? edges_.x : edges_.y;
    float all_slopes = 0.0f;
    for (size_t i = 0; i < slopes.size(); ++i) {
      if (!IsOnMap(edges_.x[i]) || !IsOnMap(edges_.y[i])) continue;
      Bin& bin = places[i] < 0.5f ? sides[0][BinOf(places[i])] : sides[1][BinOf(1.0f - places[i])];
      bin.edge_pixels += edges_.pixels[i];
      bin.slopes += slopes[i];
      all_slopes += slopes[i];
    }
    return {BestCutOf(sides[0], all_slopes, {along_x, true}),
            BestCutOf(sides[1], all_slopes, {along_x, false})};
  }

  /// What lies at about one distance from a side.
  struct Bin {
    float nearest = kWidestCut;  ///< Of the footprints and of the shadow's places.
    float shadow = 0.0f;         ///< Places.
    float edge_pixels = 0.0f;
    float slopes = 0.0f;  ///< Of the edges' pixels along the logarithm of texels' width.
  };

  /// Four bins to each factor of two, the last for all from kWidestCut on: by the leading bits of a float.
  static size_t BinOf(float share) {
    constexpr int kShift = 21;  // Of a mantissa of 23 bits.
    const int last = std::bit_cast<int32_t>(kWidestCut) >> kShift;
    const int bin =
        static_cast<int>(kBins) - 1 - last + (std::bit_cast<int32_t>(std::max(share, 0.0f)) >> kShift);
    return static_cast<size_t>(std::clamp(bin, 0, static_cast<int>(kBins) - 1));
  }

  /// False for NaN.
  static bool IsOnMap(float share) { return share >= 0.0f && share <= 1.0f; }

  Cut BestCutOf(std::array<Bin, kBins> bins, float slopes, Cut best) const {
    // A side may move to what is nearest of all that stays.
    for (size_t k = kBins - 1; k > 0; --k) {
      bins[k - 1].nearest = std::min(bins[k - 1].nearest, bins[k].nearest);
    }
    const double unseen = UnseenFactor(*samples_);
    double saved = 0.0;
    for (const Bin& bin : bins) {
      // Lets go of what is in the bins before this one.
      const float share = bin.nearest;
      const double gain = saved + unseen * static_cast<double>(share * slopes);
      if (gain > best.gain) {
        best.gain = gain;
        best.share = share;
      }
      slopes -= bin.slopes;
      saved +=
          unseen * static_cast<double>(bin.edge_pixels) - pixels_per_place_ * static_cast<double>(bin.shadow);
    }
    return best;
  }

  /// Whether a cut is better; it then is made.
  bool Make(const Cut& cut, PredictedPixels* predicted) {
    const ShadowProjection uncut = map_;
    map_ = Apply(cut, uncut);
    const PredictedPixels now = PredictWrongPixels(problem_, maps_);
    if (!(now.Total() < (1.0 - kLeastTrimGain) * predicted->Total())) {
      map_ = uncut;
      return false;
    }
    *predicted = now;
    const std::vector<float>& low = cut.along_x ? reaches_.low_x : reaches_.low_y;
    const std::vector<float>& high = cut.along_x ? reaches_.high_x : reaches_.high_y;
    for (size_t i = 0; i < stays_.size(); ++i) {
      const float share = cut.from_low ? low[i] : 1.0f - high[i];
      if (!(share >= cut.share)) stays_[i] = 0;
    }
    return true;
  }

  /// A new map in the place of one whose sides were cut, where it is better.
  void FitToWhatIsLeft(SingleMapFit (*fit_map)(const LightProblem&, const DefaultOptions&),
                       PredictedPixels* predicted) {
    KeepSamples([&](const glm::dvec3& ray) { return map_.Holds(ray); });
    if (samples_->hull_rays.empty()) return;
    const ShadowProjection cut_map = map_;
    LightProblem problem = problem_;
    problem.samples = samples_;
    problem.hulls = nullptr;
    problem.previous = &cut_map;
    problem.map_size = options_.free_aspect ? requested_size_ : cut_map.size;
    const SingleMapFit fit = fit_map(problem, options_);
    evaluations_ += fit.evaluations;
    // Where no map is of use for what is left, a further cut may help, and the cut map leads there.
    if (!fit.usable) return;
    map_ = fit.projection;
    const PredictedPixels now = PredictWrongPixels(problem_, maps_);
    if (now.Total() < predicted->Total()) {
      *predicted = now;
    } else {
      map_ = cut_map;
    }
  }

  /// Leaves the samples whose ray is chosen, of the hull those that stay.
  void KeepSamples(absl::FunctionRef<bool(const glm::dvec3&)> chosen) {
    for (size_t i = 0; i < stays_.size(); ++i) {
      if (stays_[i] != 0 && !chosen(samples_->hull_rays[i])) stays_[i] = 0;
    }
    const size_t stride = (samples_->EdgeSamples() + kMostEdgeSamples - 1) / kMostEdgeSamples;
    LightSamples kept = SomeSamples(*samples_, std::max<size_t>(1, stride), chosen, stays_);
    own_samples_ = std::move(kept);
    samples_ = &own_samples_;
    stays_.assign(own_samples_.hull_rays.size(), 1);
  }

  const LightProblem& problem_;
  DefaultOptions options_;
  std::span<ShadowProjection> maps_;
  ShadowProjection& map_;  ///< One of them.
  std::vector<ShadowProjection> others_;
  MapSize requested_size_;  ///< Before the aspect is chosen.
  const LightSamples* samples_;
  LightSamples own_samples_;    ///< Those, where they are not the light's.
  std::vector<uint8_t> stays_;  ///< Of the hull samples: in shadow, and not let go of.
  Reaches reaches_;
  EdgesOnMap edges_;
  ShadowPlaces shadow_;
  double pixels_per_place_ = 0.0;
  int evaluations_ = 0;
};

}  // namespace

TrimmedShadow TrimShadow(const LightProblem& problem, const DefaultOptions& options,
                         std::span<ShadowProjection> maps) {
  TrimmedShadow trimmed{PredictWrongPixels(problem, maps)};
  for (size_t k = 0; k < maps.size(); ++k) {
    Trimmer trimmer(problem, options, maps, k);
    trimmed.predicted = trimmer.Trim(trimmed.predicted);
    trimmed.evaluations += trimmer.evaluations();
  }
  return trimmed;
}

}  // namespace shadowfit
#endif
