#include "core/fit/method_factory.h"

#include "core/baseline/baselines.h"
#include "core/fit/paper_method.h"

namespace shadowfit {

std::unique_ptr<LightMatrixMethod> MakeMethod(const Options& options) {
  if (std::unique_ptr<LightMatrixMethod> baseline = MakeBaseline(options.method)) return baseline;
  return std::make_unique<PaperMethod>(options.paper);
}

}  // namespace shadowfit
