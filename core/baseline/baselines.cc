#include "core/baseline/baselines.h"

#include "core/baseline/methods.h"

namespace shadowfit {
namespace {

class Baseline final : public LightMatrixMethod {
 public:
  using FitFunction = absl::StatusOr<LightFit> (*)(const LightProblem&);

  explicit Baseline(FitFunction fit) : fit_(fit) {}
  absl::StatusOr<LightFit> Fit(const LightProblem& problem) const override { return fit_(problem); }

 private:
  FitFunction fit_;
};

}  // namespace

std::unique_ptr<LightMatrixMethod> MakeBaseline(Method method) {
  switch (method) {
    case Method::kNormal:
      return std::make_unique<Baseline>(&FitNormal);
    case Method::kFocused:
      return std::make_unique<Baseline>(&FitFocused);
    case Method::kLispsm:
      return std::make_unique<Baseline>(&FitLispsm);
    case Method::kPlaneOptimal:
      return std::make_unique<Baseline>(&FitPlaneOptimal);
    case Method::kSphereStable:
      return std::make_unique<Baseline>(&FitSphereStable);
    case Method::kDefault:
    case Method::kPaper:
      break;
  }
  return nullptr;
}

}  // namespace shadowfit
