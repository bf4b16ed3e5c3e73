#!/usr/bin/env python3
"""experiments/run_all.sh --quick from end to end: everything is written, and the paper's claims hold."""

import argparse
import csv
import json
import pathlib
import shutil
import statistics
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
arguments = None


class RunAll(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.out = pathlib.Path(cls.temporary.name)
        subprocess.run([ROOT / "experiments" / "run_all.sh", "--quick", "--programs", arguments.programs, "--data",
                        arguments.data, "--out", cls.out], check=True)

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    def load(self, name):
        with open(self.out / name) as file:
            return json.load(file)

    def test_everything_is_written(self):
        for name in ("deconvolution.csv", "deconvolution_figure.png", "synthetic.csv", "synthetic_matching.csv",
                     "synthetic_figure.png", "tables.md"):
            self.assertGreater((self.out / name).stat().st_size, 100, name)

    def test_space_beats_the_frequency_domain_at_borders_and_matches_it_inside(self):
        methods = {m["method"]: m for m in self.load("deconvolution.json")["methods"]}
        space, frequency = methods["spatial"], methods["frequency"]
        self.assertLess(space["rmse_border"], 0.8 * frequency["rmse_border"])
        self.assertLess(space["rmse_interior"], 1.1 * frequency["rmse_interior"])

    def test_least_squares_taps_restore_more_than_the_papers_and_adaptive_ones_no_less(self):
        cells = {(r["noise_grey_levels"], r["extent_px"], r["rule"]): r
                 for r in self.load("deconvolution.json")["rules"]}
        for noise, extent in {key[:2] for key in cells}:
            gain = {rule: cells[noise, extent, rule]["gain_db"] for rule in ("paper", "fixed", "adaptive")}
            if noise <= 4:  # with more both lose
                self.assertGreaterEqual(gain["fixed"], gain["paper"])
            self.assertGreaterEqual(gain["adaptive"], gain["fixed"] - 0.01)
            self.assertGreaterEqual(cells[noise, extent, "adaptive"]["least_db"], -0.05)

    def test_the_proposed_method_repeats_more_and_closer(self):
        methods = {m["method"]: {p["detections"]: p for p in m["curve"]} for m in self.load("synthetic.json")["methods"]}
        for other in ("DoG", "Pretto et al."):
            self.assertGreater(methods["proposed"][500]["repeatability"], 2 * methods[other][500]["repeatability"])
            self.assertLess(methods["proposed"][500]["error_px"], methods[other][500]["error_px"])
        for wrong in (name for name in methods if "eps" in name):
            self.assertLess(methods[wrong][500]["repeatability"], methods["proposed"][500]["repeatability"], wrong)
        self.assertGreater(methods["sharp"][500]["repeatability"], methods["proposed"][500]["repeatability"])

    def test_real_world_table(self):
        with open(self.out / "real_world" / "real_world.csv") as file:
            rows = {row["method"]: row for row in csv.DictReader(file) if row["ground_truth"] == "truth"}
        self.assertEqual(set(rows), {"dog", "pretto", "proposed", "dog_smoothed", "proposed_smoothed"})
        for kind in ("", "_smoothed"):
            self.assertGreater(float(rows["proposed" + kind]["repeatability"]),
                               1.5 * float(rows["dog" + kind]["repeatability"]), kind)
        self.assertLess(float(rows["proposed"]["error_px"]), float(rows["dog"]["error_px"]))
        # The protocol takes motion for even over two frames, which shake is not.
        self.assertLess(float(rows["proposed"]["protocol_error_px"]), 25)

    def test_reconstruction(self):
        if shutil.which("colmap") is None:
            self.skipTest("there is no COLMAP")
        with open(self.out / "reconstruction" / "reconstruction.csv") as file:
            rows = [row for row in csv.DictReader(file) if row["variant"] == "deblurred_rectified"]
        self.assertEqual(len(rows), 12)  # every frame
        self.assertLess(statistics.median_high(float(row["reprojection_px"]) for row in rows), 1.5)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("programs")
    parser.add_argument("data")
    arguments = parser.parse_args()
    unittest.main(argv=sys.argv[:1], verbosity=2)
