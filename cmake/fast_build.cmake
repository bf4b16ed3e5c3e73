# GYRO_DEBLUR_FAST_BUILD: a build from scratch in half the time. What is not installed is compiled with -O1 or -O0,
# debug information is that of backtraces (-g1), and headers of other libraries are precompiled. Results are the same to
# the last bit: no instruction set or floating-point option changes.
option(GYRO_DEBLUR_FAST_BUILD "Build from scratch in half the time, for continuous integration" OFF)
if(GYRO_DEBLUR_FAST_BUILD)
  string(REGEX REPLACE "(^| )-g( |$)" "\\1-g1\\2" CMAKE_CXX_FLAGS_RELWITHDEBINFO "${CMAKE_CXX_FLAGS_RELWITHDEBINFO}")
endif()
# A compiler cache takes precompiled headers only with some of its checks off, and is quicker without them.
if(GYRO_DEBLUR_FAST_BUILD AND NOT CMAKE_CXX_COMPILER_LAUNCHER)
  set(GYRO_DEBLUR_PRECOMPILE ON)
else()
  set(GYRO_DEBLUR_PRECOMPILE OFF)
endif()

# Of other libraries alone: what a layer or a test includes of the package, it has to include itself.
set(gyro_deblur_core_headers
  <algorithm> <array> <cmath> <cstdint> <deque> <functional> <limits> <map> <memory> <optional> <set> <sstream>
  <stdexcept> <string> <utility> <vector>
  <Eigen/Cholesky> <Eigen/Core> <Eigen/Geometry> <Eigen/LU> <opencv2/core.hpp> <opencv2/imgproc.hpp>)
set(gyro_deblur_ros_headers
  ${gyro_deblur_core_headers} <atomic> <chrono> <condition_variable> <mutex>
  <boost/make_shared.hpp> <ros/ros.h> <sensor_msgs/CameraInfo.h> <sensor_msgs/Image.h> <sensor_msgs/Imu.h>
  <tf2_msgs/TFMessage.h> <topic_tools/shape_shifter.h>)
set(gyro_deblur_tool_headers
  ${gyro_deblur_core_headers} <array> <cstdio> <filesystem> <fstream> <iostream>
  <nlohmann/json.hpp> <opencv2/features2d.hpp> <opencv2/imgcodecs.hpp>)
set(gyro_deblur_test_headers <gtest/gtest.h> <filesystem> <fstream> <random>)

# gyro_deblur_precompile(OWNER HEADERS...): OWNER's headers, which other targets with the same options may use.
function(gyro_deblur_precompile owner)
  if(GYRO_DEBLUR_PRECOMPILE)
    target_precompile_headers(${owner} PRIVATE ${ARGN})
    # The compiler refuses the headers where a macro of theirs is missing.
    set_target_properties(${owner} PROPERTIES DEFINE_SYMBOL "")
  endif()
endfunction()

# gyro_deblur_use_precompiled(TARGET OWNER)
function(gyro_deblur_use_precompiled target owner)
  if(GYRO_DEBLUR_PRECOMPILE)
    target_precompile_headers(${target} REUSE_FROM ${owner})
  endif()
endfunction()

# gyro_deblur_optimize(TARGET LEVEL): the optimisation of what is not installed, in a fast build. -O1 for numerics; -O0
# for what handles messages, which then compiles in half the time.
function(gyro_deblur_optimize target level)
  if(GYRO_DEBLUR_FAST_BUILD)
    target_compile_options(${target} PRIVATE $<$<CONFIG:RelWithDebInfo>:${level}>)
  endif()
endfunction()

# gyro_deblur_optimize_if_sanitized(TARGET LEVEL): the same for what is installed, with sanitizers alone: other builds
# test what users run.
function(gyro_deblur_optimize_if_sanitized target level)
  if(GYRO_DEBLUR_SANITIZE)
    gyro_deblur_optimize(${target} ${level})
  endif()
endfunction()

# gyro_deblur_add_precompiled(OWNER LEVEL HEADERS... LIBRARIES...): a program that only holds precompiled headers for
# others with this optimisation; those of libraries differ in -fPIC.
function(gyro_deblur_add_precompiled owner level)
  cmake_parse_arguments(ARG "" "" "HEADERS;LIBRARIES" ${ARGN})
  if(NOT GYRO_DEBLUR_PRECOMPILE)
    return()
  endif()
  set(source ${CMAKE_CURRENT_BINARY_DIR}/${owner}.cpp)
  file(GENERATE OUTPUT ${source} CONTENT "int main() { return 0; }\n")
  add_executable(${owner} ${source})
  target_link_libraries(${owner} PRIVATE ${ARG_LIBRARIES} gyro_deblur_warnings)
  set_target_properties(${owner} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_CURRENT_BINARY_DIR})
  gyro_deblur_optimize(${owner} ${level})
  gyro_deblur_precompile(${owner} ${ARG_HEADERS})
endfunction()
