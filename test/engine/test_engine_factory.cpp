#include "engine/engine.hpp"

#include <string>

#include <gtest/gtest.h>

#include "gyro_deblur/options.hpp"

namespace gyro_deblur::engine_factory_test {
namespace {

TEST(MakeEngine, KnowsItsNames) {
  EXPECT_EQ(make_engine("float")->name(), "float");
  EXPECT_EQ(make_engine("cpu")->name().rfind("cpu-", 0), 0u);
  EXPECT_EQ(make_engine("fourier")->name(), "fourier, " + make_engine("cpu")->name());
  EXPECT_TRUE(make_engine("fourier")->prefers_2d());
  EXPECT_NE(make_engine("auto", 1), nullptr);
  EXPECT_FALSE(make_engine("auto")->prefers_2d());
  EXPECT_THROW(make_engine("gpu"), OptionError);
  EXPECT_THROW(make_engine("float", -1), OptionError);
}

TEST(MakeEngine, ListsTheNamesItKnows) {
  try {
    make_engine("abacus");
    FAIL();
  } catch (const OptionError& error) {
    const std::string message = error.what();
    EXPECT_NE(message.find("\"abacus\""), std::string::npos) << message;
    for (const char* name : {"auto", "cpu", "fourier", "float", "opencl", "opencl:INDEX", "opencl:NAME"}) {
      EXPECT_NE((message + ",").find(std::string(" ") + name + ","), std::string::npos) << name << " in " << message;
    }
  }
}

TEST(MakeEngine, TakesADeviceForOpenClAlone) {
  for (const char* name : {"cpu:0", "fourier:0", "float:0", "auto:0", "opencl:"})
    EXPECT_THROW(make_engine(name), OptionError) << name;
}

}  // namespace
}  // namespace gyro_deblur::engine_factory_test
