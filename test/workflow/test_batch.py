#!/usr/bin/env python3
"""Twenty small bags through the workflow on two workers, one of them corrupt and one job killed on the way."""

import hashlib
import os
import shutil
import stat
import subprocess
import sys
import tempfile

import rosbag

BAGS = 20
CORRUPT, KILLED = "bag_05", "bag_07"
FRAMES = 6

# Stands for deblur_bag: notes each call, and kills the job of one bag, with all that it started, the first time.
WRAPPER = """#!/bin/bash
echo "$1" >> "{folder}/calls"
if [[ "$1" == *{killed}.bag && ! -e "{folder}/killed" ]]; then
  touch "{folder}/killed"
  "{deblur_bag}" "$@" &
  while kill -0 $! 2> /dev/null && [[ ! -e "$2.part" ]]; do sleep 0.01; done
  kill -9 $!
  kill -9 $$
fi
exec "{deblur_bag}" "$@"
"""


def check(condition, text):
    if not condition:
        sys.exit(f"FAILED: {text}")
    print(f"ok: {text}")


def hash_of(path):
    with open(path, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()


def messages(path):
    with rosbag.Bag(path) as bag:
        return [(topic, time.to_nsec(), message[1]) for topic, message, time in bag.read_messages(raw=True)]


class Batch:
    """A folder with bags, and the workflow in it."""

    def __init__(self, source, simulate_bag, deblur_bag, folder):
        self.source, self.deblur_bag, self.folder = source, deblur_bag, folder
        self.config = os.path.join(source, "test", "faults", "config.yaml")
        os.makedirs(self.path("bags"))
        for i in range(BAGS):
            subprocess.run([simulate_bag, self.path("bags", f"bag_{i:02}.bag"), "--scene",
                            os.path.join(source, "test", "faults", "scene.yaml"), "--frames", str(FRAMES), "--seed",
                            str(i + 1), "--no-truth", "--quiet"], check=True, stdout=subprocess.DEVNULL)
        broken = self.path("bags", CORRUPT + ".bag")
        os.truncate(broken, os.path.getsize(broken) * 6 // 10)
        wrapper = self.path("wrapper.sh")
        with open(wrapper, "w", encoding="utf-8") as file:
            file.write(WRAPPER.format(folder=folder, deblur_bag=deblur_bag, killed=KILLED))
        os.chmod(wrapper, os.stat(wrapper).st_mode | stat.S_IXUSR)

    def path(self, *parts):
        return os.path.join(self.folder, *parts)

    def run(self, *settings):
        """Exit code and output of snakemake."""
        result = subprocess.run(
            ["snakemake", "--snakefile", os.path.join(self.source, "workflow", "Snakefile"), "--profile",
             os.path.join(self.source, "workflow", "profiles", "local"), "--nocolor", "--config",
             f"config={self.config}", f"deblur_bag={self.path('wrapper.sh')}", *settings],
            cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
        print(result.stdout[-2000:])
        return result.returncode

    def calls(self):
        """Input bags for which a job was started since the last look."""
        with open(self.path("calls"), encoding="utf-8") as file:
            names = sorted(os.path.basename(line.strip()) for line in file)
        os.remove(self.path("calls"))
        return names

    def report(self):
        with open(self.path("results", "report.md"), encoding="utf-8") as file:
            return file.read()

    def results(self):
        """Time of last change of each result."""
        return {name: os.path.getmtime(self.path("results", name)) for name in os.listdir(self.path("results"))
                if name.endswith(".bag")}

    def sequential(self, name):
        """The result of deblur_bag alone."""
        output = self.path(name + ".sequential.bag")
        subprocess.run([self.deblur_bag, self.path("bags", name + ".bag"), output, "--config", self.config],
                       check=True, stdout=subprocess.DEVNULL)
        return output


def main():
    source, simulate_bag, deblur_bag = sys.argv[1:]
    if shutil.which("snakemake") is None:
        print("SKIPPED:\nthere is no snakemake")
        sys.exit(77)
    with tempfile.TemporaryDirectory(prefix="gyro_deblur_batch_") as folder:
        batch = Batch(source, simulate_bag, deblur_bag, folder)
        check(batch.run() != 0, "the first run says that something failed")
        first = batch.results()
        check(len(batch.calls()) == BAGS, "the first run starts a job for every bag")
        check(len(first) == BAGS - 2, f"the first run has {BAGS - 2} results")
        check(f"{BAGS - 2} of {BAGS} bags have a result, 2 failed: {CORRUPT}, {KILLED}" in batch.report(),
              "its report names the corrupt bag and the killed job")
        check(not os.path.exists(batch.path("results", KILLED + ".bag")), "nothing half-written has a result's name")

        check(batch.run() != 0, "the second run says that something failed")
        second = batch.results()
        check(batch.calls() == [CORRUPT + ".bag", KILLED + ".bag"], "the second run redoes only what is missing")
        check(len(second) == BAGS - 1, f"the second run has {BAGS - 1} results")
        check(all(second[name] == time for name, time in first.items()), "results of the first run are untouched")
        report = batch.report()
        check(f"{BAGS - 1} of {BAGS} bags have a result, 1 failed: {CORRUPT}" in report, "its report names one failure")
        check(f"| bags/{CORRUPT}.bag | **failed** |" in report and "run rosbag reindex" in report,
              "with the cause")

        for name in sorted(second):
            stem = os.path.splitext(name)[0]
            if hash_of(batch.path("results", name)) != hash_of(batch.sequential(stem)):
                check(False, f"{name} is that of a sequential run, byte for byte")
        check(True, f"all {len(second)} results are those of sequential runs, byte for byte")

        os.remove(batch.path("bags", CORRUPT + ".bag"))
        check(batch.run("slice_seconds=0.3", "output=sliced", "bags=bags/bag_00.bag") == 0, "a bag in slices succeeds")
        check(len(batch.calls()) > 1, "with more than one job")
        check(messages(batch.path("sliced", "bag_00.bag")) == messages(batch.path("bag_00.sequential.bag")),
              "and the same messages as a sequential run")


if __name__ == "__main__":
    main()
