#!/usr/bin/python3
"""Tables and a plot from the JSON of compare_engines and measure_fidelity."""

import argparse

import missing_packages  # noqa: F401  (first: names the package of a module that is missing)
import matplotlib

from report_tables import add_table_arguments, one_line_about, read_json, titled_table, write_tables

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

# Mustaniemi et al., ICPR 2018: 1920x1080, mean extent 90 px, GTX 1080.
PAPER_EXTENT_PX, PAPER_MS = 90, 17

STYLES = {
    "cpu-avx512": ("#d62728", "-", "o"),
    "cpu-avx2": ("#ff7f0e", "-", "o"),
    "cpu-baseline": ("#e7ba52", "-", "o"),
    "opencl": ("#2ca02c", "-", "D"),
    "float": ("#7f7f7f", ":", "^"),
    "float-avx512": ("#1f77b4", "--", "s"),
    "float-avx2": ("#17becf", "--", "s"),
    "filter2d": ("#9467bd", "--", "v"),
    "filter2d-float": ("#8c564b", "--", "v"),
}


def baseline_of(engine):
    return {"cpu-avx512": "float-avx512", "cpu-avx2": "float-avx2"}.get(engine, "float")


def deconvolution_tables(records):
    parts = []
    keys = sorted({(r["width"], r["height"], r["threads"]) for r in records})
    for width, height, threads in keys:
        chosen = [r for r in records if (r["width"], r["height"], r["threads"]) == (width, height, threads)]
        extents = sorted({r["extent_px"] for r in chosen})
        engines = list(dict.fromkeys(r["engine"] for r in chosen))
        cell = {(r["engine"], r["extent_px"]): r for r in chosen}
        title = f"{width}x{height}, {threads} thread{'s' if threads > 1 else ''}"
        rows = [[e] + [f"{cell[e, x]['median_ms']:.2f}" for x in extents] for e in engines]
        parts.append(titled_table(f"Time [ms] at mean extent, {title}:",
                                  ["engine"] + [f"{x:g} px" for x in extents], rows))
        rows = []
        for engine in engines:
            if engine.startswith(("float", "filter2d")):
                continue
            for other in dict.fromkeys([baseline_of(engine), "filter2d", "filter2d-float"]):
                if all(other in cell[engine, x]["speedup_over"] for x in extents):
                    rows.append([f"{engine} over {other}"]
                                + [f"{cell[engine, x]['speedup_over'][other]:.1f}" for x in extents])
        if rows:
            parts.append(titled_table(f"Speed-up, median of ratios within a round, {title}:",
                                      ["", *[f"{x:g} px" for x in extents]], rows))
    return parts


def roofline_table(records, peaks):
    """Rates at the largest size and number of threads, and their share of the peak."""
    if not peaks:
        return []
    size = max((r["width"], r["height"]) for r in records)
    threads = max(r["threads"] for r in records)
    l1 = [p["gb_per_s"] for p in peaks if p["threads"] == threads and p.get("level") == "L1"]
    arithmetic = {p["instruction_set"]: p for p in peaks if p["threads"] == threads and "instruction_set" in p}
    rows = []
    for r in records:
        if (r["width"], r["height"]) != size or r["threads"] != threads or "work" not in r:
            continue
        isa = "avx2" if r["engine"].endswith("avx2") else "avx512" if r["engine"].endswith("avx512") else None
        if isa not in arithmetic or r["extent_px"] not in (15, 30, 90, 130) or not l1:
            continue
        work, seconds, peak = r["work"], r["median_ms"] * 1e-3, arithmetic[isa]
        busy = (work["float_gmac"] / peak["float_gmac_per_s"] + work["int16_gmac"] / peak["int16_gmac_per_s"]) / seconds
        rows.append([r["engine"], f"{r['extent_px']:g}", f"{work['float_gmac']:.3f}", f"{work['int16_gmac']:.3f}",
                     f"{work['load_gb']:.2f}", f"{100 * busy:.0f} %",
                     f"{100 * work['load_gb'] / seconds / l1[0]:.0f} %"])
    header = ["engine", "extent [px]", "float [GMAC]", "int16 [GMAC]", "loads [GB]", "of arithmetic peak", "of L1 peak"]
    lines = [f"{p['instruction_set']}: {p['float_gmac_per_s']:.0f} float, {p['int16_gmac_per_s']:.0f} int16 GMAC/s"
             for p in arithmetic.values()]
    levels = [f"{p['level']} {p['gb_per_s']:.0f}" for p in peaks if p["threads"] == threads and "level" in p]
    return [f"Peaks on {threads} thread{'s' if threads > 1 else ''}: {'; '.join(lines)}; read {', '.join(levels)} GB/s.",
            titled_table(f"Work at {size[0]}x{size[1]}:", header, rows)] if rows else []


def pipeline_table(records):
    header = ["frame", "engine", "threads", "flow", "blur field", "noise", "validation", "deconvolution", "exposure",
              "sum", "cv::ORB", "ORB / sum", "tracks"]
    rows = []
    for r in records:
        ms = r["median_ms"]
        rows.append([f"{r['width']}x{r['height']}, {r['extent_px']:g} px", r["engine"], str(r["threads"]),
                     f"{ms['flow']:.2f}", f"{ms['blur_field']:.3f}", f"{ms['noise']:.2f}", f"{ms['validation']:.2f}",
                     f"{ms['deconvolution']:.2f}", f"{ms['exposure']:.2f}",
                     f"{ms['deblurring']:.2f}", f"{ms['orb']:.2f}", f"{r['orb_over_deblurring']:.1f}",
                     f"{ms['tracks']:.2f}"])
    return [titled_table("Stages of what deblurs by default [ms]; sum: with a sixth of exposure, which is estimated for "
                         "every sixth image; cv::ORB with 1000 features on the same images; tracks: what "
                         "feature_tracks add:", header, rows)]


def fidelity_tables(fidelity):
    parts = []
    header = ["engine", "extent [px]", "parity [dB]", "at the worst angle", "mean loss [dB]", "worst loss [dB]"]
    if "uniform" in fidelity:
        rows = [[r["engine"], f"{r['extent_px']:g}", f"{r['parity_db']:.1f}",
                 f"{r['worst_parity_db']:.1f} ({r['worst_parity_at_deg']:.0f} deg)", f"{r['mean_loss_db']:+.3f}",
                 f"{r['worst_loss_db']:+.3f} ({r['worst_loss_at_deg']:.0f} deg)"] for r in fidelity["uniform"]]
        parts.append(titled_table("Uniform fields over all angles, against the float engine:", header, rows))
    if "roll" in fidelity:
        header = ["engine", "mean extent [px]", "parity [dB]", "worst image", "mean loss [dB]", "worst loss [dB]"]
        rows = [[r["engine"], f"{r['mean_extent_px']:g}", f"{r['parity_db']:.1f}", f"{r['worst_parity_db']:.1f}",
                 f"{r['mean_loss_db']:+.3f}", f"{r['worst_loss_db']:+.3f}"] for r in fidelity["roll"]]
        parts.append(titled_table("Roll fields, against the float engine:", header, rows))
    if "seams" in fidelity:
        rows = [[r["engine"], f"{r['mean_extent_px']:g}", f"{r['mean']:.3f}", f"{r['largest']:.3f}"]
                for r in fidelity["seams"]]
        parts.append(titled_table("Gradient across block borders over that inside, relative to the sharp image:",
                                  ["engine", "mean extent [px]", "mean", "largest"], rows))
    return parts


def plot(records, machine, path):
    size = max((r["width"], r["height"]) for r in records)
    threads = max(r["threads"] for r in records)
    chosen = [r for r in records if (r["width"], r["height"]) == size and r["threads"] == threads]
    figure, axes = plt.subplots(figsize=(8, 5), dpi=120)
    for engine in dict.fromkeys(r["engine"] for r in chosen):
        points = sorted((r["extent_px"], r["median_ms"]) for r in chosen if r["engine"] == engine)
        color, line, marker = STYLES.get(engine, ("black", "-", "x"))
        axes.plot(*zip(*points), color=color, linestyle=line, marker=marker, markersize=4, label=engine)
    if size == (1920, 1080):
        axes.plot([PAPER_EXTENT_PX], [PAPER_MS], "k*", markersize=14, label="Mustaniemi et al. 2018, GTX 1080")
    axes.set_yscale("log")
    ticks = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000]
    low, high = axes.get_ylim()
    axes.set_yticks([t for t in ticks if low <= t <= high])
    axes.get_yaxis().set_major_formatter(matplotlib.ticker.FormatStrFormatter("%g"))
    axes.get_yaxis().set_minor_formatter(matplotlib.ticker.NullFormatter())
    axes.set_xlim(left=0)
    axes.set_xticks(sorted({r["extent_px"] for r in chosen}))
    axes.set_xlabel("mean extent of the blur [px]")
    axes.set_ylabel(f"deconvolution [ms of {machine['clock']} time]")
    axes.set_title(f"{size[0]}x{size[1]}, every block its own angle and extent\n"
                   f"{machine['processor']}, {threads} thread{'s' if threads > 1 else ''}", fontsize=10)
    axes.grid(True, which="major", alpha=0.3)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1))
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)


def comparison_tables(compare):
    """What compare_engines measured, and on which machine."""
    machine = compare["machine"]
    parts = [f"{machine['processor']}, {machine['processors']} processors, GCC {machine['compiler']}; "
             f"{machine['rounds']} rounds, {machine['clock']} time; "
             f"others used {100 * machine['load_before']:.0f} % of the processors before and {100 * machine['load_after']:.0f} % after."]
    parts += deconvolution_tables(compare["deconvolution"])
    if "pipeline" in compare:
        parts += pipeline_table(compare["pipeline"])
    parts += roofline_table(compare["deconvolution"], compare.get("peaks"))
    if "memory_mib" in compare:
        parts.append(titled_table("Peak memory above images and kernels, 1920x1080, 90 px, 2 threads [MiB]:",
                                  ["engine", "MiB"], [[k, f"{v:.0f}"] for k, v in compare["memory_mib"].items()]))
    return parts


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("compare", help="JSON of compare_engines")
    parser.add_argument("--fidelity", help="JSON of measure_fidelity")
    parser.add_argument("--plot", help="where to draw time against extent")
    add_table_arguments(parser)
    arguments = parser.parse_args()
    compare = read_json(arguments.compare)
    with one_line_about(arguments.compare):
        parts = comparison_tables(compare)
    if arguments.fidelity:
        fidelity = read_json(arguments.fidelity)
        with one_line_about(arguments.fidelity):
            parts += fidelity_tables(fidelity)
    text = "\n\n".join(parts) + "\n"
    print(text)
    write_tables(arguments, "benchmark tables", text)
    if arguments.plot:
        with one_line_about(arguments.compare):
            plot(compare["deconvolution"], compare["machine"], arguments.plot)


if __name__ == "__main__":
    main()
