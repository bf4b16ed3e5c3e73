#!/usr/bin/env python3
"""A script that misses a module of another package names the package in one line."""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
SCRIPTS = ROOT / "scripts"
sys.path.insert(0, str(SCRIPTS))
import missing_packages  # noqa: E402

REPORTS = ("bag_transport.py", "benchmark_report.py", "contention_report.py", "play_bag.py", "plot_calibration.py",
           "report.py", "setup", "soak_plot.py", "stereo_latency.py")
EXPERIMENTS = ("image_quality.py", "optical_flow.py", "point_covariance.py", "real_world.py", "reconstruction.py",
               "report_experiments.py")


def run_without_packages(script, *paths):
    """As on a machine with Python alone: -S leaves the packages of the distribution out."""
    environment = {k: v for k, v in os.environ.items() if k != "ROS_DISTRO"}
    environment["PYTHONPATH"] = os.pathsep.join(map(str, paths))
    return subprocess.run([sys.executable, "-S", str(script), "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                          universal_newlines=True, env=environment)


class MissingPackages(unittest.TestCase):
    def test_every_script_names_the_package_in_one_line(self):
        for script in [SCRIPTS / name for name in REPORTS] + [ROOT / "experiments" / name for name in EXPERIMENTS]:
            with self.subTest(script=script.name):
                result = run_without_packages(script)
                self.assertEqual(result.returncode, 1)
                self.assertRegex(result.stderr, r"\A%s: there is no Python module (\w+): apt-get install python3-\w+\n\Z"
                                 % re.escape(script.name))

    def test_each_module_by_its_own_package(self):
        with tempfile.TemporaryDirectory() as folder:
            shutil.copy(SCRIPTS / "missing_packages.py", folder)
            script = pathlib.Path(folder) / "script.py"
            for module, package in list(missing_packages.PACKAGES.items()) + [("rospy", "python3-rospy")]:
                with self.subTest(module=module):
                    script.write_text("import missing_packages\nimport %s.part\n" % module)
                    self.assertEqual(run_without_packages(script).stderr,
                                     "script.py: there is no Python module %s: apt-get install %s\n" % (module, package))

    def test_ros_packages_have_other_names_on_ubuntu(self):
        self.assertEqual(missing_packages.remedy("rosbag", "noetic"), "apt-get install ros-noetic-rosbag")
        self.assertEqual(missing_packages.remedy("cv2", "noetic"), "apt-get install python3-opencv")

    def test_other_errors_keep_their_traceback(self):
        with tempfile.TemporaryDirectory() as folder:
            shutil.copy(SCRIPTS / "missing_packages.py", folder)
            script = pathlib.Path(folder) / "script.py"
            for text in ("import missing_packages\nimport no_such_module\n", "import missing_packages\nint('x')\n"):
                script.write_text(text)
                result = run_without_packages(script)
                self.assertEqual(result.returncode, 1)
                self.assertIn("Traceback", result.stderr)

    def test_packages_are_those_that_are_installed_for_the_scripts(self):
        listed = (SCRIPTS / "install_dependencies.sh").read_text()
        for package in missing_packages.PACKAGES.values():
            self.assertRegex(listed, r"\b%s\b" % package)


if __name__ == "__main__":
    unittest.main()
