# The Debian packages, by cpack: godwit (programs, unit, configuration, manual, scenarios), godwit-models (the networks, which are
# under another licence) and godwit-tools (what looks at runs and makes sequences, in Python). What is installed where is in install.cmake; scripts/package builds both for arm64 and amd64.
set(deb ${PROJECT_SOURCE_DIR}/toolchain/deb)
set(made ${PROJECT_BINARY_DIR}/deb)
file(MAKE_DIRECTORY ${made})
if(CMAKE_SYSTEM_PROCESSOR MATCHES "aarch64")
  set(architecture arm64)
else()
  set(architecture amd64)
endif()

set(GODWIT_MAINTAINER "godwit maintainers <maintainers@godwit.invalid>" CACHE STRING "Whom the packages name")

# Documents that every package must have.
execute_process(COMMAND ${PROJECT_SOURCE_DIR}/toolchain/sbom --version ${PROJECT_VERSION} --architecture ${architecture}
                        --out ${made}/godwit.spdx.json COMMAND_ERROR_IS_FATAL ANY)
configure_file(${deb}/changelog.in ${made}/changelog @ONLY)
execute_process(COMMAND gzip -9nkf ${made}/changelog COMMAND_ERROR_IS_FATAL ANY)
file(RENAME ${made}/changelog.gz ${made}/changelog.Debian.gz)
install(FILES ${made}/changelog.Debian.gz ${made}/godwit.spdx.json ${deb}/copyright DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/godwit
        COMPONENT programs)
foreach(part models tools)
  set(documents ${CMAKE_INSTALL_DATADIR}/doc/godwit-${part})
  install(FILES ${made}/changelog.Debian.gz DESTINATION ${documents} COMPONENT ${part})
  install(FILES ${deb}/copyright_${part} DESTINATION ${documents} RENAME copyright COMPONENT ${part})
endforeach()
install(FILES ${deb}/lintian_overrides DESTINATION ${CMAKE_INSTALL_DATADIR}/lintian/overrides RENAME godwit COMPONENT programs)
# After the rules of firmware_app, which put the pages there.
install(CODE "file(GLOB pages \"\$ENV{DESTDIR}${CMAKE_INSTALL_PREFIX}/${CMAKE_INSTALL_MANDIR}/man*/*.[1-9]\")
execute_process(COMMAND gzip -9nf \${pages} COMMAND_ERROR_IS_FATAL ANY)" COMPONENT programs)

# What dpkg runs, and the files that it asks about before it overwrites them.
set(control ${deb}/postinst ${deb}/prerm ${deb}/postrm)
file(WRITE ${made}/conffiles "/etc/godwit/godwit.toml\n")
list(APPEND control ${made}/conffiles)
# A processor that lacks what the programs are compiled for is told so, and gets none.
file(REMOVE ${made}/preinst)
if(architecture STREQUAL "amd64")
  configure_file(${deb}/preinst_amd64 ${made}/preinst COPYONLY)
elseif(GODWIT_MARCH MATCHES "fp16")
  configure_file(${deb}/preinst_jetson ${made}/preinst COPYONLY)
endif()
if(EXISTS ${made}/preinst)
  list(APPEND control ${made}/preinst)
endif()

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME godwit)
set(CPACK_PACKAGE_VERSION ${PROJECT_VERSION})
set(CPACK_PACKAGE_DIRECTORY ${PROJECT_BINARY_DIR}/packages)
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
# /etc is not below /usr.
set(CPACK_SET_DESTDIR ON)
set(CPACK_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_COMPONENTS_GROUPING ONE_PER_GROUP)
set(CPACK_COMPONENTS_ALL programs scenarios models tools)
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS
    OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ WORLD_EXECUTE)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_COMPRESSION_TYPE xz)
set(CPACK_DEBIAN_PACKAGE_MAINTAINER "${GODWIT_MAINTAINER}")
set(CPACK_DEBIAN_PACKAGE_RELEASE 1)
set(CPACK_DEBIAN_PACKAGE_ARCHITECTURE ${architecture})
set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION ON)

set(CPACK_DEBIAN_PROGRAMS_PACKAGE_NAME godwit)
set(CPACK_DEBIAN_PROGRAMS_PACKAGE_SECTION misc)
set(CPACK_DEBIAN_PROGRAMS_PACKAGE_PRIORITY optional)
set(CPACK_DEBIAN_PROGRAMS_PACKAGE_CONTROL_EXTRA ${control})
set(CPACK_DEBIAN_PROGRAMS_DESCRIPTION "visual navigation where satellites are not heard
A camera frame goes in; a few milliseconds later a pose with its uncertainty
goes out to the autopilot. The daemon godwitd flies; the tool godwit replays,
simulates and looks at the machine.")
set(CPACK_DEBIAN_PROGRAMS_PACKAGE_RECOMMENDS "godwit-models")
set(CPACK_DEBIAN_PROGRAMS_PACKAGE_SUGGESTS "godwit-tools")
if(architecture STREQUAL "arm64")
  # There is no dpkg-shlibdeps for another architecture: this file asks toolchain/deb/depends, when cpack runs.
  file(WRITE ${made}/depends.cmake "execute_process(COMMAND ${deb}/depends
  ${PROJECT_BINARY_DIR}/firmware_app/godwit ${PROJECT_BINARY_DIR}/firmware_app/godwitd
  OUTPUT_VARIABLE CPACK_DEBIAN_PROGRAMS_PACKAGE_DEPENDS OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)\n")
  set(CPACK_PROJECT_CONFIG_FILE ${made}/depends.cmake)
else()
  set(CPACK_DEBIAN_PROGRAMS_PACKAGE_SHLIBDEPS ON)
endif()

set(CPACK_DEBIAN_MODELS_PACKAGE_NAME godwit-models)
set(CPACK_DEBIAN_MODELS_PACKAGE_ARCHITECTURE all)
set(CPACK_DEBIAN_MODELS_PACKAGE_SECTION misc)
set(CPACK_DEBIAN_MODELS_PACKAGE_PRIORITY optional)
set(CPACK_DEBIAN_MODELS_DESCRIPTION "networks by which godwit finds what may move
Three CBAM-YOLOv5 networks in ONNX, of 320 x 320, 416 x 416 and 480 x 352
pixels, under another licence than the programs, and three YOLOX-Nano networks,
one of 320 x 320 and two of 416 x 416 pixels, under theirs.")

set(CPACK_DEBIAN_TOOLS_PACKAGE_NAME godwit-tools)
set(CPACK_DEBIAN_TOOLS_PACKAGE_ARCHITECTURE all)
set(CPACK_DEBIAN_TOOLS_PACKAGE_SECTION misc)
set(CPACK_DEBIAN_TOOLS_PACKAGE_PRIORITY optional)
set(CPACK_DEBIAN_TOOLS_PACKAGE_DEPENDS
    "python3, python3-matplotlib, python3-numpy, python3-opencv, python3-pil, python3-yaml")
set(CPACK_DEBIAN_TOOLS_DESCRIPTION "reports of godwit's runs, and sequences out of videos
godwit-report and godwit-evaluate look at what godwit flew; godwit-from-video
and godwit-from-kitti make sequences that it flies, and godwit replay runs
them by itself.")
include(CPack)
cpack_add_component_group(programs)
cpack_add_component_group(models)
cpack_add_component_group(tools)
cpack_add_component(programs GROUP programs)
cpack_add_component(scenarios GROUP programs)
cpack_add_component(models GROUP models)
cpack_add_component(tools GROUP tools)
