// Does not compile after a header that includes yaml-cpp, ROS, OpenCL or what else only the package itself needs: a
// structure cannot have the name of a namespace, or of a type that is not one.
#pragma once

struct YAML;
struct ros;
struct std_msgs;
struct sensor_msgs;
struct dynamic_reconfigure;
struct cl;      // OpenCL for C++
struct cl_int;  // OpenCL for C
struct nlohmann;
struct CLI;
