#!/usr/bin/python3
"""Plots what image_quality --out wrote: corners that are found again, against what was expected of them."""

import argparse
import csv
import pathlib

import common  # noqa: F401  (first: names the package of a module that is missing)
import matplotlib
import numpy as np

from common import fail

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the backend has to be chosen first)

MIN_CORNERS = 300  # for a share that is right within .03
BINS = 10
IMAGES = {"blurred": "tab:red", "deblurred": "tab:green"}


def read(path):
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def plot_blocks(axes, rows):
    """What is found again over the extent, and the model, for each light."""
    lights = list(dict.fromkeys(row["light"] for row in rows))
    for status, marker in ("DEBLURRED", "o"), ("SHARP", "x"):
        for light, color in zip(lights, plt.get_cmap("viridis")(np.linspace(0, 0.85, len(lights)))):
            bins = [row for row in rows if row["status"] == status and row["light"] == light
                    and int(row["corners"]) >= MIN_CORNERS]
            extents = [float(row["mean extent [px]"]) for row in bins]
            label = light if status == "DEBLURRED" else None
            axes.plot(extents, [float(row["repeated"]) for row in bins], marker, markersize=4, color=color, label=label)
            axes.plot(extents, [float(row["expected"]) for row in bins], color=color, linewidth=0.8)
    axes.set_xscale("log")
    axes.set_xlabel("extent [px]: o deblurred, x left blurred, lines: expected")
    axes.set_ylabel("share of corners found again")
    axes.legend(fontsize=8)


def plot_frames(axes, rows):
    """Each frame, and the mean of those of about the same score."""
    for image, color in IMAGES.items():
        of_image = [(float(row["score"]), float(row["repeated"])) for row in rows if row["image"] == image]
        axes.plot(*zip(*of_image), ".", markersize=2, color=color, alpha=0.4, label=image)
    pairs = sorted((float(row["score"]), float(row["repeated"])) for row in rows)
    for part in np.array_split(np.array(pairs), BINS):
        axes.errorbar(part[:, 0].mean(), part[:, 1].mean(), part[:, 1].std(), color="black", marker="o", markersize=4)
    axes.plot([0, 1], [0, 1], color="black", linewidth=0.5)
    axes.set_xlabel("score of the image")
    axes.legend(fontsize=8)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=pathlib.Path, help="that image_quality --out wrote")
    arguments = parser.parse_args()
    blocks, frames = arguments.folder / "image_quality_blocks.csv", arguments.folder / "image_quality_frames.csv"
    for path in blocks, frames:
        if not path.is_file():
            fail(f"there is no {path}")
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.6), sharey=True)
    plot_blocks(axes[0], read(blocks))
    plot_frames(axes[1], read(frames))
    for each in axes:
        each.grid(alpha=0.3)
        each.set_ylim(0, 1)
    figure.tight_layout()
    figure.savefig(arguments.folder / "image_quality.png", dpi=110)
    print(arguments.folder / "image_quality.png")


if __name__ == "__main__":
    main()
