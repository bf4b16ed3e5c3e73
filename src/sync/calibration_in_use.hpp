// Which calibration holds for frames: what was given, else what was estimated from the images.
#pragma once

#include <optional>
#include <set>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "calibrate/self_calibration.hpp"
#include "gyro_deblur/config.hpp"
#include "sync/input_problems.hpp"

namespace gyro_deblur {

/// What is known of one value, in words.
struct CalibrationRow {
  std::string key;         ///< as the parameter's
  std::string text;        ///< the value, where it is from, how well it is known, or what is missing to know it
  bool by_images = false;  ///< it was estimated from the images
};

/// Takes estimates for values that are not given, and reports what is given and contradicted. An estimate that is used
/// is replaced when a later one is surer or another one. Its owner serialises access.
class CalibrationInUse {
 public:
  /// @param problems  has to outlive this
  explicit CalibrationInUse(InputProblems* problems);

  void set_config(const Config& config);
  /// What was learned before, e.g. at the last start: used until an estimate from the images is surer, or differs.
  void remember(const LearnedCalibration& before);
  /// As after the start, with nothing remembered.
  void forget();
  /// What is used of the estimates from the images, and nothing else.
  LearnedCalibration by_images() const;
  /// The configuration, with what has been learned in place of what is not given.
  const Config& config() const { return config_; }
  /// True when no rotation is given, and one has been estimated from the images. tf goes before it.
  const std::optional<Eigen::Matrix3d>& R_cam_imu() const { return R_cam_imu_; }
  /// In the larger side of images of this size, where it has been estimated from those of a lens that is not known.
  std::optional<double> focal_length(int width_px, int height_px) const;
  /// Why there is no rotation by the images.
  std::string missing_rotation() const;

  /// @param readout_share        of the sensor's readout time that the images take, see region_readout_ns()
  /// @param readout_by_messages  the exposures that images are learned by have a message's readout time; otherwise the
  ///                             one that is given, or none
  /// @return true when other values are used from now on
  bool learn(const LearnedCalibration& learned, double readout_share, bool readout_by_messages);
  /// Without a known lens the focal length is learned as well.
  void set_lens_known(bool known) { lens_known_ = known; }
  /// The rotation that tf has; nothing: none is used.
  void set_tf(const std::optional<Eigen::Matrix3d>& R_cam_imu) { from_tf_ = R_cam_imu; }

  std::vector<CalibrationRow> table() const;

 private:
  bool learns() const { return given_.self_calibration == SelfCalibrationMode::AUTO; }
  void use();
  /// Takes an estimate that is the first, surer, or another one. @return true when it is used from now on
  template <typename Value>
  bool take(const std::string& key, const Learned<Value>& newest, Learned<Value>* taken);
  void check();
  /// Where a given value is from: "parameter", or the calibration file that has it.
  std::string source(bool file_has_it) const;
  /// Whether the estimates were made with a readout time.
  bool has_readout() const { return given_.given.readout_time || readout_by_messages_; }
  /// What a learned offset contains of a readout time that the exposures were without.
  double readout_in_offset_s() const;
  /// For exposures with the readout time that is used.
  Learned<double> time_offset() const;
  UsedCalibration used() const;

  InputProblems& problems_;
  Config given_, config_;
  std::optional<Eigen::Matrix3d> R_cam_imu_, from_tf_;
  LearnedCalibration learned_;        // newest
  LearnedCalibration taken_;          // in use where nothing is given
  std::set<std::string> remembered_;  // keys of values in taken_
  double readout_share_ = 1;
  bool readout_by_messages_ = false;
  std::optional<bool> lens_known_;  // until there has been an image
};

}  // namespace gyro_deblur
