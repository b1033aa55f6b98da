"""Relocation of a simulated robot: it is moved once it is at rest, then odometry is checked."""

import math
from dataclasses import dataclass
from enum import Enum

from geometry_msgs.msg import PoseWithCovarianceStamped

from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.core import se2
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.viewer.view_state import Pose, ViewState

REST_TIMEOUT = 3.0  #: Time that the robot may take to come to rest [s]
ODOMETRY_TIMEOUT = 2.0  #: Time for odometry to report the new pose, above `SOURCE_TIMEOUT` [s]
#: Time to wait after odometry was set [s].
#:
#: Setting odometry cancels the sources that drive; they are accepted again only after a period of
#: silence, so a goal that is sent sooner would be given up.
SOURCE_TIMEOUT = 1.2
POSE_TOLERANCE = 0.05  #: Distance [m] and angle [rad] within which the robot has reached the pose
REST_SPEED = 0.02  #: Speed below which the robot counts as at rest [m/s, rad/s]
IDLE_SOURCES = ("", "none", "stop")  #: Values of `active_source` while no source drives


class RelocationStep(Enum):
    """The next step of a relocation; the value of a failure says what went wrong."""

    WAIT = "wait"
    MOVE = "move"
    DONE = "done"
    NOT_AT_REST = "the robot does not come to rest"
    ODOMETRY_LOST = "odometry does not follow"


@dataclass
class Relocation:
    """State machine of one relocation."""

    pose: Pose  #: Pose to move the robot to
    requested_at: float  #: Time of the request [s]
    moved_at: float | None = None  #: Time at which the robot was moved [s]; None before that

    def step(self, at_rest: bool, odom: Pose | None, now: float) -> RelocationStep:
        """Return the next step; MOVE comes once, and a final step ends the relocation.

        Args:
            at_rest: Whether no source drives the robot and it is at rest.
            odom: Pose that odometry reports; None if there is no odometry.
        """
        if self.moved_at is None:
            if at_rest:
                self.moved_at = now
                return RelocationStep.MOVE
            is_late = now - self.requested_at > REST_TIMEOUT
            return RelocationStep.NOT_AT_REST if is_late else RelocationStep.WAIT
        if now - self.moved_at < SOURCE_TIMEOUT:
            return RelocationStep.WAIT
        if odom is None or self._is_near(odom):
            return RelocationStep.DONE
        is_late = now - self.moved_at > ODOMETRY_TIMEOUT
        return RelocationStep.ODOMETRY_LOST if is_late else RelocationStep.WAIT

    def _is_near(self, odom: Pose) -> bool:
        angle = abs(se2.wrap(odom[2] - self.pose[2]))
        return math.dist(odom[:2], self.pose[:2]) < POSE_TOLERANCE and angle < POSE_TOLERANCE


class Relocator:
    """Moves a simulated robot through `initialpose` (the plant) and `set_pose` (odometry)."""

    def __init__(self, node: OmnimanNode, state: ViewState, odom_frame: str) -> None:
        self._node = node
        self._state = state
        self._odom_frame = odom_frame
        self._plant = node.create_publisher(PoseWithCovarianceStamped, "initialpose", 10)
        self._odometry = node.create_publisher(PoseWithCovarianceStamped, "set_pose", 10)
        self._relocation: Relocation | None = None

    @property
    def active(self) -> bool:
        """Whether a relocation is under way."""
        return self._relocation is not None

    def begin(self, pose: Pose, now: float) -> None:
        """Begin to move the robot to a pose."""
        self._relocation = Relocation(pose, now)

    def abort(self) -> None:
        """End a relocation that is under way."""
        self._relocation = None

    def step(self, now: float, *, sources_released: bool) -> RelocationStep:
        """Continue a relocation; call this once per period.

        Args:
            sources_released: Whether path and planner have answered the request to cancel.

        Returns:
            WAIT while it continues, or if there is none; otherwise how it ended.
        """
        if self._relocation is None:
            return RelocationStep.WAIT
        at_rest = sources_released and not self.motion_reason(now)
        odom = self._state.odom if self._state.is_fresh("odom", now) else None
        step = self._relocation.step(at_rest, odom, now)
        if step is RelocationStep.MOVE:
            self._publish(self._relocation.pose)
            return RelocationStep.WAIT
        if step is not RelocationStep.WAIT:
            self._relocation = None
        return step

    def simulation_reason(self, now: float) -> str:
        """Return why the robot cannot be moved as a simulated one, or an empty string."""
        has_truth = self._state.is_fresh("truth", now)
        simulated = has_truth and self._plant.get_subscription_count()
        return "" if simulated else "only a simulated robot can be relocated"

    def motion_reason(self, now: float) -> str:
        """Return why the robot does not count as at rest, or an empty string."""
        source = self._state.active_source
        if source not in IDLE_SOURCES:
            return f"{source} drives"
        speeds = [
            speed for name, speed in self._state.speeds.items() if self._state.is_fresh(name, now)
        ]
        return "the robot moves" if max(speeds, default=0.0) > REST_SPEED else ""

    def _publish(self, pose: Pose) -> None:
        message = PoseWithCovarianceStamped()
        message.pose.pose.position.x, message.pose.pose.position.y = pose[:2]
        message.pose.pose.orientation = quaternion_from_yaw(pose[2])
        message.header.stamp = self._node.stamp()
        message.header.frame_id = self._odom_frame
        self._plant.publish(message)
        self._odometry.publish(message)
