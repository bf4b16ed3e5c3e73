#!/usr/bin/env python3
"""Compares a bag of blurred images with the bag that gyro_deblur made of it: pictures, plots and numbers.

Reads image_raw from INPUT, the outputs (deblurred/image_raw, keypoints, blur_field, blur_overlay, /diagnostics) from
OUTPUT, and the simulator's truth (/truth/sharp, /truth/global_shutter) from INPUT where it is there. Writes report.md,
report.json and PNG pictures into a folder.
"""
import argparse
import json
import math
import os
import sys

import cv2
import numpy as np

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the backend has to be chosen first)
import rosbag  # noqa: E402
from tqdm import tqdm  # noqa: E402

STATUS_NAMES = ["SHARP", "DEBLURRED", "REJECTED", "TOO_LARGE", "NO_GYRO", "BENT"]
DEBLURRED = STATUS_NAMES.index("DEBLURRED")
NO_GYRO = STATUS_NAMES.index("NO_GYRO")

SIFT_CONTRAST = 0.01  # as in the package: blurred images have little contrast
SIFT_COUNTED = 0.04 / 3  # keypoints are counted by OpenCV's default threshold, here on the response of one layer of three
SIFT_MATCHED = 1000  # the strongest are matched, as many for blurred as for deblurred images
MATCH_RATIO = 0.8  # Lowe's ratio, as in the paper's matching
CORRECT_PX = 3.0  # a match with the truth is correct when it is this near
RANSAC_PX = 5.0  # inliers between consecutive frames; rolling shutter leaves a homography some slack
FLOW_CHECK_PX = 0.1  # forward and backward flow between the truth images must agree to this

BAYER_TO_BGR = {
    "bayer_rggb8": cv2.COLOR_BayerBG2BGR,
    "bayer_bggr8": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg8": cv2.COLOR_BayerGR2BGR,
    "bayer_grbg8": cv2.COLOR_BayerGB2BGR,
}


def fail(text):
    """One line on stderr, exit code 1."""
    sys.exit("report.py: " + text)


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
            fail("%s: topic %s: %s cannot be read: %s" % (bag.filename, topic, last, error or type(error).__name__))
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
    found = [t for t, kind in types.items() if kind == message_type and ("/" + t.lstrip("/")).endswith("/" + suffix)]
    if len(found) == 1:
        return found[0]
    if not found and not required:
        return None
    fail("%s: %s topic */%s of type %s; the bag has %s" % (
        path, "no" if not found else "more than one", suffix, message_type, ", ".join(sorted(types)) or "no topics"))
    return None


def psnr(image, truth, mask=None):
    """Peak signal-to-noise ratio [dB] of 8-bit images."""
    difference = image.astype(np.float64) - truth.astype(np.float64)
    if mask is not None:
        difference = difference[mask]
    if difference.size == 0:
        return None
    error = float(np.mean(difference ** 2))
    return 99.0 if error == 0 else 10 * math.log10(255.0 ** 2 / error)


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


class Features:
    """SIFT keypoints and descriptors of one image, and matches between two."""

    _sift = None

    def __init__(self, grey):
        if Features._sift is None:
            Features._sift = cv2.SIFT_create(contrastThreshold=SIFT_CONTRAST)
        found = sorted(Features._sift.detect(grey, None), key=lambda k: -k.response)
        self.count = sum(k.response >= SIFT_COUNTED for k in found)
        keypoints, self.descriptors = Features._sift.compute(grey, found[:SIFT_MATCHED])
        self.points = np.array([k.pt for k in keypoints], dtype=np.float32).reshape(-1, 2)

    def matches(self, other):
        """Index pairs that pass the ratio test."""
        if self.descriptors is None or other.descriptors is None or len(other.points) < 2:
            return np.zeros((0, 2), dtype=int)
        pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(self.descriptors, other.descriptors, k=2)
        good = [(m.queryIdx, m.trainIdx) for m, n in (p for p in pairs if len(p) == 2)
                if m.distance < MATCH_RATIO * n.distance]
        return np.array(good, dtype=int).reshape(-1, 2)

    def correct_against_truth(self, truth):
        """Matches with an image of the same geometry that are at the same place."""
        pairs = self.matches(truth)
        distance = np.linalg.norm(self.points[pairs[:, 0]] - truth.points[pairs[:, 1]], axis=1)
        return int(np.count_nonzero(distance <= CORRECT_PX))

    def inliers(self, other):
        """Matches that agree with one homography."""
        pairs = self.matches(other)
        if len(pairs) < 4:
            return 0
        cv2.setRNGSeed(0)
        _, mask = cv2.findHomography(self.points[pairs[:, 0]], other.points[pairs[:, 1]], cv2.RANSAC, RANSAC_PX)
        return 0 if mask is None else int(np.count_nonzero(mask))


def rectification_errors(message, sharp, global_shutter):
    """Distances [px] of raw and rectified keypoints from where the global-shutter truth has the same point.

    The truth is the optical flow between the two truth images, kept where forward and backward flow agree.
    """
    chosen = [k for k in message.keypoints if k.rectified]
    if not chosen:
        return np.zeros(0), np.zeros(0)
    raw = np.array([[k.x, k.y] for k in chosen], dtype=np.float32)
    rectified = np.array([[k.rectified_x, k.rectified_y] for k in chosen], dtype=np.float32)
    options = dict(winSize=(21, 21), maxLevel=5,
                   criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 0.001))
    forward, found, _ = cv2.calcOpticalFlowPyrLK(sharp, global_shutter, raw[:, None], None, **options)
    backward, found_back, _ = cv2.calcOpticalFlowPyrLK(global_shutter, sharp, forward, None, **options)
    good = (found[:, 0] == 1) & (found_back[:, 0] == 1)
    good &= np.linalg.norm(backward[:, 0] - raw, axis=1) < FLOW_CHECK_PX
    truth = forward[good, 0]
    return np.linalg.norm(raw[good] - truth, axis=1), np.linalg.norm(rectified[good] - truth, axis=1)


def read_diagnostics(bag, topic):
    """The last values of gyro_deblur's diagnostics; of rates and latencies the means or maxima over all periods."""
    latest, periods = {}, {}
    for message in messages_of(bag, topic):
        for status in message.status:
            values = {v.key: v.value for v in status.values}
            if "frames out" not in values:
                continue
            latest = values
            for key, value in values.items():
                if key.endswith(("mean [ms]", "max [ms]", "rate [Hz]")):
                    periods.setdefault(key, []).append(float(value))
    for key, values in periods.items():
        busy = [v for v in values if v > 0] or [0.0]
        latest[key] = "%.2f" % (max(busy) if key.endswith("max [ms]") else float(np.mean(busy)))
    return latest


def label(image, text):
    """The image in BGR with a caption in its upper left corner."""
    out = to_bgr(image).copy()
    scale = max(0.5, out.shape[1] / 1200.0)
    thickness = max(1, int(round(scale)))
    (width, height), base = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, thickness)
    cv2.rectangle(out, (0, 0), (width + 12, height + base + 10), (0, 0, 0), -1)
    cv2.putText(out, text, (6, height + 6), cv2.FONT_HERSHEY_SIMPLEX, scale, (255, 255, 255), thickness, cv2.LINE_AA)
    return out


def crop_windows(grey, mask, count, size):
    """The windows with most detail, apart from each other, inside the mask: (x, y) of their corners."""
    detail = np.abs(cv2.Laplacian(cv2.GaussianBlur(grey, (0, 0), 1.5), cv2.CV_32F))
    detail[~mask] = 0
    score = cv2.boxFilter(detail, -1, size, anchor=(0, 0), borderType=cv2.BORDER_CONSTANT)
    score = score[:grey.shape[0] - size[1] + 1, :grey.shape[1] - size[0] + 1].copy()
    windows = []
    for _ in range(count):
        _, best, _, (x, y) = cv2.minMaxLoc(score)
        if best <= 0:
            break
        windows.append((x, y))
        score[max(0, y - size[1]):y + size[1], max(0, x - size[0]):x + size[0]] = 0
    return windows


class Pictures:
    """Before and after of the frames with most deblurred blur."""

    def __init__(self, folder, count):
        self.folder, self.count = folder, count
        self.kept = []  # (score, index, before, after, truth, overlay, mask)

    def offer(self, index, field, before, after, truth, overlay):
        deblurred = field.status == DEBLURRED
        if not np.any(deblurred):
            return
        score = float(np.mean(deblurred)) * float(np.median(field.extent[deblurred]))
        self.kept.append((score, index, before, after, truth, overlay, field.mask(DEBLURRED)))
        self.kept.sort(key=lambda entry: -entry[0])
        del self.kept[self.count:]

    def write(self):
        """Files by frame, most blurred first."""
        files = []
        for _, index, before, after, truth, overlay, mask in self.kept:
            names = {"frame": index}

            def save(kind, image):
                names[kind] = "frame_%04d_%s.png" % (index, kind)
                cv2.imwrite(os.path.join(self.folder, names[kind]), image)

            save("before", before)
            save("after", after)
            parts = [("before", before), ("after", after)] + ([("truth", truth)] if truth is not None else [])
            save("comparison", np.hstack([label(image, text) for text, image in parts]))
            size = (before.shape[1] // 5, before.shape[0] // 5)
            rows = []
            for x, y in crop_windows(to_grey(after), mask, 3, size):
                cells = [image[y:y + size[1], x:x + size[0]] for _, image in parts]
                cells = [cv2.resize(c, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC) for c in cells]
                rows.append(np.hstack([label(c, text) for c, (text, _) in zip(cells, parts)]))
            if rows:
                save("crops", np.vstack(rows))
            if overlay is not None:
                save("overlay", overlay)
            files.append(names)
        return files


def plot(rows, path):
    index = [r["frame"] for r in rows]
    curves = [("median blur extent [px]", [("predicted", "median_extent_px")])]
    if any(r.get("psnr_before_db") is not None for r in rows):
        curves.append(("PSNR against the sharp truth [dB]",
                       [("before", "psnr_before_db"), ("after", "psnr_after_db")]))
        curves.append(("SIFT matches with the sharp truth, correct",
                       [("before", "truth_matches_before"), ("after", "truth_matches_after")]))
    curves.append(("SIFT keypoints", [("before", "keypoints_before"), ("after", "keypoints_after")]))
    curves.append(("SIFT matches with the frame before, inliers",
                   [("before", "consecutive_matches_before"), ("after", "consecutive_matches_after")]))
    figure, axes = plt.subplots(len(curves), 1, figsize=(9, 2.4 * len(curves)), sharex=True)
    for axis, (title, series) in zip(np.atleast_1d(axes), curves):
        for name, key in series:
            axis.plot(index, [np.nan if r.get(key) is None else r[key] for r in rows], marker=".", label=name)
        axis.set_ylabel(title, fontsize=7)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    np.atleast_1d(axes)[-1].set_xlabel("frame")
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def mean_of(rows, key):
    values = [r[key] for r in rows if r.get(key) is not None]
    return float(np.mean(values)) if values else None


def analyse(arguments):
    for path in (arguments.input, arguments.output):
        if not os.path.isfile(path):
            fail(path + ": no such file")
    try:
        source, result = rosbag.Bag(arguments.input), rosbag.Bag(arguments.output)
    except rosbag.ROSBagException as error:
        fail("not a bag that can be read: %s" % error)
    types_in, types_out = topic_types(source), topic_types(result)
    image_type = "sensor_msgs/Image"
    image_topic = find_topic(types_in, "image_raw", image_type, arguments.input)
    deblurred_topic = find_topic(types_out, "deblurred/image_raw", image_type, arguments.output)
    field_topic = find_topic(types_out, "blur_field", "gyro_deblur/BlurField", arguments.output)
    keypoint_topic = find_topic(types_out, "keypoints", "gyro_deblur/KeypointArray", arguments.output, False)
    overlay_topic = find_topic(types_out, "blur_overlay", image_type, arguments.output, False)
    info_topic = find_topic(types_out, "deblurred/camera_info", "sensor_msgs/CameraInfo", arguments.output, False)
    diagnostics_topic = find_topic(types_out, "diagnostics", "diagnostic_msgs/DiagnosticArray", arguments.output, False)
    sharp_topic = find_topic(types_in, "truth/sharp", image_type, arguments.input, False)
    global_topic = find_topic(types_in, "truth/global_shutter", image_type, arguments.input, False)

    os.makedirs(arguments.folder, exist_ok=True)
    stamps_out = [stamp_ns(m) for m in messages_of(result, deblurred_topic)]
    info_stamps = [stamp_ns(m) for m in messages_of(result, info_topic)]

    deblurred, fields = Stream(result, deblurred_topic), Stream(result, field_topic)
    keypoints, overlays = Stream(result, keypoint_topic), Stream(result, overlay_topic)
    sharps = Stream(source, sharp_topic)
    # The global-shutter truth carries the reference time: it belongs to the frame beside it in the bag.
    globals_ = messages_of(source, global_topic)

    pictures = Pictures(arguments.folder, arguments.pictures)
    rows, errors_raw, errors_rectified, stamps_in = [], [], [], []
    previous = None
    total = types_in and source.get_message_count(image_topic)
    for index, message in enumerate(tqdm(messages_of(source, image_topic), total=total, desc="report", unit="frame",
                                         disable=not sys.stderr.isatty())):
        ns = stamp_ns(message)
        stamps_in.append(ns)
        sharp_message, global_message = sharps.at(ns), next(globals_, None)
        out_message, field_message = deblurred.at(ns), fields.at(ns)
        if out_message is None or field_message is None or not is_whole(message):
            previous = None
            continue
        field = Field(field_message)
        before, after = decode(message), decode(out_message)
        row = {"frame": index, "stamp_ns": ns, "reason": field.reason_name, "reason_text": field.reason_text,
               "identical": message.data == out_message.data and message.encoding == out_message.encoding,
               "median_extent_px": field.median_extent(),
               "blocks": {n: int(np.count_nonzero(field.status == i)) for i, n in enumerate(STATUS_NAMES)}}
        center = field.center()
        if center:
            row["center_extent_px"], row["center_angle_deg"] = center

        features = [Features(to_grey(image)) for image in (before, after)]
        row["keypoints_before"], row["keypoints_after"] = (f.count for f in features)
        if previous:
            row["consecutive_matches_before"], row["consecutive_matches_after"] = (
                p.inliers(f) for p, f in zip(previous, features))
        previous = features

        truth = decode(sharp_message) if sharp_message is not None else None
        if truth is not None:
            row["psnr_before_db"], row["psnr_after_db"] = psnr(before, truth), psnr(after, truth)
            mask = field.mask(DEBLURRED) if field.status.size else np.zeros(before.shape[:2], dtype=bool)
            row["psnr_blocks_before_db"] = psnr(before, truth, mask)
            row["psnr_blocks_after_db"] = psnr(after, truth, mask)
            truth_features = Features(to_grey(truth))
            row["truth_keypoints"] = truth_features.count
            row["truth_matches_before"], row["truth_matches_after"] = (
                f.correct_against_truth(truth_features) for f in features)

        keypoint_message = keypoints.at(ns)
        if keypoint_message is not None:
            row["published_keypoints"] = len(keypoint_message.keypoints)
            row["rectified_keypoints"] = sum(k.rectified for k in keypoint_message.keypoints)
            if truth is not None and global_message is not None:
                if keypoint_message.reference_time.to_nsec() == stamp_ns(global_message):
                    raw, rectified = rectification_errors(keypoint_message, to_grey(truth),
                                                          to_grey(decode(global_message)))
                    errors_raw.append(raw)
                    errors_rectified.append(rectified)
                    if raw.size:
                        row["rectification_raw_px"] = float(np.median(raw))
                        row["rectification_rectified_px"] = float(np.median(rectified))
        rows.append(row)
        overlay_message = overlays.at(ns)
        if field.status.size:
            pictures.offer(index, field, before, after, truth,
                           decode(overlay_message) if overlay_message is not None else None)

    positions = {ns: i for i, ns in enumerate(stamps_in)}
    order = [positions.get(ns, -1) for ns in stamps_out]
    changed = [r for r in rows if not r["identical"]]
    report = {
        "input": os.path.basename(arguments.input),
        "output": os.path.basename(arguments.output),
        "frames_in": len(stamps_in),
        "frames_out": len(stamps_out),
        "frames_changed": len(changed),
        "frames_missing": sorted(set(range(len(stamps_in))) - set(order)),
        "stamps_kept": all(i >= 0 for i in order),
        "order_kept": all(a < b for a, b in zip(order, order[1:])),
        "camera_info_with_every_image": info_stamps == stamps_out if info_topic else None,
        "reasons": {name: sum(r["reason"] == name for r in rows) for name in sorted({r["reason"] for r in rows})},
        "blocks": {n: sum(r["blocks"][n] for r in rows) for n in STATUS_NAMES},
        "changed_frames_mean": {key: mean_of(changed, key) for key in (
            "median_extent_px", "psnr_before_db", "psnr_after_db", "psnr_blocks_before_db", "psnr_blocks_after_db",
            "keypoints_before", "keypoints_after", "truth_matches_before", "truth_matches_after",
            "consecutive_matches_before", "consecutive_matches_after")},
        "diagnostics": read_diagnostics(result, diagnostics_topic),
        "frames": rows,
    }
    if errors_raw and sum(e.size for e in errors_raw):
        raw, rectified = np.concatenate(errors_raw), np.concatenate(errors_rectified)
        moved = raw > 1.0  # still frames would only tell the noise of the measurement
        report["rectification"] = {
            "keypoints": int(raw.size), "raw_median_px": float(np.median(raw)),
            "rectified_median_px": float(np.median(rectified)), "moved_keypoints": int(np.count_nonzero(moved)),
            "moved_raw_median_px": float(np.median(raw[moved])) if moved.any() else None,
            "moved_rectified_median_px": float(np.median(rectified[moved])) if moved.any() else None}
    report["pictures"] = pictures.write()
    plot(rows, os.path.join(arguments.folder, "plots.png"))
    return report


def throughput(bag_path, json_path):
    """What play_through.py measured, and what became of the frames."""
    with open(json_path, encoding="utf-8") as file:
        result = json.load(file)
    with rosbag.Bag(bag_path) as bag:
        types = topic_types(bag)
        topic = find_topic(types, "blur_field", "gyro_deblur/BlurField", bag_path)
        messages = list(messages_of(bag, topic))
        diagnostics = find_topic(types, "diagnostics", "diagnostic_msgs/DiagnosticArray", bag_path, False)
        result["diagnostics"] = read_diagnostics(bag, diagnostics)
    fields = [Field(m) for m in messages]
    stamps = [stamp_ns(m) for m in messages]
    result["size"] = [messages[0].image_width, messages[0].image_height] if messages else None
    result["order_kept"] = all(a < b for a, b in zip(stamps, stamps[1:]))
    result["reasons"] = {name: sum(f.reason_name == name for f in fields)
                         for name in sorted({f.reason_name for f in fields})}
    medians = [f.median_extent() for f in fields if f.status.size]
    result["median_extent_px"] = float(np.median(medians)) if medians else None
    return result


def throughput_lines(result):
    stages = ["%s %s ms" % (key[:-len(" mean [ms]")], value) for key, value in result["diagnostics"].items()
              if key.endswith(" mean [ms]")]
    return ["", "## Throughput", "",
            "- %s at %.1f Hz, median extent %s px, image only: %d frames in, %d out, sustained %.1f Hz on %d cores" % (
                "x".join(map(str, result["size"] or ["?"])), result["wanted_rate_hz"],
                number(result["median_extent_px"]), result["frames_in"], result["frames_out"], result["rate_hz"],
                os.cpu_count()),
            "- order kept: %s; reasons: %s" % (
                "yes" if result["order_kept"] else "**no**",
                ", ".join("%s %d" % item for item in result["reasons"].items())),
            "- mean latency by stage: " + ", ".join(stages)]


def number(value, digits=1):
    return "-" if value is None else "%.*f" % (digits, value)


def pair_line(title, values, key_before, key_after, unit, digits=1):
    before, after = values.get(key_before), values.get(key_after)
    if before is None and after is None:
        return None
    return "| %s | %s%s | %s%s |" % (title, number(before, digits), unit, number(after, digits), unit)


def write_markdown(report, arguments, path):
    yes = {True: "yes", False: "**no**", None: "-"}
    mean = report["changed_frames_mean"]
    lines = ["# " + arguments.title, "", "## Frames", "",
             "- in %d, out %d, of these changed by deblurring %d" % (
                 report["frames_in"], report["frames_out"], report["frames_changed"]),
             "- every output has its input's stamp: %s; order kept: %s; camera_info with every image: %s" % (
                 yes[report["stamps_kept"]], yes[report["order_kept"]], yes[report["camera_info_with_every_image"]]),
             "- reasons: " + ", ".join("%s %d" % item for item in report["reasons"].items()),
             "- blocks: " + ", ".join("%s %d" % item for item in report["blocks"].items())]
    if report["frames_missing"]:
        lines.append("- missing from the output: " + ", ".join(map(str, report["frames_missing"])))
    lines += ["", "## Before and after", "", "Means over the %d changed frames; median extent %s px." % (
        report["frames_changed"], number(mean["median_extent_px"])), "", "| | before | after |", "| --- | --- | --- |"]
    lines += [line for line in (
        pair_line("PSNR against the sharp truth, whole image", mean, "psnr_before_db", "psnr_after_db", " dB", 2),
        pair_line("PSNR, deblurred blocks", mean, "psnr_blocks_before_db", "psnr_blocks_after_db", " dB", 2),
        pair_line("SIFT keypoints (OpenCV's default threshold)", mean, "keypoints_before", "keypoints_after", "", 0),
        pair_line("correct SIFT matches with the sharp truth (1000 strongest, ratio %.1f, within %.0f px)" % (
            MATCH_RATIO, CORRECT_PX),
                  mean, "truth_matches_before", "truth_matches_after", "", 0),
        pair_line("SIFT matches with the frame before (1000 strongest, ratio %.1f, inliers of a homography)" % MATCH_RATIO, mean,
                  "consecutive_matches_before", "consecutive_matches_after", "", 0),
    ) if line]
    rectification = report.get("rectification")
    if rectification:
        lines += ["", "## Rolling-shutter rectification of keypoints", "",
                  "Median distance from the global-shutter truth, with the truth from optical flow between the truth "
                  "images.", "", "| keypoints | raw | rectified |", "| --- | --- | --- |",
                  "| all %d | %.2f px | %.2f px |" % (
                      rectification["keypoints"], rectification["raw_median_px"], rectification["rectified_median_px"])]
        if rectification["moved_keypoints"]:
            lines.append("| the %d that moved by more than 1 px | %.2f px | %.2f px |" % (
                rectification["moved_keypoints"], rectification["moved_raw_median_px"],
                rectification["moved_rectified_median_px"]))
    if report["diagnostics"]:
        lines += ["", "## Diagnostics of the nodelet", "", "Rates and mean latencies are means over the reporting periods.",
                  "", "| | |", "| --- | --- |"]
        lines += ["| %s | %s |" % item for item in report["diagnostics"].items()]
    if report.get("throughput"):
        lines += throughput_lines(report["throughput"])
    if report["pictures"]:
        lines += ["", "## Pictures", ""]
        for names in report["pictures"]:
            for kind in ("comparison", "crops", "overlay"):
                if kind in names:
                    lines += ["![frame %d, %s](%s)" % (names["frame"], kind, names[kind]), ""]
    lines += ["![over time](plots.png)", "", "## Every frame", "",
              "| frame | reason | extent at the centre | angle | blocks deblurred, rejected, bent, not covered "
              "| keypoints before, after | matches with the frame before: before, after |",
              "| --- | --- | --- | --- | --- | --- | --- |"]
    for row in report["frames"]:
        blocks = row["blocks"]
        lines.append("| %d | %s | %s px | %s deg | %d, %d, %d, %d of %d | %d, %d | %s, %s |" % (
            row["frame"], row["reason_text"] or row["reason"], number(row.get("center_extent_px")),
            number(row.get("center_angle_deg")), blocks["DEBLURRED"], blocks["REJECTED"], blocks["BENT"],
            blocks["NO_GYRO"], sum(blocks.values()), row["keypoints_before"], row["keypoints_after"],
            row.get("consecutive_matches_before", "-"), row.get("consecutive_matches_after", "-")))
    with open(path, "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("input", help="bag with the blurred images, and the truth if there is one")
    parser.add_argument("output", help="bag that deblur_bag wrote, or that was recorded from the nodelet")
    parser.add_argument("folder", help="where the report goes")
    parser.add_argument("--title", default="gyro_deblur: report")
    parser.add_argument("--pictures", type=int, default=2, help="how many frames, most blurred first [%(default)s]")
    parser.add_argument("--throughput", nargs=2, metavar=("BAG", "JSON"),
                        help="a bag recorded in another run and what play_through.py --json wrote of it")
    arguments = parser.parse_args()
    if arguments.pictures < 0:
        parser.error("--pictures %d is negative" % arguments.pictures)
    report = analyse(arguments)
    if arguments.throughput:
        report["throughput"] = throughput(*arguments.throughput)
    with open(os.path.join(arguments.folder, "report.json"), "w", encoding="utf-8") as file:
        json.dump(report, file, indent=2)
    write_markdown(report, arguments, os.path.join(arguments.folder, "report.md"))
    print("%s: %d frames in, %d out, %d changed" % (
        os.path.join(arguments.folder, "report.md"), report["frames_in"], report["frames_out"],
        report["frames_changed"]))


if __name__ == "__main__":
    main()
