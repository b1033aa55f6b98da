"""The demo's emergency stop: pressed while platform and arm move, and a twist is asked for."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.cli.recorder import Recording

Array = NDArray[np.float64]

DRIVEN, HELD, WATCHED = 1.2, 1.5, 1.0
"""How long it drives before, stays stopped, and is watched after the reset [s]."""
SWING, SWINGING = np.array([0.9, 0.0, 0.0, 0.0, 0.0, 1.2]), 3.0
"""What the arm is turned by meanwhile [rad], and how long that would take [s]."""
RATE_AT_REST = 0.01
"""Speed below which platform and arm count as at rest [m/s, rad/s]."""
ARM_STEP = 0.05
"""Over which the arm's speed is taken from its angles [s]."""


@dataclass(frozen=True)
class DrivenStop:
    """An emergency stop, in ROS time [s].

    Attributes:
        pressed: When it was pressed.
        reset: When the reset was answered.
        end: Until when the robot was watched.
    """

    pressed: float
    reset: float
    end: float


def figures(recording: Recording, driven: DrivenStop) -> dict[str, Any]:
    """How fast the robot was, how soon and how far on it stood, and what moved after the reset.

    All from what odometry and the arm have measured.
    """
    odom, arm = np.array(recording.odom), np.array(recording.arm)
    result: dict[str, Any] = {}
    speeds = np.hypot(odom[:, 4], odom[:, 5]) + np.abs(odom[:, 6])
    result["speed_m_s"], result["rest_s"] = _until_rest(odom[:, 0], speeds, driven)
    stopping = odom[(odom[:, 0] >= driven.pressed) & (odom[:, 0] <= driven.reset)]
    result["way_mm"] = 1e3 * float(np.hypot(*np.diff(stopping[:, 1:3], axis=0).T).sum())
    after = odom[(odom[:, 0] > driven.reset) & (odom[:, 0] <= driven.end)]
    moved = np.hypot(*(after[:, 1:3] - after[0, 1:3]).T).max() if len(after) else math.inf
    result["moved_mm"] = 1e3 * float(moved)
    if len(arm):
        before = np.column_stack(
            [np.interp(arm[:, 0] - ARM_STEP, arm[:, 0], joint) for joint in arm[:, 1:].T]
        )
        rates = np.abs(arm[:, 1:] - before).max(axis=1) / ARM_STEP
        result["arm_rate_rad_s"], result["arm_rest_s"] = _until_rest(arm[:, 0], rates, driven)
        later = arm[(arm[:, 0] > driven.reset) & (arm[:, 0] <= driven.end), 1:]
        moved = np.abs(later - later[0]).max() if len(later) else math.inf
        result["arm_moved_mrad"] = 1e3 * float(moved)
    return result


def _until_rest(times: Array, speeds: Array, driven: DrivenStop) -> tuple[float, float]:
    """Speed when it was pressed, and time from then to rest [s]; infinite if it never rested."""
    before, during = times < driven.pressed, (times >= driven.pressed) & (times <= driven.reset)
    stamps, falling = times[during], speeds[during]
    if not before.any() or not len(stamps) or falling[-1] > RATE_AT_REST:
        return math.nan, math.inf
    moving = np.flatnonzero(falling > RATE_AT_REST)
    rest = float(stamps[moving[-1]] - driven.pressed) if len(moving) else 0.0
    return float(speeds[before][-1]), rest
