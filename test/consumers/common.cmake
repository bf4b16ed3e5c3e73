# What the tests that build packages share; see CMakeLists.txt for the variables they are given.

# run(COMMAND...): fails the test when the command does.
function(run)
  string(REPLACE ";" " " text "${ARGN}")
  message(STATUS "${text}")
  execute_process(COMMAND ${ARGN} RESULT_VARIABLE status)
  if(NOT status STREQUAL 0)
    message(FATAL_ERROR "failed with ${status}: ${text}")
  endif()
endfunction()

# configure(SOURCE BINARY OPTIONS...): without optimisation, which takes longer than running the result does.
function(configure source binary)
  run(${CMAKE_COMMAND} -S ${source} -B ${binary} -G ${GENERATOR} -DCMAKE_CXX_COMPILER=${COMPILER}
    -DCMAKE_CXX_COMPILER_LAUNCHER=${LAUNCHER} -DGYRO_DEBLUR_FAST_BUILD=${FAST_BUILD} --no-warn-unused-cli -DCMAKE_BUILD_TYPE=Debug -DCMAKE_CXX_FLAGS_DEBUG=-O0 ${ARGN})
endfunction()

function(build binary)
  run(${CMAKE_COMMAND} --build ${binary} --parallel 2 ${ARGN})
endfunction()

# require_found_in(BINARY PREFIX): that the package configured in BINARY has found the core below PREFIX and nowhere else.
function(require_found_in binary prefix)
  file(STRINGS ${binary}/CMakeCache.txt found REGEX "^gyro_deblur_DIR:")
  string(REGEX REPLACE "^[^=]*=" "" found "${found}")
  string(FIND "${found}" "${prefix}/" at)
  if(NOT at EQUAL 0)
    message(FATAL_ERROR "found gyro_deblur in '${found}', not below ${prefix}")
  endif()
endfunction()
