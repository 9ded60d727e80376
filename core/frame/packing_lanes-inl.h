// Picks some of the lanes of vectors, for Highway's per-target code: included once for each target.

#if defined(SHADOWFIT_FRAME_PACKING_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SHADOWFIT_FRAME_PACKING_LANES_INL_H_
#undef SHADOWFIT_FRAME_PACKING_LANES_INL_H_
#else
#define SHADOWFIT_FRAME_PACKING_LANES_INL_H_
#endif

#include <hwy/highway.h>

#include <array>

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

/// A mask of 64-bit lanes for 32-bit ones.
template <class D>
HWY_INLINE hn::Mask<hn::Rebind<int32_t, D>> Narrow(D d, hn::Mask<D> mask) {
  std::array<uint8_t, 8> bits{};
  hn::StoreMaskBits(d, mask, bits.data());
  return hn::LoadMaskBits(hn::Rebind<int32_t, D>(), bits.data());
}

/// Moves the chosen of 32-bit or 64-bit lanes to the front, in their order; what comes behind them is
/// arbitrary. Highway's Compress may look its permutation up in a table each time; this does once for all
/// vectors that are packed alike.
template <class D>
class Packing {
 public:
  HWY_INLINE Packing(D d, hn::Mask<D> chosen) : order_(hn::IndicesFromVec(d, Order(d, chosen))) {}
  HWY_INLINE hn::Vec<D> operator()(hn::Vec<D> v) const { return hn::TableLookupLanes(v, order_); }

 private:
  using Places = hn::RebindToSigned<D>;

  static HWY_INLINE hn::Vec<Places> Order(D d, hn::Mask<D> chosen) {
    const Places places;
    if constexpr (sizeof(hn::TFromD<D>) == sizeof(int32_t)) {
      return hn::Compress(hn::Iota(places, 0), hn::RebindMask(places, chosen));
    } else {
      return hn::PromoteTo(places, hn::Compress(hn::Iota(hn::Rebind<int32_t, D>(), 0), Narrow(d, chosen)));
    }
  }

  decltype(hn::IndicesFromVec(D(), hn::Zero(Places()))) order_;
};

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
