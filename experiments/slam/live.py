#!/usr/bin/python3
"""Nodelet, OpenVINS and player together in real time, against the way from bag to bag: latency, drops, error, load.

Renders one flight (slam_sequences), plays it through live.launch, and lets the same stack read the bag of deblur_bag;
in both it starts by itself, in flight. With --tracks it takes feature_tracks; gyro_deblur_openvins has to be built in its
workspace then (doc/guides/slam.md). Writes live.json and live.md into --out.
"""

import argparse
import bisect
import contextlib
import dataclasses
import json
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import threading
import time

import numpy as np
import rospy

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent))
from common import ROOT, fail, write_markdown  # noqa: E402
from evaluators import OpenVins, OpenVinsTracks, state_errors  # noqa: E402
from slam import DRONE, NAMES, Case, Variant, bags_of, deblur, read_recording  # noqa: E402

# It starts from what it sees and feels: there is no true state to start from.
OWN_START = {"init_dyn_use": True, "num_opencv_threads": 2}
PROGRAMS = {"deblur_manager": "gyro_deblur's nodelet", "stack": "OpenVINS", "conductor": "player and monitor"}


class Monitor:
    """When images and what is made of them arrive, by stamp, in real time."""

    def __init__(self, topics):
        self.arrived_s = {topic: {} for topic in topics}
        self._subscribers = [rospy.Subscriber(topic, rospy.AnyMsg, self._take, topic, buff_size=2**22)
                             for topic in topics]

    def _take(self, message, topic):
        # A message begins with its header: seq, then the stamp.
        seconds, nanoseconds = np.frombuffer(message._buff, dtype="<u4", count=3)[1:]
        self.arrived_s[topic].setdefault(int(seconds) * 10**9 + int(nanoseconds), time.monotonic())

    def latencies_ms(self, from_topic, to_topic, later_ns=0):
        """later_ns: by how much the second topic's stamps are later; a millisecond more or less is the same."""
        second = sorted(self.arrived_s[to_topic].items())
        latencies = []
        for stamp_ns, arrived_s in self.arrived_s[from_topic].items():
            i = bisect.bisect_left(second, (stamp_ns + later_ns - 1_000_000,))
            if i < len(second) and second[i][0] <= stamp_ns + later_ns + 1_000_000:
                latencies.append(1e3 * (second[i][1] - arrived_s))
        if not latencies:
            raise RuntimeError("no message of %s belongs to one of %s" % (to_topic, from_topic))
        return latencies

    def end(self):
        for subscriber in self._subscribers:
            subscriber.unregister()


class Load:
    """Processor time of the launched programs, by their node's name, from /proc."""

    def __init__(self):
        self.seconds = {}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self):
        ticks = os.sysconf("SC_CLK_TCK")
        while not self._over.wait(0.2):
            for process in pathlib.Path("/proc").glob("[0-9]*"):
                with contextlib.suppress(OSError, ValueError):
                    command = (process / "cmdline").read_bytes().decode(errors="replace").split("\0")
                    name = next((part[len("__name:="):] for part in command if part.startswith("__name:=")), None)
                    if name in PROGRAMS:
                        fields = (process / "stat").read_text().rpartition(")")[2].split()
                        self.seconds[name] = (int(fields[11]) + int(fields[12])) / ticks

    def end(self):
        self._over.set()
        self._thread.join()


def play(openvins, recording, config, folder, patience_s):
    """Through live.launch. Returns what was seen."""
    states, report = folder / "live_states.txt", folder / "play.json"
    settings = openvins.write_settings(recording, folder, OWN_START)
    # The stack's packages come from its own devel space, in addition to this one.
    launch = pathlib.Path(__file__).resolve().parent / "live.launch"
    command = "source '%s/setup.bash' --extend && exec roslaunch '%s'" % (openvins.devel, launch)
    for key, value in {"bag": recording.bag, "config": config, "settings": settings, "topic": recording.image_topic,
                       "tracks": str(openvins.reads_tracks).lower(), "states": states, "json": report}.items():
        command += " '%s:=%s'" % (key, value)
    load = Load()
    monitor = Monitor(["/camera/image_raw", recording.image_topic, "/stack/poseimu"])
    with open(folder / "live.log", "w", encoding="utf-8") as log:
        process = subprocess.Popen(["bash", "-c", command], stdout=log, stderr=subprocess.STDOUT,
                                   env=openvins.environment())
        try:
            status = process.wait(patience_s)
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)  # roslaunch then ends what it has started
                process.wait()
            load.end()
            monitor.end()
    if status != 0 or not report.exists():
        raise RuntimeError("roslaunch ended with status %d:\n%s" % (
            status, "\n".join((folder / "live.log").read_text(errors="replace").splitlines()[-20:])))
    frames = json.loads(report.read_text())
    return {"frames_in": frames["frames_in"], "frames_out": frames["frames_out"],
            "output_ms": monitor.latencies_ms("/camera/image_raw", recording.image_topic),
            # Stamped in the IMU's clock, with the instant that the image stands for.
            "pose_ms": monitor.latencies_ms("/camera/image_raw", "/stack/poseimu", round(1e9 * recording.shift_s)),
            "processor_s": load.seconds, "states": openvins.read_states(states)}


def quantiles(values):
    return "%.1f / %.1f / %.1f" % tuple(np.quantile(values, [0.5, 0.95, 1])) if len(values) else "-"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=pathlib.Path, required=True, help="folder for the results")
    parser.add_argument("--openvins", type=pathlib.Path, required=True, metavar="DEVEL",
                        help="devel space of a workspace with OpenVINS (ROS 1)")
    parser.add_argument("--tracks", action="store_true", help="OpenVINS takes feature_tracks, not images")
    parser.add_argument("--flight", default=DRONE, choices=sorted(NAMES))
    parser.add_argument("--exposure-ms", type=int, default=30)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--seconds", type=float, default=20, help="of the flight, at most [%(default)g]")
    parser.add_argument("--seeds", type=int, default=3, help="draws of noise [%(default)d]")
    parser.add_argument("--data", type=pathlib.Path, default=ROOT.parent / "shared" / "data")
    parser.add_argument("--programs", type=pathlib.Path, default=ROOT / "build" / "experiments")
    parser.add_argument("--bags", type=pathlib.Path, help="folder where rendered bags are kept [they go]")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    case = Case(arguments.flight, arguments.exposure_ms, arguments.speed)
    seeds = list(range(1, arguments.seeds + 1))
    runs = []
    stack = OpenVinsTracks if arguments.tracks else OpenVins
    node = arguments.openvins / "lib" / "gyro_deblur_openvins" / "openvins_tracks"
    if arguments.tracks and not node.is_file():
        fail("there is no %s: see doc/guides/slam.md" % node)
    with tempfile.TemporaryDirectory() as folder, bags_of(case, ["day"], seeds, arguments) as bags, \
            contextlib.closing(stack(arguments.openvins, arguments.out, OWN_START, from_truth=False)) as openvins:
        folder = pathlib.Path(folder)
        os.environ.update(openvins.environment())
        rospy.init_node("monitor", disable_signals=True)
        config = folder / "nodelet.yaml"
        config.write_text("{}\n")
        for seed in seeds:
            own = folder / str(seed)
            own.mkdir()
            recording = read_recording(case, bags, "day", seed, "blurred")
            offline = deblur(recording, Variant(), case, arguments.tracks, own)
            by_bag = openvins.estimate(offline, own, "bag_%d" % seed)
            live = play(openvins, dataclasses.replace(recording, image_topic=offline.image_topic), config, own,
                        10 * case.seconds(arguments.seconds) + 120)
            states = live.pop("states")
            runs.append(dict(live, seed=seed, live=state_errors(states, recording.truth), states=len(states.t_s),
                             bag=state_errors(by_bag, recording.truth), states_by_bag=len(by_bag.t_s)))
    seconds = case.seconds(arguments.seconds)
    (arguments.out / "live.json").write_text(
        json.dumps({"case": case.key, "seconds": seconds, "runs": runs}, indent=1) + "\n")
    lines = ["%s, %s, %g s; latencies from the image's arrival: median / 95 of 100 / largest" %
             (NAMES[case.flight], case.conditions(), seconds), "",
             "| seed | frames in / out | %s [ms] | pose [ms] | states live / by bag | "
             "error live / by bag [m] | relative, live / by bag [%%] | processor time of nodelet, stack [s] |" %
             ("tracks" if arguments.tracks else "deblurred image"),
             "| --- | --- | --- | --- | --- | --- | --- | --- |"]
    for run in runs:
        lines.append("| %d | %d / %d | %s | %s | %d / %d | %.3f / %.3f | %.2f / %.2f | %.1f, %.1f |" % (
            run["seed"], run["frames_in"], run["frames_out"], quantiles(run["output_ms"]),
            quantiles(run["pose_ms"]), run["states"], run["states_by_bag"], run["live"]["ate_m"], run["bag"]["ate_m"],
            run["live"]["rte_percent"], run["bag"]["rte_percent"], run["processor_s"].get("deblur_manager", 0),
            run["processor_s"].get("stack", 0)))
    write_markdown(arguments.out / "live.md", lines)


if __name__ == "__main__":
    try:
        main()
    except (RuntimeError, OSError, subprocess.SubprocessError) as error:
        fail(str(error))
