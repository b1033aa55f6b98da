"""The platform controller with an ideal drive: wheels follow their commands at once."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros.nodes.platform_controller import PlatformControllerNode
from test.nodes.harness import PERIOD, World

TIMEOUT = {"cmd_vel": 0.5, "wheel_states": 0.1, "reference": 0.2}


class Rig(World):
    """A controller node with an ideal drive and a probe on simulated time.

    Attributes:
        node: The node under test.
        commands: All messages of `wheel_commands`.
        odom: All messages of `odom`.
        drive_alive: Whether the drive sends reports.
        stuck: (n,) flags of the wheels that stand still whatever the command.
    """

    def __init__(self, parameters: dict[str, Any] | None = None) -> None:
        super().__init__(PlatformControllerNode, parameters=parameters)
        self.node: PlatformControllerNode = self.nodes[0]
        self.core = self.node.core
        self.names = list(self.core.parameters.robot.wheels.names)
        self.commands = self.listen(JointState, "wheel_commands")
        self.volts = self.listen(JointState, "wheel_voltages")
        self.odom = self.listen(Odometry, "odom")
        self._states = self.publisher(JointState, "wheel_states")
        self.cmd_vel = self.publisher(Twist, "cmd_vel")
        self.drive_alive = True
        self.stuck = np.zeros(len(self.names), dtype=bool)
        self.position = np.zeros(len(self.names))
        self.hooks.append(self._drive)
        self.run(4 * PERIOD)

    def _drive(self) -> None:
        speeds = np.where(self.stuck, 0.0, self.core.cascade.reference)
        self.position = self.position + PERIOD * speeds
        if self.drive_alive:
            self._states.publish(self.wheel_state(self.position, speeds))

    def wheel_state(self, position: Sequence[float], velocity: Sequence[float]) -> JointState:
        """Return a report of the drive with the current stamp."""
        message = JointState(
            name=self.names, position=[*map(float, position)], velocity=[*map(float, velocity)]
        )
        message.header.stamp = self.stamp()
        return message

    def speeds(self, since: int = 0) -> np.ndarray:
        """Return the commanded wheel speeds (k, n) from command `since` on; NaN in torque mode."""
        nothing = [float("nan")] * len(self.names)
        return np.array([list(c.velocity) or nothing for c in self.commands[since:]])

    def drive(self, x: float, y: float = 0.0, turn: float = 0.0, seconds: float = 1.0) -> None:
        """Publish a twist at the tick rate for a duration."""
        self.run(seconds, lambda: self.cmd_vel.publish(twist(x, y, turn)))

    def assert_stops(self, since: int, within: float) -> None:
        """Assert that every wheel ramps to exactly zero within its deceleration and stays."""
        self.run(within)
        speeds = self.speeds(since)
        assert np.isfinite(speeds).all()
        limits = self.core.parameters.limits
        bound = self.wheel_deceleration(limits.linear_deceleration, limits.angular_deceleration)
        steps = np.diff(speeds, axis=0)
        assert (np.abs(steps) <= bound * PERIOD + 1e-9).all(), "a wheel decelerates too fast"
        assert not speeds[-1].any(), f"wheels still commanded to turn: {speeds[-1]}"
        moved = len(self.commands)
        self.run(0.2)
        assert not self.speeds(moved).any(), "wheels moved again without a command"

    def wheel_deceleration(self, linear: float, angular: float) -> np.ndarray:
        """Return the largest wheel decelerations (n,) that the twist limits allow [rad/s^2]."""
        jacobian = self.core.cascade.kinematics.J
        return np.hypot(jacobian[:, 0], jacobian[:, 1]) * linear + abs(jacobian[:, 2]) * angular


def twist(x: float, y: float = 0.0, turn: float = 0.0) -> Twist:
    """Return a twist message."""
    message = Twist()
    message.linear.x, message.linear.y, message.angular.z = float(x), float(y), float(turn)
    return message


def reference(
    times: Sequence[float],
    poses: Sequence[Sequence[float]],
    velocities: Sequence[Sequence[float]],
    stamp: Any,
    frame: str = "odom",
) -> MultiDOFJointTrajectory:
    """Return a preview: poses (x, y, theta) and world velocities at times from the stamp [s]."""
    from builtin_interfaces.msg import Duration
    from geometry_msgs.msg import Transform
    from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint

    message = MultiDOFJointTrajectory(joint_names=["platform"])
    message.header.frame_id, message.header.stamp = frame, stamp
    for t, pose, velocity in zip(times, poses, velocities, strict=True):
        transform = Transform()
        transform.translation.x, transform.translation.y = float(pose[0]), float(pose[1])
        transform.rotation.z = float(np.sin(pose[2] / 2))
        transform.rotation.w = float(np.cos(pose[2] / 2))
        message.points.append(
            MultiDOFJointTrajectoryPoint(
                transforms=[transform],
                velocities=[twist(*velocity)],
                time_from_start=Duration(sec=int(t), nanosec=int(t % 1 * 1e9)),
            )
        )
    return message
