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
import hashlib
import json
import os
import pathlib
import resource
import shutil
import sys
import threading
import time

import common  # noqa: F401  (first: names the package of a module that is missing)
import numpy
from tqdm import tqdm

import colmap
import colmap_models
from common import fail, one_line_about, read_json
from reconstruction_report import write_results
from reconstruction_sequence import BASELINE, OURS, VARIANTS, absent_photographs, read_truth, simulate

SKIPPED = 77

# Matchers, and variants at a time; each takes 0.5 GB. Two processes of COLMAP use two cores better than one process.
WORKERS = min(len(VARIANTS), os.cpu_count() or 1)
MIN_IMAGES = 3  # of a model that can be measured: as many positions determine its scale, rotation and translation


def create_matches(database, camera, folder, names):
    """A database with the features in `folder` and their matches."""
    colmap.remove_database(database)
    features = [colmap.load_features(folder / name, False) for name in names]
    colmap.create_database(database, camera, names)
    colmap.set_descriptors(database, features)
    colmap.match(database, features, folder.name, WORKERS)


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
            colmap.copy_database(work / f"matches_{source}.db", database)
            colmap.set_keypoints(database, [colmap.load_features(work / source / name, rectified) for name in names])
            colmap.verify(database, names, log, seed, verified)

        stages.once(f"verified_{variant}", verify_anew)
        if stopping.is_set():
            return
        folder = model_folder(work, variant)
        stages.once(f"model_{variant}", lambda: colmap.reconstruct(database, folder, log, seed, registered))

    pairs, images = len(variants) * len(colmap.pairs_to_match(len(names))), len(variants) * len(names)
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
        fail(f"--resume cannot go on: {path} is missing, which says what {work} was made with")
    if path.exists():
        before = read_json(path)
        for name, value in options.items():
            if before.get(name) != value:
                fail(f"--resume needs the options of the interrupted run: --{name} was {before.get(name)} and is "
                     f"{value}")
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
    with one_line_about(arguments.program):
        program = hashlib.sha256(arguments.program.read_bytes()).hexdigest()
    # Not the variants: each has stages of its own.
    same_options(work, {"quick": arguments.quick, "seed": arguments.seed, "max-features": arguments.max_features,
                        "program": f"sha256 {program}"})
    stages = Stages(work)
    with timed("simulation and features"):
        stages.once("features", lambda: simulate(arguments, work))
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
        model = colmap_models.largest_model(model_folder(work, variant))
        if model is None or len(model[0]) < MIN_IMAGES:
            print(f"  {VARIANTS[variant][2]}: no reconstruction")
            continue
        results[variant] = colmap_models.measure(model, truth, camera, numpy.random.default_rng(arguments.seed))

    write_results(arguments.out, truth, results, absent_photographs())
    if not arguments.keep:
        shutil.rmtree(work)
    if OURS in variants and OURS not in results:
        fail("nothing was reconstructed from the deblurred frames")


if __name__ == "__main__":
    main()
