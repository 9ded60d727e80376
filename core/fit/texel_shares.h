#pragma once

#include <algorithm>
#include <cmath>
#include <numeric>
#include <span>
#include <vector>

namespace shadowfit {

/// The sum over maps of c_k / sqrt(t_k), times sqrt(T), where their T texels are shared out best: where the
/// derivatives c_k / t_k^(3/2) are equal, so that t_k is proportional to c_k^(2/3), and the sum is
///
///   (sum c_k^(2/3))^(3/2).
inline double CostAtBestShares(std::span<const double> costs) {
  double sum = 0.0;
  for (const double cost : costs) sum += std::cbrt(cost * cost);
  return sum * std::sqrt(sum);
}

/// Share that a map gets at least, of an equal one.
inline constexpr double kLeastShare = 0.2;

/// Those shares, but none less than kLeastShare says: a map holds more than its part's samples,
/// lit ones foremost, and next to another part's shadow a few huge texels would darken many of those.
inline std::vector<double> SharesOfTexels(std::span<const double> costs) {
  std::vector<double> shares;
  for (const double cost : costs) shares.push_back(std::cbrt(cost * cost));
  const double least =
      kLeastShare * std::accumulate(shares.begin(), shares.end(), 1e-30) / static_cast<double>(shares.size());
  for (double& share : shares) share = std::max(share, least);
  const double sum = std::accumulate(shares.begin(), shares.end(), 0.0);
  for (double& share : shares) share /= sum;
  return shares;
}

}  // namespace shadowfit
