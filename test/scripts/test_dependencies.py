#!/usr/bin/env python3
"""Every key of package.xml has packages on Ubuntu 20.04, Debian 12 and 13; install_dependencies.sh installs them.

Looked up in rosdep_keys.yaml: rosdep needs a network, and a machine of each system.
"""

import pathlib
import re
import shutil
import subprocess
import unittest
import xml.etree.ElementTree as ElementTree

import yaml

ROOT = pathlib.Path(__file__).resolve().parents[2]
TABLES = yaml.safe_load((pathlib.Path(__file__).parent / "rosdep_keys.yaml").read_text())
DEBIAN_TABLES = [name for name in TABLES if name.startswith("debian_")]


def keys_of(text, *types):
    """Keys of a package.xml: of these types of dependencies, or of all."""
    return {element.text for element in ElementTree.fromstring(text)
            if element.tag.endswith("depend") and (not types or element.tag in types)}


def table_of_this_system():
    """The table of the Debian release that this machine runs, or None."""
    release = pathlib.Path("/etc/os-release").read_text()
    codename = re.search(r"^VERSION_CODENAME=(\S+)$", release, re.MULTILINE)
    return TABLES.get("debian_" + codename.group(1)) if codename else None


def without_packages(keys, table):
    return sorted(key for key in keys if not table.get(key))


class Dependencies(unittest.TestCase):
    def setUp(self):
        self.text = (ROOT / "package.xml").read_text()
        self.keys = keys_of(self.text)

    def test_every_key_has_packages_on_every_system(self):
        for system, table in TABLES.items():
            with self.subTest(system=system):
                self.assertEqual(without_packages(self.keys, table), [],
                                 "look the key up where rosdep_keys.yaml says, and add it there; if a system has no "
                                 "package, package.xml cannot ask for it")

    def test_keys_that_rosdep_would_refuse_are_found(self):
        self.assertEqual(set(TABLES), {"ubuntu_focal", "debian_bookworm", "debian_trixie"})
        for key in ("cli11", "no_such_key"):
            text = self.text.replace("</package>", "<build_depend>%s</build_depend></package>" % key)
            self.assertEqual(without_packages(keys_of(text), TABLES["ubuntu_focal"]), [key])

    def test_tables_hold_nothing_that_is_not_asked_for(self):
        # cli11 is what the test above needs.
        for system, table in TABLES.items():
            self.assertEqual(sorted(set(table) - self.keys), ["cli11"], system)

    def test_installing_the_nodelet_installs_no_packages_of_reports_and_tests(self):
        installed = keys_of(self.text, "depend", "exec_depend")
        self.assertEqual([key for key in installed if re.match(r"python3-|imagemagick|xvfb", key)], [])
        # What launch files start.
        self.assertLessEqual({"nodelet", "rviz", "rosbag"}, installed)

    def test_install_dependencies_names_the_packages_of_debian(self):
        listed = set(re.findall(r"[a-z0-9][a-z0-9.+-]+", (ROOT / "scripts" / "install_dependencies.sh").read_text()))
        # Those of ROS come as dependencies of the ones that are named: see below.
        for name in DEBIAN_TABLES:
            for key, packages in TABLES[name].items():
                if key in self.keys and packages == TABLES["ubuntu_focal"][key]:
                    self.assertLessEqual(set(packages), listed, (name, key))

    @unittest.skipUnless(shutil.which("dpkg-query") and pathlib.Path("/usr/share/catkin").exists(),
                         "the ROS packages here are not Debian's")
    def test_install_dependencies_installs_every_key_on_debian(self):
        table = table_of_this_system()
        if table is None:
            self.skipTest("rosdep_keys.yaml has no table of this Debian release")
        result = subprocess.run(["dpkg-query", "-W", "-f", "${Package} ${db:Status-Status}\n"], stdout=subprocess.PIPE,
                                universal_newlines=True, check=True)
        installed = {line.split()[0] for line in result.stdout.splitlines() if line.endswith(" installed")}
        missing = [key for key in sorted(self.keys) if not installed & set(table[key])]
        self.assertEqual(missing, [], "scripts/install_dependencies.sh build test does not install them")


if __name__ == "__main__":
    unittest.main(verbosity=2)
