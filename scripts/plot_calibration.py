#!/usr/bin/env python3
"""Draws what calibrate --json wrote: the angular rates of image and gyroscope, and what its values leave over.

Top: the camera's rates about its three axes by the image and by the gyroscope, with the estimated offset, bias and
rotation; the curves must lie on each other. Bottom left: distance of the tracked points from their prediction, before
and after. Bottom right: the same against the image row; a wrong readout time shows as residuals that grow away from the
middle.
"""
import argparse

import missing_packages  # noqa: F401  (first: names the package of a module that is missing)
import matplotlib
import numpy as np

from report_tables import one_line_about, read_json

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the backend has to be chosen first)


def lengths(report, key):
    return np.array([np.hypot(*r[key]) for r in report["residuals"] if None not in r[key]])


def describe(report):
    offset, readout = report["time_offset_s"], report["readout_time_s"]
    bias = ", ".join("%.4f" % b["value"] for b in report["gyro_bias_rad_s"])
    return "time offset %.2f ± %.2f ms    readout %.2f ± %.2f ms    bias [%s] rad/s    rotation: %s" % (
        1e3 * offset["value"], 1e3 * offset["stddev"], 1e3 * readout["value"], 1e3 * readout["stddev"], bias,
        report["rotation_from"])


def draw(report):
    figure = plt.figure(figsize=(11, 8.5))
    grid = figure.add_gridspec(4, 2, height_ratios=[1, 1, 1, 1.9])
    figure.suptitle(describe(report), fontsize=10)
    t_ns = np.array([r["t_ns"] for r in report["rates"]], dtype=np.int64)
    t_s = (t_ns - t_ns[0]) * 1e-9
    image = np.array([r["image_rad_s"] for r in report["rates"]])
    gyro = np.array([r["gyro_rad_s"] for r in report["rates"]])
    first = None
    for axis, name in enumerate("xyz"):
        axes = figure.add_subplot(grid[axis, :], sharex=first)
        first = first or axes
        axes.plot(t_s, image[:, axis], color="tab:orange", linewidth=2.5, alpha=0.6, label="image")
        axes.plot(t_s, gyro[:, axis], color="tab:blue", linewidth=1, label="gyroscope")
        axes.set_ylabel("%s [rad/s]" % name)
        axes.grid(alpha=0.3)
        if axis == 0:
            axes.legend(loc="upper right", ncol=2, fontsize=8)
        if axis < 2:
            axes.tick_params(labelbottom=False)
    axes.set_xlabel("time [s]")

    cases = [("without_px", "no gyroscope", "tab:gray"), ("at_start_px", "offset found, not refined", "tab:orange"),
             ("estimated_px", "estimated", "tab:blue")]
    axes = figure.add_subplot(grid[3, 0])
    for key, name, colour in cases:
        values = np.sort(lengths(report, key))
        axes.plot(np.maximum(values, 1e-3), np.linspace(0, 1, len(values)), color=colour,
                  label="%s: median %.2f px" % (name, np.median(values)))
    axes.set_xscale("log")
    axes.set_xlabel("residual [px]")
    axes.set_ylabel("part of the points below")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)

    axes = figure.add_subplot(grid[3, 1])
    rows = np.array([r["row_px"] for r in report["residuals"]])
    edges = np.linspace(rows.min(), rows.max(), 13)
    centres = 0.5 * (edges[:-1] + edges[1:])
    for key, name, colour in cases[1:]:
        values = np.array([np.hypot(*r[key]) if None not in r[key] else np.nan for r in report["residuals"]])
        index = np.clip(np.digitize(rows, edges) - 1, 0, len(centres) - 1)
        medians = [np.nanmedian(values[index == i]) if np.any(index == i) else np.nan for i in range(len(centres))]
        axes.plot(centres, medians, "o-", color=colour, label=name)
    axes.set_ylim(bottom=0)
    axes.set_xlabel("image row [px]")
    axes.set_ylabel("median residual [px]")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
    figure.tight_layout(rect=(0, 0, 1, 0.97))
    return figure


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("report", help="JSON by calibrate")
    parser.add_argument("picture", help="PNG to write")
    arguments = parser.parse_args()
    report = read_json(arguments.report)
    with one_line_about(arguments.report):
        draw(report).savefig(arguments.picture, dpi=110)


if __name__ == "__main__":
    main()
