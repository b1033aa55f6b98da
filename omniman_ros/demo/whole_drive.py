"""Figures of the whole demo that belong to no single leg: odometry, energy, timing, contacts."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.demo.limits import Bound, Limit
from omniman_ros.demo.recorder import Recording
from omniman_ros.demo.tracking import wrap_angle

WHOLE_DRIVE_LIMITS = (
    Limit("contacts.count", "things that the robot touched", 0.0),
    Limit("odometry.position_mm", "odometry position, mm", 100.0),
    Limit("odometry.heading_deg", "odometry heading, deg", 6.0),
    Limit("timing.odom.rate_hz", "odom rate, Hz", 80.0, Bound.AT_LEAST),
    Limit("timing.wheel_commands.rate_hz", "wheel_commands rate, Hz", 160.0, Bound.AT_LEAST),
)
"""Limits of the figures of the whole demo."""


def whole_drive_figures(recording: Recording) -> dict[str, Any]:
    """Return odometry's drift, the energy of the motors, timing and, in a world, contacts."""
    energy = np.array(recording.energy)
    consumed = energy[-1] - energy[0]
    touched = recording.contacts
    contacts = {} if touched is None else {"contacts": {"count": len(touched), "with": touched}}
    return {
        **contacts,
        "odometry": drift_figures(np.array(recording.odom), np.array(recording.truth)),
        "energy": {"total_j": float(consumed.sum()), "wheels_j": consumed.tolist()},
        "timing": {
            "odom": interval_figures([row[0] for row in recording.odom]),
            "wheel_commands": interval_figures(recording.commands),
            "stall_ms": 1e3 * recording.stall,
        },
    }


def drift_figures(odom: Array, truth: Array) -> dict[str, Any]:
    """Return odometry's error at the end, relative to its start, and the true travel.

    Args:
        odom: Rows of `Recording.odom`.
        truth: Rows of `Recording.truth`.
    """
    measured, true = _relative_motion(odom[:, 1:4]), _relative_motion(truth[:, 1:4])
    steps = np.diff(truth[:, 1:4], axis=0)
    return {
        "position_mm": 1e3 * float(np.hypot(*(measured[:2] - true[:2]))),
        "heading_deg": math.degrees(abs(float(wrap_angle(measured[2] - true[2])))),
        "travel_m": float(np.hypot(steps[:, 0], steps[:, 1]).sum()),
        "turn_rad": float(np.abs(wrap_angle(steps[:, 2])).sum()),
    }


def interval_figures(times: Sequence[float]) -> dict[str, float]:
    """Return the mean rate of a topic, and its intervals, from the times of messages [s]."""
    intervals_ms = 1e3 * np.diff(np.array(times))
    return {
        "rate_hz": 1e3 / float(intervals_ms.mean()),
        "p50_ms": float(np.percentile(intervals_ms, 50)),
        "p99_ms": float(np.percentile(intervals_ms, 99)),
        "max_ms": float(intervals_ms.max()),
    }


def _relative_motion(poses: Array) -> Array:
    """Return the last of the poses (k, 3) in the frame of the first [m, m, rad]."""
    x, y, angle = poses[-1] - poses[0]
    cosine, sine = math.cos(poses[0, 2]), math.sin(poses[0, 2])
    return np.array([cosine * x + sine * y, cosine * y - sine * x, angle])
