// Which engine is taken on a computer with a GPU: gpu_driver.cpp is all the OpenCL there is.
#include <cstdlib>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "engine/engine.hpp"
#include "engine/opencl/opencl_engine.hpp"

namespace gyro_deblur {
namespace {

class EngineWithAGpu : public testing::Test {
 protected:
  static void SetUpTestSuite() { setenv("OCL_ICD_VENDORS", OPENCL_VENDORS, 1); }  // read at the first call of OpenCL
};

TEST_F(EngineWithAGpu, IsTheProcessorsUnlessSomebodyAsks) {
  ASSERT_EQ(opencl_devices(), std::vector<std::string>{"test: a GPU"});
  EXPECT_EQ(make_engine("auto")->name(), make_engine("cpu")->name());
  const std::string asked_for = make_engine("opencl")->name();
  EXPECT_NE(asked_for.find("OpenCL failed: clCreateContext"), std::string::npos) << asked_for;
}

}  // namespace
}  // namespace gyro_deblur
