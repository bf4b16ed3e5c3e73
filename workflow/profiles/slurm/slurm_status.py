#!/usr/bin/env python3
"""Prints what became of a Slurm job: running, success or failed. Asks the controller, else the accounting database."""

import re
import subprocess
import sys

RUNNING = {"PENDING", "CONFIGURING", "RUNNING", "COMPLETING", "SUSPENDED", "REQUEUED", "RESIZING", "STAGE_OUT"}


def output_of(command):
    """What a command prints; nothing when it fails or is not there."""
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=30).stdout
    except (OSError, subprocess.SubprocessError):
        return ""


def state_of(job):
    """Slurm's name for the job's state; empty when nobody knows."""
    found = re.search(r"JobState=(\w+)", output_of(["scontrol", "show", "job", job]))
    if found:
        return found.group(1)
    # The controller forgets jobs some minutes after their end (MinJobAge).
    accounted = output_of(["sacct", "--noheader", "--parsable2", "--allocations", "--format=State", "--jobs", job])
    return accounted.split("\n")[0].split(" ")[0].strip()


def main():
    state = state_of(sys.argv[1])
    if state == "COMPLETED":
        print("success")
    elif state in RUNNING:
        print("running")
    else:
        print("failed")


if __name__ == "__main__":
    main()
