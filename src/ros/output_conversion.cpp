// Converts results to messages.
#include "ros/output_conversion.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <optional>

#include <Eigen/Core>
#include <boost/make_shared.hpp>

#include "gyro_deblur/overlay.hpp"
#include "ros/value_conversion.hpp"

namespace gyro_deblur {
namespace {

constexpr float kUnknown = -1;
constexpr char kMarkerNamespace[] = "blur";
/// At the depth of the lines.
constexpr double kMarkerWidthPx = 2, kMarkerGapPx = 8, kMarkerHalfTickPx = 4;

struct TrackChannel {
  const char* name;
  bool vins_fusion_only;
  double (*value)(const Track& track);
};

/// In the order in which the estimators read all but the covariances. VINS-Fusion stores a point's true place, and only
/// draws it.
constexpr TrackChannel kChannels[] = {
    {"id_of_point", false, [](const Track& track) { return static_cast<double>(track.id); }},
    {"camera_of_point", true, [](const Track&) { return 0.0; }},
    {"u_of_point", false, [](const Track& track) { return track.pixel_px.x(); }},
    {"v_of_point", false, [](const Track& track) { return track.pixel_px.y(); }},
    {"velocity_x_of_point", false, [](const Track& track) { return track.velocity_1_s.x(); }},
    {"velocity_y_of_point", false, [](const Track& track) { return track.velocity_1_s.y(); }},
    {"true_x_of_point", true, [](const Track&) { return 0.0; }},
    {"true_y_of_point", true, [](const Track&) { return 0.0; }},
    {"true_z_of_point", true, [](const Track&) { return 0.0; }},
    {"covariance_uu_of_point", false, [](const Track& track) { return track.covariance_px2(0, 0); }},
    {"covariance_uv_of_point", false, [](const Track& track) { return track.covariance_px2(0, 1); }},
    {"covariance_vv_of_point", false, [](const Track& track) { return track.covariance_px2(1, 1); }}};

/// One marker without content.
visualization_msgs::MarkerArrayPtr make_markers(const std_msgs::Header& header, std::int32_t action) {
  auto array = boost::make_shared<visualization_msgs::MarkerArray>();
  array->markers.resize(1);
  visualization_msgs::Marker& marker = array->markers.front();
  marker.header = header;
  marker.ns = kMarkerNamespace;
  marker.action = action;
  marker.pose.orientation.w = 1;
  return array;
}

}  // namespace

BlurFieldPtr to_message(const FrameBlur& field, const std_msgs::Header& header) {
  auto message = boost::make_shared<BlurField>();
  message->header = header;
  message->reason = BlurField::REASON_NONE;
  message->image_width = static_cast<std::uint32_t>(field.grid.width_px());
  message->image_height = static_cast<std::uint32_t>(field.grid.height_px());
  message->block_width = message->block_height = static_cast<std::uint32_t>(field.grid.block_size_px());
  message->cols = static_cast<std::uint32_t>(field.grid.cols());
  message->rows = static_cast<std::uint32_t>(field.grid.rows());
  for (const BlockBlur& block : field.blocks) {
    const ResidualVelocity residual = block.residual.value_or(ResidualVelocity{});
    message->source.push_back(!block.residual      ? BlurField::SOURCE_GYROSCOPE
                              : field.images_alone ? BlurField::SOURCE_IMAGES_ALONE
                                                   : BlurField::SOURCE_IMAGES);
    message->residual_x.push_back(static_cast<float>(residual.velocity_px_s.x()));
    message->residual_y.push_back(static_cast<float>(residual.velocity_px_s.y()));
    message->residual_stddev.push_back(static_cast<float>(residual.stddev_px_s));
    message->angle.push_back(block.angle_rad);
    message->extent.push_back(block.extent_px);
    message->status.push_back(static_cast<std::uint8_t>(block.status));
  }
  message->noise = field.noise ? static_cast<float>(*field.noise) : kUnknown;
  message->exposure_time.fromNSec(field.exposure_ns);
  message->readout_time.fromNSec(field.readout_ns);
  return message;
}

BlurFieldPtr pass_through_message(PassThroughReason reason, const std::string& text, const sensor_msgs::Image& input) {
  auto message = boost::make_shared<BlurField>();
  message->header = input.header;
  message->reason = static_cast<std::uint8_t>(reason);
  message->reason_text = text;
  message->noise = kUnknown;
  message->image_width = input.width;
  message->image_height = input.height;
  return message;
}

ImageQualityPtr to_message(const FrameQuality& quality, const std_msgs::Header& header) {
  auto message = boost::make_shared<ImageQuality>();
  message->header = header;
  message->grade = static_cast<std::uint8_t>(quality.grade);
  message->score = quality.score ? static_cast<float>(*quality.score) : kUnknown;
  message->extent_median = static_cast<float>(quality.before.median_px);
  message->extent_p95 = static_cast<float>(quality.before.p95_px);
  message->residual_extent_median = static_cast<float>(quality.after.median_px);
  message->residual_extent_p95 = static_cast<float>(quality.after.p95_px);
  message->noise = quality.noise ? static_cast<float>(*quality.noise) : kUnknown;
  message->contrast = static_cast<float>(quality.contrast);
  const auto share = [&quality](BlockStatus status) { return static_cast<float>(quality.share(status)); };
  message->sharp = share(BlockStatus::SHARP);
  message->deblurred = share(BlockStatus::DEBLURRED);
  message->rejected = share(BlockStatus::REJECTED);
  message->too_large = share(BlockStatus::TOO_LARGE);
  message->no_gyro = share(BlockStatus::NO_GYRO);
  message->too_curved = share(BlockStatus::TOO_CURVED);
  message->noisy = share(BlockStatus::NOISY);
  message->masked = share(BlockStatus::MASKED);
  message->static_edge = share(BlockStatus::STATIC_EDGE);
  return message;
}

ImageQualityPtr unknown_quality(const std_msgs::Header& header) {
  FrameQuality unknown;
  unknown.shares[static_cast<std::size_t>(BlockStatus::NO_GYRO)] = 1;
  return to_message(unknown, header);
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
    const Eigen::Matrix2d& covariance_px2 = result.covariances_px2[i];
    to.covariance_xx = static_cast<float>(covariance_px2(0, 0));
    to.covariance_xy = static_cast<float>(covariance_px2(0, 1));
    to.covariance_yy = static_cast<float>(covariance_px2(1, 1));
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

sensor_msgs::PointCloudPtr to_message(const std::vector<Track>& tracks, TrackLayout layout,
                                      const std_msgs::Header& header) {
  std::vector<TrackChannel> channels;
  std::copy_if(std::begin(kChannels), std::end(kChannels), std::back_inserter(channels),
               [layout](const TrackChannel& channel) {
                 return layout == TrackLayout::VINS_FUSION || !channel.vins_fusion_only;
               });
  auto message = boost::make_shared<sensor_msgs::PointCloud>();
  message->header = header;
  message->channels.resize(channels.size());
  for (std::size_t i = 0; i < channels.size(); ++i) message->channels[i].name = channels[i].name;
  for (const Track& track : tracks) {
    if (track.length < 2) continue;
    geometry_msgs::Point32 point;
    point.x = static_cast<float>(track.normalized.x());
    point.y = static_cast<float>(track.normalized.y());
    point.z = 1;
    message->points.push_back(point);
    for (std::size_t i = 0; i < channels.size(); ++i) {
      message->channels[i].values.push_back(static_cast<float>(channels[i].value(track)));
    }
  }
  return message;
}

visualization_msgs::MarkerArrayPtr to_markers(const FrameBlur& field, const Camera& camera,
                                              const std_msgs::Header& header) {
  visualization_msgs::MarkerArrayPtr array = make_markers(header, visualization_msgs::Marker::ADD);
  visualization_msgs::Marker& marker = array->markers.front();
  marker.type = visualization_msgs::Marker::LINE_LIST;
  marker.color.a = 1;
  marker.scale.x = kMarkerWidthPx / camera.calibration().fx_px;

  std::vector<Eigen::Vector2d> ends_px;
  std::vector<cv::Vec3b> colors_rgb;  // of each segment
  const auto add = [&](const BlurSegment& segment, const cv::Vec3b& color_rgb) {
    ends_px.push_back(segment.from_px);
    ends_px.push_back(segment.to_px);
    colors_rgb.push_back(color_rgb);
  };
  const std::vector<char> has_path = paths_apart(field, kMarkerGapPx);
  for (int i = 0; i < field.grid.size(); ++i) {
    const Eigen::Vector2d center_px = field.grid.center(i), half_dot_px(kMarkerWidthPx, 0),
                          half_tick_px(0, kMarkerHalfTickPx);
    const bool drawn = has_path[static_cast<std::size_t>(i)] != 0;
    add(drawn ? blur_segment(field, i) : BlurSegment{center_px - half_dot_px, center_px + half_dot_px},
        status_color_rgb(field.blocks[static_cast<std::size_t>(i)].status));
    const std::optional<BlurSegment> residual = residual_segment(field, i);
    if (!residual) continue;
    add(drawn ? *residual : BlurSegment{center_px - half_tick_px, center_px + half_tick_px}, residual_color_rgb());
  }
  const std::vector<Eigen::Vector3d> rays = camera.rays(ends_px);
  for (std::size_t i = 0; i < colors_rgb.size(); ++i) {
    // rviz drops a whole marker for one point that is not finite.
    if (!rays[2 * i].allFinite() || !rays[2 * i + 1].allFinite()) continue;
    const cv::Vec3b& rgb = colors_rgb[i];
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
  return make_markers(header, visualization_msgs::Marker::DELETE);
}

}  // namespace gyro_deblur
