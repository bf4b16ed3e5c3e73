#!/usr/bin/env python3
"""Draws one page of what calibrate --json wrote: each number with its verdict, and the evidence for it.

Rates: the camera's about its three axes by the image and by the gyroscope, with the estimated offset, bias and rotation;
the curves must lie on each other. Residuals: distance of the tracked points from their prediction, before and after, and
against the image row; a wrong readout time shows as residuals that grow away from the middle. Spectrum: power along the
motion over frequency times extent; the exposure is right where its zeros are at whole numbers.
"""
import argparse
import textwrap

import missing_packages  # noqa: F401  (first: names the package of a module that is missing)
import matplotlib
import numpy as np

from report_tables import one_line_about, read_json

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the backend has to be chosen first)

COLOURS = {"known": "tab:green", "given": "tab:blue", "not determined": "tab:red"}
RESIDUALS = [("without_px", "no gyroscope", "tab:gray"), ("at_start_px", "not refined", "tab:orange"),
             ("estimated_px", "estimated", "tab:blue")]


def lengths(report, key):
    return np.array([np.hypot(*r[key]) if None not in r[key] else np.nan for r in report["residuals"]])


def draw_verdicts(axes, verdicts):
    """A row for each number: its name, its state, its value, and the words below."""
    axes.axis("off")
    y = 1.0
    for verdict in verdicts:
        lines = textwrap.wrap(verdict["text"], 150)[:3]
        axes.text(0, y, verdict["key"], fontsize=10, fontweight="bold", va="top")
        axes.text(0.14, y, verdict["state"].upper(), fontsize=9, color=COLOURS[verdict["state"]], fontweight="bold",
                  va="top")
        axes.text(0.29, y, verdict["value"] or "-", fontsize=8.5, va="top", family="monospace")
        axes.text(0.14, y - 0.085, "\n".join(lines), fontsize=8.5, va="top", color="0.25")
        y -= 0.125 + 0.07 * len(lines)
    axes.set_ylim(min(0, y), 1)


def draw_rates(figure, cells, report):
    t_ns = np.array([r["t_ns"] for r in report["rates"]], dtype=np.int64)
    t_s = (t_ns - t_ns[0]) * 1e-9
    rates = {name: np.array([r[key] for r in report["rates"]])
             for name, key in (("image", "image_rad_s"), ("gyroscope", "gyro_rad_s"))}
    first = None
    for axis, name in enumerate("xyz"):
        axes = figure.add_subplot(cells[axis], sharex=first)
        first = first or axes
        axes.plot(t_s, rates["image"][:, axis], color="tab:orange", linewidth=2.5, alpha=0.6, label="image")
        axes.plot(t_s, rates["gyroscope"][:, axis], color="tab:blue", linewidth=1, label="gyroscope")
        axes.set_ylabel("%s [rad/s]" % name)
        axes.grid(alpha=0.3)
        if axis == 0:
            axes.set_title("rates of the camera, aligned", fontsize=9, loc="left")
            axes.legend(loc="upper right", ncol=2, fontsize=8)
        if axis < 2:
            axes.tick_params(labelbottom=False)
    axes.set_xlabel("time [s]")
    figure.align_ylabels()


def draw_distribution(axes, report):
    for key, name, colour in RESIDUALS:
        values = lengths(report, key)
        values = np.sort(values[~np.isnan(values)])
        if len(values) == 0:
            continue
        axes.plot(np.maximum(values, 1e-3), np.linspace(0, 1, len(values)), color=colour,
                  label="%s: median %.2f px" % (name, np.median(values)))
    axes.set_xscale("log")
    axes.set_xlabel("residual [px]")
    axes.set_ylabel("share of the points")
    axes.set_title("residuals of the points", fontsize=9, loc="left")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)


def draw_by_row(axes, report):
    rows = np.array([r["row_px"] for r in report["residuals"]])
    edges = np.linspace(rows.min(), rows.max(), 13)
    index = np.clip(np.digitize(rows, edges) - 1, 0, len(edges) - 2)
    for key, name, colour in RESIDUALS[1:]:
        values = lengths(report, key)
        medians = [np.nanmedian(values[index == i]) if np.any(~np.isnan(values[index == i])) else np.nan
                   for i in range(len(edges) - 1)]
        axes.plot(0.5 * (edges[:-1] + edges[1:]), medians, "o-", color=colour, label=name)
    axes.set_ylim(bottom=0)
    axes.set_xlabel("image row [px]")
    axes.set_ylabel("median residual [px]")
    axes.set_title("by row: flat where the readout time is right", fontsize=9, loc="left")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)


def nothing(axes, title, text):
    axes.set_title(title, fontsize=9, loc="left")
    axes.text(0.5, 0.5, text, ha="center", va="center", color="0.4", transform=axes.transAxes)
    axes.set_xticks([])
    axes.set_yticks([])


def draw_spectrum(axes, exposure):
    title = "blur along the motion: zeros at whole numbers"
    spectrum = exposure["spectrum"]
    if len(spectrum) < 10:  # a quarter of its range
        return nothing(axes, title, "no blur that determines the exposure")
    waves = np.array([p["waves"] for p in spectrum])
    power = np.array([p["log_power"] for p in spectrum])
    path = np.array([p["log_of_path"] for p in spectrum])
    # The texture of the scene is a smooth function of the frequency.
    weights = np.sqrt([p["count"] for p in spectrum])
    texture = np.polyval(np.polyfit(np.log(waves), power - path, 3, w=weights), np.log(waves))
    decibels = 10 / np.log(10)
    for zero in range(1, int(waves[-1]) + 1):
        axes.axvline(zero, color="tab:red", linestyle=":", linewidth=1)
    axes.plot(waves, decibels * power, "o", color="tab:blue", markersize=4, label="images")
    axes.plot(waves, decibels * (path + texture), color="tab:orange", label="blur of this exposure, texture fitted")
    axes.set_xlabel("frequency times extent [waves]")
    axes.set_ylabel("power [dB]")
    axes.set_title(title, fontsize=9, loc="left")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)


def draw_exposures(axes, exposure):
    title = "exposure time by single images"
    images = exposure.get("images", [])
    estimated = [i for i in images if i["estimate_s"] is not None]
    if not estimated:
        return nothing(axes, title, "no image determines it: the median blur is %.1f px"
                       % (np.median([i["extent_px"] for i in images]) if images else 0))
    begin_ns = images[0]["stamp_ns"]
    t_s = np.array([(i["stamp_ns"] - begin_ns) * 1e-9 for i in estimated])
    values_ms = 1e3 * np.array([i["estimate_s"] for i in estimated])
    errors_ms = values_ms * np.array([i["log_stddev"] for i in estimated])
    axes.errorbar(t_s, values_ms, yerr=errors_ms, fmt="o", color="tab:blue", markersize=3, linewidth=1,
                  label="%d of %d images" % (len(estimated), len(images)))
    for key, name, colour in (("given_s", "message", "tab:gray"), ("filtered_s", "filtered", "tab:orange")):
        line = [((i["stamp_ns"] - begin_ns) * 1e-9, 1e3 * i[key]) for i in images if i[key] is not None]
        if line and (key != "filtered_s" or exposure["varies"]):
            axes.plot(*zip(*line), color=colour, linewidth=1.2, label=name)
    if exposure["known"] and not exposure["varies"]:
        axes.axhline(1e3 * exposure["value_s"], color="tab:green", linewidth=1.2,
                     label="%.2f ms ± %.1f %%" % (1e3 * exposure["value_s"], 100 * exposure["log_stddev"]))
    # An image that is wrong by far does not squeeze the others.
    low, high = np.percentile(values_ms, (5, 95))
    axes.set_ylim(max(0, 0.7 * low), 1.3 * high)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("exposure [ms]")
    axes.set_title(title, fontsize=9, loc="left")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)


def draw(report):
    heights = [2.4, 2.9, 1.9, 1.9] if "rates" in report else [2.4, 1.9]
    figure = plt.figure(figsize=(11, 1.5 * sum(heights) + 0.5))
    grid = figure.add_gridspec(len(heights), 2, height_ratios=heights, hspace=0.3, left=0.075, right=0.97,
                               top=1 - 0.6 / figure.get_figheight(), bottom=0.6 / figure.get_figheight())
    figure.suptitle("Calibration from %s: %s, %s" % (report["bag"].rsplit("/", 1)[-1], report["topics"]["image"],
                                                     report["topics"]["imu"]), fontsize=11,
                    y=1 - 0.25 / figure.get_figheight())
    draw_verdicts(figure.add_subplot(grid[0, :]), report["verdicts"])
    if "rates" in report:
        draw_rates(figure, grid[1, :].subgridspec(3, 1, hspace=0.12), report)
        draw_distribution(figure.add_subplot(grid[2, 0]), report)
        draw_by_row(figure.add_subplot(grid[2, 1]), report)
    draw_spectrum(figure.add_subplot(grid[-1, 0]), report["exposure"])
    draw_exposures(figure.add_subplot(grid[-1, 1]), report["exposure"])
    return figure


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("report", help="JSON by calibrate")
    parser.add_argument("picture", help="PNG to write")
    arguments = parser.parse_args()
    report = read_json(arguments.report)
    with one_line_about(arguments.report):
        draw(report).savefig(arguments.picture, dpi=100)


if __name__ == "__main__":
    main()
