"""What the Snakefile needs in addition to rules: which bags there are, how they are sliced, and what became of them."""

import glob
import json
import math
import os
import re
import sys


def bags_by_name(bags):
    """Input bags by the name of their results.

    bags: a glob pattern, or a list of patterns and files. Raises ValueError when there is none, or two have one name.
    """
    patterns = [bags] if isinstance(bags, str) else list(bags)
    named = {}
    for path in sorted(path for pattern in patterns for path in glob.glob(pattern)):
        name = os.path.splitext(os.path.basename(path))[0]
        if name in named and named[name] != path:
            raise ValueError(f"{named[name]} and {path} would have one result, {name}.bag: give them different names")
        named[name] = path
    if not named:
        raise ValueError(f"bags = {bags!r}: there is no such file")
    return named


def pattern(name):
    """A regular expression for the name itself."""
    return re.escape(name)


def slices(path, slice_seconds):
    """deblur_bag's arguments for each slice of a bag; one slice without limits for slice_seconds = 0 [s].

    A bag that cannot be read is one slice too: its job then says what is wrong with it.
    """
    if slice_seconds < 0:
        raise ValueError(f"slice_seconds = {slice_seconds} is negative; 0 means one job a bag")
    if slice_seconds == 0:
        return [""]
    import rosbag  # not needed for whole bags

    try:
        with rosbag.Bag(path) as bag:
            duration_s = bag.get_end_time() - bag.get_start_time()
    except Exception as error:  # rosbag raises nearly anything for a broken file
        print(f"{path}: {error}", file=sys.stderr)
        return [""]
    count = max(1, math.ceil(duration_s / slice_seconds))
    limits = []
    for i in range(count):
        # Open at the end: what was recorded last belongs to the last slice, whatever rounding says.
        end = f" --end {(i + 1) * slice_seconds:.9f}" if i + 1 < count else ""
        limits.append(f"--start {i * slice_seconds:.9f}{end}")
    return limits


def _failure(output, name):
    """The last thing that the bag's jobs said, and where."""
    logs = glob.glob(f"{output}/logs/{glob.escape(name)}.log") + glob.glob(f"{output}/logs/{glob.escape(name)}.*.log")
    for log in sorted(logs, key=os.path.getmtime, reverse=True):
        with open(log, encoding="utf-8", errors="replace") as file:
            lines = [line.strip() for line in file if line.strip()]
        if lines and not os.path.exists(f"{output}/{name}.bag"):
            return f"{lines[-1]} ({log})"
    return f"ended without a word: killed, or not started ({output}/logs)"


def report(output, bags):
    """The report as Markdown, and the names of the bags that have no result."""
    rows, failed = [], []
    for name, path in bags.items():
        result = f"{output}/{name}.bag"
        if not os.path.exists(result):
            failed.append(name)
            rows.append(f"| {path} | **failed** | | {_failure(output, name)} |")
            continue
        with open(f"{output}/{name}.json", encoding="utf-8") as file:
            done = json.load(file)
        reasons = ", ".join(f"{reason} {count}" for reason, count in sorted(done["passed_through"].items()))
        rows.append(f"| {path} | {result} | {done['frames_out']} | {reasons or '-'} |")
    head = f"{len(bags) - len(failed)} of {len(bags)} bags have a result, {len(failed)} failed"
    if failed:
        head += ": " + ", ".join(failed)
    table = ["| bag | result | frames | passed through, or what failed |", "| --- | --- | --- | --- |"] + rows
    return head + "\n\n" + "\n".join(table) + "\n", failed


def write_report(output, bags):
    """Writes OUTPUT/report.md and says its first line."""
    text, _ = report(output, bags)
    os.makedirs(output, exist_ok=True)
    with open(f"{output}/report.md", "w", encoding="utf-8") as file:
        file.write(text)
    print(f"{text.splitlines()[0]}; see {output}/report.md", file=sys.stderr)
