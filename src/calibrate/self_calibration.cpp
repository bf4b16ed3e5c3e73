// Calibrates from the rates of images and gyroscope, and says what is missing for it.
#include "calibrate/self_calibration.hpp"

#include <algorithm>
#include <array>

#include <Eigen/Geometry>

#include "base/format.hpp"
#include "base/require_range.hpp"
#include "gyro_deblur/calibration.hpp"

namespace gyro_deblur {
namespace {

constexpr TimeNs kSecondNs = 1'000'000'000;
constexpr TimeNs kWindowNs = 30 * kSecondNs, kUpdateNs = kSecondNs;
/// Of 30 images a second and more.
constexpr std::size_t kMostRates = 1000;

/// Motion that counts: at 460 px of focal length and 20 ms a blur of 1 px.
constexpr double kRotatingRadS = 0.1;
constexpr double kLeastRotatingS = 2, kLeastReadoutS = 5;
/// Least correlation of images and gyroscope: unrelated motions of some seconds reach .6 at one offset of a hundred.
constexpr double kLeastCorrelation = 0.7, kLeastAgreeing = 0.6;
/// Beyond it the rates have another unit, or the focal length is wrong.
constexpr double kLeastScale = 0.6, kLargestScale = 1.6;
/// About a second axis, root mean square: a twentieth of a degree a frame.
constexpr double kLeastSecondRadS = 0.03;
/// Errors that the parts of one window share: exposures that jitter, tracking that pulls to one side.
constexpr double kOffsetFloorS = 0.0005, kRotationFloorRad = 0.1 / kDegPerRad, kBiasFloorRadS = 0.001,
                 kReadoutFloorS = 0.0005, kReadoutFloorShare = 0.08, kFocalFloorShare = 0.02;

constexpr double kStillRadS = 0.02;
constexpr TimeNs kStillNs = kSecondNs, kStillPieceNs = kSecondNs / 4;
/// Largest mean rate over a quarter of a second of a sensor at rest.
constexpr double kRestingRadS = 0.01;
/// Largest bias of a gyroscope. A larger estimate is a rotation that the images do not show.
constexpr double kLargestBiasRadS = 0.3;

/// An axis of the camera in words.
const char* axis_name(const Eigen::Vector3d& axis) {
  Eigen::Index largest = 0;
  axis.cwiseAbs().maxCoeff(&largest);
  constexpr std::array<const char*, 3> kNames{"up and down (about x)", "left and right (about y)",
                                              "about the optical axis (z)"};
  return kNames[static_cast<std::size_t>(largest)];
}

/// Takes a later value over where it is surer, or rests on about as much motion, or where both cannot be true.
template <typename Value>
void take(const Value& value, double stddev, double seconds, Learned<Value>* learned) {
  constexpr double kAboutAsMuch = 0.7, kCannotAgree = 4;
  const bool keep = learned->known && stddev > learned->stddev && seconds < kAboutAsMuch * learned->seconds &&
                    difference(value, learned->value) < kCannotAgree * std::hypot(stddev, learned->stddev);
  if (!keep) *learned = {value, stddev, seconds, true, ""};
}

template <typename Value>
void set_missing(const std::string& missing, Learned<Value>* learned) {
  if (!learned->known) learned->missing = missing;
}

}  // namespace

double difference(double a, double b) { return std::abs(a - b); }
double difference(const Eigen::Vector3d& a, const Eigen::Vector3d& b) { return (a - b).norm(); }
double difference(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b) {
  return Eigen::AngleAxisd(Eigen::Matrix3d(a.transpose() * b)).angle();
}

SelfCalibration::SelfCalibration(TimeNs expected_offset_ns, TimeNs search_ns)
    : expected_offset_ns_(expected_offset_ns), search_ns_(search_ns), gyro_(kWindowNs + 4 * search_ns) {
  constexpr double kLongestOffsetS = 4e9, kLongestSearchS = 5, kShortestSearchS = 0.02;
  require_range("time_offset", to_seconds(expected_offset_ns), -kLongestOffsetS, kLongestOffsetS, "s");
  require_range("search", to_seconds(search_ns), kShortestSearchS, kLongestSearchS, "s");
  refuse("nothing has been seen yet");
}

void SelfCalibration::restart() {
  gyro_.clear();
  rates_.clear();
  still_since_ns_.reset();
  updated_ns_.reset();
}

void SelfCalibration::add_sample(const GyroSample& sample) { gyro_.add(sample); }

void SelfCalibration::add_rate(const ImageRate& rate) {
  if (!rates_.empty() &&
      (rate.begin_ns < rates_.back().begin_ns || rate.larger_side_px != rates_.back().larger_side_px)) {
    rates_.clear();
    updated_ns_.reset();
    still_since_ns_.reset();
  }
  if (!updated_ns_) updated_ns_ = rate.begin_ns;
  if (rate.speed_rad_s > kStillRadS || (!rates_.empty() && rate.begin_ns > rates_.back().end_ns)) {
    still_since_ns_.reset();
  }
  if (rate.speed_rad_s <= kStillRadS && !still_since_ns_) still_since_ns_ = rate.begin_ns;
  rates_.push_back(rate);
  while (rates_.size() > kMostRates || rate.end_ns - rates_.front().begin_ns > kWindowNs) rates_.pop_front();
}

bool SelfCalibration::is_due() const { return updated_ns_ && rates_.back().end_ns - *updated_ns_ >= kUpdateNs; }

void SelfCalibration::update() {
  if (rates_.empty()) return;
  updated_ns_ = rates_.back().end_ns;
  learn_alignment();
  learn_resting_bias();
}

void SelfCalibration::refuse(const std::string& missing) {
  set_missing(missing, &learned_.R_cam_imu);
  set_missing(missing, &learned_.time_offset_s);
  set_missing(missing, &learned_.readout_s);
  set_missing(missing, &learned_.bias_rad_s);
  set_missing(missing, &learned_.focal_length);
}

std::vector<ImageRate> SelfCalibration::usable_rates() const {
  std::vector<ImageRate> usable;
  for (const ImageRate& rate : rates_) {
    const TimeNs begin_ns = rate.begin_ns + expected_offset_ns_ - search_ns_;
    const TimeNs end_ns = rate.end_ns + expected_offset_ns_ + search_ns_;
    if (gyro_.covers({begin_ns, end_ns})) usable.push_back(rate);
  }
  return usable;
}

std::string SelfCalibration::missing_data() const {
  const TimeRange gyro = gyro_.available();
  if (gyro.empty()) return "there are no gyroscope samples";
  const double ahead_s = to_seconds(rates_.back().end_ns + expected_offset_ns_ - gyro.end_ns);
  if (std::abs(ahead_s) > 2 * to_seconds(search_ns_) + 1) {
    return format(
        "stamps of images are %.3f s %s those of the gyroscope, and offsets within %.1f s of %.6g s are looked "
        "for: set time_offset to about %.3f",
        std::abs(ahead_s), ahead_s > 0 ? "ahead of" : "behind", to_seconds(search_ns_), to_seconds(expected_offset_ns_),
        to_seconds(expected_offset_ns_) - ahead_s);
  }
  return "more images and gyroscope samples are waited for";
}

void SelfCalibration::learn_alignment() {
  const std::vector<ImageRate> rates = usable_rates();
  if (rates.empty()) return refuse(missing_data());
  double image_s = 0, gyro_s = 0;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  const auto gyro_rate = [this](const ImageRate& rate) {
    return gyro_.mean_rate({rate.begin_ns + expected_offset_ns_, rate.end_ns + expected_offset_ns_});
  };
  for (const ImageRate& rate : rates) mean += gyro_rate(rate) / static_cast<double>(rates.size());
  for (const ImageRate& rate : rates) {
    const double step_s = to_seconds(rate.end_ns - rate.begin_ns);
    if (rate.rate_rad_s.norm() > kRotatingRadS) image_s += step_s;
    if ((gyro_rate(rate) - mean).norm() > kRotatingRadS) gyro_s += step_s;
  }
  const double rotating_s = std::min(image_s, gyro_s);
  if (rotating_s < kLeastRotatingS) {
    return refuse(
        format("the camera has rotated faster than %.1f rad/s for %.1f of the %.0f s that it takes: rotate it",
               kRotatingRadS, rotating_s, kLeastRotatingS));
  }
  const OffsetPeak peak = search_rate_offset(rates, gyro_, expected_offset_ns_, search_ns_);
  const std::optional<RateAlignment> found = align_rates(rates, gyro_, peak.offset_ns);
  if (!found || found->correlation < kLeastCorrelation || found->agreeing < kLeastAgreeing || peak.at_edge) {
    return refuse(
        format("at no offset within %.1f s of %.6g s images rotate as the gyroscope does: the best correlation "
               "is %.2f, %.1f is needed, and %.0f %% of the images agree, %.0f %% have to; move the camera "
               "before a scene that stands still, and check that the gyroscope's rates are in rad/s",
               to_seconds(search_ns_), to_seconds(expected_offset_ns_), found ? found->correlation : peak.correlation,
               kLeastCorrelation, found ? 100 * found->agreeing : 0, 100 * kLeastAgreeing));
  }
  const bool lens_known = rates.front().lens_known;
  if (found->scale < (lens_known ? kLeastScale : kShortestFocalLength) ||
      found->scale > (lens_known ? kLargestScale : kLongestFocalLength)) {
    return refuse(format(lens_known ? "images rotate %.3g times as fast as the gyroscope says: check that its rates "
                                      "are in rad/s, and the focal length"
                                    : "images move as though the focal length were %.3g of their larger side: check "
                                      "that the gyroscope's rates are in rad/s",
                         found->scale));
  }
  if (peak.is_ambiguous) {
    return refuse(
        format("the motion repeats itself, so that time offsets of %.3f s and %.3f s fit equally well: rotate the "
               "camera irregularly",
               to_seconds(peak.offset_ns), to_seconds(peak.second_ns)));
  }
  const double offset_s = to_seconds(found->offset_ns);
  const double offset_stddev_s = std::hypot(found->offset_stddev_s, kOffsetFloorS);
  if (offset_stddev_s > UsefulStddev::kOffsetS) {
    return refuse(format("the time offset is known to %.0f ms, and %.0f ms are needed: rotate the camera faster",
                         1e3 * offset_stddev_s, 1e3 * UsefulStddev::kOffsetS));
  }
  take(offset_s, offset_stddev_s, rotating_s, &learned_.time_offset_s);
  learn_readout(*found, rotating_s);
  learn_rotation_and_bias(*found, rotating_s);
  if (!lens_known) learn_focal_length(*found, rotating_s);
}

void SelfCalibration::learn_focal_length(const RateAlignment& found, double rotating_s) {
  const double stddev = std::hypot(found.scale_stddev, kFocalFloorShare * found.scale);
  if (stddev > UsefulStddev::kFocalShare * found.scale) {
    return set_missing(format("the focal length is known to %.0f %%, and %.0f %% are needed: rotate the camera faster",
                              1e2 * stddev / found.scale, 1e2 * UsefulStddev::kFocalShare),
                       &learned_.focal_length);
  }
  if (rates_.back().larger_side_px != learned_.focal_image_px) learned_.focal_length = {};
  learned_.focal_image_px = rates_.back().larger_side_px;
  take(found.scale, stddev, rotating_s, &learned_.focal_length);
}

void SelfCalibration::learn_readout(const RateAlignment& found, double rotating_s) {
  const double stddev_s =
      std::hypot(found.readout_stddev_s, kReadoutFloorS + kReadoutFloorShare * std::abs(found.readout_s));
  if (rotating_s < kLeastReadoutS) {
    return set_missing(format("the camera has rotated for %.1f of the %.0f s that the readout time takes: rotate it",
                              rotating_s, kLeastReadoutS),
                       &learned_.readout_s);
  }
  if (stddev_s > UsefulStddev::kReadoutS) {
    return set_missing(format("the readout time is known to %.0f ms, and %.0f ms are needed: rotate the camera faster",
                              1e3 * stddev_s, 1e3 * UsefulStddev::kReadoutS),
                       &learned_.readout_s);
  }
  // A global shutter's is 0, and not nearly.
  const double readout_s = std::abs(found.readout_s) < 2 * stddev_s ? 0 : found.readout_s;
  take(readout_s, stddev_s, rotating_s, &learned_.readout_s);
}

void SelfCalibration::learn_rotation_and_bias(const RateAlignment& found, double rotating_s) {
  const double rotation_stddev_rad = std::hypot(found.rotation_stddev_rad, kRotationFloorRad);
  std::string missing;
  if (found.second_rad_s < std::max(kLeastSecondRadS, found.spread_rad_s / 2)) {
    missing = format("the camera has rotated about one axis only, %s: rotate it about another one, too",
                     axis_name(found.main_axis));
  } else if (rotation_stddev_rad > UsefulStddev::kRotationRad) {
    missing = format("the rotation is known to %.1f degrees, and %.1f are needed: rotate the camera about all axes",
                     kDegPerRad * rotation_stddev_rad, kDegPerRad * UsefulStddev::kRotationRad);
  }
  if (!missing.empty()) {
    set_missing(missing, &learned_.R_cam_imu);
    set_missing(missing + ", or let it stand still", &learned_.bias_rad_s);
    return;
  }
  take(found.R_cam_imu, rotation_stddev_rad, rotating_s, &learned_.R_cam_imu);
  const double bias_stddev_rad_s = std::hypot(found.bias_stddev_rad_s, kBiasFloorRadS);
  if (bias_stddev_rad_s > UsefulStddev::kBiasRadS) {
    set_missing(format("the bias is known to %.3f rad/s, and %.3f are needed: let the camera stand still",
                       bias_stddev_rad_s, UsefulStddev::kBiasRadS),
                &learned_.bias_rad_s);
    return;
  }
  // At rest it is known better, but it drifts, and a slow pan passes for rest.
  const double change_rad_s = difference(found.bias_rad_s, learned_.bias_rad_s.value);
  if (bias_of_rest_ && change_rad_s < std::max(2 * UsefulStddev::kBiasRadS, 4 * bias_stddev_rad_s)) return;
  bias_of_rest_ = false;
  take(found.bias_rad_s, bias_stddev_rad_s, rotating_s, &learned_.bias_rad_s);
}

void SelfCalibration::learn_resting_bias() {
  if (!still_since_ns_) return;
  // Whatever the offset is, the gyroscope stood still then, too.
  const TimeNs around_ns = learned_.time_offset_s.known ? kSecondNs / 10 : search_ns_;
  const TimeNs offset_ns = learned_.time_offset_s.known ? to_ns(learned_.time_offset_s.value) : expected_offset_ns_;
  TimeNs begin_ns = *still_since_ns_ + offset_ns + around_ns;
  const TimeNs end_ns = std::min(rates_.back().end_ns + offset_ns - around_ns, gyro_.available().end_ns);
  begin_ns = std::max(begin_ns, end_ns - 4 * kSecondNs);
  if (end_ns - begin_ns < kStillNs || !gyro_.covers({begin_ns, end_ns})) return;
  std::vector<Eigen::Vector3d> pieces;
  for (TimeNs t_ns = begin_ns; t_ns + kStillPieceNs <= end_ns; t_ns += kStillPieceNs) {
    pieces.push_back(gyro_.mean_rate({t_ns, t_ns + kStillPieceNs}));
  }
  Eigen::Vector3d mean = Eigen::Vector3d::Zero(), squares = Eigen::Vector3d::Zero();
  const auto count = static_cast<double>(pieces.size());
  for (const Eigen::Vector3d& piece : pieces) mean += piece / count;
  for (const Eigen::Vector3d& piece : pieces) squares += (piece - mean).cwiseAbs2() / (count - 1);
  const double scatter_rad_s = std::sqrt(squares.maxCoeff());
  if (scatter_rad_s > kRestingRadS || mean.norm() > kLargestBiasRadS) return;
  learned_.bias_rad_s = {mean, std::hypot(scatter_rad_s / std::sqrt(count), kBiasFloorRadS),
                         to_seconds(end_ns - begin_ns), true, ""};
  bias_of_rest_ = true;
}

std::vector<Contradiction> contradictions(const UsedCalibration& used, const LearnedCalibration& learned) {
  constexpr double kForgivenRad = 10 / kDegPerRad, kForgivenS = 0.02, kForgivenReadoutS = 0.008, kForgivenRadS = 0.05;
  const auto contradicts = [](double off, double forgiven, double stddev) {
    constexpr double kSignificance = 4;
    return off > std::max(forgiven, kSignificance * stddev);
  };
  std::vector<Contradiction> found;
  const auto add = [&found](const std::string& key, const std::string& source, const std::string& values) {
    found.push_back({key, key + " (" + source + ") contradicts the images: it is " + values +
                              "; correct it, or leave it out to have it estimated"});
  };
  if (used.R_cam_imu && learned.R_cam_imu.known) {
    const Eigen::Matrix3d& value = learned.R_cam_imu.value;
    const double stddev = learned.R_cam_imu.stddev;
    const double off_rad = difference(used.R_cam_imu->value, value);
    if (contradicts(off_rad, kForgivenRad, stddev)) {
      add("R_cam_imu", used.R_cam_imu->source,
          to_string(used.R_cam_imu->value) + ", they say " + to_string(value) +
              format(" (+- %.1f degrees), %.0f degrees from it", kDegPerRad * stddev, kDegPerRad * off_rad));
    }
  }
  const auto check_time = [&](const char* key, const std::optional<Used<TimeNs>>& in_use, const Learned<double>& images,
                              double forgiven_s) {
    if (!in_use || !images.known) return;
    const double used_s = to_seconds(in_use->value);
    if (!contradicts(difference(used_s, images.value), forgiven_s, images.stddev)) return;
    add(key, in_use->source, format("%.4f s, they say %.4f s (+- %.4f s)", used_s, images.value, images.stddev));
  };
  check_time("time_offset", used.time_offset_ns, learned.time_offset_s, kForgivenS);
  check_time("readout_time", used.readout_ns, learned.readout_s, kForgivenReadoutS);
  if (used.bias_rad_s && learned.bias_rad_s.known) {
    const Eigen::Vector3d &a = used.bias_rad_s->value, &b = learned.bias_rad_s.value;
    if (contradicts(difference(a, b), kForgivenRadS, learned.bias_rad_s.stddev)) {
      add("gyro_bias", used.bias_rad_s->source,
          format("[%.3f, %.3f, %.3f] rad/s, they say [%.3f, %.3f, %.3f] rad/s (+- %.3f)", a.x(), a.y(), a.z(), b.x(),
                 b.y(), b.z(), learned.bias_rad_s.stddev));
    }
  }
  return found;
}

}  // namespace gyro_deblur
