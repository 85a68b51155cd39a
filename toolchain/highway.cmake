# godwit_highway: Highway's headers, its functions being chosen when they are compiled (static dispatch).
add_library(godwit_highway INTERFACE)
if(CMAKE_CROSSCOMPILING)
  target_include_directories(godwit_highway SYSTEM INTERFACE ${GODWIT_HOST_HEADERS})
else()
  pkg_check_modules(HWY REQUIRED IMPORTED_TARGET libhwy)
  target_link_libraries(godwit_highway INTERFACE PkgConfig::HWY)
endif()
# x86-64-v3 has no AES instructions, which Highway otherwise demands before it uses AVX2. For all who include its headers:
# functions of one name with other instructions in them must not meet in one program.
target_compile_definitions(godwit_highway INTERFACE HWY_DISABLE_PCLMUL_AES)
