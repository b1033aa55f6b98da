"""Poses of a path as a polyline: headings, repeats, detail, and where a moving robot joins it."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SAME = 1e-6
"""Poses nearer to each other than this share of the tolerance are one."""


def unwrapped(poses: Array, heading: float) -> Array:
    """Poses (k, 3) whose headings go the short way round, from a heading [rad] on."""
    result = np.array(poses, dtype=float)
    result[:, 2] = np.unwrap(np.concatenate([[heading], result[:, 2]]))[1:]
    return result


def along(poses: Array, spread: float) -> Array:
    """Poses (j, 3) whose headings are the direction of travel.

    At each corner the heading turns over `spread` on either side, or over half of a segment that
    is shorter than twice that. A pose that repeats its place is left out.

    Args:
        poses: (k, 3) x, y, theta [m, m, rad]; the headings are replaced, unless all poses are at
            one place.
        spread: [m]; with 0 the robot turns in place at the corner.
    """
    places = poses[:, :2]
    length = np.hypot(*np.diff(places, axis=0).T)
    keep = np.concatenate([[True], length > SAME])
    places = places[keep]
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


def distinct(poses: Array, scale: Array) -> Array:
    """Poses (j, d) without repeats; coordinates are compared after division by scale (d,)."""
    moved = np.abs(np.diff(poses, axis=0) / scale).max(axis=1) > SAME
    kept: Array = poses[np.concatenate([[True], moved])]
    if len(kept) > 1:
        kept[-1] = poses[-1]  # the path ends where it says
    return kept


def simplified(poses: Array, scale: Array) -> Array:
    """Poses (j, d) such that none that was left out is off by more than scale (d,).

    Douglas and Peucker's splitting; a piece that goes back on its way is split, too.
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
    """Index of the inner point that is farthest off the way from the first to the last."""
    chord = points[-1] - points[0]
    offset = points[1:-1] - points[0]
    square = float(chord @ chord)
    along_chord = offset @ chord / square if square > SAME**2 else np.zeros(len(offset))
    off = np.abs(offset - np.clip(along_chord, 0.0, 1.0)[:, None] * chord).max(axis=1)
    back = (np.maximum.accumulate(along_chord) - along_chord) * np.sqrt(square)
    off = np.maximum(off, back)
    worst = int(off.argmax())
    return worst + 1 if off[worst] > 1.0 else None


def joined(poses: Array, place: Array) -> Array:
    """The rest (j, 3) of a path for a robot that is at a place (2,) [m].

    The way from the first pose on is left out for as long as it comes nearer to the robot: a
    robot on the move does not turn back to where the path began.
    """
    for i in range(len(poses) - 1):
        step = poses[i + 1, :2] - poses[i, :2]
        square = float(step @ step)
        if square <= SAME**2:
            continue
        share = float((place - poses[i, :2]) @ step) / square
        if share < 1.0:
            foot = poses[i] + max(share, 0.0) * (poses[i + 1] - poses[i])
            return np.vstack([foot, poses[i + 1 :]])
    return poses[-1:]
