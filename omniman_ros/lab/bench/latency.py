"""Measurement of the latency from a twist to the wheel commands of a node in another process."""

import random
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from geometry_msgs.msg import Twist
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from omniman_ros.console.errors import CommandError
from omniman_ros.console.preview_messages import twist_message
from omniman_ros.console.session import DISCOVERY_TIMEOUT, Session
from omniman_ros.core.planar import Triple

SETPOINT = QoSProfile(depth=1)
"""Quality of service of topics of which only the last message counts."""
SPEED_STEP = 0.002
"""Step of the forward velocity, small so that the robot is soon at rest again [m/s]."""
REST: Triple = (0.0, 0.0, 0.0)  # twist (v_x, v_y, omega) that commands rest [m/s, m/s, rad/s]
STEP_TIMEOUT = 2.0  # longest time until the wheels react to a step [s]
WARM_UP_PERIOD = 0.1
"""Period at which twists are sent until the node reacts for the first time [s]."""


@dataclass
class CommandPath:
    """The path of a command through a node, from a twist to wheel commands."""

    session: Session  # ROS session that publishes the twists and receives the wheel commands
    name: str  # name of the node in tables and errors
    cmd_vel: str  # topic of the twists
    wheel_commands: str  # topic of the wheel commands
    latencies: list[float] = field(default_factory=list)  # latencies measured so far [s]

    def __post_init__(self) -> None:
        self._moving = False
        self._received = 0
        self._changed_at = 0.0
        node = self.session.node
        self._publisher = node.create_publisher(Twist, self.cmd_vel, SETPOINT)
        node.create_subscription(JointState, self.wheel_commands, self._on_command, SETPOINT)

    def _on_command(self, message: JointState) -> None:
        moving = any(message.velocity)
        if moving != self._moving:
            self._changed_at = time.monotonic()
            self._moving = moving
        self._received += 1

    @property
    def ready(self) -> bool:
        """Whether the node receives the twists, and its wheel commands arrive."""
        return self._received > 0 and self._publisher.get_subscription_count() > 0

    def send(self, twist: Triple) -> None:
        """Publish a twist (v_x, v_y, omega) [m/s, m/s, rad/s]."""
        self._publisher.publish(twist_message(twist))

    def measure(self, pause: float) -> None:
        """Measure the time from a step of the velocity to the first non-zero wheel command.

        The robot is at rest before the step, and again at the end.
        """
        self.session.spin(pause)
        before = time.monotonic()
        self.send((SPEED_STEP, 0.0, 0.0))
        self._await(lambda: self._moving, "move")
        self.latencies.append(self._changed_at - before)
        self.send(REST)
        self._await(lambda: not self._moving, "come to rest")

    def _await(self, condition: Callable[[], bool], action: str) -> None:
        if not self.session.wait(condition, STEP_TIMEOUT):
            raise CommandError(
                f"{self.name}: the wheels do not {action} within {STEP_TIMEOUT:g} s of a step"
            )

    def warm_up(self) -> None:
        """Send twists until the node reacts for the first time, then wait for rest.

        A platform controller ignores twists until it receives wheel states.
        """
        end = time.monotonic() + DISCOVERY_TIMEOUT
        while not (self.ready and self._moving):
            if time.monotonic() > end:
                raise CommandError(f"{self.name}: no connection within {DISCOVERY_TIMEOUT:g} s")
            self.send((SPEED_STEP, 0.0, 0.0))
            self.session.wait(lambda: self.ready and self._moving, WARM_UP_PERIOD)
        self.send(REST)
        self._await(lambda: not self._moving, "come to rest")

    def summary(self) -> dict[str, float]:
        """Return the number of latencies, their median, 90th and 99th percentile [ms]."""
        cuts = statistics.quantiles(self.latencies, n=100, method="inclusive")
        return {
            "samples": len(self.latencies),
            "median_ms": 1e3 * statistics.median(self.latencies),
            "p90_ms": 1e3 * cuts[89],
            "p99_ms": 1e3 * cuts[98],
        }


def measure_paths(
    paths: list[CommandPath], samples: int, block: int, poll: Callable[[], None]
) -> None:
    """Measure the latencies of all paths in alternating blocks.

    Random pauses make the steps fall on random phases of the nodes' timers.
    """
    draw = random.Random(1)
    for path in paths:
        path.warm_up()
    for _ in range(-(-samples // block)):
        for path in paths:
            for _ in range(block):
                poll()
                path.measure(draw.uniform(0.02, 0.04))
