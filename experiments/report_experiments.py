#!/usr/bin/python3
"""Plots and tables from the results of synthetic and deconvolution_figure."""

import argparse
import csv
import io
import os

import common  # noqa: F401  (first: names the package of a module that is missing)
import cv2
import matplotlib
import numpy as np
from PIL import Image

from common import fail, number, one_line_about, read_json, titled_table

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the backend has to be chosen first)

TABLE_DETECTIONS = 500  # the paper's table has this number
# Color, line and marker of a method; wrong estimates share the proposed method's color.
STYLES = {
    "sharp": ("black", ":", None),
    "DoG": ("#1f77b4", "-", "s"),
    "Pretto et al.": ("#2ca02c", "-", "D"),
    "frequency domain": ("#9467bd", "--", "v"),
    "frequency domain, tapered": ("#8c564b", "--", "^"),
    "proposed": ("#d62728", "-", "o"),
    "proposed, taps of the transform": ("#e377c2", "--", "o"),
    "beyond the paper": ("#ff7f0e", "-", "P"),
}
WRONG_LINES = ["-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1))]
PALETTE_COLORS = 128
# Regularizations in deconvolution.json.
RULES = {"paper": "paper", "fixed": "fixed", "adaptive": "adaptive (default)"}

# Files of deconvolution_figure and their titles.
PICTURES = [("blurred", "blurred"), ("frequency", "frequency domain"),
            ("frequency_tapered", "frequency domain, tapered"), ("spatial", "in space")]


def at(method, detections):
    return next(p for p in method["curve"] if p["detections"] == detections)


def synthetic_table(synthetic):
    rows = []
    for method in synthetic["methods"]:
        point, matching = at(method, TABLE_DETECTIONS), method.get("matching", {})
        rows.append([method["method"], number(point["repeatability"], 1, 100), number(point["error_px"], 2),
                     number(point["repeatability_normalized"], 1, 100), number(point["error_px_normalized"], 2),
                     number(matching.get("sift_correct"), 0), number(matching.get("orb_correct"), 0),
                     number(matching.get("sift_homographies"), 0, synthetic["pairs"])])
    header = ["method", "repeatability [%]", "error [px]", "same, discs of 30 px [%]", "its error [px]",
              "correct SIFT matches", "ORB", f"homographies of {synthetic['pairs']}"]
    return titled_table(f"{TABLE_DETECTIONS} detections, {synthetic['images']}, {synthetic['pairs']} pairs, "
                        f"noise {synthetic['snr_db']:g} dB below the image:", header, rows)


def synthetic_ratios(synthetic):
    """What the method gains over the blurred image."""
    methods = {m["method"]: at(m, TABLE_DETECTIONS) for m in synthetic["methods"]}
    if "DoG" not in methods:
        return ""
    lines = []
    for name in ("proposed", "proposed, taps of the transform", "beyond the paper"):
        if name not in methods:
            continue
        own, dog = methods[name], methods["DoG"]
        parts = []
        for suffix, text in (("", "as detected"), ("_normalized", "discs of 30 px")):
            ratio, dog_ratio = own["repeatability" + suffix], dog["repeatability" + suffix]
            error, dog_error = own["error_px" + suffix], dog["error_px" + suffix]
            if dog_ratio and error is not None and dog_error:
                parts.append(f"{text} {ratio / dog_ratio:.2f} times the repeatability, {error / dog_error:.2f} times the "
                             "error")
        lines.append(f"{name} against DoG at {TABLE_DETECTIONS} detections: " + "; ".join(parts))
    return "\n".join(lines)


def style_of(name, wrong):
    if name in STYLES:
        color, line, marker = STYLES[name]
        return {"color": color, "linestyle": line, "marker": marker, "markersize": 4}
    shade = 0.35 + 0.5 * wrong / len(WRONG_LINES)
    return {"color": plt.cm.Reds(shade), "linestyle": WRONG_LINES[wrong % len(WRONG_LINES)], "linewidth": 1}


def plot_synthetic(synthetic, path):
    quantities = [[("repeatability", "repeatability [%]", 100), ("error_px", "localisation error [px]", 1)],
                  [("repeatability_normalized", "repeatability [%], discs of 30 px", 100),
                   ("error_px_normalized", "localisation error [px], discs of 30 px", 1)]]
    figure, axes = plt.subplots(2, 2, figsize=(10, 8.5), dpi=90, sharex=True)
    for row, of_row in zip(axes, quantities):
        for panel, (key, label, factor) in zip(row, of_row):
            wrong = 0
            for method in synthetic["methods"]:
                points = [(p["detections"], factor * p[key]) for p in method["curve"] if p[key] is not None]
                style = style_of(method["method"], wrong)
                wrong += method["method"] not in STYLES
                panel.plot(*zip(*points), label=method["method"].replace("proposed eps=", "proposed, ε = "), **style)
            panel.set_ylabel(label)
            panel.set_ylim(bottom=0)
            panel.grid(True, alpha=0.3)
    for panel in axes[1]:
        panel.set_xlabel("detections")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.suptitle(f"{synthetic['images']}: 30° 27 px against 110° 47 px, noise {synthetic['snr_db']:g} dB",
                    fontsize=10)
    figure.legend(handles, labels, loc="lower center", ncol=4, fontsize=8)
    figure.tight_layout(rect=(0, 0.09, 1, 1))
    figure.savefig(path)
    plt.close(figure)


def deconvolution_table(deconvolution):
    rows = [[dict(PICTURES)[m["method"]], number(m["rmse_border"]), number(m["rmse_interior"])]
            for m in deconvolution["methods"]]
    header = ["method", f"border of {deconvolution['band_px']} px", "interior"]
    kernel = deconvolution["kernel"]
    share = kernel["taps"] / (kernel["width_px"] * kernel["height_px"])
    title = (f"RMSE [grey levels] against the sharp image, {deconvolution['images']}, {deconvolution['count']} images, "
             f"{deconvolution['angle_deg']:g} degrees, {deconvolution['extent_px']:g} px, "
             f"noise-to-signal ratio {deconvolution['noise_to_signal_ratio']:g}, "
             f"noise {deconvolution['noise_grey_levels']:g} grey level:")
    return (titled_table(title, header, rows)
            + f"\n\n2-D kernel: {kernel['width_px']} x {kernel['height_px']}, {kernel['taps']} elements "
              f"({100 * share:.1f} %) are not zero.")


def rules_table(deconvolution):
    """PSNR that the regularizations gain, a row for each noise and regularization, a column for each extent."""
    records = deconvolution["rules"]
    extents = sorted({r["extent_px"] for r in records})
    by_cell = {(r["noise_grey_levels"], r["rule"], r["extent_px"]): r for r in records}

    def cell(record):
        return f"{record['gain_db']:.2f} ({record['least_db']:.2f})"
    rows = [[f"{noise:g}", RULES[rule], *(cell(by_cell[noise, rule, extent]) for extent in extents)]
            for noise, rule in dict.fromkeys((r["noise_grey_levels"], r["rule"]) for r in records)]
    return titled_table("PSNR [dB] over the blurred image, mean (least), by noise [grey levels], regularization and extent:",
                        ["noise", "regularization", *(f"{extent:g} px" for extent in extents)], rows)


def save_with_palette(figure, path):
    """As PNG with PALETTE_COLORS colours: a third of the size where photographs are in it, and it looks the same."""
    pixels = io.BytesIO()
    figure.savefig(pixels, format="png")
    picture = Image.open(pixels).convert("RGB").quantize(PALETTE_COLORS, method=Image.MAXCOVERAGE, dither=Image.NONE)
    picture.save(path, optimize=True)


def plot_deconvolution(deconvolution, folder, path):
    def read(name):
        file = os.path.join(folder, f"deconvolution_{name}.png")
        image = cv2.imread(file, cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise OSError(f"{file}: cannot be read")
        return image

    def columns(name):
        with open(os.path.join(folder, f"deconvolution_{name}.csv"), newline="") as file:
            return np.array([[float(v) for v in row] for row in list(csv.reader(file))[1:]])

    figure = plt.figure(figsize=(11, 6.6), dpi=80)
    grid = figure.add_gridspec(3, 4, height_ratios=(0.8, 1, 0.75))
    side = 160
    for i, (name, title) in enumerate(PICTURES):
        image = read(name)
        panel = figure.add_subplot(grid[0, i])
        panel.imshow(image, cmap="gray", vmin=0, vmax=255)
        panel.set_title(f"({'abcd'[i]}) {title}", fontsize=9)
        detail = figure.add_subplot(grid[1, i])
        detail.imshow(image[-side:, :side], cmap="gray", vmin=0, vmax=255)
        panel.add_patch(plt.Rectangle((0, image.shape[0] - side), side, side, fill=False, edgecolor="yellow"))
        for axes in (panel, detail):
            axes.set_xticks([])
            axes.set_yticks([])
    line = columns("kernel_1d")
    panel = figure.add_subplot(grid[2, :2])
    panel.plot(line[:, 0], line[:, 1], color="#d62728", linewidth=1)
    panel.axhline(0, color="gray", linewidth=0.5)
    panel.set_xlabel("position along the path [px]", fontsize=8)
    panel.set_title("(e) 1-D filter along the path", fontsize=9)
    panel.tick_params(labelsize=7)
    plane = columns("kernel_2d")
    rx, ry = int(abs(plane[:, 0]).max()), int(abs(plane[:, 1]).max())
    picture = np.full((2 * ry + 1, 2 * rx + 1), np.nan)
    picture[plane[:, 1].astype(int) + ry, plane[:, 0].astype(int) + rx] = plane[:, 2]
    panel = figure.add_subplot(grid[2, 2:])
    colors = plt.cm.RdBu_r.copy()
    colors.set_bad("#bbbbbb")
    limit = np.nanpercentile(abs(picture), 97)
    panel.imshow(picture, cmap=colors, vmin=-limit, vmax=limit, extent=(-rx - 0.5, rx + 0.5, ry + 0.5, -ry - 0.5))
    panel.set_title("(f) the same in the image; grey: zero", fontsize=9)
    panel.tick_params(labelsize=7)
    figure.tight_layout()
    save_with_palette(figure, path)
    plt.close(figure)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", help="results of the experiments; tables and plots are written there, too")
    arguments = parser.parse_args()
    folder = arguments.folder
    parts, pictures = [], []
    for name, tables, plot in (
            ("deconvolution", (deconvolution_table, rules_table), lambda d, p: plot_deconvolution(d, folder, p)),
            ("synthetic", (synthetic_table, synthetic_ratios), plot_synthetic)):
        file = os.path.join(folder, name + ".json")
        if not os.path.exists(file):
            continue
        results = read_json(file)
        with one_line_about(file):
            parts += [make(results) for make in tables]
            pictures.append(os.path.join(folder, name + "_figure.png"))
            plot(results, pictures[-1])
    if not parts:
        fail(f"{folder} holds neither deconvolution.json nor synthetic.json")
    text = "\n\n".join(part for part in parts if part) + "\n"
    with open(os.path.join(folder, "tables.md"), "w", encoding="utf-8") as file:
        file.write(text)
    print(text)
    print("\n".join(pictures))


if __name__ == "__main__":
    main()
