# Builds the core without ROS, installs it alone, and builds and runs a CMake project that links it.
include(${CMAKE_CURRENT_LIST_DIR}/common.cmake)

# Several files at a time, which takes half as long.
configure(${CORE} ${BINARY}/core -DCMAKE_UNITY_BUILD=ON
  -DGYRO_DEBLUR_ROS=OFF -DGYRO_DEBLUR_TESTS=OFF -DGYRO_DEBLUR_EXPERIMENTS=OFF)
build(${BINARY}/core --target gyro_deblur_core)
file(REMOVE_RECURSE ${BINARY}/installed ${BINARY}/prefix)
run(${CMAKE_COMMAND} --install ${BINARY}/core --component core --prefix ${BINARY}/installed)

# What is installed knows neither where it was built nor where it was installed.
file(RENAME ${BINARY}/installed ${BINARY}/prefix)
file(GLOB_RECURSE files ${BINARY}/prefix/*.cmake ${BINARY}/prefix/*.hpp)
list(LENGTH files count)
if(count LESS 10)
  message(FATAL_ERROR "only ${count} files are installed: ${files}")
endif()
foreach(file IN LISTS files)
  file(READ ${file} text)
  foreach(path ${CORE} ${BINARY})
    string(FIND "${text}" ${path} at)
    if(NOT at EQUAL -1)
      message(FATAL_ERROR "${file} names ${path}")
    endif()
  endforeach()
endforeach()

# A devel space in the environment must not lend its library.
unset(ENV{LD_LIBRARY_PATH})
configure(${CMAKE_CURRENT_LIST_DIR}/plain ${BINARY}/plain -DCMAKE_PREFIX_PATH=${BINARY}/prefix)
require_found_in(${BINARY}/plain ${BINARY}/prefix)
build(${BINARY}/plain)
run(${BINARY}/plain/use_core)
