#!/usr/bin/env python3
"""Draws what soak --json wrote: memory and latency percentiles over simulated time."""

import argparse

import missing_packages  # noqa: F401  (first: names the package of a module that is missing)
import matplotlib

from report_tables import one_line_about, read_json

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the backend has to be chosen first)


def draw(report):
    windows = report["windows"]
    minutes = [window["t_s"] / 60 for window in windows]

    figure, (memory, latency, processor) = plt.subplots(3, 1, figsize=(9, 8), sharex=True, constrained_layout=True)
    memory.plot(minutes, [window["memory_mib"] for window in windows], color="tab:purple")
    memory.set_ylabel("resident memory [MiB]")
    for axes, prefix, label in ((latency, "", "latency of a frame [ms]"), (processor, "processor_", "processor time [ms]")):
        for percentile, color in (("p50", "tab:green"), ("p95", "tab:orange"), ("p99", "tab:red")):
            axes.plot(minutes, [window[f"{prefix}{percentile}_ms"] for window in windows], color=color, label=percentile)
        if prefix:
            axes.plot(minutes, [window["yardstick_ms"] for window in windows], color="grey", linestyle="--",
                      label="the same work always")
        axes.set_ylabel(label)
        axes.legend(loc="upper right", ncol=4)
    for axes in (memory, latency, processor):
        axes.set_ylim(bottom=0, top=1.25 * axes.get_ylim()[1])
        axes.grid(alpha=0.3)
    processor.set_xlabel("simulated time [min]")
    figure.suptitle(f"{report['frames_in']} frames in, {report['frames_out']} out, {report['lost']} lost")
    return figure


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("json", help="points")
    parser.add_argument("png", help="picture to write")
    arguments = parser.parse_args()
    report = read_json(arguments.json)
    with one_line_about(arguments.json):
        draw(report).savefig(arguments.png, dpi=110)


if __name__ == "__main__":
    main()
