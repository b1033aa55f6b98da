"""Messages and quality of service of /tf and /tf_static.

The names are absolute, as tf2's are: to keep the transforms of a namespace in it, remap them
(`-r /tf:=tf -r /tf_static:=tf_static`), as the launch file and `omniman up` do.
"""

from importlib import import_module
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

TFMessage: Any  #: The messages' type; None where it is missing
try:
    TFMessage = import_module("tf2_msgs.msg").TFMessage
except ImportError:  # not among the wheels on PyPI
    TFMessage = None

TOPIC = "/tf"  #: Topic of transforms that change
STATIC_TOPIC = "/tf_static"  #: Topic of transforms that hold for ever
#: Quality of service of subscriptions to /tf: any publisher matches
LISTENER = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
#: Quality of service of subscriptions to /tf_static: each publisher keeps one message for them
STATIC_LISTENER = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: Quality of service with which /tf_static is published
STATIC_PUBLISHER = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
