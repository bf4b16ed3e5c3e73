#include "gyro_deblur/calibration.hpp"

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>
#include <Eigen/Geometry>
#include <Eigen/LU>

#include "gyro_deblur/config.hpp"

namespace gyro_deblur::calibration_test {
namespace {

const std::string kFolder = GYRO_DEBLUR_SOURCE_DIR "/test/config/calibration/";

/// The camera that every file of the folder describes.
CameraCalibration camera0() {
  CameraCalibration camera;
  camera.width_px = 752;
  camera.height_px = 480;
  camera.fx_px = 458.25;
  camera.fy_px = 457.5;
  camera.cx_px = 367.125;
  camera.cy_px = 248.75;
  camera.model = "plumb_bob";
  camera.coefficients = {-0.28, 0.07, 0.0002, -0.00015};
  return camera;
}

CameraCalibration camera1() {
  CameraCalibration camera = camera0();
  camera.fx_px = 462.5;
  camera.fy_px = 461.75;
  camera.cx_px = 359.5;
  camera.cy_px = 241.25;
  camera.model = "equidistant";
  camera.coefficients = {-0.013, 0.021, -0.0105, 0.00225};
  return camera;
}

Eigen::Isometry3d transform(const Eigen::Vector3d& rotation_rad, const Eigen::Vector3d& translation_m) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = Eigen::AngleAxisd(rotation_rad.norm(), rotation_rad.normalized()).toRotationMatrix();
  T.translation() = translation_m;
  return T;
}

Eigen::Isometry3d T_cam0_imu() { return transform({1.2, -1.1, 1.25}, {0.03, -0.05, 0.01}); }
Eigen::Isometry3d T_cam1_imu() { return transform({0.01, 0.02, -0.005}, {-0.11, 0.001, 0.0005}) * T_cam0_imu(); }

constexpr TimeNs kTimeOffset = -7'310'000;
constexpr double kDigits = 1e-10;  // of the matrices in the files

void expect_same(const SensorCalibration& calibration, const CameraCalibration& camera, const Eigen::Isometry3d& T,
                 const char* name) {
  SCOPED_TRACE(name);
  ASSERT_TRUE(calibration.camera);
  EXPECT_EQ(to_string(*calibration.camera), to_string(camera));
  ASSERT_TRUE(calibration.R_cam_imu);
  EXPECT_LT((*calibration.R_cam_imu - T.linear()).norm(), kDigits);
  ASSERT_TRUE(calibration.p_imu_cam_m);
  EXPECT_LT((*calibration.p_imu_cam_m - T.inverse().translation()).norm(), kDigits);
}

TEST(LoadCalibration, EquivalentFilesGiveTheSameInternalForm) {
  const SensorCalibration kalibr = load_calibration(kFolder + "kalibr.yaml");
  const SensorCalibration euroc = load_calibration(kFolder + "mav0/cam0/sensor.yaml");
  const SensorCalibration euroc_folder = load_calibration(kFolder + "mav0");
  const SensorCalibration vins_mono = load_calibration(kFolder + "vins_mono.yaml");
  const SensorCalibration vins_fusion = load_calibration(kFolder + "vins_fusion.yaml");
  expect_same(kalibr, camera0(), T_cam0_imu(), "Kalibr");
  expect_same(euroc, camera0(), T_cam0_imu(), "EuRoC");
  expect_same(euroc_folder, camera0(), T_cam0_imu(), "EuRoC, folder");
  expect_same(vins_mono, camera0(), T_cam0_imu(), "VINS-Mono");
  expect_same(vins_fusion, camera0(), T_cam0_imu(), "VINS-Fusion");
  EXPECT_EQ(kalibr.time_offset_ns, kTimeOffset);
  EXPECT_EQ(vins_mono.time_offset_ns, kTimeOffset);
  EXPECT_EQ(vins_fusion.time_offset_ns, kTimeOffset);
  EXPECT_FALSE(euroc.time_offset_ns);
  EXPECT_FALSE(kalibr.readout_ns);
  EXPECT_EQ(vins_mono.readout_ns, 21'000'000);
  EXPECT_EQ(euroc.frame_period_ns, 50'000'000);
  EXPECT_EQ(kalibr.origin, kFolder + "kalibr.yaml");

  const SensorCalibration info = load_calibration(kFolder + "camera_info.yaml");
  ASSERT_TRUE(info.camera);
  EXPECT_NO_THROW(require_agreement(*info.camera, "camera_info", camera0(), "truth"));
  EXPECT_FALSE(info.R_cam_imu);
}

/// A camera of the size and centre of camera0().
CameraCalibration fisheye(const std::string& model, double fx_px, double fy_px, std::vector<double> coefficients) {
  CameraCalibration camera = camera0();
  camera.model = model;
  camera.fx_px = fx_px;
  camera.fy_px = fy_px;
  camera.coefficients = std::move(coefficients);
  return camera;
}

TEST(LoadCalibration, ReadsEveryLensModelFromTheFormatsThatHaveIt) {
  const CameraCalibration ds = fisheye("ds", 300.5, 300.25, {-0.17, 0.59});
  const CameraCalibration eucm = fisheye("eucm", 310.5, 310.25, {0.62, 1.1});
  const CameraCalibration mei = fisheye("mei", 1160.5, 1159.25, {2.2, 0.14, 0.91, 0.0012, 0.002});
  const CameraCalibration undistorted = fisheye("mei", 760.5, 759.25, {1.1});
  const CameraCalibration kb4 = fisheye("equidistant", 462.5, 461.75, {-0.013, 0.021, -0.0105, 0.00225});
  const CameraCalibration radtan8 =
      fisheye("rational_polynomial", 458.25, 457.5, {0.6, -0.2, 0.0005, -0.0004, 0.01, 0.85, -0.12, -0.01});
  const std::tuple<const char*, const char*, CameraCalibration> kFiles[] = {
      {"kalibr_fisheye.yaml", "cam0", ds},  {"kalibr_fisheye.yaml", "cam1", eucm},
      {"kalibr_fisheye.yaml", "cam2", mei}, {"kalibr_fisheye.yaml", "cam3", undistorted},
      {"basalt.json", "cam0", ds},          {"basalt.json", "cam1", eucm},
      {"basalt.json", "cam2", kb4},         {"basalt.json", "cam3", fisheye("none", 458.25, 457.5, {})},
      {"basalt.json", "cam4", radtan8},
  };
  for (const auto& [file, name, camera] : kFiles) {
    SCOPED_TRACE(name);
    const SensorCalibration calibration = load_calibration(kFolder + file, name);
    expect_same(calibration, camera, T_cam0_imu(), file);
    EXPECT_EQ(calibration.time_offset_ns, kTimeOffset);
    EXPECT_EQ(calibration.notes, std::vector<std::string>());
  }
  EXPECT_EQ(to_string(*load_calibration(kFolder + "vins_mei.yaml").camera), to_string(mei));
  expect_same(load_calibration(kFolder + "openvins.yaml"), camera0(), T_cam0_imu(), "OpenVINS");
}

TEST(LoadCalibration, TakesTheCameraThatIsNamed) {
  expect_same(load_calibration(kFolder + "kalibr.yaml", "cam1"), camera1(), T_cam1_imu(), "Kalibr");
  expect_same(load_calibration(kFolder + "vins_fusion.yaml", "cam1"), camera1(), T_cam1_imu(), "VINS-Fusion");
}

/// A copy of a calibration file with one text replaced.
class Edited {
 public:
  Edited(const std::string& file, const std::string& from, const std::string& to) {
    std::ifstream in(kFolder + file);
    std::stringstream text;
    text << in.rdbuf();
    std::string content = text.str();
    const std::size_t position = content.find(from);
    EXPECT_NE(position, std::string::npos) << file << " has no " << from;
    if (position != std::string::npos) content.replace(position, from.size(), to);
    // Files that it names stay where they are.
    for (std::size_t at = 0; (at = content.find("\"vins_cam", at)) != std::string::npos;) {
      content.insert(at + 1, kFolder);
      at += kFolder.size();
    }
    path_ = testing::TempDir() + "gyro_deblur_edited_" + testing::UnitTest::GetInstance()->current_test_info()->name() +
            ".yaml";
    std::ofstream(path_) << content;
  }
  ~Edited() { std::remove(path_.c_str()); }
  Edited(const Edited&) = delete;
  Edited& operator=(const Edited&) = delete;

  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

std::string error_of(const std::string& path, const std::string& camera = "cam0") {
  try {
    load_calibration(path, camera);
  } catch (const OptionError& error) {
    return error.what();
  }
  return "accepted";
}

/// The error of a file with one text replaced; begins with file and key.
void expect_refused(const std::string& file, const std::string& from, const std::string& to,
                    const std::string& message) {
  const Edited edited(file, from, to);
  EXPECT_EQ(error_of(edited.path()).rfind(edited.path() + ": " + message, 0), 0u)
      << "expected " << message << "\ngot " << error_of(edited.path());
}

TEST(LoadCalibration, RefusesMissingKeysByName) {
  for (const char* key : {"camera_model", "distortion_model", "distortion_coeffs", "intrinsics", "resolution"}) {
    expect_refused("kalibr.yaml", std::string("  ") + key, std::string("  no_") + key,
                   std::string("cam0.") + key + " is missing");
  }
  for (const char* key : {"resolution", "intrinsics", "distortion_model", "distortion_coefficients", "T_BS"}) {
    expect_refused("mav0/cam0/sensor.yaml", std::string("\n") + key, std::string("\nno_") + key,
                   std::string(key) + " is missing");
  }
  for (const char* key : {"image_width", "image_height", "distortion_parameters", "projection_parameters"}) {
    expect_refused("vins_mono.yaml", std::string("\n") + key, std::string("\nno_") + key,
                   std::string(key) + " is missing");
  }
  expect_refused("vins_mono.yaml", "   fx:", "   f:", "projection_parameters.fx is missing");
  expect_refused("vins_mono.yaml", "extrinsicRotation", "extrinsic", "body_T_cam0 is missing");
  expect_refused("vins_mono.yaml", "rolling_shutter_tr", "tr", "rolling_shutter_tr is missing");
  expect_refused("camera_info.yaml", "distortion_coefficients", "coefficients", "distortion_coefficients is missing");
}

TEST(LoadCalibration, RefusesWhatIsNoRotation) {
  // The first row of the matrix is negated: det -1.
  const Eigen::Matrix4d T = T_cam0_imu().matrix();
  const auto row = [](const Eigen::RowVector4d& values) {
    char text[200];
    std::snprintf(text, sizeof(text), "- [%.12g, %.12g, %.12g, %.12g]", values[0], values[1], values[2], values[3]);
    return std::string(text);
  };
  expect_refused("kalibr.yaml", row(T.row(0)), row(-T.row(0)), "cam0.T_cam_imu has determinant -1: it mirrors");
  expect_refused("kalibr.yaml", row(T.row(0)), row(2 * T.row(0)), "cam0.T_cam_imu has determinant 2 and is not ortho");
  expect_refused("kalibr.yaml", row(T.row(0)), "- [.nan, 0, 0, 0]", "cam0.T_cam_imu = .nan is not a matrix of 4x4");
  expect_refused("kalibr.yaml", row(T.row(0)), "- [1, 0, 0]", "cam0.T_cam_imu = [[1, 0, 0], ");
  expect_refused("kalibr.yaml", row(T.row(3)), "- [0, 0, 1, 1]", "cam0.T_cam_imu = ");
  const Eigen::Matrix4d body_T_cam = T_cam0_imu().inverse().matrix();
  const auto number = [](double value) {
    char text[40];
    std::snprintf(text, sizeof(text), "%.12g", value);
    return std::string(text);
  };
  expect_refused("vins_fusion.yaml", number(body_T_cam(0, 0)), number(-body_T_cam(0, 0)), "body_T_cam0 has determ");
  expect_refused("vins_mono.yaml", "rows: 3", "rows: 4", "extrinsicRotation = ");
  expect_refused("mav0/cam0/sensor.yaml", "rows: 4", "rows: 3", "T_BS = ");
}

TEST(LoadCalibration, RefusesNumbersThatCannotBe) {
  expect_refused("kalibr.yaml", "timeshift_cam_imu: -0.00731", "timeshift_cam_imu: .nan",
                 "cam0.timeshift_cam_imu = .nan is not a finite number of seconds");
  expect_refused("kalibr.yaml", "intrinsics: [458.25", "intrinsics: [.inf", "cam0.intrinsics = .inf is not");
  expect_refused("kalibr.yaml", "intrinsics: [458.25", "intrinsics: [0", "cam0.camera fx = 0 is outside");
  expect_refused(
      "kalibr.yaml", "[-0.28, 0.07,", "[-0.28, 0, 0, 0.07,",
      "cam0.camera distortion has 6 coefficients, but plumb_bob has 5: number 6 is -0.00015, where only zeros");
  expect_refused("kalibr.yaml", "[752, 480]", "[752.5, 480]", "cam0.resolution = [752.5, 480] is not whole pixels");
  expect_refused("kalibr.yaml", "[752, 480]", "[0, 480]", "cam0.camera width = 0 is outside");
  expect_refused("mav0/cam0/sensor.yaml", "rate_hz: 20", "rate_hz: 0", "rate_hz = 0 is outside");
  expect_refused("vins_mono.yaml", "td: -0.00731", "td: soon", "td = soon is not a finite number of seconds");
}

TEST(LoadCalibration, RefusesModelsWithoutEquivalentByName) {
  expect_refused("kalibr.yaml", "radtan", "fov", "cam0.distortion_model = fov is not supported");
  expect_refused("kalibr.yaml", "pinhole", "ucm",
                 "cam0.camera_model = ucm is not supported; supported are pinhole, ds, eucm and omni");
  expect_refused("kalibr.yaml", "pinhole", "ds",
                 "cam0.distortion_model = radtan is not supported; with camera_model ds supported are none");
  expect_refused("kalibr.yaml", "pinhole", "omni",
                 "cam0.intrinsics = [458.25, 457.5, 367.125, 248.75] is not a list of 5 numbers");
  expect_refused("mav0/cam0/sensor.yaml", "radial-tangential", "fov", "distortion_model = fov is not supported");
  expect_refused("vins_mono.yaml", "PINHOLE", "SCARAMUZZA",
                 "model_type = SCARAMUZZA is not supported; supported are PINHOLE, KANNALA_BRANDT and MEI");
  expect_refused(
      "basalt.json", "\"ds\"", "\"ucm\"",
      "value0.intrinsics[0].camera_type = ucm is not supported; supported are pinhole-radtan8, kb4, ds, eucm");
  expect_refused("camera_info.yaml", "plumb_bob", "ds",
                 "distortion_model = \"ds\" has no coefficients in a camera_info");
  expect_refused("camera_info.yaml", "plumb_bob", "fov", "distortion_model = \"fov\" is not one of plumb_bob");
}

TEST(LoadCalibration, RefusesShapesAndPosesThatAreNone) {
  expect_refused("kalibr_fisheye.yaml", "[-0.17, 0.59,", "[-1.7, 0.59,",
                 "cam0.camera distortion coefficient 1 (xi of ds) = -1.7 is outside [-1, 1]");
  expect_refused("basalt.json", "\"alpha\": 0.59", "\"alpha\": 5.9",
                 "value0.intrinsics[0].camera distortion coefficient 2 (alpha of ds) = 5.9 is outside [0, 1]");
  expect_refused("basalt.json", "\"xi\"", "\"x\"", "value0.intrinsics[0].intrinsics.xi is missing");
  expect_refused("basalt.json", "\"qw\": ", "\"qw\": 1", "value0.T_imu_cam[0].qx, qy, qz, qw have the norm");
  EXPECT_NE(error_of(kFolder + "basalt.json", "cam5").find("value0.intrinsics[5] is missing; the list has 5 elements"),
            std::string::npos);
  expect_refused("vins_mei.yaml", "xi:", "x:", "mirror_parameters.xi is missing");
  // Both keys of OpenVINS and Kalibr, that are no inverses of each other.
  const Edited both("kalibr.yaml", "  cam_overlaps: [1]",
                    "  T_imu_cam: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]");
  EXPECT_NE(error_of(both.path()).find("cam0.T_imu_cam (they differ by"), std::string::npos) << error_of(both.path());
}

// Basalt calibrates the cameras first, and writes the identity for what it does not know yet.
TEST(LoadCalibration, DoesNotTakeBasaltsIdentityForARotation) {
  YAML::Node root = YAML::LoadFile(kFolder + "basalt.json");
  YAML::Node pose = root["value0"]["T_imu_cam"][0];
  for (const char* key : {"px", "py", "pz", "qx", "qy", "qz"}) pose[key] = 0;
  pose["qw"] = 1;
  const std::string path = testing::TempDir() + "gyro_deblur_identity.json";
  std::ofstream(path) << root;
  const SensorCalibration calibration = load_calibration(path);
  EXPECT_FALSE(calibration.R_cam_imu);
  ASSERT_EQ(calibration.notes.size(), 1u);
  EXPECT_EQ(calibration.notes[0].rfind(path + ": value0.T_imu_cam[0] is the identity", 0), 0u) << calibration.notes[0];
  std::remove(path.c_str());
}

TEST(LoadCalibration, NamesKeysThatAreNotKnownOnce) {
  for (const char* file : {"kalibr.yaml", "kalibr_fisheye.yaml", "openvins.yaml", "mav0/cam0/sensor.yaml",
                           "vins_mono.yaml", "vins_fusion.yaml", "vins_mei.yaml", "basalt.json", "camera_info.yaml"}) {
    EXPECT_EQ(load_calibration(kFolder + file).notes, std::vector<std::string>()) << file;
  }
  const auto notes_of = [](const std::string& file, const std::string& from, const std::string& to) {
    const Edited edited(file, from, to);
    std::string text;
    for (std::string note : load_calibration(edited.path()).notes) {
      EXPECT_EQ(note.rfind(edited.path() + ": ", 0), 0u) << note;
      text += note.substr(edited.path().size() + 2) + "|";
    }
    return text;
  };
  const std::string advice = "ignored: doc/guides/calibration.md lists the keys that are read|";
  EXPECT_EQ(notes_of("kalibr.yaml", "  T_cam_imu", "  line_delay: 1\n  T_camera_imu"),
            "cam0.line_delay and cam0.T_camera_imu are not known and " + advice);
  EXPECT_EQ(notes_of("vins_mono.yaml", "\ntd:", "\ntime_delay:"), "time_delay is not known and " + advice);
  EXPECT_EQ(notes_of("vins_mono.yaml", "   k1:", "   k3: 0.1\n   k1:"),
            "distortion_parameters.k3 is not known and " + advice);
  EXPECT_EQ(notes_of("basalt.json", "\"xi\"", "\"k1\": 0.1, \"xi\""),
            "value0.intrinsics[0].intrinsics.k1 is not known and " + advice);
  EXPECT_EQ(notes_of("camera_info.yaml", "camera_name", "name"), "name is not known and " + advice);
  EXPECT_EQ(notes_of("kalibr.yaml", "[-0.28, 0.07,", "[-0.28,"),
            "cam0.distortion_coeffs has 3 of 4 coefficients: the last ones are taken as 0|");
  const Edited edited("kalibr.yaml", "cam_overlaps", "overlaps");
  const Config config = parse_config("calibration_file: [" + edited.path() + ", " + kFolder + "camera_info.yaml]");
  ASSERT_EQ(config.calibration->notes.size(), 1u) << "the sources' notes are kept";
  EXPECT_NE(config.calibration->notes[0].find("cam0.overlaps is not known"), std::string::npos);
}

TEST(LoadCalibration, TakesZerosThatAreMissingOrTooMany) {
  const auto camera_of = [](const std::string& file, const std::string& from, const std::string& to) {
    const Edited edited(file, from, to);
    return *load_calibration(edited.path()).camera;
  };
  const std::string data = "data: [-0.28, 0.07, 0.0002, -0.00015, 0]";
  for (const char* same : {"data: [-0.28, 0.07, 0.0002, -0.00015]",
                           "data: [-0.28, 0.07, 0.0002, -0.00015, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]"}) {
    EXPECT_NO_THROW(require_agreement(camera_of("camera_info.yaml", data, same), same, camera0(), "truth"));
  }
  EXPECT_NO_THROW(require_agreement(camera_of("kalibr.yaml", "-0.00015]", "-0.00015, 0]"), "5", camera0(), "truth"));
  expect_refused(
      "camera_info.yaml", data, "data: [-0.28, 0.07, 0.0002, -0.00015, 0, 0.1]",
      "camera distortion has 6 coefficients, but plumb_bob has 5: number 6 is 0.1, where only zeros are allowed");
}

TEST(LoadCalibration, NamesTheFileThatCannotBeUsed) {
  EXPECT_EQ(error_of("/nonexistent.yaml"), "/nonexistent.yaml: cannot be opened: no such file, or no right to read it");
  EXPECT_NE(error_of(kFolder + "vins_cam1.yaml", "left").find("\"left\" is not one of cam0"), std::string::npos);
  EXPECT_NE(error_of(kFolder + "kalibr.yaml", "cam2").find("cam2 is missing; the file has cam0 cam1"),
            std::string::npos);
  EXPECT_NE(error_of(kFolder + "mav0/imu0/sensor.yaml").find("sensor_type = imu is not camera"), std::string::npos);
  const Edited other("kalibr.yaml", "cam0:", "left:");
  EXPECT_EQ(error_of(other.path(), "cam1"), "accepted") << "one camera is enough";
  expect_refused("vins_cam0.yaml", "model_type: PINHOLE", "model_type: [", "");
  const Edited unknown("camera_info.yaml", "camera_matrix", "matrix");
  EXPECT_NE(error_of(unknown.path()).find("is none of Kalibr's camchain"), std::string::npos);
}

TEST(LoadCalibration, SuspectsAReadoutLongerThanTheFramePeriod) {
  expect_refused("vins_mono.yaml", "rolling_shutter_tr: 0.021", "rolling_shutter_tr: soon",
                 "rolling_shutter_tr = soon");
  const SensorCalibration euroc = load_calibration(kFolder + "mav0");
  SensorCalibration readout;
  readout.origin = "data sheet";
  readout.readout_ns = 21'000'000;
  EXPECT_NO_THROW(merge_calibrations({euroc, readout}));
  readout.readout_ns = 210'000'000;
  try {
    merge_calibrations({euroc, readout});
    ADD_FAILURE() << "accepted";
  } catch (const OptionError& error) {
    EXPECT_STREQ(error.what(),
                 "data sheet: readout = 0.21 s is longer than the frame period 0.05 s: is its unit right?");
  }
}

TEST(MergeCalibrations, TakesFromEachWhatTheOtherLacks) {
  const SensorCalibration merged = merge_calibrations(
      {load_calibration(kFolder + "mav0"), load_calibration(kFolder + "kalibr.yaml"),
       load_calibration(kFolder + "camera_info.yaml"), load_calibration(kFolder + "vins_mono.yaml")});
  expect_same(merged, camera0(), T_cam0_imu(), "merged");
  EXPECT_EQ(merged.time_offset_ns, kTimeOffset);
  EXPECT_EQ(merged.readout_ns, 21'000'000);
  EXPECT_EQ(merged.frame_period_ns, 50'000'000);
}

std::string conflict_of(const SensorCalibration& a, const SensorCalibration& b) {
  try {
    merge_calibrations({a, b});
  } catch (const OptionError& error) {
    return error.what();
  }
  return "accepted";
}

TEST(MergeCalibrations, PrintsBothValuesOfAConflict) {
  const SensorCalibration a = load_calibration(kFolder + "kalibr.yaml");
  const auto has = [](const std::string& text, const std::string& part) {
    return text.find(part) != std::string::npos;
  };
  {
    SensorCalibration b = a;
    b.origin = "b.yaml";
    EXPECT_EQ(conflict_of(a, b), "accepted");
    b.time_offset_ns = 7'310'000;
    const std::string text = conflict_of(a, b);
    EXPECT_TRUE(has(text, "time_offset is -0.007310 s in " + a.origin + ", but 0.007310 s in b.yaml")) << text;
  }
  {
    SensorCalibration b = a;
    b.origin = "b.yaml";
    b.R_cam_imu = a.R_cam_imu->transpose();
    const std::string text = conflict_of(a, b);
    EXPECT_TRUE(has(text, "R_cam_imu is " + to_string(*a.R_cam_imu))) << text;
    EXPECT_TRUE(has(text, "but " + to_string(*b.R_cam_imu) + " in b.yaml")) << text;
    b.R_cam_imu = *a.R_cam_imu * Eigen::AngleAxisd(0.05 * M_PI / 180, Eigen::Vector3d::UnitX()).toRotationMatrix();
    EXPECT_EQ(conflict_of(a, b), "accepted") << "0.05 degrees are rounding";
  }
  {
    SensorCalibration b = a;
    b.origin = "b.yaml";
    b.camera->fx_px += 1;
    const std::string text = conflict_of(a, b);
    EXPECT_TRUE(has(text, "fx 458.25,")) << text;
    EXPECT_TRUE(has(text, "fx 459.25,")) << text;
    b.camera->fx_px = a.camera->fx_px + 1e-4;
    EXPECT_EQ(conflict_of(a, b), "accepted");
    b.camera->width_px = 640;
    EXPECT_TRUE(has(conflict_of(a, b), "640x480"));
  }
  EXPECT_TRUE(has(conflict_of(a, load_calibration(kFolder + "kalibr.yaml", "cam1")), "equidistant"));
}

TEST(CalibrationFileInTheConfiguration, FillsWhatNoKeySays) {
  const auto parse = [](const std::string& yaml) { return parse_config(yaml); };
  const auto error = [&parse](const std::string& yaml) -> std::string {
    try {
      parse(yaml);
    } catch (const OptionError& e) {
      return e.what();
    }
    return "accepted";
  };
  const std::string file = "calibration_file: " + kFolder + "vins_mono.yaml\n";
  const Config config = parse(file);
  ASSERT_TRUE(config.calibration);
  EXPECT_LT((*config.R_cam_imu - T_cam0_imu().linear()).norm(), kDigits);
  EXPECT_EQ(config.gyro.time_offset_ns, kTimeOffset);
  EXPECT_EQ(config.shutter.readout_ns, 21'000'000);
  EXPECT_TRUE(config.given.time_offset && config.given.readout_time);
  EXPECT_FALSE(config.given.gyro_bias) << "no file has it";
  EXPECT_EQ(error(file + "time_offset: -0.00731"), "accepted");
  EXPECT_EQ(error(file + "time_offset: 0.0\nreadout_time: 0.0\nR_cam_imu: []"), "accepted") << "defaults say nothing";
  EXPECT_EQ(error(file + "time_offset: -0.0075"),
            "time_offset is -0.007500 s in the parameter, but -0.007310 s in " + kFolder +
                "vins_mono.yaml (they differ by 0.000190 s, allowed is 0.000001 s)");
  EXPECT_EQ(error(file + "readout_time: 0.02").rfind("readout_time is 0.020000 s in the parameter", 0), 0u);
  EXPECT_EQ(error(file + "R_cam_imu: [1, 0, 0, 0, 1, 0, 0, 0, 1]").rfind("R_cam_imu is [1, 0, 0", 0), 0u);
  const Config keys_hold = parse(file +
                                 "time_offset: -0.0075\nR_cam_imu: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
                                 "on_calibration_conflict: configured");
  EXPECT_EQ(keys_hold.gyro.time_offset_ns, -7'500'000);
  EXPECT_EQ(*keys_hold.R_cam_imu, Eigen::Matrix3d(Eigen::Matrix3d::Identity()));
  EXPECT_EQ(keys_hold.shutter.readout_ns, 21'000'000) << "no key says it";
  EXPECT_EQ(error("calibration_file: [" + kFolder + "kalibr.yaml, " + kFolder + "mav0]"), "accepted");
  EXPECT_NE(error("calibration_file: [" + kFolder + "mav0]\nreadout_time: 0.5").find("longer than the frame period"),
            std::string::npos);
  const Config second = parse("calibration_file: " + kFolder + "kalibr.yaml\ncalibration_camera: cam1");
  EXPECT_EQ(second.calibration->camera, camera1());
}

TEST(CalibrationFileInTheConfiguration, IsRelativeToIt) {
  const std::string path = testing::TempDir() + "gyro_deblur_relative.yaml";
  const std::string relative = std::filesystem::relative(kFolder + "kalibr.yaml", testing::TempDir()).string();
  std::ofstream(path) << "calibration_file: " << relative << "\n";
  EXPECT_EQ(load_config(path).gyro.time_offset_ns, kTimeOffset);
  std::remove(path.c_str());
}

}  // namespace
}  // namespace gyro_deblur::calibration_test
