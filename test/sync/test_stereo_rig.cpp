// Cameras that decide together. Who waits, waits in a thread of its own for as long as it takes: the timeout is either
// 0 or longer than any test, so that time decides nothing.
#include "sync/stereo_rig.hpp"

#include <algorithm>
#include <array>
#include <chrono>
#include <future>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "gyro_deblur/frame_blur.hpp"
#include "sync/work_signal.hpp"

namespace gyro_deblur::stereo_rig_test {
namespace {

constexpr TimeNs kMs = 1'000'000;
constexpr TimeNs kPeriod = 50 * kMs;
constexpr TimeNs kNone = 1;  // as good as
constexpr TimeNs kEndless = 3'600'000 * kMs;

/// A field whose blocks have these statuses.
FrameBlur field(const std::vector<BlockStatus>& statuses) {
  FrameBlur field;
  for (const BlockStatus status : statuses) {
    field.blocks.emplace_back();
    field.blocks.back().status = status;
  }
  return field;
}
FrameBlur blurred() { return field({BlockStatus::SHARP, BlockStatus::DEBLURRED, BlockStatus::REJECTED}); }
FrameBlur sharp() { return field({BlockStatus::SHARP, BlockStatus::SHARP}); }
FrameBlur rejected() { return field({BlockStatus::SHARP, BlockStatus::REJECTED}); }

/// Waits until the image is decided on, as a camera's worker does.
class WaitingCamera : public StereoCamera {
 public:
  WaitingCamera(std::shared_ptr<StereoRig> rig, const std::string& name) : StereoCamera(std::move(rig), name) {
    set_wake([signal = signal_] { signal->notify(); });
  }

  FrameAction decide(TimeNs stamp_ns, const FrameBlur& field, const std::optional<DropReasons>& drop_reasons = {}) {
    std::optional<FrameAction> action;
    while (!(action = StereoCamera::decide(stamp_ns, field, drop_reasons))) signal_->wait(std::chrono::milliseconds(1));
    return *action;
  }

 private:
  const std::shared_ptr<WorkSignal> signal_ = std::make_shared<WorkSignal>();
};

class StereoRigTest : public testing::Test {
 protected:
  void make(TimeNs timeout_ns, int cameras = 2) {
    timeout_ns_ = timeout_ns;
    for (int i = 0; i < cameras; ++i) {
      cameras_.push_back(std::make_unique<WaitingCamera>(rig_, "/cam" + std::to_string(i)));
      cameras_.back()->set_timeout(timeout_ns_);
    }
  }
  WaitingCamera& camera(std::size_t i) { return *cameras_[i]; }
  void announce(TimeNs stamp_ns) {
    for (const auto& camera : cameras_) camera->announce(stamp_ns);
  }
  /// In a thread of its own.
  std::future<std::string> decide(std::size_t i, TimeNs stamp_ns, const FrameBlur& field = blurred()) {
    return std::async(std::launch::async, [this, i, stamp_ns, field] {
      camera(i).begin(stamp_ns);
      return camera(i).decide(stamp_ns, field).pass_through_text;
    });
  }

  TimeNs timeout_ns_ = 0;
  const std::shared_ptr<StereoRig> rig_ = std::make_shared<StereoRig>();
  std::vector<std::unique_ptr<WaitingCamera>> cameras_;
};

TEST_F(StereoRigTest, OneCameraDecidesAlone) {
  make(kEndless, /*cameras=*/1);
  camera(0).announce(kPeriod);
  EXPECT_EQ(camera(0).decide(kPeriod, blurred()).pass_through_text, "");
}

TEST_F(StereoRigTest, BothWaitForEachOther) {
  make(kEndless, /*cameras=*/3);
  for (TimeNs stamp_ns = kPeriod; stamp_ns < 20 * kPeriod; stamp_ns += kPeriod) {
    announce(stamp_ns);
    auto first = decide(0, stamp_ns), second = decide(1, stamp_ns);
    EXPECT_EQ(camera(2).decide(stamp_ns, blurred()).pass_through_text, "");
    EXPECT_EQ(first.get(), "");
    EXPECT_EQ(second.get(), "");
  }
}

TEST_F(StereoRigTest, NoCallWaitsAndTheCameraThatHasToIsWoken) {
  make(kEndless);
  int woken = 0;
  StereoCamera waits(rig_, "/waits");
  waits.set_wake([&] { ++woken; });
  waits.set_timeout(kEndless);
  cameras_.pop_back();
  announce(kPeriod);
  waits.announce(kPeriod);
  EXPECT_EQ(woken, 0) << "nothing waits";
  EXPECT_FALSE(waits.decide(kPeriod, blurred()));
  EXPECT_FALSE(waits.decide(kPeriod, blurred())) << "asked again";
  const int before = woken;
  EXPECT_EQ(camera(0).decide(kPeriod, blurred()).pass_through_text, "");
  EXPECT_GT(woken, before);
  const auto action = waits.decide(kPeriod, blurred());
  ASSERT_TRUE(action);
  EXPECT_TRUE(action->deblurs());
  const int after = woken;
  announce(2 * kPeriod);
  EXPECT_EQ(woken, after) << "it waits no longer";
}

TEST_F(StereoRigTest, WaitOfAnImageThatFailedIsForgotten) {
  make(kEndless);
  for (const TimeNs stamp_ns : {kPeriod, 2 * kPeriod}) announce(stamp_ns);
  EXPECT_FALSE(camera(0).deadline());
  EXPECT_FALSE(camera(0).StereoCamera::decide(kPeriod, blurred()));
  EXPECT_TRUE(camera(0).deadline());
  camera(0).pass_through(kPeriod, PassThroughReason::INTERNAL_ERROR);
  camera(1).pass_through(2 * kPeriod, PassThroughReason::OVERLOAD);
  EXPECT_EQ(camera(0).decide(2 * kPeriod, blurred()).pass_through_text, "/cam1 passes this image through: OVERLOAD");
  EXPECT_FALSE(camera(0).deadline());
}

TEST_F(StereoRigTest, ImageThatPassesThroughTakesItsPartnerAlong) {
  make(kEndless);
  announce(kPeriod);
  auto waits = decide(0, kPeriod);
  camera(1).pass_through(kPeriod, PassThroughReason::OVERLOAD);
  EXPECT_EQ(waits.get(), "/cam1 passes this image through: OVERLOAD");
  announce(2 * kPeriod);
  camera(1).pass_through(2 * kPeriod, PassThroughReason::NO_CALIBRATION);  // before anybody asks
  EXPECT_EQ(camera(0).decide(2 * kPeriod, blurred()).pass_through_text,
            "/cam1 passes this image through: NO_CALIBRATION");
}

TEST_F(StereoRigTest, ImageThatStaysBlurredTakesItsPartnerAlongAndOneThatIsSharpDoesNot) {
  make(kEndless);
  announce(kPeriod);
  EXPECT_EQ(camera(1).decide(kPeriod, rejected()).pass_through_text, "")
      << "it is processed, though nothing may be deblurred";
  EXPECT_EQ(camera(0).decide(kPeriod, blurred()).pass_through_text,
            "/cam1 has no block of this image that may be deblurred");
  announce(2 * kPeriod);
  EXPECT_EQ(camera(1).decide(2 * kPeriod, sharp()).pass_through_text, "");
  EXPECT_EQ(camera(0).decide(2 * kPeriod, blurred()).pass_through_text, "");
  for (const BlockStatus status : {BlockStatus::TOO_LARGE, BlockStatus::TOO_CURVED, BlockStatus::NO_GYRO}) {
    const TimeNs stamp_ns = (3 + static_cast<int>(status)) * kPeriod;
    announce(stamp_ns);
    camera(1).decide(stamp_ns, field({BlockStatus::SHARP, status}));
    EXPECT_NE(camera(0).decide(stamp_ns, blurred()).pass_through_text, "") << to_string(status);
  }
}

TEST_F(StereoRigTest, WhoGivesUpBindsThePartner) {
  make(kNone);
  announce(kPeriod);
  EXPECT_EQ(camera(0).decide(kPeriod, blurred()).pass_through_text,
            "/cam1 has not decided on its image of 0.050000000 s within 0 ms");
  EXPECT_EQ(camera(1).decide(kPeriod, blurred()).pass_through_text, "/cam0 has not waited for this image any longer");
}

TEST_F(StereoRigTest, WhatIsAgreedOnStays) {
  make(kEndless);
  announce(kPeriod);
  auto first = decide(0, kPeriod);
  EXPECT_EQ(camera(1).decide(kPeriod, blurred()).pass_through_text, "");
  camera(1).pass_through(kPeriod, PassThroughReason::INTERNAL_ERROR);  // too late
  EXPECT_EQ(first.get(), "");
}

TEST_F(StereoRigTest, LostImageHoldsNobodyUp) {
  make(kEndless);
  announce(kPeriod);
  camera(0).announce(2 * kPeriod);
  auto first = decide(0, 2 * kPeriod);
  camera(1).announce(3 * kPeriod);
  EXPECT_EQ(first.get(), "");
  camera(0).announce(3 * kPeriod);
  auto second = decide(0, 3 * kPeriod);
  EXPECT_EQ(camera(1).decide(3 * kPeriod, blurred()).pass_through_text, "");
  EXPECT_EQ(second.get(), "");
}

TEST_F(StereoRigTest, SilentCameraCostsThreeImages) {
  make(kNone);
  camera(0).announce(kPeriod);
  EXPECT_EQ(camera(0).decide(kPeriod, blurred()).pass_through_text, "") << "no image of the other has ever come";
  announce(2 * kPeriod);
  camera(1).pass_through(2 * kPeriod, PassThroughReason::OVERLOAD);
  for (TimeNs i = 3; i < 20; ++i) {
    camera(0).announce(i * kPeriod);
    EXPECT_EQ(camera(0).decide(i * kPeriod, blurred()).pass_through_text.empty(), i >= 6) << i;
  }
  // It comes back, and its images count at once.
  announce(20 * kPeriod);
  camera(1).pass_through(20 * kPeriod, PassThroughReason::OVERLOAD);
  EXPECT_NE(camera(0).decide(20 * kPeriod, blurred()).pass_through_text, "");
}

TEST_F(StereoRigTest, CameraOfAnotherRateIsNotWaitedForLong) {
  make(kNone);
  int refused = 0;
  for (TimeNs i = 1; i <= 100; ++i) {
    camera(0).announce(i * kPeriod);
    if (i % 2 == 0) {
      camera(1).announce(i * kPeriod);
      EXPECT_EQ(camera(1).decide(i * kPeriod, sharp()).pass_through_text, "");
    }
    refused += !camera(0).decide(i * kPeriod, blurred()).pass_through_text.empty();
  }
  EXPECT_LE(refused, 6);
}

TEST_F(StereoRigTest, CameraThatIsSilentForAWhileIsWaitedForAgain) {
  make(kNone);
  announce(kPeriod);
  camera(1).decide(kPeriod, sharp());
  TimeNs i = 2;
  for (; i < 10; ++i) {
    camera(0).announce(i * kPeriod);
    camera(0).decide(i * kPeriod, blurred());
  }
  // Its images come late again, as they do when nobody waits for them.
  int refused = 0;
  for (; i < 20; ++i) {
    camera(0).announce(i * kPeriod);
    refused += !camera(0).decide(i * kPeriod, blurred()).pass_through_text.empty();
    camera(1).announce(i * kPeriod);
  }
  EXPECT_GT(refused, 0);
}

TEST_F(StereoRigTest, SlowCameraIsWaitedForOnlyWhileItIsAtTheImage) {
  make(kNone);
  const std::string waited = " s within 0 ms", not_waited = " s";
  const auto expect = [this](TimeNs i, const std::string& end) {
    const std::string why = camera(0).decide(i * kPeriod, blurred()).pass_through_text;
    EXPECT_EQ(why.substr(why.size() - std::min(why.size(), end.size())), end) << i << ": " << why;
  };
  TimeNs i = 1;
  for (; i <= 3; ++i) {
    announce(i * kPeriod);
    expect(i, waited);
  }
  announce(i * kPeriod);
  expect(i++, not_waited);
  announce(i * kPeriod);
  camera(1).begin(i * kPeriod);
  expect(i++, waited);
  // In time again.
  for (int k = 0; k < 3; ++k, ++i) {
    announce(i * kPeriod);
    camera(1).decide(i * kPeriod, sharp());
    EXPECT_EQ(camera(0).decide(i * kPeriod, blurred()).pass_through_text, "");
  }
  announce(i * kPeriod);
  expect(i, waited);
}

TEST_F(StereoRigTest, StampsOfAPairMayDifferByThreeMilliseconds) {
  make(kNone);
  camera(0).announce(kPeriod);
  camera(1).announce(kPeriod + 3 * kMs);
  camera(1).pass_through(kPeriod + 3 * kMs, PassThroughReason::OVERLOAD);
  EXPECT_NE(camera(0).decide(kPeriod, blurred()).pass_through_text, "");
  camera(0).announce(2 * kPeriod);
  camera(1).announce(2 * kPeriod + 3 * kMs + 1);
  camera(1).pass_through(2 * kPeriod + 3 * kMs + 1, PassThroughReason::OVERLOAD);
  EXPECT_EQ(camera(0).decide(2 * kPeriod, blurred()).pass_through_text, "")
      << "a later image: it has none of this instant";
}

TEST_F(StereoRigTest, LeavingWakesThePartnerAndOneself) {
  make(kEndless);
  announce(kPeriod);
  auto partner = decide(0, kPeriod);
  cameras_[1].reset();
  EXPECT_EQ(partner.get(), "");
  cameras_[1] = std::make_unique<WaitingCamera>(rig_, "/cam1");
  cameras_[1]->set_timeout(timeout_ns_);
  announce(2 * kPeriod);
  auto oneself = decide(0, 2 * kPeriod);
  camera(0).set_timeout(0);
  EXPECT_EQ(oneself.get(), "");
  EXPECT_EQ(camera(1).decide(2 * kPeriod, blurred()).pass_through_text, "");
}

TEST_F(StereoRigTest, RecordingThatIsPlayedAgainIsDecidedAnew) {
  make(kEndless);
  for (int loop = 0; loop < 3; ++loop) {
    for (TimeNs i = 1; i <= 5; ++i) {
      announce(i * kPeriod);
      const bool passes = (i + loop) % 2 == 0;
      if (passes) camera(1).pass_through(i * kPeriod, PassThroughReason::OVERLOAD);
      auto first = decide(0, i * kPeriod);
      if (!passes) {
        EXPECT_EQ(camera(1).decide(i * kPeriod, blurred()).pass_through_text, "") << loop << ' ' << i;
      }
      EXPECT_EQ(first.get().empty(), !passes) << loop << ' ' << i;
    }
  }
}

/// Cameras that drop bad images.
class DroppingRigTest : public StereoRigTest {
 protected:
  static DropReasons fine() { return {true, "", ""}; }
  static DropReasons poor() { return {true, "POOR", "POOR"}; }
  static DropReasons poor_if_passed_through() { return {true, "", "POOR"}; }
  std::future<FrameAction> decide_drop(std::size_t i, TimeNs stamp_ns, const FrameBlur& field,
                                       const DropReasons& drop) {
    return std::async(std::launch::async, [this, i, stamp_ns, field, drop] {
      camera(i).begin(stamp_ns);
      return camera(i).decide(stamp_ns, field, drop);
    });
  }
  /// What becomes of both images of a new instant.
  std::array<FrameAction, 2> decide_both(const FrameBlur& first_field, const DropReasons& first,
                                         const FrameBlur& second_field, const DropReasons& second) {
    stamp_ns_ += kPeriod;
    announce(stamp_ns_);
    auto one = decide_drop(0, stamp_ns_, first_field, first);
    auto other = decide_drop(1, stamp_ns_, second_field, second);
    return {one.get(), other.get()};
  }
  TimeNs stamp_ns_ = 0;
};

TEST_F(DroppingRigTest, BothAreDroppedWhereOneIsPoor) {
  make(kEndless);
  for (const FrameBlur& partner : {blurred(), sharp(), rejected()}) {
    for (const FrameBlur& field : {blurred(), rejected()}) {
      for (const FrameAction& action : decide_both(field, poor(), partner, fine())) {
        EXPECT_EQ(action.drop_text, "the image of /cam0 is POOR");
      }
    }
    for (const FrameAction& action : decide_both(blurred(), fine(), partner, fine())) {
      EXPECT_EQ(action.drop_text, "");
    }
  }
}

TEST_F(DroppingRigTest, WhetherItIsPoorGoesByWhatBecomesOfIt) {
  make(kEndless);
  for (const FrameAction& action : decide_both(blurred(), poor_if_passed_through(), blurred(), fine())) {
    EXPECT_EQ(action.drop_text + action.pass_through_text, "");
  }
  for (const FrameAction& action : decide_both(blurred(), poor_if_passed_through(), rejected(), fine())) {
    EXPECT_EQ(action.drop_text, "the image of /cam0 is POOR") << "its stereo partner keeps it from being deblurred";
  }
}

TEST_F(DroppingRigTest, NoneIsDroppedWhereOneLeavesWhateverTheOthersSay) {
  make(kEndless);
  announce(kPeriod);
  auto waits = decide_drop(0, kPeriod, blurred(), poor());
  camera(1).pass_through(kPeriod, PassThroughReason::OVERLOAD);
  const FrameAction action = waits.get();
  EXPECT_EQ(action.drop_text, "");
  EXPECT_EQ(action.pass_through_text, "/cam1 passes this image through: OVERLOAD");
  stamp_ns_ = kPeriod;
  for (const FrameAction& each : decide_both(blurred(), poor(), blurred(), DropReasons{false, "", ""})) {
    EXPECT_EQ(each.drop_text, "");
  }
}

TEST_F(DroppingRigTest, WhoGivesUpIsPublishedAndSoIsTheStereoPartner) {
  make(kNone);
  announce(kPeriod);
  EXPECT_EQ(camera(0).decide(kPeriod, sharp(), fine()).pass_through_text, "");
  const FrameAction late = camera(1).decide(kPeriod, blurred(), poor());
  EXPECT_EQ(late.drop_text, "") << "a pair of which one image has left";
  EXPECT_EQ(late.pass_through_text, "") << "a sharp image goes with a deblurred one";
  announce(2 * kPeriod);
  EXPECT_NE(camera(0).decide(2 * kPeriod, blurred(), poor()).pass_through_text, "");
  EXPECT_EQ(camera(1).decide(2 * kPeriod, blurred(), poor()).drop_text, "");
}

TEST_F(DroppingRigTest, WhoIsTooLateToBeAskedIsNotDroppedWhereItMayNotBe) {
  make(kEndless);
  // Nobody waits for a camera that has sent nothing yet.
  camera(0).announce(kPeriod);
  camera(0).begin(kPeriod);
  EXPECT_NE(camera(0).decide(kPeriod, blurred(), poor()).drop_text, "");
  camera(1).announce(kPeriod);
  camera(1).begin(kPeriod);
  EXPECT_EQ(camera(1).decide(kPeriod, blurred(), DropReasons{false, "", ""}).drop_text, "");
}

TEST_F(DroppingRigTest, CameraThatDropsNoneLosesNone) {
  make(kEndless);
  announce(kPeriod);
  auto dropping = decide_drop(0, kPeriod, blurred(), poor());
  EXPECT_EQ(camera(1).decide(kPeriod, blurred()).pass_through_text, "");
  EXPECT_NE(dropping.get().drop_text, "");
}

TEST_F(DroppingRigTest, AloneItGoesByItself) {
  make(kEndless, /*cameras=*/1);
  camera(0).announce(kPeriod);
  EXPECT_EQ(camera(0).decide(kPeriod, blurred(), poor()).drop_text, "the image of /cam0 is POOR");
  camera(0).set_timeout(0);
  EXPECT_EQ(camera(0).decide(2 * kPeriod, blurred(), poor()).drop_text, "POOR");
}

TEST_F(StereoRigTest, CamerasOfOneImuMeet) {
  EXPECT_EQ(StereoRig::get("/imu"), StereoRig::get("/imu")) << "while somebody has it";
  const auto rig = StereoRig::get("/imu");
  EXPECT_EQ(StereoRig::get("/imu"), rig);
  EXPECT_NE(StereoRig::get("/imu1"), rig);
}

/// Cameras that lose, pass through and reject at random: both images of an instant are deblurred or none. With an
/// endless timeout all that may be deblurred is, with a short one whatever threads have time for.
TEST_F(StereoRigTest, WhateverHappensBothAreDeblurredOrNone) {
  constexpr std::size_t kCameras = 2;
  constexpr TimeNs kImages = 3000;
  make(kEndless, kCameras);
  enum class Outcome { LOST, DEBLURRED, BLURRED, SHARP };
  std::array<std::vector<Outcome>, kCameras> outcomes;
  std::array<std::thread, kCameras> workers;
  // All have come before the work begins, as in a backlog.
  std::mt19937 random(7);
  std::array<std::vector<unsigned>, kCameras> fates;
  for (TimeNs i = 0; i < kImages; ++i) {
    for (std::size_t c = 0; c < kCameras; ++c) fates[c].push_back(random() % 20);
  }
  constexpr TimeNs kAtATime = 500;
  // An image that never comes is known as lost when a later one has come.
  for (auto& of_camera : fates) of_camera[kAtATime - 1] = 7;
  int permitted_both = 0;
  for (TimeNs i = 0; i < kAtATime; ++i) permitted_both += fates[0][i] >= 7 && fates[1][i] >= 7;
  for (TimeNs begin = 0; begin < kImages; begin += kAtATime) {
    for (TimeNs i = begin; i < begin + kAtATime; ++i) {
      for (std::size_t c = 0; c < kCameras; ++c) {
        if (fates[c][i] != 0) camera(c).announce((i + 1) * kPeriod);
      }
    }
    for (std::size_t c = 0; c < kCameras; ++c) {
      workers[c] = std::thread([&, c] {
        for (TimeNs i = begin; i < begin + kAtATime; ++i) {
          const TimeNs stamp_ns = (i + 1) * kPeriod;
          const unsigned fate = fates[c][i];
          if (fate == 0) {
            outcomes[c].push_back(Outcome::LOST);
            continue;
          }
          if (fate <= 3) {
            camera(c).pass_through(stamp_ns, PassThroughReason::OVERLOAD);
            outcomes[c].push_back(Outcome::BLURRED);
            continue;
          }
          camera(c).begin(stamp_ns);
          if (fate <= 6) {
            camera(c).decide(stamp_ns, fate <= 5 ? rejected() : sharp());
            outcomes[c].push_back(fate <= 5 ? Outcome::BLURRED : Outcome::SHARP);
            continue;
          }
          const bool permitted = camera(c).decide(stamp_ns, blurred()).pass_through_text.empty();
          outcomes[c].push_back(permitted ? Outcome::DEBLURRED : Outcome::BLURRED);
        }
      });
    }
    for (std::thread& worker : workers) worker.join();
    for (const auto& camera : cameras_) camera->set_timeout(kMs);
  }
  int deblurred = 0;
  for (TimeNs i = 0; i < kImages; ++i) {
    const Outcome first = outcomes[0][i], second = outcomes[1][i];
    deblurred += i < kAtATime && first == Outcome::DEBLURRED && second == Outcome::DEBLURRED;
    EXPECT_FALSE(first == Outcome::DEBLURRED && second == Outcome::BLURRED) << i;
    EXPECT_FALSE(first == Outcome::BLURRED && second == Outcome::DEBLURRED) << i;
  }
  EXPECT_GT(deblurred, 0);
  EXPECT_EQ(deblurred, permitted_both);
}

}  // namespace
}  // namespace gyro_deblur::stereo_rig_test
