#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/budget/map_sizing.h"

namespace shadowfit {

/// Ways to make a light matrix; the names are those of the command line and the wire.
enum class Method {
  kDefault,       ///< "default": the best that this library knows.
  kPaper,         ///< "paper": TR-07-07, Algorithm 1, as published.
  kNormal,        ///< "normal": the light's own frustum around the scene.
  kFocused,       ///< "focused": Normal, limited to the view frustum.
  kLispsm,        ///< "lispsm": light-space perspective shadow maps (Wimmer, Scherzer, Purgathofer 2004).
  kPlaneOptimal,  ///< "plane_optimal": Chong, Gortler 2004.
  kSphereStable,  ///< "sphere_stable": a sphere around the view frustum, snapped to texels.
};

std::string_view MethodName(Method method);
std::optional<Method> MethodFromName(std::string_view name);
/// All methods in the order of the enumeration.
const std::vector<Method>& AllMethods();

/// The knobs of TR-07-07's Algorithm 1, at their published values.
struct PaperOptions {
  /// Gradient steps ("three iterations of gradient descent were sufficient").
  int iterations = 3;
  /// Candidate rotations of the axis in degrees; the negative one forces exploration.
  std::vector<double> angles_degrees = {-10, 3, 5, 9, 16, 23, 30, 40, 50};
  /// Section 2.3's heuristic shear of the minimum-area rectangle.
  bool skew = true;
  /// "We increase the rectangle size slightly" (2.4): the fraction of the map's width and height left as a
  /// border on each side.
  double border = 0.02;
  /// Step 5: the previous frame's matrix stays unless the median badness falls below this share of its own. 0
  /// turns hysteresis off.
  double sufficient_improvement = 0.8;
};

/// Cube faces hold any light: no light needs more.
inline constexpr int kMostMaps = 6;

/// The knobs of the default method.
struct DefaultOptions {
  /// Let the map's width and height vary at a fixed number of texels.
  bool free_aspect = false;
  /// Maps that one light may get, 1 to kMostMaps, sharing the texels of the one asked for, where more maps
  /// are predicted to be better.
  int most_maps = 1;
  /// Whether a light whose receivers no single map holds (they span half of all directions or more) gets as
  /// many maps as it needs: at most `most_maps` where that allows several, else at most kMostMaps. False: one
  /// map holds what it can, and the fit's note says so.
  bool divide_where_needed = true;
  /// Whether maps hold all of the light's shadow that the samples show. Else shadow is let go of, and shown
  /// lit, where the texels that it would take are predicted to save more wrong pixels elsewhere (TrimShadow).
  bool hold_all_shadow = false;
  /// Trades swim for wrong pixels. The previous frame's matrix, rescaled where it must be to hold this
  /// frame's samples, stays while it is predicted to get at most this many times the pixels wrong of a new
  /// one that holds all of the shadow: a new matrix moves all texels at once, which is seen as a flicker
  /// along the edges. Finite, at least 1; or 0: always a new one.
  double keep_within = 1.1;
  /// Samples by which a first look at the previous frame's matrix goes: where they already say that it may
  /// stay, nothing is searched. 0: the search always decides.
  int glance_samples = 128;
  /// Samples that the search looks at; the last steps look at all.
  int search_samples = 512;
  /// Axes on each of the two rings of the first search.
  int search_directions = 8;
  /// The best of the first search start short descents, the best of those go on, and the best of all is
  /// polished over all samples; each with this many evaluations at most.
  int starts = 4;
  int evaluations_per_start = 8;
  int descents = 2;
  int evaluations_per_descent = 30;
  int evaluations_to_polish = 25;
};

struct Options {
  Method method = Method::kDefault;
  PaperOptions paper;
  DefaultOptions standard;
  /// Every method's maps can be sized by budget or tolerance.
  MapSizing sizing;
  /// Fill in LightSummary::quality.
  bool assess_quality = false;
};

}  // namespace shadowfit
