"""What the viewer hears of the robot: its topics into a `Picture`."""

from collections import deque
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry, Path
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, String
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros import conversions
from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.runtime import OmnimanNode
from omniman_ros.nodes.stopping import ALL_LATCHED, LATCHED
from omniman_ros.nodes.viewing.ears import Ears
from omniman_ros.nodes.viewing.parameters import ViewerParameters
from omniman_ros.viewer.lines import thinned
from omniman_ros.viewer.state import Condition, Picture, Pose

Array = NDArray[np.float64]

COLUMNS = "voltage,current,energy"
"""Of `wheel_electrical`."""
INTERVALS = 1000
"""Intervals of the arm's setpoints that are kept between two samples of the plots."""
LARGEST_ENERGY = 1e15
"""Of a counter [J]."""


class RobotSenses:
    """Platform, arm, paths and stops.

    Args:
        node: Who hears.
        ears: Its subscriptions.
        picture: What is told.
        parameters: Of the node.

    Attributes:
        speeds: Largest component of the twist by where it comes from, odom or truth
            [m/s, rad/s].
        truth_frame: Frame of the ground truth, empty before it is heard.
    """

    def __init__(
        self, node: OmnimanNode, ears: Ears, picture: Picture, parameters: ViewerParameters
    ) -> None:
        self._node = node
        self._picture = picture
        self._names = parameters.robot.wheels.names
        self._joints = parameters.arm.joints
        self._frames = parameters.frames
        self.speeds: dict[str, float] = {}
        self.truth_frame = ""
        self._counted: float | None = None
        self._energy = 0.0
        self._intervals: deque[float] = deque(maxlen=INTERVALS)
        ears.hear(Odometry, "odom", self._on_odom)
        ears.hear(Odometry, "ground_truth/odom", self._on_truth)
        ears.hear(Path, "path", self._on_path, 10)
        ears.hear(Path, "tool_path", self._on_tool_path, 10)
        ears.hear(MultiDOFJointTrajectory, "path/reference", self._on_reference)
        ears.hear(Float64, "path_progress", self._on_progress)
        ears.hear(Float64MultiArray, "wheel_electrical", self._on_electrical)
        ears.hear(String, "active_source", self._on_source, LATCHED)
        ears.hear(DiagnosticStatus, "stop_state", self._on_stop_state, ALL_LATCHED)
        ears.hear(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        ears.hear_watched(JointState, "wheel_states", self._on_wheels)
        ears.hear_watched(JointState, "wheel_commands", self._on_commands)
        ears.hear_watched(JointState, "coupling_error", self._on_coupling)
        ears.hear_watched(JointState, "arm/joint_states", self._on_arm)
        # Not the last alone: the longest interval of all counts.
        ears.hear_watched(Float64MultiArray, "arm/timing", self._on_timing, 50)

    def sample(self, now: float) -> None:
        """Tell what was gathered since the last sample of the plots."""
        if self._intervals:
            intervals = 1e3 * np.array(self._intervals)
            self._intervals.clear()
            self._picture.hear("sending", np.array([intervals.mean(), intervals.max()]), now)

    # ---- platform -----------------------------------------------------------------------------

    def _on_wheels(self, message: JointState) -> None:
        position, velocity, _ = conversions.joint_arrays(message, self._names)
        for values, bound, label in (
            (position, plausible.WHEEL_ANGLE, "position"),
            (velocity, plausible.WHEEL_SPEED, "velocity"),
        ):
            if values is not None:
                plausible.demand(values, bound, label)
        self._picture.hear_wheels(position, velocity, self._node.now())

    def _on_commands(self, message: JointState) -> None:
        _, velocity, _ = conversions.joint_arrays(message, self._names)
        if velocity is not None:
            plausible.demand(velocity, plausible.WHEEL_SPEED, "velocity")
        self._picture.hear_commands(velocity, self._node.now())

    def _on_coupling(self, message: JointState) -> None:
        errors = np.array(message.position, dtype=float)
        plausible.demand(errors, plausible.WHEEL_ANGLE, "position")
        self._picture.hear("coupling", errors, self._node.now())

    def _on_electrical(self, message: Float64MultiArray) -> None:
        labels, n = [dimension.label for dimension in message.layout.dim], len(self._names)
        if labels[1:] != [COLUMNS] or len(message.data) != 3 * n:
            raise InputError(
                f"{len(message.data)} numbers of {labels}, expected {COLUMNS} of {n} wheels"
            )
        rows, now = np.array(message.data, dtype=float).reshape(n, 3), self._node.now()
        volts = np.where(np.abs(rows[:, 0]) <= plausible.EFFORT, rows[:, 0], np.nan)
        self._picture.hear("voltages", volts, now)
        total = float(rows[:, 2].sum())
        if abs(total) <= LARGEST_ENERGY:
            # A counter that was silent may have begun anew: what was shown is kept.
            if self._counted is not None and self._picture.is_fresh("energy", now):
                self._energy += total - self._counted
            self._counted = total
            self._picture.hear("energy", np.array([self._energy]), now)

    def _on_odom(self, message: Odometry) -> None:
        self._picture.hear_odom(_pose(message), self._node.now())
        self.speeds["odom"] = _speed(message)

    def _on_truth(self, message: Odometry) -> None:
        self._picture.hear_truth(_pose(message), self._node.now())
        self.speeds["truth"] = _speed(message)
        self.truth_frame = message.header.frame_id

    # ---- arm ----------------------------------------------------------------------------------

    def _on_arm(self, message: JointState) -> None:
        position, _, _ = conversions.joint_arrays(message, self._joints)
        angles = conversions.present(position, plausible.ANGLE, "position")
        self._picture.hear_arm(angles, self._node.now())

    def _on_timing(self, message: Float64MultiArray) -> None:
        at = 0
        for dimension in message.layout.dim:
            part = message.data[at : at + dimension.size]
            at += dimension.size
            if dimension.label == "intervals":
                intervals = np.array(part, dtype=float)
                plausible.demand(intervals, plausible.LENGTH, "intervals")
                self._intervals.extend(intervals.tolist())

    # ---- paths --------------------------------------------------------------------------------

    def _on_path(self, message: Path) -> None:
        self._picture.path.set(path_points(message, self._frames)[:, :2])

    def _on_tool_path(self, message: Path) -> None:
        self._picture.tool_path.set(path_points(message, self._frames))

    def _on_reference(self, message: MultiDOFJointTrajectory) -> None:
        conversions.check_frame(message.header.frame_id, *self._frames)
        points = message.points
        places = [
            transform.translation
            for i in thinned(len(points))
            for transform in points[i].transforms[:1]
        ]
        self._picture.hear_reference(_positions(places)[:, :2], self._node.now())

    def _on_progress(self, message: Float64) -> None:
        if not 0.0 <= message.data <= 1.0:
            raise InputError(f"{message.data} is not within 0 to 1")
        self._picture.hear_progress(message.data, self._node.now())

    # ---- who drives, who stops ----------------------------------------------------------------

    def _on_source(self, message: String) -> None:
        self._picture.active_source = message.data

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        self._picture.stops[message.name] = Condition(level(message), message.message)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        node = self._node
        inside = node.get_namespace().rstrip("/") + "/"
        for status in message.status:
            if status.name.startswith(inside) and status.name != node.get_fully_qualified_name():
                self._picture.hear_complaint(
                    status.name, level(status), status.message, node.now()
                )


def path_points(message: Path, frames: tuple[str, ...]) -> Array:
    """Positions (k, 3) of a path [m], thinned.

    Raises:
        InputError: Another frame, or a position that is not finite or huge.
    """
    conversions.check_frame(message.header.frame_id, *frames)
    poses = message.poses
    return _positions([poses[i].pose.position for i in thinned(len(poses))])


def level(status: DiagnosticStatus) -> int:
    """0 good, 1 warning, 2 error; stale counts as an error."""
    return min(int.from_bytes(status.level, "little"), 2)


def _positions(places: list[Any]) -> Array:
    points = np.array([(place.x, place.y, place.z) for place in places], dtype=float)
    points = points.reshape(-1, 3)
    plausible.demand(points, plausible.LENGTH, "positions")
    return points


def _pose(message: Odometry) -> Pose:
    position = message.pose.pose.position
    plausible.demand(np.array([position.x, position.y]), plausible.LENGTH, "position")
    return position.x, position.y, conversions.yaw(message.pose.pose.orientation)


def _speed(message: Odometry) -> float:
    return float(np.abs(conversions.twist_array(message.twist.twist)).max())
