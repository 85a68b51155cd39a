# Cross build of hal/rt and vo_core for aarch64, run under qemu's user emulation.
# Needs the Debian packages g++-aarch64-linux-gnu, qemu-user-static and googletest (sources). Eigen and Highway are used
# as headers alone, which are the same on every architecture, so the host's serve; nothing of arm64 is installed on the
# host, and nothing else of the host is found.
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR aarch64)
set(CMAKE_C_COMPILER aarch64-linux-gnu-gcc)
set(CMAKE_CXX_COMPILER aarch64-linux-gnu-g++)
set(CMAKE_CROSSCOMPILING_EMULATOR qemu-aarch64-static -L /usr/aarch64-linux-gnu)

set(CMAKE_FIND_ROOT_PATH /usr/aarch64-linux-gnu)
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_PACKAGE ONLY)
set(Eigen3_DIR /usr/share/eigen3/cmake CACHE PATH "Eigen's CMake package")
set(GODWIT_HIGHWAY_HEADERS /usr/include CACHE PATH "Folder that holds hwy/highway.h, if not found by pkg-config")
set(GODWIT_GTEST_SOURCE /usr/src/googletest CACHE PATH "GoogleTest to be built with the cross compiler")
