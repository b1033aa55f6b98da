"""Decides whether a robot truly touched an obstacle or left its area during a drive.

The judge shares no code with the planner that it judges. A gap changes by no more than robot and
obstacle travel relative to each other: between two samples, gaps g and h, it is at least
0.5 (g + h - travel). Where this bound does not exclude a contact, there is one. With samples 5 ms
apart and 1.6 m/s, what counts as a contact is at most 4 mm away from one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.lab.studies.scene_gaps import ellipse_gap, outside
from omniman_ros.lab.studies.scene_geometry import Area, Box, Ellipse


@dataclass(frozen=True)
class Verdict:
    """The judge's verdict on a drive; gap and room at the samples."""

    gap: float  # smallest gap [m]; not above zero after a contact, inf with nothing to touch
    contact: float  # time of the first contact [s]; inf without one
    touched: int | None  # index of the obstacle that the robot touched first
    outside: float  # largest distance by which the robot left its area [m]; -inf without one

    @property
    def collided(self) -> bool:
        """Whether the robot touched anything."""
        return self.touched is not None


def relative_travel(
    times: Array, poses: Array, radius: float, speeds: Sequence[float] | Array
) -> Array:
    """Return the travel (K, M) since the beginning of a robot relative to M obstacles [m].

    Args:
        times: (K,) times [s].
        poses: (K, 3) poses [m, m, rad]; headings may be wrapped.
        radius: Distance of the robot's farthest point from base_link [m].
        speeds: (M,) largest speeds of the obstacles [m/s].
    """
    steps = np.abs(np.diff(poses, axis=0))
    turns = np.abs(np.diff(np.unwrap(poses[:, 2])))
    own = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]) + radius * turns)])
    result: Array = own[:, None] + (times - times[0])[:, None] * np.array(speeds)
    return result


def first_contact(times: Array, gaps: Array, travel: Array) -> tuple[float, int | None]:
    """Return time and obstacle of the first contact, from gaps and travel (K, M) [m]."""
    if not gaps.size:
        return math.inf, None
    between = 0.5 * (gaps[1:] + gaps[:-1] - np.diff(travel, axis=0))
    least = gaps.copy()
    least[1:] = np.minimum(least[1:], between)
    rows = np.flatnonzero((least <= 0.0).any(axis=1))
    if not len(rows):
        return math.inf, None
    return float(times[rows[0]]), int(least[rows[0]].argmin())


def judge(
    times: Array, poses: Array, box: Box, obstacles: Sequence[Ellipse], area: Area | None = None
) -> Verdict:
    """Judge a drive, given by its times (K,) [s] and true poses (K, 3) in odom [m, m, rad].

    Args:
        times: (K,) times [s].
        poses: (K, 3) true poses in odom [m, m, rad].
        box: The robot's outline.
        obstacles: What the robot may have touched.
        area: Where its whole outline should stay; leaving it is no contact. None: anywhere.
    """
    count = len(times)
    columns = []
    for each in obstacles:
        axes, angles = np.tile(each.semi_axes, (count, 1)), np.full(count, each.angle)
        columns.append(ellipse_gap(poses, box, each.place.at(times), axes, angles))
    gaps = np.column_stack(columns) if columns else np.zeros((count, 0))
    travel = relative_travel(times, poses, box.radius, [o.place.speed for o in obstacles])
    contact, touched = first_contact(times, gaps, travel)
    beyond = -math.inf if area is None else float(outside(poses, box, area).max())
    least = float(gaps.min(initial=math.inf))
    return Verdict(least if touched is None else min(least, 0.0), contact, touched, beyond)
