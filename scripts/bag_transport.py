#!/usr/bin/env python3
"""Prints the transport of a bag's images, raw or compressed, for playback.launch.

Ends well for a bag that cannot be read, too: play_bag.py says what is wrong with it. Usage: BAG CAMERA IMAGE
"""
import sys

import missing_packages  # noqa: F401  (first: names the package of a module that is missing)
from bag_input import image_topic, transport_of

bag_path, camera, image = sys.argv[1:]
sys.stdout.write(transport_of(bag_path, image_topic(camera, image)))
