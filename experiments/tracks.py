#!/usr/bin/python3
"""Plots what tracks --out wrote: errors from image to image by the blur's extent, for each tracker."""

import argparse
import csv
import pathlib

import common  # noqa: F401  (first: names the package of a module that is missing)
import matplotlib

from common import fail, one_line_about

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the backend has to be chosen first)

MIN_TRACKS = 100
COLORS = {"FeatureTracker, blurred": "tab:green", "FeatureTracker, sharp": "tab:blue", "LK, blurred": "tab:red",
          "LK, deblurred": "tab:orange", "LK, sharp": "black"}


def read(path):
    """Rows of a bin of extents, in order of these."""
    with open(path, newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file)
                if row["extent [px]"] != "all" and int(row["tracks"]) >= MIN_TRACKS]
    return sorted(rows, key=lambda row: int(row["extent [px]"].rstrip("+").split("-")[0]))


def plot(axes, rows):
    extents = list(dict.fromkeys(row["extent [px]"] for row in rows))
    for tracker, color in COLORS.items():
        own = [row for row in rows if row["tracker"] == tracker]
        x = [extents.index(row["extent [px]"]) for row in own]
        axes.plot(x, [float(row["median [px]"]) for row in own], "o-", color=color, markersize=4, label=tracker)
        axes.plot(x, [float(row["p90 [px]"]) for row in own], ":", color=color, linewidth=1)
    axes.set_xticks(range(len(extents)))
    axes.set_xticklabels(extents)
    axes.set_yscale("log")
    axes.grid(alpha=0.3, which="both")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=pathlib.Path, help="what --out was")
    folder = parser.parse_args().folder
    try:
        rows = read(folder / "tracks.csv")
    except (OSError, KeyError, ValueError) as error:
        fail(f"{folder / 'tracks.csv'}: {one_line_about(error)}")
    cases = sorted({(row["light"], row["speed"]) for row in rows})
    figure, axes = plt.subplots(1, len(cases), figsize=(3.4 * len(cases) + 0.6, 3.6), sharey=True, squeeze=False)
    for case, panel in zip(cases, axes[0]):
        plot(panel, [row for row in rows if (row["light"], row["speed"]) == case])
        panel.set_title(f"{case[0]}, x{case[1]}")
        panel.set_xlabel("extent of the blur [px]")
    axes[0][0].set_ylabel("error from image to image [px]\nmedian, and 90 % (dotted)")
    axes[0][0].legend(fontsize=7, loc="upper left")
    figure.tight_layout()
    figure.savefig(folder / "tracks.png", dpi=130)
    print(folder / "tracks.png")


if __name__ == "__main__":
    main()
