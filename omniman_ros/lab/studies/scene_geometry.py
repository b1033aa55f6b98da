"""True shapes of a scene: the robot's box, moving and fixed ellipses, and walls.

Drives are judged by means of these shapes, so they share no code with the planner.
"""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array

Point = tuple[float, float]  # components along x and y of a position [m] or a velocity [m/s]
Area = tuple[float, float, float, float]  # x_min, y_min, x_max, y_max in odom [m]


@dataclass(frozen=True)
class Box:
    """The robot's outline: a rectangle centred at its pose, with its length along its heading."""

    length: float
    width: float

    @property
    def half(self) -> tuple[float, float]:
        """Half length and half width [m]."""
        return 0.5 * self.length, 0.5 * self.width

    @property
    def radius(self) -> float:
        """Distance of the corners from the centre [m]."""
        return math.hypot(*self.half)


@dataclass(frozen=True)
class PolylineMotion:
    """The motion of a point along a polyline, at constant velocity between successive corners.

    The point rests at the first corner before the first time, and moves on at a given velocity
    after the last time.
    """

    times: tuple[float, ...]  # at which the corners are reached [s], increasing
    places: tuple[Point, ...]  # corners in odom [m], one for each time
    velocity: Point = (0.0, 0.0)  # in odom after the last time [m/s]

    @staticmethod
    def still(x: float, y: float) -> "PolylineMotion":
        """Return the motion of a point that rests at (x, y) in odom [m]."""
        return PolylineMotion((0.0,), ((x, y),))

    @staticmethod
    def straight(place: Point, velocity: Point) -> "PolylineMotion":
        """Return a motion at constant velocity from a place in odom on."""
        return PolylineMotion((0.0,), (place,), velocity)

    def __call__(self, now: float) -> Array:
        """Return the position (2,) in odom [m] at the time `now` [s]."""
        result: Array = self.at(np.array([now]))[0]
        return result

    def at(self, times: Array) -> Array:
        """Return the positions (K, 2) in odom [m] at times (K,) [s]."""
        places = np.array(self.places)
        x, y = (np.interp(times, self.times, places[:, i]) for i in (0, 1))
        beyond = np.maximum(times - self.times[-1], 0.0)
        result: Array = np.stack((x + beyond * self.velocity[0], y + beyond * self.velocity[1]), 1)
        return result

    @property
    def speed(self) -> float:
        """Largest speed at any time [m/s]."""
        steps = np.diff(np.array(self.places), axis=0) / np.diff(self.times)[:, None]
        speeds = np.hypot(steps[:, 0], steps[:, 1])
        return float(max(speeds.max(initial=0.0), math.hypot(*self.velocity)))


@dataclass(frozen=True)
class Ellipse:
    """An elliptic obstacle, a disc if its semi-axes are equal; it moves but never turns."""

    semi_axes: tuple[float, float]
    place: PolylineMotion  # motion of its centre
    angle: float = 0.0  # of its first semi-axis in odom [rad]

    @property
    def fixed(self) -> bool:
        """Whether the obstacle never moves."""
        return self.place.speed == 0.0


@dataclass(frozen=True)
class Wall:
    """A wall: a fixed rectangle, given by centre, heading, and size along and across."""

    x: float
    y: float
    heading: float
    length: float
    width: float
