#!/usr/bin/env python3
"""Plays a bag through a running gyro_deblur, records what comes out, and ends when the last frame has left.

Waits for what it needs instead of sleeping: until the nodelet and the other nodes given by --listener have subscribed,
until the clock has reached the bag's end, until every frame that went in has come out and is recorded, or was kept back
by drop_poor. Until then rosbag play is kept alive: with its end it would take away what it has not sent yet, and on a
busy machine that can be most of a bag. A recorder of its own would lose its last messages in the same way; this one
knows what it has. Says what it waits for after 5 s, and ends with status 1 when nothing happens for --patience seconds.
Played are the bag's topics that somebody has subscribed to.
"""
import argparse
import json
import subprocess
import threading
import time

import missing_packages  # noqa: F401  (first: names the package of a module that is missing)
import rosbag
import rosgraph
import rospy
from gyro_deblur.msg import BlurField

from bag_input import image_topic, open_bag
from report_tables import fail

POLL_S = 0.2  # between two looks at something that has no event
SILENT_S = 5.0  # of waiting, before a line says what for


class Patience:
    """Waits for conditions, in real time: simulated time may stand still."""

    def __init__(self, seconds):
        self.seconds = seconds

    def until(self, condition, what, progress=lambda: None):
        """Returns when condition() is true; fails when progress() has not changed for too long."""
        last, since, reported = progress(), time.monotonic(), False
        while not condition():
            if rospy.is_shutdown():
                fail("interrupted while waiting for " + what)
            now = progress()
            if now != last:
                last, since, reported = now, time.monotonic(), False
            waited_s = time.monotonic() - since
            if waited_s > self.seconds:
                fail("waited %.0f s in vain for %s" % (self.seconds, what))
            if waited_s > SILENT_S and not reported:
                print("waiting for %s, for %.0f s at most" % (what, self.seconds), flush=True)
                reported = True
            time.sleep(POLL_S)


class Outputs:
    """Counts the messages of the nodelet's topics as they come, and writes those that are asked for into a bag."""

    # One message for every frame, or for every one that drop_poor lets out; there are fewer overlays and tracks.
    OF_EVERY_FRAME_OUT = ("deblurred/image_raw", "deblurred/camera_info", "keypoints")
    OF_EVERY_FRAME = ("blur_field", "blur_markers", "image_quality")

    def __init__(self, camera, recorded, path):
        self.image, self._field = camera + "/deblurred/image_raw", camera + "/blur_field"
        self.first_s = self.last_s = 0.0  # monotonic; of the images
        self.dropped = 0  # by drop_poor
        self._recorded = frozenset(recorded)
        self._counts = dict.fromkeys([self.image, self._field, *recorded], 0)
        self._of_every_frame_out, self._of_every_frame = (
            [t for t in self._counts if t in {camera + "/" + o for o in outputs}]
            for outputs in (self.OF_EVERY_FRAME_OUT, self.OF_EVERY_FRAME))
        self._lock = threading.Lock()
        self._bag = rosbag.Bag(path, "w") if path else None
        self._subscribers = [rospy.Subscriber(topic, rospy.AnyMsg, self._on_message, topic, buff_size=2**22)
                             for topic in self._counts]

    def _on_message(self, message, topic):
        with self._lock:
            if topic == self.image:
                self.last_s = time.monotonic()
                self.first_s = self.first_s or self.last_s
            elif topic == self._field and message._connection_header["md5sum"] == BlurField._md5sum:
                self.dropped += BlurField().deserialize(message._buff).reason_text.startswith("drop_poor:")
            if self._bag and topic in self._recorded:
                header = message._connection_header  # rospy has no other access to it
                # A bag has no time 0, which is what simulated time is before it begins.
                at = max(rospy.Time.now(), rospy.Time(0, 1))
                raw = (header["type"], message._buff, header["md5sum"], None)
                self._bag.write(topic, raw, at, raw=True, connection_header=dict(header, topic=topic))
            self._counts[topic] += 1

    def has(self, topic):
        return topic in self._counts

    def connected(self):
        return all(subscriber.get_num_connections() > 0 for subscriber in self._subscribers)

    def frames(self):
        """Of which everything has come that comes of every frame, those dropped among them."""
        with self._lock:
            return min([self._counts[topic] + self.dropped for topic in self._of_every_frame_out] +
                       [self._counts[topic] for topic in self._of_every_frame])

    def rate_hz(self):
        """Of the images from the first to the last."""
        span_s = self.last_s - self.first_s
        return (self._counts[self.image] - 1) / span_s if span_s > 0 else 0.0

    def close(self):
        for subscriber in self._subscribers:
            subscriber.unregister()
        with self._lock:
            if self._bag:
                self._bag.close()
            self._bag = None


class Player:
    """rosbag play, which ends only on request, or when it fails."""

    def __init__(self, bag, topics, arguments):
        command = ["rosbag", "play", "--clock", "--quiet", "--wait-for-subscribers", "--rate=%g" % arguments.rate,
                   "--delay=%g" % arguments.delay, "--loop" if arguments.loop else "--keep-alive"]
        if arguments.duration is not None:
            command.append("--duration=%.6f" % arguments.duration)
        self._process = subprocess.Popen(command + [bag, "--topics"] + topics, stdin=subprocess.DEVNULL)

    def check(self):
        if self._process.poll() is not None:
            fail("rosbag play ended with status %d" % self._process.returncode)

    def end(self):
        self._process.terminate()
        self._process.wait()


class Recording:
    """What a bag has for the nodelet."""

    def __init__(self, path, raw, imu, duration_s):
        with open_bag(path) as bag:
            types = {name: info.msg_type for name, info in bag.get_type_and_topic_info().topics.items()}
            self.topics = sorted(types)
            self.end_s = bag.get_end_time()
            end = None
            if duration_s is not None:
                end = rospy.Time.from_sec(bag.get_start_time() + duration_s)
                self.end_s = min(self.end_s, end.to_sec())
            # Raw, or what a plugin of image_transport makes of it.
            self.images = {t: [at.to_sec() for _, _, at in bag.read_messages(topics=[t], end_time=end, raw=True)]
                           for t in self.topics if t == raw or t.startswith(raw + "/")}
        for topic, found, arguments in ((raw, any(self.images.values()), "camera:= and image:="),
                                        (imu, imu in types, "imu:=")):
            if not found:
                fail("%s: no messages on %s; %s of the launch file name the topic; the bag has %s" % (
                    path, topic, arguments, ", ".join("%s (%s)" % (t, types[t]) for t in self.topics)))


def subscribers(topic):
    """Names of the nodes that subscribe to a topic."""
    _, state, _ = rosgraph.Master(rospy.get_name()).getSystemState()
    return {node for name, nodes in state for node in nodes if name == topic}


def grab(path):
    """A picture of the whole display, also as an array."""
    import cv2  # only screenshots need it

    try:
        subprocess.run(["import", "-silent", "-window", "root", path], check=True)
    except FileNotFoundError:
        fail("there is no program import: apt-get install imagemagick")
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
    parser.add_argument("--camera", default="/camera", help="its namespace [%(default)s]")
    parser.add_argument("--image", default="image_raw",
                        help="topic of the images, in that namespace unless it begins with / [%(default)s]")
    parser.add_argument("--imu", default="/imu", help="its topic, may be in that namespace [%(default)s]")
    parser.add_argument("--listener", action="append", default=[], metavar="TOPIC=NODE",
                        help="node that has to subscribe to a topic before the bag is played")
    parser.add_argument("--duration", type=float, help="play only so many seconds of the bag")
    parser.add_argument("--rate", type=float, default=1.0, help="speed of the clock [%(default)g]")
    parser.add_argument("--delay", type=float, default=0.2,
                        help="[s] before playing, for those to connect that nobody waits for [%(default)g]")
    parser.add_argument("--loop", action="store_true", help="play again and again, until this is ended")
    parser.add_argument("--record", metavar="BAG", help="write the outputs into this bag")
    parser.add_argument("--outputs", nargs="+", default=[], metavar="TOPIC", help="which ones")
    parser.add_argument("--patience", type=float, default=60.0, help="[s] to wait for something [%(default)g]")
    parser.add_argument("--json", metavar="FILE", help="write frames and rate to this file")
    parser.add_argument("--screenshot", metavar="PNG", help="at the end, a picture of the display")
    arguments = parser.parse_args(rospy.myargv()[1:])

    camera = "/" + arguments.camera.strip("/")
    imu = arguments.imu if arguments.imu.startswith("/") else camera + "/" + arguments.imu
    image = image_topic(camera, arguments.image)
    recording = Recording(arguments.bag, image, imu, arguments.duration)
    rospy.init_node("conductor")
    patience = Patience(arguments.patience)
    outputs = Outputs(camera, arguments.outputs if arguments.record else [], arguments.record)

    def listeners(topic):
        return subscribers(topic) - {rospy.get_name()}

    patience.until(outputs.connected, "the nodelet's outputs")
    # The nodelet subscribes to its images last.
    patience.until(lambda: any(map(listeners, recording.images)),
                   "a subscriber of %s, which the bag has (image_transport:= decides between them)" %
                   " or ".join(recording.images))
    patience.until(lambda: listeners(imu), "a subscriber of " + imu)
    for listener in arguments.listener:
        topic, node = listener.split("=")
        patience.until(lambda t=topic, n=node: n in subscribers(t), "%s to subscribe to %s" % (node, topic))
    topics = [t for t in recording.topics if listeners(t) and not outputs.has(t)]
    times_s = next(recording.images[t] for t in topics if t in recording.images)
    expected = len(times_s)
    wanted_rate_hz = (expected - 1) / (times_s[-1] - times_s[0]) if expected > 1 else 0.0

    screen = Screen(arguments.screenshot, patience) if arguments.screenshot else None

    print("playing %d frames of %s" % (expected, arguments.bag), flush=True)
    player = Player(arguments.bag, topics, arguments)
    try:
        def played():
            player.check()
            return not arguments.loop and (rospy.get_time() >= recording.end_s or outputs.frames() >= expected)

        def all_out():
            player.check()
            return outputs.frames() >= expected

        patience.until(played, "the clock to go on", rospy.get_time)
        patience.until(all_out, "the last of %d frames" % expected, outputs.frames)
    finally:
        player.end()
        outputs.close()
    frames_out = outputs.frames() - outputs.dropped
    print("%d of %d frames came out at %.1f Hz" % (frames_out, expected, outputs.rate_hz()) +
          (", %d were dropped as POOR" % outputs.dropped if outputs.dropped else ""), flush=True)
    if arguments.json:
        with open(arguments.json, "w", encoding="utf-8") as file:
            json.dump({"frames_in": expected, "frames_out": frames_out, "dropped_poor": outputs.dropped,
                       "rate_hz": outputs.rate_hz(), "wanted_rate_hz": wanted_rate_hz}, file)
    if screen:
        screen.take()
        print("screenshot: " + arguments.screenshot, flush=True)


if __name__ == "__main__":
    main()
