#!/usr/bin/env python3
"""doc/design/figures.py draws every figure that a design page shows, small enough for a page, and refuses unknown names."""

import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
DESIGN = ROOT / "doc" / "design"
SKIPPED = 77  # ctest's SKIP_RETURN_CODE
MAX_BYTES = 80_000


def draw(*arguments):
    return subprocess.run(["/usr/bin/python3", "-B", DESIGN / "figures.py", "--data", DATA, *arguments],
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE, universal_newlines=True)


class Figures(unittest.TestCase):
    def test_each_page_has_its_figure(self):
        shown = set()
        for page in DESIGN.glob("*.md"):
            shown |= set(re.findall(r"\]\(images/([\w.]+)\)", page.read_text(encoding="utf-8")))
        with tempfile.TemporaryDirectory() as folder:
            run = draw("--out", folder)
            self.assertEqual(run.returncode, 0, msg=run.stderr)
            drawn = {path.name: path.stat().st_size for path in pathlib.Path(folder).iterdir()}
        self.assertEqual(set(drawn), shown)
        for name, size in drawn.items():
            self.assertGreater(size, 1000, msg=name)
            self.assertLess(size, MAX_BYTES, msg=name)

    def test_an_unknown_figure_is_refused(self):
        run = draw("no_such_figure")
        self.assertEqual(run.returncode, 2)
        self.assertIn("there is no figure no_such_figure", run.stderr)


if __name__ == "__main__":
    DATA = pathlib.Path(sys.argv.pop())
    for needed in "handshake_gyro", "oxford_affine":
        if not (DATA / needed).is_dir():
            print(f"SKIPPED:\nthere is no {DATA / needed}")
            sys.exit(SKIPPED)
    unittest.main()
