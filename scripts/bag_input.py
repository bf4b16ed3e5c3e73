"""Bags as the scripts in Python open them, and the image topics in them.

Installed next to the scripts that import it.
"""
import os

import rosbag

from report_tables import fail

COMPRESSED = "/compressed"  # image_transport's name below that of the image
ROS1_MAGIC = b"#ROSBAG V"
ROS2_MAGICS = (b"SQLite format 3\0", b"\x89MCAP0\r\n")  # rosbag2's storages: sqlite3 and mcap
ROS2_HELP = ("is a ROS 2 bag: convert it with rosbags-convert (pip install rosbags): "
             "rosbags-convert --src %s --dst %s.bag")


def problem_of(path):
    """Why `path` cannot be a ROS 1 bag, and what to do; None where it looks like one."""
    stem = os.path.splitext(path.rstrip("/"))[0]
    if os.path.isdir(path):
        if os.path.isfile(os.path.join(path, "metadata.yaml")):
            return ROS2_HELP % (path, path.rstrip("/"))
        return "is a folder, not a bag"
    if not os.path.isfile(path):
        return "no such file"
    with open(path, "rb") as file:
        begin = file.read(32)
    if begin.startswith(ROS2_MAGICS):
        return ROS2_HELP % (path, stem)
    return None if begin.startswith(ROS1_MAGIC) else "is not a bag: it does not begin with " + ROS1_MAGIC.decode()


def open_bag(path, **options):
    """The rosbag.Bag to read. Fails with a line that names the file and the remedy when it cannot be opened."""
    try:
        problem = problem_of(path)
        if problem is None:
            return rosbag.Bag(path, **options)
    except rosbag.ROSBagUnindexedException:
        problem = "has no index, as of a recording that did not end well: run rosbag reindex " + path
    except rosbag.ROSBagException as error:
        problem = "is damaged or cut (%s): run rosbag reindex %s" % (error, path)
    except OSError as error:
        problem = error.strerror
    fail("%s: %s" % (path, problem))


def image_topic(camera, image):
    """The topic of the images: `image` in the namespace `camera`, unless it begins with /."""
    return image if image.startswith("/") else "/" + camera.strip("/") + "/" + image


def transport_of(path, image):
    """raw where the bag has such a topic, else compressed where it has that, else raw; raw for what is no bag."""
    topics = set()
    try:
        if problem_of(path) is None:
            # The index of a long bag takes time, and says nothing here.
            with rosbag.Bag(path, skip_index=True) as bag:
                topics = {connection.topic for connection in bag._get_connections()}
    except (rosbag.ROSBagException, OSError):
        pass
    return "compressed" if image not in topics and image + COMPRESSED in topics else "raw"
