#include "firmware_app/link/parameters.h"

namespace godwit::link {
namespace {
bool allowed(std::size_t i, std::int64_t value) {
  return value >= kParameterTable[i].min && value <= kParameterTable[i].max;
}
}  // namespace

ParameterSet::ParameterSet(const ParameterValues& defaults, const ParameterValues& now) {
  for (std::size_t i = 0; i < kParameters; ++i) {
    defaults_[i] = allowed(i, defaults[i]) ? defaults[i] : kParameterTable[i].fallback;
    values_[i] = allowed(i, now[i]) ? now[i] : defaults_[i];
  }
}

bool ParameterSet::set(Parameter p, std::int64_t value) {
  const auto i = static_cast<std::size_t>(p);
  if (i >= kParameters || !allowed(i, value)) return false;
  values_[i] = value;
  return true;
}

Parameter ParameterSet::find(std::string_view name) {
  for (std::size_t i = 0; i < kParameters; ++i) {
    if (name == kParameterTable[i].name) return static_cast<Parameter>(i);
  }
  return Parameter::kCount;
}

}  // namespace godwit::link
