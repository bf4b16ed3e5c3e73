"""Which motion a recording still lacks for a calibration, from the gyroscope alone.

calibrate needs rotation about all axes, at 0.5 rad/s and more, that changes its direction (doc/guides/calibration.md).
How the IMU is mounted on the camera is not known here: rotation is counted about its own principal axes.
"""
import numpy as np

FAST_RAD_S = 0.5
FAST_S = 8.0  # of rotation that fast
SECOND_RAD_S, THIRD_RAD_S = 0.2, 0.1  # root mean square about the second and third principal axis
REVERSED_RAD_S = 0.3  # on either side of 0 about the first one
REVERSALS = 6
LONGEST_GAP_S = 0.1  # between samples, else nothing is known of the motion


class WantedMotion:
    def __init__(self):
        self._times_s, self._rates = [], []

    def add(self, t_s, rate_rad_s):
        """A sample, by its stamp; one that is not newer than the last is left out."""
        if np.all(np.isfinite(rate_rad_s)) and (not self._times_s or t_s > self._times_s[-1]):
            self._times_s.append(t_s)
            self._rates.append(rate_rad_s)

    def state(self):
        """(share, text): how much of the motion is there, 0 to 1, and which is wanted next; empty text: enough."""
        if len(self._times_s) < 2:
            return 0.0, "no samples of the IMU yet"
        rates = np.array(self._rates, dtype=float)
        rates -= np.median(rates, axis=0)  # the bias
        steps_s = np.minimum(np.diff(self._times_s, prepend=self._times_s[0]), LONGEST_GAP_S)
        fast = np.linalg.norm(rates, axis=1) >= FAST_RAD_S
        if not fast.any():
            return 0.0, "rotate the camera: back and forth, faster than %.1f rad/s" % FAST_RAD_S
        # Of the time in motion: pauses do no harm.
        values, axes = np.linalg.eigh(rates[fast].T @ rates[fast] / fast.sum())
        third_rad_s, second_rad_s, _ = np.sqrt(np.maximum(values, 0))
        signs = np.sign(np.where(np.abs(rates @ axes[:, 2]) > REVERSED_RAD_S, rates @ axes[:, 2], 0))
        signs = signs[signs != 0]
        parts = [(steps_s[fast].sum() / FAST_S, "keep rotating the camera"),
                 (second_rad_s / SECOND_RAD_S, "rotate it about another axis, too: pan, tilt and roll are wanted"),
                 (third_rad_s / THIRD_RAD_S, "rotate it about the third axis, too: pan, tilt and roll are wanted"),
                 (np.count_nonzero(np.diff(signs)) / REVERSALS, "change the direction more often: back and forth")]
        missing = [text for share, text in parts[1:] + parts[:1] if share < 1]
        return min(1.0, sum(min(1.0, share) for share, _ in parts) / len(parts)), missing[0] if missing else ""
