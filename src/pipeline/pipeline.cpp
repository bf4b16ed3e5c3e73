#include "gyro_deblur/pipeline.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <limits>
#include <stdexcept>
#include <utility>

#include "base/stopwatch.hpp"
#include "blur/static_content.hpp"
#include "features/corner_prediction.hpp"
#include "features/residual_flow.hpp"
#include "gyro_deblur/blur_validation.hpp"
#include "gyro_deblur/gyro_unit_watch.hpp"
#include "gyro_deblur/image_noise.hpp"
#include "gyro_deblur/image_rectification.hpp"
#include "gyro_deblur/point_covariance.hpp"

namespace gyro_deblur {
namespace {

void require_fit(const cv::Mat& image, PixelLayout layout, const CameraCalibration& calibration,
                 const PixelMask& mask) {
  if (!mask.empty() && mask.size() != image.size()) {
    throw std::invalid_argument("mask of " + std::to_string(mask.size().width) + "x" +
                                std::to_string(mask.size().height) + " px does not fit the image of " +
                                std::to_string(image.cols) + "x" + std::to_string(image.rows) + " px");
  }
  if (image.cols != calibration.width_px || image.rows != calibration.height_px) {
    throw std::invalid_argument("image of " + std::to_string(image.cols) + "x" + std::to_string(image.rows) +
                                " px does not fit the calibration of " + std::to_string(calibration.width_px) + "x" +
                                std::to_string(calibration.height_px) + " px");
  }
  if ((image.depth() != CV_8U && image.depth() != CV_16U) || image.channels() != channels_of(layout)) {
    throw std::invalid_argument("image must have 8 or 16 bit and " + std::to_string(channels_of(layout)) +
                                " channels, has OpenCV depth " + std::to_string(image.depth()) + " and " +
                                std::to_string(image.channels()) + " channels");
  }
}

std::vector<Eigen::Vector2d> positions(const std::vector<cv::KeyPoint>& keypoints) {
  std::vector<Eigen::Vector2d> points;
  points.reserve(keypoints.size());
  for (const cv::KeyPoint& keypoint : keypoints) points.emplace_back(keypoint.pt.x, keypoint.pt.y);
  return points;
}

/// Of a result's rectified points. @param luminance  as it leaves
std::vector<Eigen::Matrix2d> covariances(const cv::Mat& luminance, const std::string& detector,
                                         const RowExposure& exposure, const PipelineResult& result) {
  const PointCovariance covariance(luminance, result.field);
  std::vector<Eigen::Matrix2d> of_points;
  of_points.reserve(result.points.size());
  for (std::size_t i = 0; i < result.points.size(); ++i) {
    const cv::KeyPoint& keypoint = result.features.keypoints[i];
    const Eigen::Vector2d pixel_px(keypoint.pt.x, keypoint.pt.y);
    of_points.push_back(covariance.of_keypoint(keypoint, detector));
    if (!result.points[i].rectified) continue;
    const BlockBlur& block = result.field.blocks[result.field.grid.index_at(pixel_px.x(), pixel_px.y())];
    of_points.back() += covariance_of_moving(block, to_seconds(result.reference_ns - exposure.middle(pixel_px.y())));
  }
  return of_points;
}

/// Stands in for a motion that is not known: velocities beside it are the whole of it.
class StationaryCamera : public CameraMotion {
 public:
  bool covers(const TimeRange& range) const override { return !range.empty(); }
  Eigen::Matrix3d rotation(TimeNs, TimeNs) const override { return Eigen::Matrix3d::Identity(); }
};

/// Residual velocities of blocks that are not masked wholly.
ResidualField of_used(ResidualField residuals, const BlockGrid& grid, const PixelMask& mask) {
  for (std::size_t i = 0; !mask.empty() && i < residuals.size(); ++i) {
    const cv::Rect rect = grid.rect(static_cast<int>(i));
    if (mask.masked_in(rect) == rect.area()) residuals[i].reset();
  }
  return residuals;
}

/// Rate of a camera [rad/s], in its axes; 0 where its motion is not known. At most 3000 rad/s, where the rotation
/// within the time that it is taken over is half a turn.
Eigen::Vector3d rate_at(const CameraMotion& motion, TimeNs t_ns) {
  constexpr TimeNs kHalfNs = 500'000;
  const TimeRange range{t_ns - kHalfNs, t_ns + kHalfNs};
  if (!motion.covers(range)) return Eigen::Vector3d::Zero();
  const Eigen::AngleAxisd turn(motion.rotation(range.begin_ns, range.end_ns));
  return -turn.angle() / to_seconds(range.end_ns - range.begin_ns) * turn.axis();
}

/// Whether corners have to be followed again by the exposure that was found. Its middle is another one, by more than
/// 1 % of the time since the image before: so much of the rotation was taken for residual velocities.
bool moves_corners(const TimeRange& before, const RowExposure& assumed, const RowExposure& found) {
  constexpr TimeNs kParts = 100;
  return kParts * std::abs(found.middle(0) - assumed.middle(0)) > assumed.start(0) - before.begin_ns;
}

/// Of the blocks whose motion is known [px].
double longest_extent_px(const FrameBlur& field) {
  double longest_px = 0;
  for (const BlockBlur& block : field.blocks) {
    if (block.status != BlockStatus::MASKED) longest_px = std::max<double>(longest_px, block.extent_px);
  }
  return longest_px;
}

/// Why a field and the image's spectra give no estimate of the exposure.
ExposureNeed exposure_need(double contrast, const std::optional<double>& noise, const FrameBlur& field) {
  // One image with a median of so much gives one by day, see doc/reports/exposure.md.
  constexpr float kEnoughPx = 6;
  // By day the noise of a camera is a tenth of the contrast or less.
  constexpr double kTooNoisy = 0.2;
  const auto is_long = [](const BlockBlur& block) { return block.extent_px >= kEnoughPx; };
  const auto moving = std::count_if(field.blocks.begin(), field.blocks.end(), is_long);
  if (2 * static_cast<std::size_t>(moving) < field.blocks.size()) return ExposureNeed::MOTION;
  return noise && *noise > kTooNoisy * contrast ? ExposureNeed::LIGHT : ExposureNeed::TEXTURE;
}

/// Blocks of a field beside no motion: that none was found does not say that there is none.
void require_residuals(FrameBlur* field) {
  field->images_alone = true;
  for (BlockBlur& block : field->blocks) {
    if (!block.residual) block = {0, 0, BlockStatus::NO_GYRO};
  }
}

}  // namespace

Pipeline::Pipeline(const PipelineOptions& options, EngineFactory engine_factory)
    : make_engine_(std::move(engine_factory)), static_content_(std::make_unique<StaticContent>()) {
  set_options(options);
}

Pipeline::Pipeline(Pipeline&&) noexcept = default;
Pipeline& Pipeline::operator=(Pipeline&&) noexcept = default;
Pipeline::~Pipeline() = default;

void Pipeline::set_options(const PipelineOptions& options) {
  // Everything that may throw comes before the first assignment, so that a failure leaves the former state.
  options.validate();
  std::unique_ptr<FilterBank> bank;
  if (!bank_ || !(options.filter == options_.filter)) bank = std::make_unique<FilterBank>(options.filter);
  std::unique_ptr<Engine> engine;
  if (!engine_ || options.engine != options_.engine || options.threads != options_.threads) {
    engine = make_engine_(options.engine, options.threads);
  }
  const bool other_depth = options.significant_bits != options_.significant_bits;
  const bool other_keypoints = !(options.keypoints == options_.keypoints);
  std::unique_ptr<BlurFieldEstimator> estimator;
  if (camera_ && !(options.blur_field == options_.blur_field)) {
    estimator = std::make_unique<BlurFieldEstimator>(*camera_, options.blur_field);
  }
  PipelineOptions copy = options;
  const bool same_extents = options.blur_field.min_extent_px == options_.blur_field.min_extent_px &&
                            options.blur_field.max_extent_px == options_.blur_field.max_extent_px;
  if (bank || engine || !same_extents) {
    prepare_deconvolution(options.blur_field, bank ? *bank : *bank_, engine ? *engine : *engine_, options.threads);
  }

  std::swap(options_, copy);
  if (bank) bank_ = std::move(bank);
  if (engine) engine_ = std::move(engine);
  if (other_keypoints) extractor_.reset();
  if (other_depth) bit_depth_ = BitDepth(options_.significant_bits);
  if (estimator) estimator_ = std::move(estimator);
  if (options_.optical_flow != (flow_ != nullptr)) {
    flow_ = options_.optical_flow ? std::make_unique<ResidualFlow>() : nullptr;
    alone_ = false;
  }
}

std::optional<TimeRange> Pipeline::newest_frame() const {
  if (flow_) return flow_->newest_frame();
  if (!exposure_before_) return std::nullopt;
  return exposure_before_->frame();
}

void Pipeline::set_calibration(const CameraCalibration& calibration) {
  if (camera_ && camera_->calibration() == calibration) return;
  auto camera = std::make_unique<Camera>(calibration);
  auto estimator = std::make_unique<BlurFieldEstimator>(*camera, options_.blur_field);
  camera_ = std::move(camera);
  estimator_ = std::move(estimator);
  if (flow_) flow_->reset();
  static_content_->reset();
  exposure_before_.reset();
  unaided_flow_.reset();
}

std::string Pipeline::engine() const { return engine_->name(); }

std::string Pipeline::take_warning() {
  std::string warning = engine_->take_warning();
  return warning.empty() ? bit_depth_.take_message() : warning;
}

PipelineResult Pipeline::process(const cv::Mat& image, PixelLayout layout, const CameraMotion& motion,
                                 const RowExposure& assumed_exposure, const PipelineRequest& request) {
  if (!camera_) throw std::logic_error("Pipeline::process before set_calibration");
  require_fit(image, layout, camera_->calibration(), mask_);

  PipelineResult result;
  RowExposure exposure = assumed_exposure;
  result.exposure_ns = exposure.timing().exposure_ns;
  result.reference_ns = exposure.reference_time(options_.rectify_to);
  result.significant_bits = bit_depth_.of(image, layout);
  const bool by_flow =
      options_.flow_without_gyro == "always" || (options_.flow_without_gyro == "absent" && request.without_gyro);
  const bool alone = flow_ && by_flow && !motion.covers(assumed_exposure.frame());
  const StationaryCamera standing;
  const CameraMotion& known = alone ? standing : motion;
  cv::Mat luminance;
  ResidualField residuals;
  const auto follow = [&](const RowExposure& by) {
    residuals = residual_velocities(luminance, known, by, request.repeats_picture);
    if (alone || request.repeats_picture) return;
    result.residual_rotation =
        fit_residual_rotation(of_used(residuals, estimator_->grid(), mask_), estimator_->grid(), *camera_, motion, by);
  };
  std::optional<ResidualFlow> flow_before;  // this image
  if (flow_) {
    const Stopwatch watch;
    luminance = luminance8(image, layout, result.significant_bits);
    if (alone != alone_) flow_->change_motion(*camera_, estimator_->grid(), alone ? &motion : nullptr);
    alone_ = alone;
    flow_->set_mask(mask_);
    if (request.exposure) flow_before = *flow_;
    follow(exposure);
    result.times.flow_ms = watch.ms();
  }
  const Stopwatch blur_field_watch;
  watch_static_content(image, layout, motion, exposure, &luminance, &result);
  const auto field_by = [&](const RowExposure& by) {
    return blur_field(known, by, residuals, alone, request.behind_camera_rate);
  };
  const auto field_by_found = [&](const RowExposure& found) {
    const std::optional<TimeRange> before = flow_before ? flow_before->newest_frame() : std::nullopt;
    if (before && moves_corners(*before, exposure, found)) {
      *flow_ = *std::move(flow_before);
      follow(found);
    } else if (flow_) {
      flow_->correct_exposure(*camera_, found);
    }
    return field_by(found);
  };
  result.field = field_by(exposure);
  result.times.blur_field_ms = blur_field_watch.ms();

  std::optional<double> found_noise;
  if (!options_.noise.is_known()) {
    const Stopwatch watch;
    found_noise = image_noise(image, layout, result.significant_bits, 1, mask_);
    result.times.noise_ms = watch.ms();
  }
  const bool image_has_luminance = is_yuv422(layout) || (layout == PixelLayout::GRAY && image.depth() == CV_8U);
  if (request.exposure) {
    const Stopwatch watch;
    if (luminance.empty()) luminance = luminance8(image, layout, result.significant_bits);
    choose_exposure(*request.exposure, luminance, image_has_luminance ? found_noise : std::nullopt, field_by_found,
                    &exposure, &result);
    result.times.exposure_ms = watch.ms();
  }
  if (flow_ && !alone && !request.repeats_picture)
    result.seen_rotation = seen_rotation(luminance, motion, exposure, result);
  if (!result.exposure_is_known && !result.sharp_at_any_exposure) {
    result.exposure_need =
        exposure_need(image_contrast(image, layout, result.significant_bits, mask_), found_noise, result.field);
    result.field.reject_all();
    if (request.luminance) result.luminance = luminance;
    return result;
  }
  if (options_.validation.rule != ValidationRule::NONE && result.field.count(BlockStatus::DEBLURRED) > 0) {
    const Stopwatch watch;
    if (luminance.empty()) luminance = luminance8(image, layout, result.significant_bits);
    result.field = validate_blur_field(result.field, luminance, options_.validation, options_.threads,
                                       image_has_luminance ? found_noise : std::nullopt);
    result.times.validation_ms = watch.ms();
  }

  {
    const Stopwatch watch;
    const bool weighs =
        options_.filter.regularization == Regularization::ADAPTIVE && result.field.count(BlockStatus::DEBLURRED) > 0;
    if (luminance.empty() && (weighs || options_.noise.is_known())) {
      luminance = luminance8(image, layout, result.significant_bits);
    }
    result.field.noise = options_.noise.is_known() ? image_noise(luminance, options_.noise, mask_) : found_noise;
    result.field.contrast = image_contrast(image, layout, result.significant_bits, mask_);
    if (weighs) {
      adapt_regularization(luminance, *bank_, result.field, options_.threads, mask_);
    } else {
      for (BlockBlur& block : result.field.blocks) {
        if (block.status != BlockStatus::DEBLURRED) continue;
        block.noise_gain = static_cast<float>(bank_->choose(block.extent_px, 0).noise_gain);
      }
    }
    result.times.noise_ms += watch.ms();
  }

  const Permit permit = request.permit ? request.permit(result.field) : Permit::DEBLUR;
  if (permit == Permit::STOP) return result;
  if (permit == Permit::LEAVE) result.field.reject_all();

  const bool anything_to_deblur = result.field.count(BlockStatus::DEBLURRED) > 0;
  if ((request.image || request.global_shutter) && anything_to_deblur) {
    const Stopwatch watch;
    result.fallback_counts = deconvolve(image, layout, result.field, *bank_, *engine_, result.image, options_.threads);
    keep_range(image, result.significant_bits, result.image);
    result.times.deconvolution_ms = watch.ms();
  }
  if (request.global_shutter && permit == Permit::DEBLUR) {
    move_to_reference(result.image.empty() ? image : result.image, layout, known, exposure, &result);
  }
  if (!request.keypoints && !request.luminance) return result;

  // The same keypoints whether or not somebody wants the image too: found on the deblurred luminance, which is not
  // quite the luminance of the deblurred colours. With 8-bit grey they are one and the same, with YUV 4:2:2 as well.
  if (!result.image.empty() && image_has_luminance) {
    luminance = luminance8(result.image, layout);
  } else {
    const Stopwatch watch;
    if (luminance.empty()) luminance = luminance8(image, layout, result.significant_bits);
    if (anything_to_deblur) {
      cv::Mat deblurred;
      keep_larger(deconvolve(luminance, PixelLayout::GRAY, result.field, *bank_, *engine_, deblurred, options_.threads),
                  result.fallback_counts);
      luminance = deblurred;
    }
    result.times.deconvolution_ms += watch.ms();
  }
  if (request.luminance) result.luminance = luminance;
  if (!request.keypoints) return result;
  const Stopwatch watch;
  extract(luminance, mask_, &result);
  result.points = rectify_points(positions(result.features.keypoints), result.field, *camera_, known, exposure,
                                 result.reference_ns);
  result.covariances_px2 = covariances(luminance, options_.keypoints.detector, exposure, result);
  result.times.keypoints_ms = watch.ms();
  return result;
}

FrameBlur Pipeline::blur_field(const CameraMotion& known, const RowExposure& exposure, const ResidualField& residuals,
                               bool alone, bool behind_camera_rate) const {
  FrameBlur field = estimator_->estimate(known, exposure, residuals, behind_camera_rate);
  if (alone) require_residuals(&field);
  mark_blocks(&field);
  return field;
}

void Pipeline::choose_exposure(const ExposureQuestion& question, const cv::Mat& luminance,
                               const std::optional<double>& noise,
                               const std::function<FrameBlur(const RowExposure&)>& field_by, RowExposure* exposure,
                               PipelineResult* result) {
  const double longest = static_cast<double>(question.longest_ns) / static_cast<double>(result->exposure_ns);
  result->sharp_at_any_exposure =
      longest > 0 && longest_extent_px(result->field) * longest < options_.blur_field.min_extent_px;
  if (question.estimate && !result->sharp_at_any_exposure) {
    result->exposure_estimate = estimate_exposure(result->field, luminance, noise, options_.threads);
  }
  const ExposureAnswer answer = question.answer(result->exposure_estimate, cv::mean(luminance)[0]);
  result->exposure_is_known = answer.is_known;
  if (answer.exposure_ns == result->exposure_ns) return;
  // Where it is not known, too: the next image is followed from the middle of this one's exposure.
  const RowExposure found = exposure->with_exposure(answer.exposure_ns);
  result->exposure_ns = answer.exposure_ns;
  result->reference_ns = found.reference_time(options_.rectify_to);
  result->field = field_by(found);
  exposure_before_ = *exposure = found;
}

ResidualField Pipeline::residual_velocities(const cv::Mat& luminance, const CameraMotion& known,
                                            const RowExposure& exposure, bool repeats_picture) {
  // A picture that was not followed the first time, for it passed through then, is followed now.
  std::optional<ResidualField> found;
  if (repeats_picture) found = flow_->found_for(exposure, estimator_->grid());
  return found ? *std::move(found)
               : flow_->follow(luminance, *camera_, known, exposure, estimator_->grid(), options_.threads);
}

void Pipeline::watch_static_content(const cv::Mat& image, PixelLayout layout, const CameraMotion& motion,
                                    const RowExposure& exposure, cv::Mat* luminance, PipelineResult* result) {
  const Eigen::Vector2d center_px(0.5 * (image.cols - 1), 0.5 * (image.rows - 1));
  std::optional<Eigen::Vector2d> now_px;
  if (exposure_before_) now_px = predicted_pixel(center_px, *camera_, motion, *exposure_before_, exposure);
  exposure_before_ = exposure;
  if (now_px && static_content_->move(*now_px - center_px)) {
    if (luminance->empty()) *luminance = luminance8(image, layout, result->significant_bits);
    static_content_->add(*luminance, mask_);
  }
  result->static_share = static_content_->share();
}

void Pipeline::mark_blocks(FrameBlur* field) const {
  const FilterReach reach{options_.filter.length_factor, engine_->prefers_2d()};
  mark_masked(mask_, field);
  mark_static_edges(mask_, reach, field);
  mark_static_edges(static_content_->edges(), reach, field);
}

std::optional<ResidualRotation> Pipeline::seen_rotation(const cv::Mat& luminance, const CameraMotion& motion,
                                                        const RowExposure& exposure, const PipelineResult& result) {
  // Fast motion, and images in which nothing can be followed, are soon over; a wrong unit lasts.
  constexpr int kFewestFrames = 3;
  const BlockGrid& grid = estimator_->grid();
  const bool too_large = 2 * result.field.count(BlockStatus::TOO_LARGE) > result.field.blocks.size();
  if (result.residual_rotation && !too_large) {
    unaided_frames_ = 0;
    unaided_flow_.reset();
    ResidualRotation seen = *result.residual_rotation;
    seen.rate_rad_s += seen.known_rad_s;
    return seen;
  }
  const Eigen::Vector3d gyro_rad_s = rate_at(motion, exposure.middle(0.5 * (grid.height_px() - 1)));
  if (++unaided_frames_ < kFewestFrames || gyro_rad_s.norm() < GyroUnitWatch::kLeastGyroRadS) return std::nullopt;
  if (!unaided_flow_) unaided_flow_ = std::make_unique<ResidualFlow>();
  const StationaryCamera standing;
  unaided_flow_->set_mask(mask_);
  const ResidualField whole = unaided_flow_->follow(luminance, *camera_, standing, exposure, grid, options_.threads);
  std::optional<ResidualRotation> seen =
      fit_residual_rotation(of_used(whole, grid, mask_), grid, *camera_, standing, exposure);
  if (seen) seen->known_rad_s = gyro_rad_s;
  return seen;
}

void Pipeline::move_to_reference(const cv::Mat& image, PixelLayout layout, const CameraMotion& motion,
                                 const RowExposure& exposure, PipelineResult* result) const {
  if (result->field.count(BlockStatus::NO_GYRO) == result->field.blocks.size()) return;
  const Stopwatch watch;
  if (is_global_shutter(exposure, result->reference_ns)) {
    result->global_shutter = image;
  } else {
    const GlobalShutterMap map =
        global_shutter_map(result->field, *camera_, motion, exposure, result->reference_ns, options_.threads);
    if (map.empty()) return;
    // Pixels that share colours lose them where they are moved by fractions of a pixel.
    const cv::Mat colors = shares_colors(layout) ? to_bgr(image, layout) : image;
    result->global_shutter = to_global_shutter(colors, map, options_.global_shutter_border, options_.threads);
    // What does not move with the camera stays where it is.
    if (!mask_.empty()) colors.copyTo(result->global_shutter, mask_.pixels() == 0);
  }
  result->times.global_shutter_ms = watch.ms();
}

void Pipeline::extract(const cv::Mat& luminance, const PixelMask& mask, PipelineResult* result) {
  try {
    if (!extractor_) extractor_ = std::make_unique<FeatureExtractor>(options_.keypoints);
    result->features = extractor_->extract(luminance, mask);
  } catch (const std::exception& error) {
    result->features = {};
    result->keypoints_text = error.what();
  }
}

PipelineResult Pipeline::detect(const cv::Mat& image, PixelLayout layout, TimeNs stamp_ns,
                                const std::optional<CameraCalibration>& calibration) {
  PipelineResult result;
  result.reference_ns = stamp_ns;
  result.significant_bits = bit_depth_.of(image, layout);
  const Stopwatch watch;
  extract(luminance8(image, layout, result.significant_bits), mask_.size() == image.size() ? mask_ : PixelMask(),
          &result);
  const std::vector<Eigen::Vector2d> points_px = positions(result.features.keypoints);
  std::optional<Camera> camera;
  if (calibration) camera.emplace(*calibration);
  for (const Eigen::Vector2d& pixel_px : points_px) {
    RectifiedPoint point;
    point.rectified_px = pixel_px;
    point.normalized = Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
    if (camera) point.normalized = camera->normalized(camera->ray(pixel_px));
    result.points.push_back(point);
    // Nobody knows how blurred the image is.
    result.covariances_px2.push_back(Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity()).asDiagonal());
  }
  result.times.keypoints_ms = watch.ms();
  return result;
}

}  // namespace gyro_deblur
