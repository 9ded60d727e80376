#pragma once

#include <memory>

#include "core/fit/light_problem.h"
#include "core/fit/options.h"

namespace shadowfit {

/// The method that the options name, with their settings.
std::unique_ptr<LightMatrixMethod> MakeMethod(const Options& options);

}  // namespace shadowfit
