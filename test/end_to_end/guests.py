"""Participants that come to a ROS domain and go again, one after the other.

Usage: `guests.py NUMBER`. Each is a process of its own that listens to `odom` until it has heard
it. Every fourth one is killed, as by a crash; the others leave in order. Prints how many have
heard.
"""

import os
import signal
import sys
import time

import rclpy
from nav_msgs.msg import Odometry
from rclpy.experimental import EventsExecutor
from rclpy.node import Node

PATIENCE = 5.0
"""Longest time that a guest listens [s]."""


def visit(number: int) -> bool:
    """Take part until `odom` is heard; return whether it was."""
    heard: list[Odometry] = []
    rclpy.init()
    node = Node(f"guest_{number}")
    node.create_subscription(Odometry, "odom", heard.append, 10)
    executor = EventsExecutor()
    executor.add_node(node)
    end = time.monotonic() + PATIENCE
    while not heard and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
    if heard and number % 4 == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    executor.remove_node(node)
    node.destroy_node()
    rclpy.shutdown()
    return bool(heard)


def main() -> None:
    """Let the guests come, each in a process that shares nothing with the others."""
    served = 0
    for number in range(int(sys.argv[1])):
        pid = os.fork()
        if not pid:
            os._exit(0 if visit(number) else 1)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        served += code in (0, -signal.SIGKILL)
    print(served)  # noqa: T201 - its result, which the test reads


if __name__ == "__main__":
    main()
