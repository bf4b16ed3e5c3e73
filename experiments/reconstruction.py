#!/usr/bin/env python3
"""The paper's reconstruction (section V-C) on a simulated sequence, with COLMAP in the place of VisualSFM.

A shaken camera moves along a wall of photographs. SIFT features of the blurred frames and of the deblurred ones, each
as detected and with the rolling shutter taken out, go into COLMAP databases; COLMAP matches neighbouring frames and
reconstructs with known intrinsics. The true trajectory gives the scale. Writes reconstruction.csv (one line a frame),
reconstruction.md and reconstruction.png. Exits with 77 where COLMAP is absent.
"""

import argparse
import csv
import pathlib
import shutil
import sqlite3
import subprocess
import sys

import matplotlib
import numpy
import yaml
from tqdm import tqdm

import photo_wall

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402

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
MIN_START_ANGLE_DEG = 3  # between the rays of the first two frames; COLMAP wants 16, which neighbours in a video lack
# The whole model is adjusted after it has grown by 40 % instead of 10 %, as COLMAP's automatic reconstruction does with
# videos, three times with 25 iterations at most instead of five times with 50: that takes most of the time, and after 20
# iterations the cost no longer changes in its fifth digit.
VIDEO_MAPPER = {"Mapper__ba_global_images_ratio": 1.4, "Mapper__ba_global_points_ratio": 1.4,
                "Mapper__ba_global_max_num_iterations": 25, "Mapper__ba_global_max_refinements": 3}
MIN_TRACK = 3  # images in which a point that counts is visible, as in the paper
PLANE_RANSAC_M = 0.02
PLANE_TRIALS = 500
TRAJECTORY_TRIALS = 500
TRAJECTORY_RANSAC_M = 0.03


# --- COLMAP's database (https://colmap.github.io/database.html) -----------------------------------------------------

PINHOLE = 1
PIXEL_CENTER = 0.5  # COLMAP's first pixel has its centre at (0.5, 0.5), OpenCV's at (0, 0)


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
    with sqlite3.connect(path) as database:
        database.execute("INSERT INTO cameras VALUES (1, ?, ?, ?, ?, 1)",
                         (PINHOLE, int(camera["width_px"]), int(camera["height_px"]), parameters.tobytes()))
        for i, name in enumerate(names, 1):
            database.execute("INSERT INTO images (image_id, name, camera_id) VALUES (?, ?, 1)", (i, name))


def set_keypoints(path, features):
    """Replaces the keypoints of all images; what was verified with the old ones is dropped, matches stay."""
    with sqlite3.connect(path) as database:
        database.execute("DELETE FROM keypoints")
        database.execute("DELETE FROM two_view_geometries")
        for i, (keypoints, _) in enumerate(features, 1):
            database.execute("INSERT INTO keypoints VALUES (?, ?, ?, ?)", (i, *keypoints.shape, keypoints.tobytes()))


def set_descriptors(path, features):
    with sqlite3.connect(path) as database:
        database.execute("DELETE FROM descriptors")
        for i, (_, descriptors) in enumerate(features, 1):
            database.execute("INSERT INTO descriptors VALUES (?, ?, ?, ?)",
                             (i, *descriptors.shape, descriptors.tobytes()))


def colmap(command, log, **options):
    """Runs COLMAP; returns whether it succeeded. Its output goes to the file `log`."""
    arguments = [part for key, value in options.items() for part in ("--" + key.replace("__", "."), str(value))]
    with open(log, "a") as output:
        done = subprocess.run(["colmap", command, *arguments], stdout=output, stderr=subprocess.STDOUT)
    return done.returncode == 0


def require(success, command, log):
    if not success:
        sys.exit(f"reconstruction.py: colmap {command} failed; see {log}")


def match(database, names, log, seed, label="matching"):
    """Matches each frame with its successors and verifies; matches that the database has are only verified."""
    pairs = [f"{name} {names[i + step]}\n" for i, name in enumerate(names)
             for step in SUCCESSORS + (FAR_SUCCESSORS if i % FAR_PERIOD == 0 else ()) if i + step < len(names)]
    path = database.with_suffix(".pairs")
    with tqdm(total=len(pairs), desc=f"  {label}", unit="pair", mininterval=1) as progress:
        for start in range(0, len(pairs), PAIRS_AT_A_TIME):
            chunk = pairs[start:start + PAIRS_AT_A_TIME]
            path.write_text("".join(chunk))
            require(colmap("matches_importer", log, database_path=database, match_list_path=path, match_type="pairs",
                           random_seed=seed, SiftMatching__use_gpu=0), "matches_importer", log)
            progress.update(len(chunk))


def reconstruct(database, folder, log, seed):
    """Poses and points (see read_model) of the model with most images; None when there is none."""
    folder.mkdir(parents=True, exist_ok=True)
    # Fails where it finds no pair of images to begin with.
    if not colmap("mapper", log, database_path=database, image_path=folder, output_path=folder, random_seed=seed,
                  Mapper__ba_refine_focal_length=0, Mapper__ba_refine_extra_params=0, Mapper__extract_colors=0,
                  Mapper__init_min_tri_angle=MIN_START_ANGLE_DEG, **VIDEO_MAPPER):
        return None
    best = None
    for model in sorted(p for p in folder.iterdir() if p.name.isdigit()):
        text = folder / f"{model.name}_text"
        text.mkdir(exist_ok=True)
        require(colmap("model_converter", log, input_path=model, output_path=text, output_type="TXT"),
                "model_converter", log)
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
    figure, axes = pyplot.subplots(4, 1, figsize=(9, 10), sharex=True)
    styles = {BASELINE: ("tab:red", "-"), "deblurred": ("tab:cyan", ":"), OURS: ("tab:blue", "-")}

    def series(variant, key):
        frames = results[variant][0]
        return numpy.array([frames[n].get(key, numpy.nan) if n in frames else numpy.nan for n in names])

    axes[0].plot(times, [-truth[n]["position"][1] for n in names], color="black", linewidth=3, alpha=0.3, label="truth")
    for variant, (color, line) in styles.items():
        if variant not in results:
            continue
        label = VARIANTS[variant][2]
        axes[0].plot(times, series(variant, "height_m"), line, color=color, linewidth=1, label=label)
        axes[1].plot(times, series(variant, "reprojection_px"), line, color=color, linewidth=1)
        axes[2].plot(times, 1000 * series(variant, "plane_rmse_m"), line, color=color, linewidth=1)
        missing = [i for i, n in enumerate(names) if n not in results[variant][0]]
        axes[0].plot(times[missing], [-truth[names[i]]["position"][1] for i in missing], "x", color=color)
    axes[0].set_ylabel("camera height [m]")
    axes[0].legend(loc="best", fontsize=8)
    axes[1].set_ylabel("mean reprojection\nerror [px]")
    axes[2].set_ylabel("RMS distance of points\nfrom the plane [mm]")
    axes[3].plot(times, [truth[n]["extent_px"] for n in names], color="black", linewidth=1)
    axes[3].set_ylabel("median extent\nof the blur [px]")
    axes[3].set_xlabel("time [s]")
    for axis in axes:
        axis.grid(alpha=0.4)
    figure.tight_layout()
    figure.savefig(path, dpi=90)


def table(results, frames):
    lines = ["| | registered | points | reprojection error | distance from the plane, RMS (median) | camera position, "
             "RMS (largest) |", "| --- | --- | --- | --- | --- | --- |"]
    for variant, (_, totals) in results.items():
        lines.append(
            f"| {VARIANTS[variant][2]} | {totals['registered']} of {frames} | {totals['points']} | "
            f"{totals['reprojection_px']:.2f} px | {1000 * totals['plane_rmse_m']:.1f} "
            f"({1000 * totals['plane_median_m']:.1f}) mm | {1000 * totals['position_rmse_m']:.0f} "
            f"({1000 * totals['position_max_m']:.0f}) mm |")
    return lines


def read_truth(folder):
    truth = {}
    with open(folder / "truth.csv") as file:
        for row in csv.DictReader(file):
            q = numpy.array([float(row[k]) for k in ("qw", "qx", "qy", "qz")])
            truth[f"frame_{int(row['frame']):04d}"] = {
                "t_s": float(row["t_s"]), "R_world_cam": rotation_matrix(q),
                "position": numpy.array([float(row[k]) for k in ("x_m", "y_m", "z_m")]),
                "extent_px": float(row["median_extent_px"])}
    with open(folder / "camera.csv") as file:
        camera = {key: float(value) for key, value in next(csv.DictReader(file)).items()}
    return truth, camera


def extract(arguments, work):
    """Simulates the sequence and writes the features, images and truth; returns the names of absent photographs."""
    scene = yaml.safe_load((ROOT / "experiments" / "scenes" / "reconstruction.yaml").read_text())
    texture = (work / "wall.png").resolve()
    absent = photo_wall.compose([OPENCV_DOC / name for name in WALL], COLUMNS, texture, arguments.seed)
    scene.update(planes=[photo_wall.plane(texture, (COLUMNS, len(WALL) // COLUMNS), TILE_M, DISTANCE_M)],
                 seed=arguments.seed)
    (work / "scene.yaml").write_text(yaml.safe_dump(scene, sort_keys=False))
    frames = ["--frames", "12", "--first-frame", "40", "--step", "6"] if arguments.quick else []
    subprocess.run([str(arguments.program), str(work / "scene.yaml"), str(work), "--max-features",
                    str(arguments.max_features), "--image-period", "5", *frames], check=True)
    return absent


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
                 f"{PAPER['points'][1] / PAPER['points'][0]:.2f})", ""]
    if absent:
        text.append("Photographs that are absent, with rectangles in their place: " + ", ".join(absent))
    (out / "reconstruction.md").write_text("\n".join(text).rstrip() + "\n")
    plot(truth, results, out / "reconstruction.png")
    print("\n".join(text))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=pathlib.Path, help="folder for the results")
    parser.add_argument("--program", type=pathlib.Path, required=True, help="the built reconstruction")
    parser.add_argument("--seed", type=int, default=1, help="of noise and of RANSAC [1]")
    parser.add_argument("--max-features", type=int, default=8192, help="of each frame [8192, SiftGPU's limit]")
    parser.add_argument("--quick", action="store_true", help="12 frames, raw blurred and rectified deblurred only")
    parser.add_argument("--features", type=pathlib.Path, help="folder work/ of an earlier run with --keep")
    parser.add_argument("--variants", nargs="+", choices=list(VARIANTS), default=list(VARIANTS), help="[all]")
    parser.add_argument("--keep", action="store_true", help="leave features, databases and models")
    arguments = parser.parse_args()
    if shutil.which("colmap") is None:
        print("SKIPPED:\nthere is no COLMAP: install the package colmap to run the reconstruction")
        sys.exit(SKIPPED)
    arguments.out.mkdir(parents=True, exist_ok=True)
    work = arguments.out / "work"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    source = arguments.features or work
    absent = [] if arguments.features else extract(arguments, work)
    truth, camera = read_truth(source)

    variants = [BASELINE, OURS] if arguments.quick else arguments.variants
    results, matched = {}, {}
    for variant in variants:
        folder, rectified, label = VARIANTS[variant]
        log = work / f"{variant}.log"
        features = [load_features(source / folder / name, rectified) for name in truth]
        database = work / f"{variant}.db"
        if folder in matched:  # matches of descriptors are the same; only the geometry is verified anew
            shutil.copy(matched[folder], database)
        else:
            create_database(database, camera, list(truth))
            set_descriptors(database, features)
            matched[folder] = database
        set_keypoints(database, features)
        match(database, list(truth), log, arguments.seed, label)
        model = reconstruct(database, work / variant, log, arguments.seed)
        if model is None or len(model[0]) < 3:
            print(f"  {label}: no reconstruction")
            continue
        results[variant] = measure(model, truth, camera, numpy.random.default_rng(arguments.seed))

    write_results(arguments.out, truth, results, absent)
    if not arguments.keep:
        shutil.rmtree(work)
    if OURS not in results:
        sys.exit("reconstruction.py: nothing was reconstructed from the deblurred frames")


if __name__ == "__main__":
    main()
