"""Poses of a path as a polyline: headings, repeated poses, detail, and joining it on the move."""

import math

import numpy as np

from omniman_ros.core import round_off, se2
from omniman_ros.core.arrays import Array

REPEAT_TOLERANCE = 1e-6  #: Distance up to which poses count as repeated, relative to the tolerance


def unwrap_headings(poses: Array, heading: float) -> Array:
    """Return poses (k, 3) whose headings change by at most pi, from a first heading [rad] on."""
    result = np.array(poses, dtype=float)
    result[:, 2] = se2.nearest_turns(result[:, 2], heading)
    return result


def headings_along(poses: Array, spread: float) -> Array:
    """Return poses (j, 3) whose headings are the direction of travel.

    At each corner the heading changes over the distance `spread` on either side, or over half of a
    segment that is shorter than twice that. A pose that repeats its position is left out.

    Args:
        poses: (k, 3) x, y, theta [m, m, rad]; the headings are replaced, unless all poses are at
            one position.
        spread: Distance [m]; with 0 the robot rotates in place at the corner.
    """
    places = _separate(poses[:, :2])
    if len(places) < 2:
        return poses
    step = np.diff(places, axis=0)
    length = np.hypot(*step.T)
    direction = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    reach = np.minimum(spread, 0.5 * length)
    unit = step / length[:, None]
    before = np.column_stack([places[:-1] + unit * reach[:, None], direction])
    after = np.column_stack([places[1:] - unit * reach[:, None], direction])
    rows = np.stack([before, after], axis=1).reshape(-1, 3)
    rows[0, :2], rows[-1, :2] = places[0], places[-1]
    return rows


def _separate(places: Array) -> Array:
    rows = places.tolist()
    kept = rows[:1]
    for x, y in rows[1:]:
        if math.hypot(x - kept[-1][0], y - kept[-1][1]) > round_off.SAME_POSITION:
            kept.append([x, y])
    if len(kept) > 1:
        kept[-1] = rows[-1]  # the path ends exactly at its last pose
    return np.array(kept)


def remove_repeats(poses: Array, scale: Array) -> Array:
    """Return poses (j, d) without repeats; coordinates are compared relative to a scale (d,)."""
    moved = np.abs(np.diff(poses, axis=0) / scale).max(axis=1) > REPEAT_TOLERANCE
    kept: Array = poses[np.concatenate([[True], moved])]
    if len(kept) > 1:
        kept[-1] = poses[-1]  # the path ends exactly at its last pose
    return kept


def simplify(poses: Array, scale: Array) -> Array:
    """Return poses (j, d) such that no omitted pose is off by more than a scale (d,).

    This is the algorithm of Douglas and Peucker, which here also splits pieces that go backwards.
    """
    points = poses / scale
    keep = np.zeros(len(points), dtype=bool)
    keep[[0, -1]] = True
    pieces = [(0, len(points) - 1)]
    while pieces:
        first, last = pieces.pop()
        if last - first < 2:
            continue
        split = _worst(points[first : last + 1])
        if split is not None:
            middle = first + split
            keep[middle] = True
            pieces += [(first, middle), (middle, last)]
    return poses[keep]


def _worst(points: Array) -> int | None:
    chord = points[-1] - points[0]
    offset = points[1:-1] - points[0]
    square = float(chord @ chord)
    along_chord = (
        offset @ chord / square if square > REPEAT_TOLERANCE**2 else np.zeros(len(offset))
    )
    distance = np.abs(offset - np.clip(along_chord, 0.0, 1.0)[:, None] * chord).max(axis=1)
    backwards = (np.maximum.accumulate(along_chord) - along_chord) * np.sqrt(square)
    distance = np.maximum(distance, backwards)
    worst = int(distance.argmax())
    return worst + 1 if distance[worst] > 1.0 else None


def remaining_path(poses: Array, position: Array) -> Array:
    """Return the rest (j, 3) of a path for a robot at a position (2,) [m].

    The path is left out from its first pose on for as long as it approaches the robot, so that a
    robot on the move does not turn back to the start of the path.
    """
    for i in range(len(poses) - 1):
        step = poses[i + 1, :2] - poses[i, :2]
        square = float(step @ step)
        if square <= REPEAT_TOLERANCE**2:
            continue
        fraction = float((position - poses[i, :2]) @ step) / square
        if fraction < 1.0:
            foot = poses[i] + max(fraction, 0.0) * (poses[i + 1] - poses[i])
            return np.vstack([foot, poses[i + 1 :]])
    return poses[-1:]
