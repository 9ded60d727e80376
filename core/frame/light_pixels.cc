#include "core/frame/light_pixels.h"

#include <algorithm>
#include <numeric>

#include "core/frame/light_samples.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/frame/light_pixels.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/frame/number_lanes-inl.h"
#include "core/frame/packing_lanes-inl.h"
#include "core/frame/pixel_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

// Cosine between normal and light below which a surface counts as grazing: its bits flip with the
// tessellation, not with a caster's edge. What is grazing need not be in the map, so that this is no more
// than rounding: ground under a low sun is seen, and lost as a whole where it does not count.
constexpr double kGrazingCosine = 0.0005;

// What a crossing (neighbours of different bits) that is no plain one counts of a shadow's edge. Its chance
// to be one: its share of wrong pixels to that of plain ones, counted against rays in three scenes
// (study_edges); times 1.6, since where it is one there are more than it shows: leaves. Beside a
// discontinuity it depends on how many of a sample's neighbours go on with its surface in the same light: a
// leaf has none, and an object that stands whole in shadow before a lit ground all but one.
constexpr double kEdgesBesideDiscontinuity[] = {0.53, 0.43, 0.29, 0.19};
// At a terminator, and beside a surface that faces away from the light, whose bit means nothing: where some
// other neighbour is lit, and where all that is seen of the light's work is shadow.
constexpr double kEdgesAtTerminator = 0.32;
constexpr double kEdgesInTheDark = 0.05;

// Crossings that a sample of a shadow's inside or rim stands for where it shows none. Tried from 0 to 2: this
// leaves scenes much as they were whose shadows show their edges (plaza, Sterngarten), and takes the worst
// from others (streets, rooms, arcades), whose single maps pay for it where nothing would have gone wrong.
constexpr double kUnseenEdges = 0.01;

// A pixel that the light does not shine on at all, outside a spot's cone: as one that faces away.
constexpr double kUnlit = -2.0;

// What a light asks a pixel for: bit k where its bit differs from visible neighbour k's, bit 4 + k where the
// surface goes on there, a bit for the rim and the inside of its shadow, and one where that, or the light, is
// narrow.
constexpr int kContinuous = 4;
constexpr int32_t kRim = 1 << 8;
constexpr int32_t kNarrow = 1 << 9;

using Words = hn::CappedTag<uint32_t, kMostLanes>;
using Lanes = DoubleLanes;

void FindConcerned(const ActivePixels& active, uint32_t light_bit, LightPixels* pixels) {
  const Words d;
  const hn::RebindToSigned<Words> di;
  pixels->concerned.Reserve(active.size());
  pixels->marks.Reserve(active.size());
  const auto bit = hn::Set(d, light_bit);
  size_t count = 0;
  for (size_t i = 0; i < active.size(); i += hn::Lanes(d)) {
    const auto mark_where = [&](const LaneList<uint32_t>& lights, int32_t mark) {
      const auto asks = hn::TestBit(hn::LoadU(d, lights.data() + i), bit);
      return hn::IfThenElseZero(hn::RebindMask(di, asks), hn::Set(di, mark));
    };
    auto asked = mark_where(active.rim, kRim);
    for (int k = 0; k < 4; ++k) {
      asked = hn::Or(asked, mark_where(active.crossing[static_cast<size_t>(k)], 1 << k));
    }
    const auto concerned = hn::And(hn::Ne(asked, hn::Zero(di)), hn::FirstN(di, active.size() - i));
    const auto continuous = hn::BitCast(di, hn::LoadU(d, active.continuous.data() + i));
    const Packing packed(di, concerned);
    const auto store = [&](hn::Vec<decltype(di)> v, LaneList<int32_t>* to) {
      hn::StoreU(packed(v), di, to->data() + count);
    };
    store(NumbersFrom(di, static_cast<int32_t>(i)), &pixels->concerned);
    const auto narrow = mark_where(active.narrow, kNarrow);
    store(hn::Or(hn::Or(asked, narrow), hn::ShiftLeft<kContinuous>(continuous)), &pixels->marks);
    count += hn::CountTrue(di, concerned);
  }
  pixels->concerned.Resize(count);
  pixels->concerned.Pad(0);
  pixels->marks.Resize(count);
}

void ConcernAll(size_t count, LightPixels* pixels) {
  pixels->concerned.Resize(count);
  pixels->marks.Resize(count);
  std::iota(pixels->concerned.data(), pixels->concerned.data() + count, 0);
  std::fill_n(pixels->marks.data(), count, kRim);
  pixels->concerned.Pad(0);
}

/// See LightPixels::cosine.
HWY_INLINE Doubles CosineOf(const Doubles3& normal, const PixelSurfaces& surfaces, const Gather& gather,
                            const RaySpace& ray_space) {
  const Lanes d;
  const Doubles3 direction = Set(ray_space.ws_direction());
  if (ray_space.is_directional()) return hn::Neg(Dot(normal, direction));
  const Doubles3 from_light = Minus(gather(surfaces.ws_position), Set(ray_space.ws_position()));
  const Doubles distance = hn::Sqrt(Dot(from_light, from_light));
  const Doubles cosine = hn::Div(hn::Neg(Dot(normal, from_light)), distance);
  if (!ray_space.cos_outer()) return cosine;
  const auto lit = hn::Ge(Dot(from_light, direction), hn::Mul(hn::Set(d, *ray_space.cos_outer()), distance));
  return hn::IfThenElse(lit, cosine, hn::Set(d, kUnlit));
}

HWY_INLINE hn::Mask<Lanes> IsAwayOrGrazing(Doubles cosine) {
  return hn::Le(cosine, hn::Set(Lanes(), kGrazingCosine));
}
HWY_INLINE hn::Mask<Lanes> FacesTheLight(Doubles cosine) {
  return hn::Gt(cosine, hn::Set(Lanes(), kGrazingCosine));
}

void FindCosines(const PixelSurfaces& surfaces, const RaySpace& ray_space, LightPixels* pixels) {
  const Lanes d;
  pixels->cosine.Resize(surfaces.size());
  for (size_t i = 0; i < pixels->concerned.size(); i += hn::Lanes(d)) {
    const Gather gather(hn::LoadU(IndexLanes(), pixels->concerned.data() + i));
    const Doubles3 normal = gather(surfaces.ws_normal);
    const Doubles cosine = CosineOf(normal, surfaces, gather, ray_space);
    // At the light itself there is no direction to it, and nothing shines.
    const auto undefined = hn::And(hn::IsNaN(cosine), hn::Eq(normal.x, normal.x));
    hn::ScatterIndex(hn::IfThenElse(undefined, hn::Set(d, kUnlit), cosine), d, pixels->cosine.data(),
                     gather.indices);
  }
}

HWY_INLINE hn::Mask<Lanes> HasMark(hn::Vec<LongLanes> marks, int64_t mark) {
  const LongLanes d;
  return hn::RebindMask(Lanes(), hn::Ne(hn::And(marks, hn::Set(d, mark)), hn::Zero(d)));
}

void ChooseHull(LightPixels* pixels) {
  const Lanes d;
  const IndexLanes di;
  const size_t most = pixels->concerned.size();
  pixels->hull.Reserve(most);
  pixels->hull_marks.Reserve(most);
  size_t count = 0;
  for (size_t i = 0; i < most; i += hn::Lanes(d)) {
    const auto index = hn::LoadU(di, pixels->concerned.data() + i);
    const auto listed_marks = hn::LoadU(di, pixels->marks.data() + i);
    const auto marks = hn::PromoteTo(LongLanes(), listed_marks);
    const Doubles cosine = Gather(index)(pixels->cosine);
    const auto away = hn::Le(cosine, hn::Zero(d));
    const auto grazing = hn::AndNot(away, IsAwayOrGrazing(cosine));
    const auto differs = HasMark(hn::And(marks, hn::ShiftRight<kContinuous>(marks)), 15);
    // What is lit and beside a discontinuity is not asked: what is in shadow there has the edge, if there is
    // one.
    const auto chosen = Narrow(d, hn::And(hn::AndNot(away, hn::FirstN(d, most - i)),
                                          hn::Or(differs, hn::AndNot(grazing, HasMark(marks, kRim)))));
    const Packing packed(di, chosen);
    hn::StoreU(packed(index), di, pixels->hull.data() + count);
    hn::StoreU(packed(listed_marks), di, pixels->hull_marks.data() + count);
    count += hn::CountTrue(di, chosen);
  }
  pixels->hull.Resize(count);
  pixels->hull.Pad(0);
  pixels->hull_marks.Resize(count);
  pixels->hull_marks.Pad(0);
}

void CountCrossings(const ActivePixels& active, std::ptrdiff_t stride, LightPixels* pixels) {
  const Lanes d;
  const IndexLanes di;
  const auto zero = hn::Zero(d);
  const auto one = hn::Set(d, 1.0);
  const size_t count = pixels->hull.size();
  pixels->tail.Resize(count);
  pixels->edges.crossings.Resize(count);
  pixels->edges.pixels = 0;
  pixels->rough_edges.crossings.Resize(count);
  pixels->rough_edges.pixels = 0;
  pixels->unseen_edges.crossings.Resize(count);
  pixels->unseen_edges.pixels = 0;
  for (size_t i = 0; i < count; i += hn::Lanes(d)) {
    const auto here = hn::LoadU(di, pixels->hull.data() + i);
    const auto listed_marks = hn::LoadU(di, pixels->hull_marks.data() + i);
    const auto marks = hn::PromoteTo(LongLanes(), listed_marks);
    const Doubles cosine = Gather(here)(pixels->cosine);
    const auto index = hn::GatherIndex(di, active.index.data(), here);
    // Where bits differ the neighbour is active and concerned, too: one in the same row is the next in the
    // list.
    const auto in_row = [&](int32_t step) { return hn::Add(here, hn::Set(di, step)); };
    const auto in_column = [&](std::ptrdiff_t step) {
      return hn::GatherIndex(di, active.place_of_index.data(),
                             hn::Add(index, hn::Set(di, static_cast<int32_t>(step))));
    };
    const hn::Vec<IndexLanes> neighbours[4] = {in_row(-1), in_row(1), in_column(-stride), in_column(stride)};

    auto crossings = zero;
    auto discontinuous_crossings = zero;
    auto terminators = zero;
    auto away_crossings = zero;
    auto supports = zero;
    for (int k = 0; k < 4; ++k) {
      const auto add = [&](hn::Mask<Lanes> where, Doubles* to) {
        *to = hn::Add(*to, hn::IfThenElseZero(where, one));
      };
      const auto crossed = HasMark(marks, 1 << k);
      const auto continuous = HasMark(marks, 1 << (kContinuous + k));
      const auto is_crossed = hn::TestBit(listed_marks, hn::Set(di, 1 << k));
      const Doubles beside = Gather(hn::IfThenElseZero(is_crossed, neighbours[k]))(pixels->cosine);
      const auto away = IsAwayOrGrazing(beside);
      const auto sure = hn::And(continuous, hn::And(FacesTheLight(cosine), FacesTheLight(beside)));
      // At a terminator the light's cosine, carried on at the same rate, reaches zero within a step.
      const auto goes_on = hn::Gt(hn::Sub(hn::Mul(hn::Set(d, 2.0), cosine), beside), zero);
      add(hn::AndNot(crossed, continuous), &supports);
      add(hn::And(crossed, away), &away_crossings);
      add(hn::AndNot(hn::Or(away, sure), crossed), &discontinuous_crossings);
      add(hn::And(crossed, hn::And(sure, goes_on)), &crossings);
      add(hn::And(crossed, hn::AndNot(goes_on, sure)), &terminators);
    }
    const auto lit_beside = hn::Gt(hn::Add(crossings, hn::Add(discontinuous_crossings, terminators)), zero);
    auto chance = hn::Set(d, kEdgesBesideDiscontinuity[3]);
    for (int k = 2; k >= 0; --k) {
      chance = hn::IfThenElse(hn::Le(supports, hn::Set(d, static_cast<double>(k))),
                              hn::Set(d, kEdgesBesideDiscontinuity[k]), chance);
    }
    const auto at_terminator = hn::Set(d, kEdgesAtTerminator);
    const auto rough_crossings = hn::Add(
        hn::Add(hn::Mul(discontinuous_crossings, chance), hn::Mul(terminators, at_terminator)),
        hn::Mul(away_crossings, hn::IfThenElse(lit_beside, at_terminator, hn::Set(d, kEdgesInTheDark))));
    const auto counts = hn::AndNot(IsAwayOrGrazing(cosine), hn::FirstN(d, count - i));
    const auto store = [&](Doubles v, EdgeCrossings* to) {
      v = hn::IfThenElseZero(counts, v);
      hn::StoreU(v, d, to->crossings.data() + i);
      to->pixels += hn::CountTrue(d, hn::Gt(v, zero));
    };
    store(crossings, &pixels->edges);
    store(rough_crossings, &pixels->rough_edges);
    hn::StoreU(hn::IfThenZeroElse(HasMark(marks, kNarrow), hn::Set(d, kWideTail)), d,
               pixels->tail.data() + i);
    const auto shows_none = hn::Eq(hn::Add(crossings, rough_crossings), zero);
    store(hn::IfThenElseZero(hn::And(HasMark(marks, kRim), shows_none), hn::Set(d, kUnseenEdges)),
          &pixels->unseen_edges);
  }
}

void ListLit(const LightPixels& pixels, LaneList<int32_t>* lit) {
  lit->Resize(0);
  for (size_t i = 0; i < pixels.hull.size(); ++i) {
    if (pixels.cosine[static_cast<size_t>(pixels.hull[i])] > kGrazingCosine) {
      lit->Append(static_cast<int32_t>(i));
    }
  }
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {

HWY_EXPORT(FindConcerned);
HWY_EXPORT(FindCosines);
HWY_EXPORT(ChooseHull);
HWY_EXPORT(CountCrossings);
HWY_EXPORT(ConcernAll);
HWY_EXPORT(ListLit);

void FindLightPixels(const ActivePixels& active, const PixelSurfaces& surfaces, std::ptrdiff_t stride,
                     const RaySpace& ray_space, uint32_t light_bit, LightPixels* pixels) {
  HWY_DYNAMIC_DISPATCH(FindConcerned)(active, light_bit, pixels);
  HWY_DYNAMIC_DISPATCH(FindCosines)(surfaces, ray_space, pixels);
  HWY_DYNAMIC_DISPATCH(ChooseHull)(pixels);
  HWY_DYNAMIC_DISPATCH(CountCrossings)(active, stride, pixels);
}

void FindLitPixels(const PixelSurfaces& surfaces, const RaySpace& ray_space, LightPixels* pixels,
                   LaneList<int32_t>* lit) {
  HWY_DYNAMIC_DISPATCH(ConcernAll)(surfaces.size(), pixels);
  HWY_DYNAMIC_DISPATCH(FindCosines)(surfaces, ray_space, pixels);
  HWY_DYNAMIC_DISPATCH(ChooseHull)(pixels);
  HWY_DYNAMIC_DISPATCH(ListLit)(*pixels, lit);
  for (EdgeCrossings* edges : {&pixels->edges, &pixels->rough_edges, &pixels->unseen_edges}) {
    edges->crossings.Resize(pixels->hull.size());
    std::fill_n(edges->crossings.data(), pixels->hull.size() + kMostLanes, 0.0);
    edges->pixels = 0;
  }
}

}  // namespace shadowfit
#endif
