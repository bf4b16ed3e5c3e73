"""The cameras and IMUs of a running system, and a recording of some of its topics.

Needs a node: rospy.init_node() comes first.
"""
import threading
import time

import rosbag
import rospy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu

from gyro_deblur.msg import Exposure

POLL_S = 0.1
COMPRESSED = "/compressed"  # image_transport's name below that of the image
IMAGE_TYPES = {Image._type: Image, CompressedImage._type: CompressedImage}
# Images that this package publishes, and depth, are not offered as cameras.
OWN_OUTPUTS = ("/deblurred/image_raw", "/global_shutter/image_raw", "/blur_overlay", "/trust_mask")
DEPTH_NAMES, DEPTH_ENCODINGS = ("depth", "disparity"), ("16UC1", "32FC1")


class Stream:
    """One topic: how often its messages come, and the first of them."""

    def __init__(self, topic, kind):
        self.topic, self.kind = topic, kind
        self.first, self.size_bytes = None, 0
        self._count, self._begin_s, self._end_s = 0, 0.0, 0.0
        self._subscriber = rospy.Subscriber(topic, rospy.AnyMsg, self._on_message, buff_size=2**24)

    def _on_message(self, message):
        self._end_s = time.monotonic()
        if self._count == 0:
            self._begin_s, self.size_bytes = self._end_s, len(message._buff)
            if message._connection_header["md5sum"] == self.kind._md5sum:
                self.first = self.kind().deserialize(message._buff)
        self._count += 1

    def rate_hz(self):
        """0 before there are two messages."""
        span_s = self._end_s - self._begin_s
        return (self._count - 1) / span_s if span_s > 0 else 0.0

    def close(self):
        self._subscriber.unregister()


def in_namespace_of(topic, name):
    """The topic of that name in the namespace of another one."""
    return topic.rsplit("/", 1)[0] + "/" + name


class Camera:
    """A topic of images with its camera_info (or None) and its topic of exposure messages (or "")."""

    def __init__(self, stream, info, exposure):
        self.topic, self.rate_hz = stream.topic, stream.rate_hz()
        self.bytes_per_s = stream.size_bytes * self.rate_hz
        self.transport = "compressed" if stream.kind is CompressedImage else "raw"
        self.image = self.topic[:-len(COMPRESSED)] if self.transport == "compressed" else self.topic
        namespace, self.name = self.image.rsplit("/", 1)
        self.namespace = namespace or "/"
        self.first, self.info, self.exposure = stream.first, info, exposure

    def is_depth(self):
        return (any(name in self.topic for name in DEPTH_NAMES) or
                getattr(self.first, "encoding", "") in DEPTH_ENCODINGS)

    def is_calibrated(self):
        return self.info is not None and self.info.K[0] > 0

    def describe(self):
        if self.first is None:
            return "no image within the time of looking"
        what = ("%dx%d %s" % (self.first.width, self.first.height, self.first.encoding) if self.transport == "raw"
                else self.first.format.strip() or "compressed")
        info = ("without camera_info" if self.info is None else
                "calibrated" if self.is_calibrated() else "camera_info is not calibrated")
        return "%s, %.1f Hz, %s%s" % (what, self.rate_hz, info, ", exposure messages" if self.exposure else "")


def find_inputs(look_s):
    """(cameras, IMUs): Camera and Stream objects of everything that is published, sorted by their topics.

    look_s: how long rates are measured; up to three times as long if a stream has sent fewer than two messages.
    """
    types = dict(rospy.get_published_topics())
    images = {topic: IMAGE_TYPES[kind] for topic, kind in types.items()
              if kind in IMAGE_TYPES and not topic.replace(COMPRESSED, "").endswith(OWN_OUTPUTS)}
    # The compressed version of a topic is not another camera.
    images = {topic: kind for topic, kind in images.items()
              if not (topic.endswith(COMPRESSED) and topic[:-len(COMPRESSED)] in images)}
    streams = [Stream(topic, kind) for topic, kind in sorted(images.items())]
    imus = [Stream(topic, Imu) for topic, kind in sorted(types.items()) if kind == Imu._type]
    infos = {topic: Stream(topic, CameraInfo) for topic, kind in types.items() if kind == CameraInfo._type}
    until_s = time.monotonic() + 3 * look_s
    time.sleep(look_s)
    while time.monotonic() < until_s and not all(stream.rate_hz() for stream in streams + imus):
        time.sleep(POLL_S)
    cameras = []
    for stream in streams:
        image = stream.topic[:-len(COMPRESSED)] if stream.kind is CompressedImage else stream.topic
        info, exposure = infos.get(in_namespace_of(image, "camera_info")), in_namespace_of(image, "exposure")
        camera = Camera(stream, info and info.first, exposure if types.get(exposure) == Exposure._type else "")
        if not camera.is_depth():
            cameras.append(camera)
    for stream in streams + imus + list(infos.values()):
        stream.close()
    return cameras, imus


class Recording:
    """Writes topics into a bag as their messages come, and hands the IMU's to on_imu(t_s, rate_rad_s)."""

    def __init__(self, path, topics, image, imu, on_imu):
        self._image, self._imu, self._on_imu = image, imu, on_imu
        self._lock = threading.Lock()
        self._bag = rosbag.Bag(path, "w")
        self.images = self.samples = 0
        self.last_image_s = self.last_sample_s = time.monotonic()
        self._subscribers = [rospy.Subscriber(topic, rospy.AnyMsg, self._on_message, topic, buff_size=2**24)
                             for topic in topics]

    def _on_message(self, message, topic):
        with self._lock:
            if self._bag is None:
                return
            header = message._connection_header  # rospy has no other access to it
            # Simulated time is 0 before it begins, which a bag refuses.
            at = max(rospy.Time.now(), rospy.Time(0, 1))
            raw = (header["type"], message._buff, header["md5sum"], None)
            self._bag.write(topic, raw, at, raw=True, connection_header=dict(header, topic=topic))
            if topic == self._image:
                self.images += 1
                self.last_image_s = time.monotonic()
            if topic == self._imu and header["md5sum"] == Imu._md5sum:
                self.samples += 1
                self.last_sample_s = time.monotonic()
                sample = Imu().deserialize(message._buff)
                rate = sample.angular_velocity
                self._on_imu(sample.header.stamp.to_sec(), (rate.x, rate.y, rate.z))

    def silent_s(self):
        """For how long there has been no image, or no sample."""
        return time.monotonic() - min(self.last_image_s, self.last_sample_s)

    def close(self):
        for subscriber in self._subscribers:
            subscriber.unregister()
        with self._lock:
            self._bag.close()
            self._bag = None
