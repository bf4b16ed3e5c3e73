#!/usr/bin/env python3
"""Compares a bag of blurred images with the bag that gyro_deblur made of it: pictures, plots and numbers.

Reads the images from INPUT, the outputs (deblurred/image_raw, keypoints, blur_field, blur_overlay, /diagnostics) from
OUTPUT, and the simulator's truth (/truth/sharp, /truth/global_shutter) from INPUT where it is there. Writes report.md,
report.json and PNG pictures into a folder.
"""
import argparse
import json
import os
import sys

import missing_packages  # noqa: F401  (first: names the package of a module that is missing)
import numpy as np
from tqdm import tqdm

from bag_input import open_bag
from report_bags import (STATUS_NAMES, BagPair, Field, decode, find_topic, is_whole, messages_of, read_diagnostics,
                         stamp_ns, topic_types)
from report_measures import CORRECT_PX, MATCH_RATIO, MOVED_PX, SIFT_MATCHED, MeasuredFrame, rectification_summary
from report_pictures import Pictures, plot
from report_tables import number, one_line_about, read_json, table

YES = {True: "yes", False: "**no**", None: "-"}


def mean_of(rows, key):
    values = [r[key] for r in rows if r.get(key) is not None]
    return float(np.mean(values)) if values else None


def counts(names):
    """How often each name occurs, in alphabetical order."""
    return {name: names.count(name) for name in sorted(set(names))}


def summary(pair, rows, stamps_in):
    """What holds for all frames; stamps [ns] of the images in the input."""
    stamps_out, info_stamps = pair.stamps_out_ns(), pair.info_stamps_ns()
    positions = {ns: i for i, ns in enumerate(stamps_in)}
    order = [positions.get(ns, -1) for ns in stamps_out]
    changed = [r for r in rows if not r["identical"]]
    return {
        "frames_in": len(stamps_in),
        "frames_out": len(stamps_out),
        "frames_changed": len(changed),
        "frames_missing": sorted(set(range(len(stamps_in))) - set(order)),
        "stamps_kept": all(i >= 0 for i in order),
        "order_kept": all(a < b for a, b in zip(order, order[1:])),
        "camera_info_with_every_image": None if info_stamps is None else info_stamps == stamps_out,
        "reasons": counts([r["reason"] for r in rows]),
        "blocks": {n: sum(r["blocks"][n] for r in rows) for n in STATUS_NAMES},
        "changed_frames_mean": {key: mean_of(changed, key) for key in (
            "median_extent_px", "psnr_before_db", "psnr_after_db", "psnr_blocks_before_db", "psnr_blocks_after_db",
            "keypoints_before", "keypoints_after", "truth_matches_before", "truth_matches_after",
            "consecutive_matches_before", "consecutive_matches_after")},
        "diagnostics": pair.diagnostics(),
        "frames": rows,
    }


def analyse(arguments):
    """The content of report.json; leaves the pictures in the folder."""
    pair = BagPair(arguments.input, arguments.output, arguments.image_topic)
    os.makedirs(arguments.folder, exist_ok=True)
    pictures = Pictures(arguments.folder, arguments.pictures)
    rows, errors_px, stamps_in, previous = [], [], [], None
    for frame in tqdm(pair.frames(), total=pair.count(), desc="report", unit="frame", disable=not sys.stderr.isatty()):
        stamps_in.append(stamp_ns(frame.image))
        if frame.output is None or frame.field is None or not is_whole(frame.image):
            previous = None
            continue
        previous = measured = MeasuredFrame(frame, previous)
        rows.append(measured.row)
        if measured.rectification_px:
            errors_px.append(measured.rectification_px)
        pictures.offer(measured, decode(frame.overlay) if frame.overlay is not None else None)
    report = {"input": os.path.basename(arguments.input), "output": os.path.basename(arguments.output),
              **summary(pair, rows, stamps_in)}
    rectification = rectification_summary(errors_px)
    if rectification:
        report["rectification"] = rectification
    report["pictures"] = pictures.write()
    plot(rows, os.path.join(arguments.folder, "plots.png"))
    return report


def throughput(bag_path, json_path):
    """What play_bag.py measured, and what became of the frames."""
    played = read_json(json_path)
    with one_line_about(json_path):
        result = {key: played[key] for key in ("frames_in", "frames_out", "rate_hz", "wanted_rate_hz")}
    with open_bag(bag_path) as bag:
        types = topic_types(bag)
        topic = find_topic(types, "blur_field", "gyro_deblur/BlurField", bag_path)
        messages = list(messages_of(bag, topic))
        diagnostics = find_topic(types, "diagnostics", "diagnostic_msgs/DiagnosticArray", bag_path, False)
        result["diagnostics"] = read_diagnostics(bag, diagnostics)
    fields = [Field(m) for m in messages]
    stamps = [stamp_ns(m) for m in messages]
    result["size"] = [messages[0].image_width, messages[0].image_height] if messages else None
    result["order_kept"] = all(a < b for a, b in zip(stamps, stamps[1:]))
    result["reasons"] = counts([f.reason_name for f in fields])
    medians = [f.median_extent() for f in fields if f.status.size]
    result["median_extent_px"] = float(np.median(medians)) if medians else None
    return result


def listed(numbers):
    return ", ".join("%s %d" % item for item in numbers.items())


def throughput_lines(result):
    stages = ["%s %s ms" % (key[:-len(" mean [ms]")], value) for key, value in result["diagnostics"].items()
              if key.endswith(" mean [ms]")]
    return ["", "## Throughput", "",
            "- %s at %.1f Hz, median extent %s px, image only: %d frames in, %d out, sustained %.1f Hz on %d cores" % (
                "x".join(map(str, result["size"] or ["?"])), result["wanted_rate_hz"],
                number(result["median_extent_px"]), result["frames_in"], result["frames_out"], result["rate_hz"],
                os.cpu_count()),
            "- order kept: %s; reasons: %s" % (YES[result["order_kept"]], listed(result["reasons"])),
            "- mean latency by stage: " + ", ".join(stages)]


def frames_lines(report):
    lines = ["", "## Frames", "",
             "- in %d, out %d, of these changed by deblurring %d" % (
                 report["frames_in"], report["frames_out"], report["frames_changed"]),
             "- every output has its input's stamp: %s; order kept: %s; camera_info with every image: %s" % (
                 YES[report["stamps_kept"]], YES[report["order_kept"]], YES[report["camera_info_with_every_image"]]),
             "- reasons: " + listed(report["reasons"]),
             "- blocks: " + listed(report["blocks"])]
    if report["frames_missing"]:
        lines.append("- missing from the output: " + ", ".join(map(str, report["frames_missing"])))
    return lines


def before_after_lines(report):
    mean = report["changed_frames_mean"]
    rows = []
    for title, key, unit, digits in (
            ("PSNR against the sharp truth, whole image", "psnr_%s_db", " dB", 2),
            ("PSNR, deblurred blocks", "psnr_blocks_%s_db", " dB", 2),
            ("SIFT keypoints (OpenCV's default threshold)", "keypoints_%s", "", 0),
            ("correct SIFT matches with the sharp truth (%d strongest, ratio %.1f, within %.0f px)" % (
                SIFT_MATCHED, MATCH_RATIO, CORRECT_PX), "truth_matches_%s", "", 0),
            ("SIFT matches with the frame before (%d strongest, ratio %.1f, inliers of a homography)" % (
                SIFT_MATCHED, MATCH_RATIO), "consecutive_matches_%s", "", 0)):
        values = [mean[key % side] for side in ("before", "after")]
        if any(value is not None for value in values):
            rows.append([title, *(number(value, digits) + unit for value in values)])
    return ["", "## Before and after", "",
            "Means over the %d changed frames; median extent %s px." % (
                report["frames_changed"], number(mean["median_extent_px"])),
            "", *table(["", "before", "after"], rows)]


def rectification_lines(rectification):
    rows = [["all %d" % rectification["keypoints"], "%.2f px" % rectification["raw_median_px"],
             "%.2f px" % rectification["rectified_median_px"]]]
    if rectification["moved_keypoints"]:
        rows.append(["the %d that moved by more than %.0f px" % (rectification["moved_keypoints"], MOVED_PX),
                     "%.2f px" % rectification["moved_raw_median_px"],
                     "%.2f px" % rectification["moved_rectified_median_px"]])
    return ["", "## Rolling-shutter rectification of keypoints", "",
            "Median distance from the global-shutter truth, with the truth from optical flow between the truth images.",
            "", *table(["keypoints", "raw", "rectified"], rows)]


def diagnostics_lines(diagnostics):
    return ["", "## Diagnostics of the nodelet", "",
            "Rates and mean latencies are means over the reporting periods.", "",
            *table(["", ""], diagnostics.items())]


def pictures_lines(pictures):
    lines = ["", "## Pictures", ""]
    for names in pictures:
        for kind in ("comparison", "crops", "overlay"):
            if kind in names:
                lines += ["![frame %d, %s](%s)" % (names["frame"], kind, names[kind]), ""]
    return lines


def every_frame_lines(frames):
    rows = []
    for row in frames:
        blocks = row["blocks"]
        rows.append([
            row["frame"], row["reason_text"] or row["reason"], number(row.get("center_extent_px")) + " px",
            number(row.get("center_angle_deg")) + " deg", "%d, %d, %d, %d of %d" % (
                blocks["DEBLURRED"], blocks["REJECTED"], blocks["TOO_CURVED"], blocks["NO_GYRO"], sum(blocks.values())),
            "%d, %d" % (row["keypoints_before"], row["keypoints_after"]),
            "%s, %s" % (row.get("consecutive_matches_before", "-"), row.get("consecutive_matches_after", "-"))])
    header = ["frame", "reason", "extent at the centre", "angle", "blocks deblurred, rejected, too curved, not covered",
              "keypoints before, after", "matches with the frame before: before, after"]
    return ["![over time](plots.png)", "", "## Every frame", "", *table(header, rows)]


def write_markdown(report, title, path):
    lines = ["# " + title, *frames_lines(report), *before_after_lines(report)]
    if report.get("rectification"):
        lines += rectification_lines(report["rectification"])
    if report["diagnostics"]:
        lines += diagnostics_lines(report["diagnostics"])
    if report.get("throughput"):
        lines += throughput_lines(report["throughput"])
    if report["pictures"]:
        lines += pictures_lines(report["pictures"])
    lines += every_frame_lines(report["frames"])
    with open(path, "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("input", help="bag with the blurred images, and the truth if there is one")
    parser.add_argument("output", help="bag that deblur_bag wrote, or that was recorded from the nodelet")
    parser.add_argument("folder", help="where the report goes")
    parser.add_argument("--image-topic", help="sensor_msgs/Image of the input [the one that ends with image_raw]")
    parser.add_argument("--title", default="gyro_deblur: report")
    parser.add_argument("--pictures", type=int, default=2, help="how many frames, most blurred first [%(default)s]")
    parser.add_argument("--throughput", nargs=2, metavar=("BAG", "JSON"),
                        help="a bag recorded in another run and what play_bag.py --json wrote of it")
    arguments = parser.parse_args()
    if arguments.pictures < 0:
        parser.error("--pictures %d is negative" % arguments.pictures)
    report = analyse(arguments)
    if arguments.throughput:
        report["throughput"] = throughput(*arguments.throughput)
    with open(os.path.join(arguments.folder, "report.json"), "w", encoding="utf-8") as file:
        json.dump(report, file, indent=2)
    write_markdown(report, arguments.title, os.path.join(arguments.folder, "report.md"))
    print("%s: %d frames in, %d out, %d changed" % (
        os.path.join(arguments.folder, "report.md"), report["frames_in"], report["frames_out"],
        report["frames_changed"]))


if __name__ == "__main__":
    main()
