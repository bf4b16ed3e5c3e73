// The nodelet as a node of its own.

#include <nodelet/loader.h>
#include <ros/ros.h>

int main(int argc, char** argv) {
  ros::init(argc, argv, "gyro_deblur");
  constexpr bool kProvideManagerServices = false;
  nodelet::Loader loader(kProvideManagerServices);
  const nodelet::V_string arguments(argv + 1, argv + argc);
  if (!loader.load(ros::this_node::getName(), "gyro_deblur/DeblurNodelet", ros::names::getRemappings(), arguments)) {
    ROS_FATAL("gyro_deblur/DeblurNodelet could not be loaded");
    return 1;
  }
  ros::spin();
  return 0;
}
