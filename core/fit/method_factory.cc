#include "core/fit/method_factory.h"

#include "core/fit/paper_method.h"

namespace shadowfit {

std::unique_ptr<LightMatrixMethod> MakeMethod(const Options& options) {
  return std::make_unique<PaperMethod>(options.paper);
}

}  // namespace shadowfit
