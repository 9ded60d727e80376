// What lists of pixels refer to, several at once, for Highway's per-target code: included once for each
// target.

#if defined(SHADOWFIT_FRAME_PIXEL_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SHADOWFIT_FRAME_PIXEL_LANES_INL_H_
#undef SHADOWFIT_FRAME_PIXEL_LANES_INL_H_
#else
#define SHADOWFIT_FRAME_PIXEL_LANES_INL_H_
#endif

#include "core/frame/lane_list.h"
#include "core/math/double_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

using IndexLanes = hn::Rebind<int32_t, DoubleLanes>;
using LongLanes = hn::RebindToSigned<DoubleLanes>;

/// Elements of lists at some indices.
struct Gather {
  hn::Vec<LongLanes> indices;
  HWY_INLINE explicit Gather(hn::Vec<IndexLanes> list) : indices(hn::PromoteTo(LongLanes(), list)) {}
  HWY_INLINE Doubles operator()(const LaneList<double>& v) const {
    return hn::GatherIndex(DoubleLanes(), v.data(), indices);
  }
  HWY_INLINE Doubles3 operator()(const LaneList<glm::dvec3>& v) const {
    const DoubleLanes d;
    const double* first = &v.data()->x;
    const auto triples = hn::Add(indices, hn::Add(indices, indices));
    return {hn::GatherIndex(d, first, triples), hn::GatherIndex(d, first + 1, triples),
            hn::GatherIndex(d, first + 2, triples)};
  }
};

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
