"""What reconstruction.py writes: a line for each frame, tables and a plot."""

import csv

import matplotlib
import numpy

from common import number, table, write_markdown
from reconstruction_sequence import BASELINE, OURS, VARIANTS

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402

PAPER_POINTS = {BASELINE: 5888, OURS: 10620}
# Of the median blur in a frame, for the table by blur.
BLUR_CLASSES_PX = (0, 7, 15, 30, numpy.inf)


def plot(truth, results, path):
    names = list(truth)
    times = numpy.array([truth[n]["t_s"] for n in names])
    figure, axes = pyplot.subplots(5, 1, figsize=(9, 12), sharex=True)
    colors = {BASELINE: "tab:red", OURS: "tab:blue"}

    def series(variant, key):
        frames = results[variant][0]
        return numpy.array([frames[n].get(key, numpy.nan) if n in frames else numpy.nan for n in names])

    def height(name):
        return 1000 * -truth[name]["position"][1]

    axes[0].plot(times, [height(n) for n in names], color="black", linewidth=4, alpha=0.25, label="truth")
    for variant, color in colors.items():
        if variant not in results:
            continue
        axes[0].plot(times, 1000 * series(variant, "height_m"), color=color, linewidth=1, label=VARIANTS[variant][2])
        missing = [i for i, n in enumerate(names) if n not in results[variant][0]]
        if missing:
            axes[0].plot(times[missing], [height(names[i]) for i in missing], "x", color=color, label="not registered")
        for axis, key, unit in zip(axes[1:4], ("reprojection_px", "plane_rmse_m", "points"), (1, 1000, 1)):
            axis.plot(times, unit * series(variant, key), color=color, linewidth=1)
    axes[4].plot(times, [truth[n]["extent_px"] for n in names], color="black", linewidth=1)
    for axis, label in zip(axes, ("camera height [mm]", "mean reprojection\nerror [px]",
                                  "RMS distance of points\nfrom the plane [mm]", "points in the image",
                                  "median extent\nof the blur [px]")):
        axis.set_ylabel(label)
        axis.grid(alpha=0.4)
    for axis in axes[1:]:
        axis.set_ylim(bottom=0)
    axes[0].legend(loc="best", fontsize=8)
    axes[-1].set_xlabel("time [s]")
    figure.align_ylabels()
    figure.tight_layout()
    figure.savefig(path, dpi=90)


def model_table(results, frames):
    """Totals of each variant's model."""
    rows = []
    for variant, (_, totals) in results.items():
        rows.append([
            VARIANTS[variant][2], f"{totals['registered']} of {frames}",
            f"{totals['points']} ({totals['points_on_plane']})", f"{totals['observations'] / totals['points']:.1f}",
            f"{totals['reprojection_px']:.2f} px",
            f"{1000 * totals['plane_rmse_m']:.1f} ({1000 * totals['plane_median_m']:.1f}) mm",
            f"{1000 * totals['position_rmse_m']:.0f} ({1000 * totals['position_max_m']:.0f}) mm"])
    return table(["", "registered", "points (near the plane)", "images a point", "reprojection error",
                  "distance from the plane, RMS (median)", "camera position, RMS (largest)"], rows)


def table_by_blur(truth, results):
    """Features, points and errors in an image, means of the registered images of similar blur: blurred / ours."""
    rows = []
    for low, high in zip(BLUR_CLASSES_PX, BLUR_CLASSES_PX[1:]):
        names = [n for n in truth if low <= truth[n]["extent_px"] < high]
        if not names:
            continue
        cells = []
        for key, unit, digits in (("features", 1, 0), ("points", 1, 0), ("reprojection_px", 1, 2),
                                  ("plane_rmse_m", 1000, 1)):
            values = []
            for variant in (BASELINE, OURS):
                if key == "features":
                    values.append([truth[n]["features"][VARIANTS[variant][0]] for n in names])
                else:
                    frames = results[variant][0]
                    values.append([frames[n][key] for n in names if key in frames.get(n, ())])
            cells.append(" / ".join(number(numpy.mean(v) if v else None, digits, unit) for v in values))
        limits = f"{low} to {high} px" if numpy.isfinite(high) else f"above {low} px"
        rows.append([limits, len(names), cells[0], cells[1], cells[2] + " px", cells[3] + " mm"])
    return table(["median blur in the frame", "frames", "features", "points in the image", "reprojection error",
                  "distance from the plane, RMS"], rows)


def write_csv(path, truth, results):
    """A line for each frame of each variant."""
    with open(path, "w", newline="") as file:
        keys = ["height_m", "position_error_m", "rotation_error_deg", "points", "reprojection_px", "plane_rmse_m"]
        writer = csv.writer(file)
        writer.writerow(["variant", "frame", "t_s", "median_extent_px", *keys])
        for variant, (rows, _) in results.items():
            for name, row in rows.items():
                writer.writerow([variant, name, truth[name]["t_s"], truth[name]["extent_px"],
                                 *(row.get(key, "") for key in keys)])


def write_results(out, truth, results, absent):
    """CSV, table and plot of the variants' frames and totals (see measure); `absent` are the missing photographs."""
    write_csv(out / "reconstruction.csv", truth, results)
    text = [f"{len(truth)} frames, median extent of the blur "
            f"{numpy.median([f['extent_px'] for f in truth.values()]):.1f} px, largest "
            f"{max(f['extent_px'] for f in truth.values()):.1f} px", "", *model_table(results, len(truth)), ""]
    if BASELINE in results and OURS in results:
        ratio = results[OURS][1]["points"] / results[BASELINE][1]["points"]
        text += [f"points, ours / SIFT on blurred frames: {ratio:.2f} (the paper: "
                 f"{PAPER_POINTS[OURS] / PAPER_POINTS[BASELINE]:.2f})", "",
                 f"{VARIANTS[BASELINE][2]} / {VARIANTS[OURS][2]}:", "", *table_by_blur(truth, results), ""]
    if absent:
        text.append("Photographs that are absent, with rectangles in their place: " + ", ".join(absent))
    plot(truth, results, out / "reconstruction.png")
    write_markdown(out / "reconstruction.md", text)
