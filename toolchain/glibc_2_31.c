/* What GCC 12's libstdc++.a asks of a C library newer than glibc 2.31, given in the words of the old one. Linked into
 * every program that is built against the sysroot (toolchain/aarch64.cmake). */
#include <stdint.h>
#include <stdlib.h>
#include <unistd.h>

/* glibc 2.32: whether no second thread was ever made. "No" is always safe: reference counts stay atomic. */
char __libc_single_threaded = 0;

/* glibc 2.36: std::random_device. */
uint32_t arc4random(void);
uint32_t arc4random(void) {
  uint32_t value;
  if (getentropy(&value, sizeof value) != 0) abort();
  return value;
}
