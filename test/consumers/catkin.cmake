# Builds and runs a catkin package that uses core and messages from the devel space of this build, and the plain CMake
# project with the core of the same place.
include(${CMAKE_CURRENT_LIST_DIR}/common.cmake)

# As after sourcing the devel space's setup file.
set(ENV{CMAKE_PREFIX_PATH} "${DEVEL}:$ENV{CMAKE_PREFIX_PATH}")
set(options_of_catkin -DPYTHON_EXECUTABLE=${PYTHON})
foreach(package catkin plain)
  configure(${CMAKE_CURRENT_LIST_DIR}/${package} ${BINARY}/${package} ${options_of_${package}})
  require_found_in(${BINARY}/${package} ${DEVEL})
  build(${BINARY}/${package})
endforeach()
run(${BINARY}/catkin/devel/lib/use_gyro_deblur/use_core_and_messages)
run(${BINARY}/plain/use_core)
