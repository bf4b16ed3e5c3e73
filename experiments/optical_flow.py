#!/usr/bin/python3
"""Plots what optical_flow --out wrote: errors against what there was to find, and pictures before and after."""

import argparse
import csv
import pathlib

import common  # noqa: F401  (first: names the package of a module that is missing)
import cv2
import matplotlib
import numpy as np

from common import fail, one_line_about

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the backend has to be chosen first)

BINS = 12
# Column of displacement_samples.csv: name, color.
SOURCES = {"residual_px": ("gyroscope alone", "tab:gray"),
           "velocity_px": ("true velocity, median depth", "tab:orange"),
           "images_px": ("images", "tab:blue")}
STAGES = [("blurred", "as it arrived"), ("gyroscope", "deblurred by the gyroscope"), ("images", "and by the images")]


def read_samples(path):
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return [(row["flight"], {key: float(row[key]) for key in SOURCES}) for row in rows]


def plot_errors(samples, path):
    """Median and 90 % of the error in bins of equal numbers of blocks, by what the gyroscope left over."""
    flights = sorted({flight for flight, _ in samples})
    figure, all_axes = plt.subplots(1, len(flights), figsize=(4.2 * len(flights), 3.8), sharey=True, squeeze=False)
    for axes, flight in zip(all_axes[0], flights):
        values = {key: np.array([row[key] for of, row in samples if of == flight]) for key in SOURCES}
        order = np.array_split(np.argsort(values["residual_px"]), BINS)
        centers = [np.median(values["residual_px"][part]) for part in order]
        for key, (name, color) in SOURCES.items():
            axes.plot(centers, [np.median(values[key][part]) for part in order], color=color, marker="o", markersize=3,
                      label=name)
            axes.plot(centers, [np.quantile(values[key][part], 0.9) for part in order], color=color, linestyle=":")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_title(flight, fontsize=10)
        axes.set_xlabel("displacement the gyroscope does not know [px]")
        axes.grid(alpha=0.3, which="both")
    all_axes[0][0].set_ylabel("error: median, dotted 90 % [px]")
    all_axes[0][0].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def plot_objects(folder, trajectory, path):
    """One row for each object, one column for each stage."""
    objects = ["panned", "crosses"]
    figure, all_axes = plt.subplots(len(objects), len(STAGES), figsize=(11, 5.2))
    for row, name in zip(all_axes, objects):
        for axes, (stage, title) in zip(row, STAGES):
            file = folder / f"object_{name}_{trajectory}_{stage}.png"
            image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
            if image is None:
                fail(f"{file} cannot be read")
            height, width = image.shape
            crop = image[height // 2 - 150:height // 2 + 150, width // 2 - 210:width // 2 + 210]
            axes.imshow(crop, cmap="gray", vmin=0, vmax=255)
            axes.set_xticks([])
            axes.set_yticks([])
            if name == objects[0]:
                axes.set_title(title, fontsize=10)
        row[0].set_ylabel(name, fontsize=10)
    figure.tight_layout()
    figure.savefig(path, dpi=90)
    plt.close(figure)


def plot_shutter(folder, trajectory, path):
    """A checkered room as a rolling shutter saw it, and as the global-shutter image shows it."""
    figure, all_axes = plt.subplots(1, 2, figsize=(11, 3.9))
    for axes, (stage, title) in zip(all_axes, [("arrived", "as it arrived"), ("global", "global_shutter/image_raw")]):
        file = folder / f"shutter_{trajectory}_{stage}.png"
        image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        if image is None:
            fail(f"{file} cannot be read")
        axes.imshow(image, cmap="gray", vmin=0, vmax=255)
        axes.set_title(title, fontsize=10)
        axes.set_xticks([])
        axes.set_yticks([])
    figure.tight_layout()
    figure.savefig(path, dpi=90)
    plt.close(figure)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=pathlib.Path, help="of optical_flow --out")
    parser.add_argument("--trajectory", default="tum_vi_room2", help="whose pictures are shown [tum_vi_room2]")
    arguments = parser.parse_args()
    folder = arguments.folder
    samples = folder / "displacement_samples.csv"
    pictures = []
    if samples.exists():
        pictures.append(folder / "optical_flow.png")
        with one_line_about(samples):
            plot_errors(read_samples(samples), pictures[-1])
    if list(folder.glob(f"object_*_{arguments.trajectory}_*.png")):
        pictures.append(folder / "moving_object.png")
        plot_objects(folder, arguments.trajectory, pictures[-1])
    if list(folder.glob(f"shutter_{arguments.trajectory}_*.png")):
        pictures.append(folder / "global_shutter.png")
        plot_shutter(folder, arguments.trajectory, pictures[-1])
    if not pictures:
        fail(f"{folder} holds neither displacement_samples.csv nor pictures of {arguments.trajectory}")
    print("\n".join(str(picture) for picture in pictures))


if __name__ == "__main__":
    main()
