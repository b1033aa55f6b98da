"""Figures of a robot that was led along a path of its tool, from its recording."""

from collections.abc import Sequence

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.lab.measurement import columns_at, spread_ms
from omniman_ros.lab.studies.running_body import ENDS, BodyRecording
from omniman_ros.motion.whole_body.model import WholeBodyModel

REST_SPEEDS = 0.005, 0.005  #: Speeds below which platform [m/s] and joints [rad/s] rest
REST_TIME = 0.3  #: Time for which the robot must be slow to be at rest [s]
LEAST_GAP_OF_TIME = 0.012  #: Least time between poses whose difference gives a speed [s]


def outcome(recording: BodyRecording) -> dict[str, str]:
    """Return what became of the path, by the keys of `motion_events`."""
    end = recording.event(*ENDS)
    result = "not_there" if end is None else "completed" if end[1] == "arrived" else end[1]
    return {"outcome": result}


def span(recording: BodyRecording, limit: float) -> tuple[float, float] | None:
    """Return the times at which the motion started and ended, if it did start [s]."""
    started, end = recording.event("started"), recording.event(*ENDS)
    if started is None:
        return None
    return started[0], end[0] if end else started[0] + limit


def tool_positions(recording: BodyRecording, model: WholeBodyModel) -> Array:
    """Return times and measured positions of the tool in odom (n, 4), by odom and joints."""
    odom, joints = np.array(recording.odom), np.array(recording.joints)
    times = odom[(odom[:, 0] >= joints[0, 0]) & (odom[:, 0] <= joints[-1, 0]), 0]
    at = np.column_stack([times, columns_at(odom, times), columns_at(joints, times)])
    return np.column_stack([times, model.forward(at[:, 1:])[:, :3, 3]])


def between(rows: Array, begin: float, end: float) -> Array:
    """Return the rows whose first column, the time, lies in a span."""
    return rows[(rows[:, 0] >= begin) & (rows[:, 0] <= end)]


def distances_to_curve(points: Array, curve: Array) -> Array:
    """Return the distances (n,) of points (n, 3) from a polyline (k, 3) [m]."""
    squares = ((points[:, None] - curve[None]) ** 2).sum(axis=2)
    nearest = np.clip(squares.argmin(axis=1), 1, len(curve) - 2)
    result = np.full(len(points), np.inf)
    for first in (nearest - 1, nearest):
        start, along = curve[first], curve[first + 1] - curve[first]
        offset, length = points - start, (along**2).sum(axis=1)
        share = np.clip((offset * along).sum(axis=1) / np.maximum(length, 1e-18), 0.0, 1.0)
        off = np.linalg.norm(offset - share[:, None] * along, axis=1)
        result = np.minimum(result, off)
    return result


def tool_errors(tool: Array, references: Sequence[Array], curve: Array) -> dict[str, float]:
    """Return root mean square and maximum of the tool's errors [mm].

    Args:
        tool: Times and measured positions (n, 4).
        references: Times and positions (4,) of `tool_reference`.
        curve: (k, 3) positions along the path.
    """
    table = _by_time(references)
    inside = between(tool, table[0, 0], table[-1, 0])
    due = columns_at(table, inside[:, 0])
    off = np.linalg.norm(inside[:, 1:] - due, axis=1)
    from_curve = distances_to_curve(tool[:, 1:], curve)
    result = {}
    for name, errors in (("path", from_curve), ("reference", off)):
        result[f"{name}_rms_mm"] = 1e3 * float(np.sqrt((errors**2).mean()))
        result[f"{name}_max_mm"] = 1e3 * float(errors.max())
    return result


def largest_accelerations(recording: BodyRecording) -> dict[str, float]:
    """Return the largest accelerations in the references: of the tool and of any joint."""
    rows = _by_time(recording.references)
    kept = [0]
    for k in range(1, len(rows)):
        if rows[k, 0] - rows[kept[-1], 0] >= LEAST_GAP_OF_TIME:
            kept.append(k)
    rows = rows[kept]
    steps = np.diff(rows[:, 0])
    speeds = np.diff(rows[:, 1:], axis=0) / steps[:, None]
    rates = np.diff(speeds, axis=0) / (0.5 * (steps[1:] + steps[:-1]))[:, None]
    joints = np.array(recording.accelerations)[:, 1:]
    return {
        "tool_acceleration": float(np.linalg.norm(rates, axis=1).max()),
        "joint_acceleration": float(joints.max()),
    }


def cycle_figures(recording: BodyRecording, begin: float, end: float) -> dict[str, float]:
    """Return the CPU time of the planner's process between two messages on `body/status` [ms].

    That is a cycle with all that the process does meanwhile: corrections of the arm, searches.
    """
    rows = between(np.array(recording.cycles), begin, end)
    return spread_ms(np.diff(rows[:, 1]).tolist())


def rest_time(recording: BodyRecording, since: float) -> float | None:
    """Return the time after an instant at which platform and arm are at rest, if they are [s]."""
    rests = []
    for rows, bound in zip((recording.truth, recording.true_joints), REST_SPEEDS, strict=True):
        table = between(np.array(rows), since, np.inf)
        moves = np.flatnonzero(table[:, -1] > bound)
        last = table[moves[-1], 0] if len(moves) else since
        if not len(table) or table[-1, 0] - last < REST_TIME:
            return None
        rests.append(float(last))
    return max(rests) - since


def movement(recording: BodyRecording, since: float) -> dict[str, float]:
    """Return how far platform [mm] and joints [mrad] have truly moved since an instant."""
    platform = between(np.array(recording.truth), since, np.inf)
    joints = between(np.array(recording.true_joints), since, np.inf)
    moved = np.linalg.norm(platform[:, 1:3] - platform[0, 1:3], axis=1).max()
    turned = np.abs(joints[:, 1:7] - joints[0, 1:7]).max()
    return {"platform_mm": 1e3 * float(moved), "joints_mrad": 1e3 * float(turned)}


def _by_time(rows: Sequence[Array]) -> Array:
    """Return rows in the order of their times; of those of one time, the last."""
    return np.array([row for _, row in sorted({float(row[0]): row for row in rows}.items())])
