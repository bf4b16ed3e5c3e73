"""Ends a script that misses a Python module of another package with one line that names the package to install.

Imported before those modules; installed next to the scripts that import it.
"""
import os
import sys

# apt's package of each module, the same on Debian and Ubuntu; scripts/install_dependencies.sh installs them.
PACKAGES = {"PIL": "python3-pil", "cv2": "python3-opencv", "matplotlib": "python3-matplotlib",
            "numpy": "python3-numpy", "tqdm": "python3-tqdm", "yaml": "python3-yaml"}
ROS_MODULES = ("rosbag", "rosgraph", "rospy")


def remedy(module, distribution=os.environ.get("ROS_DISTRO", "")):
    """What to do about a missing module; None for one that is not known here.

    distribution: of ROS's own packages, "noetic"; anything else stands for Debian's.
    """
    if module in PACKAGES:
        return "apt-get install " + PACKAGES[module]
    if module in ROS_MODULES:
        return "apt-get install %s%s" % ("ros-noetic-" if distribution == "noetic" else "python3-", module)
    if module == "gyro_deblur":
        return "source the setup.bash of the workspace it is built in"
    return None


def _tell(kind, error, traceback):
    module = (getattr(error, "name", None) or "").partition(".")[0]
    advice = remedy(module) if issubclass(kind, ModuleNotFoundError) else None
    if advice:
        print("%s: there is no Python module %s: %s" % (os.path.basename(sys.argv[0]), module, advice),
              file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, traceback)


sys.excepthook = _tell
