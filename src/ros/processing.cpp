// How the processor makes the output of a synchronized frame.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <utility>

#include <sensor_msgs/image_encodings.h>
#include <boost/make_shared.hpp>

#include "base/format.hpp"
#include "base/stopwatch.hpp"
#include "blur/frame_quality.hpp"
#include "gyro_deblur/image_format.hpp"
#include "gyro_deblur/overlay.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "ros/calibration_conversion.hpp"
#include "ros/image_conversion.hpp"
#include "ros/output_conversion.hpp"
#include "ros/processor.hpp"
#include "ros/value_conversion.hpp"
#include "sync/exposure_check.hpp"

namespace gyro_deblur {

/// Result of the pipeline for a picture, for images that repeat it.
struct MadePicture {
  sensor_msgs::ImageConstPtr image;  ///< some of the result may share its memory
  std::shared_ptr<const Config> config;
  CameraCalibration calibration;
  PixelMask mask;
  PipelineRequest request;
  PipelineResult result;

  /// Whether it is the result for this frame and this request.
  bool serves(const SynchronizedFrame& synchronized, const PipelineRequest& wanted) const {
    return synchronized.frame.repeats && config == synchronized.config &&
           calibration == *synchronized.frame.calibration && mask.is_same(synchronized.mask) &&
           (request.image || !wanted.image) && (request.keypoints || !wanted.keypoints) &&
           (request.global_shutter || !wanted.global_shutter) && (request.input_luminance || !wanted.input_luminance);
  }
};

namespace {

namespace encodings = sensor_msgs::image_encodings;

/// What is wrong with saturated samples among those that the frame itself needs; empty when there is none.
std::string saturation_text(const SynchronizedFrame& synchronized) {
  const GyroOptions& options = synchronized.gyro;
  const auto saturated = [&options](const GyroSample& sample) { return is_saturated(sample, options); };
  const auto begin = synchronized.samples.begin() + static_cast<std::ptrdiff_t>(synchronized.own_begin),
             end = synchronized.samples.begin() + static_cast<std::ptrdiff_t>(synchronized.own_end);
  const auto first = std::find_if(begin, end, saturated);
  if (first == end) return {};
  return format("%td of the %td gyroscope samples that the frame needs reach gyro_range = %g rad/s, the first is ",
                std::count_if(first, end, saturated), end - begin, options.range_rad_s) +
         vector_text(first->rate_rad_s) + " rad/s at " + seconds_text(first->t_ns) + " s of the IMU clock";
}

/// The blur field's message, and why blocks or the whole frame are as they were.
void add_field(const SynchronizedFrame& synchronized, const RowExposure& exposure, const RotationTrack& rotation,
               const FrameBlur& field, FrameOutput* output) {
  const sensor_msgs::Image& image = *synchronized.frame.image;
  output->blur_field = to_message(field, image.header);
  const std::size_t uncovered = field.count(BlockStatus::NO_GYRO);
  const bool gyro_covers = rotation.covers(exposure.frame());
  const std::string saturation = gyro_covers ? "" : saturation_text(synchronized);
  if (uncovered > 0) {
    output->reason_text = gyro_covers          ? "blocks lie beyond the range of the lens model"
                          : saturation.empty() ? synchronized.coverage_text
                                               : saturation;
  }
  if (uncovered == field.blocks.size()) {
    output->reason = gyro_covers          ? PassThroughReason::NO_CALIBRATION
                     : saturation.empty() ? synchronized.lacks
                                          : PassThroughReason::GYRO_SATURATED;
    if (synchronized.lacks != PassThroughReason::NO_GYRO)
      output->reason_text += ", and optical flow shows no certain motion";
    output->blur_field = pass_through_message(output->reason, output->reason_text, image);
  }
  if (field.images_alone && output->reason == PassThroughReason::NONE) {
    output->reason_text = "optical flow alone: " + (saturation.empty() ? synchronized.coverage_text : saturation);
  }
  output->blur_field->reason_text = output->reason_text;
}

/// Image and camera_info at the reference time.
void add_global_shutter(const PipelineResult& result, const PendingFrame& frame, FrameOutput* output) {
  auto image = to_image(result.global_shutter, *frame.image);
  if (result.global_shutter.channels() != CV_MAT_CN(*type_of_encoding(frame.image->encoding))) {
    // A mosaic, or YUV 4:2:2, has become BGR.
    image->encoding = result.global_shutter.depth() == CV_16U ? encodings::BGR16 : encodings::BGR8;
  }
  auto info = frame.info ? boost::make_shared<sensor_msgs::CameraInfo>(*frame.info)
                         : boost::make_shared<sensor_msgs::CameraInfo>(*uncalibrated_camera_info(*frame.image));
  image->header.stamp = info->header.stamp = to_ros_time(result.reference_ns);
  output->global_shutter = image;
  output->global_shutter_info = info;
}

/// What the pipeline has found out about the camera and its own work.
void add_findings(const SynchronizedFrame& synchronized, const PipelineResult& result, FrameOutput* output) {
  static_cast<FrameFindings&>(*output) = result;
  output->engine_warning = synchronized.pipeline->take_warning();
  // The error of an estimated focal length would pass for the gyroscope's.
  if (synchronized.frame.lens != Lens::CALIBRATED) output->residual_rotation.reset();
  if (!output->residual_rotation) return;
  const Eigen::Matrix3d R_imu_cam = synchronized.R_cam_imu.transpose();
  output->residual_rotation->rate_rad_s = R_imu_cam * result.residual_rotation->rate_rad_s;
  output->residual_rotation->known_rad_s = R_imu_cam * result.residual_rotation->known_rad_s;
}

/// Without a calibration no ray of a keypoint is known.
void remove_rays(KeypointArray* message) {
  for (Keypoint& keypoint : message->keypoints) {
    keypoint.normalized_x = keypoint.normalized_y = std::numeric_limits<float>::quiet_NaN();
  }
}

/// The messages of a frame whose exposure is known, apart from tracks and the blur field.
void add_messages(const SynchronizedFrame& synchronized, const FrameRequest& request, const PipelineResult& result,
                  const FrameQuality& quality, FrameOutput* output) {
  const PendingFrame& frame = synchronized.frame;
  const std_msgs::Header& header = frame.image->header;
  if (request.image && !result.image.empty()) output->image = to_image(result.image, *frame.image);
  if (!result.global_shutter.empty()) add_global_shutter(result, frame, output);
  if (request.keypoints && !output->dropped) {
    output->keypoints = to_message(result, synchronized.config->pipeline.keypoints, header);
    if (frame.lens != Lens::CALIBRATED) remove_rays(output->keypoints.get());
  }
  if (request.overlay)
    output->overlay = to_image(draw_overlay(result.input_luminance, result.field), header, encodings::BGR8);
  if (request.markers && frame.lens == Lens::CALIBRATED)
    output->markers = to_markers(result.field, Camera(*frame.calibration), header);
  output->quality = to_message(quality, header);
  if (request.trust_mask)
    output->trust_mask = to_image(trust_mask(result.field, synchronized.mask), header, encodings::MONO8);
}

/// The trust mask of a frame that passes through. Where its size is not that of its data there is none to have.
sensor_msgs::ImagePtr no_trust(const sensor_msgs::Image& input) {
  const bool has_pixels = std::uint64_t{input.width} * input.height <= input.data.size();
  const cv::Size size =
      has_pixels ? cv::Size(static_cast<int>(input.width), static_cast<int>(input.height)) : cv::Size();
  return to_image(cv::Mat::zeros(size, CV_8UC1), input.header, encodings::MONO8);
}

/// The output of a frame that failed. Outputs made before the failure are not published.
FrameOutput pass_through_failed(const std::string& text, const FrameOutput& made) {
  FrameOutput output;
  output.input = output.image = made.input;
  output.reason = PassThroughReason::INTERNAL_ERROR;
  output.reason_text = text;
  output.keypoints_text = made.keypoints_text;
  output.engine_warning = made.engine_warning;
  output.times = made.times;
  output.tracks_ms = made.tracks_ms;
  output.waiting_ms = made.waiting_ms;
  output.messages_ms = made.messages_ms;
  output.total_ms = made.total_ms;
  return output;
}

/// Why Config::drop_poor keeps an image with this validated field from being published; empty: it does not.
std::string drop_text(const FrameBlur& field) {
  const FrameQuality quality = assess_quality(field);
  if (quality.grade != QualityGrade::POOR) return {};
  return format("POOR, with a score of %.3f", *quality.score);
}

}  // namespace

bool Processor::process(FrameInWork* work) {
  const PendingFrame& frame = work->synchronized.frame;
  FrameOutput& output = work->output;
  const StageTimer timer(&output.total_ms);
  StereoCamera* const stereo = environment_.stereo.get();
  const bool begins = !output.input;
  if (begins) {
    if (environment_.request) work->request = environment_.request();
    output.input = output.image = frame.image;
    output.reason = frame.pass_through_reason;
    output.reason_text = frame.pass_through_text;
  }
  if (output.reason == PassThroughReason::NONE) {
    if (stereo && begins) stereo->begin(frame.stamp_ns);
    try {
      const std::optional<FrameAction> action = examine(work);
      if (!action) return false;
      deblur(*action, work);
    } catch (const std::exception& error) {
      output = pass_through_failed(error.what(), output);
    } catch (...) {
      output = pass_through_failed("an exception of unknown type", output);
    }
  } else if (stereo) {
    stereo->pass_through(frame.stamp_ns, output.reason);
  }
  if (!output.dropped) complete(work);
  if (stereo && output.reason != PassThroughReason::NONE) stereo->pass_through(frame.stamp_ns, output.reason);
  return true;
}

std::optional<FrameAction> Processor::examine(FrameInWork* work) {
  if (!work->rotation) {
    begin(work);
    if (!work->made) validate(work);
  }
  if (!work->made && !work->validated->blur_is_known()) return FrameAction();
  return decide(work->synchronized, work->made ? work->made->result.field : work->validated->field);
}

void Processor::begin(FrameInWork* work) {
  const SynchronizedFrame& synchronized = work->synchronized;
  const PendingFrame& frame = synchronized.frame;
  FrameRequest& request = work->request;
  request.input_luminance = request.overlay || request.wants_tracks();
  request.behind_camera_rate = synchronized.behind_camera_rate;
  request.repeats_picture = frame.repeats;
  request.without_gyro = synchronized.without_gyro;
  const ExposurePlan& plan = synchronized.plan;
  request.exposure = ExposureQuestion{plan.estimate && !plan.decided, plan.longest_ns, plan.period_ns};
  Stopwatch watch;
  work->view = view_image(*frame.image);
  work->output.messages_ms += watch.lap();
  set_up_pipeline(synchronized);
  synchronized.pipeline->set_calibration(*frame.calibration);
  work->rotation.emplace(synchronized.samples, synchronized.gyro, synchronized.R_cam_imu, synchronized.own_begin);
  work->preparation_ms = watch.ms();
  work->chosen = synchronized.plan;
  const std::shared_ptr<const MadePicture> made = frame.picture ? frame.picture->made : nullptr;
  if (made && made->serves(synchronized, request)) work->made = made;
}

void Processor::validate(FrameInWork* work) {
  const SynchronizedFrame& synchronized = work->synchronized;
  Pipeline& pipeline = *synchronized.pipeline;
  work->chosen = choose_exposure(synchronized, pipeline.estimate(work->view.image, work->view.layout, *work->rotation,
                                                                 *synchronized.exposure, work->request));
  const ExposureAnswer answer{work->chosen.exposure_ns, work->chosen.origin != ExposureOrigin::ASSUMED};
  work->validated = &pipeline.validate(answer);
}

void Processor::deblur(const FrameAction& action, FrameInWork* work) {
  const SynchronizedFrame& synchronized = work->synchronized;
  const PendingFrame& frame = synchronized.frame;
  // What was made of the picture is of one that is deblurred.
  if (work->made && !action.deblurs()) {
    work->made.reset();
    validate(work);
  }
  PipelineResult result;
  if (work->made) {
    result = work->made->result;
    result.times = {};
    result.residual_rotation.reset();
    result.seen_rotation.reset();
  } else {
    result = synchronized.pipeline->deblur(action);
    if (synchronized.pictures_repeat && frame.picture && action.deblurs()) {
      frame.picture->made = std::make_shared<MadePicture>(
          MadePicture{frame.image, synchronized.config, *frame.calibration, synchronized.mask, work->request, result});
    }
  }
  FrameOutput& output = work->output;
  output.exposure = FrameExposure{work->chosen, result.exposure_need};
  // What is said of a picture holds for the image that shows it, as though it had been exposed by that one's stamp.
  result.reference_ns += frame.stamp_ns - frame.picture_ns();
  add_findings(synchronized, result, &output);
  output.times.blur_field_ms += work->preparation_ms;
  add_result(action, std::move(result), work);
}

void Processor::add_result(const FrameAction& action, PipelineResult result, FrameInWork* work) {
  const SynchronizedFrame& synchronized = work->synchronized;
  FrameOutput& output = work->output;
  const RowExposure exposure = synchronized.exposure->with_exposure(result.exposure_ns);
  output.dropped = !action.drop_text.empty();
  if (output.dropped) {
    output.image.reset();
    if (!action.pass_through_text.empty()) result.field.reject_all();
  } else if (work->request.wants_tracks() && synchronized.frame.lens == Lens::CALIBRATED) {
    add_tracks(exposure, result, work);
  }
  if (!result.blur_is_known()) {
    output.reason = PassThroughReason::NO_EXPOSURE_TIME;
    output.reason_text = unknown_exposure_text(result.exposure_need);
    return;
  }
  const StageTimer timer(&output.messages_ms);
  const FrameQuality quality = assess_quality(result.field);
  add_messages(synchronized, work->request, result, quality, &output);
  if (action.pass_through_text.empty() || output.dropped) {
    output.exposure_terms = exposure_terms(result.field, quality, synchronized.config->pipeline.blur_field);
    add_field(synchronized, exposure, *work->rotation, result.field, &output);
    output.field = std::move(result.field);
  } else {
    output.reason = PassThroughReason::STEREO_PARTNER;
    output.reason_text = action.pass_through_text;
  }
  if (output.dropped) output.blur_field->reason_text = output.reason_text = "drop_poor: " + action.drop_text;
}

void Processor::add_tracks(const RowExposure& exposure, const PipelineResult& result, FrameInWork* work) {
  const StageTimer timer(&work->output.tracks_ms);
  const Config& config = *work->synchronized.config;
  const PendingFrame& frame = work->synchronized.frame;
  const Camera camera(*frame.calibration);
  tracker_.set_options(config.tracker);
  tracker_.set_threads(config.pipeline.threads);
  tracker_.set_mask(work->synchronized.mask);
  const RotationTrack& rotation = *work->rotation;
  const std::vector<Track>& tracks =
      tracker_.track(result.input_luminance, camera, rotation, exposure, &result.field, frame.repeats);
  std_msgs::Header header = frame.image->header;
  if (work->request.tracks) work->output.tracks = to_message(tracks, config.track_layout, header);
  // While the exposure is not known, neither is the time of the rows.
  if (!work->request.global_shutter_tracks || !result.blur_is_known()) return;
  header.stamp = to_ros_time(result.reference_ns);
  const TimeNs reference_ns = exposure.reference_time(config.pipeline.rectify_to);
  work->output.global_shutter_tracks =
      to_message(track_rectifier_.rectify(tracks, result.field, camera, rotation, exposure, reference_ns),
                 config.track_layout, header);
}

std::optional<FrameAction> Processor::decide(const SynchronizedFrame& synchronized, const FrameBlur& field) const {
  StereoCamera* const stereo = environment_.stereo.get();
  const TimeNs stamp_ns = synchronized.frame.stamp_ns;
  if (!stereo) return FrameAction{"", synchronized.drop_poor ? drop_text(field) : ""};
  if (!synchronized.drop_poor) return stereo->decide(stamp_ns, field);
  FrameBlur passed_through = field;
  passed_through.reject_all();
  const bool may_be_dropped = assess_quality(field).grade != QualityGrade::UNKNOWN;
  return stereo->decide(stamp_ns, field, DropReasons{may_be_dropped, drop_text(field), drop_text(passed_through)});
}

ChosenExposure Processor::choose_exposure(const SynchronizedFrame& synchronized, const PipelineResult& estimated) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const PendingFrame& frame = synchronized.frame;
  const ChosenExposure chosen =
      exposures_.decide(frame.picture_ns(), synchronized.plan, estimated.exposure_estimate, estimated.mean_brightness);
  if (frame.picture && frame.picture->motion) {
    PictureMotion& motion = *frame.picture->motion;
    motion.exposure = synchronized.exposure->with_exposure(chosen.exposure_ns);
    static_cast<ChosenExposure&>(motion.plan) = chosen;
    motion.plan.decided = true;
  }
  return chosen;
}

void Processor::set_up_pipeline(const SynchronizedFrame& synchronized) {
  if (config_of_pipeline_ != synchronized.config) {
    synchronized.pipeline->set_options(synchronized.config->pipeline);
    config_of_pipeline_ = synchronized.config;
  }
  synchronized.pipeline->set_mask(synchronized.mask);
}

void Processor::complete(FrameInWork* work) {
  FrameOutput& output = work->output;
  const StageTimer timer(&output.messages_ms);
  const FrameRequest& request = work->request;
  const PendingFrame& frame = work->synchronized.frame;
  output.camera_info =
      frame.info ? frame.info : sensor_msgs::CameraInfoConstPtr(uncalibrated_camera_info(*frame.image));
  if (request.global_shutter && !output.global_shutter) {
    output.global_shutter = output.input;
    output.global_shutter_info = output.camera_info;
  }
  if (!output.blur_field) output.blur_field = pass_through_message(output.reason, output.reason_text, *frame.image);
  if (!output.quality) output.quality = unknown_quality(frame.image->header);
  if (request.trust_mask && !output.trust_mask) output.trust_mask = no_trust(*frame.image);
  if (request.markers && !output.markers) output.markers = no_markers(frame.image->header);
  if (request.keypoints && !output.keypoints) add_raw_keypoints(work->synchronized, &output);
}

void Processor::add_raw_keypoints(const SynchronizedFrame& synchronized, FrameOutput* output) {
  const PendingFrame& frame = synchronized.frame;
  output->keypoints = boost::make_shared<KeypointArray>();
  output->keypoints->header = frame.image->header;
  output->keypoints->reference_time = frame.image->header.stamp;
  // When too much waits, what is left of the work has to be quick.
  if (!synchronized.pipeline || output->reason == PassThroughReason::OVERLOAD) return;
  try {
    const ImageView view = view_image(*frame.image);
    std::optional<CameraCalibration> calibration = frame.lens == Lens::CALIBRATED ? frame.calibration : std::nullopt;
    if (!calibration && frame.info) {
      try {
        calibration =
            to_calibration(*frame.info, view.image.cols, view.image.rows, synchronized.config->rectified_input);
      } catch (const OptionError&) {
        // Normalised coordinates are not known then.
      }
    }
    set_up_pipeline(synchronized);
    const PipelineResult result = synchronized.pipeline->detect(view.image, view.layout, frame.stamp_ns, calibration);
    output->keypoints_text = result.keypoints_text;
    output->times.keypoints_ms = result.times.keypoints_ms;
    output->messages_ms -= result.times.keypoints_ms;  // of which they are counted as a part
    output->keypoints = to_message(result, synchronized.config->pipeline.keypoints, frame.image->header);
  } catch (const std::exception&) {
    // The frame has its reason already.
  }
}

}  // namespace gyro_deblur
