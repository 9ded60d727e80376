#include "core/frame/pixel_surfaces.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/frame/pixel_surfaces.cc"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/math/double_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::HWY_NAMESPACE {

using Lanes = DoubleLanes;
static_assert(hn::MaxLanes(Lanes()) <= PixelList::kPadding);

HWY_INLINE void Store(const Doubles3& v, size_t i, std::vector<double> (&to)[3]) {
  const Lanes d;
  hn::StoreU(v.x, d, to[0].data() + i);
  hn::StoreU(v.y, d, to[1].data() + i);
  hn::StoreU(v.z, d, to[2].data() + i);
}

/// (dX, dw) = world_from_clip (dclip): the change of a homogeneous point by that of its clip coordinates.
struct HomogeneousStep {
  Doubles3 xyz;
  Doubles w;
};

void Unproject(const Camera& camera, int width, int height, const PixelDepths& pixels,
               PixelSurfaces* surfaces) {
  const Lanes d;
  const glm::dmat4& m = camera.world_from_clip();
  const auto xyz = [&m](int column) { return Set(glm::dvec3(m[column])); };
  const auto w = [&](int column) { return hn::Set(d, m[column][3]); };
  // A step of one pixel along screen x or y, the depth's part left out.
  const HomogeneousStep step1{Scaled(xyz(0), hn::Set(d, 2.0 / width)),
                              hn::Mul(w(0), hn::Set(d, 2.0 / width))};
  const HomogeneousStep step2{Scaled(xyz(1), hn::Set(d, 2.0 / height)),
                              hn::Mul(w(1), hn::Set(d, 2.0 / height))};
  const Doubles3 eye = Set(glm::dvec3(camera.ws_eye()));
  const auto eye_w = hn::Set(d, camera.ws_eye().w);
  const auto zero = hn::Zero(d);
  const auto one = hn::Set(d, 1.0);
  const size_t count = pixels.size();
  for (size_t i = 0; i < count; i += hn::Lanes(d)) {
    const auto in = hn::FirstN(d, count - i);
    const auto load = [&](const std::vector<double>& v) { return hn::MaskedLoad(in, d, v.data() + i); };
    const Doubles x = load(pixels.ndc[0]);
    const Doubles y = load(pixels.ndc[1]);
    const Doubles z = load(pixels.ndc[2]);
    const Doubles point_w =
        hn::Add(hn::Add(hn::Mul(w(0), x), hn::Mul(w(1), y)), hn::Add(hn::Mul(w(2), z), w(3)));
    const Doubles inverse_w = hn::Div(one, point_w);
    const Doubles3 position =
        Scaled(Plus(Plus(Scaled(xyz(0), x), Scaled(xyz(1), y)), Plus(Scaled(xyz(2), z), xyz(3))), inverse_w);
    // X = p / p.w, so dX = (dp - X dp.w) / p.w.
    const auto derivative = [&](const HomogeneousStep& step, Doubles dz) {
      const Doubles3 dp = Plus(step.xyz, Scaled(xyz(2), dz));
      const Doubles dw = hn::Add(step.w, hn::Mul(w(2), dz));
      return Scaled(Minus(dp, Scaled(position, dw)), inverse_w);
    };
    const Doubles3 dx1 = derivative(step1, load(pixels.dz1));
    const Doubles3 dx2 = derivative(step2, load(pixels.dz2));
    const Doubles3 normal = Cross(dx1, dx2);
    const Doubles length = hn::Sqrt(Dot(normal, normal));
    const auto regular = hn::And(hn::Gt(length, zero), hn::IsFinite(length));
    const Doubles3 towards_viewer = Minus(eye, Scaled(position, eye_w));
    const Doubles unit = hn::Div(one, length);
    const Doubles scale = hn::IfThenElse(hn::Lt(Dot(normal, towards_viewer), zero), hn::Neg(unit), unit);
    Store(position, i, surfaces->ws_position);
    Store(dx1, i, surfaces->ws_dx1);
    Store(dx2, i, surfaces->ws_dx2);
    Store({hn::IfThenElseZero(regular, hn::Mul(normal.x, scale)),
           hn::IfThenElseZero(regular, hn::Mul(normal.y, scale)),
           hn::IfThenElseZero(regular, hn::Mul(normal.z, scale))},
          i, surfaces->ws_normal);
    uint8_t regular_bits[8] = {};
    hn::StoreMaskBits(d, regular, regular_bits);
    for (size_t lane = 0; lane < hn::Lanes(d) && i + lane < count; ++lane) {
      surfaces->reliable[i + lane] =
          static_cast<uint8_t>(pixels.reliable[i + lane] & (regular_bits[0] >> lane & 1));
    }
  }
}

/// Some listed pixels' elements of arrays.
struct Gather {
  hn::Vec<hn::RebindToSigned<Lanes>> indices;
  explicit Gather(const int32_t* list)
      : indices(hn::PromoteTo(hn::RebindToSigned<Lanes>(), hn::LoadU(hn::Rebind<int32_t, Lanes>(), list))) {}
  Doubles operator()(const std::vector<double>& v) const {
    return hn::GatherIndex(Lanes(), v.data(), indices);
  }
  Doubles3 operator()(const std::vector<double> (&v)[3]) const {
    return {(*this)(v[0]), (*this)(v[1]), (*this)(v[2])};
  }
};

void Cosines(const PixelSurfaces& surfaces, const PixelList& pixels, const RaySpace& ray_space, double* to) {
  const Lanes d;
  const Doubles3 light = Set(ray_space.ws_position());
  const Doubles3 direction = Set(ray_space.ws_direction());
  const auto cos_outer = hn::Set(d, ray_space.cos_outer().value_or(-1.0));
  for (size_t i = 0; i < pixels.size(); i += hn::Lanes(d)) {
    const Gather gather(pixels.data() + i);
    const Doubles3 normal = gather(surfaces.ws_normal);
    if (ray_space.is_directional()) {
      hn::StoreU(hn::Neg(Dot(normal, direction)), d, to + i);
      continue;
    }
    const Doubles3 from_light = Minus(gather(surfaces.ws_position), light);
    const Doubles distance = hn::Sqrt(Dot(from_light, from_light));
    Doubles cosine = hn::Div(hn::Neg(Dot(normal, from_light)), distance);
    if (ray_space.cos_outer()) {
      const auto lit = hn::Ge(Dot(from_light, direction), hn::Mul(cos_outer, distance));
      cosine = hn::IfThenElse(lit, cosine, hn::Set(d, kUnlit));
    }
    hn::StoreU(cosine, d, to + i);
  }
}

/// `to` has room for the list, padded.
void Hull(const PixelSurfaces& surfaces, const PixelList& pixels, const RaySpace& ray_space,
          LightSamples* to) {
  const Lanes d;
  const glm::dmat3& linear = ray_space.linear();
  const Doubles3 offset = Set(ray_space.offset());
  const Doubles3 direction = Set(ray_space.ws_direction());
  const auto store = [&](const Doubles3& v, glm::dvec3* at) {
    hn::StoreInterleaved3(v.x, v.y, v.z, d, &at->x);
  };
  for (size_t i = 0; i < pixels.size(); i += hn::Lanes(d)) {
    const Gather gather(pixels.data() + i);
    const Doubles3 position = gather(surfaces.ws_position);
    store(Plus(Times(linear, position), offset), to->hull_rays.data() + i);
    store(Times(linear, gather(surfaces.ws_dx1)), to->hull_rays_dx1.data() + i);
    store(Times(linear, gather(surfaces.ws_dx2)), to->hull_rays_dx2.data() + i);
    hn::StoreU(ray_space.is_directional() ? Dot(position, direction) : hn::Set(d, 1.0), d,
               to->hull_along_ray.data() + i);
  }
}

}  // namespace shadowfit::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace shadowfit {
namespace {

HWY_EXPORT(Unproject);
HWY_EXPORT(Cosines);
HWY_EXPORT(Hull);

size_t PaddedSize(size_t count) {
  constexpr size_t kLanes = PixelList::kPadding;
  return (count + kLanes - 1) / kLanes * kLanes;
}

}  // namespace

void PixelDepths::Clear() {
  for (std::vector<double>& axis : ndc) axis.clear();
  dz1.clear();
  dz2.clear();
  reliable.clear();
}

void PixelDepths::Reserve(size_t count) {
  for (std::vector<double>& axis : ndc) axis.reserve(count);
  dz1.reserve(count);
  dz2.reserve(count);
  reliable.reserve(count);
}

void UnprojectPixels(const Camera& camera, int width, int height, const PixelDepths& pixels,
                     PixelSurfaces* surfaces) {
  for (auto* vectors : {&surfaces->ws_position, &surfaces->ws_dx1, &surfaces->ws_dx2, &surfaces->ws_normal}) {
    for (std::vector<double>& axis : *vectors) axis.resize(PaddedSize(pixels.size()));
  }
  surfaces->reliable.resize(pixels.size());
  HWY_DYNAMIC_DISPATCH(Unproject)(camera, width, height, pixels, surfaces);
}

void LightCosines(const PixelSurfaces& surfaces, const PixelList& pixels, const RaySpace& ray_space,
                  std::vector<double>* cosines) {
  cosines->resize(PaddedSize(pixels.size()));
  HWY_DYNAMIC_DISPATCH(Cosines)(surfaces, pixels, ray_space, cosines->data());
  cosines->resize(pixels.size());
}

void FillHull(const PixelSurfaces& surfaces, const PixelList& pixels, const RaySpace& ray_space,
              LightSamples* samples) {
  static_assert(sizeof(glm::dvec3) == 3 * sizeof(double));
  const auto resize = [samples](size_t size) {
    samples->hull_rays.resize(size);
    samples->hull_along_ray.resize(size);
    samples->hull_rays_dx1.resize(size);
    samples->hull_rays_dx2.resize(size);
  };
  resize(PaddedSize(pixels.size()));
  HWY_DYNAMIC_DISPATCH(Hull)(surfaces, pixels, ray_space, samples);
  resize(pixels.size());
}

}  // namespace shadowfit
#endif
