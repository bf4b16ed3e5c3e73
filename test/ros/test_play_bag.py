#!/usr/bin/python3
"""scripts/play_bag.py with a slow front end: one that takes nothing in until everything has been published.

That is what a busy machine does to rosbag play: most of the bag is in its outbox when it is through. The front end here
is this process. Usage: test_play_bag.py SCRIPT
"""
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
import unittest

import rosbag
import rosgraph
import rospy
from gyro_deblur.msg import BlurField
from sensor_msgs.msg import CameraInfo, Image, Imu

SCRIPT = sys.argv[1]
FRAMES, PERIOD_S = 40, 0.02
BYTES = 2**20  # of an image; all of them are more than sockets keep
DEADLINE_S = 60


class FrontEnd:
    """Sends every image on, with its camera_info, but lets nothing in before the bag has been published. Of the first
    ones, as many as it is to drop, it only says that they are POOR."""

    def __init__(self, end_s, drops=0):
        self.frames = 0
        self._end_s, self._drops = end_s, drops
        self._field = rospy.Publisher("/camera/blur_field", BlurField, queue_size=FRAMES)
        self._image = rospy.Publisher("/camera/deblurred/image_raw", Image, queue_size=FRAMES)
        self._info = rospy.Publisher("/camera/deblurred/camera_info", CameraInfo, queue_size=FRAMES)
        # Called in the thread that reads the socket, which reads on when it returns.
        self._subscribers = [rospy.Subscriber("/camera/image_raw", Image, self._on_image),
                             rospy.Subscriber("/imu", Imu, lambda _: None)]

    def _published(self):
        publishers = dict(rosgraph.Master(rospy.get_name()).getSystemState()[0])
        return rospy.get_time() >= self._end_s or not publishers.get("/camera/image_raw")

    def _on_image(self, image):
        deadline = time.monotonic() + DEADLINE_S
        while self.frames == 0 and not self._published() and time.monotonic() < deadline:
            time.sleep(0.05)
        self.frames += 1
        dropped = self.frames <= self._drops
        if not dropped:
            self._image.publish(image)
            self._info.publish(CameraInfo(header=image.header))
        self._field.publish(BlurField(header=image.header, reason_text="drop_poor: PARTLY_DEBLURRED" if dropped else ""))

    def end(self):
        for connection in self._subscribers + [self._image, self._info, self._field]:
            connection.unregister()


class PlayBag(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.bag, cls.recorded = (os.path.join(folder.name, name) for name in ("in.bag", "out.bag"))
        with rosbag.Bag(cls.bag, "w") as bag:
            for i in range(FRAMES):
                stamp = rospy.Time.from_sec(100 + i * PERIOD_S)
                image = Image(height=1, width=BYTES, step=BYTES, encoding="mono8", data=bytes([i]) * BYTES)
                for topic, message in (("/camera/image_raw", image), ("/imu", Imu()), ("/nobody_listens", Imu())):
                    message.header.stamp = stamp
                    bag.write(topic, message, stamp)
            cls.end_s = stamp.to_sec()
        with socket.socket() as probe:
            probe.bind(("localhost", 0))
            port = probe.getsockname()[1]
        os.environ.update(ROS_MASTER_URI="http://localhost:%d" % port, ROS_HOSTNAME="localhost",
                          ROS_LOG_DIR=os.path.join(folder.name, "log"))
        master = subprocess.Popen(["roscore", "-p", str(port)], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                  stderr=subprocess.DEVNULL)
        cls.addClassCleanup(master.wait)
        cls.addClassCleanup(master.send_signal, signal.SIGINT)
        deadline = time.monotonic() + DEADLINE_S
        while time.monotonic() < deadline:  # there is no notice of when it is there
            try:
                rosgraph.Master("/test").setParam("/use_sim_time", True)
                break
            except OSError:
                time.sleep(0.1)
        rospy.init_node("front_end", disable_signals=True)
        cls.addClassCleanup(rospy.signal_shutdown, "the end")

    def play(self, *options):
        return subprocess.run([sys.executable, SCRIPT, self.bag, "--patience", "10", *options], stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, universal_newlines=True, timeout=300)

    def test_the_last_frames_come_out_and_are_recorded(self):
        front_end = FrontEnd(self.end_s)
        self.addCleanup(front_end.end)
        outputs = ["/camera/deblurred/image_raw", "/camera/deblurred/camera_info"]
        result = self.play("--record", self.recorded, "--outputs", *outputs)
        self.assertEqual(result.returncode, 0, result.stdout)
        self.assertEqual(front_end.frames, FRAMES)
        self.assertIn("%d of %d frames came out" % (FRAMES, FRAMES), result.stdout)
        with rosbag.Bag(self.recorded) as bag:
            for topic in outputs:
                stamps = [message.header.stamp.to_sec() for _, message, _ in bag.read_messages(topics=[topic])]
                self.assertEqual(stamps, [rospy.Time.from_sec(100 + i * PERIOD_S).to_sec() for i in range(FRAMES)])
            for i, (_, image, _) in enumerate(bag.read_messages(topics=outputs[:1])):
                self.assertEqual(image.data, bytes([i]) * BYTES)

    def test_what_drop_poor_keeps_back_is_not_waited_for(self):
        front_end = FrontEnd(self.end_s, drops=7)
        self.addCleanup(front_end.end)
        result = self.play()
        self.assertEqual(result.returncode, 0, result.stdout)
        self.assertIn("%d of %d frames came out" % (FRAMES - 7, FRAMES), result.stdout)
        self.assertIn(", 7 were dropped as POOR", result.stdout)

    def test_says_what_it_waits_for(self):
        """Nobody deblurs: the bag is never played."""
        began = time.monotonic()
        player = subprocess.Popen([sys.executable, SCRIPT, self.bag, "--patience", "20"], stdout=subprocess.PIPE,
                                  stderr=subprocess.STDOUT, universal_newlines=True)
        self.addCleanup(player.stdout.close)
        self.assertEqual(player.stdout.readline(), "waiting for the nodelet's outputs, for 20 s at most\n")
        self.assertGreater(time.monotonic() - began, 5)
        output, _ = player.communicate(timeout=DEADLINE_S)
        self.assertEqual(player.returncode, 1)
        self.assertIn("waited 20 s in vain for the nodelet's outputs", output)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
