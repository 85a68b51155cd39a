#include "firmware_app/output/disc_room.h"

#include <algorithm>
#include <cerrno>
#include <sys/statvfs.h>

namespace godwit::app {

bool has_room(const std::string& folder, const DiscRoom& room, std::uint64_t bytes) {
  struct statvfs disc {};
  if (::statvfs(folder.c_str(), &disc) != 0 || disc.f_blocks == 0) return true;
  const auto in_bytes = [&disc](auto blocks) {
    return static_cast<double>(blocks) * static_cast<double>(disc.f_frsize);
  };
  const double left = std::min(static_cast<double>(room.leave_bytes), room.leave_share * in_bytes(disc.f_blocks));
  if (in_bytes(disc.f_bavail) - static_cast<double>(bytes) > left) return true;
  errno = ENOSPC;
  return false;
}

}  // namespace godwit::app
