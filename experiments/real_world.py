#!/usr/bin/env python3
"""The paper's real-world table (section V-B) on simulated bursts with real hand-shake.

Two walls of photographs are seen by a rolling-shutter camera that rotates as a recorded hand-shake gyroscope says. Each
pair of viewpoints is a pair of bursts sharp - blurred - sharp. Exposures are drawn from the recording with a fixed
seed: once among those whose motion is even and straight, as the paper takes it to be, once among the rest. One
recording shakes mostly in one direction, ten photographs do not: for each burst the recorder is rotated about the
optical axis by a random angle, so that blur has any direction. The same exposures are rendered at two strengths: as
recorded, and weakened until the baseline alone fares as in the paper (--calibrate). Writes real_world.csv,
real_world.md, and for each strength a plot, real_world_STRENGTH.png.
"""

import argparse
import csv
import math
import os
import pathlib
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor

import common  # noqa: F401  (first: names the package of a module that is missing)
import cv2
import matplotlib
import numpy
import yaml
from tqdm import tqdm

import photo_wall
from common import ONE_THREAD, OPENCV_DOC, ROOT, fail, number, one_line_about, read_json, table, write_markdown

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402

# What the recorded rates are multiplied by. The recording is of a phone that is shaken on purpose (up to 6.4 rad/s). As
# it is, DoG errs on the blurred frames about as it does in the paper, but repeats less often; the second factor is the
# one with which it repeats as often, found by --calibrate, which measures that and nothing else.
STRENGTHS = {"recorded": 1.0, "weakened": 0.6}
CALIBRATION_FACTORS = (0.25, 0.35, 0.7)
CALIBRATION_PAIRS = 2  # of each scene
RECORDED_EXTENT_PX = (20.0, 100.0)  # with a factor of 1: up to what the tablet's published burst of 20 ms shows
EVEN = 0.20  # largest change of speed during an exposure of an 'even' pair, over the mean speed
STRAIGHT_DEG = 10.0  # largest angle between velocity and blur in an exposure of an 'even' pair
PAIRS = 5  # of each scene and class
KINDS = {"even": f"even: speed changes by less than {100 * EVEN:.0f} %, direction by less than {STRAIGHT_DEG:.0f} deg",
         "nonuniform": "non-uniform: the others"}
METHODS = {"dog": "DoG", "pretto": "Pretto et al.", "proposed": "proposed"}
# The same images, all of them smoothed before detection.
SMOOTHED = {"dog_smoothed": "dog", "proposed_smoothed": "proposed"}
GROUND_TRUTHS = {
    "protocol": "the protocol's homography between the frames",
    "best_homography": "the best homography between the frames",
    "truth": "each keypoint's true place",
    "rectified": "rectified with the gyroscope",
}
# The paper's table II: repeatability [%] and error [px].
PAPER = {"dog": (26.8, 6.5), "pretto": (35.5, 4.4), "proposed": (52.8, 3.9)}

# Photographs of a wall; each hangs there twice, the second time mirrored (which SIFT distinguishes), small enough that
# the frames show detail down to the pixel.
WALLS = {
    "Oxford": ["bark", "bikes", "boat", "leuven", "graf", "trees", "ubc", "wall", "graf3.png", "building.jpg"],
    "OpenCV": ["aero1.jpg", "aloeL.jpg", "baboon.jpg", "board.jpg", "starry_night.jpg", "leuvenA.jpg",
               "butterfly.jpg", "home.jpg", "fruits.jpg", "box_in_scene.png"],
}
COLUMNS = 5
TILE_M = (0.55, 0.44)
DISTANCE_M = 2.0
VIEW_OFFSET_M = 0.3  # of a viewpoint from the wall's normal through its centre, sideways and up
TARGET_OFFSET_M = 0.1  # of the point on the wall that the camera looks at when the middle frame is exposed
ROLL_DEG = 10.0


def load_trace(path):
    """Times from the first line [s] and rates in the recorder's axes [rad/s], (n,) and (n, 3)."""
    lines = numpy.loadtxt(path)
    return (lines[:, 0] - lines[0, 0]) * 1e-9, lines[:, 1:4]


def substitute_trace(path, seed):
    """Writes a made-up hand-shake for where the recording is absent: sines of 1 to 7 Hz with random phases."""
    rng = numpy.random.default_rng(seed)
    times = numpy.arange(0, 60, 0.005)
    rates = numpy.zeros((len(times), 3))
    for hz in numpy.arange(1, 7.01, 0.25):
        for axis, strength in enumerate((0.35, 0.35, 0.1)):
            rates[:, axis] += strength / math.sqrt(hz) * numpy.sin(2 * math.pi * hz * times + rng.uniform(0, 2 * math.pi))
    numpy.savetxt(path, numpy.column_stack([(times + 1) * 1e9, rates]), fmt=["%.0f"] + 3 * ["%.8f"])


class Exposures:
    """What the exposures of a recording do at the centre column of a camera's image."""

    def __init__(self, scene, times, rates, factor):
        self.camera = scene["camera"]
        self.factor = factor
        self.R_cam_imu = numpy.array(scene["imu"]["R_cam_imu"], float).reshape(3, 3)
        self.step = 0.001
        self.times = numpy.arange(times[0], times[-1], self.step)
        rates = factor * rates @ self.R_cam_imu.T
        self.rates = numpy.column_stack([numpy.interp(self.times, times, rates[:, k]) for k in range(3)])
        self.exposure = self.camera["exposure_time"][1]

    def _velocity(self, rates, row):
        """Image velocity [px/s] of what the centre column shows in a row, for camera rates (n, 3): (n, 2)."""
        fx, fy, cx, cy = self.camera["intrinsics"]
        x, y = (self.camera["size"][0] / 2 - cx) / fx, (row - cy) / fy
        wx, wy, wz = rates.T
        return numpy.column_stack([fx * (x * y * wx - (1 + x * x) * wy + y * wz),
                                   fy * ((1 + y * y) * wx - x * y * wy - x * wz)])

    def describe(self, index, roll_rad):
        """Extent [px], change of speed, and deviation [deg] from the mean direction, of the exposure that begins at
        times[index], for a recorder that is rotated about the optical axis by `roll_rad`; None when the extent in the
        top, middle or bottom row is outside RECORDED_EXTENT_PX times the factor. Change and deviation are the largest
        of the three rows'."""
        height, samples = self.camera["size"][1], int(round(self.exposure / self.step))
        extents, changes, deviations = [], [], []
        for row in (0, height / 2, height - 1):
            begin = index + int(round(self.camera["readout_time"] * row / height / self.step))
            velocity = self._velocity(self.rates[begin:begin + samples + 1] @ about_optical_axis(roll_rad).T, row)
            speed = numpy.linalg.norm(velocity, axis=1)
            mean = velocity.mean(axis=0)
            extents.append(numpy.linalg.norm(mean) * self.exposure)
            changes.append((speed.max() - speed.min()) / speed.mean())
            across = mean[0] * velocity[:, 1] - mean[1] * velocity[:, 0]
            deviations.append(numpy.degrees(numpy.abs(numpy.arctan2(across, velocity @ mean)).max()))
        if min(extents) < self.factor * RECORDED_EXTENT_PX[0] or max(extents) > self.factor * RECORDED_EXTENT_PX[1]:
            return None
        return {"index": index, "roll_rad": roll_rad, "extent": extents[1], "change": max(changes),
                "deviation_deg": max(deviations)}

    def candidates(self):
        """All exposures that are neither too weak nor too strong, every 2 ms, for a recorder that is not rotated."""
        # The burst begins one frame before the middle one and ends one after it, with gyroscope on both sides.
        margin = int((1 / self.camera["fps"] + 0.2) / self.step)
        described = (self.describe(i, 0.0) for i in range(margin, len(self.times) - margin, 2))
        return [d for d in described if d]

    def draw(self, pool, is_right, rng, taken):
        """One exposure of the pool and a rotation of the recorder, both at random, such that is_right(exposure) and it
        does not overlap with those in `taken`, which grows."""
        for i in rng.permutation(len(pool)):
            index = pool[i]["index"]
            if any(abs(index - other) * self.step < self.exposure for other in taken):
                continue
            drawn = self.describe(index, rng.uniform(0, 2 * math.pi))
            if drawn and is_right(drawn):
                taken.append(index)
                return dict(drawn, start=self.times[index])
        fail(f"the recording has no more than {len(taken)} of the exposures asked for")

    def rotation(self, begin, end, roll_rad):
        """Of the camera from one time of the recording to another: camera(end) -> camera(begin)."""
        R, axis = numpy.eye(3), about_optical_axis(roll_rad)
        for t in numpy.arange(begin, end, self.step):
            dt = min(self.step, end - t)
            rate = [numpy.interp(t + dt / 2, self.times, self.rates[:, k]) for k in range(3)]
            R = R @ cv2.Rodrigues(axis @ numpy.array(rate) * dt)[0]
        return R


def about_optical_axis(roll_rad):
    return cv2.Rodrigues(numpy.array([0.0, 0.0, roll_rad]))[0]


def photographs(names, data):
    return [OPENCV_DOC / name if "." in name else data / "oxford_affine" / name / "img1.png" for name in names]


def viewpoint(rng):
    """Position [m] and orientation (camera -> world) of a camera that looks at the wall."""
    position = numpy.append(rng.uniform(-VIEW_OFFSET_M, VIEW_OFFSET_M, 2), rng.uniform(-0.1, 0.1))
    target = numpy.append(rng.uniform(-TARGET_OFFSET_M, TARGET_OFFSET_M, 2), DISTANCE_M)
    z = (target - position) / numpy.linalg.norm(target - position)
    x = numpy.cross([0, 1, 0], z)
    x /= numpy.linalg.norm(x)
    look = numpy.column_stack([x, numpy.cross(z, x), z])
    return position, look @ about_optical_axis(math.radians(rng.uniform(-ROLL_DEG, ROLL_DEG)))


def write_scene(path, base, plane, trace_path, exposures, drawn, rng, seed):
    """A burst whose middle frame is the exposure `drawn` (see Exposures.draw)."""
    scene = dict(base, planes=[plane], seed=int(seed), frames=3)
    R_cam_imu = about_optical_axis(drawn["roll_rad"]) @ exposures.R_cam_imu
    scene["imu"] = dict(base["imu"], R_cam_imu=[float(v) for v in R_cam_imu.ravel()])
    begin = drawn["start"] - 1 / base["camera"]["fps"] - base["lead_time"]
    position, look = viewpoint(rng)
    middle = drawn["start"] + exposures.exposure / 2 + base["camera"]["readout_time"] / 2
    orientation = look @ exposures.rotation(begin, middle, drawn["roll_rad"]).T
    scene["motion"] = {
        "type": "gyro_trace", "file": str(trace_path), "start": float(begin), "scale": exposures.factor,
        "orientation": [math.degrees(v) for v in cv2.Rodrigues(orientation)[0].ravel()],
        "position": {"offset": [float(v) for v in position]},
    }
    path.write_text(yaml.safe_dump(scene, sort_keys=False))


class Pair:
    """A folder with scene1.yaml and scene2.yaml, and what the CSV says of the two bursts."""

    def __init__(self, folder, description):
        self.folder, self.description = folder, description


def plan_pairs(exposures, kinds, count, base, walls, trace_path, folder, seed):
    """Draws `count` pairs of each kind and wall and writes their scenes. With the same seed they are the same exposures,
    seen from the same viewpoints, whatever the strength."""
    rng = numpy.random.default_rng(seed)
    is_even = lambda e: e["change"] < EVEN and e["deviation_deg"] < STRAIGHT_DEG  # noqa: E731
    candidates = exposures.candidates()
    pairs = []
    for kind in kinds:
        is_right = is_even if kind == "even" else lambda e: not is_even(e)
        pool = [c for c in candidates if is_right(c)]
        print(f"  {kind}: {len(pool)} of {len(candidates)} exposures")
        for scene in walls:
            taken = []  # exposures of a scene do not overlap
            for index in range(1, count + 1):
                pair = Pair(folder / f"{kind}_{scene}_{index}", {"kind": kind, "pair": f"{scene} #{index}"})
                pair.folder.mkdir(parents=True, exist_ok=True)
                chosen = [exposures.draw(pool, is_right, rng, taken) for _ in range(2)]
                for view, drawn in enumerate(chosen, 1):
                    write_scene(pair.folder / f"scene{view}.yaml", base, walls[scene], trace_path, exposures, drawn,
                                rng, seed=1000 * seed + 10 * len(pairs) + view)
                    pair.description.update({
                        f"start{view}_s": drawn["start"], f"roll{view}_deg": math.degrees(drawn["roll_rad"]),
                        f"extent{view}_px": drawn["extent"], f"change{view}": drawn["change"],
                        f"deviation{view}_deg": drawn["deviation_deg"]})
                pairs.append(pair)
    return pairs


def run(program, *arguments):
    with one_line_about(program):
        done = subprocess.run([str(program), *map(str, arguments)], stderr=subprocess.PIPE, text=True, env=ONE_THREAD)
    if done.returncode != 0:
        fail(done.stderr.strip() or f"{program} {arguments[0]} ended with status {done.returncode}")


def rows_of(report, pair):
    """One line of the CSV for each method and kind of ground truth."""
    homography = report["homography"]
    common = dict(pair, matches=homography["matches"], inliers=homography["inliers"],
                  residual_px=homography["residual_px"],
                  protocol_error_px=homography["error"]["median_px"],
                  protocol_error_p95_px=homography["error"]["p95_px"],
                  best_homography_error_px=homography["error_of_best_homography"]["median_px"],
                  blocks=sum(f["blocks"] for f in report["frames"]),
                  rejected=sum(f["rejected"] for f in report["frames"]),
                  too_curved=sum(f["too_curved"] for f in report["frames"]))
    for truth in GROUND_TRUTHS:
        for method, value in report[truth].items():
            yield dict(common, ground_truth=truth, method=method, repeatability=value["repeatability"],
                       error_px=value["error_px"], correspondences=value["correspondences"],
                       keypoints=min(value["keypoints"]))


def means(rows, **where):
    """Mean repeatability [%] and error [px] of each method over the rows that fit `where`."""
    result = {}
    for row in rows:
        if all(row[key] == value for key, value in where.items()):
            result.setdefault(row["method"], []).append((100 * row["repeatability"], row["error_px"]))
    return {method: tuple(numpy.nanmean(numpy.array(values), axis=0)) for method, values in result.items()}


def pair_table(rows, kind, truth):
    """The pairs of one kind, as the paper's table. Rows of one strength, here and below."""
    methods = methods_in(rows)
    chosen = [r for r in rows if r["kind"] == kind and r["ground_truth"] == truth]
    lines = []
    for name in dict.fromkeys(r["pair"] for r in chosen):
        here = {r["method"]: r for r in chosen if r["pair"] == name}
        pair = next(iter(here.values()))
        lines.append([name, f"{pair['extent1_px']:.0f}, {pair['extent2_px']:.0f}",
                      f"{100 * pair['change1']:.0f} %, {100 * pair['change2']:.0f} %",
                      f"{pair['deviation1_deg']:.0f}, {pair['deviation2_deg']:.0f} deg",
                      *(cell for m in methods for cell in (number(here[m]["repeatability"], 1, 100),
                                                           number(here[m]["error_px"]))),
                      number(pair["protocol_error_px"]) + " px"])
    average = means(rows, kind=kind, ground_truth=truth)
    lines.append(["mean", "", "", "", *(f"**{number(value)}**" for m in methods for value in average[m]),
                  number(numpy.mean([r["protocol_error_px"] for r in chosen])) + " px"])
    return table(["pair", "extent [px]", "speed changes by", "direction by", *method_columns(methods),
                  "homography off by"], lines)


def truth_table(rows, kind):
    """Means of one kind for every kind of ground truth, and with smoothed images."""
    methods = methods_in(rows)
    cases = [(name, means(rows, kind=kind, ground_truth=truth)) for truth, name in GROUND_TRUTHS.items()]
    average = means(rows, kind=kind, ground_truth="truth")
    cases.append(("each keypoint's true place, all images smoothed",
                  {plain: average[method] for method, plain in SMOOTHED.items()}))
    lines = [[name, *(number(value) for m in methods for value in average.get(m, (None, None))),
              *(number(ratio, 2) for ratio in ratios(average))] for name, average in cases]
    return table(["keypoints are compared through", *method_columns(methods), "proposed / DoG rep.", "err."], lines)


def methods_in(rows):
    return [m for m in METHODS if any(r["method"] == m for r in rows)]


def method_columns(methods):
    return [title for m in methods for title in (METHODS[m] + " rep.", "err.")]


def ratios(average):
    """Proposed over DoG: repeatability, error."""
    return (average["proposed"][0] / average["dog"][0], average["proposed"][1] / average["dog"][1])


def plot(rows, path):
    kinds = [k for k in KINDS if any(r["kind"] == k for r in rows)]
    methods = methods_in(rows)
    colors = {"dog": "tab:gray", "pretto": "tab:orange", "proposed": "tab:blue"}
    figure, axes = pyplot.subplots(2, len(kinds), figsize=(5.5 * len(kinds), 6.5), sharey="row", squeeze=False)
    for column, kind in enumerate(kinds):
        chosen = [r for r in rows if r["kind"] == kind and r["ground_truth"] == "truth"]
        names = list(dict.fromkeys(r["pair"] for r in chosen))
        for m, method in enumerate(methods):
            values = {r["pair"]: r for r in chosen if r["method"] == method}
            at = numpy.arange(len(names)) + (m - (len(methods) - 1) / 2) * 0.27
            axes[0, column].bar(at, [100 * values[n]["repeatability"] for n in names], 0.25, color=colors[method],
                                label=METHODS[method])
            axes[1, column].bar(at, [values[n]["error_px"] for n in names], 0.25, color=colors[method])
        axes[0, column].set_title(KINDS[kind].replace(": ", ":\n"), fontsize=9)
        for row in range(2):
            axes[row, column].set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=8)
            axes[row, column].grid(axis="y", alpha=0.4)
    axes[0, 0].set_ylabel("repeatability at 500 detections [%]")
    axes[1, 0].set_ylabel("localisation error [px]")
    axes[0, 0].set_ylim(0, 1.25 * axes[0, 0].get_ylim()[1])  # room for the legend
    axes[0, 0].legend(loc="upper left", ncol=3, fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=100)


def make_walls(arguments, notes):
    """The plane with photographs of each wall, by its name; `notes` grows by what is absent."""
    walls = {}
    for scene, names in WALLS.items():
        texture = (arguments.out / f"wall_{scene}.png").resolve()
        absent = photo_wall.compose(photographs(names, arguments.data.resolve()), COLUMNS, texture, arguments.seed,
                                    mirrored=True)
        walls[scene] = photo_wall.plane(texture, (COLUMNS, 2 * len(names) // COLUMNS), TILE_M, DISTANCE_M)
        if absent:
            notes.append(f"Photographs of the wall {scene} that are absent, with rectangles in their place: "
                         + ", ".join(absent))
    return walls


def find_trace(arguments, notes):
    """The recorded hand-shake, or a made-up one where it is absent, of which `notes` then has a line."""
    path = (arguments.data / "handshake_gyro" / "gyro_test.txt").resolve()
    if not path.exists():
        path = (arguments.out / "made_up_trace.txt").resolve()
        substitute_trace(path, arguments.seed)
        notes.append("The hand-shake recording is absent: a made-up one was used.")
    return path


def measure(pair, arguments):
    """The program's report on a pair, which is simulated for it."""
    report = pair.folder / "report.json"
    if not (arguments.resume and report.exists()):
        options = ["--only-dog"] if arguments.calibrate else []
        run(arguments.program, "simulate", pair.folder / "scene1.yaml", pair.folder / "scene2.yaml", pair.folder)
        run(arguments.program, "evaluate", pair.folder, "--json", report, *options)
        if not arguments.keep_bursts:
            for view in ("first", "second"):
                shutil.rmtree(pair.folder / view)
    return read_json(report)


def measure_all(pairs, arguments):
    # A pair on each core: detectors use one core most of the time.
    with ThreadPoolExecutor(arguments.jobs) as pool:
        return list(tqdm(pool.map(lambda pair: measure(pair, arguments), pairs), total=len(pairs), unit="pair",
                         mininterval=1))


def calibrate(arguments, plan):
    """Says what DoG repeats at each of CALIBRATION_FACTORS. plan(factor, kinds, count, folder): see plan_pairs."""
    for factor in CALIBRATION_FACTORS:
        pairs = plan(factor, ["even"], CALIBRATION_PAIRS, arguments.out / f"calibration_{factor}")
        values = [100 * report["truth"]["dog"]["repeatability"] for report in measure_all(pairs, arguments)]
        print(f"  factor {factor}: DoG {numpy.mean(values):.1f} % (" + ", ".join(f"{v:.1f}" for v in values)
              + f"); the paper: {PAPER['dog'][0]} %")


def evaluate(arguments, plan):
    """The lines of the CSV. plan: as for calibrate()."""
    pairs = []
    for strength in arguments.strengths:
        print(f"  {strength}:")
        for pair in plan(STRENGTHS[strength], arguments.kinds, PAIRS, arguments.out / "bursts" / strength):
            pair.description = dict(strength=strength, **pair.description)
            pairs.append(pair)
    if arguments.quick:
        pairs = pairs[:1]
    reports = measure_all(pairs, arguments)
    return [row for pair, report in zip(pairs, reports) for row in rows_of(report, pair.description)]


def write_results(out, rows, notes):
    with open(out / "real_world.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    text = []
    for strength, factor in STRENGTHS.items():
        of_strength = [r for r in rows if r["strength"] == strength]
        if not of_strength:
            continue
        text += [f"# {strength.capitalize()}: rates times {factor:g}", ""]
        for kind, title in KINDS.items():
            if any(r["kind"] == kind for r in of_strength):
                text += [f"{title}; {GROUND_TRUTHS['truth']}:".capitalize(), "",
                         *pair_table(of_strength, kind, "truth"), "", *truth_table(of_strength, kind), ""]
        plot(of_strength, out / f"real_world_{strength}.png")
    repeatability, error = ratios(PAPER)
    text += ["The paper: " + ", ".join(f"{METHODS[m]} {r:.1f} % and {e:.1f} px" for m, (r, e) in PAPER.items())
             + f"; proposed / DoG: repeatability {repeatability:.2f}, error {error:.2f}", ""]
    write_markdown(out / "real_world.md", text + notes)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=pathlib.Path, help="folder for the results")
    parser.add_argument("--program", type=pathlib.Path, required=True, help="the built real_world")
    parser.add_argument("--data", type=pathlib.Path, default=ROOT.parent / "shared" / "data",
                        help="folder with handshake_gyro and oxford_affine")
    parser.add_argument("--seed", type=int, default=1, help="of the choice of exposures, viewpoints and noise [1]")
    parser.add_argument("--quick", action="store_true", help="one even pair only")
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS), help="[both]")
    parser.add_argument("--strengths", nargs="+", choices=list(STRENGTHS), default=list(STRENGTHS), help="[both]")
    parser.add_argument("--resume", action="store_true",
                        help="do not measure again what an interrupted run with the same arguments has measured")
    parser.add_argument("--calibrate", action="store_true",
                        help="only measure what DoG repeats with other strengths of the shake; take another seed")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="pairs at a time [number of cores]")
    parser.add_argument("--keep-bursts", action="store_true", help="leave the images of all pairs")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)

    base = yaml.safe_load((ROOT / "experiments" / "scenes" / "real_world.yaml").read_text())
    notes = []
    trace_path = find_trace(arguments, notes)
    walls = make_walls(arguments, notes)

    def plan(factor, kinds, count, folder):
        exposures = Exposures(base, *load_trace(trace_path), factor)
        return plan_pairs(exposures, kinds, count, base, walls, trace_path, folder, arguments.seed)

    if arguments.calibrate:
        calibrate(arguments, plan)
    else:
        write_results(arguments.out, evaluate(arguments, plan), notes)


if __name__ == "__main__":
    main()
