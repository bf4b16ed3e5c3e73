"""What the experiments share: where things are, programs on one thread, report_tables.py and missing_packages.py."""

import os
import pathlib
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
# The scripts are no package, and the experiments are not installed.
sys.path.insert(0, str(ROOT / "scripts"))
import missing_packages  # noqa: E402,F401
from report_tables import fail, number, one_line_about, read_json, table, titled_table  # noqa: E402

__all__ = ["ONE_THREAD", "OPENCV_DOC", "ROOT", "fail", "number", "one_line_about", "read_json", "table", "titled_table",
           "write_markdown"]

OPENCV_DOC = pathlib.Path("/usr/share/doc/opencv-doc/examples/data")

# Several processes at a time instead of several threads in each: for the libraries behind COLMAP and the programs.
ONE_THREAD = dict(os.environ, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")


def write_markdown(path, lines):
    """Into the file and onto the screen."""
    path.write_text("\n".join(lines).rstrip() + "\n")
    print("\n".join(lines))
