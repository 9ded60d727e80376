#include "core/irregular/sample_layout.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>
#include <utility>

namespace shadowfit::irregular {
namespace {

/// Where samples are evenly spread a row is as high as so many of them ...
constexpr double kRowHeight = 8.0;
/// ... and a cell holds so many: a run of cells then overshoots a small triangle by little.
constexpr double kSamplesOfCell = 4.0;
constexpr double kMostRows = 1 << 10;
/// Their borders are those of bins, of which there are so many to an average row.
constexpr double kBinsOfRow = 32.0;
constexpr double kMostBins = 4096.0;
constexpr double kMostColumns = 1 << 14;

constexpr uint32_t kBspLeaf = 64;

void BuildNode(std::span<const glm::vec3> uvw, std::span<uint32_t> order, uint32_t first, uint32_t end,
               const Cancellation* cancellation, std::vector<BspNode>* nodes) {
  BspNode node;
  node.u_min = node.v_min = std::numeric_limits<float>::infinity();
  node.u_max = node.v_max = node.farthest = -node.u_min;
  for (uint32_t i = first; i < end; ++i) {
    const glm::vec3& p = uvw[order[i]];
    node.u_min = std::min(node.u_min, p.x);
    node.u_max = std::max(node.u_max, p.x);
    node.v_min = std::min(node.v_min, p.y);
    node.v_max = std::max(node.v_max, p.y);
    node.farthest = std::max(node.farthest, p.z);
  }
  node.first_sample = first;
  node.end_sample = end;
  const size_t at = nodes->size();
  nodes->push_back(node);
  if (end - first <= kBspLeaf || IsCancelled(cancellation)) return;
  const int axis = node.u_max - node.u_min >= node.v_max - node.v_min ? 0 : 1;
  const uint32_t middle = first + (end - first) / 2;
  std::nth_element(order.begin() + first, order.begin() + middle, order.begin() + end,
                   [&](uint32_t a, uint32_t b) {
                     return uvw[a][axis] != uvw[b][axis] ? uvw[a][axis] < uvw[b][axis] : a < b;
                   });
  BuildNode(uvw, order, first, middle, cancellation, nodes);
  (*nodes)[at].right = static_cast<int32_t>(nodes->size());
  BuildNode(uvw, order, middle, end, cancellation, nodes);
}

}  // namespace

glm::dvec3 SingleFaceAxis(std::span<const glm::vec3> rays) {
  glm::dvec3 sum(0.0);
  for (const glm::vec3& r : rays) {
    const double length = glm::length(glm::dvec3(r));
    if (length > 0.0) sum += glm::dvec3(r) / length;
  }
  const double length = glm::length(sum);
  if (!(length > 1e-6 * static_cast<double>(rays.size()))) return glm::dvec3(0.0);
  // Towards the middle of the cone around all of them: again and again a step, ever smaller, towards the ray
  // that is farthest off (Badoiu and Clarkson, Smaller core-sets for balls, SODA 2003).
  glm::dvec3 axis = sum / length;
  constexpr int kSteps = 24;
  for (int step = 1; step <= kSteps; ++step) {
    double least = 1.0;
    glm::dvec3 farthest = axis;
    for (const glm::vec3& ray : rays) {
      const glm::dvec3 r(ray);
      const double along = glm::dot(axis, r), length2 = glm::dot(r, r);
      // Compares along / length without a root for each.
      const double cosine = along * std::abs(along) / length2;
      if (cosine < least) least = cosine, farthest = r;
    }
    // 66 degrees; the face itself reaches to 75, which leaves room for what was not among these rays. On the
    // way there is time to stop short of the middle.
    if (least >= 0.25) return axis;
    if (step == kSteps) return least >= 0.16 ? axis : glm::dvec3(0.0);
    axis = glm::normalize(axis + (glm::normalize(farthest) - axis) / static_cast<double>(step + 1));
  }
  return glm::dvec3(0.0);
}

void BasisAround(const glm::dvec3& axis, const glm::dvec3& second_hint, double rotation[3][3]) {
  glm::dvec3 second = second_hint - glm::dot(second_hint, axis) * axis;
  if (!(glm::dot(second, second) > 1e-6 * glm::dot(second_hint, second_hint))) {
    const glm::dvec3 a = glm::abs(axis);
    const glm::dvec3 helper = a.x <= a.y && a.x <= a.z ? glm::dvec3(1, 0, 0)
                              : a.y <= a.z             ? glm::dvec3(0, 1, 0)
                                                       : glm::dvec3(0, 0, 1);
    second = helper - glm::dot(helper, axis) * axis;
  }
  second = glm::normalize(second);
  const glm::dvec3 first = glm::cross(second, axis);
  for (int i = 0; i < 3; ++i) {
    rotation[0][i] = first[i];
    rotation[1][i] = second[i];
    rotation[2][i] = axis[i];
  }
}

void PlanFace(std::span<const glm::vec2> uv, double samples, Face* face) {
  const double wanted_rows = std::clamp(std::sqrt(samples) / kRowHeight, 1.0, kMostRows);
  face->columns = static_cast<int>(std::clamp(samples / (wanted_rows * kSamplesOfCell), 1.0, kMostColumns));

  // 1. Bins of v, then rows of bins of about equal population.
  // A face of which no sample is known may get some all the same: they lie in the one row that there is.
  const int bins = static_cast<int>(std::min(std::ceil(wanted_rows * kBinsOfRow), kMostBins));
  face->v_origin = uv.empty() ? 0.0f : face->v_min;
  const float height = uv.empty() ? 0.0f : face->v_max - face->v_min;
  face->v_scale = height > 0.0f ? std::min(static_cast<float>(bins) / height, 1e30f) : 0.0f;
  // Until the rows are known: how many samples, and their least and largest u.
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  face->row_of_bin.assign(static_cast<size_t>(bins), Row{0, 0, kInfinity, -kInfinity});
  for (const glm::vec2& p : uv) {
    Row& bin = face->row_of_bin[face->BinAt(p.y)];
    ++bin.number;
    bin.u_origin = std::min(bin.u_origin, p.x);
    bin.u_scale = std::max(bin.u_scale, p.x);
  }
  const double quota = std::max(static_cast<double>(uv.size()) / wanted_rows, 1.0);
  double taken = 0.0;
  int row = 0;
  face->first_bin_of_row.assign(1, 0);
  face->row_v_low.clear();
  face->row_v_high.clear();
  const auto border = [face](int bin) {
    // Bins of samples come from rounded arithmetic: a hundredth of a bin and a few units in the last place.
    const double bin_height = face->v_scale > 0.0f ? 1.0 / static_cast<double>(face->v_scale) : 0.0;
    const double v = static_cast<double>(face->v_origin) + bin * bin_height;
    const double slack = 0.01 * bin_height + 4.0 * static_cast<double>(kUnitRoundoff) * std::abs(v);
    return std::pair(static_cast<float>(v - slack), static_cast<float>(v + slack));
  };
  face->row_v_low.push_back(-std::numeric_limits<float>::infinity());
  for (int bin = 0; bin < bins; ++bin) {
    const double population = face->row_of_bin[static_cast<size_t>(bin)].number;
    if (taken > 0.0 && taken + 0.5 * population > quota && face->v_scale > 0.0f) {
      ++row;
      taken = 0.0;
      face->first_bin_of_row.push_back(bin);
      face->row_v_high.push_back(border(bin).second);
      face->row_v_low.push_back(border(bin).first);
    }
    taken += population;
  }
  face->first_bin_of_row.push_back(bins);
  face->row_v_high.push_back(std::numeric_limits<float>::infinity());
  face->rows = row + 1;
  const auto padded_rows = static_cast<size_t>(face->rows) + kPadding;
  face->row_v_low.resize(padded_rows, std::numeric_limits<float>::infinity());
  face->row_v_high.resize(padded_rows, std::numeric_limits<float>::infinity());

  // 2. Each row's range of u, a little wider than its typical samples.
  const auto range_of = [face](int first_bin, int end_bin) {
    float low = kInfinity, high = -kInfinity;
    for (int bin = first_bin; bin < end_bin; ++bin) {
      low = std::min(low, face->row_of_bin[static_cast<size_t>(bin)].u_origin);
      high = std::max(high, face->row_of_bin[static_cast<size_t>(bin)].u_scale);
    }
    return std::pair(low, high);
  };
  auto all = range_of(0, bins);
  if (uv.empty()) all = {0.0f, 0.0f};
  const float least_width = std::max((all.second - all.first) / 64.0f, 1e-30f);
  for (int r = 0; r < face->rows; ++r) {
    const int first_bin = face->first_bin_of_row[static_cast<size_t>(r)];
    const int end_bin = face->first_bin_of_row[static_cast<size_t>(r) + 1];
    auto [low, high] = range_of(first_bin, end_bin);
    if (!(low <= high)) std::tie(low, high) = all;
    const float width = std::max(high - low, least_width);
    const Row row = {r, r * face->columns, low - width / 32.0f,
                     static_cast<float>(face->columns) / (width * (1.0f + 2.0f / 32.0f))};
    std::fill(face->row_of_bin.begin() + first_bin, face->row_of_bin.begin() + end_bin, row);
  }
}

void BuildBsp(std::span<const glm::vec3> uvw, std::span<uint32_t> order, const Cancellation* cancellation,
              std::vector<BspNode>* nodes) {
  nodes->clear();
  if (!order.empty()) BuildNode(uvw, order, 0, static_cast<uint32_t>(order.size()), cancellation, nodes);
}

}  // namespace shadowfit::irregular
