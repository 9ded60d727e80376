#include "core/fit/method_factory.h"

#include "core/baseline/baselines.h"
#include "core/fit/default_method.h"
#include "core/fit/paper_method.h"

namespace shadowfit {

std::unique_ptr<LightMatrixMethod> MakeMethod(const Options& options) {
  if (std::unique_ptr<LightMatrixMethod> baseline = MakeBaseline(options.method)) return baseline;
  if (options.method == Method::kPaper) return std::make_unique<PaperMethod>(options.paper);
  return std::make_unique<DefaultMethod>(options.standard);
}

}  // namespace shadowfit
