"""What report.py measures on a frame: PSNR, SIFT keypoints and their matches, and how well keypoints are rectified."""
import math

import cv2
import numpy as np

from report_bags import DEBLURRED, STATUS_NAMES, Field, decode, stamp_ns, to_grey

SIFT_CONTRAST = 0.01  # as in the package: blurred images have little contrast
SIFT_COUNTED = 0.04 / 3  # keypoints are counted by OpenCV's default threshold, here on the response of one layer of three
SIFT_MATCHED = 1000  # the strongest are matched, as many for blurred as for deblurred images
MATCH_RATIO = 0.8  # Lowe's ratio, as in the paper's matching
CORRECT_PX = 3.0  # a match with the truth is correct when it is this near
RANSAC_PX = 5.0  # inliers between consecutive frames; rolling shutter leaves a homography some slack
FLOW_CHECK_PX = 0.1  # forward and backward flow between the truth images must agree to this
MOVED_PX = 1.0  # keypoints that the rolling shutter moved less would only show the noise of the measurement


def psnr(image, truth, mask=None):
    """Peak signal-to-noise ratio [dB] of 8-bit images."""
    difference = image.astype(np.float64) - truth.astype(np.float64)
    if mask is not None:
        difference = difference[mask]
    if difference.size == 0:
        return None
    error = float(np.mean(difference ** 2))
    return 99.0 if error == 0 else 10 * math.log10(255.0 ** 2 / error)


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


class MeasuredFrame:
    """A Frame with its output and blur field: the images, and in `row` what report.json says of it.

    previous: the MeasuredFrame before, or None. rectification_px: errors of raw and rectified keypoints (see
    rectification_errors), or None without truth.
    """

    def __init__(self, frame, previous):
        self.index = frame.index
        self.field = Field(frame.field)
        self.before, self.after = decode(frame.image), decode(frame.output)
        self.truth = decode(frame.sharp) if frame.sharp is not None else None
        self.rectification_px = None
        self.row = {
            "frame": frame.index, "stamp_ns": stamp_ns(frame.image), "reason": self.field.reason_name,
            "reason_text": self.field.reason_text,
            "identical": frame.image.data == frame.output.data and frame.image.encoding == frame.output.encoding,
            "median_extent_px": self.field.median_extent(),
            "blocks": {n: int(np.count_nonzero(self.field.status == i)) for i, n in enumerate(STATUS_NAMES)}}
        center = self.field.center()
        if center:
            self.row["center_extent_px"], self.row["center_angle_deg"] = center
        self._features = [Features(to_grey(image)) for image in (self.before, self.after)]
        self._count_features(previous)
        if self.truth is not None:
            self._compare_with_truth()
        if frame.keypoints is not None:
            self._measure_keypoints(frame.keypoints, frame.global_shutter)

    def _count_features(self, previous):
        self.row["keypoints_before"], self.row["keypoints_after"] = (f.count for f in self._features)
        if previous:
            self.row["consecutive_matches_before"], self.row["consecutive_matches_after"] = (
                p.inliers(f) for p, f in zip(previous._features, self._features))

    def _compare_with_truth(self):
        row, images = self.row, (self.before, self.after)
        row["psnr_before_db"], row["psnr_after_db"] = (psnr(image, self.truth) for image in images)
        mask = self.field.mask(DEBLURRED) if self.field.status.size else np.zeros(self.before.shape[:2], dtype=bool)
        row["psnr_blocks_before_db"], row["psnr_blocks_after_db"] = (psnr(image, self.truth, mask) for image in images)
        truth_features = Features(to_grey(self.truth))
        row["truth_keypoints"] = truth_features.count
        row["truth_matches_before"], row["truth_matches_after"] = (
            f.correct_against_truth(truth_features) for f in self._features)

    def _measure_keypoints(self, message, global_shutter):
        self.row["published_keypoints"] = len(message.keypoints)
        self.row["rectified_keypoints"] = sum(k.rectified for k in message.keypoints)
        if self.truth is None or global_shutter is None or message.reference_time.to_nsec() != stamp_ns(global_shutter):
            return
        self.rectification_px = rectification_errors(message, to_grey(self.truth), to_grey(decode(global_shutter)))
        raw, rectified = self.rectification_px
        if raw.size:
            self.row["rectification_raw_px"] = float(np.median(raw))
            self.row["rectification_rectified_px"] = float(np.median(rectified))


def rectification_summary(errors_px):
    """Medians over the keypoints of all frames, and over those that moved by more than MOVED_PX; None without any."""
    if not sum(raw.size for raw, _ in errors_px):
        return None
    raw, rectified = (np.concatenate(errors) for errors in zip(*errors_px))
    moved = raw > MOVED_PX
    return {"keypoints": int(raw.size), "raw_median_px": float(np.median(raw)),
            "rectified_median_px": float(np.median(rectified)), "moved_keypoints": int(np.count_nonzero(moved)),
            "moved_raw_median_px": float(np.median(raw[moved])) if moved.any() else None,
            "moved_rectified_median_px": float(np.median(rectified[moved])) if moved.any() else None}
