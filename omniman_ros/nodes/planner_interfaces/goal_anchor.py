"""The goal in its own frame, which may move against odom while the robot drives to it."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.errors import InputError
from omniman_ros.core.rigid import PlanarPose
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.planning.cycle import MeasuredState
from omniman_ros.planning.goals import Goal
from omniman_ros.surroundings.ellipses import Ellipses

if TYPE_CHECKING:  # needs casadi, which is optional
    from omniman_ros.planning.planner import Planner

LEAST_SHIFT = 5e-4  #: Distance by which a goal must have moved to be moved for the planner [m]
MIN_ROTATION = 5e-4  #: Angle by which a goal must have turned to be turned for the planner [rad]


@dataclass(frozen=True)
class PlacedGoal:
    """A goal in a frame that does not move with the robot."""

    frame: str  #: The frame; empty for odom
    goal: Goal  #: Goal in that frame


class GoalAnchor:
    """Gives the planner goals in odom, and moves them when their frame moves against odom."""

    def __init__(self, planner: "Planner", frames: FrameTransforms) -> None:
        self._planner, self._frames = planner, frames
        self._frame = ""
        self._anchor: PlanarPose = (0.0, 0.0, 0.0)

    def drive(self, placed: PlacedGoal, measured: MeasuredState, obstacles: Ellipses) -> None:
        """Drive to a goal; raise InputError if it is occupied, or unknown in odom."""
        silence = self._frames.silence_reason(placed.frame)
        if silence:
            raise InputError(silence)
        anchor = self._frames.anchor(placed.frame).planar()
        self._planner.drive(placed.goal.displaced(anchor), measured, obstacles)
        self._frame, self._anchor = placed.frame, anchor

    def silence_reason(self) -> str:
        """Return why it is not known where the goal is in odom, or an empty string."""
        return "" if self._planner.goal is None else self._frames.silence_reason(self._frame)

    def update(self, now: float, obstacles: Ellipses) -> None:
        """Move the goal if its frame has moved against odom."""
        goal = self._planner.goal
        if goal is None or not self._frame:
            return
        anchor = self._frames.anchor(self._frame).planar()
        if anchor == self._anchor:
            return
        x, y, theta = goal.targets(np.array([now]))[0][0].tolist()
        dx, dy, turn = se2.displacement(self._anchor, anchor, (x, y, theta))
        if math.hypot(dx, dy) > LEAST_SHIFT or abs(turn) > MIN_ROTATION:
            change = se2.compose(anchor, se2.inverse(self._anchor))
            self._anchor = anchor
            self._planner.displace_goal(change, now, obstacles)
