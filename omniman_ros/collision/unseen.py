"""Limit of the speed at which the robot comes to rest before somebody who steps out of the unseen.

The rule is that of passive safety: at a contact, the robot is at rest. It is kept against
everybody whom nobody sees, wherever they could be and whatever they do up to their speed
(K. Macek, D. Vasquez, T. Fraichard and R. Siegwart, "Towards Safe Vehicle Navigation in Dynamic
Urban Scenarios", Automatika 2009).
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.curve import curve_poses
from omniman_ros.collision.parameters import PersonShape
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.collision.upright_obstacles import Mask
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.validated import Validated

STEPS = 24  #: Number of intervals into which a stop from full speed is divided
LEVELS = np.linspace(0.02, 1.0, 50)  #: Fractions of full speed that are tried
MOST_CELLS = 1_000_000  #: Largest number of cells


@dataclass(frozen=True)
class Arrivals(Validated):
    """How soon an occluded pedestrian could be where.

    Raises:
        InputError: There are no cells or too many, a time is negative or NaN, or a length is not
            finite or not above zero.
    """

    #: (rows along y, columns along x) time in which somebody's centre could be in a cell [s];
    #: infinity where nobody can be soon.
    times: Annotated[Array, Shape("rows", "columns", low=0.0, unit="s", finite=False)]
    resolution: float  #: Edge of a cell [m]
    #: (2,) corner of the first cell in the frame of the robot's pose [m]
    origin: Annotated[Array, Shape(2)]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.times.size <= MOST_CELLS:
            raise InputError(f"the times have shape {self.times.shape}, expected rows and columns")
        if np.isnan(self.times).any():
            raise InputError("a time is not a number")
        if not self.resolution > 0.0:
            raise InputError(f"the resolution {self.resolution} m must be above 0")

    def after(self, time: float) -> "Arrivals":
        """Return the times from another time on, up to which nothing more was seen [s]."""
        return replace(self, times=np.maximum(self.times - time, 0.0))

    def before(self, time: float, position: Array, distance: float) -> tuple[Array, Array]:
        """Return the middles (M, 2) and times (M,) of cells where somebody could be soon.

        The cells are within a distance [m] of a place along either axis, and up to a time [s].
        """
        spans = []
        for k, count in ((1, self.times.shape[0]), (0, self.times.shape[1])):
            first = (position[k] - distance - self.origin[k]) / self.resolution
            last = (position[k] + distance - self.origin[k]) / self.resolution
            low, high = np.clip((math.floor(first), math.ceil(last)), 0, count).tolist()
            spans.append(slice(low, high))
        window = self.times[spans[0], spans[1]]
        rows, columns = np.nonzero(window <= time)
        index = np.column_stack((columns + spans[1].start, rows + spans[0].start))
        middles: Array = self.origin + self.resolution * (index + 0.5)
        return middles, window[rows, columns]


@dataclass(frozen=True, kw_only=True)
class UnseenLimitParameters(Validated):
    """Whether and how the speed respects what no scanner sees."""

    use: bool = parameter(
        False,
        "Whether the robot comes to rest before anybody who may step out from where no scanner "
        "sees, by the topic unseen of obstacle_tracker, whose unseen.speed must be above 0 then.",
    )
    person: PersonShape = inline()
    creep_speed: float = parameter(
        0.1,
        "Share of the speed limits that is left at least, such as for motions to where no scanner "
        "sees; 0: these are refused.",
        low=0.0,
        high=1.0,
    )
    timeout: float = parameter(
        0.5, "Age from which unseen is too old.", unit="s", low=0.05, high=10.0
    )


@dataclass(frozen=True)
class OcclusionLimit(Validated):
    """Fraction of the speed limits, 0 to 1, and the position (2,) it is for; None without one."""

    fraction: float = 1.0
    position: Annotated[Array | None, Shape(2)] = None


def unseen_limit(
    arrivals: Arrivals,
    outline: Rectangles,
    pose: Array,
    courses: list[tuple[Array, float]],
    radius: float,
    reaction_time: float,
) -> OcclusionLimit:
    """Return the largest fraction of full speed from which the robot stops before anybody unseen.

    In a stop from the share s of full speed, which takes the time B from full speed, the robot
    goes on for the reaction time T. It gets as far on its curve as in s T + s^2 B / 2 at full
    speed. A place of the curve in the time tau at full speed is reached by then in tau / s, or
    later, while the robot brakes, in T + B (s - sqrt(s^2 - 2 (tau - s T) / B)). Somebody must not
    be there before the robot. Who comes from the side or from behind to where the robot is already
    comes to it, and not the robot to them.

    The pose (3,) is in the frame of the arrivals [m, m, rad]. Courses are twists (3,) at full
    speed [m/s, m/s, rad/s], each with the time B [s]; people have a radius [m].
    """
    result = OcclusionLimit()
    for twist, stop_time in courses:
        taus = (reaction_time + 0.5 * stop_time) * np.arange(STEPS + 1.0) / STEPS
        far = float(outline.radius.max()) + radius + taus[-1] * math.hypot(twist[0], twist[1])
        positions, times = arrivals.before(reaction_time + stop_time, pose, far)
        first = _first_samples(outline, curve_poses(pose, twist, taus), positions, radius)
        swept = first > 0
        conflict = _conflicts(taus, first[swept], times[swept], stop_time, reaction_time)
        is_bad = conflict.any(axis=1)
        if not is_bad.any():
            continue
        level = int(is_bad.argmax())
        position = positions[swept][int(conflict[level].argmax())]
        found = OcclusionLimit(float(LEVELS[level - 1]) if level else 0.0, position)
        result = min(result, found, key=lambda limit: limit.fraction)
    return result


def _first_samples(
    outline: Rectangles, poses: Array, positions: Array, radius: float
) -> NDArray[np.intp]:
    """Return the number (M,) of the first pose at which the robot touches somebody in a place.

    It is 0 also for those whom it never touches.
    """
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    x, y = (positions[:, k] - poses[:, k, None] for k in (0, 1))
    local = np.stack((c * x + s * y, c * y - s * x), axis=-1)
    first: NDArray[np.intp] = (outline.distances(local) <= radius).argmax(axis=0)
    return first


def _conflicts(
    taus: Array, first: NDArray[np.intp], times: Array, stop_time: float, reaction: float
) -> Mask:
    """Return whether somebody is in a place before the robot, for each share (L, M).

    At full speed the robot first comes to the places at the samples `first` (M,), above 0, of the
    times `taus` (K,) [s]; somebody can be there at `times` (M,) [s].
    """
    # The robot may come to a place right after the sample before, and at the latest at this one.
    way = LEVELS * reaction + 0.5 * LEVELS**2 * stop_time
    reached = _stopping_times(taus[first], stop_time, reaction)
    conflict: Mask = (taus[first - 1] < way[:, None]) & (times < reached)
    return conflict


def _stopping_times(taus: Array, stop_time: float, reaction: float) -> Array:
    """Return when the robot is in places while it stops from fractions of full speed (L, M) [s].

    At full speed it is there at `taus` (M,) [s]; beyond the way of a stop, its end counts.
    """
    fraction = LEVELS[:, None]
    rest = np.maximum(taus - fraction * reaction, 0.0)
    scale = max(stop_time, 1e-9)
    speed = np.sqrt(np.maximum(fraction * fraction - 2.0 * rest / scale, 0.0))
    result: Array = np.where(
        taus <= fraction * reaction, taus / fraction, reaction + scale * (fraction - speed)
    )
    return result
