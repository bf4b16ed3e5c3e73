#include "engine/fallback_engine.hpp"

#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "engine/engine.hpp"
#include "engine/float/float_engine.hpp"
#include "filter_grids.hpp"
#include "inverse/filter_bank.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::fallback_engine_test {
namespace {

/// Works for some frames, then throws having spoilt the result.
template <typename Error>
class FailingEngine : public Engine {
 public:
  FailingEngine(int good_frames, int* calls) : good_frames_(good_frames), calls_(calls) {}

  void filter(const cv::Mat& src, const FilterGrid& grid, cv::Mat& dst) override {
    if (++*calls_ <= good_frames_) return engine_.filter(src, grid, dst);
    dst = cv::Mat(3, 3, CV_8UC1, cv::Scalar(7));
    throw Error("out of order");
  }
  std::string name() const override { return "failing"; }
  void prepare(const std::vector<const LineKernel*>&) override { ++*calls_; }
  FallbackCounts fallback_counts() const override { return {{"the device is slow", 3}}; }

 private:
  int good_frames_;
  int* calls_;
  FloatEngine engine_{1};
};

class FallbackEngineTest : public testing::Test {
 protected:
  template <typename Error = DeviceError>
  FallbackEngine failing_after(int good_frames) {
    return {std::make_unique<FailingEngine<Error>>(good_frames, &calls_), std::make_unique<FloatEngine>(1)};
  }

  bool gives_the_right_frame(Engine& engine) {
    cv::Mat expected, actual;
    FloatEngine(1).filter(image_, blocks_, expected);
    engine.filter(image_, blocks_, actual);
    return actual.size() == expected.size() && actual.type() == expected.type() &&
           cv::norm(expected, actual, cv::NORM_INF) == 0;
  }

  int calls_ = 0;
  const cv::Mat image_ = test::textured_image(80, 60, 50);
  const LineKernel kernel_ = wiener_kernel(9, {});
  const FilterGrid blocks_ = test::one_block({80, 60}, 0.4, kernel_);
};

TEST_F(FallbackEngineTest, PreparesBoth) {
  int others = 0;
  FallbackEngine engine(std::make_unique<FailingEngine<DeviceError>>(0, &calls_),
                        std::make_unique<FailingEngine<DeviceError>>(9, &others));
  engine.prepare({&kernel_});
  EXPECT_EQ(calls_, 1);
  EXPECT_EQ(others, 1);
  cv::Mat dst;
  engine.filter(image_, blocks_, dst);  // the first fails
  engine.prepare({&kernel_});
  EXPECT_EQ(calls_, 2);
  EXPECT_EQ(others, 3);
}

TEST_F(FallbackEngineTest, LosesNoFrameWhenTheDeviceFailsInMidRun) {
  FallbackEngine engine = failing_after(2);
  for (int frame = 0; frame < 2; ++frame) {
    EXPECT_TRUE(gives_the_right_frame(engine));
    EXPECT_EQ(engine.name(), "failing");
    EXPECT_EQ(engine.take_warning(), "");
  }
  EXPECT_TRUE(gives_the_right_frame(engine)) << "the frame that failed";
  EXPECT_EQ(engine.name(), "float (failing failed: out of order)");
  EXPECT_EQ(engine.take_warning(), "failing failed: out of order; using float from now on");
  for (int frame = 0; frame < 3; ++frame) {
    EXPECT_TRUE(gives_the_right_frame(engine));
    EXPECT_EQ(engine.take_warning(), "") << "one warning only";
  }
  EXPECT_EQ(calls_, 3) << "the device is not tried again";
}

TEST_F(FallbackEngineTest, HasTheFallbackCountsOfTheEngineInUse) {
  FallbackEngine engine = failing_after(1);
  EXPECT_TRUE(gives_the_right_frame(engine));
  EXPECT_EQ(engine.fallback_counts(), (FallbackCounts{{"the device is slow", 3}}));
  EXPECT_TRUE(gives_the_right_frame(engine));
  EXPECT_EQ(engine.fallback_counts(), FallbackCounts{}) << "of the engine behind it";
}

TEST_F(FallbackEngineTest, StartsWithoutTheDevice) {
  FallbackEngine engine("OpenCL", DeviceError("no such device"), std::make_unique<FloatEngine>(1));
  EXPECT_EQ(engine.name(), "float (OpenCL failed: no such device)");
  EXPECT_EQ(engine.take_warning(), "OpenCL failed: no such device; using float from now on");
  EXPECT_EQ(engine.take_warning(), "");
  EXPECT_TRUE(gives_the_right_frame(engine));
}

// A bad argument is the caller's mistake, whichever engine finds it.
TEST_F(FallbackEngineTest, LetsOtherErrorsPass) {
  FallbackEngine engine = failing_after<std::invalid_argument>(0);
  cv::Mat dst;
  EXPECT_THROW(engine.filter(image_, blocks_, dst), std::invalid_argument);
  EXPECT_EQ(engine.name(), "failing");
  EXPECT_EQ(engine.take_warning(), "");
}

TEST_F(FallbackEngineTest, StandsBehindOpenCl) {
  const auto engine = make_engine("opencl:no such device", 1);
  EXPECT_EQ(engine->name().rfind(make_engine("cpu")->name() + " (OpenCL failed: ", 0), 0u) << engine->name();
  EXPECT_NE(engine->take_warning(), "");
  EXPECT_EQ(engine->take_warning(), "");
  cv::Mat expected, actual;
  make_engine("cpu", 1)->filter(image_, blocks_, expected);
  engine->filter(image_, blocks_, actual);
  EXPECT_EQ(cv::norm(expected, actual, cv::NORM_INF), 0);
}

TEST_F(FallbackEngineTest, IsNotForUnknownNames) {
  for (const char* engine : {"", "opencl:", "opencl0", "OpenCL", "abacus"}) {
    EXPECT_THROW(make_engine(engine), OptionError) << engine;
  }
}

}  // namespace
}  // namespace gyro_deblur::fallback_engine_test
