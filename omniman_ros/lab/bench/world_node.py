"""CPU time of `simulated_world` in a running robot, per simulated second."""

import math
import os
from dataclasses import dataclass

from geometry_msgs.msg import Twist
from rosgraph_msgs.msg import Clock

from omniman_ros.console.preview_messages import twist_message
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.core.planar import Triple
from omniman_ros.lab.bench.harness import RunningNodes, running_nodes
from omniman_ros.lab.measurement import cpu_time
from omniman_ros.processes.robot_setup import RobotSetup, robot_processes
from omniman_ros.processes.ros_domain import isolate_ros_domain

NODE = "simulated_world"  # the node that is measured
START_TIMEOUT = 60.0  # longest time from the start of the nodes to simulated time [s]
WARM_UP = 4.0
"""Simulated time from its beginning to the measurement [s]: all nodes run, the robot rests."""
CIRCLES = 3.0
"""Angular frequency of the circles that the robot drives, without rotation of its own [rad/s]."""
REST: Triple = (0.0, 0.0, 0.0)  # twist (v_x, v_y, omega) of a robot at rest [m/s, m/s, rad/s]


@dataclass(frozen=True)
class NodeShare:
    """CPU time of the node per simulated second."""

    rest: float  # while the robot rests, as a share of one core [%]
    driving: float  # while it drives [%]
    pace: float  # mean of simulated over real time


def node_share(robot: str, scene: str, wheels: str, seconds: float, speed: float) -> NodeShare:
    """Measure the node among all nodes of `omniman up --world` but the viewer."""
    isolate_ros_domain(os.environ)
    setup = RobotSetup(
        robot=robot, sim_time=True, world=scene, params=(f"world.wheels:={wheels}",)
    )
    specs = [spec for spec in robot_processes(setup) if spec.name != "viewer"]
    with running_nodes(specs) as nodes:
        meter = _Meter(nodes)
        nodes.wait(lambda: meter.time > WARM_UP, START_TIMEOUT, "simulated time does not begin")
        rest, pace_at_rest = meter.measure(seconds, 0.0)
        driving, pace = meter.measure(seconds, speed)
    return NodeShare(rest, driving, 0.5 * (pace_at_rest + pace))


class _Meter:
    """Drives the robot, and measures the node meanwhile."""

    def __init__(self, nodes: RunningNodes) -> None:
        self.time = 0.0
        self._nodes, self._pid = nodes, nodes.pids([NODE])[NODE]
        node = nodes.session.node
        node.create_subscription(Clock, "/clock", self._on_clock, 1)
        self._publisher = node.create_publisher(Twist, "cmd_vel", 1)

    def _on_clock(self, message: Clock) -> None:
        self.time = time_seconds(message.clock)

    def measure(self, seconds: float, speed: float) -> tuple[float, float]:
        """Return CPU time per simulated time [%], and simulated over real time."""

        def feed(_: float) -> None:
            angle = CIRCLES * self.time
            twist = (speed * math.cos(angle), speed * math.sin(angle), 0.0) if speed else REST
            self._publisher.publish(twist_message(twist))

        time, cpu = self.time, cpu_time(self._pid)
        self._nodes.serve(seconds, feed)
        passed = self.time - time
        return 100.0 * (cpu_time(self._pid) - cpu) / passed, passed / seconds
