"""Participants that come and go: processes that join the robot's domain for a moment.

Usage: `python -m omniman_ros.lab.bench.guests COUNT`. Each guest receives what a robot reports, as
`ros2 topic echo` does, for 0.2 to 2 s; every other one is killed. They are forked from a process
that has imported all they need: they take the time of a participant, not of an import. Guests use
shared memory, and the locks of those that were killed may hold them up for good: a guest that does
not end by itself is ended by SIGALRM.
"""

import os
import random
import signal
import sys
import time

import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState

AT_ONCE = 6
"""Largest number of guests at a time."""
STAY = (0.2, 2.0)
"""Shortest and longest stay of a guest [s]."""
LONGEST_LIFE = 20.0
"""Time after which a guest that has not ended is ended [s]."""
PROBE = "bench/probe"
"""Topic of the benchmark's own messages."""
TOPICS = ((JointState, PROBE), (JointState, "wheel_states"), (Odometry, "odom"))
"""Type and topic of each subscription of a guest."""


def stay(number: int, seconds: float) -> None:
    """Be a participant for some time [s]; with an odd number, end by SIGKILL."""
    signal.setitimer(signal.ITIMER_REAL, LONGEST_LIFE)
    rclpy.init(args=[])
    node = rclpy.create_node(f"guest_{number}")
    for kind, topic in TOPICS:
        node.create_subscription(kind, topic, lambda message: None, 10)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
    if number % 2:
        os.kill(os.getpid(), signal.SIGKILL)
    node.destroy_node()
    rclpy.shutdown()


def main() -> int:
    """Let the guests come and go; return 0 when the last one has left."""
    count, stays = int(sys.argv[1]), random.Random(0)
    present = 0
    for number in range(count):
        if present == AT_ONCE:
            os.wait()
            present -= 1
        seconds = stays.uniform(*STAY)
        if os.fork() == 0:
            try:
                stay(number, seconds)
            finally:
                os._exit(0)
        present += 1
    for _ in range(present):
        os.wait()
    return 0


if __name__ == "__main__":
    sys.exit(main())
