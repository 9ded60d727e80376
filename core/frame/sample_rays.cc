#include "core/frame/sample_rays.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/frame/sample_rays.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/frame/number_lanes-inl.h"
#include "core/frame/packing_lanes-inl.h"
#include "core/frame/pixel_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

using Lanes = DoubleLanes;

/// Some pixels in ray coordinates.
struct Rays {
  Doubles3 r, dx1, dx2;
  Doubles q;
};

/// Boundary samples that are being filled, with room for a vector beyond the last.
class BoundaryFiller {
 public:
  BoundaryFiller(const EdgeCrossings& edges, const EdgeDirections& directions, const glm::dvec2& scale,
                 BoundarySamples* samples, LaneList<int32_t>* textures)
      : edges_(edges), directions_(directions), scale_(scale), samples_(*samples), textures_(*textures) {}

  /// Those of the hull samples from i on that have crossings; patterns() and tails() are theirs.
  template <class Patterns, class Tails>
  HWY_INLINE void Add(size_t i, const Rays& rays, const Patterns& patterns, const Tails& tails) {
    const Lanes d;
    const IndexLanes di;
    const auto one = hn::Set(d, 1.0);
    const Doubles crossings = hn::LoadU(d, edges_.crossings.data() + i);
    const auto crossed = hn::Gt(crossings, hn::Zero(d));
    if (hn::AllFalse(d, crossed)) return;
    const Packing packed(d, crossed);
    const auto put = [&](Doubles v, std::vector<double>* to) {
      hn::StoreU(packed(v), d, to->data() + count_);
    };
    const auto put3 = [&](const Doubles3& v, std::vector<double>(*to)[3]) {
      put(v.x, &(*to)[0]);
      put(v.y, &(*to)[1]);
      put(v.z, &(*to)[2]);
    };
    put3(rays.r, &samples_.r);
    put3(Scaled(rays.dx1, hn::Set(d, 1.0 / scale_.x)), &samples_.dr1);
    put3(Scaled(rays.dx2, hn::Set(d, 1.0 / scale_.y)), &samples_.dr2);
    put(rays.q, &samples_.q);

    static_assert(sizeof(EdgeDirection) == 3 * sizeof(double));
    const auto pattern = patterns();
    const auto entry = hn::Add(pattern, hn::Add(pattern, pattern));
    const double* table = &directions_.data()->normal.x;
    put(hn::GatherIndex(d, table, entry), &samples_.n1);
    put(hn::GatherIndex(d, table + 1, entry), &samples_.n2);
    put(hn::Mul(crossings, hn::GatherIndex(d, table + 2, entry)), &samples_.length);
    put(tails(), &samples_.tail);

    const size_t found = hn::CountTrue(d, crossed);
    const auto is_texture = hn::RebindMask(d, hn::Eq(pattern, hn::Set(LongLanes(), kTexture)));
    const auto texture =
        Narrow(d, hn::And(hn::FirstN(d, found), hn::Eq(packed(hn::IfThenElseZero(is_texture, one)), one)));
    const auto places = NumbersFrom(di, static_cast<int32_t>(count_));
    hn::StoreU(hn::Compress(places, texture), di, textures_.data() + texture_count_);
    texture_count_ += hn::CountTrue(di, texture);
    count_ += found;
  }

  void Finish() {
    textures_.Resize(texture_count_);
    samples_.Resize(count_);
  }

 private:
  const EdgeCrossings& edges_;
  const EdgeDirections& directions_;
  const glm::dvec2 scale_;
  BoundarySamples& samples_;
  LaneList<int32_t>& textures_;
  size_t count_ = 0;
  size_t texture_count_ = 0;
};

/// `samples` and `textures` have room for a vector beyond what they will hold.
void Fill(const PixelSurfaces& surfaces, const LightPixels& pixels, const LaneList<EdgePattern>& patterns,
          const EdgeDirections& directions, const glm::dvec2& scale, const RaySpace& ray_space,
          SampledTextures* textures, LightSamples* samples) {
  const Lanes d;
  const glm::dmat3& linear = ray_space.linear();
  const Doubles3 offset = Set(ray_space.offset());
  const Doubles3 direction = Set(ray_space.ws_direction());
  BoundaryFiller boundary(pixels.edges, directions, scale, &samples->boundary, &textures->boundary);
  BoundaryFiller rough_boundary(pixels.rough_edges, directions, scale, &samples->rough_boundary,
                                &textures->rough_boundary);
  BoundaryFiller unseen_boundary(pixels.unseen_edges, directions, scale, &samples->unseen_boundary,
                                 &textures->unseen_boundary);
  for (size_t i = 0; i < pixels.hull.size(); i += hn::Lanes(d)) {
    const Gather gather(hn::LoadU(IndexLanes(), pixels.hull.data() + i));
    const Doubles3 position = gather(surfaces.ws_position);
    const Rays rays{Plus(Times(linear, position), offset), Times(linear, gather(surfaces.ws_dx1)),
                    Times(linear, gather(surfaces.ws_dx2)),
                    ray_space.is_directional() ? Dot(position, direction) : hn::Set(d, 1.0)};
    const auto store = [&](const Doubles3& v, std::vector<glm::dvec3>* to) {
      hn::StoreInterleaved3(v.x, v.y, v.z, d, &(*to)[i].x);
    };
    store(rays.r, &samples->hull_rays);
    store(rays.dx1, &samples->hull_rays_dx1);
    store(rays.dx2, &samples->hull_rays_dx2);
    hn::StoreU(rays.q, d, samples->hull_along_ray.data() + i);
    const auto seen = [&] {
      return hn::PromoteTo(LongLanes(), hn::LoadU(IndexLanes(), patterns.data() + i));
    };
    const auto tails = [&] { return hn::LoadU(d, pixels.tail.data() + i); };
    boundary.Add(i, rays, seen, tails);
    rough_boundary.Add(i, rays, seen, tails);
    unseen_boundary.Add(
        i, rays, [] { return hn::Set(LongLanes(), kTexture); }, [&] { return hn::Zero(d); });
  }
  boundary.Finish();
  rough_boundary.Finish();
  unseen_boundary.Finish();
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {

HWY_EXPORT(Fill);

void FillSamples(const PixelSurfaces& surfaces, const LightPixels& pixels,
                 const LaneList<EdgePattern>& patterns, const EdgeDirections& directions,
                 const glm::dvec2& scale, const RaySpace& ray_space, SampledTextures* textures,
                 LightSamples* samples) {
  static_assert(sizeof(glm::dvec3) == 3 * sizeof(double));
  const auto resize_hull = [samples](size_t size) {
    samples->hull_rays.resize(size);
    samples->hull_along_ray.resize(size);
    samples->hull_rays_dx1.resize(size);
    samples->hull_rays_dx2.resize(size);
  };
  resize_hull(pixels.hull.size() + kMostLanes);
  samples->boundary.Resize(pixels.edges.pixels + kMostLanes);
  samples->rough_boundary.Resize(pixels.rough_edges.pixels + kMostLanes);
  samples->unseen_boundary.Resize(pixels.unseen_edges.pixels + kMostLanes);
  textures->boundary.Reserve(pixels.edges.pixels);
  textures->rough_boundary.Reserve(pixels.rough_edges.pixels);
  textures->unseen_boundary.Reserve(pixels.unseen_edges.pixels);
  HWY_DYNAMIC_DISPATCH(Fill)
  (surfaces, pixels, patterns, directions, scale, ray_space, textures, samples);
  resize_hull(pixels.hull.size());
}

}  // namespace shadowfit
#endif
