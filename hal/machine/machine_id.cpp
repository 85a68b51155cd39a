#include "hal/machine/machine_id.h"

#include <algorithm>
#include <cstring>
#include <string>
#include <systemd/sd-id128.h>

namespace godwit::hal {

rt::Result<MachineId> machine_id() {
  // Drawn once, for godwit: another program's id of the same computer is another one.
  // (SD_ID128_MAKE is C99's compound literal, which clang refuses in C++.)
  constexpr sd_id128_t kGodwit{
      .bytes = {0xc1, 0x4b, 0x7e, 0x0d, 0x93, 0x52, 0x4f, 0x8a, 0xb6, 0x1e, 0x2f, 0xd8, 0x70, 0x39, 0xa5, 0x64}};
  sd_id128_t id{};
  if (const int failed = sd_id128_get_machine_app_specific(kGodwit, &id); failed < 0) {
    return rt::Error{std::string("/etc/machine-id: ") + std::strerror(-failed) +
                     ": this computer has no stable id; systemd-machine-id-setup makes one"};
  }
  MachineId out{};
  std::copy(std::begin(id.bytes), std::end(id.bytes), out.begin());
  return out;
}

}  // namespace godwit::hal
