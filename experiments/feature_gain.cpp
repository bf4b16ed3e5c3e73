#include "feature_gain.hpp"

#include <deque>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "blur/blur_validation.hpp"
#include "blur/image_noise.hpp"
#include "displacement_errors.hpp"
#include "engine/engine.hpp"
#include "evaluation.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "inverse/filter_bank.hpp"
#include "lk_tracker.hpp"
#include "pipeline/deconvolution.hpp"

namespace gyro_deblur::experiments {
namespace {

/// As Pipeline, for residual velocities that are given.
class ToldDeblurring {
 public:
  explicit ToldDeblurring(const Camera& camera)
      : estimator_(camera, options_.blur_field), bank_(options_.filter), engine_(make_engine(options_.engine)) {}

  const BlockGrid& grid() const { return estimator_.grid(); }
  cv::Mat deblur(const cv::Mat& image, const RotationTrack& rotation, const RowExposure& exposure,
                 const ResidualField& residuals) {
    FrameBlur field =
        validate_blur_field(estimator_.estimate(rotation, exposure, residuals), image, options_.validation);
    field.noise = image_noise(image, PixelLayout::GRAY);
    adapt_regularization(image, bank_, field);
    if (field.count(BlockStatus::DEBLURRED) == 0) return image;
    cv::Mat deblurred;
    deconvolve(image, PixelLayout::GRAY, field, bank_, *engine_, deblurred);
    return deblurred;
  }

 private:
  PipelineOptions options_;
  BlurFieldEstimator estimator_;
  FilterBank bank_;
  std::unique_ptr<Engine> engine_;
};

/// The frames of one camera, one after the other, deblurred by what is known.
class Deblurring {
 public:
  Deblurring(Knowledge knowledge, const Footage& footage)
      : knowledge_(knowledge), footage_(footage), rotation_(footage.rotation()), told_(footage.camera()) {
    PipelineOptions options;
    options.optical_flow = knowledge == Knowledge::IMAGES;
    pipeline_ = std::make_unique<Pipeline>(options);
    pipeline_->set_calibration(footage.camera().calibration());
  }

  cv::Mat next(int i, const cv::Mat& image) {
    if (knowledge_ == Knowledge::NONE) return image;
    const RowExposure exposure = footage_.exposure(i);
    if (knowledge_ == Knowledge::TRUTH) {
      return told_.deblur(image, rotation_, exposure, true_residuals(footage_, i, rotation_, told_.grid()));
    }
    PipelineRequest request;
    request.keypoints = false;
    const cv::Mat deblurred = pipeline_->process(image, PixelLayout::GRAY, rotation_, exposure, request).image;
    return deblurred.empty() ? image : deblurred;
  }

 private:
  Knowledge knowledge_;
  const Footage& footage_;
  RotationTrack rotation_;
  ToldDeblurring told_;
  std::unique_ptr<Pipeline> pipeline_;
};

/// Counts tracks that go where the scene goes.
class TrackCount {
 public:
  explicit TrackCount(const Footage& footage) : footage_(footage), tracker_(TrackerOptions{}) {}

  /// Of frame i; the frame before is i - 1.
  int next(int i, const cv::Mat& image, const RotationTrack& rotation) {
    constexpr double kLimitPx = 1;
    std::map<std::int32_t, Eigen::Vector2d> now;
    int correct = 0;
    for (const Track& track : tracker_.track(image, footage_.camera(), rotation, footage_.exposure(i))) {
      now[track.id] = track.pixel_px;
      const auto before = before_.find(track.id);
      if (before == before_.end()) continue;
      const auto point_m = footage_.truth().scene_point(i - 1, before->second);
      if (point_m && (footage_.truth().pixel_of(i, *point_m) - track.pixel_px).norm() < kLimitPx) ++correct;
    }
    before_ = std::move(now);
    return correct;
  }

 private:
  const Footage& footage_;
  LkTracker tracker_;
  std::map<std::int32_t, Eigen::Vector2d> before_;
};

}  // namespace

ResidualField true_residuals(const Footage& footage, int frame, const RotationTrack& rotation, const BlockGrid& grid) {
  constexpr double kStddevPxS = 1e-6;
  const RowExposure exposure = footage.exposure(frame);
  const double exposure_s = to_seconds(exposure.timing().exposure_ns);
  ResidualField residuals(grid.size());
  for (int b = 0; b < grid.size(); ++b) {
    const Eigen::Vector2d center_px = grid.center(b);
    const Eigen::Vector2d residual_px = footage.truth().truth_displacement(frame, center_px) -
                                        displacement_px(footage.camera(), rotation, exposure, center_px);
    if (residual_px.allFinite()) residuals[b] = {residual_px / exposure_s, kStddevPxS};
  }
  return residuals;
}

std::array<FeatureCounts, 4> feature_counts(Footage& footage, const Light& light, int step) {
  constexpr int kFirst = 2;
  constexpr int kFeatures = 1000;
  MatchingOptions options;
  options.max_keypoints = kFeatures;
  options.max_error_px = 3;
  const RotationTrack rotation = footage.rotation();
  std::deque<Deblurring> deblurring;  // of what cannot be moved
  std::deque<TrackCount> counting;
  for (const Knowledge knowledge : kAllKnowledge) {
    deblurring.emplace_back(knowledge, footage);
    counting.emplace_back(footage);
  }
  std::array<FeatureCounts, 4> counts;
  int frames = 0, matched = 0;
  for (int i = 0; i < footage.frames(); ++i) {
    const cv::Mat image = footage.image(i, light);
    const bool matches = i >= kFirst && (i - kFirst) % step == 0;
    Features sharp_sift, sharp_orb;
    if (matches) {
      const cv::Mat sharp = footage.sharp(i, light);
      sharp_sift = extract_sift(sharp, kFeatures);
      sharp_orb = extract_orb(sharp, kFeatures);
      ++matched;
    }
    if (i >= kFirst) ++frames;
    for (std::size_t k = 0; k < kAllKnowledge.size(); ++k) {
      const cv::Mat deblurred = deblurring[k].next(i, image);
      const int tracks = counting[k].next(i, deblurred, rotation);
      if (i >= kFirst) counts[k].tracks += tracks;
      if (!matches) continue;
      const auto correct = [&](const Features& own, const Features& sharp) {
        return evaluate_matching(own, image.size(), sharp, Homography::eye(), options).correct;
      };
      counts[k].sift += correct(extract_sift(deblurred, kFeatures), sharp_sift);
      counts[k].orb += correct(extract_orb(deblurred, kFeatures), sharp_orb);
    }
  }
  for (FeatureCounts& count : counts) {
    count.tracks /= frames;
    count.sift /= matched;
    count.orb /= matched;
  }
  return counts;
}

}  // namespace gyro_deblur::experiments
