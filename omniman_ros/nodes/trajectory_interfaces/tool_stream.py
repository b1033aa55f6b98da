"""A tool path under way, whose joint angles are corrected for the platform's measured pose."""

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from geometry_msgs.msg import PoseStamped

from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.core.arrays import Array
from omniman_ros.motion.axes import JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.path.pace import Pace
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.path.window import Window, paced_window
from omniman_ros.motion.whole_body.correction import (
    PlatformCorrection,
    corrected_arm_motion,
    joint_speed_pace,
)
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.nodes.omniman_node import OmnimanNode

#: Number of steps between a pace of 0 and 1; fewer changes of the pace disturb the motion less
PACE_STEPS = 20


class LedTool(Protocol):
    """The tool of a planned motion."""

    @property
    def branch(self) -> int:
        """Branch of the arm's inverse kinematics."""

    def tool(self, times: Array) -> Array:
        """Return poses (m, 4, 4) of `tool0` in odom at times (m,) of the motion [s]."""


class PlannedAxes(Protocol):
    """The axes of a planned motion, in motion time."""

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, 9) at increasing motion times (k,) [s]."""

    def plan_times(self, times: Array) -> Array:
        """Return the times (k,) of the tool's motion at increasing motion times (k,) [s]."""


@dataclass(frozen=True)
class CorrectedStretch:
    """A stretch of a tool path, corrected for the platform's error."""

    window: Window  #: All axes (k, 9) at the times of the stretch
    tool: Array  #: (4, 4) planned pose of `tool0` in odom at the first time


class ToolStream:
    """A planned tool path whose joint angles are corrected for the platform's error.

    Args:
        velocity: (6,) limits of the joint speeds [rad/s].
    """

    def __init__(
        self,
        model: WholeBodyModel,
        plan: LedTool,
        options: ToolPathOptions,
        velocity: tuple[float, ...],
    ) -> None:
        self._model, self.plan, self._velocity = model, plan, np.array(velocity)
        self.correction = PlatformCorrection(options)
        self._joint_pace: float = 1.0
        self._arm_offset: Array = np.zeros(len(velocity))

    @property
    def max_pace(self) -> float:
        """Highest pace at which the path may be driven, 0 to 1."""
        steps = np.floor(PACE_STEPS * min(self.correction.max_pace(), self._joint_pace))
        return max(float(steps), 1.0) / PACE_STEPS  # a pace of 0 would remain 0

    def corrected(self, times: Array, pace: Pace, core: PlannedAxes) -> CorrectedStretch:
        """Correct the plan at times (k,) a tick apart [s]; raise InputError if out of reach."""
        # The times are padded by one tick on either side, for central differences.
        padded = np.concatenate([times[:1] - TICK, times, times[-1:] + TICK])
        paced = pace.sample(padded)
        plan_times = core.plan_times(paced.motion)
        planned = paced_window(pace, core.sample, padded)
        window = self.window(planned, plan_times, float(paced.rate[0]))
        offset = window.positions[0, JOINT_COLUMNS] - planned.positions[1, JOINT_COLUMNS]
        self._arm_offset = offset
        return CorrectedStretch(window, self.plan.tool(plan_times[1:2])[0])

    def offset(self, planned: Window) -> Window:
        """Return a planned motion (k, 9) whose arm keeps the correction of the last stretch."""
        positions = planned.positions.copy()
        positions[:, JOINT_COLUMNS] += self._arm_offset
        return replace(planned, positions=positions)

    def correct(self, time: float, pose: Array, reference: Array) -> str:
        """Correct the arm for a measured and a planned pose (3,); return any excessive error.

        Args:
            pose: (3,) measured pose of the platform in odom [m, m, rad].
        """
        self.correction.update(time, pose, reference)
        if self.correction.error_ratio <= 1.0:
            return ""
        x, y, theta = self.correction.error
        return f"{math.hypot(x, y):.3f} m and {theta:.3f} rad"

    def window(self, planned: Window, plan_times: Array, rate: float) -> Window:
        """Replace the arm's part of a planned motion by the corrected one.

        Args:
            planned: All axes (k + 2, 9), from a tick before the result to a tick after it.
            plan_times: (k + 2,) times of the plan [s].
            rate: Present pace, 0 to 1.

        Returns:
            The corrected motion (k, 9).
        """
        platform = self.correction.platform_at(
            planned.positions[:, PLATFORM_COLUMNS], planned.times
        )
        tool, near = self.plan.tool(plan_times), planned.positions[:, JOINT_COLUMNS]
        arm = corrected_arm_motion(self._model, platform, tool, self.plan.branch, near, TICK)
        self._joint_pace = joint_speed_pace(arm[1], self._velocity, rate)
        whole = (planned.positions, planned.velocities, planned.accelerations)
        parts = zip(whole, arm, strict=True)
        joined = (np.hstack([rows[1:-1, PLATFORM_COLUMNS], joints]) for rows, joints in parts)
        return Window(planned.times[1:-1], *joined)


class ToolPosePublisher:
    """Publisher of poses of the tool in odom."""

    def __init__(self, node: OmnimanNode, topic: str, frame: str) -> None:
        self._node = node
        self._message = PoseStamped()
        self._message.header.frame_id = frame
        self._publisher = node.create_publisher(PoseStamped, topic, 10)

    def send(self, time: float, pose: Array) -> None:
        """Publish a pose (4, 4) at a time of the node's clock [s]."""
        arm_conversions.fill_pose(self._message.pose, pose)
        self._message.header.stamp = self._node.stamp(time)
        self._publisher.publish(self._message)
