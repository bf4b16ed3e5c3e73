"""Models that COLMAP made, and how far they are from the truth."""

import numpy

from colmap import PIXEL_CENTER

MIN_TRACK = 3  # images in which a point that counts is visible, as in the paper
PLANE_RANSAC_M = 0.02
PLANE_TRIALS = 500
TRAJECTORY_TRIALS = 500
TRAJECTORY_RANSAC_M = 0.03


def rotation_matrix(q):
    w, x, y, z = q / numpy.linalg.norm(q)
    return numpy.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


class Pose:
    """Of a registered image: camera = R world + t; observations: (n, 2) pixels and their point ids (-1: none)."""

    def __init__(self, q, t, pixels, ids):
        self.R, self.t, self.pixels, self.ids = rotation_matrix(q), t, pixels, ids
        self.center = -self.R.T @ t


def read_model(folder):
    """Poses by image name, and points by id: (position, track length). See https://colmap.github.io/format.html."""
    poses, points = {}, {}
    lines = [line for line in (folder / "images.txt").read_text().splitlines() if not line.startswith("#")]
    for header, observations in zip(lines[0::2], lines[1::2]):
        words = header.split()
        numbers = numpy.array(words[1:8], float)
        seen = numpy.array(observations.split(), float).reshape(-1, 3)
        poses[words[9]] = Pose(numbers[:4], numbers[4:], seen[:, :2], seen[:, 2].astype(int))
    for line in (folder / "points3D.txt").read_text().splitlines():
        if line.startswith("#"):
            continue
        words = line.split()
        points[int(words[0])] = (numpy.array(words[1:4], float), (len(words) - 8) // 2)
    return poses, points


def largest_model(folder):
    """Poses and points (see read_model) of the model with most images in `folder`; None when there is none."""
    best = None
    for text in sorted(folder.glob("*_text")):
        poses, points = read_model(text)
        if best is None or len(poses) > len(best[0]):
            best = (poses, points)
    return best


def similarity(source, target):
    """Scale, rotation and translation that take (n, 3) source to target with least squares (Umeyama 1991)."""
    mean_source, mean_target = source.mean(axis=0), target.mean(axis=0)
    a, b = source - mean_source, target - mean_target
    u, d, vt = numpy.linalg.svd(b.T @ a / len(a))
    sign = numpy.diag([1, 1, numpy.sign(numpy.linalg.det(u @ vt))])
    R = u @ sign @ vt
    scale = numpy.trace(numpy.diag(d) @ sign) / (a * a).sum() * len(a)
    return scale, R, mean_target - scale * R @ mean_source


def robust_similarity(source, target, rng):
    """As similarity(), from the largest set of cameras that agree, so that a few wrong ones do not distort it."""
    best = numpy.ones(len(source), bool)
    best_count = 0
    for _ in range(TRAJECTORY_TRIALS):
        some = rng.choice(len(source), min(8, len(source)), replace=False)
        scale, R, t = similarity(source[some], target[some])
        inliers = numpy.linalg.norm(scale * source @ R.T + t - target, axis=1) < TRAJECTORY_RANSAC_M
        if inliers.sum() > best_count:
            best, best_count = inliers, inliers.sum()
    if best_count < 4:
        best = numpy.ones(len(source), bool)
    return similarity(source[best], target[best])


def fit_plane(points, rng):
    """Unit normal and offset of a plane n x = d by RANSAC and least squares over its inliers."""
    best = None
    for _ in range(PLANE_TRIALS):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        n = numpy.cross(b - a, c - a)
        if numpy.linalg.norm(n) < 1e-9:
            continue
        n /= numpy.linalg.norm(n)
        inliers = numpy.abs((points - a) @ n) < PLANE_RANSAC_M
        if best is None or inliers.sum() > best.sum():
            best = inliers
    center = points[best].mean(axis=0)
    n = numpy.linalg.svd(points[best] - center, full_matrices=False)[2][2]
    return n, n @ center


def measure(model, truth, camera, rng):
    """Per-frame numbers and totals of a model, in metres of the true world."""
    poses, points = model
    names = [f for f in truth if f in poses]
    scale, R, t = robust_similarity(numpy.array([poses[n].center for n in names]),
                                    numpy.array([truth[n]["position"] for n in names]), rng)
    kept = {i: p for i, (p, length) in points.items() if length >= MIN_TRACK}
    world = {i: scale * R @ p + t for i, p in kept.items()}
    normal, offset = fit_plane(numpy.array(list(world.values())), rng)
    distance = {i: normal @ p - offset for i, p in world.items()}
    frames = {}
    for name in names:
        pose = poses[name]
        center = scale * R @ pose.center + t
        R_error = pose.R @ R.T @ truth[name]["R_world_cam"]
        seen = [(pixel, i) for pixel, i in zip(pose.pixels, pose.ids) if i in kept]
        row = {"height_m": -center[1], "position_error_m": numpy.linalg.norm(center - truth[name]["position"]),
               "rotation_error_deg": numpy.degrees(numpy.arccos(numpy.clip((numpy.trace(R_error) - 1) / 2, -1, 1))),
               "points": len(seen)}
        if seen:
            local = numpy.array([pose.R @ kept[i] + pose.t for _, i in seen])
            projected = numpy.column_stack([
                camera["fx_px"] * local[:, 0] / local[:, 2] + camera["cx_px"] + PIXEL_CENTER,
                camera["fy_px"] * local[:, 1] / local[:, 2] + camera["cy_px"] + PIXEL_CENTER])
            errors = numpy.linalg.norm(projected - numpy.array([p for p, _ in seen]), axis=1)
            row["reprojection_px"] = errors.mean()
            row["plane_rmse_m"] = numpy.sqrt(numpy.mean([distance[i] ** 2 for _, i in seen]))
        frames[name] = row
    observations = sum(r["points"] for r in frames.values())
    totals = {
        "registered": len(names), "points": len(kept), "observations": observations,
        "points_on_plane": sum(abs(d) < PLANE_RANSAC_M for d in distance.values()),
        "reprojection_px": sum(r["reprojection_px"] * r["points"] for r in frames.values() if r["points"])
        / max(1, observations),
        "plane_rmse_m": numpy.sqrt(numpy.mean(numpy.square(list(distance.values())))),
        "plane_median_m": numpy.median(numpy.abs(list(distance.values()))),
        "position_rmse_m": numpy.sqrt(numpy.mean([r["position_error_m"] ** 2 for r in frames.values()])),
        "position_max_m": max(r["position_error_m"] for r in frames.values()),
    }
    return frames, totals
