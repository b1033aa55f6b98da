#!/usr/bin/env python3
"""Starts the executable of a simulated drive, talks to it over DDS, and ends it with SIGINT.

Usage: talk.py EXECUTABLE. Exit code 0: it published wheel states, answered a service call, and
ended with exit code 0.
"""

import signal
import subprocess
import sys
import time
from collections.abc import Callable

import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from sensor_msgs.msg import JointState

TIMEOUT = 30.0
"""Longest wait [s] for one answer; two processes mostly find each other in 0.1 s."""


def wait(node: Node, what: str, done: Callable[[], bool]) -> None:
    """Spin until it is done, or end with an error."""
    start = time.monotonic()
    while not done():
        if time.monotonic() - start > TIMEOUT:
            sys.exit(f"error: no {what} within {TIMEOUT} s")
        rclpy.spin_once(node, timeout_sec=0.1)
    print(f"{what} after {time.monotonic() - start:.2f} s")


def talk(node: Node) -> None:
    """Receive one wheel state and read one parameter."""
    states: list[JointState] = []
    node.create_subscription(JointState, "wheel_states", states.append, 1)
    wait(node, "wheel states", lambda: bool(states))

    client = node.create_client(GetParameters, "simulated_drive/get_parameters")
    wait(node, "parameter service", client.service_is_ready)
    answer = client.call_async(GetParameters.Request(names=["robot"]))
    wait(node, "parameter", answer.done)
    robot = answer.result().values[0].string_value
    print(f"robot {robot}, wheels {', '.join(states[0].name)}")


def main(executable: str) -> None:
    """Start, talk, end."""
    drive = subprocess.Popen([executable])
    try:
        rclpy.init()
        node = rclpy.create_node("talk")
        talk(node)
        node.destroy_node()
        rclpy.shutdown()

        drive.send_signal(signal.SIGINT)
        code = drive.wait(timeout=TIMEOUT)
        print(f"exit code {code} after SIGINT")
        if code != 0:
            sys.exit("error: the exit code should be 0")
    finally:
        drive.kill()


if __name__ == "__main__":
    main(sys.argv[1])
