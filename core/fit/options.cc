#include "core/fit/options.h"

#include <array>
#include <utility>

namespace shadowfit {
namespace {

constexpr std::array<std::pair<Method, std::string_view>, 7> kNames = {{
    {Method::kDefault, "default"},
    {Method::kPaper, "paper"},
    {Method::kNormal, "normal"},
    {Method::kFocused, "focused"},
    {Method::kLispsm, "lispsm"},
    {Method::kPlaneOptimal, "plane_optimal"},
    {Method::kSphereStable, "sphere_stable"},
}};

}  // namespace

std::string_view MethodName(Method method) {
  for (const auto& [value, name] : kNames) {
    if (value == method) return name;
  }
  return "unknown";
}

std::optional<Method> MethodFromName(std::string_view name) {
  for (const auto& [value, known] : kNames) {
    if (known == name) return value;
  }
  return std::nullopt;
}

const std::vector<Method>& AllMethods() {
  static const auto* const methods = [] {
    auto* all = new std::vector<Method>;
    for (const auto& [value, name] : kNames) all->push_back(value);
    return all;
  }();
  return *methods;
}

}  // namespace shadowfit
