# GYRO_DEBLUR_SIFT: whether OpenCV's main modules have SIFT, as they do since 4.4, when its patent had run out.
include(CheckCXXSourceCompiles)
set(CMAKE_REQUIRED_INCLUDES ${OpenCV_INCLUDE_DIRS})
set(CMAKE_REQUIRED_LIBRARIES opencv_features2d opencv_core)
check_cxx_source_compiles("#include <opencv2/features2d.hpp>
int main() { return cv::SIFT::create().empty(); }" GYRO_DEBLUR_OPENCV_HAS_SIFT)
unset(CMAKE_REQUIRED_INCLUDES)
unset(CMAKE_REQUIRED_LIBRARIES)
option(GYRO_DEBLUR_HIDE_SIFT "Build as with an OpenCV that has no SIFT" OFF)
if(GYRO_DEBLUR_OPENCV_HAS_SIFT AND NOT GYRO_DEBLUR_HIDE_SIFT)
  set(GYRO_DEBLUR_SIFT 1)
else()
  set(GYRO_DEBLUR_SIFT 0)
endif()
