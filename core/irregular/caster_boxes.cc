#include "core/irregular/caster_boxes.h"

#include <algorithm>
#include <cmath>

#include "core/irregular/parallel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/irregular/caster_boxes.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/irregular/simd.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::irregular {
namespace HWY_NAMESPACE {

/// By how much a direction may be off: plane coordinates by that times 1 + u^2 + v^2, and those of a
/// directional light by that share of themselves. It covers the rounding of corners and samples to single
/// precision, and that of slivers' edges.
constexpr float kSlack = 6e-4f;
/// Rounding of what follows here, as a share of the box's distance from the light.
constexpr float kRoundoff = 1e-6f;
/// Boxes farther off, or nearer, over- or underflow in single precision.
constexpr float kMostSize = 1e17f, kLeastSize = 1e-17f;

/// Boxes of kLanes clusters in the world, around the light.
struct ClusterLanes {
  VF centre[3], extent[3];
  VF size;  ///< Sum of their coordinates' magnitudes.

  HWY_INLINE ClusterLanes(const FaceFrame& frame, const MaskScene::Cluster* clusters, size_t count) {
    constexpr size_t kFours = sizeof(MaskScene::Cluster) / (4 * sizeof(float));
    static_assert(alignof(MaskScene::Cluster) % (4 * sizeof(float)) == 0);
    HWY_ALIGN uint32_t index[kLanes];
    for (size_t i = 0; i < kLanes; ++i) index[i] = static_cast<uint32_t>(kFours * std::min(i, count - 1));
    const float* const first = &clusters->ws_min.x;
    VF a[4], b[4];
    for (size_t k = 0; k < 4; ++k) {
      a[k] = EveryFourth(df, first, index + k);
      b[k] = EveryFourth(df, first + 4, index + k);
    }
    TransposeBlocks(a);
    TransposeBlocks(b);
    const VF low[3] = {a[0], a[1], a[2]}, high[3] = {a[3], b[0], b[1]};
    const VF half = hn::Set(df, 0.5f);
    size = hn::Zero(df);
    for (int i = 0; i < 3; ++i) {
      const auto from_origin = [&](VF x) HWY_ATTR {
        return hn::Sub(hn::Sub(x, hn::Set(df, frame.origin[i])), hn::Set(df, frame.origin_rest[i]));
      };
      const VF l = from_origin(low[i]), h = from_origin(high[i]);
      centre[i] = hn::Mul(half, hn::Add(l, h));
      extent[i] = hn::Mul(half, hn::Sub(h, l));
      size = hn::Add(size, hn::Add(hn::Abs(l), hn::Abs(h)));
    }
  }

  /// Of the linear function with these factors: its value in the middle, and by how much it differs at most.
  HWY_INLINE void Range(const float factors[3], VF* at, VF* reach) const {
    *at = *reach = hn::Zero(df);
    for (int i = 0; i < 3; ++i) {
      *at = hn::MulAdd(hn::Set(df, factors[i]), centre[i], *at);
      *reach = hn::MulAdd(hn::Set(df, std::abs(factors[i])), extent[i], *reach);
    }
  }

  /// By how much x - m w differs at most from its value in the middle, where the rows are those of x and w.
  HWY_INLINE VF ReachAround(VF m, const float x_row[3], const float w_row[3]) const {
    VF reach = hn::Zero(df);
    for (int i = 0; i < 3; ++i) {
      const VF factor = hn::NegMulAdd(m, hn::Set(df, w_row[i]), hn::Set(df, x_row[i]));
      reach = hn::MulAdd(hn::Abs(factor), extent[i], reach);
    }
    return reach;
  }
};

struct BoxLanes {
  VF u_min, v_min, u_max, v_max, nearest;

  HWY_INLINE void Set(MF lanes, float low, float high, float depth) {
    u_min = hn::IfThenElse(lanes, hn::Set(df, low), u_min);
    v_min = hn::IfThenElse(lanes, hn::Set(df, low), v_min);
    u_max = hn::IfThenElse(lanes, hn::Set(df, high), u_max);
    v_max = hn::IfThenElse(lanes, hn::Set(df, high), v_max);
    nearest = hn::IfThenElse(lanes, hn::Set(df, depth), nearest);
  }
};

/// Encloses the clusters as a face sees them, whose samples have |u| and |v| up to `widest`.
HWY_INLINE BoxLanes BoxesOf(bool directional, const FaceFrame& frame, float widest,
                            const ClusterLanes& clusters) {
  const VF one = hn::Set(df, 1.0f), zero = hn::Zero(df), slack_share = hn::Set(df, kSlack);
  const VF roundoff = hn::Mul(clusters.size, hn::Set(df, kRoundoff));
  const auto rounding = [roundoff](VF at, VF reach) HWY_ATTR {
    return hn::MulAdd(hn::Add(hn::Abs(at), reach), hn::Set(df, 1e-5f), roundoff);
  };
  VF middle[3], least[3], most[3];
  for (int row = 0; row < 3; ++row) {
    VF reach;
    clusters.Range(frame.rotation[row], &middle[row], &reach);
    const VF slack = rounding(middle[row], reach);
    least[row] = hn::Sub(hn::Sub(middle[row], reach), slack);
    most[row] = hn::Add(hn::Add(middle[row], reach), slack);
  }
  VF u[2] = {least[0], most[0]}, v[2] = {least[1], most[1]};
  VF nearest = least[2];
  MF none = NoLanes();
  const MF usable =
      hn::And(hn::Lt(clusters.size, hn::Set(df, kMostSize)), hn::Gt(clusters.size, hn::Set(df, kLeastSize)));
  MF all = hn::Not(usable);
  if (!directional) {
    none = hn::Not(hn::Gt(most[2], zero));
    // Beyond a side of the pyramid that holds the samples' rays, by as much as the slack below at its edge?
    const VF margin = hn::MulAdd(most[2], hn::Set(df, kSlack * (1.0f + 2.0f * widest * widest)),
                                 hn::Mul(roundoff, hn::Set(df, 1.0f + widest)));
    for (int row = 0; row < 2; ++row) {
      for (const float sign : {-1.0f, 1.0f}) {
        float side[3];
        for (int i = 0; i < 3; ++i) side[i] = sign * frame.rotation[row][i] - widest * frame.rotation[2][i];
        VF at, reach;
        clusters.Range(side, &at, &reach);
        none = hn::Or(none, hn::Gt(hn::Sub(at, reach), margin));
      }
    }
    all = hn::Or(all, hn::Not(hn::Gt(least[2], hn::Mul(most[2], hn::Set(df, 1e-3f)))));
    const VF inverse_least = hn::Div(one, least[2]), inverse_most = hn::Div(one, most[2]);
    // x/w lies between the quotients of the ranges of x and w; and with m its value in the middle, x/w - m is
    // (x - m w)/w, where the numerator's range is exact. That is the sharper one unless w varies much.
    VF* const plane[2] = {u, v};
    for (int row = 0; row < 2; ++row) {
      VF* const x = plane[row];
      x[0] = hn::Mul(x[0], hn::IfThenElse(hn::Lt(x[0], zero), inverse_least, inverse_most));
      x[1] = hn::Mul(x[1], hn::IfThenElse(hn::Gt(x[1], zero), inverse_least, inverse_most));
      const VF m = hn::Div(middle[row], middle[2]);
      const VF reach = clusters.ReachAround(m, frame.rotation[row], frame.rotation[2]);
      const VF slack = hn::MulAdd(hn::Abs(m), roundoff, rounding(middle[row], reach));
      const VF half = hn::Mul(hn::Add(reach, slack), inverse_least);
      x[0] = hn::Max(x[0], hn::Sub(m, half));
      x[1] = hn::Min(x[1], hn::Add(m, half));
    }
    nearest = hn::Neg(inverse_least);
  }
  const VF reach_u = hn::Max(hn::Abs(u[0]), hn::Abs(u[1]));
  const VF reach_v = hn::Max(hn::Abs(v[0]), hn::Abs(v[1]));
  const VF unit = directional ? hn::Max(reach_u, reach_v)
                              : hn::MulAdd(reach_u, reach_u, hn::MulAdd(reach_v, reach_v, one));
  const VF slack = hn::Mul(slack_share, unit);
  BoxLanes box = {hn::Sub(u[0], slack), hn::Sub(v[0], slack), hn::Add(u[1], slack), hn::Add(v[1], slack),
                  nearest};
  box.Set(all, -kInfinity, kInfinity, -kInfinity);
  box.Set(hn::And(none, usable), kInfinity, -kInfinity, kInfinity);
  return box;
}

void BoxesOfClustersImpl(const LightFrame& light, const Face& face, float widest,
                         std::span<const MaskScene::Cluster> clusters, size_t stride, float* out) {
  const FaceFrame frame(light, face);
  for (size_t i = 0; i < clusters.size(); i += kLanes) {
    const ClusterLanes lanes(frame, clusters.data() + i, clusters.size() - i);
    const BoxLanes box = BoxesOf(light.directional, frame, widest, lanes);
    const VF values[5] = {box.u_min, box.v_min, box.u_max, box.v_max, box.nearest};
    // What follows them may be another thread's.
    const MF present =
        LanesOf(FirstBits(static_cast<uint32_t>(std::min<size_t>(clusters.size() - i, kLanes))));
    for (size_t k = 0; k < 5; ++k) hn::BlendedStore(values[k], present, df, out + k * stride + i);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit::irregular {

HWY_EXPORT(BoxesOfClustersImpl);

namespace {

size_t StrideFor(size_t clusters) { return (clusters + 2 * kPadding - 1) / kPadding * kPadding; }

}  // namespace

size_t CasterBoxes::BytesFor(size_t clusters, const LightPlan& plan) {
  return static_cast<size_t>(plan.face_count) * 5 * StrideFor(clusters) * sizeof(float);
}

BoxArrays CasterBoxes::Of(int face) const {
  const float* first = values_.data() + static_cast<size_t>(face) * 5 * stride_;
  return {first, first + stride_, first + 2 * stride_, first + 3 * stride_, first + 4 * stride_};
}

bool CasterBoxes::Compute(std::span<const std::span<const MaskScene::Cluster>> parts, const LightPlan& plan,
                          const Cancellation* cancellation) {
  size_t count = 0;
  for (const std::span<const MaskScene::Cluster>& part : parts) count += part.size();
  stride_ = StrideFor(count);
  if (!values_.Reserve(static_cast<size_t>(plan.face_count) * 5 * stride_)) return false;
  const float widest = plan.face_count == 1 ? kWidestFace : 1.0f;
  size_t first = 0;
  for (const std::span<const MaskScene::Cluster>& part : parts) {
    ForEachPiece(part.size(), 4096, cancellation, [&](size_t begin, size_t end) {
      for (int f = 0; f < plan.face_count; ++f) {
        HWY_DYNAMIC_DISPATCH(BoxesOfClustersImpl)
        (plan.frame, plan.faces[static_cast<size_t>(f)], widest, part.subspan(begin, end - begin), stride_,
         values_.data() + static_cast<size_t>(f) * 5 * stride_ + first + begin);
      }
    });
    first += part.size();
  }
  return true;
}

}  // namespace shadowfit::irregular
#endif  // HWY_ONCE
