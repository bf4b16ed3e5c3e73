# The target gyro_deblur::gyro_deblur_core, for who calls find_package(gyro_deblur) or find_package(catkin COMPONENTS
# gyro_deblur). With catkin it ends the package's configuration; without, it is the configuration.
include(CMakeFindDependencyMacro)
find_dependency(Eigen3 3.3 NO_MODULE)
# A second search would change the caller's OpenCV_LIBS.
if(NOT TARGET opencv_core OR NOT TARGET opencv_features2d)
  find_dependency(OpenCV 4.2)
endif()
# Where one CMake run builds a whole workspace, the target is there already.
if(NOT TARGET gyro_deblur::gyro_deblur_core)
  include(${gyro_deblur_DIR}/gyro_deblurTargets.cmake)
endif()
