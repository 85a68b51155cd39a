# Cross build for aarch64 against a sysroot with glibc 2.31 (JetPack 5), run under qemu's user emulation. Needs the Debian
# packages g++-12-aarch64-linux-gnu, qemu-user-static and googletest (sources); the sysroot is made on first use, by
# toolchain/sysroot. Libraries that are headers alone are the machine's own (toolchain/packages).
#
# Debian 12's GCC 12 stays the compiler: GCC 10, which belongs to that C library, has no std::bit_cast, and another compiler
# would be another judge of warnings and of floating point than that of the tests. Only what it links against is older:
#  - C headers and libraries come from the sysroot, C++ headers from GCC 12;
#  - libstdc++ is linked statically, being newer than the target's;
#  - libgcc is the target's libgcc_s.so.1, since GCC 12's libgcc_eh.a wants _dl_find_object of glibc 2.35. The unwinder's
#    interface has been the same since GCC 3;
#  - the few things that libstdc++.a takes from a newer glibc are in glibc_2_31.c.
# tests/package holds every shipped file to GLIBC_2.31.
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR aarch64)
set(CMAKE_C_COMPILER aarch64-linux-gnu-gcc-12)
set(CMAKE_CXX_COMPILER aarch64-linux-gnu-g++-12)
set(CMAKE_LIBRARY_ARCHITECTURE aarch64-linux-gnu)
execute_process(COMMAND ${CMAKE_CURRENT_LIST_DIR}/sysroot arm64 OUTPUT_VARIABLE CMAKE_SYSROOT
                OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
set(CMAKE_CROSSCOMPILING_EMULATOR qemu-aarch64-static -L ${CMAKE_SYSROOT})

# Where the compiler's own headers are, asked of itself.
execute_process(COMMAND ${CMAKE_CXX_COMPILER} -print-file-name=include OUTPUT_VARIABLE gcc_include
                OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
execute_process(COMMAND ${CMAKE_CXX_COMPILER} -E -v -xc++ /dev/null ERROR_VARIABLE said OUTPUT_QUIET)
string(REGEX MATCHALL "\n /[^\n]*/c\\+\\+/12[^\n]*" cxx_includes "${said}")
set(cxx "-nostdinc -nostdinc++")
foreach(folder ${cxx_includes})
  string(STRIP "${folder}" folder)
  file(REAL_PATH "${folder}" folder)
  string(APPEND cxx " -isystem ${folder}")
endforeach()
set(c "-isystem ${gcc_include} -isystem ${CMAKE_SYSROOT}/usr/include/${CMAKE_LIBRARY_ARCHITECTURE} -isystem ${CMAKE_SYSROOT}/usr/include")
set(CMAKE_C_FLAGS_INIT "-nostdinc ${c}")
set(CMAKE_CXX_FLAGS_INIT "${cxx} ${c}")

# One object of glibc_2_31.c serves all build folders, CMake's trial programs too.
set(libraries ${CMAKE_SYSROOT}/usr/lib/${CMAKE_LIBRARY_ARCHITECTURE})
file(SHA256 ${CMAKE_CURRENT_LIST_DIR}/glibc_2_31.c sum)
string(SUBSTRING ${sum} 0 12 sum)
set(compat ${libraries}/glibc_2_31-${sum}.o)
if(NOT EXISTS ${compat})
  separate_arguments(c_list UNIX_COMMAND "-nostdinc ${c}")
  string(RANDOM LENGTH 8 part)
  execute_process(COMMAND ${CMAKE_C_COMPILER} ${c_list} -O2 -fPIC -c ${CMAKE_CURRENT_LIST_DIR}/glibc_2_31.c -o ${compat}.${part}
                  COMMAND_ERROR_IS_FATAL ANY)
  file(RENAME ${compat}.${part} ${compat})
endif()
# -B comes before the compiler's own search path, which leads to Debian 12's C library.
set(link "-B${libraries} -L${libraries} -L${CMAKE_SYSROOT}/lib/${CMAKE_LIBRARY_ARCHITECTURE} -static-libstdc++ -shared-libgcc ${compat}")
set(CMAKE_EXE_LINKER_FLAGS_INIT "${link}")
set(CMAKE_SHARED_LINKER_FLAGS_INIT "${link}")
set(CMAKE_MODULE_LINKER_FLAGS_INIT "${link}")

# Libraries are the sysroot's; nothing of the machine is found but programs and what toolchain/packages points to.
set(CMAKE_FIND_ROOT_PATH ${CMAKE_SYSROOT})
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_PACKAGE ONLY)
