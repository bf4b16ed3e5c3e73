#!/usr/bin/python3
"""What deblurring is worth to a SLAM stack: recorded flights through a simulated room, sharp, blurred and deblurred.

Renders each flight (slam_sequences), deblurs it (deblur_bag), evaluates all by a stack or by the package's own tracks,
and writes results.json, tables (slam.md) and a plot (slam.png) into --out. What is in results.json already is not
measured again. Needs the devel space of this package (scripts/build.sh, then source build/devel/setup.bash) and
the program slam_sequences (cmake --build build --target slam_sequences).
"""

import argparse
import concurrent.futures
import contextlib
import dataclasses
import json
import pathlib
import shutil
import subprocess
import sys
import tempfile
import threading
from typing import Optional

import matplotlib
import numpy as np
import rosbag
from tqdm import tqdm

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent))
from common import ROOT, fail, write_markdown  # noqa: E402
from evaluators import Lost, OpenVins, OpenVinsTracks, OwnTracks, Recording, run_logged  # noqa: E402
from trajectory import read_truth  # noqa: E402

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the backend has to be chosen first)

DRONE, HAND, TUNING = "V1_02_medium", "tum_vi_room2", "V2_02_medium"
NAMES = {DRONE: "drone (EuRoC V1_02)", HAND: "hand-held (TUM VI room2)", TUNING: "drone (EuRoC V2_02)"}
LONGEST_S = {DRONE: 58, HAND: 28, TUNING: 85}  # of the recordings, as recorded, that can be flown
LEAD_S = 1.6  # of the IMU alone, before and after the images
LIGHTS = {"day": "", "low": "low light"}


@dataclasses.dataclass(frozen=True)
class Case:
    """What is rendered once."""
    flight: str
    exposure_ms: int
    speed: float = 1.0
    readout_ms: int = 0

    @property
    def key(self):
        return "%s_%dms_x%g_r%d" % (self.flight, self.exposure_ms, self.speed, self.readout_ms)

    def seconds(self, at_most):
        """Of the sequence: as long as the recording lasts."""
        return round(min(at_most, (LONGEST_S[self.flight] + LEAD_S) / self.speed - LEAD_S), 1)

    def conditions(self):
        parts = ["%d ms" % self.exposure_ms]
        if self.readout_ms:
            parts.append("readout %d ms" % self.readout_ms)
        if self.speed != 1:
            parts.append("x%g" % self.speed)
        return ", ".join(parts)


READOUT_MS = 20  # of the rolling shutter
REPORTED = [Case(flight, exposure_ms, speed, readout_ms) for readout_ms in (0, READOUT_MS) for flight in (DRONE, HAND)
            for speed in (1.7, 1.0) for exposure_ms in (30, 15)]
# What is chosen is chosen on another flight.
TUNED = [Case(TUNING, exposure_ms, speed) for speed in (1.7, 1.0) for exposure_ms in (30, 15)]


@dataclasses.dataclass(frozen=True)
class Variant:
    """How the images get to the evaluator."""
    options: Optional[dict] = dataclasses.field(default_factory=dict)  # of config/default.yaml; None: as in the bag
    without: tuple = ()           # topics that the package does not get
    exposure_factor: float = 0.0  # exposure_time is so many times the true one; 0: not given
    gives_readout: bool = False   # readout_time, which is in the exposure message as well


EXPOSURE, CAMERA_INFO, IMU, TF = "/camera/exposure", "/camera/camera_info", "/imu", "/tf_static"
VARIANTS = {"sharp": Variant(None), "blurred": Variant(None), "gyroscope": Variant({"optical_flow": False}),
            "package": Variant(), "exposure-unknown": Variant(without=(EXPOSURE,), gives_readout=True),
            "exposure-x0.6": Variant(without=(EXPOSURE,), exposure_factor=0.6, gives_readout=True),
            "exposure-x1.6": Variant(without=(EXPOSURE,), exposure_factor=1.6, gives_readout=True),
            "camera-info-only": Variant(without=(EXPOSURE, TF)), "no-imu": Variant(without=(IMU,)),
            "no-camera-info": Variant(without=(CAMERA_INFO,))}
MEASURED = ("sharp", "blurred", "package")
TITLES = {"sharp": "sharp", "blurred": "blurred", "gyroscope": "gyroscope alone", "package": "the package",
          "exposure-unknown": "exposure unknown", "exposure-x0.6": "exposure_time x0.6",
          "exposure-x1.6": "exposure_time x1.6", "camera-info-only": "camera_info alone", "no-imu": "no IMU",
          "no-camera-info": "no camera_info"}
COLORS = {"sharp": "tab:green", "blurred": "tab:red", "gyroscope": "tab:gray", "package": "tab:blue",
          "exposure-unknown": "tab:cyan", "exposure-x0.6": "gold", "exposure-x1.6": "tab:orange",
          "camera-info-only": "tab:brown", "no-imu": "tab:pink", "no-camera-info": "black"}
TRACK_TITLES = {"package": "tracks", "sharp": "tracks, sharp images"}
TRACK_COLORS = {"package": "tab:purple", "sharp": "tab:olive"}
# Nothing is deblurred: for tracks on images as they are.
UNTOUCHED = {"min_extent": 1, "max_extent": 1, "optical_flow": False}


def variant_of(name):
    """A named one, or the package with KEY=VALUE pairs."""
    if name in VARIANTS:
        return VARIANTS[name]
    options = {}
    for pair in name.split(","):
        key, _, value = pair.partition("=")
        if not value:
            fail("%s is neither one of %s nor KEY=VALUE" % (name, ", ".join(VARIANTS)))
        try:
            options[key] = json.loads(value)
        except ValueError:
            options[key] = value
    return Variant(options)


def variants_of(evaluator, variants):
    """Those that the evaluator can be given."""
    return [v for v in variants if v not in VARIANTS or v in getattr(evaluator, "variants", VARIANTS)]


KEY = ("case", "seconds", "light", "seed", "variant", "evaluator")  # of a result


class Study:
    """Measures what is missing."""

    def __init__(self, arguments):
        self.arguments = arguments
        self.path = arguments.out / "results.json"
        self.results = json.loads(self.path.read_text()) if self.path.exists() else []
        self._lock = threading.Lock()

    def _key(self, evaluator, case, light, seed, variant):
        return case.key, case.seconds(self.arguments.seconds), light, seed, variant, evaluator.name

    def keep(self, key, metrics):
        with self._lock:
            self.results.append({**dict(zip(KEY, key)), **metrics})
            part = self.path.with_suffix(".part")
            part.write_text(json.dumps(self.results, indent=1) + "\n")
            part.rename(self.path)

    def run(self, evaluators, cases, variants):
        seeds = list(range(1, self.arguments.seeds + 1))
        known = {tuple(r[k] for k in KEY) for r in self.results}
        missing = {case: [(evaluator, case, light, seed, variant) for evaluator in evaluators
                          for light in self.arguments.lights for seed in seeds
                          for variant in variants_of(evaluator, variants)
                          if self._key(evaluator, case, light, seed, variant) not in known] for case in cases}
        total = sum(map(len, missing.values()))
        with tqdm(total=total, unit="run", disable=None) as bar, \
                concurrent.futures.ThreadPoolExecutor(self.arguments.jobs) as pool:
            for case, jobs in missing.items():
                if not jobs:
                    continue
                with bags_of(case, self.arguments.lights, seeds, self.arguments) as folder:
                    waiting = [pool.submit(self.measure, folder, *job) for job in jobs]
                    for done in concurrent.futures.as_completed(waiting):
                        done.result()
                        bar.update()

    def measure(self, folder, evaluator, case, light, seed, variant):
        name = "%s_%s_%d_%s" % (case.key, light, seed, variant)
        recording = read_recording(case, folder, light, seed, "sharp" if variant == "sharp" else "blurred")
        how = variant_of(variant)
        with tempfile.TemporaryDirectory(dir=folder) as own:
            own = pathlib.Path(own)
            if how.options is not None or evaluator.reads_tracks:
                recording = deblur(recording, how, case, evaluator.reads_tracks, own)
            try:
                metrics = evaluator.evaluate(recording, own, name)
            except Lost as error:
                tqdm.write("%s: lost: %s" % (name, error), file=sys.stderr)
                metrics = dict.fromkeys(evaluator.metrics)
        self.keep(self._key(evaluator, case, light, seed, variant), metrics)


@contextlib.contextmanager
def bags_of(case, lights, seeds, arguments):
    """Folder with the bags of a case, rendered where they are not there already; it goes where none was named."""
    with contextlib.ExitStack() as stack:
        if arguments.bags:
            folder = arguments.bags / ("%s_%gs" % (case.key, case.seconds(arguments.seconds)))
        else:
            folder = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        if not all((folder / ("%s_%d_sharp.bag" % (light, seed))).exists() for light in lights for seed in seeds):
            run_logged([arguments.programs / "slam_sequences", "--flight", case.flight, "--seconds",
                        case.seconds(arguments.seconds), "--speed", case.speed, "--exposure-ms", case.exposure_ms,
                        "--readout-ms", case.readout_ms, "--out", folder, "--data", arguments.data, "--quiet",
                        "--lights", *lights, "--seeds", *seeds], arguments.out / "render.log")
        yield folder


def read_recording(case, folder, light, seed, kind):
    """kind: sharp or blurred."""
    sequence = json.loads((folder / "sequence.json").read_text())
    # To the middle of the exposure of the middle row; sharp images are stamped with that.
    shift_s = 0.0 if kind == "sharp" else 0.5 * (sequence["exposure_s"] + sequence["readout_s"])
    # The same in every line.
    biases = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1, max_rows=1)[11:17]
    return Recording(folder / ("%s_%d_%s.bag" % (light, seed, kind)), "/camera/image_raw", "/imu", shift_s,
                     bool(case.readout_ms) and kind != "sharp", sequence["camera"], sequence["imu"],
                     read_truth(folder / "truth.csv"), biases)


def copy_bag(source, target, wanted, mode="w"):
    """wanted: whether a topic's messages are copied."""
    with rosbag.Bag(str(source)) as messages, rosbag.Bag(str(target), mode) as bag:
        for topic, message, time in messages.read_messages(raw=True):
            if wanted(topic):
                bag.write(topic, message, time, raw=True)


def deblur(recording, how, case, tracks, folder):
    """Through deblur_bag. Returns the recording of its images, or of its tracks."""
    settings = dict(UNTOUCHED if how.options is None else how.options)
    if how.gives_readout:
        settings["readout_time"] = case.readout_ms * 1e-3
    if how.exposure_factor:
        settings["exposure_time"] = case.exposure_ms * 1e-3 * how.exposure_factor
    if recording.shift_s == 0:
        settings["exposure_time"] = 0.001  # sharp images come without one
    config, output = folder / "config.yaml", folder / "deblurred.bag"
    config.write_text("".join("%s: %s\n" % (key, json.dumps(value)) for key, value in settings.items()) or "{}\n")
    given = recording.bag
    if how.without:
        given = folder / "given.bag"
        copy_bag(recording.bag, given, lambda topic: topic not in how.without)
    command = ["rosrun", "gyro_deblur", "deblur_bag", given, output, "--config", config, "--no-keypoints",
               "--threads", 1, "--keep-all-topics"]
    if tracks:
        command.append("--tracks")
    if recording.rolling:
        command.append("--global-shutter")
    run_logged(command, folder / "deblur.log")
    if IMU in how.without:  # which the evaluator has
        copy_bag(recording.bag, output, lambda topic: topic == IMU, "a")
    return deblurred_recording(recording, tracks, output)


def deblurred_recording(recording, tracks, bag):
    """What deblur_bag makes of a recording: the topic of tracks or images, and what their stamps mean."""
    if recording.rolling:
        topic = "/camera/global_shutter/" + ("feature_tracks" if tracks else "image_raw")
        # Stamped with the instant that they show.
        return dataclasses.replace(recording, bag=bag, image_topic=topic, shift_s=0.0, rolling=False)
    topic = "/camera/" + ("feature_tracks" if tracks else "deblurred/image_raw")
    return dataclasses.replace(recording, bag=bag, image_topic=topic)


def cell(values):
    """Mean and its standard error; an infinite mean when one of them was lost."""
    if not values:
        return float("nan"), float("nan")
    if None in values:
        return float("inf"), float("nan")
    values = np.array(values)
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")


class Cells:
    """Results of one evaluator by case, light and variant."""

    def __init__(self, results, evaluator, seconds):
        """seconds: of a case, at most."""
        self.evaluator = evaluator
        self._results = [r for r in results if r["evaluator"] == evaluator.name]
        self._seconds = seconds

    def of(self, case, light, variant, metric):
        key = (case.key, case.seconds(self._seconds), light, variant)
        return cell([r[metric] for r in self._results if key == (r["case"], r["seconds"], r["light"], r["variant"])])


@dataclasses.dataclass(frozen=True)
class Column:
    """Of a table, and of the plot."""
    title: str
    color: str
    cells: Cells
    variant: str
    metric: str

    def of(self, case, light):
        return self.cells.of(case, light, self.variant, self.metric)


def columns_of(cells, variants, metric, tracks=None):
    """tracks: cells of the evaluator of the package's tracks; columns of their own."""
    columns = [Column(TITLES.get(v, v), COLORS.get(v), cells, v, metric)
               for v in variants_of(cells.evaluator, variants)]
    if tracks is not None:
        columns += [Column(TRACK_TITLES.get(v, "tracks, " + TITLES.get(v, v)), TRACK_COLORS.get(v, COLORS.get(v)), tracks,
                           v, metric)
                    for v in sorted(variants_of(tracks.evaluator, variants), key=lambda v: v == "sharp")]
    return columns


def share_of_the_way(cells, case, light, variant, metric):
    """From blurred to sharp [%]; nothing where what blur costs is within the noise."""
    (sharp, sharp_se), (blurred, blurred_se) = (cells.of(case, light, v, metric) for v in ("sharp", "blurred"))
    if not blurred - sharp > 2 * np.hypot(sharp_se, blurred_se):
        return None
    mean = cells.of(case, light, variant, metric)[0]
    return 100 * (blurred - mean) / (blurred - sharp) if np.isfinite([blurred, mean]).all() else None


def markdown(cells, tracks, cases, lights, variants):
    evaluator = cells.evaluator
    lines = []
    for metric, (title, digits) in evaluator.metrics.items():
        columns = columns_of(cells, variants, metric, tracks)
        way = metric == next(iter(evaluator.metrics)) and "package" in variants
        header = ["flight", "conditions"] + [c.title for c in columns] + (["of the way to sharp"] if way else [])
        lines += ["%s: %s; mean of seeds ± its standard error" % (evaluator.name, title), "",
                  "| " + " | ".join(header) + " |", "| " + " | ".join(["---"] * len(header)) + " |"]
        for case in cases:
            for light in lights:
                row = [NAMES[case.flight], ", ".join(filter(None, [case.conditions(), LIGHTS[light]]))]
                for column in columns:
                    mean, error = column.of(case, light)
                    row.append("lost" if np.isinf(mean) else "-" if np.isnan(mean) else
                               "%.*f" % (digits, mean) + ("" if np.isnan(error) else " ± %.*f" % (digits, error)))
                if way:
                    shares = [share_of_the_way(cells, case, light, v, metric) for v in ("gyroscope", "package")
                              if v in variants]
                    row.append(", ".join("-" if share is None else "%.0f %%" % share for share in shares))
                lines.append("| " + " | ".join(row) + " |")
        lines.append("")
        if tracks is not None:
            lines += ratio_lines(columns, cases, lights)
    return lines


def ratio_lines(columns, cases, lights):
    """Each column over the first: geometric mean of the cells' ratios, ± its standard error."""
    lines = []
    for light in lights:
        parts = []
        for column in columns[1:]:
            means = [(column.of(case, light)[0], columns[0].of(case, light)[0]) for case in cases]
            ratios = np.log([mean / first for mean, first in means if np.isfinite([mean, first]).all()])
            if len(ratios) == len(means) > 1:
                parts.append("%s %.2f ± %.2f" % (column.title, np.exp(ratios.mean()), np.exp(ratios.mean()) *
                                                 ratios.std(ddof=1) / np.sqrt(len(ratios))))
        if parts:
            lines += ["Over %s%s: %s" % (columns[0].title, ", " + LIGHTS[light] if LIGHTS[light] else "",
                                         ", ".join(parts)), ""]
    return lines


def plot(cells, tracks, cases, lights, variants, path):
    """A group of bars for each case and light; a row for each shutter."""
    metric, (title, _) = next(iter(cells.evaluator.metrics.items()))
    columns = columns_of(cells, variants, metric, tracks)
    rows = [[(case, light) for case in cases if case.readout_ms == readout_ms for light in lights]
            for readout_ms in sorted({case.readout_ms for case in cases})]
    figure, all_axes = plt.subplots(len(rows), 1, figsize=(max(8, 1.5 + 0.12 * len(columns) * max(map(len, rows))),
                                                             4.3 * len(rows)), sharey=True, squeeze=False)
    for groups, axes in zip(rows, all_axes[:, 0]):
        draw_bars(columns, groups, axes)
        axes.set_ylabel("%s: %s" % (cells.evaluator.name, title))
    all_axes[0, 0].legend(fontsize=8, ncol=min(6, len(columns)), loc="lower left", bbox_to_anchor=(0, 1), frameon=False)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_bars(columns, groups, axes):
    width = 0.8 / len(columns)
    for k, column in enumerate(columns):
        means, errors = zip(*(column.of(case, light) for case, light in groups))
        finite = [mean if np.isfinite(mean) else 0 for mean in means]
        for x, mean in enumerate(means):
            if np.isinf(mean):
                axes.annotate("lost", (x, 1), xycoords=("data", "axes fraction"), fontsize=7, va="top", rotation=90)
        axes.bar(np.arange(len(groups)) + (k - 0.5 * (len(columns) - 1)) * width, finite, width,
                 yerr=[error if np.isfinite(error) else 0 for error in errors], color=column.color, label=column.title,
                 hatch="//" if column.cells.evaluator.reads_tracks else None,
                 error_kw={"elinewidth": 0.8})
    axes.set_yscale("log")
    axes.set_xlim(-0.7, len(groups) - 0.3)
    axes.set_xticks(range(len(groups)))
    labels = []
    for case, light in groups:
        conditions = case.conditions().replace(", ", ",\n").replace("readout ", "readout\n")
        labels.append(filter(None, [NAMES[case.flight].split(" (")[0], conditions, LIGHTS[light]]))
    axes.set_xticklabels(["\n".join(label) for label in labels], fontsize=7)
    axes.grid(axis="y", alpha=0.3, which="both")


def parse_arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=pathlib.Path, required=True, help="folder for the results")
    parser.add_argument("--openvins", type=pathlib.Path, metavar="DEVEL",
                        help="devel space of a workspace with OpenVINS (ROS 1) [the package's own tracks evaluate]")
    parser.add_argument("--tracks", action="store_true",
                        help="with --openvins: evaluate by it on the package's tracks, too, not on corners of its own")
    parser.add_argument("--track-sigma-px", type=float,
                        help="standard deviation that it takes tracks to have [%g]" % OpenVinsTracks.SIGMA_PX)
    parser.add_argument("--tuning", action="store_true",
                        help="on the flight that defaults are chosen on, instead of those that are reported")
    parser.add_argument("--variants", nargs="+", default=list(MEASURED), metavar="VARIANT",
                        help="of %s, or KEY=VALUE[,KEY=VALUE] of the package's configuration [%s]" %
                        (", ".join(VARIANTS), " ".join(MEASURED)))
    parser.add_argument("--lights", nargs="+", choices=list(LIGHTS), default=list(LIGHTS))
    parser.add_argument("--seeds", type=int, default=3, help="draws of noise [%(default)d]")
    parser.add_argument("--seconds", type=float, default=20, help="of each flight, at most [%(default)g]")
    parser.add_argument("--only", nargs="+", default=[""], metavar="PART",
                        help="cases whose key contains one of these, such as V1_02_medium_30ms_x1.7_r0")
    parser.add_argument("--jobs", type=int, default=2, help="at a time [%(default)d]")
    parser.add_argument("--data", type=pathlib.Path, default=ROOT.parent / "shared" / "data",
                        help="recorded data, with trajectories/; see test/data/README.md")
    parser.add_argument("--programs", type=pathlib.Path, default=ROOT / "build" / "experiments",
                        help="where slam_sequences is")
    parser.add_argument("--bags", type=pathlib.Path,
                        help="folder where rendered bags are kept for the next time, 0.4 GB a run [they go]")
    parser.add_argument("--report", action="store_true", help="tables and plot of what is there; measure nothing")
    return parser.parse_args()


def main():
    arguments = parse_arguments()
    if not (arguments.data / "trajectories").is_dir():
        fail("there is no %s/trajectories; see test/data/README.md" % arguments.data)
    if arguments.tracks and not arguments.openvins:
        fail("--tracks needs --openvins")
    if arguments.track_sigma_px is not None and not arguments.tracks:
        fail("--track-sigma-px needs --tracks")
    if not arguments.report and shutil.which("rosrun") is None:
        fail("there is no rosrun: source build/devel/setup.bash")
    for name in arguments.variants:
        variant_of(name)  # says what is wrong with it
    arguments.out.mkdir(parents=True, exist_ok=True)
    cases = [case for case in (TUNED if arguments.tuning else REPORTED)
             if any(part in case.key for part in arguments.only)]
    types = [OpenVins] if arguments.openvins else [OwnTracks]
    if arguments.tracks:
        sigma_px = arguments.track_sigma_px
        types.append(OpenVinsTracks if sigma_px is None else OpenVinsTracks.with_sigma(sigma_px))
    if not arguments.openvins:
        cases = [case for case in cases if not case.readout_ms]  # it takes an image for one instant
    if not cases:
        fail("--only %s: there is no such case" % " ".join(arguments.only))
    study = Study(arguments)
    if not arguments.report:
        with contextlib.ExitStack() as stack:
            evaluators = [stack.enter_context(contextlib.closing(
                make(arguments.openvins, arguments.out) if arguments.openvins else make())) for make in types]
            study.run(evaluators, cases, arguments.variants)
    cells = [Cells(study.results, evaluator, arguments.seconds) for evaluator in types]
    tracks = cells[1] if len(cells) > 1 else None
    lines = markdown(cells[0], tracks, cases, arguments.lights, arguments.variants)
    write_markdown(arguments.out / "slam.md", lines)
    plot(cells[0], tracks, cases, arguments.lights, arguments.variants, arguments.out / "slam.png")
    print(arguments.out / "slam.png")


if __name__ == "__main__":
    try:
        main()
    except (RuntimeError, OSError, subprocess.SubprocessError) as error:
        fail(str(error))
