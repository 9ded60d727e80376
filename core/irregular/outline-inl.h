// What a triangle covers of a face, for Highway's per-target code: included once for each target.

#if defined(SHADOWFIT_IRREGULAR_OUTLINE_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef SHADOWFIT_IRREGULAR_OUTLINE_INL_H_
#undef SHADOWFIT_IRREGULAR_OUTLINE_INL_H_
#else
#define SHADOWFIT_IRREGULAR_OUTLINE_INL_H_
#endif

#include <hwy/highway.h>

#include <algorithm>
#include <cmath>

#include "core/irregular/simd.h"

HWY_BEFORE_NAMESPACE();
namespace shadowfit::irregular {
namespace HWY_NAMESPACE {

/// A convex polygon in plane coordinates of a face, which encloses what the triangle covers of it.
struct Outline {
  float u[8], v[8];
  int corners;
  float pad;  ///< By how much rounding may move a sample against it.
  float u_min, u_max, v_min, v_max;
};

HWY_INLINE void MeasureOutline(Outline* o) {
  o->u_min = o->v_min = kInfinity;
  o->u_max = o->v_max = -kInfinity;
  for (int i = 0; i < o->corners; ++i) {
    o->u_min = std::min(o->u_min, o->u[i]);
    o->u_max = std::max(o->u_max, o->u[i]);
    o->v_min = std::min(o->v_min, o->v[i]);
    o->v_max = std::max(o->v_max, o->v[i]);
  }
}

/// Clips a triangle that crosses the light's plane of this face, or spans very much of it, to the samples'
/// rectangle in it: x <= u_max w and so on, which implies w >= 0. False where nothing is left. From corners
/// in double precision: that of a plane which passes the light closely is lost in single precision.
HWY_NOINLINE bool ClippedOutline(const LightFrame& frame, const Face& face, const float* geometry, int lane,
                                 Outline* outline) {
  const auto pad = [](float low, float high) {
    return 1e-3 * (static_cast<double>(high) - static_cast<double>(low)) +
           64.0 * kUnitRoundoff * (1.0 + std::max(std::abs(low), std::abs(high)));
  };
  const double pad_u = pad(face.u_min, face.u_max), pad_v = pad(face.v_min, face.v_max);
  const double planes[4][3] = {{1, 0, pad_u - face.u_min},
                               {-1, 0, pad_u + face.u_max},
                               {0, 1, pad_v - face.v_min},
                               {0, -1, pad_v + face.v_max}};
  // A triangle becomes one of seven corners at most; but rounding lets the edges of one that is hardly more
  // than a line cross a plane again and again.
  constexpr int kMost = 7;
  glm::dvec3 polygon[2 * kMost];  // x, y, w (1 where directional)
  int corners = 3;
  for (int i = 0; i < 3; ++i) {
    glm::dvec3 t, r;
    for (int axis = 0; axis < 3; ++axis) {
      t[axis] = static_cast<double>(geometry[(3 * i + axis) * kBlock + lane]) - frame.ws_origin[axis];
    }
    for (int row = 0; row < 3; ++row) {
      const double* m = face.rotation[row];
      r[row] = m[0] * t.x + m[1] * t.y + m[2] * t.z;
    }
    polygon[i] = {r.x, r.y, frame.directional ? 1.0 : r.z};
  }
  for (const auto& plane : planes) {
    glm::dvec3 kept[2 * kMost];
    int count = 0;
    for (int i = 0; i < corners; ++i) {
      const glm::dvec3& a = polygon[i];
      const glm::dvec3& b = polygon[(i + 1) % corners];
      const double da = plane[0] * a.x + plane[1] * a.y + plane[2] * a.z;
      const double db = plane[0] * b.x + plane[1] * b.y + plane[2] * b.z;
      if (da >= 0.0) kept[count++] = a;
      if ((da >= 0.0) != (db >= 0.0)) kept[count++] = a + (b - a) * (da / (da - db));
    }
    corners = count;
    std::copy(kept, kept + count, polygon);
    if (count == 0) return false;
    if (count > kMost) break;
  }
  // w = 0 happens only at the light itself, which is every direction at once: then, too, all of the face.
  const bool everywhere = corners > kMost || std::any_of(polygon, polygon + corners,
                                                         [](const glm::dvec3& p) { return !(p.z > 0.0); });
  if (everywhere) {
    *outline = {{face.u_min, face.u_max, face.u_max, face.u_min},
                {face.v_min, face.v_min, face.v_max, face.v_max},
                4,
                0,
                0,
                0,
                0,
                0};
  } else {
    outline->corners = corners;
    for (int i = 0; i < corners; ++i) {
      outline->u[i] = static_cast<float>(polygon[i].x / polygon[i].z);
      outline->v[i] = static_cast<float>(polygon[i].y / polygon[i].z);
    }
  }
  MeasureOutline(outline);
  return true;
}

}  // namespace HWY_NAMESPACE
}  // namespace shadowfit::irregular
HWY_AFTER_NAMESPACE();

#endif
