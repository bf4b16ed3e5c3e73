#!/usr/bin/env python3
"""What is installed, and with it what the Debian package holds: all that a user needs, nothing that names the sources.

Usage: test_installed_files.py BUILD, the folder of a finished build.
"""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
BUILD = pathlib.Path(sys.argv.pop())
TOOLS = ("calibrate", "deblur_bag", "deblur_image", "deblur_node", "make_bag", "simulate_bag")
LIBRARIES = ("libgyro_deblur_core.so", "libgyro_deblur_nodelet.so", "libgyro_deblur_ros.so")


def local_imports(script):
    """Modules next to a script that it imports, and that they import."""
    found = set()
    for name in re.findall(r"^(?:import|from) (\w+)", script.read_text(), re.MULTILINE):
        module = script.with_name(name + ".py")
        if module.exists():
            found |= {module.name} | local_imports(module)
    return found


class InstalledFiles(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        subprocess.run(["cmake", "--install", str(BUILD), "--prefix", "/usr"], check=True, stdout=subprocess.DEVNULL,
                       env=dict(os.environ, DESTDIR=cls.folder.name))
        cls.root = pathlib.Path(cls.folder.name) / "usr"
        cls.files = {path.relative_to(cls.root).as_posix() for path in cls.root.rglob("*") if path.is_file()}

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def assert_installed(self, names):
        self.assertEqual(sorted(set(names) - self.files), [])

    def test_launch_files_configurations_and_messages(self):
        self.assert_installed("share/gyro_deblur/" + path.relative_to(ROOT).as_posix()
                              for folder in ("config", "launch", "msg", "rviz") for path in (ROOT / folder).rglob("*")
                              if path.is_file())
        self.assert_installed("share/gyro_deblur/" + name for name in ("package.xml", "nodelet_plugins.xml",
                                                                       "cmake/gyro_deblurConfig.cmake"))
        modules = [name.rsplit("/", 1)[-1] for name in self.files if "-packages/gyro_deblur/msg/" in name]
        self.assertLessEqual({"_%s.py" % path.stem for path in (ROOT / "msg").glob("*.msg")}, set(modules))

    def test_headers(self):
        self.assert_installed("include/gyro_deblur/" + path.name for path in (ROOT / "include/gyro_deblur").glob("*.hpp"))

    def test_libraries_are_where_the_plugin_file_says(self):
        where = {name.rsplit("/", 1)[-1]: name for name in self.files}
        for library in LIBRARIES:
            self.assertIn(library, where)
        path = re.search('<library path="([^"]+)"', (ROOT / "nodelet_plugins.xml").read_text()).group(1)
        # Without a folder: Debian's pluginlib looks for a file of that name next to the system's libraries.
        self.assertIn(path + ".so", where)

    def test_tools_and_scripts_with_what_they_import(self):
        self.assert_installed("lib/gyro_deblur/" + name for name in TOOLS)
        scripts = [name for name in self.files if name.startswith("lib/gyro_deblur/") and name.endswith(".py")]
        self.assertIn("lib/gyro_deblur/play_bag.py", scripts)
        self.assertIn("lib/gyro_deblur/setup", self.files)
        for script in scripts + ["lib/gyro_deblur/setup"]:
            self.assert_installed("lib/gyro_deblur/" + name
                                  for name in local_imports(ROOT / "scripts" / script.rsplit("/", 1)[-1]))

    def test_programs_are_executable_and_found_once(self):
        """rosrun takes any executable file below the package's folder, too."""
        for name in sorted(self.files):
            if name.startswith("lib/gyro_deblur/"):
                script = ROOT / "scripts" / name.rsplit("/", 1)[-1]
                is_program = not script.exists() or script.read_text().startswith("#!")
                self.assertEqual(os.access(str(self.root / name), os.X_OK), is_program, name)
                self.assertFalse(script.exists() and os.access(str(script), os.X_OK), script)

    def test_nothing_names_the_sources_or_the_build(self):
        for name in self.files:
            content = (self.root / name).read_bytes()
            if content.startswith(b"\x7fELF"):
                continue  # names sources in its debug information and assertions
            for path in (ROOT, BUILD):
                self.assertNotIn(str(path).encode() + b"/", content, name)

    def test_package_depends_on_packages_that_are_there(self):
        if not shutil.which("apt-cache") or not pathlib.Path("/usr/share/catkin").exists():
            self.skipTest("the ROS packages here are not Debian's")
        text = (ROOT / "cmake" / "package.cmake").read_text()
        names = re.search(r"else\(\).*?set\(ros_packages([^)]*)\)", text, re.DOTALL).group(1).split()
        self.assertLessEqual({"rviz", "rosbash", "libnodeletlib-tools", "python3-roslaunch"}, set(names))
        for name in names:
            status = subprocess.run(["dpkg-query", "-W", "-f", "${db:Status-Status}", name], stdout=subprocess.PIPE,
                                    stderr=subprocess.DEVNULL, universal_newlines=True).stdout
            self.assertEqual(status, "installed", "%s is not among the packages of the tests" % name)


if __name__ == "__main__":
    unittest.main(verbosity=2)
