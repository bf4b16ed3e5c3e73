#!/usr/bin/python3
"""Tables and plots of what exposure_estimate --out wrote: estimated over true exposures, and exposures that change."""

import argparse
import csv
import pathlib

import matplotlib
import numpy as np

from common import fail, one_line_about, table, write_markdown

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the backend has to be chosen first)

EXTENT_BORDERS_PX = [0, 4, 6, 8, 12, 20, 200]
FAR, SURE = np.log(1.1), 0.03  # an error, and a standard deviation, of which the two do not go together
BLURRED_FRAMES = [5, 10, 20]  # of 8 px or more, that a filter has seen


def read(path):
    """{column: array}; numbers where all are."""
    with one_line_about(path), open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
        columns = {}
        for name in rows[0]:
            values = [row[name] for row in rows]
            try:
                columns[name] = np.array(values, dtype=float)
            except ValueError:
                columns[name] = np.array(values)
    return columns


def bin_name(low, high):
    return "%g px and more" % low if high == EXTENT_BORDERS_PX[-1] else "%g to %g px" % (low, high)


def spread(ratios):
    """Median (10th to 90th percentile)."""
    if len(ratios) == 0:
        return "-"
    return "%.3f (%.3f to %.3f)" % tuple(np.quantile(ratios, [0.5, 0.1, 0.9]))


def single_table(data):
    lines = []
    for light in dict.fromkeys(data["light"]):
        rows = []
        for assumed in sorted(set(data["assumed"])):
            row = ["x%g" % assumed]
            for low, high in zip(EXTENT_BORDERS_PX, EXTENT_BORDERS_PX[1:]):
                frames = ((data["light"] == light) & (data["assumed"] == assumed)
                          & (data["extent_px"] >= low) & (data["extent_px"] < high))
                ratios = data["ratio"][frames]
                known = ratios[~np.isnan(ratios)]
                row.append("%s; %.0f %% of %d" % (spread(known), 100 * len(known) / max(1, len(ratios)), len(ratios)))
            rows.append(row)
        header = ["assumed"] + [bin_name(*pair) for pair in zip(EXTENT_BORDERS_PX, EXTENT_BORDERS_PX[1:])]
        title = "%s: ratio of estimated to true exposure, median (p10 to p90); how many are known" % light.capitalize()
        lines += [title, "", *table(header, rows), ""]
    return lines


def wrong_and_sure(ratios, stddevs):
    """How many are off by more than a tenth and said to be right within 3 %, and how many there are."""
    known = ~np.isnan(ratios)
    wrong = known & (np.abs(np.log(ratios, where=known, out=np.zeros_like(ratios))) > FAR) & (stddevs <= SURE)
    return int(wrong.sum()), int(known.sum())


def honesty_table(single, filtered):
    rows = []
    for name, data in ("one frame", single), ("filtered", filtered):
        for light in dict.fromkeys(data["light"]):
            of_light = data["light"] == light
            ratios, stddevs = data["ratio"][of_light], data["log_stddev"][of_light]
            wrong, known = wrong_and_sure(ratios, stddevs)
            normalized = np.abs(np.log(ratios) / stddevs)[~np.isnan(ratios)]
            rows.append([name, light, known, wrong, "%.2f" % (100 * wrong / max(1, known)),
                         "%.0f" % (100 * np.mean(normalized < 1)), "%.1f" % (100 * np.mean(normalized < 3))])
    return ["How honest the standard deviations are: errors above 10 % that are said to be at most 3 %", "",
            *table(["", "light", "known", "wrong and sure", "[%]", "within one standard deviation [%]",
                    "within three [%]"], rows), ""]


def filtered_table(data):
    rows = []
    for light in dict.fromkeys(data["light"]):
        for assumed in sorted(set(data["assumed"])):
            row = [light, "x%g" % assumed]
            for count in BLURRED_FRAMES:
                ratios = data["ratio"][(data["light"] == light) & (data["assumed"] == assumed)
                                       & (data["blurred"] >= count)]
                known = ratios[~np.isnan(ratios)]
                errors = 100 * np.abs(np.log(known))
                row.append("-" if len(known) == 0 else "%.3f; %.1f / %.1f %%; %.0f %%" % (
                    np.median(known), np.quantile(errors, 0.95), errors.max(), 100 * len(known) / len(ratios)))
            rows.append(row)
    return ["Filtered: median ratio; 95th percentile and largest of its errors; how many frames know it", "",
            *table(["light", "assumed"] + ["%d frames of 8 px" % count for count in BLURRED_FRAMES], rows), ""]


def cost_table(data):
    rows = []
    for light in dict.fromkeys(data["light"]):
        of_light = data["light"] == light
        known = of_light & ~np.isnan(data["ratio"])
        for name, frames in ("all frames", of_light), ("known", known), ("not known", of_light & ~known):
            if frames.any():
                rows.append([light, name, "%.0f" % (100 * data["looked"][frames].mean()),
                             "%.2f" % data["ms"][frames].mean(), "%.2f" % data["others_ms"][frames].mean(),
                             "%.0f" % (100 * data["ms"][frames].mean() / data["others_ms"][frames].mean())])
    return ["Processor time of a frame, 752x480, one thread", "",
            *table(["light", "frames", "looked at [%]", "estimate [ms]", "flow and validation [ms]", "share [%]"],
                   rows), ""]


def recorded_table(data):
    rows = []
    for recording in dict.fromkeys(data["recording"]):
        for assumed in sorted(set(data["assumed_ms"][data["recording"] == recording])):
            values = data["ms"][(data["recording"] == recording) & (data["assumed_ms"] == assumed)]
            known = ~np.isnan(values)
            text = ", ".join("%.1f" % v for v in values[known]) or "none"
            frames = " (frames %s)" % ", ".join("%d" % (i + 1) for i in np.flatnonzero(known)) if known.any() else ""
            rows.append([recording, "%g" % assumed, len(values), text + frames])
    return ["Recorded images: what is known [ms]", "",
            *table(["recording", "assumed [ms]", "frames", "known"], rows), ""]


def draw_filtered(data, path):
    """Errors over time, a line for each flight and assumption."""
    lights = list(dict.fromkeys(data["light"]))
    figure, axes = plt.subplots(1, len(lights), figsize=(6 * len(lights), 4.2), sharey=True, squeeze=False)
    assumptions = sorted(set(data["assumed"]))
    colors = plt.get_cmap("viridis")(np.linspace(0, 0.9, len(assumptions)))
    for one, light in zip(axes[0], lights):
        for assumed, color in zip(assumptions, colors):
            of_both = (data["light"] == light) & (data["assumed"] == assumed)
            for flight in dict.fromkeys(zip(data["flight"][of_both], data["conditions"][of_both])):
                rows = of_both & (data["flight"] == flight[0]) & (data["conditions"] == flight[1])
                one.plot(data["blurred"][rows], 100 * np.log(data["ratio"][rows]), color=color, linewidth=0.6)
            one.plot([], [], color=color, label="assumed x%g" % assumed)
        one.axhspan(-3, 3, color="black", alpha=0.08)
        one.set_ylim(-20, 20)
        one.set_xlabel("frames of 8 px and more so far")
        one.set_title(light)
        one.grid(alpha=0.3)
    axes[0, 0].set_ylabel("error of the filtered exposure [%]")
    axes[0, 0].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=100)


def draw_changes(data, path):
    """Exposures over time, and blur."""
    names, flights = list(dict.fromkeys(data["change"])), list(dict.fromkeys(data["flight"]))
    figure, axes = plt.subplots(len(flights), len(names), figsize=(4.6 * len(names), 3.4 * len(flights)), sharex=True,
                                squeeze=False)
    for row, flight in zip(axes, flights):
        for one, name in zip(row, names):
            rows = (data["change"] == name) & (data["flight"] == flight)
            t_s, filtered, stddev = data["t_s"][rows], data["filtered_ms"][rows], data["filtered_stddev"][rows]
            one.plot(t_s, data["true_ms"][rows], color="black", linewidth=1, label="true")
            one.plot(t_s, filtered, color="tab:blue", linewidth=1, label="filtered, 2 standard deviations")
            one.fill_between(t_s, filtered * np.exp(-2 * stddev), filtered * np.exp(2 * stddev), color="tab:blue",
                             alpha=0.2)
            one.plot(t_s, data["one_ms"][rows], ".", color="tab:red", markersize=4, label="one frame")
            one.plot(t_s, data["extent_px"][rows], color="tab:gray", linewidth=0.7, linestyle=":", label="blur [px]")
            one.set_yscale("log")
            one.set_yticks([2, 5, 10, 20, 40])
            one.set_yticklabels(["2", "5", "10", "20", "40"])
            one.minorticks_off()
            one.set_ylim(2, 50)
            one.set_title("%s, %s" % (name, flight), fontsize=10)
            one.grid(alpha=0.3)
    for one in axes[-1]:
        one.set_xlabel("time [s]")
    for row in axes:
        row[0].set_ylabel("exposure [ms]")
    axes[0, 0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=100)


def changes_table(data):
    rows = []
    for name in dict.fromkeys(data["change"]):
        for flight in dict.fromkeys(data["flight"]):
            of_both = (data["change"] == name) & (data["flight"] == flight)
            if not of_both.any():
                continue
            ratios = data["filtered_ms"][of_both] / data["true_ms"][of_both]
            stddevs, known = data["filtered_stddev"][of_both], ~np.isnan(ratios)
            errors = 100 * np.abs(np.log(ratios[known]))
            wrong, _ = wrong_and_sure(ratios, stddevs)
            row = [name, flight, "%.0f" % (100 * np.mean(known))]
            if known.any():
                row += ["%.1f / %.1f" % (np.median(errors), np.quantile(errors, 0.9)),
                        "%.0f" % (100 * np.mean(errors > 10)), "%d of %d" % (wrong, known.sum())]
            rows.append(row if known.any() else row + ["-"] * 3)
    return ["Exposures that change, filtered", "",
            *table(["change", "flight", "known [%]", "error, median / p90 [%]", "off by more than 10 % [%]",
                    "wrong and sure"], rows), ""]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=pathlib.Path, help="that exposure_estimate --out wrote")
    folder = parser.parse_args().folder
    lines = []
    found = {name: folder / ("exposure_%s.csv" % name) for name in ("frames", "filtered", "changes", "recorded")}
    if not any(path.is_file() for path in found.values()):
        fail("there is none of %s" % ", ".join(map(str, found.values())))
    if found["frames"].is_file():
        single, filtered = read(found["frames"]), read(found["filtered"])
        lines += single_table(single) + honesty_table(single, filtered)
        lines += filtered_table(filtered) + cost_table(filtered)
        draw_filtered(filtered, folder / "exposure_filtered.png")
    if found["changes"].is_file():
        changes = read(found["changes"])
        lines += changes_table(changes)
        draw_changes(changes, folder / "exposure_changes.png")
    if found["recorded"].is_file():
        lines += recorded_table(read(found["recorded"]))
    write_markdown(folder / "exposure_estimate.md", lines)


if __name__ == "__main__":
    main()
