"""Trajectories of a body, and how far one is from the truth."""

import dataclasses

import numpy as np


def rotations(quaternions):
    """n x 4 (x y z w), of unit length -> n x 3 x 3, body to world."""
    x, y, z, w = np.moveaxis(np.asarray(quaternions, dtype=float), -1, 0)
    return np.stack([
        np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], -1),
        np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], -1),
        np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], -1)], -2)


def angle_deg(rotation):
    """Of one rotation matrix."""
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))


@dataclasses.dataclass
class Trajectory:
    """Poses of a body in a world whose z is up."""
    t_s: np.ndarray  # n, increasing
    p_m: np.ndarray  # n x 3
    q: np.ndarray    # n x 4, x y z w, body to world

    def at(self, t_s):
        """Between its poses, which are close to each other: positions linear, quaternions linear and normalised."""
        t_s = np.asarray(t_s, dtype=float)
        i = np.clip(np.searchsorted(self.t_s, t_s) - 1, 0, len(self.t_s) - 2)
        share = ((t_s - self.t_s[i]) / (self.t_s[i + 1] - self.t_s[i]))[:, None]
        q0, q1 = self.q[i], self.q[i + 1]
        q1 = np.where((q0 * q1).sum(1, keepdims=True) < 0, -q1, q1)
        q = (1 - share) * q0 + share * q1
        return Trajectory(t_s, (1 - share) * self.p_m[i] + share * self.p_m[i + 1],
                          q / np.linalg.norm(q, axis=1, keepdims=True))


def read_truth(path):
    """truth.csv of slam_sequences."""
    rows = np.loadtxt(path, delimiter=",", comments="#")
    return Trajectory(1e-9 * rows[:, 0], rows[:, 1:4], rows[:, [5, 6, 7, 4]])


def common(estimate, truth):
    """The part of an estimate of which the truth is known, and that truth."""
    inside = (estimate.t_s >= truth.t_s[0]) & (estimate.t_s <= truth.t_s[-1])
    estimate = Trajectory(estimate.t_s[inside], estimate.p_m[inside], estimate.q[inside])
    return estimate, truth.at(estimate.t_s)


def aligned(estimate, truth):
    """The estimate's positions after the rotation about z and the shift that bring them nearest to the truth's, which
    is what gravity leaves undetermined (Zhang and Scaramuzza, IROS 2018, section III-C)."""
    from_m, to_m = estimate.p_m - estimate.p_m.mean(0), truth.p_m - truth.p_m.mean(0)
    covariance = to_m[:, :2].T @ from_m[:, :2]
    yaw = np.arctan2(covariance[1, 0] - covariance[0, 1], covariance[0, 0] + covariance[1, 1])
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    return from_m @ about_z.T + truth.p_m.mean(0)


def absolute_error_m(estimate, truth):
    """Root of the mean squared distance after alignment."""
    return float(np.sqrt(((aligned(estimate, truth) - truth.p_m) ** 2).sum(1).mean()))


def relative_errors(estimate, truth, span_s):
    """Of pieces of span_s, in percent of the way: where the end of a piece is, seen from its beginning (ibid., III-D).
    A new piece begins every tenth of that."""
    way_m = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(truth.p_m, axis=0), axis=1))])
    R_estimate, R_truth = rotations(estimate.q), rotations(truth.q)
    errors = []
    for begin_s in np.arange(estimate.t_s[0], estimate.t_s[-1] - span_s, span_s / 10):
        i, j = np.searchsorted(estimate.t_s, [begin_s, begin_s + span_s])
        seen_m = R_estimate[i].T @ (estimate.p_m[j] - estimate.p_m[i])
        true_m = R_truth[i].T @ (truth.p_m[j] - truth.p_m[i])
        errors.append(100 * np.linalg.norm(seen_m - true_m) / (way_m[j] - way_m[i]))
    return np.array(errors)
