# Messages, dynamic parameters and the catkin package. Included from the top level, where catkin wants it.
find_package(catkin REQUIRED COMPONENTS
  diagnostic_msgs
  diagnostic_updater
  dynamic_reconfigure
  geometry_msgs
  image_transport
  message_generation
  nodelet
  pluginlib
  rosbag_storage
  roscpp
  sensor_msgs
  std_msgs
  std_srvs
  tf2
  tf2_msgs
  topic_tools
  visualization_msgs
  xmlrpcpp
)

add_message_files(DIRECTORY msg FILES
  BlurField.msg
  Exposure.msg
  ImageQuality.msg
  Keypoint.msg
  KeypointArray.msg
)
generate_messages(DEPENDENCIES std_msgs)
generate_dynamic_reconfigure_options(cfg/Deblur.cfg)

catkin_package(
  INCLUDE_DIRS include
  LIBRARIES gyro_deblur_core
  CATKIN_DEPENDS message_runtime std_msgs
  DEPENDS EIGEN3 OpenCV
  CFG_EXTRAS gyro_deblur-extras.cmake
)
