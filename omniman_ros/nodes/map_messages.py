"""Messages and quality of service of `map` and `map_updates`, as Nav2's costmaps have them."""

from importlib import import_module
from typing import Any

from rclpy.qos import QoSProfile

OccupancyGridUpdate: Any  #: The type of updates; None where it is missing
try:
    OccupancyGridUpdate = import_module("map_msgs.msg").OccupancyGridUpdate
except ImportError:  # not among the wheels on PyPI
    OccupancyGridUpdate = None

TOPIC = "map"  #: Topic of whole maps, which are latched
UPDATES_TOPIC = "map_updates"  #: Topic of rectangles of cells that have changed since
UPDATES = QoSProfile(depth=10)  #: Quality of service of updates
