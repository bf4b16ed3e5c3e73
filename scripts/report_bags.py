"""The two bags that report.py compares: images, blur fields and diagnostics as arrays and values, frame by frame."""
import collections
import math

import cv2
import numpy as np

from bag_input import open_bag
from report_tables import fail

STATUS_NAMES = ["SHARP", "DEBLURRED", "REJECTED", "TOO_LARGE", "NO_GYRO", "TOO_CURVED", "NOISY", "MASKED",
                "STATIC_EDGE"]
DEBLURRED = STATUS_NAMES.index("DEBLURRED")
NO_GYRO = STATUS_NAMES.index("NO_GYRO")

BAYER_TO_BGR = {
    "bayer_rggb8": cv2.COLOR_BayerBG2BGR,
    "bayer_bggr8": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg8": cv2.COLOR_BayerGR2BGR,
    "bayer_grbg8": cv2.COLOR_BayerGB2BGR,
}


def stamp_ns(message):
    return message.header.stamp.to_nsec()


def is_whole(message):
    """True when a sensor_msgs/Image has the bytes that its header announces; genpy does not look."""
    return message.height > 0 and message.step >= message.width > 0 and len(message.data) == message.height * message.step


def decode(message):
    """sensor_msgs/Image to an 8-bit grey or BGR array."""
    encoding = message.encoding
    deep = encoding.endswith("16") or encoding == "16UC1"
    dtype = np.dtype(">u2" if message.is_bigendian else "<u2") if deep else np.uint8
    rows = np.frombuffer(message.data, dtype=np.uint8).reshape(message.height, message.step)
    channels = {"mono": 1, "8UC1": 1, "16UC": 1, "baye": 1, "bgra": 4, "rgba": 4}.get(encoding[:4], 3)
    width_bytes = message.width * channels * np.dtype(dtype).itemsize
    pixels = np.ascontiguousarray(rows[:, :width_bytes]).view(dtype).reshape(message.height, message.width, channels)
    if deep:
        pixels = (pixels.astype(np.float32) / 257.0).round().astype(np.uint8)
    if encoding in BAYER_TO_BGR:
        return cv2.cvtColor(pixels, BAYER_TO_BGR[encoding])
    if channels == 1:
        return np.ascontiguousarray(pixels[:, :, 0])
    if encoding.startswith("rgb"):
        return np.ascontiguousarray(pixels[:, :, [2, 1, 0]])
    return np.ascontiguousarray(pixels[:, :, :3])


def to_grey(image):
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def to_bgr(image):
    return image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)


def messages_of(bag, topic):
    """The messages of a topic, in the order of their recording; none for no topic. Ends with one line at a damaged one."""
    reader = bag.read_messages(topics=[topic]) if topic else iter(())
    last = "the first one"
    while True:
        try:
            _, message, time = next(reader)
        except StopIteration:
            return
        except Exception as error:  # rosbag and genpy raise nearly anything for damaged bytes
            fail("%s: topic %s: %s cannot be read: %s" % (bag.filename, topic, last, str(error) or type(error).__name__))
        last = "the message after the one recorded at %.9f s" % time.to_sec()
        yield message


class Stream:
    """Messages of one topic in order of their stamps, asked for by stamp."""

    def __init__(self, bag, topic):
        self._messages = messages_of(bag, topic)
        self._next = next(self._messages, None)

    def at(self, ns):
        """The message with this stamp, or None. Stamps must be asked for in rising order."""
        while self._next is not None and stamp_ns(self._next) < ns:
            self._next = next(self._messages, None)
        if self._next is not None and stamp_ns(self._next) == ns:
            return self._next
        return None


def topic_types(bag):
    return {name: info.msg_type for name, info in bag.get_type_and_topic_info().topics.items()}


def find_topic(types, suffix, message_type, path, required=True):
    """The only topic of a type whose name ends with `suffix`."""
    ending = "/" + suffix.lstrip("/")
    found = [t for t, kind in types.items() if kind == message_type and ("/" + t.lstrip("/")).endswith(ending)]
    if len(found) == 1:
        return found[0]
    if not found and not required:
        return None
    fail("%s: %s topic */%s of type %s; the bag has %s" % (
        path, "no" if not found else "more than one", suffix, message_type, ", ".join(sorted(types)) or "no topics"))
    return None


class Field:
    """gyro_deblur/BlurField as arrays of rows x cols."""

    def __init__(self, message):
        self.reason = message.reason
        self.reason_text = message.reason_text
        self.names = {getattr(message, n): n[len("REASON_"):] for n in dir(message) if n.startswith("REASON_")}
        self.block = (message.block_width, message.block_height)
        shape = (message.rows, message.cols) if message.status else (0, 0)
        self.angle = np.array(message.angle, dtype=np.float64).reshape(shape)
        self.extent = np.array(message.extent, dtype=np.float64).reshape(shape)
        self.status = np.array(list(message.status), dtype=np.uint8).reshape(shape)
        self.size = (message.image_width, message.image_height)

    @property
    def reason_name(self):
        return self.names.get(self.reason, str(self.reason))

    def mask(self, status):
        """Pixels of the blocks with a status."""
        full = np.zeros((self.size[1], self.size[0]), dtype=bool)
        for row, col in zip(*np.nonzero(self.status == status)):
            y, x = row * self.block[1], col * self.block[0]
            full[y:y + self.block[1], x:x + self.block[0]] = True
        return full

    def median_extent(self):
        known = self.extent[self.status != NO_GYRO]
        return float(np.median(known)) if known.size else 0.0

    def center(self):
        """(extent [px], angle [deg] in (-90, 90]) of the block at the image centre, or None."""
        if not self.status.size:
            return None
        row = self.size[1] // 2 // self.block[1]
        col = self.size[0] // 2 // self.block[0]
        if self.status[row, col] == NO_GYRO:
            return None
        angle = math.degrees(self.angle[row, col])
        return float(self.extent[row, col]), angle - 180 if angle > 90 else angle


def read_diagnostics(bag, topic):
    """The last values of gyro_deblur's diagnostics; of rates and latencies the means or maxima over all periods."""
    latest, periods = {}, {}
    for message in messages_of(bag, topic):
        statuses = {status.name: {v.key: v.value for v in status.values} for status in message.status}
        # "NODE: image", whose rates nobody else has, and the node's other statuses.
        node = next((name[:-len("image")] for name, values in statuses.items()
                     if name.endswith(": image") and "output rate [Hz]" in values), None)
        if node is None:
            continue
        latest = {}
        for part in ("image", "IMU", "calibration", "timing"):
            latest.update(statuses.get(node + part, {}))
        for key, value in latest.items():
            if key.endswith(("mean [ms]", "max [ms]", "rate [Hz]")):
                periods.setdefault(key, []).append(float(value))
    for key, values in periods.items():
        busy = [v for v in values if v > 0] or [0.0]
        latest[key] = "%.2f" % (max(busy) if key.endswith("max [ms]") else float(np.mean(busy)))
    return latest


# An image of the input, and what belongs to it; all but index and image None where it is absent.
Frame = collections.namedtuple("Frame", "index image output field keypoints overlay sharp global_shutter")


class BagPair:
    """The bag of blurred images, perhaps with the truth, and the bag that gyro_deblur made of it."""

    def __init__(self, input_path, output_path, image_topic=None):
        self._source, self._result = open_bag(input_path), open_bag(output_path)
        types_in, types_out = topic_types(self._source), topic_types(self._result)
        image = "sensor_msgs/Image"
        self._image = find_topic(types_in, image_topic or "image_raw", image, input_path)
        self._deblurred = find_topic(types_out, "deblurred/image_raw", image, output_path)
        self._field = find_topic(types_out, "blur_field", "gyro_deblur/BlurField", output_path)
        self._keypoints = find_topic(types_out, "keypoints", "gyro_deblur/KeypointArray", output_path, False)
        self._overlay = find_topic(types_out, "blur_overlay", image, output_path, False)
        self._info = find_topic(types_out, "deblurred/camera_info", "sensor_msgs/CameraInfo", output_path, False)
        self._diagnostics = find_topic(types_out, "diagnostics", "diagnostic_msgs/DiagnosticArray", output_path, False)
        self._sharp = find_topic(types_in, "truth/sharp", image, input_path, False)
        self._global = find_topic(types_in, "truth/global_shutter", image, input_path, False)

    def count(self):
        """Images in the input."""
        return self._source.get_message_count(self._image)

    def stamps_out_ns(self):
        return [stamp_ns(m) for m in messages_of(self._result, self._deblurred)]

    def info_stamps_ns(self):
        """Of the output's camera_info; None without such a topic."""
        return [stamp_ns(m) for m in messages_of(self._result, self._info)] if self._info else None

    def diagnostics(self):
        return read_diagnostics(self._result, self._diagnostics)

    def frames(self):
        """A Frame for each image of the input, in order."""
        deblurred, fields = Stream(self._result, self._deblurred), Stream(self._result, self._field)
        keypoints, overlays = Stream(self._result, self._keypoints), Stream(self._result, self._overlay)
        sharps = Stream(self._source, self._sharp)
        # The global-shutter truth carries the reference time: it belongs to the adjacent frame in the bag.
        globals_ = messages_of(self._source, self._global)
        for index, message in enumerate(messages_of(self._source, self._image)):
            ns = stamp_ns(message)
            yield Frame(index, message, output=deblurred.at(ns), field=fields.at(ns), keypoints=keypoints.at(ns),
                        overlay=overlays.at(ns), sharp=sharps.at(ns), global_shutter=next(globals_, None))
