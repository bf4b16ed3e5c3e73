#include "ros/conversions.hpp"

#include <algorithm>
#include <cinttypes>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>
#include <sstream>
#include <vector>

#include <sensor_msgs/image_encodings.h>
#include <tf2/exceptions.h>
#include <Eigen/Geometry>
#include <boost/make_shared.hpp>
#include <opencv2/imgcodecs.hpp>

#include "gyro_deblur/overlay.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "motion/lens_models.hpp"

namespace gyro_deblur {
namespace {

constexpr TimeNs kNsPerSecond = 1'000'000'000;
constexpr char kMarkerNamespace[] = "blur";
/// At the depth of the lines.
constexpr double kMarkerWidthPx = 2, kMarkerGapPx = 8;

bool host_is_big_endian() {
  const std::uint16_t probe = 1;
  std::uint8_t first_byte = 0;
  std::memcpy(&first_byte, &probe, 1);
  return first_byte == 0;
}

std::string size_text(double width, double height) {
  std::ostringstream text;
  text << width << "x" << height;
  return text.str();
}

/// The part of the sensor that the image shows, before binning.
struct Region {
  double x_offset_px = 0, y_offset_px = 0, width_px = 0, height_px = 0;
  double binning_x = 1, binning_y = 1;
};

Region region_of(const sensor_msgs::CameraInfo& info) {
  Region region;
  region.binning_x = std::max<std::uint32_t>(1, info.binning_x);
  region.binning_y = std::max<std::uint32_t>(1, info.binning_y);
  const bool whole = info.roi.width == 0 && info.roi.height == 0;
  region.x_offset_px = info.roi.x_offset;
  region.y_offset_px = info.roi.y_offset;
  region.width_px = whole ? info.width : info.roi.width;
  region.height_px = whole ? info.height : info.roi.height;
  return region;
}

/// Binned sizes are rounded up by some drivers and down by others.
bool is_binned_size(int image_px, double region_px, double binning) {
  return std::abs(image_px - region_px / binning) < 1.0;
}

/// Old drivers write a leading slash, which tf2 does not take.
std::string tf2_name(const std::string& frame_id) {
  return !frame_id.empty() && frame_id.front() == '/' ? frame_id.substr(1) : frame_id;
}

struct PixelType {
  PixelLayout layout;
  int cv_type;
};

PixelType pixel_type_of(const std::string& encoding) {
  const std::optional<PixelLayout> layout = layout_of_encoding(encoding);
  if (!layout) {
    throw FrameError(PassThroughReason::UNSUPPORTED_ENCODING,
                     "encoding \"" + encoding +
                         "\" is not one of mono8, mono16, 8UC1, 16UC1, bgr8, rgb8, bgra8, rgba8, their 16-bit kin and "
                         "bayer_*8/16");
  }
  const int depth = sensor_msgs::image_encodings::bitDepth(encoding) == 16 ? CV_16U : CV_8U;
  return {*layout, CV_MAKETYPE(depth, channels_of(*layout))};
}

}  // namespace

TimeNs to_time_ns(const ros::Time& time) { return static_cast<TimeNs>(time.toNSec()); }

ros::Time to_ros_time(TimeNs time_ns) {
  const TimeNs latest_ns = std::numeric_limits<std::uint32_t>::max() * kNsPerSecond;
  ros::Time time;
  time.fromNSec(static_cast<std::uint64_t>(std::clamp<TimeNs>(time_ns, 0, latest_ns)));
  return time;
}

std::string seconds_text(TimeNs time_ns) {
  constexpr TimeNs kNsPerSecond = 1'000'000'000;
  char text[40];
  const std::uint64_t magnitude =
      time_ns < 0 ? std::uint64_t{0} - static_cast<std::uint64_t>(time_ns) : static_cast<std::uint64_t>(time_ns);
  std::snprintf(text, sizeof(text), "%s%" PRIu64 ".%09" PRIu64, time_ns < 0 ? "-" : "", magnitude / kNsPerSecond,
                magnitude % kNsPerSecond);
  return text;
}

std::string vector_text(const Eigen::Vector3d& v) {
  char text[80];
  std::snprintf(text, sizeof(text), "[%.6f, %.6f, %.6f]", v.x(), v.y(), v.z());
  return text;
}

std::optional<GyroSample> to_gyro_sample(const sensor_msgs::Imu& imu) {
  if (imu.angular_velocity_covariance[0] == -1) return std::nullopt;
  return GyroSample{to_time_ns(imu.header.stamp),
                    Eigen::Vector3d(imu.angular_velocity.x, imu.angular_velocity.y, imu.angular_velocity.z)};
}

CameraCalibration to_calibration(const sensor_msgs::CameraInfo& info, int image_width_px, int image_height_px,
                                 bool rectified_input) {
  const Region region = region_of(info);
  if (!is_binned_size(image_width_px, region.width_px, region.binning_x) ||
      !is_binned_size(image_height_px, region.height_px, region.binning_y)) {
    throw OptionError("camera_info describes an image of " +
                      size_text(region.width_px / region.binning_x, region.height_px / region.binning_y) +
                      " (region of interest " + size_text(region.width_px, region.height_px) + ", binning " +
                      size_text(region.binning_x, region.binning_y) + "), but the image is " +
                      size_text(image_width_px, image_height_px));
  }

  // P is 3x4, K is 3x3, both row by row.
  const double* matrix = rectified_input ? info.P.data() : info.K.data();
  const int stride = rectified_input ? 4 : 3;
  const char* name = rectified_input ? "P" : "K";
  if (!(matrix[0] > 0) || !(matrix[stride + 1] > 0)) {
    std::ostringstream text;
    text << "camera_info: focal lengths in " << name << " are (" << matrix[0] << ", " << matrix[stride + 1]
         << ") px, they have to be > 0: the camera is not calibrated";
    throw OptionError(text.str());
  }
  // Relative to the focal length; printed calibrations are no more exact.
  constexpr double kLargestSkew = 1e-6;
  if (std::abs(matrix[1]) > kLargestSkew * matrix[0]) {
    throw OptionError(std::string("camera_info: skew ") + name + "[1] = " + std::to_string(matrix[1]) +
                      " is not supported, it has to be 0");
  }

  CameraCalibration calibration;
  calibration.width_px = image_width_px;
  calibration.height_px = image_height_px;
  calibration.fx_px = matrix[0] / region.binning_x;
  calibration.fy_px = matrix[stride + 1] / region.binning_y;
  calibration.cx_px = (matrix[2] - region.x_offset_px) / region.binning_x;
  calibration.cy_px = (matrix[stride + 2] - region.y_offset_px) / region.binning_y;
  if (rectified_input) {
    calibration.R_image_cam = require_rotation(
        "camera_info.R", Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(info.R.data()));
  } else if (!info.D.empty() || !info.distortion_model.empty()) {
    if (info.distortion_model.empty()) {
      throw OptionError("camera_info: distortion_model is empty, but D has " + std::to_string(info.D.size()) +
                        " coefficients");
    }
    calibration.model = require_distortion_model(info.distortion_model);
    calibration.coefficients = info.D;
    if (info.D.empty()) calibration.model = "none";  // a model without coefficients distorts nothing
  }
  calibration.validate();
  return calibration;
}

sensor_msgs::CameraInfo camera_info_message(const CameraCalibration& camera) {
  sensor_msgs::CameraInfo info;
  info.width = static_cast<std::uint32_t>(camera.width_px);
  info.height = static_cast<std::uint32_t>(camera.height_px);
  info.D = camera.coefficients;
  info.distortion_model = lens_model(camera.model).camera_info_name;
  info.D.resize(lens_model(info.distortion_model).coefficient_counts.back(), 0.0);  // image_geometry wants all of them
  info.K = {camera.fx_px, 0, camera.cx_px, 0, camera.fy_px, camera.cy_px, 0, 0, 1};
  info.R = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  info.P = {camera.fx_px, 0, camera.cx_px, 0, 0, camera.fy_px, camera.cy_px, 0, 0, 0, 1, 0};
  return info;
}

TimeNs region_readout_ns(TimeNs full_readout_ns, const sensor_msgs::CameraInfo& info) {
  const Region region = region_of(info);
  if (info.height == 0) return full_readout_ns;
  return std::llround(static_cast<double>(full_readout_ns) * region.height_px / info.height);
}

void check_image(const sensor_msgs::Image& message) {
  if (message.width == 0 || message.height == 0) {
    throw FrameError(PassThroughReason::BAD_IMAGE, "image is empty (" + size_text(message.width, message.height) + ")");
  }
  const PixelType type = pixel_type_of(message.encoding);
  constexpr std::uint32_t kLargestSide = std::numeric_limits<std::int16_t>::max();
  if (message.width > kLargestSide || message.height > kLargestSide) {
    throw FrameError(PassThroughReason::BAD_IMAGE, "image size " + size_text(message.width, message.height) +
                                                       " is outside [1, " + std::to_string(kLargestSide) + "] px");
  }
  const std::size_t row_bytes = static_cast<std::size_t>(message.width) * CV_ELEM_SIZE(type.cv_type);
  if (message.step < row_bytes || message.step % CV_ELEM_SIZE1(type.cv_type) != 0) {
    throw FrameError(PassThroughReason::BAD_IMAGE, "image step = " + std::to_string(message.step) + " does not fit " +
                                                       std::to_string(message.width) + " pixels of " +
                                                       message.encoding + " (" + std::to_string(row_bytes) + " bytes)");
  }
  const std::size_t needed = static_cast<std::size_t>(message.step) * message.height;
  if (message.data.size() < needed) {
    throw FrameError(PassThroughReason::BAD_IMAGE, "image data has " + std::to_string(message.data.size()) +
                                                       " bytes, step * height = " + std::to_string(needed));
  }
}

ImageView view_image(const sensor_msgs::Image& message) {
  check_image(message);
  const PixelType type = pixel_type_of(message.encoding);
  // cv::Mat has no read-only form; ImageView forbids writing.
  auto* data = const_cast<std::uint8_t*>(message.data.data());
  cv::Mat image(static_cast<int>(message.height), static_cast<int>(message.width), type.cv_type, data, message.step);
  if (CV_MAT_DEPTH(type.cv_type) == CV_16U && (message.is_bigendian != 0) != host_is_big_endian()) {
    image = image.clone();
    for (int y = 0; y < image.rows; ++y) {
      auto* row = image.ptr<std::uint16_t>(y);
      const int values = image.cols * image.channels();
      for (int x = 0; x < values; ++x) row[x] = static_cast<std::uint16_t>((row[x] << 8) | (row[x] >> 8));
    }
  }
  return {image, type.layout};
}

sensor_msgs::ImagePtr to_image(const cv::Mat& pixels, const sensor_msgs::Image& input) {
  auto message = boost::make_shared<sensor_msgs::Image>();
  message->header = input.header;
  message->encoding = input.encoding;
  message->width = static_cast<std::uint32_t>(pixels.cols);
  message->height = static_cast<std::uint32_t>(pixels.rows);
  message->is_bigendian = host_is_big_endian();
  const std::size_t row_bytes = static_cast<std::size_t>(pixels.cols) * pixels.elemSize();
  message->step = static_cast<std::uint32_t>(row_bytes);
  message->data.resize(row_bytes * static_cast<std::size_t>(pixels.rows));
  for (int y = 0; y < pixels.rows; ++y) {
    std::memcpy(message->data.data() + static_cast<std::size_t>(y) * row_bytes, pixels.ptr(y), row_bytes);
  }
  return message;
}

sensor_msgs::ImagePtr to_bgr_image(const cv::Mat& bgr, const std_msgs::Header& header) {
  sensor_msgs::Image like;
  like.header = header;
  like.encoding = sensor_msgs::image_encodings::BGR8;
  return to_image(bgr, like);
}

sensor_msgs::ImagePtr decode_image(const sensor_msgs::CompressedImage& compressed) {
  namespace encodings = sensor_msgs::image_encodings;
  sensor_msgs::Image like;
  like.header = compressed.header;
  cv::Mat pixels;
  try {
    // compressedDepth puts a header of its own before the data.
    if (!compressed.data.empty() && compressed.format.find("compressedDepth") == std::string::npos) {
      pixels = cv::imdecode(compressed.data, cv::IMREAD_UNCHANGED);
    }
  } catch (const cv::Exception&) {
    pixels.release();  // the same as data that is none
  }
  const std::string original = compressed.format.substr(0, compressed.format.find(';'));
  const bool wide = pixels.depth() == CV_16U;
  if (!pixels.empty() && (wide || pixels.depth() == CV_8U)) {
    switch (pixels.channels()) {
      case 1:
        like.encoding = wide ? encodings::MONO16 : encodings::MONO8;
        if (encodings::isBayer(original) && encodings::bitDepth(original) == (wide ? 16 : 8)) like.encoding = original;
        break;
      case 3:
        like.encoding = wide ? encodings::BGR16 : encodings::BGR8;
        break;
      case 4:
        like.encoding = wide ? encodings::BGRA16 : encodings::BGRA8;
        break;
      default:
        break;
    }
  }
  if (like.encoding.empty()) {
    like.encoding = encodings::MONO8;
    pixels.release();
  }
  return to_image(pixels, like);
}

sensor_msgs::CameraInfoPtr uncalibrated_camera_info(const sensor_msgs::Image& input) {
  auto info = boost::make_shared<sensor_msgs::CameraInfo>();
  info->header = input.header;
  info->width = input.width;
  info->height = input.height;
  return info;
}

BlurFieldPtr to_message(const FrameBlur& field, const std_msgs::Header& header) {
  auto message = boost::make_shared<BlurField>();
  message->header = header;
  message->reason = BlurField::REASON_NONE;
  message->image_width = static_cast<std::uint32_t>(field.grid.width_px());
  message->image_height = static_cast<std::uint32_t>(field.grid.height_px());
  message->block_width = message->block_height = static_cast<std::uint32_t>(field.grid.block_size_px());
  message->cols = static_cast<std::uint32_t>(field.grid.cols());
  message->rows = static_cast<std::uint32_t>(field.grid.rows());
  message->angle.reserve(field.blocks.size());
  message->extent.reserve(field.blocks.size());
  message->status.reserve(field.blocks.size());
  for (const BlockBlur& block : field.blocks) {
    message->angle.push_back(block.angle_rad);
    message->extent.push_back(block.extent_px);
    message->status.push_back(static_cast<std::uint8_t>(block.status));
  }
  message->exposure_time.fromNSec(field.exposure_ns);
  message->readout_time.fromNSec(field.readout_ns);
  return message;
}

BlurFieldPtr pass_through_message(PassThroughReason reason, const std::string& text, const sensor_msgs::Image& input) {
  auto message = boost::make_shared<BlurField>();
  message->header = input.header;
  message->reason = static_cast<std::uint8_t>(reason);
  message->reason_text = text;
  message->image_width = input.width;
  message->image_height = input.height;
  return message;
}

KeypointArrayPtr to_message(const PipelineResult& result, const KeypointOptions& options,
                            const std_msgs::Header& header) {
  auto message = boost::make_shared<KeypointArray>();
  message->header = header;
  message->reference_time = to_ros_time(result.reference_ns);
  message->detector = options.detector;
  message->keypoints.resize(result.features.keypoints.size());
  for (std::size_t i = 0; i < result.features.keypoints.size(); ++i) {
    const cv::KeyPoint& from = result.features.keypoints[i];
    const RectifiedPoint& point = result.points[i];
    Keypoint& to = message->keypoints[i];
    to.x = from.pt.x;
    to.y = from.pt.y;
    to.rectified_x = static_cast<float>(point.rectified_px.x());
    to.rectified_y = static_cast<float>(point.rectified_px.y());
    to.normalized_x = static_cast<float>(point.normalized.x());
    to.normalized_y = static_cast<float>(point.normalized.y());
    to.size = from.size;
    to.angle = from.angle;
    to.response = from.response;
    to.octave = from.octave;
    to.deblurred = point.deblurred;
    to.rectified = point.rectified;
  }
  const cv::Mat& descriptors = result.features.descriptors;
  if (descriptors.empty()) return message;
  message->descriptor = options.descriptor;
  message->descriptor_type =
      descriptors.depth() == CV_32F ? KeypointArray::DESCRIPTOR_FLOAT32 : KeypointArray::DESCRIPTOR_BINARY;
  const std::size_t row_bytes = static_cast<std::size_t>(descriptors.cols) * descriptors.elemSize();
  message->descriptor_length = static_cast<std::uint32_t>(row_bytes);
  message->descriptors.resize(row_bytes * static_cast<std::size_t>(descriptors.rows));
  for (int i = 0; i < descriptors.rows; ++i) {
    std::memcpy(message->descriptors.data() + static_cast<std::size_t>(i) * row_bytes, descriptors.ptr(i), row_bytes);
  }
  return message;
}

sensor_msgs::PointCloudPtr to_message(const std::vector<Track>& tracks, const std_msgs::Header& header) {
  auto message = boost::make_shared<sensor_msgs::PointCloud>();
  message->header = header;
  message->channels.resize(5);
  enum Channel : std::size_t { ID, U, V, VELOCITY_X, VELOCITY_Y };
  message->channels[ID].name = "id_of_point";
  message->channels[U].name = "u_of_point";
  message->channels[V].name = "v_of_point";
  message->channels[VELOCITY_X].name = "velocity_x_of_point";
  message->channels[VELOCITY_Y].name = "velocity_y_of_point";
  const auto add = [&message](Channel channel, double value) {
    message->channels[channel].values.push_back(static_cast<float>(value));
  };
  for (const Track& track : tracks) {
    if (track.length < 2) continue;
    geometry_msgs::Point32 point;
    point.x = static_cast<float>(track.normalized.x());
    point.y = static_cast<float>(track.normalized.y());
    point.z = 1;
    message->points.push_back(point);
    add(ID, track.id);
    add(U, track.pixel_px.x());
    add(V, track.pixel_px.y());
    add(VELOCITY_X, track.velocity_1_s.x());
    add(VELOCITY_Y, track.velocity_1_s.y());
  }
  return message;
}

visualization_msgs::MarkerArrayPtr to_markers(const FrameBlur& field, const Camera& camera,
                                              const std_msgs::Header& header) {
  auto array = boost::make_shared<visualization_msgs::MarkerArray>();
  array->markers.resize(1);
  visualization_msgs::Marker& marker = array->markers.front();
  marker.header = header;
  marker.ns = kMarkerNamespace;
  marker.id = 0;
  marker.type = visualization_msgs::Marker::LINE_LIST;
  marker.action = visualization_msgs::Marker::ADD;
  marker.pose.orientation.w = 1;
  marker.color.a = 1;
  marker.scale.x = kMarkerWidthPx / camera.calibration().fx_px;

  std::vector<Eigen::Vector2d> ends_px;
  ends_px.reserve(2 * field.blocks.size());
  const std::vector<char> has_path = paths_apart(field, kMarkerGapPx);
  const Eigen::Vector2d half_dot_px(kMarkerWidthPx, 0);
  for (int i = 0; i < field.grid.size(); ++i) {
    const Eigen::Vector2d center_px = field.grid.center(i);
    const BlurSegment segment = has_path[static_cast<std::size_t>(i)]
                                    ? blur_segment(field, i)
                                    : BlurSegment{center_px - half_dot_px, center_px + half_dot_px};
    ends_px.push_back(segment.from_px);
    ends_px.push_back(segment.to_px);
  }
  const std::vector<Eigen::Vector3d> rays = camera.rays(ends_px);
  for (std::size_t i = 0; i < field.blocks.size(); ++i) {
    // rviz drops a whole marker for one point that is not finite.
    if (!rays[2 * i].allFinite() || !rays[2 * i + 1].allFinite()) continue;
    const cv::Vec3b rgb = status_color_rgb(field.blocks[i].status);
    std_msgs::ColorRGBA color;
    color.r = static_cast<float>(rgb[0]) / 255.f;
    color.g = static_cast<float>(rgb[1]) / 255.f;
    color.b = static_cast<float>(rgb[2]) / 255.f;
    color.a = 1;
    for (const Eigen::Vector3d& ray : {rays[2 * i], rays[2 * i + 1]}) {
      geometry_msgs::Point point;
      point.x = ray.x();
      point.y = ray.y();
      point.z = ray.z();
      marker.points.push_back(point);
      marker.colors.push_back(color);
    }
  }
  return array;
}

visualization_msgs::MarkerArrayPtr no_markers(const std_msgs::Header& header) {
  auto array = boost::make_shared<visualization_msgs::MarkerArray>();
  array->markers.resize(1);
  array->markers.front().header = header;
  array->markers.front().ns = kMarkerNamespace;
  array->markers.front().action = visualization_msgs::Marker::DELETE;
  array->markers.front().pose.orientation.w = 1;
  return array;
}

void add_transforms(const tf2_msgs::TFMessage& message, tf2::BufferCore* buffer) {
  constexpr bool kStatic = true;  // tf keeps one transform then, and looks at no stamps
  for (const geometry_msgs::TransformStamped& transform : message.transforms) {
    buffer->setTransform(transform, "gyro_deblur", kStatic);
  }
}

std::optional<Eigen::Matrix3d> lookup_R_cam_imu(const tf2::BufferCore& buffer, const std::string& camera_frame_id,
                                                const std::string& imu_frame_id) {
  const std::optional<Eigen::Isometry3d> T_cam_imu = lookup_T_cam_body(buffer, camera_frame_id, imu_frame_id);
  if (!T_cam_imu) return std::nullopt;
  return T_cam_imu->linear();
}

std::optional<Eigen::Isometry3d> lookup_T_cam_body(const tf2::BufferCore& buffer, const std::string& camera_frame_id,
                                                   const std::string& body_frame_id) {
  const std::string camera_frame = tf2_name(camera_frame_id);
  const std::string body_frame = tf2_name(body_frame_id);
  if (camera_frame.empty() || body_frame.empty()) return std::nullopt;
  try {
    if (!buffer.canTransform(camera_frame, body_frame, ros::Time(0))) return std::nullopt;
    const auto transform = buffer.lookupTransform(camera_frame, body_frame, ros::Time(0));
    const auto& q = transform.transform.rotation;
    const auto& p = transform.transform.translation;
    Eigen::Isometry3d T_cam_body = Eigen::Isometry3d::Identity();
    T_cam_body.linear() = Eigen::Quaterniond(q.w, q.x, q.y, q.z).normalized().toRotationMatrix();
    T_cam_body.translation() = Eigen::Vector3d(p.x, p.y, p.z);
    return T_cam_body;
  } catch (const tf2::TransformException&) {
    return std::nullopt;  // went away between the two calls, or a frame name that tf refuses
  }
}

}  // namespace gyro_deblur
