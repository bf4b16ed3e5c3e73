#!/usr/bin/python3
"""make_bag on small folders made here: every format, and input that cannot be used."""
import gzip
import json
import os
import subprocess
import sys
import tempfile
import unittest

import cv2
import numpy as np
import rosbag

MAKE_BAG = None  # path of the tool, from the command line

CAMERA = """
camera: {width: 64, height: 48, fx: 50, fy: 51, cx: 31.5, cy: 23.5, distortion: [], distortion_model: plumb_bob}
R_cam_imu: [0, -1, 0, -1, 0, 0, 0, 0, -1]
time_offset: -0.25
readout_time: 0.01
"""
FRAMES = CAMERA + r"""
images: {folder: pictures, pattern: 'shot(\d+)\.png'}
frame_stamps: {file: stamps.txt, column: 1, unit: 0.001}
exposures: {file: log.txt.gz, pattern: 'frame (\d+) took ([0-9.]+) ms', unit: 0.001}
gyro: {file: gyro.csv, time_column: 1, x_column: 2, y_column: 3, z_column: 4, time_unit: 1.0, rate_unit: 0.0174532925199433}
"""
# Columns of one file for each image, rows of several sensors in another.
COLUMNS = CAMERA + r"""
images: {folder: images, pattern: '(\d+)\.png'}
frame_stamps: {file: images/images.txt, column: 1, unit: 1.0e-9}
exposures: {file: images/images.txt, column: 2, unit: 1.0e-6}
gyro: {file: imu/imu.txt, kind_column: 1, kind: 4, time_column: 2, x_column: 3, y_column: 4, z_column: 5,
       time_unit: 1.0e-9, rate_unit: 1.0}
accelerometer: {file: imu/imu.txt, kind_column: 1, kind: 1, time_column: 2, x_column: 3, y_column: 4, z_column: 5,
                time_unit: 1.0e-9, acceleration_unit: 2.0}
"""


def picture(seed, shape=(48, 64)):
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


class MakeBag(unittest.TestCase):
    def setUp(self):
        self._folder = tempfile.TemporaryDirectory()
        self.root = self._folder.name
        self.addCleanup(self._folder.cleanup)

    def path(self, *parts):
        return os.path.join(self.root, *parts)

    def write(self, name, text):
        os.makedirs(os.path.dirname(self.path(name)), exist_ok=True)
        with open(self.path(name), "w", encoding="utf-8") as file:
            file.write(text)

    def image(self, name, pixels):
        os.makedirs(os.path.dirname(self.path(name)), exist_ok=True)
        cv2.imwrite(self.path(name), pixels)

    def run_tool(self, *arguments):
        return subprocess.run([MAKE_BAG, self.path("out.bag"), self.path("in")] + list(arguments),
                              stdout=subprocess.PIPE, stderr=subprocess.PIPE, universal_newlines=True)

    def messages(self, topic):
        with rosbag.Bag(self.path("out.bag")) as bag:
            return [(m, t) for _, m, t in bag.read_messages(topics=[topic])]

    def assert_fails(self, expected, *arguments):
        result = self.run_tool("--quiet", *arguments)
        self.assertEqual(result.returncode, 1, result.stderr)
        self.assertIn(expected, result.stderr)
        self.assertEqual(result.stderr.count("\n"), 1, result.stderr)
        self.assertEqual([f for f in os.listdir(self.root) if f.startswith("out.bag")], [])

    def make_frames(self):
        self.write("description.yaml", FRAMES)
        self.write("in/stamps.txt", "".join("%d\n" % (5000 + 100 * i) for i in range(1, 13)))
        for number in (2, 10, 11):
            self.image("in/pictures/shot%d.png" % number, picture(number))
        self.image("in/pictures/notes.png", picture(0))
        self.write("in/gyro.csv", "# t, x, y, z\n" + "".join("%.2f,1,2,%d\n" % (4.5 + 0.01 * i, i) for i in range(200)))
        with gzip.open(self.path("in/log.txt.gz"), "wt") as file:
            file.write("noise\nframe 2 took 4.5 ms\nframe 10 took 20 ms\n")

    def frames(self, *arguments):
        return self.run_tool("--format", "frames", "--description", self.path("description.yaml"), *arguments)

    def test_frames(self):
        self.make_frames()
        result = self.frames("--json", self.path("report.json"))
        self.assertEqual(result.returncode, 0, result.stderr)
        images = self.messages("/camera/image_raw")
        # By number, not by name: 2 comes before 10. Line i is the stamp of image i.
        self.assertEqual([m.header.stamp.to_nsec() for m, _ in images],
                         [5200 * 10**6, 6000 * 10**6, 6100 * 10**6])
        for (message, _), number in zip(images, (2, 10, 11)):
            self.assertEqual(message.encoding, "mono8")
            self.assertEqual(message.data, picture(number).tobytes())
            self.assertEqual(message.header.frame_id, "camera")
        # Image 11 has no exposure in the log, and none is invented.
        exposures = self.messages("/camera/exposure")
        self.assertEqual([(m.header.stamp.to_nsec(), m.exposure_time.to_nsec(), m.readout_time.to_nsec())
                          for m, _ in exposures],
                         [(5200 * 10**6, 4500000, 10000000), (6000 * 10**6, 20000000, 10000000)])
        # Delivered after exposure and readout, in the IMU clock.
        self.assertEqual(images[1][1].to_nsec(), 6000 * 10**6 + 20 * 10**6 + 10 * 10**6 - 250 * 10**6)
        imu = self.messages("/imu")
        self.assertEqual(len(imu), 200)
        self.assertEqual(imu[7][0].header.stamp.to_nsec(), 4570000000)
        self.assertEqual(imu[7][1].to_nsec(), 4570000000)
        rate = imu[7][0].angular_velocity
        self.assertAlmostEqual(rate.x, np.deg2rad(1), 12)
        self.assertAlmostEqual(rate.z, np.deg2rad(7), 12)
        self.assertEqual(imu[7][0].linear_acceleration_covariance[0], -1)
        with open(self.path("report.json"), encoding="utf-8") as file:
            report = json.load(file)
        self.assertEqual((report["images"], report["imu_samples"], report["exposures"]), (3, 200, 2))

    def test_calibration_and_extrinsic(self):
        self.make_frames()
        self.assertEqual(self.frames("--camera-namespace", "/cam", "--imu-frame", "body").returncode, 0)
        info = self.messages("/cam/camera_info")[0][0]
        self.assertEqual((info.width, info.height), (64, 48))
        self.assertEqual(list(info.K), [50, 0, 31.5, 0, 51, 23.5, 0, 0, 1])
        self.assertEqual(info.distortion_model, "plumb_bob")
        transform = self.messages("/tf_static")[0][0].transforms[0]
        self.assertEqual((transform.header.frame_id, transform.child_frame_id), ("body", "camera"))
        q = transform.transform.rotation
        # tf takes camera to IMU coordinates: the camera's x axis is minus the IMU's y axis.
        x_axis = [1 - 2 * (q.y**2 + q.z**2), 2 * (q.x * q.y + q.w * q.z), 2 * (q.x * q.z - q.w * q.y)]
        np.testing.assert_allclose(x_axis, [0, -1, 0], atol=1e-9)

    def test_encodings(self):
        self.make_frames()
        for number in (2, 10, 11):
            self.image("in/pictures/shot%d.png" % number, picture(number, (48, 64, 3)))
        self.assertEqual(self.frames().returncode, 0)
        message = self.messages("/camera/image_raw")[0][0]
        self.assertEqual((message.encoding, message.step), ("bgr8", 192))
        self.assertEqual(message.data, picture(2, (48, 64, 3)).tobytes())
        self.assertEqual(self.frames("--encoding", "mono8").returncode, 0)
        self.assertEqual(self.messages("/camera/image_raw")[0][0].encoding, "mono8")

    def make_columns(self):
        self.write("description.yaml", COLUMNS)
        self.write("in/images/images.txt", "1403715273262142977 20000\n1403715273295474977,10000\n")
        self.image("in/images/0001.png", picture(1))
        self.image("in/images/0002.png", picture(2))
        self.write("in/imu/imu.txt", "2 1403715273262142970 1 2 3\n1 1403715273262142979 7 8 9\n"
                                     "4 1403715273262142979 -3 -4 -5\n4 1403715273272142979 -6 -7 -8\n")

    def test_columns_and_kinds(self):
        self.make_columns()
        result = self.frames()
        self.assertEqual(result.returncode, 0, result.stderr)
        # 19 digits do not fit a double: times must be exact.
        self.assertEqual([m.header.stamp.to_nsec() for m, _ in self.messages("/camera/image_raw")],
                         [1403715273262142977, 1403715273295474977])
        self.assertEqual([m.data for m, _ in self.messages("/camera/image_raw")],
                         [picture(1).tobytes(), picture(2).tobytes()])
        self.assertEqual([m.exposure_time.to_nsec() for m, _ in self.messages("/camera/exposure")],
                         [20000000, 10000000])
        imu = [m for m, _ in self.messages("/imu")]
        self.assertEqual([m.header.stamp.to_nsec() for m in imu], [1403715273262142979, 1403715273272142979])
        self.assertEqual((imu[0].angular_velocity.y, imu[0].linear_acceleration.y), (-4, 16))
        self.assertEqual(imu[1].linear_acceleration_covariance[0], -1)

    def test_bad_columns_and_kinds(self):
        frames = ("--format", "frames", "--description", self.path("description.yaml"))
        for before, after, expected in (
                ("kind: 4", "kind: 5", "imu.txt: no row is of the kind '5'; column 1 has 1, 2, 4"),
                ("kind: 4, ", "", "description.yaml: gyro.kind is missing"),
                ("kind_column: 1, kind: 4", "kind: 4", "description.yaml: gyro.kind_column is missing"),
                ("kind_column: 1, kind: 4", "kind_column: 6, kind: 4", "imu.txt:1: has 5 columns, column 6 is needed"),
                ("kind_column: 1, kind: 4", "kind_column: 0, kind: 4",
                 "description.yaml: gyro.kind_column = 0 is outside [1, 100]"),
                ("kind: 4, time_column: 2", "kind: 4, time_column: t",
                 "description.yaml: gyro.time_column = t is not an integer"),
                ("column: 2, unit", "column: 3, unit", "images.txt:1: has 2 columns, column 3 is needed"),
                ("column: 2, unit", "column: -1, unit", "description.yaml: exposures.column = -1 is outside [1, 100]"),
                ("column: 2, unit", "unit", "exposures.column is missing, and so is pattern: give one of the two"),
                ("column: 2, unit", "column: 2, pattern: x, unit",
                 "exposures.column excludes pattern: give one of the two"),
                (", acceleration_unit: 2.0", "", "description.yaml: accelerometer.acceleration_unit is missing"),
                ("kind: 1", "kind: 2", "description.yaml: accelerometer: no sample has the time of a gyroscope"),
                ("frame_stamps: {file: images/images.txt", "frame_stamps: {file: none.txt",
                 "in/none.txt: cannot be opened"),
                ("gyro: {file: imu/imu.txt", "gyro: {file: imu/none.txt", "imu/none.txt: cannot be opened"),
                ("folder: images", "folder: none", "in/none: no such folder"),
                ("readout_time:", "readout: 0.02\nreadout_time:",
                 "description.yaml: unknown keys: readout; config/recordings/ has an example"),
                ("gyro: {", "gyro: {bias: 1, ", "description.yaml: unknown keys: gyro.bias; "),
                ("accelerometer: {", "accelerometer: {offset: 1, ", "unknown keys: accelerometer.offset; "),
                ("frame_stamps: {", "frame_stamps: {offset: 1, ", "unknown keys: frame_stamps.offset; "),
                ("folder: images", "folder: images, first: 1", "unknown keys: images.first; "),
                ("camera: {", "camera: {shutter: rolling, ", "unknown keys: camera.shutter; ")):
            with self.subTest(after=after):
                self.make_columns()
                self.assertEqual(COLUMNS.count(before), 1)
                self.write("description.yaml", COLUMNS.replace(before, after))
                self.assert_fails(expected, *frames)
        self.make_columns()
        self.write("in/images/images.txt", "1403715273262142977 20000\n")
        self.assert_fails("0002.png: no stamp for image 2 in images/images.txt, which has 1", *frames)
        self.write("in/images/images.txt", "1403715273.262 20000\n")
        self.assert_fails("images.txt:1: '1403715273.262' is no time in integer nanoseconds", *frames)

    def test_bad_patterns(self):
        frames = ("--format", "frames", "--description", self.path("description.yaml"))
        for before, after, expected in (
                (r"shot(\d+)\.png", r"shot\d+\.png",
                 r"description.yaml: images.pattern = shot\d+\.png has 0 groups in parentheses instead of 1: "
                 "image number. Write other parentheses as (?:...)"),
                (r"shot(\d+)\.png", r"(shot|snap)(\d+)\.png", "has 2 groups in parentheses instead of 1: image number"),
                (r"shot(\d+)\.png", r"shot(\d+\.png",
                 r"description.yaml: images.pattern = shot(\d+\.png is no regular expression: "),
                (r"frame (\d+) took ([0-9.]+) ms", "took ([0-9.]+) ms",
                 "description.yaml: exposures.pattern = took ([0-9.]+) ms has 1 groups in parentheses instead of 2: "
                 "image number, time"),
                (r"frame (\d+) took ([0-9.]+) ms", r"frame (\d+) took ([0-9.]+) (ms)", "has 3 groups in parentheses"),
                (r"frame (\d+) took", r"(\w+) \d+ took",
                 "log.txt.gz:2: 'frame' is no image number: an integer from 0 to 2147483647 is needed"),
                (r"frame (\d+) took", r"frame (\d*)[ \d]* took",
                 "log.txt.gz:4: '' is no image number: an integer from 0 to 2147483647 is needed"),
                (r"shot(\d+)\.png", r"shot(\w+)\.png", "in/pictures/shot2b.png: '2b' is no image number: an integer"),
                (r"shot(\d+)\.png", r"shot?(\d+)\.png",
                 "in/pictures/sho2147483648.png: '2147483648' is no image number: an integer"),
                (r"([0-9.]+) ms'", r"(\S+) ms'", "log.txt.gz:5: 'nan' is no time: at most 9e9 s are allowed")):
            with self.subTest(after=after):
                self.make_frames()
                self.image("in/pictures/shot2b.png", picture(2))
                self.image("in/pictures/sho2147483648.png", picture(2))
                with gzip.open(self.path("in/log.txt.gz"), "at") as file:
                    file.write("frame  took 1 ms\nframe 11 took nan ms\n")
                self.assertEqual(FRAMES.count(before), 1)
                self.write("description.yaml", FRAMES.replace(before, after))
                self.assert_fails(expected, *frames)

    def test_groups_that_do_not_count(self):
        self.make_frames()
        self.write("description.yaml", FRAMES.replace(r"shot(\d+)", r"(?:shot|snap)0*(\d+)"))
        self.image("in/pictures/snap0012.png", picture(12))
        self.assertEqual(self.frames().returncode, 0)
        self.assertEqual([m.header.stamp.to_nsec() for m, _ in self.messages("/camera/image_raw")],
                         [5200 * 10**6, 6000 * 10**6, 6100 * 10**6, 6200 * 10**6])

    def test_euroc(self):
        self.write("in/mav0/cam0/sensor.yaml", """%YAML:1.0
T_BS:
  cols: 4
  rows: 4
  data: [0, 0, 1, 0.1,  -1, 0, 0, 0.2,  0, -1, 0, 0.3,  0, 0, 0, 1]
resolution: [64, 48]
intrinsics: [50, 51, 31.5, 23.5]
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, 1.7e-05]
""")
        self.write("in/mav0/cam0/data.csv", "#timestamp [ns],filename\n1403715273262142976,a.png\n")
        self.image("in/mav0/cam0/data/a.png", picture(3))
        self.write("in/mav0/imu0/data.csv",
                   "#t\n1403715273262142976,0.1,0.2,0.3,9,8,7\n1403715273267142912,0.4,0.5,0.6,6,5,4\n")
        self.assertEqual(self.run_tool("--format", "euroc").returncode, 0)
        self.assertEqual(self.messages("/camera/exposure"), [])
        image, delivered = self.messages("/camera/image_raw")[0]
        # 19 digits do not fit a double: the stamp must be exact.
        self.assertEqual(image.header.stamp.to_nsec(), 1403715273262142976)
        self.assertEqual(delivered.to_nsec(), 1403715273262142976)
        np.testing.assert_allclose(self.messages("/camera/camera_info")[0][0].D, [-0.28, 0.07, 0.0002, 1.7e-05, 0])
        translation = self.messages("/tf_static")[0][0].transforms[0].transform.translation
        self.assertEqual((translation.x, translation.y, translation.z), (0.1, 0.2, 0.3))
        self.assertEqual(self.messages("/imu")[1][0].linear_acceleration.z, 4)
        self.assertEqual(self.run_tool("--format", "euroc", "--exposure-time", "0.015").returncode, 0)
        self.assertEqual(self.messages("/camera/exposure")[0][0].exposure_time.to_nsec(), 15000000)

    def test_bad_input(self):
        frames = ("--format", "frames", "--description", self.path("description.yaml"))
        self.assert_fails("in: no such folder", *frames)
        self.make_frames()
        self.assert_fails("--format frames needs --description", "--format", "frames")
        self.assert_fails("cam0/sensor.yaml: cannot be opened", "--format", "euroc")
        self.assert_fails("none.yaml: cannot be opened", "--format", "frames", "--description", self.path("none.yaml"))
        self.write("in/gyro.csv", "1.0,1,2,3\n1.1,1,two,3\n")
        self.assert_fails("gyro.csv:2: 'two' is no number", *frames)
        self.write("in/gyro.csv", "1.0,1,2\n")
        self.assert_fails("gyro.csv:1: has 3 columns, column 4 is needed", *frames)
        self.write("in/gyro.csv", "")
        self.assert_fails("no gyroscope sample", *frames)
        self.make_frames()
        self.image("in/pictures/shot2.png", picture(2, (20, 30)))
        self.assert_fails("shot2.png: is 30x20 px, the calibration is for 64x48", *frames)
        self.make_frames()
        self.write("in/pictures/shot10.png", "no image")
        self.assert_fails("shot10.png: cannot be read as an image", *frames)
        self.make_frames()
        self.image("in/pictures/shot13.png", picture(13))
        self.assert_fails("shot13.png: no stamp for image 13 in stamps.txt, which has 12", *frames)
        os.remove(self.path("in/pictures/shot13.png"))
        self.write("description.yaml", FRAMES.replace("readout_time: 0.01", ""))
        self.assert_fails("readout_time is missing", *frames)
        self.write("description.yaml", FRAMES.replace("[0, -1, 0, -1,", "[0, -1, 0, 1,"))
        self.assert_fails("R_cam_imu", *frames)
        self.write("description.yaml", FRAMES.replace("fx: 50", "fx: 0"))
        self.assert_fails("fx", *frames)
        self.write("description.yaml", "a: [")
        self.assert_fails("description.yaml", *frames)

    def test_usage(self):
        result = subprocess.run([MAKE_BAG, "--help"], stdout=subprocess.PIPE, universal_newlines=True)
        self.assertEqual(result.returncode, 0)
        self.assertIn("--description", result.stdout)
        result = self.run_tool("--format", "mp4")
        self.assertEqual(result.returncode, 2)
        self.assertIn("mp4", result.stderr)
        self.assertIn("euroc, frames", result.stderr)
        self.assertEqual(self.run_tool().returncode, 2)


if __name__ == "__main__":
    MAKE_BAG = sys.argv.pop(1)
    unittest.main(verbosity=2)
