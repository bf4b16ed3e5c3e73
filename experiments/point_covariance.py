#!/usr/bin/python3
"""Plots what point_covariance --out wrote: errors squared over what was expected of them, and errors by what was said."""

import argparse
import csv
import pathlib

import common  # noqa: F401  (first: names the package of a module that is missing)
import matplotlib
import numpy as np

from common import fail

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the backend has to be chosen first)

MIN_POINTS = 100  # for a mean square that is right within a seventh, were they independent
STATUSES = {"DEBLURRED": "-", "SHARP": ":"}
SAID_BORDERS_PX = 0.05 * 2**(np.arange(17) / 2)  # of bins of standard deviations
SHOWN_PX = np.array([0.03, 8])  # of them, and of errors


def read(path):
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def errors_by_what_was_said(path, min_points=MIN_POINTS):
    """{kind of point: n x 3: standard deviation that was said, root mean square error [px, each of an axis], points}."""
    points, said, errors = [], [], []
    with open(path, newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            points.append(row["points"])
            said.append((float(row["cxx"]) + float(row["cyy"])) / 2)
            errors.append((float(row["ex"])**2 + float(row["ey"])**2) / 2)
    points, said, errors = np.array(points), np.array(said), np.array(errors)
    bins = np.digitize(np.sqrt(said), SAID_BORDERS_PX)
    result = {}
    for kind in dict.fromkeys(points):
        inside = [(points == kind) & (bins == i) for i in range(len(SAID_BORDERS_PX) + 1)]
        result[kind] = np.array([[np.sqrt(said[i].mean()), np.sqrt(errors[i].mean()), i.sum()]
                                 for i in inside if i.sum() >= min_points])
    return result


def plot_said(axes, bins):
    axes.plot(bins[:, 0], bins[:, 1], "o-", markersize=4, linewidth=0.7, fillstyle="none")
    axes.plot(SHOWN_PX, SHOWN_PX, color="black", linewidth=0.7)
    axes.fill_between(SHOWN_PX, SHOWN_PX / 2**0.5, SHOWN_PX * 2**0.5, color="black", alpha=0.06)  # as of squares above
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(SHOWN_PX)
    axes.set_ylim(SHOWN_PX)
    axes.grid(alpha=0.3)


def plot(axes, rows, columns):
    """Some columns over the extent, for each light, with a marker of its own for each column."""
    lights = list(dict.fromkeys(row["light"] for row in rows))
    for light, color in zip(lights, plt.get_cmap("viridis")(np.linspace(0, 0.85, len(lights)))):
        for status, style in STATUSES.items():
            bins = [row for row in rows if row["status"] == status and row["light"] == light
                    and int(row["points in it"]) >= MIN_POINTS]
            bins.sort(key=lambda row: float(row["mean extent [px]"]))
            extents = [float(row["mean extent [px]"]) for row in bins]
            for column, marker in columns.items():
                axes.plot(extents, [float(row[column]) for row in bins], style, marker=marker, markersize=4,
                          linewidth=0.7, color=color, fillstyle="none",
                          label=light if status == "DEBLURRED" and marker == "o" else None)
    axes.axhline(1, color="black", linewidth=0.7)
    axes.axhspan(0.5, 2, color="black", alpha=0.06)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(0.05, 20)
    axes.grid(alpha=0.3)


def draw(folder):
    rows = read(folder / "point_covariance.csv")
    kinds = list(dict.fromkeys(row["points"] for row in rows))
    said = errors_by_what_was_said(folder / "point_covariance_samples.csv")
    figure, axes = plt.subplots(3, len(kinds), figsize=(4.2 * len(kinds), 11), sharex="row", sharey="row")
    for column, kind in enumerate(kinds):
        of_kind = [row for row in rows if row["points"] == kind]
        plot(axes[0, column], of_kind, {"mean": "o", "median": "x"})
        plot(axes[1, column], of_kind, {"along": "o", "across": "x"})
        axes[0, column].set_title(kind, fontsize=10)
        axes[1, column].set_xlabel("extent [px]: solid deblurred, dotted left blurred")
        plot_said(axes[2, column], said[kind])
        axes[2, column].set_xlabel("standard deviation that was said [px]")
    axes[0, 0].set_ylabel("squared error over expected: o mean, x median")
    axes[1, 0].set_ylabel("squared error over expected: o along, x across")
    axes[2, 0].set_ylabel("root mean square error [px]")
    axes[0, 0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(folder / "point_covariance.png", dpi=90)
    print(folder / "point_covariance.png")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=pathlib.Path, help="that point_covariance --out wrote")
    arguments = parser.parse_args()
    path = arguments.folder / "point_covariance.csv"
    if not path.is_file():
        fail(f"there is no {path}")
    draw(arguments.folder)


if __name__ == "__main__":
    main()
