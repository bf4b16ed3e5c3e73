#!/usr/bin/env python3
"""Latency of two cameras in one nodelet manager: plays a bag in real time to both and waits for every image.

Starts a master of its own, loads one nodelet for each camera with slam_front_end.launch, publishes the bag's images to
both cameras and its IMU once, at the bag's pace, and measures the time from publishing an image to receiving the
deblurred one. Keypoints are subscribed to as well, so that they are computed. Prints a table, how many pairs had one image
deblurred and the other left blurred, and the machine's load.
"""
import argparse
import collections
import json
import os
import signal
import socket
import subprocess
import tempfile
import threading
import time

import missing_packages  # noqa: F401  (first: names the package of a module that is missing)
import numpy as np

from bag_input import open_bag
from report_tables import fail, number, table

CAMERAS = ("/cam0", "/cam1")


def free_port():
    with socket.socket() as s:
        s.bind(("localhost", 0))
        return s.getsockname()[1]


def percentiles(values_ms):
    return {"p50_ms": float(np.percentile(values_ms, 50)), "p95_ms": float(np.percentile(values_ms, 95)),
            "p99_ms": float(np.percentile(values_ms, 99)), "max_ms": float(np.max(values_ms))}


def percentile_cells(numbers):
    return [number(numbers[key]) + " ms" for key in ("p50_ms", "p95_ms", "p99_ms")]


class Listener:
    """When each image of each camera came out, and what became of it."""

    def __init__(self):
        import rospy
        from gyro_deblur.msg import BlurField
        from sensor_msgs.msg import Image

        self.images = {camera: collections.OrderedDict() for camera in CAMERAS}
        self.reasons = collections.Counter()
        self.deblurred = {camera: {} for camera in CAMERAS}  # by stamp; absent for an image without blur
        self.keypoints = 0  # messages; taking their many keypoints apart in Python would slow everything down
        self._lock = threading.Lock()
        self._subscribers = []
        for camera in CAMERAS:
            for name, kind, callback in (("deblurred/image_raw", Image, self._on_image),
                                         ("blur_field", BlurField, self._on_field),
                                         ("keypoints", rospy.AnyMsg, self._on_keypoints)):
                self._subscribers.append(rospy.Subscriber(camera + "/" + name, kind, callback, camera, queue_size=1000,
                                                          tcp_nodelay=True))

    def _on_image(self, message, camera):
        now = time.monotonic()
        with self._lock:
            self.images[camera][message.header.stamp.to_nsec()] = now

    def _on_field(self, message, camera):
        status = np.array(list(message.status))
        with self._lock:
            self.reasons[message.reason] += 1
            if message.reason != message.REASON_NONE or np.any(status != message.SHARP):
                self.deblurred[camera][message.header.stamp.to_nsec()] = bool(np.any(status == message.DEBLURRED))

    def _on_keypoints(self, *_):
        with self._lock:
            self.keypoints += 1

    def count(self):
        with self._lock:
            return min(len(images) for images in self.images.values())


def measure(bag_path, camera, imu_topic, seconds):
    """Plays the bag and returns what was measured."""
    import rospy

    rospy.init_node("stereo_latency", disable_signals=True)
    targets = {camera + "/" + name: [c + "/" + name for c in CAMERAS]
               for name in ("image_raw", "camera_info", "exposure")}
    targets.update({imu_topic: ["/imu"], "/tf_static": ["/tf_static"]})
    with open_bag(bag_path) as bag:
        start = bag.get_start_time()
        messages = [(topic, message, t.to_sec() - start) for topic, message, t in bag.read_messages(topics=targets)
                    if t.to_sec() - start <= seconds]
    # The bag brings the classes of its messages.
    kinds = {topic: type(message) for topic, message, _ in messages}
    publishers = {topic: [rospy.Publisher(name, kind, queue_size=1000, tcp_nodelay=True, latch=topic == "/tf_static")
                          for name in targets[topic]] for topic, kind in kinds.items()}
    frames = sum(topic == camera + "/image_raw" for topic, _, _ in messages)
    if frames == 0:
        fail("%s has no images on %s/image_raw" % (bag_path, camera))
    listener = Listener()

    deadline = time.monotonic() + 60
    while not all(p.get_num_connections() >= 1 for topic in publishers for p in publishers[topic]):
        if time.monotonic() > deadline:
            fail("the nodelets did not subscribe within 60 s")
        time.sleep(0.1)
    published = {c: {} for c in CAMERAS}
    begin = time.monotonic()
    late = 0.0
    for topic, message, at in messages:
        wait = begin + at - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        late = max(late, -wait)
        for i, publisher in enumerate(publishers[topic]):
            if topic == camera + "/image_raw":
                published[CAMERAS[i]][message.header.stamp.to_nsec()] = time.monotonic()
            publisher.publish(message)
    last, since = -1, time.monotonic()
    while listener.count() < frames and time.monotonic() - since < 10:
        if listener.count() != last:
            last, since = listener.count(), time.monotonic()
        time.sleep(0.1)

    result = {"frames": frames, "cameras": {}, "load_average": os.getloadavg(), "cores": os.cpu_count(),
              "publisher_late_s": late, "keypoint_messages": listener.keypoints,
              "passed_through": {str(reason): n for reason, n in listener.reasons.items() if reason != 0}}
    for c in CAMERAS:
        out = listener.images[c]
        latencies = [1e3 * (out[stamp] - published[c][stamp]) for stamp in published[c] if stamp in out]
        result["cameras"][c] = dict(percentiles(latencies), out=len(out), dropped=frames - len(out),
                                    in_order=list(out) == sorted(out))
    apart = [1e3 * abs(listener.images[CAMERAS[0]][s] - listener.images[CAMERAS[1]][s])
             for s in listener.images[CAMERAS[0]] if s in listener.images[CAMERAS[1]]]
    of_pair = [listener.deblurred[c] for c in CAMERAS]
    result["pairs"] = dict(percentiles(apart), complete=len(apart),
                           unlike=sum(of_pair[0][s] != of_pair[1][s] for s in of_pair[0] if s in of_pair[1]))
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bag", help="of one camera; both get its images")
    parser.add_argument("--camera", default="/camera", help="namespace in the bag [%(default)s]")
    parser.add_argument("--imu", default="/imu", help="topic in the bag [%(default)s]")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE",
                        help="parameter of the nodelets, which have keypoint_detector ORB, 1000 features, one thread each")
    parser.add_argument("--set1", action="append", default=[], metavar="KEY=VALUE", help="of the second one alone")
    parser.add_argument("--seconds", type=float, default=1e9, help="play only so much of the bag")
    parser.add_argument("--json", metavar="FILE", help="write everything to this file")
    arguments = parser.parse_args()

    processes = []
    with tempfile.TemporaryDirectory() as folder:
        config = os.path.join(folder, "config.yaml")
        with open(config, "w", encoding="utf-8") as file:
            file.write("keypoint_detector: ORB\nkeypoint_descriptor: ORB\nmax_keypoints: 1000\nthreads: 1\n")
            file.writelines("%s: %s\n" % tuple(item.split("=", 1)) for item in arguments.set)
        config1 = os.path.join(folder, "config1.yaml")
        with open(config, encoding="utf-8") as file, open(config1, "w", encoding="utf-8") as file1:
            keys1 = {item.split("=", 1)[0] for item in arguments.set1}
            file1.writelines(line for line in file if line.split(":")[0] not in keys1)
            file1.writelines("%s: %s\n" % tuple(item.split("=", 1)) for item in arguments.set1)
        port = free_port()
        os.environ.update(ROS_MASTER_URI="http://localhost:%d" % port, ROS_HOSTNAME="localhost",
                          ROS_LOG_DIR=os.path.join(folder, "log"))
        try:
            log = open(os.path.join(folder, "launch.log"), "w", encoding="utf-8")
            processes.append(subprocess.Popen(
                ["roslaunch", "-p", str(port), "gyro_deblur", "slam_front_end.launch", "camera:=" + CAMERAS[0],
                 "camera1:=" + CAMERAS[1], "imu:=/imu", "config:=" + config, "config1:=" + config1],
                stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL))
            while subprocess.run(["rosparam", "get", "/run_id"], stdout=subprocess.DEVNULL,
                                 stderr=subprocess.DEVNULL, check=False).returncode != 0:
                if processes[0].poll() is not None:
                    fail("roslaunch ended; is the package's environment sourced?")
                time.sleep(0.5)
            result = measure(arguments.bag, arguments.camera, arguments.imu, arguments.seconds)
        finally:
            for process in processes:
                process.send_signal(signal.SIGINT)
                process.wait()
    if arguments.json:
        with open(arguments.json, "w", encoding="utf-8") as file:
            json.dump(result, file, indent=2)
    print("%d pairs, %d cores, load average %.1f, %d messages of keypoints" % (
        result["frames"], result["cores"], result["load_average"][0], result["keypoint_messages"]))
    rows = [[c, numbers["out"], numbers["dropped"], *percentile_cells(numbers)]
            for c, numbers in result["cameras"].items()]
    pairs = result["pairs"]
    rows.append(["images of a pair apart", pairs["complete"], "", *percentile_cells(pairs)])
    print("\n".join(table(["", "out", "dropped", "p50", "p95", "p99"], rows)))
    print("pairs of which one image is deblurred and one left blurred: %d" % pairs["unlike"])
    if result["passed_through"]:
        print("passed through, by reason: %s" % result["passed_through"])


if __name__ == "__main__":
    main()
