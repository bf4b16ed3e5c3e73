// One frame from pixels and motion to deblurred pixels and rectified keypoints.
#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/image_format.hpp"
#include "gyro_deblur/keypoints.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/pixel_mask.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

class Engine;

/// What is done with a frame whose field is known, and why. Without either text it is deblurred.
struct FrameAction {
  /// Why the frame is passed through: every block that would be deblurred is REJECTED, and nothing is moved to the
  /// reference time.
  std::string pass_through_text;
  /// Why the frame is dropped: the field is all that there is of it, and says what could have been deblurred.
  std::string drop_text;

  bool deblurs() const { return pass_through_text.empty() && drop_text.empty(); }
};

/// What an image's blur, and that of the images before, say of its exposure.
struct ExposureAnswer {
  TimeNs exposure_ns = 0;  ///< (0, 1] s, the likeliest
  bool is_known = true;    ///< the image may be deblurred by it
};

/// How an exposure time is found that is not certain.
struct ExposureQuestion {
  bool estimate = true;   ///< the exposure is estimated from the blur (doc/design/exposure.md)
  TimeNs longest_ns = 0;  ///< longest time that the exposure is expected to be; 0: not known
  TimeNs period_ns = 0;   ///< frame period: no exposure is longer; 0: not known
};

/// What images still lack for an estimate of the exposure time.
enum class ExposureNeed { NOTHING, MOTION, TEXTURE, LIGHT };

/// What a caller wants of a frame; nothing else is computed.
struct PipelineRequest {
  bool image = true;             ///< the deblurred image
  bool keypoints = true;         ///< keypoints and rectification (implies the deblurred luminance)
  bool luminance = false;        ///< the deblurred luminance
  bool global_shutter = false;   ///< the deblurred image with all rows moved to the reference time
  bool input_luminance = false;  ///< the luminance of the image as it came
  /// No 2-D filters, which take two to four times as long. Has no effect on engine "fourier".
  bool behind_camera_rate = false;
  /// The image repeats the picture of the call before. The motion that was found for that picture is used again.
  /// `motion` and `exposure` have to be those of the call before, too.
  bool repeats_picture = false;
  /// If set, the exposure time of estimate() is a first guess, and validate() gets the answer; else it is used as
  /// given.
  std::optional<ExposureQuestion> exposure = {};
  /// No gyroscope is there, or it is silent: see flow_without_gyro.
  bool without_gyro = false;
};

/// Wall time of each stage [ms]; 0 for a stage that did not run.
struct StageTimes {
  double flow_ms = 0;  ///< of corners since the image before
  double blur_field_ms = 0;
  double validation_ms = 0;
  double noise_ms = 0;
  double deconvolution_ms = 0;
  double keypoints_ms = 0;
  double global_shutter_ms = 0;
  double exposure_ms = 0;  ///< of its estimate
};

/// What an image says of the camera, and how the work on it went.
struct FrameFindings {
  /// Why there are no keypoints though they were requested, such as a detector that OpenCV does not have; else empty.
  std::string keypoints_text;
  /// What the residual velocities have in common; nothing where too few are known, and for a picture that is repeated.
  std::optional<ResidualRotation> residual_rotation;
  /// About how much of the image does not move with the camera and is not masked, in [0, 1], see StaticContent; blocks
  /// at its edge are STATIC_EDGE.
  double static_share = 0;
  /// Rotation of the image as a whole (`rate_rad_s`), and that by `motion`. Its corners are followed without the
  /// gyroscope if they are not found where the gyroscope predicts them, or if most blocks are TOO_LARGE.
  std::optional<ResidualRotation> seen_rotation;
  StageTimes times;
  /// How many blocks did not take the engine's fast path, for each reason in words.
  std::map<std::string, std::size_t> fallback_counts;
};

struct PipelineResult : FrameFindings {
  FrameBlur field;  ///< from validate() on validated
  /// Deblurred; empty when neither it nor the global-shutter image was requested, or when no block was changed (use the
  /// input).
  cv::Mat image;
  cv::Mat luminance;        ///< deblurred, CV_8UC1; may share memory with the input; empty when not requested
  cv::Mat input_luminance;  ///< the same of the image as it came
  /// The deblurred image at the reference time; empty when not requested, or where no motion is known. That of a mosaic
  /// or YUV 4:2:2 is BGR, except when all rows were exposed around the reference time: then it is `image`, or the
  /// input, itself, and shares its memory.
  cv::Mat global_shutter;
  Features features;                             ///< in pixels of the image as it arrived
  std::vector<RectifiedPoint> points;            ///< one for each of features.keypoints
  std::vector<Eigen::Matrix2d> covariances_px2;  ///< of points[].rectified_px
  int significant_bits = 8;                      ///< of the image that came in, see BitDepth
  TimeNs reference_ns = 0;  ///< camera clock; at which points[].rectified_px and global_shutter hold
  /// The exposure that was used, or assumed.
  TimeNs exposure_ns = 0;
  /// False: the exposure is not known. Then no block is DEBLURRED and there are no image, keypoints and global-shutter
  /// image, unless the image is sharp whatever the exposure is.
  bool exposure_is_known = true;
  bool sharp_at_any_exposure = false;                  ///< of an exposure that is not known
  std::optional<ExposureEstimate> exposure_estimate;   ///< from the blur; nothing: there is none, or none was made
  double mean_brightness = 0;                          ///< mean grey level, 0 to 255, where the exposure is in question
  ExposureNeed exposure_need = ExposureNeed::NOTHING;  ///< where the exposure is not known

  /// Whether the field is known, and with it what may be deblurred.
  bool blur_is_known() const { return exposure_is_known || sharp_at_any_exposure; }
};

/// For tests of this package: makes the engine of a name and a number of threads. Leave it empty.
using EngineFactory = std::function<std::unique_ptr<Engine>(const std::string& engine, int threads)>;

/// The paper's method for one camera. Calibration and options may change between frames; what depends on them is
/// rebuilt then. Not thread-safe, engine() aside.
///
/// process() makes three calls, which a caller may make itself: estimate(), then validate() with the exposure that the
/// caller has chosen, then deblur() with what the caller has decided. A call out of this order throws std::logic_error
/// and changes nothing. The pipeline keeps one frame between the calls. It forgets the frame in deblur(), in another
/// estimate(), when options, calibration or mask are set, and when a call throws anything else.
///
/// A calibration file (calibration.hpp) goes to three places: `camera` to the pipeline, `R_cam_imu` and the time offset
/// to the motion, the readout time to the exposure of the rows.
///
///     const SensorCalibration file = load_calibration("camchain-imucam.yaml");
///     Pipeline pipeline({});
///     pipeline.set_calibration(file.camera.value());
///     GyroOptions gyro;
///     gyro.time_offset_ns = file.time_offset_ns.value_or(0);
///     ShutterTiming timing;
///     timing.readout_ns = file.readout_ns.value_or(0);
///     timing.exposure_ns = 20'000'000;
///     // For each image. Samples reach from before the previous image's exposure to after its own:
///     const RotationTrack motion(samples, gyro, file.R_cam_imu.value());
///     const RowExposure exposure(stamp_ns, image.rows, timing);
///     const PipelineResult result = pipeline.process(image, PixelLayout::GRAY, motion, exposure, {});
///     const cv::Mat& deblurred = result.image.empty() ? image : result.image;  // empty: no block was changed
class Pipeline {
 public:
  /// Throws OptionError. Prepares filters for all blur that the options let through (time and memory by max_extent:
  /// doc/reports/performance.md).
  explicit Pipeline(const PipelineOptions& options, const EngineFactory& engine_factory = {});
  Pipeline(Pipeline&&) noexcept;
  Pipeline& operator=(Pipeline&&) noexcept;
  ~Pipeline();

  /// Throws OptionError and keeps the former options when the new ones are not valid. Rebuilds what depends on the
  /// options that differ, prepared for the first frame as in the constructor, and nothing else.
  void set_options(const PipelineOptions& options);
  const PipelineOptions& options() const;

  /// Throws OptionError and keeps the former calibration when the new one is not valid. Cheap when nothing changed.
  void set_calibration(const CameraCalibration& calibration);

  /// Masked pixels are passed through, and are neither followed nor described nor counted; see mark_masked() and
  /// mark_static_edges() for what becomes of blocks. The global-shutter image has them where they are.
  /// @param mask  empty, or of the size of the images to come
  void set_mask(const PixelMask& mask);

  /// Name of the engine in use. Any thread may ask during process().
  std::string engine() const;

  /// What the user should know, of the engine, such as a device that failed, or a guess of significant bits; ask after
  /// set_options and after each frame.
  std::string take_warning();

  /// Exposure of the picture before, from which corners are followed and static content is found: how far back the next
  /// call's `motion` should reach.
  std::optional<TimeRange> newest_frame() const;

  /// Predicts a frame's blur, follows its corners, and estimates its exposure if that is in question.
  /// @param image   CV_8U or CV_16U that fits `layout`, of the calibration's size; its pixels are read until deblur()
  /// @param motion  of the camera over the frame and, for optical flow, back to newest_frame(). Blocks that it does not
  ///                cover are NO_GYRO. If it does not cover the frame wholly and flow_without_gyro allows it, optical
  ///                flow alone gives the motion of every block, or the block is NO_GYRO. Has to exist until deblur()
  /// @return what is known so far, until the next call
  /// Throws std::invalid_argument when the image or the mask does not fit, std::logic_error before set_calibration.
  const PipelineResult& estimate(const cv::Mat& image, PixelLayout layout, const CameraMotion& motion,
                                 const RowExposure& exposure, const PipelineRequest& request);

  /// Tests which blocks may be deblurred by the exposure that was chosen, or says why it is not known.
  /// @param answer  where the request has a question, and only there
  /// @return what is known so far, with the validated field, until the next call
  const PipelineResult& validate(const std::optional<ExposureAnswer>& answer = {});

  /// What the request wants of the frame, as far as `action` allows it.
  PipelineResult deblur(const FrameAction& action = {});

  /// All three, for a frame whose exposure is not in question.
  PipelineResult process(const cv::Mat& image, PixelLayout layout, const CameraMotion& motion,
                         const RowExposure& exposure, const PipelineRequest& request);

  /// Keypoints of an image whose motion is not known: where they are in `image`, none deblurred or rectified.
  /// @param image        CV_8U or CV_16U that fits `layout`
  /// @param stamp_ns     becomes the result's reference time
  /// @param calibration  for the normalised coordinates, which are NaN without it
  /// A mask of another size is not used.
  PipelineResult detect(const cv::Mat& image, PixelLayout layout, TimeNs stamp_ns,
                        const std::optional<CameraCalibration>& calibration);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace gyro_deblur
