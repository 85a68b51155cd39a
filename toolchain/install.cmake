# What `cmake --install` puts where. Components: programs (with unit, configuration, manual), models, scenarios, tools (what
# looks at runs and makes sequences, for a desk: Python with numpy and matplotlib, so a package of its own).
#   cmake --install build/release --strip --prefix DIR [--component NAME]
include(GNUInstallDirs)

# The programs look for models, scenarios and tools in ../share/godwit beside their own folder (hal/machine/installed_data.h), so
# that a prefix can be moved and nothing compiled in names one.
set(GODWIT_DATA_DIR ${CMAKE_INSTALL_DATADIR}/godwit)
file(RELATIVE_PATH from_programs ${CMAKE_INSTALL_FULL_BINDIR} ${CMAKE_INSTALL_FULL_DATADIR}/godwit)
if(NOT from_programs STREQUAL "../share/godwit")
  message(FATAL_ERROR "CMAKE_INSTALL_BINDIR and CMAKE_INSTALL_DATADIR: the programs look in ../share/godwit, not in ${from_programs}")
endif()

# The same beside the programs of the build folder, and beside those of the tests one folder further down.
file(MAKE_DIRECTORY ${PROJECT_BINARY_DIR}/share/godwit ${PROJECT_BINARY_DIR}/tests)
file(CREATE_LINK ${PROJECT_SOURCE_DIR}/detector/models ${PROJECT_BINARY_DIR}/share/godwit/models SYMBOLIC)
file(CREATE_LINK ${PROJECT_SOURCE_DIR}/config/scenarios ${PROJECT_BINARY_DIR}/share/godwit/scenarios SYMBOLIC)
file(CREATE_LINK ${PROJECT_SOURCE_DIR}/scripts ${PROJECT_BINARY_DIR}/share/godwit/tools SYMBOLIC)
file(CREATE_LINK ../share ${PROJECT_BINARY_DIR}/tests/share SYMBOLIC)
file(MAKE_DIRECTORY ${PROJECT_BINARY_DIR}/lib ${PROJECT_BINARY_DIR}/tools)
file(CREATE_LINK ../lib ${PROJECT_BINARY_DIR}/tests/lib SYMBOLIC)

# godwit_program(NAME): a program that is installed, with a man page and shell completion out of its own --help.
function(godwit_program name)
  install(TARGETS ${name} RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT programs)
  set(section 1)
  if(name MATCHES "d$")
    set(section 8)
  endif()
  set(manual ${PROJECT_BINARY_DIR}/manual)
  set(page ${manual}/man/${name}.${section})
  add_custom_command(
    OUTPUT ${page} ${manual}/completion/${name}
    COMMAND /usr/bin/python3 ${PROJECT_SOURCE_DIR}/scripts/make_manual --out ${manual} --version ${PROJECT_VERSION}
            "--run=${CMAKE_CROSSCOMPILING_EMULATOR}" $<TARGET_FILE:${name}>
    DEPENDS ${name} ${PROJECT_SOURCE_DIR}/scripts/make_manual
    COMMENT "Manual of ${name}" VERBATIM)
  add_custom_target(${name}_manual ALL DEPENDS ${page})
  install(FILES ${page} DESTINATION ${CMAKE_INSTALL_MANDIR}/man${section} COMPONENT programs)
  install(FILES ${manual}/completion/${name} DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions
          COMPONENT programs)
endfunction()

install(DIRECTORY ${PROJECT_SOURCE_DIR}/detector/models DESTINATION ${GODWIT_DATA_DIR} COMPONENT models)
install(DIRECTORY ${PROJECT_SOURCE_DIR}/config/scenarios DESTINATION ${GODWIT_DATA_DIR} COMPONENT scenarios)
install(FILES ${PROJECT_SOURCE_DIR}/config/godwit.dbc ${PROJECT_SOURCE_DIR}/config/plotjuggler.xml DESTINATION ${GODWIT_DATA_DIR} COMPONENT programs)
# Each tool lies beside what it imports, and the path has a link to it.
install(DIRECTORY ${PROJECT_SOURCE_DIR}/scripts/report DESTINATION ${GODWIT_DATA_DIR}/tools COMPONENT tools PATTERN __pycache__ EXCLUDE)
install(FILES ${PROJECT_SOURCE_DIR}/scripts/pose_consistency.py ${PROJECT_SOURCE_DIR}/scripts/pose_metric.py
        DESTINATION ${GODWIT_DATA_DIR}/tools COMPONENT tools)
foreach(tool godwit-report evaluate from_kitti from_video)
  install(PROGRAMS ${PROJECT_SOURCE_DIR}/scripts/${tool} DESTINATION ${GODWIT_DATA_DIR}/tools COMPONENT tools)
  string(REPLACE godwit- "" name godwit-${tool})
  string(REPLACE _ - name godwit-${name})
  file(CREATE_LINK ${from_programs}/tools/${tool} ${PROJECT_BINARY_DIR}/tools/${name} SYMBOLIC)
  install(FILES ${PROJECT_BINARY_DIR}/tools/${name} DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT tools)
endforeach()
# docs/ in what programs, manual and configuration say.
install(DIRECTORY ${PROJECT_SOURCE_DIR}/docs/ DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/godwit COMPONENT programs FILES_MATCHING
        PATTERN "*.md" PATTERN pictures EXCLUDE)
# An administrator's file: the defaults, every key explained.
install(FILES ${PROJECT_SOURCE_DIR}/config/godwit.toml DESTINATION ${CMAKE_INSTALL_SYSCONFDIR}/godwit
        COMPONENT programs)

# The service. The unit names the places where program and configuration are put, and these are known when they are:
# `cmake --install --prefix` may name another prefix than the configured one, which tests look at.
set(GODWIT_UNIT_BINDIR ${CMAKE_INSTALL_FULL_BINDIR})
set(GODWIT_UNIT_SYSCONFDIR ${CMAKE_INSTALL_FULL_SYSCONFDIR})
configure_file(${PROJECT_SOURCE_DIR}/systemd/godwitd.service.in ${PROJECT_BINARY_DIR}/systemd/godwitd.service @ONLY)
install(CODE "
  get_filename_component(prefix \"\${CMAKE_INSTALL_PREFIX}\" ABSOLUTE)
  get_filename_component(GODWIT_UNIT_BINDIR \"${CMAKE_INSTALL_BINDIR}\" ABSOLUTE BASE_DIR \"\${prefix}\")
  get_filename_component(GODWIT_UNIT_SYSCONFDIR \"${CMAKE_INSTALL_SYSCONFDIR}\" ABSOLUTE BASE_DIR \"\${prefix}\")
  set(unit \"\${prefix}/lib/systemd/system/godwitd.service\")
  message(STATUS \"Installing: \$ENV{DESTDIR}\${unit}\")
  configure_file(\"${PROJECT_SOURCE_DIR}/systemd/godwitd.service.in\" \"\$ENV{DESTDIR}\${unit}\" @ONLY)
  list(APPEND CMAKE_INSTALL_MANIFEST_FILES \"\${unit}\")
" COMPONENT programs)
install(FILES ${PROJECT_SOURCE_DIR}/systemd/80-godwit-can0.network DESTINATION lib/systemd/network COMPONENT programs)
install(FILES ${PROJECT_SOURCE_DIR}/systemd/80-godwit.rules DESTINATION lib/udev/rules.d COMPONENT programs)
install(FILES ${PROJECT_SOURCE_DIR}/systemd/godwit.sysusers DESTINATION lib/sysusers.d RENAME godwit.conf COMPONENT programs)
