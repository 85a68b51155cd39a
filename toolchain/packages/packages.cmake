# Where a cross build finds what is not in the sysroot. What is headers alone (Eigen, Highway, fmt, toml++, CLI11) is the
# same on every architecture: the machine's serve, by links, because the folder that holds them holds its other headers
# too. OpenCV is our own cut (toolchain/opencv), made on first use.
set(headers ${PROJECT_BINARY_DIR}/headers)
file(MAKE_DIRECTORY ${headers})
foreach(name CLI fmt hwy nlohmann toml++)
  if(NOT EXISTS /usr/include/${name})
    message(FATAL_ERROR "/usr/include/${name} is not there: scripts/setup installs it")
  endif()
  file(CREATE_LINK /usr/include/${name} ${headers}/${name} SYMBOLIC)
endforeach()
set(GODWIT_HOST_HEADERS ${headers})
set(Eigen3_DIR /usr/share/eigen3/cmake CACHE PATH "Eigen's CMake package")
set(TOMLPP_INCLUDE_DIR ${headers} CACHE PATH "Folder that holds toml++/toml.h")
set(GODWIT_GTEST_SOURCE /usr/src/googletest CACHE PATH "GoogleTest to be built with the cross compiler")
foreach(package fmt tomlplusplus yaml-cpp)
  set(${package}_DIR ${CMAKE_CURRENT_LIST_DIR} CACHE PATH "CMake package of the cross build")
endforeach()
if(GODWIT_BUILD_APP)
  # Linked statically: their packages have other names on Ubuntu.
  foreach(name JPEG PNG ZLIB)
    string(REPLACE ZLIB z library ${name})
    string(TOLOWER ${library} library)
    set(${name}_LIBRARY ${CMAKE_SYSROOT}/usr/lib/${CMAKE_LIBRARY_ARCHITECTURE}/lib${library}.a CACHE FILEPATH "Linked statically")
    set(${name}_INCLUDE_DIR ${CMAKE_SYSROOT}/usr/include CACHE PATH "Of the sysroot")
  endforeach()
  set(PNG_PNG_INCLUDE_DIR ${CMAKE_SYSROOT}/usr/include CACHE PATH "Of the sysroot")
  # OpenCV's package names it and does not look for it.
  add_library(protobuf::libprotobuf STATIC IMPORTED)
  set_target_properties(protobuf::libprotobuf PROPERTIES
                        IMPORTED_LOCATION ${CMAKE_SYSROOT}/usr/lib/${CMAKE_LIBRARY_ARCHITECTURE}/libprotobuf.a)
  execute_process(COMMAND ${PROJECT_SOURCE_DIR}/toolchain/sysroot devices OUTPUT_VARIABLE folder OUTPUT_STRIP_TRAILING_WHITESPACE
                  COMMAND_ERROR_IS_FATAL ANY)
  list(APPEND CMAKE_FIND_ROOT_PATH ${folder})
  set(ENV{PKG_CONFIG_LIBDIR} ${folder}/usr/lib/${CMAKE_LIBRARY_ARCHITECTURE}/pkgconfig)
  set(ENV{PKG_CONFIG_SYSROOT_DIR} ${folder})
  set(CMAKE_CROSSCOMPILING_EMULATOR ${CMAKE_CROSSCOMPILING_EMULATOR} -E
      LD_LIBRARY_PATH=${folder}/usr/lib/${CMAKE_LIBRARY_ARCHITECTURE}:${folder}/lib/${CMAKE_LIBRARY_ARCHITECTURE})
  set(GODWIT_EMULATOR "${CMAKE_CROSSCOMPILING_EMULATOR}" CACHE INTERNAL "What runs the target's programs, for tests/package")
  # What these libraries want in turn is on the target, not here.
  add_link_options(-Wl,--unresolved-symbols=ignore-in-shared-libs)
  set(GODWIT_OPENCV "" CACHE PATH "An OpenCV for the target in place of toolchain/opencv's, such as one with CUDA")
  if(GODWIT_OPENCV)
    set(folder ${GODWIT_OPENCV})
  else()
    message(STATUS "OpenCV for the target: building it if it is not there (ten minutes of processor time, once)")
    execute_process(COMMAND ${PROJECT_SOURCE_DIR}/toolchain/opencv OUTPUT_VARIABLE folder OUTPUT_STRIP_TRAILING_WHITESPACE
                    COMMAND_ERROR_IS_FATAL ANY)
  endif()
  set(OpenCV_DIR ${folder}/lib/cmake/opencv4 CACHE PATH "OpenCV's CMake package" FORCE)
endif()
