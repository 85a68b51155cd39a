# Writes the one file that holds the commit, when a build begins and only where it says something else than before:
#   cmake -D SOURCE=.. -D TEMPLATE=.. -D OUT=.. -D VERSION=.. -P version.cmake
# A commit, or a change of a tracked file, costs this file and the links that follow it. Without git, or outside a
# repository of its own, the commit is unknown.
set(COMMIT unknown)
set(DIRTY false)
find_program(GIT git)
if(GIT)
  execute_process(COMMAND ${GIT} -C ${SOURCE} rev-parse --show-toplevel --short=12 HEAD OUTPUT_VARIABLE said
                  OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET RESULT_VARIABLE failed)
  string(REPLACE "\n" ";" said "${said}")
  get_filename_component(source ${SOURCE} REALPATH)
  if(NOT failed)
    list(GET said 0 top)
    get_filename_component(top ${top} REALPATH)
  endif()
  # Sources that lie within somebody else's repository are none of its commits.
  if(NOT failed AND top STREQUAL source)
    list(GET said 1 COMMIT)
    execute_process(COMMAND ${GIT} -C ${SOURCE} status --porcelain --untracked-files=no OUTPUT_VARIABLE changed ERROR_QUIET)
    if(changed)
      set(DIRTY true)
    endif()
  endif()
endif()
configure_file(${TEMPLATE} ${OUT} @ONLY)
