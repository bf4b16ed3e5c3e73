# A Debian package of what is installed: scripts/package.sh. Libraries that are linked are found by dpkg-shlibdeps, what
# launch files, the Python modules and rosrun need is named here.
# Inside another project, the packages are that one's.
if(NOT GYRO_DEBLUR_ROS OR NOT CMAKE_SOURCE_DIR STREQUAL PROJECT_SOURCE_DIR)
  return()
endif()
if(CMAKE_INSTALL_PREFIX MATCHES "^/opt/ros/([a-z]+)$")
  set(CPACK_DEBIAN_PACKAGE_NAME ros-${CMAKE_MATCH_1}-gyro-deblur)
  set(ros_packages dynamic-reconfigure image-transport message-runtime nodelet rosbag rosbash rosgraph roslaunch rosmsg
    rosnode rospy rosservice rviz sensor-msgs std-msgs std-srvs tf2-msgs visualization-msgs)
  list(TRANSFORM ros_packages PREPEND ros-${CMAKE_MATCH_1}-)
else()
  set(CPACK_DEBIAN_PACKAGE_NAME gyro-deblur)
  # libstd-msgs-dev has the package.xml by which rosmsg finds std_msgs.
  set(ros_packages libnodeletlib-tools libstd-msgs-dev python3-dynamic-reconfigure python3-genpy python3-rosbag
    python3-rosgraph python3-roslaunch python3-rosmsg python3-rosnode python3-rospy python3-rosservice
    python3-sensor-msgs python3-std-msgs ros-message-runtime ros-std-msgs rosbash rviz)
endif()
list(JOIN ros_packages ", " CPACK_DEBIAN_PACKAGE_DEPENDS)
set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME ${PROJECT_NAME})
set(CPACK_PACKAGE_CONTACT "gyro_deblur maintainers <gyro-deblur@users.noreply.github.com>")
set(CPACK_PACKAGE_DESCRIPTION_SUMMARY "removes motion blur from camera images with a gyroscope (ROS nodelet)")
set(CPACK_PACKAGE_DESCRIPTION "Deblurs the images of a camera for SLAM front ends, in real time.\n A nodelet, launch \
files, command-line tools for bags, and a C++ library.")
set(CPACK_PACKAGING_INSTALL_PREFIX ${CMAKE_INSTALL_PREFIX})
set(CPACK_STRIP_FILES ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SECTION science)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
# A package of its own links the installed libraries among themselves.
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS_PRIVATE_DIRS ${CATKIN_DEVEL_PREFIX}/${CATKIN_PACKAGE_LIB_DESTINATION}
  ${PROJECT_BINARY_DIR}/src)
if(CMAKE_CROSSCOMPILING)
  # scripts/package.sh --arm64. By default the package would be for the processor of this machine.
  set(CPACK_DEBIAN_PACKAGE_ARCHITECTURE arm64)
  foreach(folder lib usr/lib)
    list(APPEND CPACK_DEBIAN_PACKAGE_SHLIBDEPS_PRIVATE_DIRS ${CMAKE_SYSROOT}/${folder}/aarch64-linux-gnu)
  endforeach()
endif()
# For the report scripts, for who links the library, and for OpenCL's engine.
set(CPACK_DEBIAN_PACKAGE_SUGGESTS "imagemagick, libeigen3-dev, libopencv-dev, opencl-icd, python3-matplotlib, \
python3-numpy, python3-opencv, python3-tqdm")
install(FILES LICENSE DESTINATION share/doc/${CPACK_DEBIAN_PACKAGE_NAME} RENAME copyright)
include(CPack)
