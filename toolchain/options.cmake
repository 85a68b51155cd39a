# Language level, processor target, warnings and sanitizers for every target of the project.
# The processor target is set for the whole tree at once: Eigen's alignment depends on it, so two
# archives built with different flags could not exchange Eigen types.
set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_POSITION_INDEPENDENT_CODE ON)
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release CACHE STRING "" FORCE)
endif()

# Fixed SIMD target and no floating-point contraction, so that a replay is the same to the bit with every compiler
# option that only changes speed.
if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
  add_compile_options(-march=x86-64-v3)
elseif(CMAKE_SYSTEM_PROCESSOR MATCHES "aarch64")
  # Highway's NEON functions are compiled for the cryptographic extension; without it here the compiler could not inline
  # them. None of its instructions is used, so that the generic build runs on cores without it, too.
  set(GODWIT_MARCH armv8-a CACHE STRING "Processor that aarch64 code is compiled for, as -march= takes it")
  add_compile_options(-march=${GODWIT_MARCH}+crypto)
endif()
# What runs as a service resolves its symbols at the start, and none of their addresses can be written to afterwards.
if(GODWIT_PACKAGE)
  add_link_options(-Wl,-z,relro,-z,now)
endif()
add_compile_options(-ffp-contract=off -fno-math-errno)
set(CMAKE_CXX_FLAGS_RELEASE "-O3 -g1 -DNDEBUG")
set(CMAKE_C_FLAGS_RELEASE "-O3 -g1 -DNDEBUG")
# Sanitizer builds keep the assertions.
set(CMAKE_CXX_FLAGS_SANITIZE "-O1 -g1 -fno-omit-frame-pointer")
set(CMAKE_C_FLAGS_SANITIZE "-O1 -g1 -fno-omit-frame-pointer")

if(GODWIT_SANITIZE)
  add_compile_options(-fsanitize=${GODWIT_SANITIZE} -fno-sanitize-recover=all)
  add_link_options(-fsanitize=${GODWIT_SANITIZE})
  # Clang tells the source by __has_feature alone.
  if(CMAKE_CXX_COMPILER_ID STREQUAL "Clang" AND GODWIT_SANITIZE MATCHES "address")
    add_compile_definitions(__SANITIZE_ADDRESS__=1)
  endif()
endif()

find_program(CCACHE ccache)
if(CCACHE)
  set(CMAKE_CXX_COMPILER_LAUNCHER ${CCACHE})
  set(CMAKE_C_COMPILER_LAUNCHER ${CCACHE})
endif()

# Most of a compiler run is Eigen's and the library's templates, over again for each file; eight files together take half of
# their time. Who works on one file configures with -DGODWIT_UNITY=OFF.
option(GODWIT_UNITY "Compile several source files of a target at once" ON)
option(GODWIT_UNITY_TIDY "Such units are for clang-tidy, not for the compiler" OFF)
function(godwit_warnings target)
  target_compile_options(${target} PRIVATE -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Wno-sign-conversion -Werror)
  # GCC 12 takes Eigen's masked 3-vector loads for reads past the end once they are inlined deeply enough.
  target_compile_options(${target} PRIVATE $<$<CXX_COMPILER_ID:GNU>:-Wno-array-bounds -Wno-stringop-overread>)
  # What a unit's first file keeps to itself in its anonymous namespace is in an included file for the compiler.
  target_compile_options(${target} PRIVATE $<$<CXX_COMPILER_ID:GNU>:-Wno-subobject-linkage>)
  if(GODWIT_SANITIZE)
    # With the sanitizers' extra branches GCC 12 no longer sees that Eigen's fixed-size results are filled.
    target_compile_options(${target} PRIVATE $<$<CXX_COMPILER_ID:GNU>:-Wno-maybe-uninitialized>)
  endif()
endfunction()

# godwit_unity(OUT SOURCES...): the files that compile SOURCES, at most eight each. Made here, not by CMake's UNITY_BUILD,
# whose files name the checkout and would make ccache take each checkout for another program.
function(godwit_unity out)
  list(LENGTH ARGN count)
  if(NOT GODWIT_UNITY OR count LESS 2)
    set(${out} ${ARGN} PARENT_SCOPE)
    return()
  endif()
  set(units)
  set(text)
  set(prefix)
  set(remark)
  if(GODWIT_UNITY_TIDY)
    # The static analyzer follows the paths of functions in included files only where the including file is named so.
    set(prefix UnifiedSource_)
    set(remark "  // NOLINT(bugprone-suspicious-include)")
  endif()
  set(held 0)
  set(number 0)
  foreach(source ${ARGN})
    cmake_path(ABSOLUTE_PATH source BASE_DIRECTORY ${CMAKE_CURRENT_SOURCE_DIR} NORMALIZE OUTPUT_VARIABLE path)
    cmake_path(IS_PREFIX PROJECT_SOURCE_DIR "${path}" NORMALIZE ours)
    cmake_path(IS_PREFIX PROJECT_BINARY_DIR "${path}" NORMALIZE made)
    if(made OR NOT ours)
      list(APPEND units ${source})
      continue()
    endif()
    file(RELATIVE_PATH relative ${PROJECT_SOURCE_DIR} ${path})
    string(APPEND text "#include \"${relative}\"${remark}\n")
    math(EXPR held "${held} + 1")
    if(held EQUAL 8)
      godwit_write_unit(${prefix}${out}_${number} "${text}")
      list(APPEND units ${CMAKE_CURRENT_BINARY_DIR}/unity/${prefix}${out}_${number}.cpp)
      math(EXPR number "${number} + 1")
      set(held 0)
      set(text)
    endif()
  endforeach()
  if(text)
    godwit_write_unit(${prefix}${out}_${number} "${text}")
    list(APPEND units ${CMAKE_CURRENT_BINARY_DIR}/unity/${prefix}${out}_${number}.cpp)
  endif()
  set(${out} ${units} PARENT_SCOPE)
endfunction()

function(godwit_write_unit name text)
  file(CONFIGURE OUTPUT ${CMAKE_CURRENT_BINARY_DIR}/unity/${name}.cpp CONTENT "${text}")
endfunction()

# godwit_library(NAME SOURCES...): a static library with the project's warnings and the repository root as include path.
function(godwit_library name)
  godwit_unity(${name} ${ARGN})
  add_library(${name} STATIC ${${name}})
  target_include_directories(${name} PUBLIC ${PROJECT_SOURCE_DIR})
  godwit_warnings(${name})
endfunction()
