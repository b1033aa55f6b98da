"""True shapes of a scene: the robot's box, moving and fixed ellipses, walls and the allowed area.

Drives are judged by means of these shapes, so they share no code with the planner.
"""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError

Point = tuple[float, float]  # components along x and y of a position [m] or a velocity [m/s]
Area = tuple[float, float, float, float]  # A rectangle x_min, y_min, x_max, y_max in odom [m]


@dataclass(frozen=True)
class Box:
    """The robot's outline: a rectangle centred at its pose, with its length along its heading."""

    length: float  # length [m], above zero
    width: float  # width [m], above zero

    def __post_init__(self) -> None:
        _above_zero("length of the box", self.length)
        _above_zero("width of the box", self.width)

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

    times: tuple[float, ...]  # times at which the corners are reached [s], increasing, one or more
    places: tuple[Point, ...]  # corners (x, y) in odom [m], one for each time
    velocity: Point = (0.0, 0.0)  # velocity (x', y') in odom after the last time [m/s]

    def __post_init__(self) -> None:
        if not self.times or len(self.times) != len(self.places):
            raise InputError(
                f"a polyline motion needs a time for each corner, got {len(self.times)} times "
                f"and {len(self.places)} corners"
            )
        values = np.array([*self.times, *np.ravel(self.places), *self.velocity])
        if not (np.isfinite(values).all() and (np.diff(self.times) > 0.0).all()):
            raise InputError(
                f"a polyline motion needs finite values and increasing times, got {self}"
            )

    @staticmethod
    def still(x: float, y: float) -> "PolylineMotion":
        """Return the motion of a point that rests at (x, y) in odom [m]."""
        return PolylineMotion((0.0,), ((x, y),))

    @staticmethod
    def straight(place: Point, velocity: Point, since: float = 0.0) -> "PolylineMotion":
        """Return a motion at constant velocity.

        Args:
            place: Start (x, y) in odom [m].
        """
        return PolylineMotion((since,), (place,), velocity)

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
    """An elliptic obstacle, a disc if its semi-axes are equal; it moves but never turns.

    Attributes:
        place: Motion of its centre; calling it with a time [s] returns the position (2,) in odom
            [m].
    """

    semi_axes: tuple[float, float]  # semi-axes [m], above zero
    place: PolylineMotion
    angle: float = 0.0  # angle of its first semi-axis in odom [rad]

    def __post_init__(self) -> None:
        for axis in self.semi_axes:
            _above_zero("semi-axis", axis)
        _finite("angle of the ellipse", self.angle)

    @property
    def fixed(self) -> bool:
        """Whether the obstacle never moves."""
        return self.place.speed == 0.0


@dataclass(frozen=True)
class Wall:
    """A wall: a fixed rectangle."""

    x: float  # x of its centre in odom [m]
    y: float  # y of its centre in odom [m]
    heading: float  # direction of its length in odom [rad]
    length: float  # size along its heading [m], above zero
    width: float  # size across its heading [m], above zero

    def __post_init__(self) -> None:
        for name in ("x", "y", "heading"):
            _finite(f"{name} of the wall", getattr(self, name))
        _above_zero("length of the wall", self.length)
        _above_zero("width of the wall", self.width)


@dataclass(frozen=True)
class World:
    """The surroundings of a robot: obstacles, walls, and the area that it should not leave.

    Attributes:
        area: Area within which the robot's whole outline should stay; None if there is no such
            area. Leaving it does not count as a contact.
    """

    obstacles: tuple[Ellipse, ...] = ()  # fixed and moving ellipses
    walls: tuple[Wall, ...] = ()  # walls
    area: Area | None = None

    def __post_init__(self) -> None:
        if self.area is not None:
            low, high = np.array(self.area[:2]), np.array(self.area[2:])
            if not (np.isfinite(self.area).all() and (low < high).all()):
                raise InputError(
                    "the area must be finite with x_min < x_max and y_min < y_max, "
                    f"got {self.area}"
                )


def _above_zero(name: str, value: float) -> None:
    """Raise an InputError unless a length [m] is above zero and finite."""
    if not 0.0 < value < math.inf:
        raise InputError(f"{name} must be above zero and finite, got {value} m")


def _finite(name: str, value: float) -> None:
    """Raise an InputError unless a value is finite."""
    if not math.isfinite(value):
        raise InputError(f"{name} must be finite, got {value}")
