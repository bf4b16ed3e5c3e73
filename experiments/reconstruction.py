#!/usr/bin/env python3
"""The paper's reconstruction (section V-C) on a simulated sequence, with COLMAP in the place of VisualSFM.

A shaken camera moves along a wall of photographs. SIFT features of the blurred frames and of the deblurred ones, each
as detected and with the rolling shutter taken out, go into COLMAP databases; COLMAP matches neighbouring frames and
reconstructs with known intrinsics. The true trajectory gives the scale. Writes reconstruction.csv (one line a frame),
reconstruction.md and reconstruction.png. Exits with 77 where COLMAP is absent.
"""

import argparse
import concurrent.futures
import contextlib
import csv
import hashlib
import json
import os
import pathlib
import resource
import shutil
import sqlite3
import subprocess
import sys
import threading
import time

import matplotlib
import numpy
import yaml
from tqdm import tqdm

import photo_wall

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402

# Several processes at a time instead of several threads in each: for the libraries behind COLMAP.
ONE_THREAD = dict(os.environ, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

ROOT = pathlib.Path(__file__).resolve().parent.parent
OPENCV_DOC = pathlib.Path("/usr/share/doc/opencv-doc/examples/data")
SKIPPED = 77

WALL = ["aero1.jpg", "aloeL.jpg", "baboon.jpg", "board.jpg", "fruits.jpg",
        "starry_night.jpg", "building.jpg", "graf1.png", "butterfly.jpg", "home.jpg",
        "leuvenA.jpg", "messi5.jpg", "rubberwhale1.png", "box_in_scene.png", "squirrel_cls.jpg"]
COLUMNS = 5
TILE_M = (0.95, 0.76)
DISTANCE_M = 2.0

# name: (folder of the features, whether the keypoints are rectified, label)
VARIANTS = {
    "blurred": ("blurred", False, "SIFT on blurred frames"),
    "blurred_rectified": ("blurred", True, "SIFT on blurred frames, rectified"),
    "deblurred": ("deblurred", False, "ours, not rectified"),
    "deblurred_rectified": ("deblurred", True, "ours"),
}
BASELINE, OURS = "blurred", "deblurred_rectified"
PAPER = {"points": (5888, 10620), "unregistered": (3, 0)}

SUCCESSORS = (1, 2, 4, 8, 16)  # frames that each frame is matched with
# Every fourth frame is matched with these, too: only they see the wall from places far enough apart to begin with.
FAR_SUCCESSORS, FAR_PERIOD = (32, 64), 4
PAIRS_AT_A_TIME = 40  # for the progress to move
MAX_RATIO, MAX_ANGLE = 0.8, 0.7  # COLMAP's defaults (SiftMatching.max_ratio, max_distance [rad])
DESCRIPTOR_LENGTH = 512  # of a SIFT descriptor as bytes
# Matchers, and variants at a time; each takes 0.5 GB. Two processes of COLMAP use two cores better than one process.
WORKERS = min(len(VARIANTS), os.cpu_count() or 1)
# Of the median blur in a frame, for the table by blur.
BLUR_CLASSES_PX = (0, 7, 15, 30, numpy.inf)
MIN_START_ANGLE_DEG = 3  # between the rays of the first two frames; COLMAP wants 16, which neighbours in a video lack
# The same for all variants. The whole model is adjusted after it has grown by 40 % instead of 10 %, as COLMAP's
# automatic reconstruction does with videos. Adjustments end when the cost changes by less than a millionth (Ceres
# Solver's default); COLMAP has no such limit and goes on to its number of iterations, which takes most of the time.
MAPPER = {"Mapper__ba_global_images_ratio": 1.4, "Mapper__ba_global_points_ratio": 1.4,
          "Mapper__ba_global_function_tolerance": 1e-6, "Mapper__ba_local_function_tolerance": 1e-6,
          "Mapper__ba_refine_focal_length": 0, "Mapper__ba_refine_extra_params": 0, "Mapper__extract_colors": 0,
          "Mapper__init_min_tri_angle": MIN_START_ANGLE_DEG}
MIN_TRACK = 3  # images in which a point that counts is visible, as in the paper
MIN_IMAGES = 3  # of a model that can be measured: as many positions determine its scale, rotation and translation
PLANE_RANSAC_M = 0.02
PLANE_TRIALS = 500
TRAJECTORY_TRIALS = 500
TRAJECTORY_RANSAC_M = 0.03


# --- COLMAP's database (https://colmap.github.io/database.html) -----------------------------------------------------

PINHOLE = 1
PAIR_BASE = 2147483647  # the id of a pair is this times the first image's, plus the second image's
PIXEL_CENTER = 0.5  # COLMAP's first pixel has its centre at (0.5, 0.5), OpenCV's at (0, 0)


@contextlib.contextmanager
def opened(path):
    """A database that is written and closed in the end, so that its file is complete."""
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        yield database


def remove_database(path):
    """With what SQLite leaves beside a database whose writer was killed, and would write into the next of that name."""
    for suffix in ("", "-wal", "-shm", "-journal"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def copy_database(source, path):
    remove_database(path)
    shutil.copy(source, path)


def load_features(prefix, rectified):
    """Keypoints (n, 4): x, y, scale, orientation in COLMAP's convention, float32; and descriptors (n, 128), uint8."""
    raw = numpy.load(f"{prefix}_keypoints.npy")
    position = raw[:, 4:6] if rectified else raw[:, 0:2]
    # OpenCV's size is a diameter, two sigma.
    keypoints = numpy.column_stack([position + PIXEL_CENTER, raw[:, 2] / 2, numpy.radians(raw[:, 3])])
    return keypoints.astype(numpy.float32), numpy.load(f"{prefix}_descriptors.npy")


def create_database(path, camera, names):
    """An empty database with one camera of known intrinsics and images `names`, numbered from 1."""
    subprocess.run(["colmap", "database_creator", "--database_path", str(path)], check=True, stdout=subprocess.DEVNULL)
    parameters = numpy.array([camera["fx_px"], camera["fy_px"], camera["cx_px"] + PIXEL_CENTER,
                              camera["cy_px"] + PIXEL_CENTER], numpy.float64)
    with opened(path) as database:
        database.execute("INSERT INTO cameras VALUES (1, ?, ?, ?, ?, 1)",
                         (PINHOLE, int(camera["width_px"]), int(camera["height_px"]), parameters.tobytes()))
        for i, name in enumerate(names, 1):
            database.execute("INSERT INTO images (image_id, name, camera_id) VALUES (?, ?, 1)", (i, name))


def set_keypoints(path, features):
    """Replaces the keypoints of all images; what was verified with the old ones is dropped, matches stay."""
    with opened(path) as database:
        database.execute("DELETE FROM keypoints")
        database.execute("DELETE FROM two_view_geometries")
        for i, (keypoints, _) in enumerate(features, 1):
            database.execute("INSERT INTO keypoints VALUES (?, ?, ?, ?)", (i, *keypoints.shape, keypoints.tobytes()))


def set_descriptors(path, features):
    with opened(path) as database:
        database.execute("DELETE FROM descriptors")
        for i, (_, descriptors) in enumerate(features, 1):
            database.execute("INSERT INTO descriptors VALUES (?, ?, ?, ?)",
                             (i, *descriptors.shape, descriptors.tobytes()))


def colmap(command, log, progress=None, **options):
    """Runs COLMAP; returns whether it succeeded. Raises SystemExit when a signal ended it, which says nothing of its
    input. Its output goes to the file `log`; `progress` counts the images that it registers."""
    arguments = [part for key, value in options.items() for part in ("--" + key.replace("__", "."), str(value))]
    with open(log, "a") as output, subprocess.Popen(["colmap", command, *arguments], stdout=subprocess.PIPE, text=True,
                                                    stderr=subprocess.STDOUT, env=ONE_THREAD) as process:
        for line in process.stdout:
            output.write(line)
            if progress is not None and line.startswith("Registering image"):
                progress.update()
    if process.returncode < 0:
        sys.exit(f"reconstruction.py: signal {-process.returncode} ended colmap {command}; see {log}")
    return process.returncode == 0


def require(success, command, log):
    if not success:
        sys.exit(f"reconstruction.py: colmap {command} failed; see {log}")


def match_descriptors(a, b):
    """Pairs (n, 2), uint32, of descriptors (rows of `a` and `b`, uint8): each the other's nearest, nearer than
    MAX_ANGLE and than MAX_RATIO times the second nearest on either side. These are COLMAP's rules; its version without
    CUDA searches approximately and for longer. A matrix product of floats is exact: sums are whole numbers below 2^24.
    It is fast with OpenBLAS, and slow with the reference BLAS."""
    if not len(a) or not len(b):
        return numpy.empty((0, 2), numpy.uint32)
    product = a.astype(numpy.float32) @ b.astype(numpy.float32).T

    def angle(values):
        return numpy.arccos(numpy.minimum(values / DESCRIPTOR_LENGTH ** 2, 1))

    rows = numpy.arange(len(a))
    nearest = product.argmax(axis=1)
    best = product[rows, nearest]
    mutual = best == product.max(axis=0)[nearest]
    # Of rows that are equally near to a column none matches; columns that are equally near to a row fail the ratio.
    mutual &= numpy.bincount(nearest[mutual], minlength=len(b))[nearest] == 1
    product[rows, nearest] = 0
    second_of_row = product.max(axis=1)
    product[rows[~mutual], nearest[~mutual]] = best[~mutual]  # these are in the way of nobody but other rows
    second_of_column = product.max(axis=0)[nearest]
    limit = numpy.minimum(MAX_ANGLE, MAX_RATIO * numpy.minimum(angle(second_of_row), angle(second_of_column)))
    kept = mutual & (angle(best) < limit)
    return numpy.column_stack([rows[kept], nearest[kept]]).astype(numpy.uint32)


def pairs_to_match(count):
    """Pairs of frames, by number from 0."""
    return [(i, i + step) for i in range(count) for step in SUCCESSORS + (FAR_SUCCESSORS if i % FAR_PERIOD == 0 else ())
            if i + step < count]


def match(path, features, label="matching"):
    """Matches the descriptors of each frame with those of its successors and writes the matches into the database."""
    pairs = pairs_to_match(len(features))

    def matched(pair):
        return match_descriptors(features[pair[0]][1], features[pair[1]][1])

    # The matrix product and the searches run outside Python's lock.
    with opened(path) as database, concurrent.futures.ThreadPoolExecutor(WORKERS) as pool:
        for (i, j), matches in tqdm(zip(pairs, pool.map(matched, pairs)), desc=f"  matching, {label}", unit="pair",
                                    total=len(pairs), mininterval=1):
            database.execute("INSERT INTO matches VALUES (?, ?, 2, ?)",
                             (PAIR_BASE * (i + 1) + j + 1, len(matches), matches.tobytes()))


def verify(database, names, log, seed, progress):
    """COLMAP's verification of the matches that are in the database, by the geometry of two views."""
    pairs = [f"{names[i]} {names[j]}\n" for i, j in pairs_to_match(len(names))]
    path = database.with_suffix(".pairs")
    for start in range(0, len(pairs), PAIRS_AT_A_TIME):
        chunk = pairs[start:start + PAIRS_AT_A_TIME]
        path.write_text("".join(chunk))
        require(colmap("matches_importer", log, database_path=database, match_list_path=path, match_type="pairs",
                       random_seed=seed, SiftMatching__use_gpu=0, SiftMatching__num_threads=1), "matches_importer", log)
        progress.update(len(chunk))


def reconstruct(database, folder, log, seed, progress):
    """COLMAP's models, as text in folders beside each other in `folder`; none where it finds no pair to begin with."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    if not colmap("mapper", log, progress, database_path=database, image_path=folder, output_path=folder,
                  random_seed=seed, Mapper__num_threads=1, **MAPPER):
        return
    for model in sorted(p for p in folder.iterdir() if p.name.isdigit()):
        text = folder / f"{model.name}_text"
        text.mkdir()
        require(colmap("model_converter", log, input_path=model, output_path=text, output_type="TXT"),
                "model_converter", log)


def largest_model(folder):
    """Poses and points (see read_model) of the model with most images in `folder`; None when there is none."""
    best = None
    for text in sorted(folder.glob("*_text")):
        poses, points = read_model(text)
        if best is None or len(poses) > len(best[0]):
            best = (poses, points)
    return best


# --- models ---------------------------------------------------------------------------------------------------------


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
    """As similarity(), from the largest set of cameras that agree, so that a few wrong ones do not bend it."""
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
        turn = pose.R @ R.T @ truth[name]["R_world_cam"]
        seen = [(pixel, i) for pixel, i in zip(pose.pixels, pose.ids) if i in kept]
        row = {"height_m": -center[1], "position_error_m": numpy.linalg.norm(center - truth[name]["position"]),
               "rotation_error_deg": numpy.degrees(numpy.arccos(numpy.clip((numpy.trace(turn) - 1) / 2, -1, 1))),
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


# --- output ---------------------------------------------------------------------------------------------------------


def plot(truth, results, path):
    names = list(truth)
    times = numpy.array([truth[n]["t_s"] for n in names])
    figure, axes = pyplot.subplots(5, 1, figsize=(9, 12), sharex=True)
    colors = {BASELINE: "tab:red", OURS: "tab:blue"}

    def series(variant, key):
        frames = results[variant][0]
        return numpy.array([frames[n].get(key, numpy.nan) if n in frames else numpy.nan for n in names])

    def height(name):
        return 1000 * -truth[name]["position"][1]

    axes[0].plot(times, [height(n) for n in names], color="black", linewidth=4, alpha=0.25, label="truth")
    for variant, color in colors.items():
        if variant not in results:
            continue
        axes[0].plot(times, 1000 * series(variant, "height_m"), color=color, linewidth=1, label=VARIANTS[variant][2])
        missing = [i for i, n in enumerate(names) if n not in results[variant][0]]
        if missing:
            axes[0].plot(times[missing], [height(names[i]) for i in missing], "x", color=color, label="not registered")
        for axis, key, unit in zip(axes[1:4], ("reprojection_px", "plane_rmse_m", "points"), (1, 1000, 1)):
            axis.plot(times, unit * series(variant, key), color=color, linewidth=1)
    axes[4].plot(times, [truth[n]["extent_px"] for n in names], color="black", linewidth=1)
    for axis, label in zip(axes, ("camera height [mm]", "mean reprojection\nerror [px]",
                                  "RMS distance of points\nfrom the plane [mm]", "points in the image",
                                  "median extent\nof the blur [px]")):
        axis.set_ylabel(label)
        axis.grid(alpha=0.4)
    for axis in axes[1:]:
        axis.set_ylim(bottom=0)
    axes[0].legend(loc="best", fontsize=8)
    axes[-1].set_xlabel("time [s]")
    figure.align_ylabels()
    figure.tight_layout()
    figure.savefig(path, dpi=90)


def table(results, frames):
    lines = ["| | registered | points (near the plane) | images a point | reprojection error | distance from the "
             "plane, RMS (median) | camera position, RMS (largest) |", "| --- | --- | --- | --- | --- | --- | --- |"]
    for variant, (_, totals) in results.items():
        lines.append(
            f"| {VARIANTS[variant][2]} | {totals['registered']} of {frames} | {totals['points']} "
            f"({totals['points_on_plane']}) | {totals['observations'] / totals['points']:.1f} | "
            f"{totals['reprojection_px']:.2f} px | {1000 * totals['plane_rmse_m']:.1f} "
            f"({1000 * totals['plane_median_m']:.1f}) mm | {1000 * totals['position_rmse_m']:.0f} "
            f"({1000 * totals['position_max_m']:.0f}) mm |")
    return lines


def table_by_blur(truth, results):
    """Features, points and errors in an image, means of the registered images of similar blur: blurred / ours."""
    lines = ["| median blur in the frame | frames | features | points in the image | reprojection error | distance "
             "from the plane, RMS |", "| --- | --- | --- | --- | --- | --- |"]
    for low, high in zip(BLUR_CLASSES_PX, BLUR_CLASSES_PX[1:]):
        names = [n for n in truth if low <= truth[n]["extent_px"] < high]
        if not names:
            continue
        cells = []
        for key, unit, digits in (("features", 1, 0), ("points", 1, 0), ("reprojection_px", 1, 2),
                                  ("plane_rmse_m", 1000, 1)):
            values = []
            for variant in (BASELINE, OURS):
                if key == "features":
                    values.append([truth[n]["features"][VARIANTS[variant][0]] for n in names])
                else:
                    frames = results[variant][0]
                    values.append([frames[n][key] for n in names if key in frames.get(n, ())])
            cells.append(" / ".join(f"{unit * numpy.mean(v):.{digits}f}" if v else "-" for v in values))
        limits = f"{low} to {high} px" if numpy.isfinite(high) else f"above {low} px"
        lines.append(f"| {limits} | {len(names)} | {cells[0]} | {cells[1]} | {cells[2]} px | {cells[3]} mm |")
    return lines


def read_truth(folder):
    truth = {}
    with open(folder / "truth.csv") as file:
        for row in csv.DictReader(file):
            q = numpy.array([float(row[k]) for k in ("qw", "qx", "qy", "qz")])
            truth[f"frame_{int(row['frame']):04d}"] = {
                "t_s": float(row["t_s"]), "R_world_cam": rotation_matrix(q),
                "position": numpy.array([float(row[k]) for k in ("x_m", "y_m", "z_m")]),
                "extent_px": float(row["median_extent_px"]),
                "features": {folder: int(row[f"keypoints_{folder}"]) for folder in ("blurred", "deblurred")}}
    with open(folder / "camera.csv") as file:
        camera = {key: float(value) for key, value in next(csv.DictReader(file)).items()}
    return truth, camera


def extract(arguments, work):
    """Simulates the sequence and writes the features, images and truth."""
    scene = yaml.safe_load((ROOT / "experiments" / "scenes" / "reconstruction.yaml").read_text())
    texture = (work / "wall.png").resolve()
    photo_wall.compose([OPENCV_DOC / name for name in WALL], COLUMNS, texture, arguments.seed)
    scene.update(planes=[photo_wall.plane(texture, (COLUMNS, len(WALL) // COLUMNS), TILE_M, DISTANCE_M)],
                 seed=arguments.seed)
    (work / "scene.yaml").write_text(yaml.safe_dump(scene, sort_keys=False))
    frames = ["--frames", "12", "--first-frame", "40", "--step", "6"] if arguments.quick else []
    subprocess.run([str(arguments.program), str(work / "scene.yaml"), str(work), "--max-features",
                    str(arguments.max_features), "--image-period", "5", *frames], check=True)


def create_matches(database, camera, folder, names):
    """A database with the features in `folder` and their matches."""
    remove_database(database)
    features = [load_features(folder / name, False) for name in names]
    create_database(database, camera, names)
    set_descriptors(database, features)
    match(database, features, folder.name)


def model_folder(work, variant):
    """Apart from the features, whose folders have the names of variants."""
    return work / f"models_{variant}"


def create_models(stages, variants, work, names, seed):
    """Verifies and reconstructs every variant, several at a time. When one fails, no other begins a stage."""
    stopping = threading.Event()

    def create(variant):
        database, log = work / f"{variant}.db", work / f"{variant}.log"

        def verify_anew():
            source, rectified, _ = VARIANTS[variant]
            copy_database(work / f"matches_{source}.db", database)
            set_keypoints(database, [load_features(work / source / name, rectified) for name in names])
            verify(database, names, log, seed, verified)

        stages.once(f"verified_{variant}", verify_anew)
        if stopping.is_set():
            return
        folder = model_folder(work, variant)
        stages.once(f"model_{variant}", lambda: reconstruct(database, folder, log, seed, registered))

    pairs, images = len(variants) * len(pairs_to_match(len(names))), len(variants) * len(names)
    with tqdm(desc="  verifying", unit="pair", total=pairs, mininterval=1) as verified, \
            tqdm(desc="  registering", unit="image", total=images, mininterval=1) as registered, \
            concurrent.futures.ThreadPoolExecutor(WORKERS) as pool:
        futures = [pool.submit(create, variant) for variant in variants]
        try:
            for done in concurrent.futures.as_completed(futures):
                done.result()
        except BaseException:  # KeyboardInterrupt, too: the pool would begin those that wait before it ends
            stopping.set()
            for future in futures:
                future.cancel()
            raise


def write_results(out, truth, results, absent):
    """CSV, table and plot of the variants' frames and totals (see measure)."""
    with open(out / "reconstruction.csv", "w", newline="") as file:
        keys = ["height_m", "position_error_m", "rotation_error_deg", "points", "reprojection_px", "plane_rmse_m"]
        writer = csv.writer(file)
        writer.writerow(["variant", "frame", "t_s", "median_extent_px", *keys])
        for variant, (rows, _) in results.items():
            for name, row in rows.items():
                writer.writerow([variant, name, truth[name]["t_s"], truth[name]["extent_px"],
                                 *(row.get(key, "") for key in keys)])
    text = [f"{len(truth)} frames, median extent of the blur "
            f"{numpy.median([f['extent_px'] for f in truth.values()]):.1f} px, largest "
            f"{max(f['extent_px'] for f in truth.values()):.1f} px", "", *table(results, len(truth)), ""]
    if BASELINE in results and OURS in results:
        ratio = results[OURS][1]["points"] / results[BASELINE][1]["points"]
        text += [f"points, ours / SIFT on blurred frames: {ratio:.2f} (the paper: "
                 f"{PAPER['points'][1] / PAPER['points'][0]:.2f})", "",
                 f"{VARIANTS[BASELINE][2]} / {VARIANTS[OURS][2]}:", "", *table_by_blur(truth, results), ""]
    if absent:
        text.append("Photographs that are absent, with rectangles in their place: " + ", ".join(absent))
    (out / "reconstruction.md").write_text("\n".join(text).rstrip() + "\n")
    plot(truth, results, out / "reconstruction.png")
    print("\n".join(text))


class Stages:
    """Steps of a run. Each leaves a mark in `work`, and is not done again when a run goes on that was interrupted."""

    def __init__(self, work):
        self.work = work

    def once(self, name, action):
        mark = self.work / f"{name}.done"
        if not mark.exists():
            action()
            mark.touch()


def same_options(work, options):
    """Writes into `work` the options that its stages depend on; ends when they were made with others."""
    path = work / "options.json"
    if not path.exists() and any(work.glob("*.done")):
        sys.exit(f"reconstruction.py: --resume cannot go on: {path} is missing, which says what {work} was made with")
    if path.exists():
        before = json.loads(path.read_text())
        for name, value in options.items():
            if before.get(name) != value:
                sys.exit(f"reconstruction.py: --resume needs the options of the interrupted run: --{name} was "
                         f"{before.get(name)} and is {value}")
    path.write_text(json.dumps(options))


@contextlib.contextmanager
def timed(name):
    """Prints what the block took."""
    wall_s, processor_s = time.monotonic(), processor_time_s()
    yield
    print(f"  {name}: {time.monotonic() - wall_s:.0f} s, {processor_time_s() - processor_s:.0f} s of processor time",
          flush=True)


def processor_time_s():
    """Of this process and of those that it started and that have ended."""
    return sum(usage.ru_utime + usage.ru_stime for usage in map(
        resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=pathlib.Path, help="folder for the results")
    parser.add_argument("--program", type=pathlib.Path, required=True, help="the built reconstruction")
    parser.add_argument("--seed", type=int, default=1, help="of noise and of RANSAC [1]")
    parser.add_argument("--max-features", type=int, default=8192, help="of each frame [8192, SiftGPU's limit]")
    parser.add_argument("--quick", action="store_true", help="12 frames, raw blurred and rectified deblurred only")
    parser.add_argument("--variants", nargs="+", choices=list(VARIANTS), default=list(VARIANTS), help="[all]")
    parser.add_argument("--resume", action="store_true",
                        help="go on with an interrupted run of the same options, --variants apart")
    parser.add_argument("--keep", action="store_true", help="leave features, databases and models")
    arguments = parser.parse_args()
    if shutil.which("colmap") is None:
        print("SKIPPED:\nthere is no COLMAP: install the package colmap to run the reconstruction")
        sys.exit(SKIPPED)
    work = arguments.out / "work"
    if not arguments.resume:
        shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True, exist_ok=True)
    # Not the variants: each has stages of its own.
    same_options(work, {"quick": arguments.quick, "seed": arguments.seed, "max-features": arguments.max_features,
                        "program": f"sha256 {hashlib.sha256(arguments.program.read_bytes()).hexdigest()}"})
    stages = Stages(work)
    absent = [name for name in WALL if not (OPENCV_DOC / name).is_file()]
    with timed("simulation and features"):
        stages.once("features", lambda: extract(arguments, work))
    truth, camera = read_truth(work)
    names = list(truth)

    variants = [BASELINE, OURS] if arguments.quick else arguments.variants
    for folder in dict.fromkeys(VARIANTS[variant][0] for variant in variants):
        # The matches of descriptors do not depend on where the features are: variants share them.
        with timed(f"matches, {folder}"):
            stages.once(f"matches_{folder}",
                        lambda: create_matches(work / f"matches_{folder}.db", camera, work / folder, names))
    with timed("verification and models"):
        create_models(stages, variants, work, names, arguments.seed)

    results = {}
    for variant in variants:
        model = largest_model(model_folder(work, variant))
        if model is None or len(model[0]) < MIN_IMAGES:
            print(f"  {VARIANTS[variant][2]}: no reconstruction")
            continue
        results[variant] = measure(model, truth, camera, numpy.random.default_rng(arguments.seed))

    write_results(arguments.out, truth, results, absent)
    if not arguments.keep:
        shutil.rmtree(work)
    if OURS in variants and OURS not in results:
        sys.exit("reconstruction.py: nothing was reconstructed from the deblurred frames")


if __name__ == "__main__":
    main()
