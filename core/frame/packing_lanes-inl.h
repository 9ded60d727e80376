// Picks some of the lanes of vectors, for Highway's per-target code: included once for each target.

#if defined(SHADOWFIT_FRAME_PACKING_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SHADOWFIT_FRAME_PACKING_LANES_INL_H_
#undef SHADOWFIT_FRAME_PACKING_LANES_INL_H_
#else
#define SHADOWFIT_FRAME_PACKING_LANES_INL_H_
#endif

#include <hwy/highway.h>

#include <array>
#include <cstdint>

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
/// arbitrary. One permutation serves all vectors that are packed alike. It is looked up here where there are
/// few lanes: Highway's own table is copied to the stack for every Compress where GCC compiles it.
template <class D>
class Packing {
 public:
  HWY_INLINE Packing(D d, hn::Mask<D> chosen) : order_(hn::IndicesFromVec(d, Order(d, chosen))) {}
  HWY_INLINE hn::Vec<D> operator()(hn::Vec<D> v) const { return hn::TableLookupLanes(v, order_); }

 private:
  using Places = hn::RebindToSigned<D>;
  static constexpr size_t kFewLanes = 8;

  static constexpr std::array<std::array<uint8_t, kFewLanes>, 256> Orders() {
    std::array<std::array<uint8_t, kFewLanes>, 256> orders{};
    for (size_t bits = 0; bits < orders.size(); ++bits) {
      size_t count = 0;
      for (size_t lane = 0; lane < kFewLanes; ++lane) {
        if ((bits >> lane & 1) != 0) orders[bits][count++] = static_cast<uint8_t>(lane);
      }
    }
    return orders;
  }
  static constexpr auto kOrders = Orders();

  static HWY_INLINE hn::Vec<Places> Order(D d, hn::Mask<D> chosen) {
    const Places places;
    if constexpr (hn::MaxLanes(D()) > kFewLanes) {
      return hn::Compress(hn::Iota(places, 0), hn::RebindMask(places, chosen));
    } else {
      std::array<uint8_t, 8> bits{};
      hn::StoreMaskBits(d, chosen, bits.data());
      const auto order = hn::LoadU(hn::Rebind<uint8_t, D>(), kOrders[bits[0]].data());
      const auto words = hn::PromoteTo(hn::Rebind<int32_t, D>(), order);
      if constexpr (sizeof(hn::TFromD<D>) == sizeof(int32_t)) {
        return words;
      } else {
        return hn::PromoteTo(places, words);
      }
    }
  }

  decltype(hn::IndicesFromVec(D(), hn::Zero(Places()))) order_;
};

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
