#include <cerrno>
#include <fcntl.h>
#include <linux/spi/spidev.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "hal/imu/mpu6000/spi_port.h"
#include "hal/rt/wake_up.h"

namespace godwit::hal {
namespace {

class SpidevPort final : public SpiPort {
 public:
  SpidevPort() = default;
  ~SpidevPort() override { close(); }
  SpidevPort(const SpidevPort&) = delete;
  SpidevPort& operator=(const SpidevPort&) = delete;

  bool open(const char* path, std::uint32_t speed_hz) override {
    close();
    fd_ = ::open(path, O_RDWR | O_CLOEXEC);
    if (fd_ < 0) return false;
    std::uint8_t mode = SPI_MODE_0, bits = 8;
    speed_hz_ = speed_hz;
    if (ioctl(fd_, SPI_IOC_WR_MODE, &mode) == 0 && ioctl(fd_, SPI_IOC_WR_BITS_PER_WORD, &bits) == 0) return true;
    const int error = errno;
    close();
    errno = error;
    return false;
  }
  void close() override {
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
  }
  bool transfer(const std::uint8_t* tx, std::uint8_t* rx, std::size_t bytes) override {
    spi_ioc_transfer t{};
    t.tx_buf = reinterpret_cast<std::uintptr_t>(tx);
    t.rx_buf = reinterpret_cast<std::uintptr_t>(rx);
    t.len = static_cast<std::uint32_t>(bytes);
    t.speed_hz = speed_hz_;
    return ioctl(fd_, SPI_IOC_MESSAGE(1), &t) == static_cast<int>(bytes);
  }
  rt::TimeNs now_ns() override { return rt::monotonic_now_ns(); }
  void sleep_until(rt::TimeNs t_ns) override { rt::sleep_until_ns(t_ns); }

 private:
  int fd_ = -1;
  std::uint32_t speed_hz_ = 0;
};

}  // namespace

std::unique_ptr<SpiPort> spidev_port() {
  return std::make_unique<SpidevPort>();
}

}  // namespace godwit::hal
