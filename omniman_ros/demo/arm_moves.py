"""Moves of the arm during the demo, and the errors with which it followed its reference."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.demo.limits import Limit
from omniman_ros.demo.recorder import Recording
from omniman_ros.demo.tracking import rms
from omniman_ros.demo.whole_drive import interval_figures

SETTLING_TIME = 1.0
"""Time after the start of a move from which on its errors are measured [s]."""
LAGS = np.arange(-0.1, 0.2, 0.002)
"""Candidates for the lag of the arm behind its reference [s]."""
ARM_LIMITS = (
    Limit("arm.final_mrad", "arm final position, mrad", 3.0),
    Limit("arm.lag_ms", "arm behind its reference, ms", 100.0),
    Limit("arm.rms_mrad", "arm off its path, mrad", 10.0),
)
"""Limits of the figures of `arm_figures`."""


@dataclass(frozen=True)
class ArmMove:
    """A move of the arm to joint angles.

    Attributes:
        goal: Joint angles at the end of the move [rad].
        start: ROS time at which the move was sent [s].
        end: ROS time until which the move is measured [s].
    """

    goal: tuple[float, ...]
    start: float
    end: float = math.nan


def arm_figures(recording: Recording, moves: Sequence[ArmMove]) -> dict[str, Any]:
    """Return the lag and the errors of the arm behind its reference, and where it came to rest.

    The servo of the arm's controller lags. The lag is the delay at which the measured angles fit
    the reference best; the error is the remaining difference. Each figure is that of the worst
    joint or, as RMS, of all joints.

    Args:
        recording: What the robot published.
        moves: Moves of the arm.
    """
    measured = np.array(recording.arm)
    reference = np.array(recording.arm_reference).reshape(-1, measured.shape[1])
    reference = reference[np.argsort(reference[:, 0], kind="stable")]
    is_moving = np.zeros(len(measured), dtype=bool)
    final_errors = []
    for move in moves:
        is_moving |= (measured[:, 0] >= move.start + SETTLING_TIME) & (measured[:, 0] <= move.end)
        last = measured[measured[:, 0] <= move.end][-1, 1:]
        final_errors.append(float(np.abs(last - np.array(move.goal)).max()))
    rows = measured[is_moving]

    def error(lag: float) -> Array:
        columns = [
            np.interp(rows[:, 0] - lag, reference[:, 0], reference[:, k])
            for k in range(1, reference.shape[1])
        ]
        result: Array = rows[:, 1:] - np.column_stack(columns)
        return result

    lag = float(LAGS[int(np.argmin([rms(error(delay)) for delay in LAGS]))])
    travel = np.abs(np.diff(rows[:, 1:], axis=0)).sum(axis=0)
    return {
        "moves": len(moves),
        "travel_rad": float(travel.max()),
        "final_mrad": 1e3 * max(final_errors),
        "lag_ms": 1e3 * lag,
        "rms_mrad": 1e3 * rms(error(lag)),
        "setpoints": interval_figures(np.cumsum(recording.arm_intervals).tolist()),
    }
