# What is left out for want of a library is a warning that names the library, at every configuration; what the user has
# left out is none.
include(${CMAKE_CURRENT_LIST_DIR}/common.cmake)

set(missing -DCMAKE_DISABLE_FIND_PACKAGE_catkin=ON -DCMAKE_DISABLE_FIND_PACKAGE_OpenCL=ON
  -DCMAKE_DISABLE_FIND_PACKAGE_benchmark=ON -DGYRO_DEBLUR_HIDE_SIFT=ON -DGYRO_DEBLUR_BENCHMARKS=ON
  -DGYRO_DEBLUR_TESTS=OFF)
# warnings(RESULT OPTIONS...)
function(warnings result)
  execute_process(COMMAND ${CMAKE_COMMAND} -S ${CORE} -B ${BINARY}/build -G ${GENERATOR} -DCMAKE_CXX_COMPILER=${COMPILER}
      ${missing} ${ARGN}
    RESULT_VARIABLE status ERROR_VARIABLE text OUTPUT_VARIABLE output)
  if(NOT status STREQUAL 0)
    message(FATAL_ERROR "failed with ${status}: ${output}${text}")
  endif()
  string(REGEX REPLACE "[ \n]+" " " text "${text}")
  set(${result} "${text}" PARENT_SCOPE)
endfunction()

file(REMOVE_RECURSE ${BINARY}/build)
foreach(time first second)
  warnings(text)
  foreach(part "catkin is not found: the nodelet" "OpenCL is not found: the engine opencl" "has no SIFT: SIFT keypoints"
          "Google Benchmark is not found")
    string(FIND "${text}" "${part}" at)
    if(at EQUAL -1)
      message(FATAL_ERROR "no warning '${part}' at the ${time} configuration: ${text}")
    endif()
  endforeach()
endforeach()

file(REMOVE_RECURSE ${BINARY}/build)
warnings(text -DGYRO_DEBLUR_ROS=OFF -DGYRO_DEBLUR_OPENCL=OFF)
foreach(part catkin OpenCL)
  string(FIND "${text}" "${part} is not found" at)
  if(NOT at EQUAL -1)
    message(FATAL_ERROR "a warning of what the user has left out: ${text}")
  endif()
endforeach()
