#!/usr/bin/env python3
"""Plays a bag through a running gyro_deblur and waits until every frame has come out.

Waits for what it needs instead of sleeping: until the nodelet and the other nodes given by --listener have subscribed,
until rosbag play is through, until as many frames came out as went in. Ends with status 1, and says why, when nothing
happens for --patience seconds.
"""
import argparse
import json
import subprocess
import threading
import time

import rosbag
import rosgraph
import rospy
from sensor_msgs.msg import Image

from report_tables import fail

POLL_S = 0.2  # between two looks at something that has no event


class Patience:
    """Waits for conditions, in real time: simulated time may stand still."""

    def __init__(self, seconds):
        self.seconds = seconds

    def until(self, condition, what, progress=lambda: None):
        """Returns when condition() is true; fails when progress() has not changed for too long."""
        last, since = progress(), time.monotonic()
        while not condition():
            if rospy.is_shutdown():
                fail("interrupted while waiting for " + what)
            now = progress()
            if now != last:
                last, since = now, time.monotonic()
            if time.monotonic() - since > self.seconds:
                fail("waited %.0f s in vain for %s" % (self.seconds, what))
            time.sleep(POLL_S)


class Counter:
    """Counts the frames of a topic."""

    def __init__(self, topic):
        self.count = 0
        self.first_s = self.last_s = 0.0  # monotonic
        self._lock = threading.Lock()
        self._subscriber = rospy.Subscriber(topic, Image, self._on_image, queue_size=1000)

    def _on_image(self, _):
        with self._lock:
            self.last_s = time.monotonic()
            if self.count == 0:
                self.first_s = self.last_s
            self.count += 1

    def rate_hz(self):
        """Of the frames from the first to the last."""
        span_s = self.last_s - self.first_s
        return (self.count - 1) / span_s if span_s > 0 else 0.0


def subscribers(topic):
    """Names of the nodes that subscribe to a topic."""
    _, state, _ = rosgraph.Master(rospy.get_name()).getSystemState()
    return {node for name, nodes in state for node in nodes if name == topic}


def grab(path):
    """A picture of the whole display, also as an array."""
    import cv2  # only screenshots need it

    subprocess.run(["import", "-silent", "-window", "root", path], check=True)
    return cv2.imread(path, cv2.IMREAD_COLOR)


def changed_share(a, b):
    return float((a != b).any(axis=2).mean())


class Screen:
    """The display with rviz, before and after the bag was played."""

    MIN_BRIGHTNESS = 20  # of 255: a display without a window is black
    MIN_CHANGE = 0.1  # of the pixels: the pictures that have come
    MAX_REST = 0.001  # of the pixels: rviz's frame counter ticks on

    def __init__(self, path, patience):
        self.path, self.patience = path, patience
        self._last = None
        patience.until(lambda: grab(path).mean() > self.MIN_BRIGHTNESS, "rviz's window")
        self._at_rest("rviz's empty window to come to rest")
        self._empty = self._last

    def _at_rest(self, what):
        def settled():
            before, self._last = self._last, grab(self.path)
            return before is not None and changed_share(before, self._last) < self.MAX_REST

        self.patience.until(settled, what)

    def take(self):
        """Leaves the picture of what rviz shows in the end."""
        self.patience.until(lambda: changed_share(grab(self.path), self._empty) > self.MIN_CHANGE, "pictures in rviz")
        self._at_rest("rviz to come to rest")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bag")
    parser.add_argument("--camera", default="/camera", help="namespace of the camera [%(default)s]")
    parser.add_argument("--imu", default="/imu", help="topic of the IMU [%(default)s]")
    parser.add_argument("--listener", action="append", default=[], metavar="TOPIC=NODE",
                        help="node that has to subscribe to a topic before the bag is played")
    parser.add_argument("--duration", type=float, help="play only so many seconds of the bag")
    parser.add_argument("--patience", type=float, default=60.0, help="[s] to wait for something [%(default)s]")
    parser.add_argument("--json", metavar="FILE", help="write frames and rate to this file")
    parser.add_argument("--screenshot", metavar="PNG", help="at the end, a picture of the display")
    arguments = parser.parse_args(rospy.myargv()[1:])

    rospy.init_node("conductor")
    patience = Patience(arguments.patience)
    image = arguments.camera + "/image_raw"
    with rosbag.Bag(arguments.bag) as bag:
        present = set(bag.get_type_and_topic_info().topics)
        end = None
        if arguments.duration is not None:
            end = rospy.Time.from_sec(bag.get_start_time() + arguments.duration)
        times_s = [t.to_sec() for _, _, t in bag.read_messages(topics=[image], end_time=end)]
    expected = len(times_s)
    wanted_rate_hz = (expected - 1) / (times_s[-1] - times_s[0]) if expected > 1 else 0.0
    wanted = [image, arguments.camera + "/camera_info", arguments.imu, arguments.camera + "/exposure", "/tf_static"]
    topics = [t for t in wanted if t in present]
    if expected == 0 or arguments.imu not in present:
        fail("%s: no images on %s or no samples on %s; the bag has %s" % (
            arguments.bag, image, arguments.imu, ", ".join(sorted(present))))

    counter = Counter(arguments.camera + "/deblurred/image_raw")
    for topic in topics:
        patience.until(lambda topic=topic: subscribers(topic) - {rospy.get_name()}, "a subscriber of " + topic)
    for listener in arguments.listener:
        topic, node = listener.split("=")
        patience.until(lambda t=topic, n=node: n in subscribers(t), "%s to subscribe to %s" % (node, topic))

    screen = Screen(arguments.screenshot, patience) if arguments.screenshot else None

    print("playing %d frames of %s" % (expected, arguments.bag), flush=True)
    command = ["rosbag", "play", "--clock", "--quiet", "--wait-for-subscribers"]
    if arguments.duration is not None:
        command.append("--duration=%.6f" % arguments.duration)
    player = subprocess.Popen(command + [arguments.bag, "--topics"] + topics, stdin=subprocess.DEVNULL)
    patience.until(lambda: player.poll() is not None, "rosbag play", lambda: counter.count)
    if player.returncode != 0:
        fail("rosbag play ended with status %d" % player.returncode)
    patience.until(lambda: counter.count >= expected, "the last of %d frames" % expected, lambda: counter.count)
    print("%d of %d frames came out at %.1f Hz" % (counter.count, expected, counter.rate_hz()), flush=True)
    if arguments.json:
        with open(arguments.json, "w", encoding="utf-8") as file:
            json.dump({"frames_in": expected, "frames_out": counter.count, "rate_hz": counter.rate_hz(),
                       "wanted_rate_hz": wanted_rate_hz}, file)
    if screen:
        screen.take()
        print("screenshot: " + arguments.screenshot, flush=True)


if __name__ == "__main__":
    main()
