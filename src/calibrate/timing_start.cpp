// Finds a first time offset and rotation.
#include "calibrate/timing_start.hpp"

#include <cmath>
#include <limits>

#include <Eigen/Geometry>
#include <Eigen/SVD>

#include "base/format.hpp"
#include "calibrate/aligned_rotation.hpp"

namespace gyro_deblur {
namespace {

constexpr double kMinCorrelation = 0.5;
constexpr TimeNs kSearchStepNs = 1'000'000;

/// Rotation that takes the rays of the first frame to those of the second, as if all rows were exposed at once.
Eigen::Matrix3d image_rotation(const Camera& camera, const WindowPoints& points) {
  std::vector<Eigen::Vector3d> from, to;
  for (const Sighting& sighting : points.sightings) {
    if (sighting.frame != 1) continue;
    from.push_back(points.anchors[sighting.anchor].ray.normalized());
    to.push_back(camera.ray(sighting.px).normalized());
  }
  return robust_rotation(from, to);
}

/// Pearson's, -1 where it is not defined.
class Correlation {
 public:
  void add(double a, double b) { n_ += 1, a_ += a, b_ += b, aa_ += a * a, bb_ += b * b, ab_ += a * b; }
  double value() const {
    const double variance_a = aa_ - a_ * a_ / n_, variance_b = bb_ - b_ * b_ / n_;
    if (n_ < static_cast<double>(kMinPairs) || !(variance_a > 0) || !(variance_b > 0)) return -1;
    return (ab_ - a_ * b_ / n_) / std::sqrt(variance_a * variance_b);
  }

 private:
  double n_ = 0, a_ = 0, b_ = 0, aa_ = 0, bb_ = 0, ab_ = 0;
};

}  // namespace

TimingStart::TimingStart(const TimingModel& model, const std::vector<WindowPoints>& windows)
    : model_(model), windows_(windows) {
  // Scene points move against the camera.
  for (const WindowPoints& points : windows) {
    image_rotations_.push_back(-log_rotation(image_rotation(model.camera(), points)));
  }
}

std::vector<Eigen::Vector3d> TimingStart::gyro_rotations(const TimingState& state) const {
  const RotationTrack gyro = model_.track(state);
  std::vector<Eigen::Vector3d> rotations;
  for (const WindowPoints& points : windows_) {
    const std::vector<FrameTime>& frames = points.window->frames;
    const TimeRange range{model_.middle_of(frames[0], state.readout_s), model_.middle_of(frames[1], state.readout_s)};
    rotations.emplace_back(gyro.covers(range)
                               ? Eigen::Vector3d(-log_rotation(gyro.rotation(range.begin_ns, range.end_ns)))
                               : Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN()));
  }
  return rotations;
}

double TimingStart::search_offset(TimeNs search_ns, TimingState* state) const {
  TimingState plain = *state;
  plain.time_offset_s = 0;
  plain.R_cam_imu.setIdentity();
  const RotationTrack gyro = model_.track(plain);  // camera clock = IMU clock here
  const auto correlate = [&](TimeNs offset_ns) {
    Correlation correlation;
    for (std::size_t i = 0; i < windows_.size(); ++i) {
      const std::vector<FrameTime>& frames = windows_[i].window->frames;
      const TimeRange range{model_.middle_of(frames[0], state->readout_s) + offset_ns,
                            model_.middle_of(frames[1], state->readout_s) + offset_ns};
      if (!gyro.covers(range)) continue;
      const double dt_s = to_seconds(range.end_ns - range.begin_ns);
      correlation.add(image_rotations_[i].norm() / dt_s,
                      Eigen::AngleAxisd(gyro.rotation(range.begin_ns, range.end_ns)).angle() / dt_s);
    }
    return correlation.value();
  };
  const TimeNs center_ns = to_ns(state->time_offset_s);
  TimeNs best_ns = center_ns;
  double best = correlate(center_ns);
  for (TimeNs shift_ns = kSearchStepNs; shift_ns <= search_ns; shift_ns += kSearchStepNs) {
    for (const TimeNs offset_ns : {center_ns - shift_ns, center_ns + shift_ns}) {
      const double value = correlate(offset_ns);
      if (value <= best) continue;
      best = value;
      best_ns = offset_ns;
    }
  }
  state->time_offset_s = to_seconds(best_ns);
  if (best < kMinCorrelation) {
    throw TimingError(
        format("the angular speeds of image and gyroscope do not agree at any offset within %.2g s of %.2g s: the best "
               "correlation is %.2g, %.2g is needed; is there motion, are the images not stabilised, do the recordings "
               "belong together, are the rates in rad/s?",
               to_seconds(search_ns), to_seconds(center_ns), best, kMinCorrelation));
  }
  return best;
}

void TimingStart::find_rotation(TimingState* state) const {
  TimingState plain = *state;
  plain.R_cam_imu.setIdentity();
  const std::vector<Eigen::Vector3d> by_gyro = gyro_rotations(plain);
  std::vector<Eigen::Vector3d> from, to;
  for (std::size_t i = 0; i < by_gyro.size(); ++i) {
    if (!by_gyro[i].allFinite()) continue;
    from.push_back(by_gyro[i]);
    to.push_back(image_rotations_[i]);
  }
  constexpr int kIterations = 10;
  Eigen::Matrix3d moment;
  state->R_cam_imu = robust_rotation(from, to, kIterations, &moment);
  // Rotation about one axis only does not determine the angle about it.
  const Eigen::Vector3d spread = Eigen::JacobiSVD<Eigen::Matrix3d>(moment).singularValues();
  constexpr double kLeastSpread = 0.02;
  if (spread[1] < kLeastSpread * spread[0]) {
    throw TimingError(
        "the rotation between IMU and camera is not determined: the recording rotates about one axis only; rotate it "
        "about others too, or give R_cam_imu");
  }
}

}  // namespace gyro_deblur
