#!/usr/bin/env python3
"""Joins the results of a bag's slices, in their order, into one bag and one report."""

import argparse
import collections
import json
import os

import rosbag


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", help="bag to write")
    parser.add_argument("json", help="report to write")
    parser.add_argument("--bags", nargs="+", required=True, help="of the slices, in order")
    parser.add_argument("--reports", nargs="+", required=True, help="deblur_bag's --json of each")
    arguments = parser.parse_args()

    part = arguments.output + ".part"
    with rosbag.Bag(part, "w") as output:
        for path in arguments.bags:
            with rosbag.Bag(path) as piece:
                for topic, message, time in piece.read_messages(raw=True):
                    output.write(topic, message, time, raw=True)

    joined = {"slices": len(arguments.reports), "frames_in": 0, "frames_out": 0, "dropped_poor": 0, "undecodable_images": 0,
              "frames": []}
    passed_through = collections.Counter()
    for path in arguments.reports:
        with open(path, encoding="utf-8") as file:
            report = json.load(file)
        for key in "frames_in", "frames_out", "dropped_poor", "undecodable_images":
            joined[key] += report[key]
        joined["frames"] += report["frames"]
        passed_through.update(report["passed_through"])
    joined["passed_through"] = dict(passed_through)
    with open(arguments.json, "w", encoding="utf-8") as file:
        json.dump(joined, file, indent=2)
    os.replace(part, arguments.output)


if __name__ == "__main__":
    main()
