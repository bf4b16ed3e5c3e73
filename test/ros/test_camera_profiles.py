#!/usr/bin/env python3
"""Each camera profile on a bag as its driver makes one: topics, encoding, stamps and exposure messages."""

import functools
import glob
import json
import os
import subprocess
import sys
import tempfile
import unittest

import cv2
import genpy.dynamic
import numpy as np
import rosbag
import roslaunch
import rospy
import yaml
from sensor_msgs.msg import CompressedImage

SOURCE, TOOLS = None, None  # the package's folder and that of its tools, from the command line

FRAMES = 30
EXPOSURE_S = 0.02
READOUT_S = 0.015  # of rolling shutters
TRANSFER_S = 0.004  # a stamp at the arrival is late by the transfer...
ARRIVAL_JITTER_S = 0.0005  # ... which scatters
SCENE = """
frames: {frames}
seed: 5
camera:
  size: [192, 144]
  intrinsics: [190, 190, 95.5, 71.5]
  fps: 20
  exposure_time: {exposure}
  readout_time: {readout}
  stamp_row: {row}
  stamp_phase: {phase}
  encoding: {encoding}
  noise: 1.5
imu: {{rate: 200, gyro_noise: 0.003}}
planes:
  - {{texture: procedural, texture_seed: 11, texture_size: [1600, 1200], size: [9.6, 7.2], position: [0, 0, 2]}}
motion:
  type: curve
  rotation:
    sines:
      - {{amplitude: [9, 4, 3], frequency: 1.9, phase: 20}}
      - {{amplitude: [-3, 10, 5], frequency: 1.3, phase: 100}}
"""

METADATA = ("realsense2_camera/Metadata", "std_msgs/Header header\nstring json_data\n" + "=" * 80 +
            "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n")
CURRENT_PARAMS = ("camera_control_msgs/currentParams", "bool is_sleeping\nfloat32 brightness\nfloat32 exposure\n")


class Habit:
    """What a driver does.

    encoding: of the images, or jpeg
    stamp:    start or end of the first row's exposure; arrival: after the last row has been transferred
    rolling:  the shutter
    metadata: unit [s] of actual_exposure in the RealSense's metadata, None: no such message
    """

    def __init__(self, encoding, stamp, rolling=False, metadata=None, current_params=False, camera_info=True):
        self.encoding, self.stamp, self.rolling = encoding, stamp, rolling
        self.metadata, self.current_params, self.camera_info = metadata, current_params, camera_info

    def publishes_exposure(self):
        return self.metadata is not None or self.current_params


HABITS = {
    "basler_pylon": Habit("bayer_rggb8", "start", current_params=True),
    "flir_spinnaker": Habit("bayer_rggb8", "arrival"),
    "oak_d_left": Habit("mono8", "end"),
    "oak_d_rgb": Habit("bgr8", "end", rolling=True),
    "pointgrey": Habit("mono8", "arrival"),
    "raspicam": Habit("jpeg", "arrival", rolling=True),
    "realsense_d435i_color": Habit("rgb8", "end", rolling=True, metadata=1e-4),
    "realsense_d435i_infra1": Habit("mono8", "end", metadata=1e-6),
    "realsense_d455_color": Habit("rgb8", "end", metadata=1e-4),
    "realsense_d455_infra1": Habit("mono8", "end", metadata=1e-6),
    "realsense_t265_fisheye1": Habit("mono8", "start", metadata=1e-6),
    "usb_cam": Habit("rgb8", "arrival", rolling=True),
    "voxl_tracking": Habit("mono8", "start", camera_info=False),
    "zed2_left": Habit("mono8", "arrival", rolling=True),
    "zedm_left": Habit("mono8", "arrival", rolling=True),
}

# Where nobody publishes camera_info the user names a file.
CALIBRATION = """
cam0:
  camera_model: pinhole
  intrinsics: [190, 190, 95.5, 71.5]
  distortion_model: none
  distortion_coeffs: []
  resolution: [192, 144]
"""


def profiles():
    return sorted(os.path.basename(path)[:-len(".launch")]
                  for path in glob.glob(os.path.join(SOURCE, "launch", "cameras", "*.launch")))


def load(*arguments):
    """What `roslaunch gyro_deblur deblur.launch ARGUMENTS` would start: its node, and that node's parameters."""
    config = roslaunch.config.load_config_default([(os.path.join(SOURCE, "launch", "deblur.launch"), list(arguments))],
                                                  None, verbose=False)
    (node,) = config.nodes
    name = node.namespace + node.name
    return node, {key[len(name) + 1:]: param.value for key, param in config.params.items()
                  if key.startswith(name + "/")}


class Launched:
    """What deblur.launch makes of a profile: parameters, and the resolved names of the topics."""

    def __init__(self, profile):
        node, self.parameters = load(f"camera_profile:={profile}")
        remaps = dict(node.remap_args)
        self.namespace = node.namespace.rstrip("/")
        self.image = self.resolve(remaps["image_raw"])
        self.camera_info = os.path.join(os.path.dirname(self.image), "camera_info")
        self.imu = self.resolve(remaps["imu"])
        self.exposure = self.resolve(remaps["exposure"])
        self.compressed = self.parameters.pop("image_transport", "raw") == "compressed"

    def resolve(self, name):
        return name if name.startswith("/") else os.path.join(self.namespace, name)


@functools.lru_cache(maxsize=None)
def message_class(name, definition):
    return genpy.dynamic.generate_dynamic(name, definition)[name]


def exposure_message(kind, stamp, value):
    message = message_class(*kind)()
    if kind is METADATA:
        message.header.stamp = stamp
        message.json_data = json.dumps({"actual_exposure": value})
    else:
        message.exposure = value
    return message


def drive(source, target, launched, habit):
    """Rewrites a simulated bag as the driver would have recorded it. Returns the stamps of its images."""
    rng = np.random.default_rng(7)
    stamps = []
    with rosbag.Bag(source) as simulated, rosbag.Bag(target, "w") as bag:
        moved = {}
        for _, message, _ in simulated.read_messages(topics=["/camera/image_raw"]):
            late = 0 if habit.stamp != "arrival" else TRANSFER_S + rng.uniform(-ARRIVAL_JITTER_S, ARRIVAL_JITTER_S)
            moved[message.header.stamp.to_nsec()] = message.header.stamp + rospy.Duration.from_sec(late)
        for topic, message, time in simulated.read_messages():
            if topic == "/imu":
                bag.write(launched.imu, message, time)
            elif topic == "/tf_static":
                bag.write(topic, message, time)
            elif topic == "/camera/camera_info" and habit.camera_info:
                message.header.stamp = moved[message.header.stamp.to_nsec()]
                bag.write(launched.camera_info, message, time)
            elif topic == "/camera/image_raw":
                message.header.stamp = moved[message.header.stamp.to_nsec()]
                stamps.append(message.header.stamp.to_nsec())
                if habit.metadata is not None:
                    value = round(EXPOSURE_S / habit.metadata)
                    bag.write(launched.exposure, exposure_message(METADATA, message.header.stamp, value), time)
                elif habit.current_params:
                    bag.write(launched.exposure, exposure_message(CURRENT_PARAMS, None, EXPOSURE_S * 1e6), time)
                if habit.encoding == "jpeg":
                    bag.write(launched.image + "/compressed", jpeg(message), time)
                else:
                    bag.write(launched.image, message, time)
    return stamps


def pixels(message):
    channels = len(message.data) // (message.height * message.width)
    return np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, channels)


def jpeg(message):
    compressed = CompressedImage(header=message.header, format="jpeg")
    compressed.data = cv2.imencode(".jpg", pixels(message), [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()
    return compressed


def images(path, topic):
    with rosbag.Bag(path) as bag:
        return [message for _, message, _ in bag.read_messages(topics=[topic])]


def psnr(image, truth):
    error = image.astype(float) - truth.astype(float)
    return 10 * np.log10(255**2 / np.mean(error[8:-8, 8:-8]**2))


class CameraProfiles(unittest.TestCase):

    def test_every_profile_has_a_habit(self):
        self.assertEqual(profiles(), sorted(list(HABITS) + ["generic"]))

    def test_profiles_are_in_the_guide(self):
        with open(os.path.join(SOURCE, "doc", "guides", "calibration.md"), encoding="utf-8") as file:
            guide = file.read()
        for profile in HABITS:
            self.assertIn(f"`{profile}`", guide)

    def test_keys_of_the_configuration_win(self):
        with tempfile.NamedTemporaryFile("w", suffix=".yaml") as config:
            config.write("stamp_phase: middle\n")
            config.flush()
            _, parameters = load("camera_profile:=realsense_d435i_infra1", f"config:={config.name}")
        self.assertEqual(parameters["stamp_phase"], "middle")
        self.assertEqual(parameters["exposure_source"], "realsense_metadata_us")

    def test_arguments_win(self):
        node, _ = load("camera_profile:=usb_cam", "camera:=/front", "imu:=/front/imu")
        self.assertEqual(node.namespace, "/front/")
        self.assertEqual(dict(node.remap_args)["imu"], "/front/imu")

    def run_profile(self, profile):
        habit, launched = HABITS[profile], Launched(profile)
        with tempfile.TemporaryDirectory(prefix="gyro_deblur_profile_") as folder:
            path = lambda name: os.path.join(folder, name)
            row, phase = ("last", "end") if habit.stamp == "arrival" else ("first", habit.stamp)
            readout_s = READOUT_S if habit.rolling else 0
            encoding = "bgr8" if habit.encoding == "jpeg" else habit.encoding
            with open(path("scene.yaml"), "w", encoding="utf-8") as file:
                file.write(SCENE.format(frames=FRAMES, exposure=EXPOSURE_S, readout=readout_s, row=row, phase=phase,
                                        encoding=encoding))
            subprocess.run([os.path.join(TOOLS, "simulate_bag"), path("simulated.bag"), "--scene", path("scene.yaml"),
                            "--quiet"], check=True, stdout=subprocess.DEVNULL)
            stamps = drive(path("simulated.bag"), path("in.bag"), launched, habit)

            # What a profile leaves to the user.
            config = dict(launched.parameters, readout_time=readout_s)
            if not habit.publishes_exposure():
                config["exposure_time"] = EXPOSURE_S
            if habit.stamp == "arrival":
                config["time_offset"] = -TRANSFER_S
            if not habit.camera_info:
                config["calibration_file"] = path("calibration.yaml")
                with open(path("calibration.yaml"), "w", encoding="utf-8") as file:
                    file.write(CALIBRATION)
            with open(path("config.yaml"), "w", encoding="utf-8") as file:
                yaml.safe_dump(config, file)

            self.assertEqual(launched.compressed, habit.encoding == "jpeg")
            topics = ["--image-topic", launched.image + ("/compressed" if launched.compressed else ""), "--imu-topic",
                      launched.imu, "--output-namespace", launched.namespace]
            if habit.camera_info:
                topics += ["--camera-info-topic", launched.camera_info]
            if habit.publishes_exposure():
                topics += ["--exposure-topic", launched.exposure]
            result = subprocess.run([os.path.join(TOOLS, "deblur_bag"), path("in.bag"), path("out.bag"), "--config",
                                     path("config.yaml"), "--json", path("report.json"), "--no-keypoints"] + topics,
                                    stdout=subprocess.PIPE, stderr=subprocess.STDOUT, universal_newlines=True)
            self.assertEqual(result.returncode, 0, result.stdout)
            with open(path("report.json"), encoding="utf-8") as file:
                report = json.load(file)
            self.assertEqual(report["frames_out"], FRAMES)
            self.assertEqual(report["passed_through"], {}, result.stdout)
            self.assertEqual(report["input_problems"], [], result.stdout)

            outputs = images(path("out.bag"), launched.namespace + "/deblurred/image_raw")
            self.assertEqual([message.header.stamp.to_nsec() for message in outputs], stamps)
            self.assertEqual({message.encoding for message in outputs}, {encoding})
            before, after = [], []
            for blurred, deblurred, sharp in zip(images(path("simulated.bag"), "/camera/image_raw"), outputs,
                                                 images(path("simulated.bag"), "/truth/sharp")):
                before.append(psnr(pixels(blurred), pixels(sharp)))
                after.append(psnr(pixels(deblurred), pixels(sharp)))
            gain_db = np.mean(after) - np.mean(before)
            print(f"{profile}: {np.mean(before):.1f} -> {np.mean(after):.1f} dB")
            self.assertGreater(gain_db, 1.5)


for name in HABITS:
    setattr(CameraProfiles, "test_" + name, lambda self, name=name: self.run_profile(name))

if __name__ == "__main__":
    SOURCE, TOOLS = sys.argv[1:3]
    unittest.main(argv=sys.argv[:1], verbosity=2)
