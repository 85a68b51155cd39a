#include "hal/machine/machine_id.h"

#include <algorithm>
#include <cstring>
#include <string>
#include <systemd/sd-id128.h>

namespace godwit::hal {

rt::Result<MachineId> machine_id() {
  // Drawn once, for godwit: another program's id of the same computer is another one.
  constexpr sd_id128_t kGodwit = SD_ID128_MAKE(c1, 4b, 7e, 0d, 93, 52, 4f, 8a, b6, 1e, 2f, d8, 70, 39, a5, 64);
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
