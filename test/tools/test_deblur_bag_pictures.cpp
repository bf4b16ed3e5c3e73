// deblur_bag with a camera that sends pictures again, as a user runs it.
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <nlohmann/json.hpp>

#include "picture_bag.hpp"
#include "run_program.hpp"

namespace gyro_deblur {
namespace {

namespace fs = std::filesystem;
using test::HandheldCamera;
using test::ProgramResult;
using test::Shot;

constexpr double kToleranceDb = 0.2;

class DeblurBagPictures : public testing::Test {
 protected:
  DeblurBagPictures() {
    std::string pattern = (fs::temp_directory_path() / "deblur_bag_XXXXXX").string();
    if (mkdtemp(pattern.data()) == nullptr) throw std::runtime_error("no temporary directory");
    directory_ = pattern;
  }
  ~DeblurBagPictures() override { fs::remove_all(directory_); }

  static const HandheldCamera& camera() {
    static const HandheldCamera camera;
    return camera;
  }
  std::string path(const std::string& name) const { return (directory_ / name).string(); }

  /// What deblur_bag says, and makes of every shot.
  struct Run {
    std::string said;
    nlohmann::json report;
    double psnr_db = 0;  ///< mean of new pictures
  };
  Run run(const std::vector<Shot>& shots, const std::string& more_config = "") const {
    test::write_bag(path("in.bag"), camera(), shots);
    std::ofstream(path("config.yaml")) << "exposure_time: 0.02\nreadout_time: 0.015\nR_cam_imu: [1,0,0,0,1,0,0,0,1]\n"
                                       << more_config;
    const ProgramResult program =
        test::run_program({DEBLUR_BAG, path("in.bag"), path("out.bag"), "--config", path("config.yaml"), "--json",
                           path("report.json"), "--no-keypoints"});
    EXPECT_EQ(program.exit_code, 0) << program.output;
    Run run{program.output, nlohmann::json::parse(std::ifstream(path("report.json")))};
    rosbag::Bag bag(path("out.bag"), rosbag::bagmode::Read);
    rosbag::View view(bag, rosbag::TopicQuery("/cam/deblurred/image_raw"));
    EXPECT_EQ(view.size(), shots.size()) << program.output;
    auto shot = shots.begin();
    int pictures = 0;
    for (const rosbag::MessageInstance& instance : view) {
      const auto image = instance.instantiate<sensor_msgs::Image>();
      EXPECT_EQ(image->header.stamp, to_ros_time(shot->stamp_ns));
      if (!shot->repeats) {
        run.psnr_db += camera().psnr_db(view_image(*image).image, shot->picture);
        ++pictures;
      }
      if (++shot == shots.end()) break;
    }
    run.psnr_db /= pictures;
    return run;
  }

  fs::path directory_;
};

// With drop_poor nothing is left out that is not in a bag without repetitions: here nothing.
TEST_F(DeblurBagPictures, RepetitionsCostNothingAndAreReportedAtTheEnd) {
  for (const std::string more : {"", "drop_poor: true\n"}) {
    const Run clean = run(camera().every_picture(), more);
    EXPECT_EQ(clean.said.find("repeat"), std::string::npos) << clean.said;
    EXPECT_TRUE(clean.report["input_problems"].empty());
    const Run twice = run(camera().every_picture_twice(), more);
    EXPECT_NEAR(twice.psnr_db, clean.psnr_db, kToleranceDb);
    EXPECT_NE(twice.said.find("\nwarning: 40 of 80 images repeat the picture before"), std::string::npos) << twice.said;
    const Run fifth = run(camera().every_picture([](int i) {
      return i % 5 == 4 ? std::vector<Shot>{camera().repetition(i, HandheldCamera::kPeriodNs / 2)}
                        : std::vector<Shot>{};
    }),
                          more);
    EXPECT_NEAR(fifth.psnr_db, clean.psnr_db, kToleranceDb);
    EXPECT_NE(fifth.said.find("\nwarning: 8 of 48 images repeat the picture before"), std::string::npos) << fifth.said;
    for (const Run* run : {&clean, &twice, &fifth}) {
      EXPECT_EQ(run->report["dropped_poor"], 0);
      EXPECT_TRUE(run->report["passed_through"].empty());
    }
  }
}

}  // namespace
}  // namespace gyro_deblur
