#!/usr/bin/python3
"""Tables and a plot from the JSON of benchmark_contention."""

import argparse

import missing_packages  # noqa: F401  (first: names the package of a module that is missing)
import matplotlib

from report_tables import add_table_arguments, number, one_line_about, read_json, titled_table, write_tables

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the backend has to be chosen first)

OTHERS = {
    "alone": "nothing",
    "busy": "a busy process on every core",
    "consumer": "a consumer like SLAM",
    "two at once": "a second stream (one)",
    "two at once, the other": "a second stream (the other)",
}


def title(stream):
    return "%s at %g Hz" % (stream["stream"], stream["rate_hz"])


def latency_table(stream):
    rows = []
    for key, others in OTHERS.items():
        run = stream[key]
        rows.append([others, run["frames"], run["deblurred"],
                     *(number(run[f"{name}_ms"], 2) for name in ("p50", "p95", "p99")), number(run["late_p95_ms"], 2),
                     number(run["processor_s"] / run["wall_s"], 1, 100)])
    return titled_table(title(stream) + ":", ["other processes", "frames", "deblurred", "p50 [ms]", "p95 [ms]",
                                              "p99 [ms]", "image late, p95 [ms]", "processor [% of a core]"], rows)


def verdict_table(stream):
    rows = [[verdict["what"], number(verdict["value"], 3), number(verdict["limit"], 3),
             "yes" if verdict["good"] else "**no**"] for verdict in stream["verdicts"]]
    return titled_table(title(stream) + ", against the limits:", ["", "is", "at most", "within"], rows)


def tables(report):
    quiet = "" if all(stream["quiet"] for stream in report["streams"]) else " **Others used the machine: no verdict.**"
    lowest = min(min(stream["quiet_before"] + stream["quiet_after"]) for stream in report["streams"])
    parts = [("%d cores, %g s of each, in %d rounds; before and after, a busy process had at least %s %% of every "
              "core." %
              (report["cores"], report["seconds"], report["rounds"], number(lowest, 0, 100))) + quiet]
    for stream in report["streams"]:
        parts += [latency_table(stream), verdict_table(stream)]
    return "\n\n".join(parts) + "\n"


def draw(report, path):
    streams = report["streams"]
    figure, axes = plt.subplots(len(streams), 2, figsize=(10, 3.4 * len(streams)), squeeze=False,
                                constrained_layout=True)
    for (latency, processor), stream in zip(axes, streams):
        places = range(len(OTHERS))
        for name, color in (("p99", "tab:red"), ("p95", "tab:orange"), ("p50", "tab:green")):
            latency.barh(places, [stream[key][f"{name}_ms"] for key in OTHERS], color=color, label=name)
        processor.barh(places, [100 * stream[key]["processor_s"] / stream[key]["wall_s"] for key in OTHERS],
                       color="tab:blue")
        latency.axvline(2 * stream["alone"]["p95_ms"], color="black", linestyle="--", label="twice p95 alone")
        processor.axvline(130 * stream["alone"]["processor_s"] / stream["alone"]["wall_s"], color="black",
                          linestyle="--", label="1.3 times alone")
        for axis, label in ((latency, "latency of a frame [ms]"), (processor, "processor time [% of a core]")):
            axis.set_xlabel(label)
            axis.invert_yaxis()
            axis.grid(axis="x", alpha=0.3)
            axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncol=4, frameon=False)
        latency.set_yticks(places, OTHERS.values())
        processor.set_yticks(places, [""] * len(OTHERS))
        latency.set_title(title(stream))
    figure.savefig(path, dpi=110)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("json", help="numbers of benchmark_contention")
    parser.add_argument("png", help="picture to write")
    add_table_arguments(parser)
    arguments = parser.parse_args()
    report = read_json(arguments.json)
    with one_line_about(arguments.json):
        text = tables(report)
        draw(report, arguments.png)
    print(text)
    write_tables(arguments, "contention tables", text, "\n![latency and processor time](../images/contention.png)\n")


if __name__ == "__main__":
    main()
