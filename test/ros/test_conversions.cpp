#include "ros/conversions.hpp"

#include <cstring>
#include <fstream>
#include <limits>
#include <regex>

#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>

#include "gyro_deblur/blur_field.hpp"
#include "gyro_deblur/overlay.hpp"
#include "message_builders.hpp"
#include "ros/param_conversion.hpp"
#include "sync/pass_through.hpp"

namespace gyro_deblur::conversions_test {
namespace {

using namespace test;

template <typename Function>
std::string error_of(Function function) {
  try {
    function();
  } catch (const std::exception& error) {
    return error.what();
  }
  return "";
}

bool has(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

TEST(Time, NanosecondsSurviveAndAreClamped) {
  const TimeNs time_ns = 1'700'000'000'123'456'789;
  EXPECT_EQ(to_time_ns(to_ros_time(time_ns)), time_ns);
  EXPECT_EQ(to_time_ns(to_ros_time(-1)), 0);
  EXPECT_EQ(to_ros_time(std::numeric_limits<TimeNs>::max()).sec, std::numeric_limits<std::uint32_t>::max());
}

TEST(GyroSample, CovarianceCanSayThatThereIsNone) {
  sensor_msgs::Imu imu = imu_message(5 * kSecond, 0.5);
  imu.angular_velocity.x = -0.25;
  imu.angular_velocity.z = 0.125;
  const auto sample = to_gyro_sample(imu);
  ASSERT_TRUE(sample);
  EXPECT_EQ(sample->t_ns, 5 * kSecond);
  EXPECT_EQ(sample->rate_rad_s, Eigen::Vector3d(-0.25, 0.5, 0.125));
  imu.linear_acceleration.z = 9.5;
  EXPECT_EQ(to_gyro_sample(imu)->specific_force_m_s2, Eigen::Vector3d(0, 0, 9.5));
  imu.linear_acceleration_covariance[0] = -1;
  EXPECT_FALSE(to_gyro_sample(imu)->specific_force_m_s2.allFinite());
  imu.angular_velocity_covariance[0] = -1;
  EXPECT_FALSE(to_gyro_sample(imu));
}

TEST(Calibration, RawImageTakesKAndD) {
  auto info = camera_info(0);
  info->D = {0.1, -0.2, 0.001, 0.002, 0.05};
  const CameraCalibration calibration = to_calibration(*info, kWidth, kHeight, false);
  EXPECT_EQ(calibration.width_px, kWidth);
  EXPECT_EQ(calibration.height_px, kHeight);
  EXPECT_EQ(calibration.fx_px, kFocalPx);
  EXPECT_EQ(calibration.cy_px, (kHeight - 1) / 2.0);
  EXPECT_EQ(calibration.model, "plumb_bob");
  EXPECT_EQ(calibration.coefficients, info->D);
  EXPECT_TRUE(calibration.R_image_cam.isIdentity());
}

TEST(Calibration, RegionAndBinningMoveAndScale) {
  auto info = camera_info(0, 640, 480);
  info->K = {400, 0, 320, 0, 410, 240, 0, 0, 1};
  info->roi.x_offset = 100;
  info->roi.y_offset = 60;
  info->roi.width = 320;
  info->roi.height = 240;
  info->binning_x = 2;
  info->binning_y = 4;
  const CameraCalibration calibration = to_calibration(*info, 160, 60, false);
  EXPECT_DOUBLE_EQ(calibration.fx_px, 200);
  EXPECT_DOUBLE_EQ(calibration.fy_px, 102.5);
  EXPECT_DOUBLE_EQ(calibration.cx_px, 110);
  EXPECT_DOUBLE_EQ(calibration.cy_px, 45);
  EXPECT_EQ(region_readout_ns(20 * kMs, *info), 10 * kMs) << "half of the sensor's rows are read";
  EXPECT_EQ(region_readout_ns(-20 * kMs, *info), -10 * kMs);
  info->roi.height = 0;
  info->roi.width = 0;
  EXPECT_EQ(region_readout_ns(20 * kMs, *info), 20 * kMs);
}

TEST(Calibration, RectifiedInputTakesPAndR) {
  auto info = camera_info(0);
  info->D = {0.1, -0.2, 0.001, 0.002, 0.05};
  info->P = {150, 0, 90, 0, 0, 160, 60, 0, 0, 0, 1, 0};
  info->R = {0, -1, 0, 1, 0, 0, 0, 0, 1};
  const CameraCalibration calibration = to_calibration(*info, kWidth, kHeight, true);
  EXPECT_EQ(calibration.fx_px, 150);
  EXPECT_EQ(calibration.fy_px, 160);
  EXPECT_EQ(calibration.cx_px, 90);
  EXPECT_EQ(calibration.model, "none");
  EXPECT_TRUE((calibration.R_image_cam * Eigen::Vector3d::UnitX()).isApprox(Eigen::Vector3d::UnitY()));
  info->R.fill(0);
  EXPECT_TRUE(has(error_of([&] { to_calibration(*info, kWidth, kHeight, true); }), "camera_info.R"));
}

TEST(Calibration, ErrorsNameTheValues) {
  auto info = camera_info(0);
  info->K.fill(0);
  EXPECT_TRUE(has(error_of([&] { to_calibration(*info, kWidth, kHeight, false); }), "not calibrated"));
  info = camera_info(0);
  info->K[0] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(has(error_of([&] { to_calibration(*info, kWidth, kHeight, false); }), "nan"));
  info = camera_info(0);
  info->distortion_model = "fov";
  const std::string model_error = error_of([&] { to_calibration(*info, kWidth, kHeight, false); });
  EXPECT_TRUE(has(model_error, "fov") && has(model_error, "equidistant")) << model_error;
  info = camera_info(0, 640, 480);
  const std::string size_error = error_of([&] { to_calibration(*info, kWidth, kHeight, false); });
  EXPECT_TRUE(has(size_error, "640x480") && has(size_error, "192x128")) << size_error;
  info = camera_info(0);
  info->distortion_model = "";
  EXPECT_TRUE(has(error_of([&] { to_calibration(*info, kWidth, kHeight, false); }), "distortion_model is empty"));
  info = camera_info(0);
  info->K[1] = 3;
  EXPECT_TRUE(has(error_of([&] { to_calibration(*info, kWidth, kHeight, false); }), "skew"));
}

TEST(Calibration, OfTheSensorIsCutToTheRegionWithItsLens) {
  CameraCalibration sensor = to_calibration(*camera_info(0, 640, 480), 640, 480, false);
  sensor.model = "ds";
  sensor.coefficients = {-0.2, 0.6};
  sensor.cx_px = 320;
  sensor_msgs::CameraInfo shown;
  shown.roi.x_offset = 100;
  shown.roi.width = 320;
  shown.roi.height = 240;
  shown.binning_x = shown.binning_y = 2;
  const CameraCalibration calibration = to_calibration(sensor, shown, 160, 120);
  EXPECT_DOUBLE_EQ(calibration.cx_px, 110);
  EXPECT_DOUBLE_EQ(calibration.fx_px, sensor.fx_px / 2);
  EXPECT_EQ(calibration.model, "ds");
  EXPECT_EQ(calibration.coefficients, sensor.coefficients);
  EXPECT_TRUE(has(error_of([&] { to_calibration(sensor, shown, 640, 480); }), "640x480"));
}

TEST(Calibration, CoefficientsOfDCountOnlyWhereTheyAreNotZero) {
  auto info = camera_info(0);
  const std::pair<const char*, std::vector<std::size_t>> kCases[] = {
      {"plumb_bob", {1, 2, 4, 5, 8, 12}}, {"rational_polynomial", {4, 5, 8, 12, 14}}, {"equidistant", {1, 4, 5, 8}}};
  for (const auto& [model, counts] : kCases) {
    for (const std::size_t count : counts) {
      info->distortion_model = model;
      info->D.assign(count, 0);
      info->D[0] = 0.1;
      EXPECT_NO_THROW(to_calibration(*info, kWidth, kHeight, false)) << model << count;
    }
  }
  info->D = {0.1, 0, 0, 0, 0.02};
  EXPECT_TRUE(has(error_of([&] { to_calibration(*info, kWidth, kHeight, false); }),
                  "5 coefficients, but equidistant has 4: number 5 is 0.02"));
}

// camera_info cannot carry the coefficients of these models.
TEST(Calibration, CameraInfoOfOtherLensesHasTheNameAlone) {
  CameraCalibration camera = to_calibration(*camera_info(0), kWidth, kHeight, false);
  for (const auto& [model, coefficients] :
       {std::make_pair("ds", std::vector<double>{-0.2, 0.6}), std::make_pair("eucm", std::vector<double>{0.6, 1.1}),
        std::make_pair("mei", std::vector<double>{1.5, 0.1, 0, 0, 0})}) {
    camera.model = model;
    camera.coefficients = coefficients;
    const sensor_msgs::CameraInfo info = camera_info_message(camera);
    EXPECT_EQ(info.distortion_model, model);
    EXPECT_TRUE(info.D.empty());
    EXPECT_EQ(info.K[0], camera.fx_px);
    EXPECT_TRUE(lacks_lens(info));
    const std::string error = error_of([&] { to_calibration(info, kWidth, kHeight, false); });
    EXPECT_TRUE(has(error, std::string("camera_info: distortion_model = \"") + model + "\"") &&
                has(error, "set calibration_file"))
        << error;
  }
  EXPECT_FALSE(lacks_lens(*camera_info(0)));
}

TEST(ImageView, SharesThePixels) {
  const auto message = image_message(0, "bgr8");
  const ImageView view = view_image(*message);
  EXPECT_EQ(view.image.data, message->data.data());
  EXPECT_EQ(view.image.type(), CV_8UC3);
  EXPECT_EQ(view.layout, PixelLayout::BGR);
}

TEST(ImageView, SwapsBigEndianIntoACopy) {
  auto message = image_message(0, "mono16");
  const cv::Mat expected = view_image(*message).image.clone();
  for (std::size_t i = 0; i + 1 < message->data.size(); i += 2) std::swap(message->data[i], message->data[i + 1]);
  message->is_bigendian = !message->is_bigendian;
  const ImageView view = view_image(*message);
  EXPECT_NE(view.image.data, message->data.data());
  EXPECT_EQ(cv::norm(view.image, expected, cv::NORM_INF), 0);
}

TEST(ImageView, PaddedRowsAreRead) {
  const auto plain = image_message(0);
  auto padded = boost::make_shared<sensor_msgs::Image>(*plain);
  padded->step = kWidth + 7;
  padded->data.assign(padded->step * kHeight, 0xAB);
  for (int y = 0; y < kHeight; ++y) {
    std::memcpy(&padded->data[static_cast<std::size_t>(y) * padded->step],
                &plain->data[static_cast<std::size_t>(y) * kWidth], kWidth);
  }
  EXPECT_EQ(cv::norm(view_image(*padded).image, view_image(*plain).image, cv::NORM_INF), 0);
}

TEST(ImageView, ReasonsOfRefusal) {
  const auto reason_of = [](const sensor_msgs::Image& image) {
    try {
      check_image(image);
    } catch (const FrameError& error) {
      EXPECT_STRNE(error.what(), "");
      return error.reason();
    }
    return PassThroughReason::NONE;
  };
  EXPECT_EQ(reason_of(sensor_msgs::Image()), PassThroughReason::BAD_IMAGE);
  auto image = *image_message(0);
  EXPECT_EQ(reason_of(image), PassThroughReason::NONE);
  image.data.resize(image.data.size() - 1);
  EXPECT_EQ(reason_of(image), PassThroughReason::BAD_IMAGE);
  image = *image_message(0);
  image.step = kWidth - 1;
  EXPECT_EQ(reason_of(image), PassThroughReason::BAD_IMAGE);
  image = *image_message(0);
  image.width = 0;
  EXPECT_EQ(reason_of(image), PassThroughReason::BAD_IMAGE);
  image.width = std::numeric_limits<std::uint32_t>::max();
  image.height = std::numeric_limits<std::uint32_t>::max();
  EXPECT_EQ(reason_of(image), PassThroughReason::BAD_IMAGE);
  image = *image_message(0, "yuv422", 31, 20);
  EXPECT_EQ(reason_of(image), PassThroughReason::BAD_IMAGE) << "half a pair of pixels";
  image = *image_message(0);
  image.encoding = "yuv422";
  EXPECT_EQ(reason_of(image), PassThroughReason::BAD_IMAGE) << "one byte a pixel";
  for (const char* encoding : {"32FC1", "8UC4", "nv21", "", "nonsense"}) {
    image = *image_message(0);
    image.encoding = encoding;
    EXPECT_EQ(reason_of(image), PassThroughReason::UNSUPPORTED_ENCODING) << encoding;
  }
}

FrameBlur example_field() {
  FrameBlur field = uniform_blur_field(100, 70, 0.5, 12, BlurFieldOptions());
  field.blocks[1].status = BlockStatus::REJECTED;
  field.exposure_ns = kExposure;
  field.readout_ns = -kReadout;
  return field;
}

TEST(BlurField, CarriesEverything) {
  std_msgs::Header header;
  header.frame_id = "camera";
  header.stamp = ros::Time(12, 34);
  FrameBlur field = example_field();
  field.blocks[2].residual = ResidualVelocity{{30, -40}, 5};
  const auto message = to_message(field, header);
  EXPECT_EQ(message->header.stamp, header.stamp);
  EXPECT_EQ(message->header.frame_id, "camera");
  EXPECT_EQ(message->reason, 0);
  EXPECT_EQ(message->image_width, 100u);
  EXPECT_EQ(message->image_height, 70u);
  EXPECT_EQ(message->block_width, 64u);
  EXPECT_EQ(message->cols, 2u);
  EXPECT_EQ(message->rows, 2u);
  ASSERT_EQ(message->status.size(), 4u);
  EXPECT_EQ(message->status[0], BlurField::DEBLURRED);
  EXPECT_EQ(message->status[1], BlurField::REJECTED);
  EXPECT_FLOAT_EQ(message->angle[0], 0.5f);
  EXPECT_FLOAT_EQ(message->extent[3], 12);
  EXPECT_EQ(message->source, (std::vector<std::uint8_t>{BlurField::SOURCE_GYROSCOPE, BlurField::SOURCE_GYROSCOPE,
                                                        BlurField::SOURCE_IMAGES, BlurField::SOURCE_GYROSCOPE}));
  field.images_alone = true;
  EXPECT_EQ(to_message(field, header)->source[2], BlurField::SOURCE_IMAGES_ALONE);
  EXPECT_EQ(message->residual_x, (std::vector<float>{0, 0, 30, 0}));
  EXPECT_EQ(message->residual_y, (std::vector<float>{0, 0, -40, 0}));
  EXPECT_EQ(message->residual_stddev, (std::vector<float>{0, 0, 5, 0}));
  EXPECT_EQ(message->exposure_time.toNSec(), kExposure);
  EXPECT_EQ(message->readout_time.toNSec(), -kReadout);
}

TEST(BlurField, ConstantsEqualTheCores) {
  EXPECT_EQ(BlurField::SHARP, static_cast<int>(BlockStatus::SHARP));
  EXPECT_EQ(BlurField::DEBLURRED, static_cast<int>(BlockStatus::DEBLURRED));
  EXPECT_EQ(BlurField::REJECTED, static_cast<int>(BlockStatus::REJECTED));
  EXPECT_EQ(BlurField::TOO_LARGE, static_cast<int>(BlockStatus::TOO_LARGE));
  EXPECT_EQ(BlurField::NO_GYRO, static_cast<int>(BlockStatus::NO_GYRO));
  EXPECT_EQ(BlurField::TOO_CURVED, static_cast<int>(BlockStatus::TOO_CURVED));
  EXPECT_EQ(BlurField::NOISY, static_cast<int>(BlockStatus::NOISY));
  EXPECT_EQ(BlurField::MASKED, static_cast<int>(BlockStatus::MASKED));
  EXPECT_EQ(BlurField::STATIC_EDGE, static_cast<int>(BlockStatus::STATIC_EDGE));
  const std::pair<int, PassThroughReason> reasons[] = {
      {BlurField::REASON_NONE, PassThroughReason::NONE},
      {BlurField::REASON_NO_GYRO, PassThroughReason::NO_GYRO},
      {BlurField::REASON_NO_EXPOSURE_TIME, PassThroughReason::NO_EXPOSURE_TIME},
      {BlurField::REASON_NO_CALIBRATION, PassThroughReason::NO_CALIBRATION},
      {BlurField::REASON_NO_EXTRINSIC, PassThroughReason::NO_EXTRINSIC},
      {BlurField::REASON_UNSUPPORTED_ENCODING, PassThroughReason::UNSUPPORTED_ENCODING},
      {BlurField::REASON_BAD_IMAGE, PassThroughReason::BAD_IMAGE},
      {BlurField::REASON_BAD_CONFIGURATION, PassThroughReason::BAD_CONFIGURATION},
      {BlurField::REASON_OVERLOAD, PassThroughReason::OVERLOAD},
      {BlurField::REASON_TIME_JUMP, PassThroughReason::TIME_JUMP},
      {BlurField::REASON_INTERNAL_ERROR, PassThroughReason::INTERNAL_ERROR},
      {BlurField::REASON_GYRO_SATURATED, PassThroughReason::GYRO_SATURATED},
      {BlurField::REASON_STEREO_PARTNER, PassThroughReason::STEREO_PARTNER},
      {BlurField::REASON_NO_STAMP, PassThroughReason::NO_STAMP}};
  for (const auto& [constant, reason] : reasons) EXPECT_EQ(constant, static_cast<int>(reason)) << to_string(reason);
}

TEST(KeypointMessage, DescriptorsKeepTheirBytes) {
  PipelineResult result;
  result.reference_ns = 3 * kSecond;
  result.features.keypoints = {cv::KeyPoint(10.5f, 20.25f, 7, 45, 0.5f, 2), cv::KeyPoint(1, 2, 3)};
  result.features.descriptors = (cv::Mat_<float>(2, 3) << 1, 2, 3, 4, 5, 6);
  result.points.resize(2);
  result.points[0].rectified_px = {11, 21};
  result.points[0].normalized = {0.5, -0.25};
  result.points[0].deblurred = result.points[0].rectified = true;
  result.points[1].rectified_px = {1, 2};
  result.points[1].normalized = {0, 0};
  result.covariances_px2.resize(2, Eigen::Matrix2d::Identity());
  result.covariances_px2[0] << 0.5, -0.125, -0.125, 0.25;
  KeypointOptions options;
  const auto message = to_message(result, options, std_msgs::Header());
  EXPECT_EQ(to_time_ns(message->reference_time), 3 * kSecond);
  ASSERT_EQ(message->keypoints.size(), 2u);
  const Keypoint& first = message->keypoints[0];
  EXPECT_EQ(first.x, 10.5f);
  EXPECT_EQ(first.y, 20.25f);
  EXPECT_EQ(first.rectified_x, 11);
  EXPECT_EQ(first.normalized_y, -0.25f);
  EXPECT_EQ(first.octave, 2);
  EXPECT_EQ(first.covariance_xx, 0.5f);
  EXPECT_EQ(first.covariance_xy, -0.125f);
  EXPECT_EQ(first.covariance_yy, 0.25f);
  EXPECT_EQ(message->keypoints[1].covariance_yy, 1.f);
  EXPECT_TRUE(first.rectified);
  EXPECT_FALSE(message->keypoints[1].rectified);
  EXPECT_EQ(message->descriptor_type, KeypointArray::DESCRIPTOR_FLOAT32);
  EXPECT_EQ(message->descriptor_length, 12u);
  ASSERT_EQ(message->descriptors.size(), 24u);
  float last = 0;
  std::memcpy(&last, &message->descriptors[20], 4);
  EXPECT_EQ(last, 6);

  result.features.descriptors = cv::Mat();
  const auto without = to_message(result, options, std_msgs::Header());
  EXPECT_EQ(without->descriptor_type, KeypointArray::DESCRIPTOR_NONE);
  EXPECT_EQ(without->descriptor, "");
}

TEST(Markers, LieOnTheRaysOfTheSegmentsInTheOverlaysColours) {
  const FrameBlur field = example_field();
  CameraCalibration calibration = to_calibration(*camera_info(0, 100, 70), 100, 70, false);
  const Camera camera(calibration);
  const auto array = to_markers(field, camera, std_msgs::Header());
  ASSERT_EQ(array->markers.size(), 1u);
  const visualization_msgs::Marker& marker = array->markers[0];
  EXPECT_EQ(marker.type, visualization_msgs::Marker::LINE_LIST);
  ASSERT_EQ(marker.points.size(), 8u);
  ASSERT_EQ(marker.colors.size(), 8u);
  const BlurSegment segment = blur_segment(field, 2);
  EXPECT_NEAR(marker.points[4].x, (segment.from_px.x() - calibration.cx_px) / kFocalPx, 1e-9);
  EXPECT_NEAR(marker.points[5].y, (segment.to_px.y() - calibration.cy_px) / kFocalPx, 1e-9);
  EXPECT_EQ(marker.points[4].z, 1);
  const cv::Vec3b rejected = status_color_rgb(BlockStatus::REJECTED);
  EXPECT_NEAR(marker.colors[2].r, rejected[0] / 255.0, 1e-6);
  EXPECT_NEAR(marker.colors[3].b, rejected[2] / 255.0, 1e-6);
  FrameBlur with_residual = field;
  with_residual.exposure_ns = 20'000'000;
  with_residual.blocks[2].residual = ResidualVelocity{{500, -250}, 10};
  const auto more = to_markers(with_residual, camera, std_msgs::Header());
  ASSERT_EQ(more->markers.size(), 1u);
  const visualization_msgs::Marker& both = more->markers[0];
  ASSERT_EQ(both.points.size(), 10u);
  ASSERT_EQ(both.colors.size(), 10u);
  const Eigen::Vector2d center_px = field.grid.center(2);
  EXPECT_EQ(both.points[5], marker.points[5]) << "the path is as it was";
  EXPECT_NEAR(both.points[6].x, (center_px.x() - calibration.cx_px) / kFocalPx, 1e-9);
  EXPECT_NEAR(both.points[7].x, (center_px.x() + 10 - calibration.cx_px) / kFocalPx, 1e-9);
  EXPECT_NEAR(both.points[7].y, (center_px.y() - 5 - calibration.cy_px) / kFocalPx, 1e-9);
  EXPECT_NEAR(both.colors[7].r, residual_color_rgb()[0] / 255.0, 1e-6);
  EXPECT_NEAR(both.colors[7].g, residual_color_rgb()[1] / 255.0, 1e-6);
  EXPECT_EQ(both.points[8], marker.points[6]);
  const auto none = no_markers(std_msgs::Header());
  EXPECT_EQ(none->markers[0].ns, marker.ns);
  EXPECT_EQ(none->markers[0].id, marker.id);
  EXPECT_EQ(none->markers[0].action, visualization_msgs::Marker::DELETE);
}

TEST(Extrinsic, TakesImuToCameraCoordinates) {
  Transforms transforms;
  EXPECT_FALSE(transforms.R_cam_imu("camera", "imu"));
  geometry_msgs::TransformStamped transform;  // pose of the camera in the IMU's frame: 90 degrees about z
  transform.header.frame_id = "imu";
  transform.child_frame_id = "camera";
  transform.transform.rotation.z = transform.transform.rotation.w = std::sqrt(0.5);
  transform.transform.translation.x = 3;
  transform.header.stamp = ros::Time(1000);
  tf2_msgs::TFMessage message;
  message.transforms = {transform};
  transforms.add(message, Transforms::Topic::TF);
  const auto R_cam_imu = transforms.R_cam_imu("camera", "imu");
  ASSERT_TRUE(R_cam_imu);
  EXPECT_TRUE((*R_cam_imu * Eigen::Vector3d::UnitY()).isApprox(Eigen::Vector3d::UnitX(), 1e-9));
  EXPECT_FALSE(transforms.R_cam_imu("camera", ""));
  EXPECT_FALSE(transforms.R_cam_imu("camera", "other"));
  EXPECT_TRUE(transforms.R_cam_imu("/camera", "/imu")) << "names of old drivers";
  message.transforms[0].header.stamp = ros::Time(1);  // the clock was set back by more than tf remembers
  message.transforms[0].transform.rotation.z = 0;
  message.transforms[0].transform.rotation.w = 1;
  transforms.add(message, Transforms::Topic::TF);
  EXPECT_TRUE(transforms.R_cam_imu("camera", "imu")->isIdentity(1e-9));
}

TEST(Extrinsic, OfTfStaticIsNotReplacedByTf) {
  // VINS-Mono and VINS-Fusion publish the pose of a frame "camera" in a frame "body".
  Transforms transforms;
  tf2_msgs::TFMessage fixed, of_slam;
  fixed.transforms.resize(1);
  fixed.transforms[0].header.frame_id = "imu";
  fixed.transforms[0].child_frame_id = "camera";
  fixed.transforms[0].transform.rotation.z = fixed.transforms[0].transform.rotation.w = std::sqrt(0.5);
  of_slam.transforms.resize(1);
  of_slam.transforms[0].header.frame_id = "body";
  of_slam.transforms[0].child_frame_id = "camera";
  of_slam.transforms[0].transform.rotation.w = 1;
  transforms.add(fixed, Transforms::Topic::TF_STATIC);
  transforms.add(of_slam, Transforms::Topic::TF);
  const auto R_cam_imu = transforms.R_cam_imu("camera", "imu");
  ASSERT_TRUE(R_cam_imu);
  EXPECT_TRUE((*R_cam_imu * Eigen::Vector3d::UnitY()).isApprox(Eigen::Vector3d::UnitX(), 1e-9));
  EXPECT_TRUE(transforms.R_cam_imu("camera", "body")->isIdentity(1e-9));
}

TEST(Parameters, KeepTheirTypes) {
  XmlRpc::XmlRpcValue values;
  values["noise_to_signal_ratio"] = 0.05;
  values["block_size"] = 32;
  values["drop_poor"] = true;
  values["validation"] = std::string("none");
  values["keypoint_detector"] = std::string("ORB");
  values["keypoint_descriptor"] = std::string("ORB");
  values["gyro_bias"][0] = 0.5;
  values["gyro_bias"][1] = 0;
  values["gyro_bias"][2] = -0.5;
  Config config = parse_config(to_yaml(values));
  EXPECT_EQ(config.pipeline.filter.noise_to_signal_ratio, 0.05);
  EXPECT_EQ(config.pipeline.blur_field.block_size_px, 32);
  EXPECT_TRUE(config.drop_poor);
  EXPECT_EQ(config.pipeline.validation.rule, ValidationRule::NONE);
  EXPECT_EQ(config.pipeline.keypoints.detector, "ORB");
  EXPECT_EQ(config.gyro.bias_rad_s, Eigen::Vector3d(0.5, 0, -0.5));
  values["noise_to_signal_ratio"] = std::string("5e-2");
  EXPECT_EQ(parse_config(to_yaml(values)).pipeline.filter.noise_to_signal_ratio, 0.05);
  values["noise_to_signal_ratio"] = std::string("0.05 px");
  EXPECT_TRUE(has(error_of([&] { parse_config(to_yaml(values)); }), "noise_to_signal_ratio"));
  values["noise_to_signal_ratio"] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(has(error_of([&] { parse_config(to_yaml(values)); }), "noise_to_signal_ratio"));
}

TEST(Parameters, BecomeYamlThatReadsTheSame) {
  XmlRpc::XmlRpcValue values;
  values["engine"] = std::string("opencl:\"a\\b\" #1: {é}\n\t\x01");
  values["calibration_camera"] = std::string("7");
  values["noise_to_signal_ratio"] = 0.1 + 0.2;
  values["namespace of others"]["a"] = std::string("x");
  std::vector<std::string> unknown;
  const Config config = parse_config(to_yaml(values), &unknown);
  EXPECT_EQ(config.pipeline.engine, static_cast<std::string>(values["engine"]));
  EXPECT_EQ(config.calibration_camera, "7");
  EXPECT_EQ(config.pipeline.filter.noise_to_signal_ratio, 0.1 + 0.2);
  EXPECT_EQ(unknown, std::vector<std::string>{"namespace of others"});
  XmlRpc::XmlRpcValue nothing, infinite(-std::numeric_limits<double>::infinity());
  EXPECT_EQ(to_yaml(nothing), "~");
  EXPECT_EQ(to_yaml(infinite), "-.inf");
}

TEST(Parameters, StringsStayStringsInYaml) {
  std::string control;
  for (char c = 1; c < 0x20; ++c) control += c;
  control += '\x7F';
  for (const std::string& text :
       {control, std::string("\"a\" 'b' \\n \\"), std::string("é €  \u0085\u2028😀"), std::string(), std::string("7"),
        std::string("true"), std::string("~"), std::string(" # {[&*!|>%@` "), std::string("\0a", 2)}) {
    XmlRpc::XmlRpcValue value(text);
    const YAML::Node node = YAML::Load(to_yaml(value));
    ASSERT_TRUE(node.IsScalar()) << to_yaml(value);
    EXPECT_EQ(node.Tag(), "!") << to_yaml(value) << " is not quoted";
    EXPECT_EQ(node.Scalar(), text) << to_yaml(value);
  }
  XmlRpc::XmlRpcValue invalid(std::string("a\xFF\xC3(b"));
  EXPECT_EQ(YAML::Load(to_yaml(invalid)).Scalar(), "a\uFFFD\uFFFD(b");
}

// Field by field what VINS-Mono's estimator reads: points (x, y, 1), then by position id, u, v and the velocities. It
// does not read what comes after these.
TEST(ToMessage, TracksHaveTheLayoutOfVinsMono) {
  std::vector<Track> tracks(3);
  tracks[0].id = 16'777'215;  // the largest
  tracks[0].length = 5;
  tracks[0].pixel_px = {100.25, 50.5};
  tracks[0].normalized = {-0.25, 0.125};
  tracks[0].velocity_1_s = {0.5, -1.5};
  tracks[0].covariance_px2 << 0.25, -0.125, -0.125, 1;
  tracks[1].id = 4;  // new: without a velocity yet
  tracks[2].id = 7;
  tracks[2].length = 2;
  tracks[2].normalized = {0.5, 0.75};
  tracks[2].covariance_px2 << 0.5, 0.0625, 0.0625, 2;
  std_msgs::Header header;
  header.stamp = to_ros_time(12 * kSecond + 345);
  header.frame_id = kCameraFrame;
  const sensor_msgs::PointCloudPtr message = to_message(tracks, TrackLayout::VINS_MONO, header);
  EXPECT_EQ(message->header.stamp, header.stamp);
  EXPECT_EQ(message->header.frame_id, kCameraFrame);
  ASSERT_EQ(message->points.size(), 2u);
  const std::vector<std::pair<std::string, std::vector<float>>> expected{{"id_of_point", {16'777'215.f, 7}},
                                                                         {"u_of_point", {100.25f, 0}},
                                                                         {"v_of_point", {50.5f, 0}},
                                                                         {"velocity_x_of_point", {0.5f, 0}},
                                                                         {"velocity_y_of_point", {-1.5f, 0}},
                                                                         {"covariance_uu_of_point", {0.25f, 0.5f}},
                                                                         {"covariance_uv_of_point", {-0.125f, 0.0625f}},
                                                                         {"covariance_vv_of_point", {1, 2}}};
  ASSERT_EQ(message->channels.size(), expected.size());
  for (std::size_t i = 0; i < expected.size(); ++i) {
    EXPECT_EQ(message->channels[i].name, expected[i].first);
    EXPECT_EQ(message->channels[i].values, expected[i].second) << expected[i].first;
  }
  EXPECT_EQ(message->points[0].x, -0.25f);
  EXPECT_EQ(message->points[0].y, 0.125f);
  for (const auto& point : message->points) EXPECT_EQ(point.z, 1.f);  // the estimator asserts it
  // With one camera the estimator takes the id by rounding: v + 0.5 as int.
  EXPECT_EQ(static_cast<int>(message->channels[0].values[0] + 0.5), 16'777'215);
}

// What VINS-Fusion's feature_callback reads by position: id, camera, u, v, velocities, and with more than five channels
// the true place, which it does not use.
TEST(ToMessage, TracksHaveTheLayoutOfVinsFusion) {
  std::vector<Track> tracks(1);
  tracks[0].id = 9;
  tracks[0].length = 3;
  tracks[0].pixel_px = {100.25, 50.5};
  tracks[0].velocity_1_s = {0.5, -1.5};
  tracks[0].covariance_px2 << 0.25, -0.125, -0.125, 1;
  const sensor_msgs::PointCloudPtr message = to_message(tracks, TrackLayout::VINS_FUSION, std_msgs::Header());
  const std::vector<float> expected{9, 0, 100.25f, 50.5f, 0.5f, -1.5f, 0, 0, 0, 0.25f, -0.125f, 1};
  ASSERT_EQ(message->channels.size(), expected.size());
  for (std::size_t i = 0; i < expected.size(); ++i) EXPECT_EQ(message->channels[i].values.at(0), expected[i]) << i;
}

// Names and values of the enumerations are those of the message, so that nodes may cast.
TEST(Names, OfGradesAgreeWithTheMessage) {
  std::ifstream file(GYRO_DEBLUR_SOURCE_DIR "/msg/ImageQuality.msg");
  ASSERT_TRUE(file);
  const std::regex constant(R"(^uint8 ([A-Z_]+)=(\d+).*)");
  int grades = 0;
  for (std::string line; std::getline(file, line);) {
    std::smatch match;
    if (!std::regex_match(line, match, constant)) continue;
    EXPECT_EQ(to_string(static_cast<QualityGrade>(std::stoi(match[2]))), match[1].str());
    ++grades;
  }
  EXPECT_EQ(grades, 5);
}

TEST(Names, AgreeWithTheMessage) {
  std::ifstream file(GYRO_DEBLUR_SOURCE_DIR "/msg/BlurField.msg");
  ASSERT_TRUE(file);
  const std::regex constant(R"(^uint8 (REASON_|SOURCE_)?([A-Z_]+)=(\d+).*)");
  int statuses = 0, reasons = 0, sources = 0;
  for (std::string line; std::getline(file, line);) {
    std::smatch match;
    if (!std::regex_match(line, match, constant)) continue;
    const int value = std::stoi(match[3]);
    if (match[1] == "SOURCE_") {
      ++sources;  // only the message has them
    } else if (match[1].matched) {
      EXPECT_EQ(to_string(static_cast<PassThroughReason>(value)), match[2].str());
      ++reasons;
    } else {
      EXPECT_EQ(to_string(static_cast<BlockStatus>(value)), match[2].str());
      ++statuses;
    }
  }
  EXPECT_EQ(statuses, static_cast<int>(kBlockStatuses.size()));
  EXPECT_EQ(reasons, 14);
  EXPECT_EQ(sources, 3);
}

}  // namespace
}  // namespace gyro_deblur::conversions_test
