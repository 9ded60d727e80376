#include "core/frame/edge_pattern.h"

#include <cmath>
#include <numbers>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/frame/edge_pattern.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/math/double_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

/// A window has the structure of an edge where the eigenvalues of its structure tensor differ by at least
/// this share of their sum.
constexpr float kLeastCoherence = 0.5f;

/// A texture's least share of neighbours that differ; a corner's is at most a quarter.
constexpr float kLeastDifferences = 0.3f;

/// Makes predictions for leaves as good as those for walls.
constexpr double kTextureEdges = 2.0;

using Words = hn::CappedTag<uint32_t, kMostLanes>;
using Window = hn::Vec<Words>;  ///< 5x5 bits each, bit 5 row + column.

constexpr uint32_t kWholeWindow = (1u << 25) - 1;
constexpr uint32_t kMiddleOfWindow = 1u << 12;

/// The bits around pixels.
HWY_INLINE Window BitsAround(const PackedBits& bits, hn::Vec<hn::RebindToSigned<Words>> indices) {
  const Words d;
  const hn::RebindToSigned<Words> di;
  // Rows are whole bytes apart, so that all of them begin at the same bit of theirs.
  const auto first = hn::Sub(indices, hn::Set(di, static_cast<int32_t>(2 * bits.stride + 2)));
  const auto shift = hn::BitCast(d, hn::And(first, hn::Set(di, 7)));
  auto offset = hn::ShiftRight<3>(first);
  auto window = hn::Zero(d);
  for (int row = 0; row < 5; ++row) {
    const auto loaded = hn::GatherOffset(d, reinterpret_cast<const uint32_t*>(bits.bytes.data()), offset);
    const auto five = hn::And(hn::Shr(loaded, shift), hn::Set(d, 31));
    window = hn::Or(window, hn::Shl(five, hn::Set(d, static_cast<uint32_t>(5 * row))));
    offset = hn::Add(offset, hn::Set(di, static_cast<int32_t>(bits.stride / 8)));
  }
  return window;
}

/// EdgePattern of windows.
HWY_INLINE hn::Vec<hn::RebindToSigned<Words>> PatternOf(Window window) {
  const Words d;
  const hn::RebindToSigned<Words> di;
  const hn::RebindToFloat<Words> df;
  // The lower left bits of all 2x2 quads, four a row, and those beside, above and across from them.
  const auto quads = hn::Set(d, 0xFu | 0xFu << 5 | 0xFu << 10 | 0xFu << 15);
  const auto v00 = hn::And(window, quads);
  const auto v10 = hn::And(hn::ShiftRight<1>(window), quads);
  const auto v01 = hn::And(hn::ShiftRight<5>(window), quads);
  const auto v11 = hn::And(hn::ShiftRight<6>(window), quads);
  const auto count = [&](Window v) { return hn::BitCast(di, hn::PopulationCount(v)); };
  const auto gg = count(hn::Xor(v11, v00));
  const auto ee = count(hn::Xor(v10, v01));
  const auto g_up = hn::AndNot(v00, v11);
  const auto g_down = hn::AndNot(v11, v00);
  const auto e_up = hn::AndNot(v01, v10);
  const auto e_down = hn::AndNot(v10, v01);
  const auto ge = hn::Sub(count(hn::Or(hn::And(g_up, e_up), hn::And(g_down, e_down))),
                          count(hn::Or(hn::And(g_up, e_down), hn::And(g_down, e_up))));
  const auto xy = hn::Sub(gg, ee);
  const auto pattern = hn::Add(hn::Mul(hn::Add(ge, hn::Set(di, kQuads)), hn::Set(di, kSums)),
                               hn::Add(xy, hn::Set(di, kQuads)));

  constexpr float kNeighbours = 2.0f * kQuads;
  const auto number = [&](auto v) { return hn::ConvertTo(df, v); };
  const auto differences = number(hn::Add(count(hn::Xor(v00, v10)), count(hn::Xor(v00, v01))));
  const auto many = hn::Ge(differences, hn::Set(df, kLeastDifferences * kNeighbours));
  // The eigenvalues differ by the root of (xx - yy)^2 + (2 xy)^2, and xx + yy = 2 (sum g^2 + sum e^2). All
  // these are small whole numbers: exact.
  const auto squared = [](auto v) { return hn::Mul(v, v); };
  const auto difference = hn::Mul(hn::Set(df, 4.0f), number(ge));
  const auto twice_xy = hn::Mul(hn::Set(df, 2.0f), number(xy));
  const auto sum = hn::Mul(hn::Set(df, 2.0f), number(hn::Add(gg, ee)));
  const auto isotropic = hn::Lt(hn::Add(squared(difference), squared(twice_xy)),
                                squared(hn::Mul(hn::Set(df, kLeastCoherence), sum)));
  return hn::IfThenElse(hn::RebindMask(di, hn::And(many, isotropic)), hn::Set(di, kTexture), pattern);
}

void FindPatterns(const PackedBits& visible, const PackedBits& light, const LaneList<int32_t>& indices,
                  const LaneList<int32_t>& listed, LaneList<EdgePattern>* patterns) {
  const Words d;
  const hn::RebindToSigned<Words> di;
  patterns->Resize(listed.size());
  for (size_t i = 0; i < listed.size(); i += hn::Lanes(d)) {
    const auto index = hn::GatherIndex(di, indices.data(), hn::LoadU(di, listed.data() + i));
    const Window seen = BitsAround(visible, index);
    const Window bits = BitsAround(light, index);
    const auto in_shadow = hn::TestBit(bits, hn::Set(d, kMiddleOfWindow));
    const Window window = hn::Or(hn::And(bits, seen),
                                 hn::IfThenElseZero(in_shadow, hn::AndNot(seen, hn::Set(d, kWholeWindow))));
    hn::StoreU(PatternOf(window), di, patterns->data() + i);
  }
}

HWY_INLINE Doubles Length(Doubles x, Doubles y) { return hn::Sqrt(hn::Add(hn::Mul(x, x), hn::Mul(y, y))); }

void TurnTextures(const LaneList<int32_t>& listed, bool directional, const double* cosines,
                  const double* sines, BoundarySamples* samples) {
  const DoubleLanes d;
  const auto zero = hn::Zero(d);
  const auto one = hn::Set(d, 1.0);
  for (size_t i = 0; i < listed.size(); i += hn::Lanes(d)) {
    const auto index = hn::PromoteTo(hn::RebindToSigned<DoubleLanes>(),
                                     hn::LoadU(hn::Rebind<int32_t, DoubleLanes>(), listed.data() + i));
    const auto at = [&](const double* v) { return hn::GatherIndex(d, v, index); };
    const auto at3 = [&](const std::vector<double>(&v)[3]) {
      return Doubles3{at(v[0].data()), at(v[1].data()), at(v[2].data())};
    };
    // The light's picture: of a directional light the first two ray coordinates, else the plane across the
    // ray, at any scale.
    Doubles3 b1{one, zero, zero};
    Doubles3 b2{zero, one, zero};
    if (!directional) {
      const Doubles3 ray = at3(samples->r);
      const auto along_z = hn::Lt(hn::Abs(ray.x), hn::Abs(ray.z));
      const Doubles3 helper{hn::IfThenElseZero(along_z, one), zero, hn::IfThenElse(along_z, zero, one)};
      b1 = Cross(helper, ray);
      b2 = Scaled(Cross(ray, b1), hn::Div(one, hn::Sqrt(Dot(ray, ray))));
    }
    const Doubles3 dx1 = at3(samples->dr1);
    const Doubles3 dx2 = at3(samples->dr2);
    const Doubles a1[2] = {Dot(b1, dx1), Dot(b2, dx1)};
    const Doubles a2[2] = {Dot(b1, dx2), Dot(b2, dx2)};
    const Doubles m[2] = {at(cosines), at(sines)};
    const auto dot_m = [&](const Doubles(&a)[2]) {
      return hn::Add(hn::Mul(m[0], a[0]), hn::Mul(m[1], a[1]));
    };
    const Doubles across1 = dot_m(a1);
    const Doubles across2 = dot_m(a2);
    const Doubles size = Length(across1, across2);
    const Doubles extents = at(samples->length.data());
    const Doubles c = hn::Div(hn::Mul(hn::Set(d, 0.5 * std::numbers::pi * kTextureEdges), extents),
                              hn::Add(Length(a1[0], a1[1]), Length(a2[0], a2[1])));
    const Doubles length = hn::Mul(c, size);
    const auto known = hn::And(hn::Gt(size, zero), hn::IsFinite(length));
    hn::ScatterIndex(hn::IfThenElse(known, hn::Div(across1, size), one), d, samples->n1.data(), index);
    hn::ScatterIndex(hn::IfThenElseZero(known, hn::Div(across2, size)), d, samples->n2.data(), index);
    hn::ScatterIndex(hn::IfThenElse(known, length, extents), d, samples->length.data(), index);
  }
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {

HWY_EXPORT(FindPatterns);
HWY_EXPORT(TurnTextures);

namespace {

EdgeDirection DirectionOf(EdgePattern pattern, const glm::dvec2& scale) {
  // A crossing between two pixels side by side is an edge as high as a pixel, half of it each one's; between
  // two upon another, as wide.
  if (pattern == kTexture) return {{1.0, 0.0}, 0.25 * (scale.x + scale.y)};
  // With xx - yy = 4 sum ge, the dominant eigenvector's angle is half that of (xx - yy, 2 xy).
  const int sum_ge = pattern / kSums - kQuads;
  const int xy = pattern % kSums - kQuads;
  const double angle = 0.5 * std::atan2(xy, 2.0 * sum_ge);
  const glm::dvec2 normal(std::cos(angle), std::sin(angle));
  const double stretch = glm::length(glm::dvec2(-normal.y, normal.x) * scale);
  return {glm::normalize(normal / scale), stretch * 0.5 / (std::abs(normal.x) + std::abs(normal.y))};
}

}  // namespace

void FindEdgePatterns(const PackedBits& visible, const PackedBits& light, const LaneList<int32_t>& indices,
                      const LaneList<int32_t>& listed, LaneList<EdgePattern>* patterns) {
  HWY_DYNAMIC_DISPATCH(FindPatterns)(visible, light, indices, listed, patterns);
}

EdgeDirections::EdgeDirections(const glm::dvec2& scale) {
  for (size_t pattern = 0; pattern < directions_.size(); ++pattern) {
    directions_[pattern] = DirectionOf(static_cast<EdgePattern>(pattern), scale);
  }
}

void TextureEdges::Prepare(size_t count) {
  for (size_t i = cosines_.size(); i < count; ++i) {
    // Multiples of the golden angle.
    const double angle = static_cast<double>(i) * (std::numbers::pi * std::numbers::phi);
    cosines_.push_back(std::cos(angle));
    sines_.push_back(std::sin(angle));
  }
}

void TextureEdges::Turn(LaneList<int32_t>* listed, bool directional, BoundarySamples* samples) const {
  if (listed->size() == 0) return;
  // What lies beyond the end is turned, too.
  listed->Pad((*listed)[listed->size() - 1]);
  HWY_DYNAMIC_DISPATCH(TurnTextures)(*listed, directional, cosines_.data(), sines_.data(), samples);
}

}  // namespace shadowfit
#endif
