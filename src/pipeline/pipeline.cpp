// The stages of processing one frame, in order.
#include "gyro_deblur/pipeline.hpp"

#include <algorithm>
#include <cstddef>
#include <stdexcept>
#include <utility>

#include "base/format.hpp"
#include "base/parallel.hpp"
#include "base/stopwatch.hpp"
#include "blur/blur_validation.hpp"
#include "blur/exposure_estimate.hpp"
#include "blur/image_noise.hpp"
#include "blur/static_content.hpp"
#include "engine/engine.hpp"
#include "features/corner_prediction.hpp"
#include "features/image_rectification.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "inverse/filter_bank.hpp"
#include "pipeline/deconvolution.hpp"
#include "pipeline/exposure_choice.hpp"
#include "pipeline/frame_context.hpp"
#include "pipeline/image_motion.hpp"
#include "pipeline/keypoint_stage.hpp"

namespace gyro_deblur {
namespace {

void require_fit(const cv::Mat& image, PixelLayout layout, const CameraCalibration& calibration,
                 const PixelMask& mask) {
  if (!mask.empty() && mask.size() != image.size()) {
    throw std::invalid_argument(format("mask of %dx%d px does not fit the image of %dx%d px", mask.size().width,
                                       mask.size().height, image.cols, image.rows));
  }
  if (image.cols != calibration.width_px || image.rows != calibration.height_px) {
    throw std::invalid_argument(format("image of %dx%d px does not fit the calibration of %dx%d px", image.cols,
                                       image.rows, calibration.width_px, calibration.height_px));
  }
  if ((image.depth() != CV_8U && image.depth() != CV_16U) || image.channels() != channels_of(layout)) {
    throw std::invalid_argument(
        format("image must have 8 or 16 bit and %d channels, has OpenCV depth %d and %d channels", channels_of(layout),
               image.depth(), image.channels()));
  }
}

/// Longest extent of the blocks whose motion is known [px].
double longest_extent_px(const FrameBlur& field) {
  double longest_px = 0;
  for (const BlockBlur& block : field.blocks) {
    if (block.status != BlockStatus::MASKED) longest_px = std::max<double>(longest_px, block.extent_px);
  }
  return longest_px;
}

/// Where optical flow gives all of the motion: that a block has no residual velocity does not say that it does not
/// move.
void require_residuals(FrameBlur* field) {
  field->images_alone = true;
  for (BlockBlur& block : field->blocks) {
    if (!block.residual) block = {0, 0, BlockStatus::NO_GYRO};
  }
}

}  // namespace

/// What Pipeline consists of, and the stages of a frame.
struct Pipeline::Impl {
  Impl(const PipelineOptions& options, const EngineFactory& engine_factory)
      : make_engine_(engine_factory ? engine_factory : make_engine) {
    set_options(options);
  }

  void set_options(const PipelineOptions& options);
  /// Throws std::logic_error without a frame that is so far.
  void require_frame(bool is_validated, const char* call) const;

  // The stages of a frame, in their order.
  void begin(FrameContext& frame);
  void watch_static_content(FrameContext& frame);
  void examine_exposure(FrameContext& frame);
  void use_exposure(const ExposureAnswer& answer, FrameContext& frame);
  void find_seen_rotation(FrameContext& frame);
  /// Why the exposure is not known; no block is DEBLURRED any more.
  void explain_unknown_exposure(FrameContext& frame) const;
  void validate(FrameContext& frame);
  void choose_regularization(FrameContext& frame);
  void move_to_reference(FrameContext& frame) const;
  cv::Mat deblurred_luminance(FrameContext& frame);

  FrameCamera frame_camera() const { return {*camera_, *estimator_, mask_, options_.threads}; }
  /// By the gyroscope and the residual velocities.
  FrameBlur blur_field(const RowExposure& exposure, const FrameContext& frame) const;
  /// Blocks that the mask or static content keeps from being deblurred.
  void mark_blocks(FrameBlur* field) const;

  EngineFactory make_engine_;
  PipelineOptions options_;
  std::unique_ptr<Camera> camera_;
  std::unique_ptr<BlurFieldEstimator> estimator_;
  std::unique_ptr<FilterBank> bank_;
  std::unique_ptr<Engine> engine_;
  BitDepth bit_depth_;
  PixelMask mask_;
  StaticContent static_content_;
  std::optional<RowExposure> exposure_before_;
  ImageMotion image_motion_;
  KeypointStage keypoints_;
  std::unique_ptr<FrameContext> frame_;  // from estimate() to deblur()
};

void Pipeline::Impl::set_options(const PipelineOptions& options) {
  // Everything that may throw comes before the first assignment, so that a failure leaves the former state.
  options.validate();
  std::unique_ptr<FilterBank> bank;
  if (!bank_ || !(options.filter == options_.filter)) bank = std::make_unique<FilterBank>(options.filter);
  std::unique_ptr<Engine> engine;
  if (!engine_ || options.engine != options_.engine || options.threads != options_.threads) {
    engine = make_engine_(options.engine, options.threads);
  }
  const bool other_depth = options.significant_bits != options_.significant_bits;
  std::unique_ptr<BlurFieldEstimator> estimator;
  if (camera_ && !(options.blur_field == options_.blur_field)) {
    estimator = std::make_unique<BlurFieldEstimator>(*camera_, options.blur_field);
  }
  PipelineOptions copy = options;
  KeypointOptions keypoint_options = options.keypoints;
  const bool same_extents = options.blur_field.min_extent_px == options_.blur_field.min_extent_px &&
                            options.blur_field.max_extent_px == options_.blur_field.max_extent_px;
  if (bank || engine || !same_extents) {
    prepare_deconvolution(options.blur_field, bank ? *bank : *bank_, engine ? *engine : *engine_, options.threads);
  }

  frame_.reset();
  std::swap(options_, copy);
  if (bank) bank_ = std::move(bank);
  if (engine) engine_ = std::move(engine);
  keypoints_.set_options(std::move(keypoint_options));
  if (other_depth) bit_depth_ = BitDepth(options_.significant_bits);
  if (estimator) estimator_ = std::move(estimator);
  image_motion_.enable(options_.optical_flow);
}

void Pipeline::Impl::require_frame(bool is_validated, const char* call) const {
  if (frame_ && frame_->is_validated == is_validated) return;
  throw std::logic_error(std::string("Pipeline::") + call + " without a frame from " +
                         (is_validated ? "validate" : "estimate"));
}

void Pipeline::Impl::begin(FrameContext& frame) {
  PipelineResult& result = frame.result;
  result.exposure_ns = frame.exposure.timing().exposure_ns;
  result.reference_ns = frame.exposure.reference_time(options_.rectify_to);
  result.significant_bits = bit_depth_.of(frame.image, frame.layout);
  const bool by_flow =
      options_.flow_without_gyro == "always" || (options_.flow_without_gyro == "absent" && frame.request.without_gyro);
  frame.images_alone = image_motion_.enabled() && by_flow && !frame.motion.covers(frame.exposure.frame());
  if (frame.request.input_luminance) result.input_luminance = frame.luminance();
}

void Pipeline::Impl::watch_static_content(FrameContext& frame) {
  const StageTimer timer(&frame.result.times.blur_field_ms);
  const Eigen::Vector2d center_px(0.5 * (frame.image.cols - 1), 0.5 * (frame.image.rows - 1));
  std::optional<Eigen::Vector2d> now_px;
  if (exposure_before_) {
    now_px = predicted_pixel(center_px, *camera_, frame.motion, *exposure_before_, frame.exposure);
  }
  exposure_before_ = frame.exposure;
  if (now_px && static_content_.move(*now_px - center_px)) static_content_.add(frame.luminance(), mask_);
  frame.result.static_share = static_content_.share();
}

FrameBlur Pipeline::Impl::blur_field(const RowExposure& exposure, const FrameContext& frame) const {
  FrameBlur field =
      estimator_->estimate(frame.known_motion(), exposure, frame.residuals, frame.request.behind_camera_rate);
  if (frame.images_alone) require_residuals(&field);
  mark_blocks(&field);
  return field;
}

void Pipeline::Impl::mark_blocks(FrameBlur* field) const {
  const FilterReach reach{options_.filter.length_factor, engine_->prefers_2d()};
  mark_masked(mask_, field);
  mark_static_edges(mask_, reach, field);
  mark_static_edges(static_content_.edges(), reach, field);
}

void Pipeline::Impl::examine_exposure(FrameContext& frame) {
  PipelineResult& result = frame.result;
  const StageTimer timer(&result.times.exposure_ms);
  const ExposureQuestion& question = *frame.request.exposure;
  const double longest = static_cast<double>(question.longest_ns) / static_cast<double>(result.exposure_ns);
  result.sharp_at_any_exposure =
      longest > 0 && longest_extent_px(result.field) * longest < options_.blur_field.min_extent_px;
  if (question.estimate && !result.sharp_at_any_exposure) {
    result.exposure_estimate =
        estimate_exposure(result.field, frame.luminance(), frame.has_own_luminance() ? frame.noise : std::nullopt,
                          options_.threads, question.period_ns);
  }
  result.mean_brightness = cv::mean(frame.luminance())[0];
}

void Pipeline::Impl::use_exposure(const ExposureAnswer& answer, FrameContext& frame) {
  PipelineResult& result = frame.result;
  const StageTimer timer(&result.times.exposure_ms);
  result.exposure_is_known = answer.is_known;
  if (answer.exposure_ns == result.exposure_ns) return;
  // Where it is not known, too: the next image is followed from the middle of this one's exposure.
  const RowExposure found = frame.exposure.with_exposure(answer.exposure_ns);
  result.exposure_ns = answer.exposure_ns;
  result.reference_ns = found.reference_time(options_.rectify_to);
  image_motion_.correct_exposure(found, frame_camera(), frame);
  result.field = blur_field(found, frame);
  exposure_before_ = frame.exposure = found;
}

void Pipeline::Impl::find_seen_rotation(FrameContext& frame) {
  if (!image_motion_.enabled() || frame.images_alone || frame.request.repeats_picture) return;
  frame.result.seen_rotation = image_motion_.seen_rotation(frame_camera(), frame);
}

void Pipeline::Impl::explain_unknown_exposure(FrameContext& frame) const {
  PipelineResult& result = frame.result;
  const double contrast = image_contrast(frame.image, frame.layout, result.significant_bits, mask_);
  result.exposure_need = exposure_need(contrast, frame.noise, result.field);
  result.field.reject_all();
}

void Pipeline::Impl::validate(FrameContext& frame) {
  FrameBlur& field = frame.result.field;
  if (options_.validation.rule == ValidationRule::NONE || field.count(BlockStatus::DEBLURRED) == 0) return;
  const StageTimer timer(&frame.result.times.validation_ms);
  const auto validated = [&](const FrameBlur& predicted) {
    return validate_blur_field(predicted, frame.luminance(), options_.validation, options_.threads,
                               frame.has_own_luminance() ? frame.noise : std::nullopt);
  };
  field = validated(field);
  // Flow that most of the image contradicts has followed something else, for example a jump of the scene.
  const std::size_t rejected = field.count(BlockStatus::REJECTED);
  if (frame.images_alone || frame.residuals.empty() || rejected <= field.count(BlockStatus::DEBLURRED)) return;
  FrameBlur without = estimator_->estimate(frame.known_motion(), frame.exposure, {}, frame.request.behind_camera_rate);
  mark_blocks(&without);
  without = validated(without);
  if (without.count(BlockStatus::REJECTED) < rejected) field = std::move(without);
}

void Pipeline::Impl::choose_regularization(FrameContext& frame) {
  FrameBlur& field = frame.result.field;
  const StageTimer timer(&frame.result.times.noise_ms);
  field.noise = frame.noise;
  field.contrast = image_contrast(frame.image, frame.layout, frame.result.significant_bits, mask_);
  if (options_.filter.regularization == Regularization::ADAPTIVE && field.count(BlockStatus::DEBLURRED) > 0) {
    adapt_regularization(frame.luminance(), *bank_, field, options_.threads, mask_);
    return;
  }
  for (BlockBlur& block : field.blocks) {
    if (block.status != BlockStatus::DEBLURRED) continue;
    block.noise_gain = static_cast<float>(bank_->choose(block.extent_px, 0).noise_gain);
  }
}

void Pipeline::Impl::move_to_reference(FrameContext& frame) const {
  PipelineResult& result = frame.result;
  if (result.field.count(BlockStatus::NO_GYRO) == result.field.blocks.size()) return;
  const cv::Mat& image = result.image.empty() ? frame.image : result.image;
  const StageTimer timer(&result.times.global_shutter_ms);
  if (is_global_shutter(frame.exposure, result.reference_ns)) {
    result.global_shutter = image;
    return;
  }
  const GlobalShutterMap map = global_shutter_map(result.field, *camera_, frame.known_motion(), frame.exposure,
                                                  result.reference_ns, options_.threads);
  if (map.empty()) return;
  // Pixels that share colours lose them where they are moved by fractions of a pixel.
  const cv::Mat colors = shares_colors(frame.layout) ? to_bgr(image, frame.layout) : image;
  result.global_shutter = to_global_shutter(colors, map, options_.threads);
  // What does not move with the camera stays where it is.
  if (!mask_.empty()) colors.copyTo(result.global_shutter, mask_.pixels() == 0);
}

cv::Mat Pipeline::Impl::deblurred_luminance(FrameContext& frame) {
  // The same keypoints whether or not somebody wants the image too: found on the deblurred luminance, which is not
  // quite the luminance of the deblurred colours. With 8-bit grey they are one and the same, with YUV 4:2:2 as well.
  PipelineResult& result = frame.result;
  if (!result.image.empty() && frame.has_own_luminance()) return luminance8(result.image, frame.layout);
  const StageTimer timer(&result.times.deconvolution_ms);
  const cv::Mat& luminance = frame.luminance();
  if (result.field.count(BlockStatus::DEBLURRED) == 0) return luminance;
  cv::Mat deblurred;
  keep_larger(deconvolve(luminance, PixelLayout::GRAY, result.field, *bank_, *engine_, deblurred, options_.threads),
              result.fallback_counts);
  return deblurred;
}

Pipeline::Pipeline(const PipelineOptions& options, const EngineFactory& engine_factory)
    : impl_(std::make_unique<Impl>(options, engine_factory)) {}

Pipeline::Pipeline(Pipeline&&) noexcept = default;
Pipeline& Pipeline::operator=(Pipeline&&) noexcept = default;
Pipeline::~Pipeline() = default;

void Pipeline::set_options(const PipelineOptions& options) { impl_->set_options(options); }
const PipelineOptions& Pipeline::options() const { return impl_->options_; }

void Pipeline::set_calibration(const CameraCalibration& calibration) {
  if (impl_->camera_ && impl_->camera_->calibration() == calibration) return;
  auto camera = std::make_unique<Camera>(calibration);
  auto estimator = std::make_unique<BlurFieldEstimator>(*camera, impl_->options_.blur_field);
  impl_->camera_ = std::move(camera);
  impl_->estimator_ = std::move(estimator);
  impl_->image_motion_.reset();
  impl_->static_content_.reset();
  impl_->exposure_before_.reset();
  impl_->frame_.reset();
}

void Pipeline::set_mask(const PixelMask& mask) {
  impl_->mask_ = mask;
  impl_->frame_.reset();
}

std::string Pipeline::engine() const { return impl_->engine_->name(); }

std::string Pipeline::take_warning() {
  std::string warning = impl_->engine_->take_warning();
  return warning.empty() ? impl_->bit_depth_.take_message() : warning;
}

std::optional<TimeRange> Pipeline::newest_frame() const {
  if (impl_->image_motion_.enabled()) return impl_->image_motion_.newest_frame();
  if (!impl_->exposure_before_) return std::nullopt;
  return impl_->exposure_before_->frame();
}

const PipelineResult& Pipeline::estimate(const cv::Mat& image, PixelLayout layout, const CameraMotion& motion,
                                         const RowExposure& exposure, const PipelineRequest& request) {
  Impl& impl = *impl_;
  impl.frame_.reset();
  if (!impl.camera_) throw std::logic_error("Pipeline::estimate before set_calibration");
  require_fit(image, layout, impl.camera_->calibration(), impl.mask_);
  const AwakeHelpers helpers(impl.options_.threads);
  auto frame = std::make_unique<FrameContext>(image, layout, motion, exposure, request);
  impl.begin(*frame);
  PipelineResult& result = frame->result;
  if (impl.image_motion_.enabled()) {
    const StageTimer timer(&result.times.flow_ms);
    impl.image_motion_.follow(impl.frame_camera(), *frame);
  }
  impl.watch_static_content(*frame);
  {
    const StageTimer timer(&result.times.blur_field_ms);
    result.field = impl.blur_field(frame->exposure, *frame);
  }
  {
    const StageTimer timer(&result.times.noise_ms);
    frame->noise = image_noise(image, layout, result.significant_bits, 1, impl.mask_, impl.options_.threads);
  }
  if (request.exposure) impl.examine_exposure(*frame);
  impl.frame_ = std::move(frame);
  return impl.frame_->result;
}

const PipelineResult& Pipeline::validate(const std::optional<ExposureAnswer>& answer) {
  Impl& impl = *impl_;
  impl.require_frame(false, "validate");
  if (answer.has_value() != impl.frame_->request.exposure.has_value()) {
    throw std::logic_error("Pipeline::validate wants an answer if PipelineRequest::exposure is set, and only then");
  }
  const AwakeHelpers helpers(impl.options_.threads);
  auto frame = std::move(impl.frame_);
  if (answer) impl.use_exposure(*answer, *frame);
  impl.find_seen_rotation(*frame);
  if (frame->result.blur_is_known()) {
    impl.validate(*frame);
    impl.choose_regularization(*frame);
  } else {
    impl.explain_unknown_exposure(*frame);
  }
  frame->is_validated = true;
  impl.frame_ = std::move(frame);
  return impl.frame_->result;
}

PipelineResult Pipeline::deblur(const FrameAction& action) {
  Impl& impl = *impl_;
  impl.require_frame(true, "deblur");
  const auto frame = std::move(impl.frame_);
  const PipelineRequest& request = frame->request;
  PipelineResult& result = frame->result;
  if (!result.blur_is_known()) {
    if (request.luminance) result.luminance = frame->luminance();
    return std::move(result);
  }
  if (!action.drop_text.empty()) return std::move(result);
  if (!action.pass_through_text.empty()) result.field.reject_all();
  const AwakeHelpers helpers(impl.options_.threads);

  if ((request.image || request.global_shutter) && result.field.count(BlockStatus::DEBLURRED) > 0) {
    const StageTimer timer(&result.times.deconvolution_ms);
    result.fallback_counts = deconvolve(frame->image, frame->layout, result.field, *impl.bank_, *impl.engine_,
                                        result.image, impl.options_.threads);
    keep_range(frame->image, result.significant_bits, result.image);
  }
  if (request.global_shutter && action.deblurs()) impl.move_to_reference(*frame);
  if (!request.keypoints && !request.luminance) return std::move(result);

  const cv::Mat luminance = impl.deblurred_luminance(*frame);
  if (request.luminance) result.luminance = luminance;
  if (request.keypoints) impl.keypoints_.find(luminance, impl.frame_camera(), *frame);
  return std::move(result);
}

PipelineResult Pipeline::process(const cv::Mat& image, PixelLayout layout, const CameraMotion& motion,
                                 const RowExposure& exposure, const PipelineRequest& request) {
  estimate(image, layout, motion, exposure, request);
  validate();
  return deblur();
}

PipelineResult Pipeline::detect(const cv::Mat& image, PixelLayout layout, TimeNs stamp_ns,
                                const std::optional<CameraCalibration>& calibration) {
  PipelineResult result;
  result.reference_ns = stamp_ns;
  result.significant_bits = impl_->bit_depth_.of(image, layout);
  const Stopwatch watch;
  std::optional<Camera> camera;
  if (calibration) camera.emplace(*calibration);
  const PixelMask& mask = impl_->mask_;
  impl_->keypoints_.find_unrectified(luminance8(image, layout, result.significant_bits),
                                     mask.size() == image.size() ? mask : PixelMask(), camera, &result);
  result.times.keypoints_ms = watch.ms();
  return result;
}

}  // namespace gyro_deblur
