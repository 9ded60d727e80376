#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <memory>
#include <span>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "core/cancellation.h"
#include "core/frame/camera.h"
#include "core/frame/images.h"
#include "core/irregular/mask_scene.h"
#include "core/math/light.h"

namespace shadowfit {

/// Alias-free shadow masks: for every visible sample the answer of its shadow ray, at a cost that depends on
/// samples and triangles and not on a map's resolution (Aila and Laine, Alias-Free Shadow Maps, EGSR 2004).
///
/// Samples are brought into the light's ray coordinates r (RaySpace) and sorted into cells of the light's
/// image plane; triangles are streamed over the cells they cover, and tested against the samples there. A
/// triangle (a,b,c) blocks the sample at r where r is in the cone of a, b, c (three triple products share a
/// sign) and behind the triangle's plane. There is no projection in the test and no map orientation, hence no
/// seam, and no triangle needs clipping.
///
/// Accuracy. The outcome may differ from exact arithmetic only
///
///   - where the shadow ray passes within 8 * 2^-24 radians of a triangle's edge, as seen from the light, or
///     for a directional light within 8 * 2^-24 of the edge's coordinates relative to the samples' centre,
///     each times (2 + longest edge squared over twice the area) at the tips of slivers;
///
///   - where the sample lies within its error bound of the triangle's plane. The bound is derived, not tuned:
///     how far the sample moves along its view ray when its depth changes by the rounding of its format and
///     of a single-precision projection (3 * 2^-24), plus 4 * 2^-24 of the world coordinates and 16 * 2^-24
///     of the distance to the light. Within it a triangle is taken to be the sample's own surface and blocks
///     nothing. (A sample is where its depth says. Against rays from the exact surface, the depth's rounding
///     turns the shadow ray as well, by as much as it moves the sample across it.)
///
/// A sample within the bound of two triangles, and certainly behind none, is undecided: reported lit and
/// counted. Results are bitwise the same for any number of threads, and for every method.

/// How a mask's samples and triangles find each other.
enum class MaskMethod {
  kGrid,        ///< "default": rows of cells of about equal population, triangles rasterised over them.
  kBsp,         ///< "bsp": the paper's hierarchy, median splits with leaves of 64 samples. For comparison.
  kExhaustive,  ///< "exhaustive": every triangle against every sample. For tests.
};

/// How the work is cut; the answer is the same.
enum class MaskPieces {
  kAuto,   ///< kSmall up to kMostTrianglesOfPieces, kFrame with more.
  kSmall,  ///< Pieces of the frame whose samples stay in the second-level cache, each rendered by one thread.
  kFrame,  ///< All of the frame at once, so that each triangle is looked at once. Only for kGrid.
};

inline constexpr size_t kMostTrianglesOfPieces = 1 << 16;

enum class MaskOutput {
  /// One bit a sample. A semi-transparent caster blocks where the mean of its channels' transmittance is
  /// below one half, as in the reference, and is ignored elsewhere.
  kBits,
  /// RGB8 a sample beside the bits: the product of the transmittances of all blockers, 255 = all light
  /// arrives. Bits are then set behind opaque casters only.
  kTransmittance,
  /// One byte a pixel beside the bits: the share of its samples, of all layers together, that light reaches;
  /// 255 = all. Background and samples outside a spot's cone do not count; without samples it is 255.
  kCoverage,
};

/// What the depth values went through before they became float; decides the error bound.
enum class DepthPrecision { kFloat32, kUnorm24, kUnorm16, kFloat16 };

/// One visible sample a pixel. Several samples a pixel (multisampling) are several layers with different
/// pixel_offset; semi-transparent receivers are several layers with the same one.
struct ReceiverLayer {
  DepthView depth;
  glm::dvec2 pixel_offset{0.5, 0.5};  ///< Of the sample in its pixel, from the lower left corner, in [0,1].
  ImageView<glm::vec3>
      ws_normals;  ///< Optional. Receivers facing away from the light are in shadow untested.
  ImageView<glm::vec3> ws_positions;  ///< Optional, instead of depth: world positions; NaN is background.
};

/// Where an instance of the scene is in this frame.
struct MovedInstance {
  size_t instance = 0;
  glm::mat4x3 world_from_object{1.0f};
};

/// What is known of a pixel's shadow before its mask is rendered.
enum class KnownShadow : uint8_t { kUnknown = 0, kLit = 1, kShadowed = 2 };

/// For hybrid masks: the answers of a shadow map (not 0: in shadow; rows packed) as KnownShadow, but unknown
/// where another answer is within `radius` pixels: maps err along the edges of their shadows.
std::vector<uint8_t> KnownAwayFromEdges(std::span<const uint8_t> in_shadow, int width, int height,
                                        int radius);

struct MaskRequest {
  const MaskScene* scene = nullptr;
  const Camera* camera = nullptr;  ///< May be null if all layers have positions.
  std::span<const ReceiverLayer> layers;
  std::span<const Light> lights;
  /// Instances that are elsewhere than the scene says, none twice. The scene itself is not changed, so that
  /// many frames can share it; costs one pass over these instances' vertices.
  std::span<const MovedInstance> moved_instances;
  /// Optional: KnownShadow of each pixel, for light i and layer j at i * layers.size() + j. What is known is
  /// taken over and costs next to nothing; the rest is rendered.
  std::span<const ImageView<uint8_t>> known;
  DepthPrecision depth_precision = DepthPrecision::kFloat32;
  MaskOutput output = MaskOutput::kBits;
  MaskMethod method = MaskMethod::kGrid;
  MaskPieces pieces = MaskPieces::kAuto;
  const Cancellation* cancellation = nullptr;
};

/// Milliseconds of each phase: those of all threads together where the frame is cut into small pieces,
/// elapsed ones where it is one piece.
struct MaskTimings {
  double plan = 0;     ///< Of the light, from few samples; and where it sees the casters.
  double project = 0;  ///< Samples to plane coordinates.
  double sort = 0;     ///< Into cells, or the BSP.
  double walk = 0;     ///< Triangles over samples.
  double resolve = 0;  ///< Answers back to pixels.
  double Total() const { return plan + project + sort + walk + resolve; }
};

/// One light's masks of all layers. The memory belongs to the renderer.
struct LightMask {
  /// Layer after layer, row 0 (the bottom) first, bytes_per_row each; bit x % 8 of byte x / 8 of a row is set
  /// where pixel x is in shadow. Background, samples outside a spot's cone and the padding of rows are clear.
  std::span<const uint8_t> bits;
  size_t bytes_per_row = 0;           ///< A multiple of 2.
  std::span<const uint8_t> rgb;       ///< kTransmittance: layer after layer, width * height * 3 bytes each.
  std::span<const uint8_t> coverage;  ///< kCoverage: width * height bytes, whatever the number of layers.
  size_t samples = 0;                 ///< Not background.
  size_t known_samples = 0;           ///< Taken over from MaskRequest::known.
  size_t facing_away_samples = 0;     ///< Decided by their normals; in shadow.
  size_t outside_cone_samples = 0;    ///< Decided by the spot's cone; their bits are clear.
  size_t shadowed_samples = 0;        ///< Set bits.
  size_t undecided_samples = 0;       ///< See above; reported lit.
  int faces = 0;                      ///< Planes of projection that the sample layout used.
  MaskTimings milliseconds;

  bool InShadow(size_t layer, int height, int x, int y) const {
    const size_t row = layer * static_cast<size_t>(height) + static_cast<size_t>(y);
    return (bits[row * bytes_per_row + static_cast<size_t>(x) / 8] >> (x % 8) & 1) != 0;
  }
};

/// Renders masks; keeps its memory between calls, so that a stream of frames of one size allocates only for
/// the first. One call at a time. Runs on the calling thread's task arena; limit threads with
/// tbb::task_arena.
class MaskRenderer {
 public:
  /// Layers are at most this wide and high.
  static constexpr int kMaxSize = 32768;
  /// Samples of all layers, rows padded to 16.
  static constexpr size_t kMaxPixels = size_t{1} << 28;

  MaskRenderer();
  ~MaskRenderer();
  MaskRenderer(MaskRenderer&&) noexcept;
  MaskRenderer& operator=(MaskRenderer&&) noexcept;

  /// Masks of all lights, in their order; valid until the next call. InvalidArgument names the field, as
  /// "lights[1].spot.direction: zero-length vector" or "layers[0].depth: size 0x4". ResourceExhausted where
  /// memory runs out, Cancelled or DeadlineExceeded within milliseconds of the request's cancellation asking
  /// for it.
  absl::StatusOr<std::span<const LightMask>> Render(const MaskRequest& request);

  size_t MemoryBytes() const;

 private:
  struct Workspace;
  std::unique_ptr<Workspace> workspace_;
};

std::string_view MaskMethodName(MaskMethod method);
/// InvalidArgument where the name is none of "default", "bsp", "exhaustive".
absl::StatusOr<MaskMethod> ParseMaskMethod(std::string_view name);

}  // namespace shadowfit
