"""Subscriptions to the robot's topics, which update the `ViewState`."""

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, String
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros.conversions.coupling import total_coupling_error
from omniman_ros.conversions.geometry import twist_array, yaw_from_quaternion
from omniman_ros.conversions.headers import check_frame
from omniman_ros.conversions.joints import joint_arrays, require_array
from omniman_ros.conversions.wheels import electrical_rows
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.motion_log import MotionEvent
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.simulated_clock import AWAITED_KEY, PACE_KEY
from omniman_ros.nodes.stop_interface import ALL_LATCHED, LATCHED
from omniman_ros.viewer.lines import thinned
from omniman_ros.viewer.ros.lazy_subscriptions import LazySubscriptions
from omniman_ros.viewer.ros.page_frames import PageFrames
from omniman_ros.viewer.ros.parameters import ViewerParameters
from omniman_ros.viewer.view_state import PATH_NODES, Condition, Pose, ViewState

MAX_INTERVALS = 1000  #: Largest number of setpoint intervals in one sample of the plots
MAX_ENERGY = 1e15  #: Largest plausible value of an energy counter [J]
#: Keys of the states of the motions in the diagnostics of the nodes that drive along paths
_MOTION_KEYS = ("state", "arm", "body")

#: Events of a path of the tool that is not decided upon
_BEFORE_START = tuple(
    event.value for event in (MotionEvent.RECEIVED, MotionEvent.WAITING, MotionEvent.PLANNING)
)


class RobotTopics:
    """Receives the topics of platform, arm, paths and stops.

    `on_standstill` is called when simulated time is known to stand, and when it goes on: while it
    stands, nothing is done that is due at a time.
    """

    def __init__(
        self,
        node: OmnimanNode,
        subscriptions: LazySubscriptions,
        state: ViewState,
        parameters: ViewerParameters,
        frames: PageFrames,
        on_standstill: Callable[[], None],
    ) -> None:
        self._node, self._on_standstill = node, on_standstill
        self._state = state
        self._names = parameters.robot.wheels.names
        self._joints = parameters.arm.joints
        self._odom_names, self._frames = parameters.frames, frames
        self._last_count: float | None = None
        self._energy = 0.0
        self._intervals: deque[float] = deque(maxlen=MAX_INTERVALS)
        subscriptions.subscribe(Odometry, "odom", self._on_odom)
        subscriptions.subscribe(Odometry, "ground_truth/odom", self._on_truth)
        for topic, handler in (("path", self._on_path), ("tool_path", self._on_tool_path)):
            waiting = frames.transforms.deferred(topic, lambda message: [message.header], handler)
            subscriptions.subscribe(Path, topic, waiting, 10)
        subscriptions.subscribe(MultiDOFJointTrajectory, "path/reference", self._on_reference)
        subscriptions.subscribe(Float64, "path_progress", self._on_progress)
        subscriptions.subscribe(Float64MultiArray, "wheel_electrical", self._on_electrical)
        subscriptions.subscribe(String, "active_source", self._on_source, LATCHED)
        subscriptions.subscribe(DiagnosticStatus, "stop_state", self._on_stop_state, ALL_LATCHED)
        subscriptions.subscribe(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        subscriptions.subscribe_while_watched(JointState, "wheel_states", self._on_wheels)
        subscriptions.subscribe_while_watched(JointState, "wheel_commands", self._on_commands)
        subscriptions.subscribe_while_watched(JointState, "coupling_error", self._on_coupling)
        subscriptions.subscribe_while_watched(JointState, "arm/joint_states", self._on_arm)
        # Every message matters, not just the latest: the plot shows the longest interval of all.
        subscriptions.subscribe_while_watched(Float64MultiArray, "arm/timing", self._on_timing, 50)

    def sample(self, now: float) -> None:
        """Write what was collected since the previous sample of the plots into the state."""
        if self._intervals:
            intervals = 1e3 * np.array(self._intervals)
            self._intervals.clear()
            self._state.update_signal(
                "sending", np.array([intervals.mean(), intervals.max()]), now
            )

    # ---- platform -----------------------------------------------------------------------------

    def _on_wheels(self, message: JointState) -> None:
        position, velocity, _ = joint_arrays(message, self._names)
        for values, bound, label in (
            (position, plausible.WHEEL_ANGLE, "position"),
            (velocity, plausible.WHEEL_SPEED, "velocity"),
        ):
            if values is not None:
                plausible.demand(values, bound, label)
        self._state.update_wheels(position, velocity, self._node.now())

    def _on_commands(self, message: JointState) -> None:
        _, velocity, _ = joint_arrays(message, self._names)
        if velocity is not None:
            plausible.demand(velocity, plausible.WHEEL_SPEED, "velocity")
        self._state.update_commands(velocity, self._node.now())

    def _on_coupling(self, message: JointState) -> None:
        errors = np.array(total_coupling_error(message), dtype=float)
        plausible.demand(errors, plausible.WHEEL_ANGLE, "position")
        self._state.update_signal("coupling", errors, self._node.now())

    def _on_electrical(self, message: Float64MultiArray) -> None:
        rows, now = electrical_rows(message, len(self._names)), self._node.now()
        volts = np.where(np.abs(rows[:, 0]) <= plausible.EFFORT, rows[:, 0], np.nan)
        self._state.update_signal("voltages", volts, now)
        total = float(rows[:, 2].sum())
        if abs(total) <= MAX_ENERGY:
            # A counter that was silent may have restarted: the displayed energy is kept.
            if self._last_count is not None and self._state.is_fresh("energy", now):
                self._energy += total - self._last_count
            self._last_count = total
            self._state.update_signal("energy", np.array([self._energy]), now)

    def _on_odom(self, message: Odometry) -> None:
        self._state.update_odom(_pose(message), self._node.now())
        self._state.speeds["odom"] = _speed(message)

    def _on_truth(self, message: Odometry) -> None:
        self._state.update_truth(_pose(message), self._node.now())
        self._state.speeds["truth"] = _speed(message)

    # ---- arm ----------------------------------------------------------------------------------

    def _on_arm(self, message: JointState) -> None:
        position, _, _ = joint_arrays(message, self._joints)
        angles = require_array(position, plausible.ANGLE, "position")
        self._state.update_arm(angles, self._node.now())

    def _on_timing(self, message: Float64MultiArray) -> None:
        start = 0
        for dimension in message.layout.dim:
            part = message.data[start : start + dimension.size]
            start += dimension.size
            if dimension.label == "intervals":
                intervals = np.array(part, dtype=float)
                plausible.demand(intervals, plausible.LENGTH, "intervals")
                self._intervals.extend(intervals.tolist())

    # ---- paths --------------------------------------------------------------------------------

    def _on_path(self, message: Path) -> None:
        self._state.path.set(self._placed_points("path", message)[:, :2])

    def _on_tool_path(self, message: Path) -> None:
        self._state.tool_path.set(self._placed_points("tool_path", message))

    def _placed_points(self, topic: str, message: Path) -> Array:
        """Return the positions (k, 3) of a path in odom [m], where path_interpolator puts it."""
        transform = self._frames.into_odom(topic, message.header)
        points = path_points(message, (message.header.frame_id.lstrip("/"),))
        matrix = transform.matrix()
        placed: Array = points @ matrix[:3, :3].T + matrix[:3, 3]
        return placed

    def _on_reference(self, message: MultiDOFJointTrajectory) -> None:
        check_frame(message.header.frame_id, *self._odom_names)
        points = message.points
        positions = [
            transform.translation
            for i in thinned(len(points))
            for transform in points[i].transforms[:1]
        ]
        self._state.update_line("reference", _positions(positions)[:, :2], self._node.now())

    def _on_progress(self, message: Float64) -> None:
        if not 0.0 <= message.data <= 1.0:
            raise InputError(f"{message.data} must be within 0 to 1")
        self._state.update_progress(message.data, self._node.now())

    # ---- sources, stops and diagnostics ---------------------------------------------------------

    def _on_source(self, message: String) -> None:
        self._state.active_source = message.data

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        self._state.stops[message.name] = Condition(level(message), message.message)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        node = self._node
        prefix = node.get_namespace().rstrip("/") + "/"
        for status in message.status:
            name = status.name.removeprefix(prefix)
            values = {item.key: item.value for item in status.values}
            if status.name.startswith(prefix) and status.name != node.get_fully_qualified_name():
                outcomes = {text for key, text in values.items() if key.split("_")[-1] == "last"}
                self._state.update_diagnostics(
                    status.name, level(status), status.message, node.now(), outcomes
                )
                self._update_pace(values)
            if name in PATH_NODES:
                self._note_tool_path(values)
                self._state.path_states[name] = frozenset(
                    values[key] for key in _MOTION_KEYS if key in values
                )

    def _note_tool_path(self, values: dict[str, str]) -> None:
        """Note why the path of the tool that the page has sent is refused.

        The first report after it may be older than the path.
        """
        state, event = self._state, values.get("tool_path_event")
        if state.tool_reports is None or event is None:
            return
        state.tool_reports += 1
        if state.tool_reports == 1:
            return
        if event == MotionEvent.REFUSED.value:
            state.note = values.get("tool_path_last", "")
        if event not in _BEFORE_START:
            state.tool_reports = None

    def _update_pace(self, values: dict[str, str]) -> None:
        """Take the pace of simulated time from the node that publishes /clock."""
        if PACE_KEY not in values:
            return
        try:
            pace = float(values[PACE_KEY])
        except ValueError as error:
            raise InputError(f"{PACE_KEY} {values[PACE_KEY]} must be a number") from error
        was_awaited = bool(self._state.awaited)
        self._state.pace = pace if math.isfinite(pace) else None
        self._state.awaited = tuple(values.get(AWAITED_KEY, "").split())
        if was_awaited or self._state.awaited:
            self._on_standstill()


def path_points(message: Path, frames: tuple[str, ...]) -> Array:
    """Return the positions (k, 3) of a path [m], thinned.

    Raises:
        InputError: The frame is not accepted, or a position is not finite or implausibly large.
    """
    check_frame(message.header.frame_id, *frames)
    poses = message.poses
    return _positions([poses[i].pose.position for i in thinned(len(poses))])


def level(status: DiagnosticStatus) -> int:
    """Return 0 for ok, 1 for a warning, 2 for an error; stale counts as an error."""
    return min(int.from_bytes(status.level, "little"), 2)


def _positions(vectors: list[Any]) -> Array:
    points = np.array([(vector.x, vector.y, vector.z) for vector in vectors], dtype=float)
    points = points.reshape(-1, 3)
    plausible.demand(points, plausible.LENGTH, "positions")
    return points


def _pose(message: Odometry) -> Pose:
    position = message.pose.pose.position
    plausible.demand(np.array([position.x, position.y]), plausible.LENGTH, "position")
    return position.x, position.y, yaw_from_quaternion(message.pose.pose.orientation)


def _speed(message: Odometry) -> float:
    return float(np.abs(twist_array(message.twist.twist)).max())
