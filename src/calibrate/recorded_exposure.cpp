// Estimates the exposure time of a recording, image by image.
#include "calibrate/recorded_exposure.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/median.hpp"
#include "blur/frame_quality.hpp"
#include "blur/image_noise.hpp"
#include "blur/motion_spectrum.hpp"
#include "blur/path_1d.hpp"

namespace gyro_deblur {
namespace {

/// A single estimate may be wrong by chance; three that agree are not.
constexpr std::size_t kFewestEstimates = 3;
/// Deviations from the median below it count as agreement, however small standard deviations are.
const double kSame = std::log(kContradictingRatio);
/// Standard deviation of errors that all estimates share, such as those of the velocity. Optical flow alone is too fast
/// where a shaking camera is fastest, see doc/reports/exposure.md.
constexpr double kCommon = 0.01, kCommonOfFlow = 0.05;

/// Standard deviations beyond which a difference is none of chance.
constexpr double kSignificance = 3;

constexpr double kBinWaves = 0.1, kLastWaves = 3.6;
/// More do not change the median spectrum.
constexpr int kMostSpectraImages = 60;

TimeNs exp_ns(double log_ns) { return std::llround(std::exp(log_ns)); }
double log_of(TimeNs time_ns) { return std::log(static_cast<double>(time_ns)); }

Pipeline pipeline_for(const CameraCalibration& camera, const PipelineOptions& options) {
  PipelineOptions used;
  used.significant_bits = options.significant_bits;
  used.threads = options.threads;
  used.engine = "cpu";
  Pipeline pipeline(used);
  pipeline.set_calibration(camera);
  return pipeline;
}

/// Logarithm of the power of a straight path at uniform speed.
double log_of_path(double waves) {
  // Power at the zeros: a window blends frequencies, and paths are not quite straight.
  constexpr double kLeft = 0.004;
  const double phase = M_PI * waves;
  const double sinc = phase < 1e-6 ? 1 : std::sin(phase) / phase;
  return std::log(sinc * sinc + kLeft);
}

/// Median of some values, and the standard deviation of one of them, robustly.
struct Spread {
  double middle = 0, stddev = 0;
};

Spread spread_of(const std::vector<double>& values) {
  constexpr double kStddevs = 1.4826;  // of a normal distribution, in median absolute deviations
  Spread spread;
  spread.middle = median(values);
  std::vector<double> off;
  for (const double value : values) off.push_back(std::abs(value - spread.middle));
  spread.stddev = kStddevs * median(std::move(off));
  return spread;
}

double percentile(std::vector<double> values, double share) {
  const auto at = static_cast<std::ptrdiff_t>(std::llround(share * static_cast<double>(values.size() - 1)));
  std::nth_element(values.begin(), values.begin() + at, values.end());
  return values[static_cast<std::size_t>(at)];
}

/// Standard deviation of the median of so many.
/// @param common  part that all have in common
double stddev_of_median(double stddev, std::size_t count, double common) {
  constexpr double kMedian = 1.2533;  // over that of the mean, of a normal distribution
  return std::hypot(kMedian * stddev / std::sqrt(static_cast<double>(count)), common);
}

/// What most images without an estimate lack.
ExposureNeed most_frequent_need(const std::vector<ImageExposure>& images) {
  const auto count = [&images](ExposureNeed need) {
    return std::count_if(images.begin(), images.end(),
                         [need](const ImageExposure& image) { return !image.estimate_ns && image.need == need; });
  };
  ExposureNeed most = ExposureNeed::MOTION;
  for (const ExposureNeed need : {ExposureNeed::TEXTURE, ExposureNeed::LIGHT}) {
    if (count(need) > count(most)) most = need;
  }
  return most;
}

void summarise(double common, RecordedExposure* result) {
  std::vector<double> logs, stddevs, log_ratios;
  for (const ImageExposure& image : result->images) {
    if (!image.estimate_ns) continue;
    logs.push_back(log_of(*image.estimate_ns));
    stddevs.push_back(image.log_stddev);
    if (image.given_ns) log_ratios.push_back(logs.back() - log_of(*image.given_ns));
  }
  result->estimates = logs.size();
  if (log_ratios.size() >= kFewestEstimates) {
    const Spread ratio = spread_of(log_ratios);
    result->over_given = {std::exp(ratio.middle), stddev_of_median(ratio.stddev, log_ratios.size(), common)};
  }
  result->missing = most_frequent_need(result->images);
  if (logs.size() < kFewestEstimates) return;
  const Spread all = spread_of(logs);
  std::size_t agreeing = 0;
  constexpr double kMostAgree = 0.8;
  for (std::size_t i = 0; i < logs.size(); ++i) {
    if (std::abs(logs[i] - all.middle) < std::max(kSame, kSignificance * stddevs[i])) ++agreeing;
  }
  result->is_known = true;
  result->missing = ExposureNeed::NOTHING;
  result->exposure_ns = exp_ns(all.middle);
  result->log_stddev = stddev_of_median(std::max(all.stddev, median(stddevs)), logs.size(), common);
  result->varies = static_cast<double>(agreeing) < kMostAgree * static_cast<double>(logs.size());
  constexpr double kLow = 0.1, kHigh = 0.9;
  result->low_ns = exp_ns(percentile(logs, kLow));
  result->high_ns = exp_ns(percentile(std::move(logs), kHigh));
}

TimeNs median_interval_ns(const std::vector<ImageExposure>& images) {
  std::vector<TimeNs> intervals_ns;
  for (std::size_t i = 1; i < images.size(); ++i) {
    intervals_ns.push_back(images[i].stamp_ns - images[i - 1].stamp_ns);
  }
  return intervals_ns.empty() ? 0 : median(std::move(intervals_ns));
}

}  // namespace

bool contradicts(const ExposureEstimate& over_given) {
  return std::abs(std::log(over_given.ratio)) > std::max(kSame, kSignificance * over_given.log_stddev);
}

TimeNs RecordedExposure::exposure_of(TimeNs stamp_ns) const {
  if (!is_known) return 0;
  if (!varies) return exposure_ns;
  // The newest that was known by then, else the first one.
  TimeNs found_ns = 0;
  for (const ImageExposure& image : images) {
    if (!image.filtered_ns) continue;
    if (found_ns != 0 && image.stamp_ns > stamp_ns) break;
    found_ns = *image.filtered_ns;
  }
  return found_ns == 0 ? exposure_ns : found_ns;
}

RecordedExposureEstimator::RecordedExposureEstimator(const CameraCalibration& camera, const ShutterTiming& shutter,
                                                     const PipelineOptions& pipeline,
                                                     std::optional<RotationTrack> motion)
    : shutter_(shutter),
      pipeline_(pipeline_for(camera, pipeline)),
      motion_(motion ? *std::move(motion) : RotationTrack({}, {}, Eigen::Matrix3d::Identity())),
      without_gyro_(motion_.available().empty()),
      log_powers_(static_cast<std::size_t>(kLastWaves / kBinWaves)) {}

void RecordedExposureEstimator::add(TimeNs stamp_ns, TimeNs middle_ns, const cv::Mat& image, PixelLayout layout,
                                    const std::optional<TimeNs>& given_ns) {
  period_.add(stamp_ns);
  std::optional<GivenExposure> given;
  if (given_ns && *given_ns > 0) given = GivenExposure{ExposureOrigin::MESSAGE, *given_ns};
  ExposurePlan plan = choice_.plan(given, period_.get());
  plan.estimate = true;
  longest_tried_ns_ =
      std::max<TimeNs>(longest_tried_ns_, std::llround(kMaxExposureRatio * static_cast<double>(plan.exposure_ns)));
  ShutterTiming timing = shutter_;
  timing.exposure_ns = plan.exposure_ns;
  timing.stamp_phase = StampPhase::MIDDLE;
  ImageExposure found;
  found.stamp_ns = stamp_ns;
  found.given_ns = given ? given_ns : std::nullopt;
  PipelineRequest request;
  request.image = request.keypoints = false;
  request.luminance = true;
  request.without_gyro = without_gyro_;
  request.exposure = ExposureQuestion{true, 0, plan.period_ns};
  const RowExposure exposure(middle_ns, image.rows, timing);
  const PipelineResult& estimated = pipeline_.estimate(image, layout, motion_, exposure, request);
  const ChosenExposure chosen = choice_.decide(stamp_ns, plan, estimated.exposure_estimate, estimated.mean_brightness);
  // "Not known" in any case: the pipeline then stops after the field and says what the image lacks.
  pipeline_.validate(ExposureAnswer{chosen.exposure_ns, false});
  const PipelineResult result = pipeline_.deblur();
  found.need = result.exposure_need;
  found.extent_px = median_extent_px(result.field, [](BlockStatus) { return true; });
  if (const std::optional<ExposureEstimate>& estimate = result.exposure_estimate) {
    found.estimate_ns = std::llround(static_cast<double>(plan.exposure_ns) * estimate->ratio);
    found.log_stddev = estimate->log_stddev;
  }
  if (chosen.origin != ExposureOrigin::ASSUMED) found.filtered_ns = chosen.exposure_ns;
  images_.push_back(found);
  if (found.estimate_ns && found.filtered_ns && spectra_images_ < kMostSpectraImages) {
    ++spectra_images_;
    add_spectra(result.field, result.luminance);
  }
}

void RecordedExposureEstimator::add_spectra(const FrameBlur& field, const cv::Mat& luminance) {
  constexpr double kFirstLobe = 0.8;
  constexpr double kLeastSignal = 0.02;  // of the power
  constexpr int kFewestPoints = 2;
  const double noise = image_noise(luminance, PixelLayout::GRAY).value_or(0);
  for (const MotionSpectrum& spectrum : motion_spectra(field, luminance, 1, noise, pipeline_.options().threads)) {
    const double extent = extent_of(spectrum.path);
    double offset = 0;
    int points = 0;
    const auto log_power = [](const SpectrumPoint& point) {
      return std::log(std::max<double>(point.power - point.noise, kLeastSignal * point.power));
    };
    for (const SpectrumPoint& point : spectrum.points) {
      const double waves = point.frequency * extent;
      if (waves > kFirstLobe) continue;
      offset += log_power(point) - log_of_path(waves);
      ++points;
    }
    if (points < kFewestPoints) continue;
    for (const SpectrumPoint& point : spectrum.points) {
      const auto bin = static_cast<std::size_t>(point.frequency * extent / kBinWaves);
      if (bin < log_powers_.size()) log_powers_[bin].push_back(static_cast<float>(log_power(point) - offset / points));
    }
  }
}

RecordedExposure RecordedExposureEstimator::result() const {
  RecordedExposure result;
  result.images = images_;
  result.longest_tried_ns = longest_tried_ns_;
  result.frame_interval_ns = median_interval_ns(images_);
  summarise(without_gyro_ ? kCommonOfFlow : kCommon, &result);
  constexpr std::size_t kFewestWindows = 5;
  for (std::size_t bin = 0; bin < log_powers_.size(); ++bin) {
    if (log_powers_[bin].size() < kFewestWindows) continue;
    const double waves = (static_cast<double>(bin) + 0.5) * kBinWaves;
    result.spectrum.push_back({waves, median(log_powers_[bin]), log_of_path(waves), log_powers_[bin].size()});
  }
  return result;
}

}  // namespace gyro_deblur
