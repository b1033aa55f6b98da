"""Path of CCTA 2017 V.C and Fig. 7, and its motion in time.

The paper: "The platform moves a path with straight lines forwards, sideways and backwards. After
that, it moves a circular path with two rotations back to the starting point. [...] The five
movements of the platform [...] can be easily distinguished." Sizes are not given. The
path is interpreted as follows:

* movements 1 to 3: forwards, sideways to the left, backwards, `length` each, heading 0: the
  platform stands at (0, length);
* movements 4 and 5: the circle whose diameter is the way back, from (0, length) to (0, 0). The
  platform drives round it one and a half times, counter-clockwise, so that it completes a whole
  circle and ends at the starting point. Meanwhile it rotates about its own centre twice,
  counter-clockwise: once in each movement, over three quarters of the circle. Heading and
  direction of travel diverge, so that the platform moves in all directions of its own frame.

Each movement is from rest to rest.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.preview import Preview

Pose = tuple[float, float, float]  #: Pose x, y, theta [m, m, rad]

LENGTH = 1.2  #: Length of a straight line, and diameter of the circle [m]
SAMPLE_PERIOD = 0.02  #: Time between two points of a preview, which are connected by quintics [s]


@dataclass(frozen=True)
class Movement:
    """A line or an arc along which the heading changes at a constant rate by path length."""

    name: str  #: Name for display
    start: Pose  #: Pose at the start [m, m, rad]
    length: float  #: Path length [m]
    course: float  #: Direction of travel at the start, in the world [rad]
    curvature: float = 0.0  #: Curvature, 0 for a line [rad/m]
    rotation: float = 0.0  #: Change of the heading over the whole length [rad]

    def at(self, distance: Array) -> tuple[Array, Array, Array]:
        """Return poses and two derivatives by path length (k, 3), at path lengths (k,) [m]."""
        x, y, heading = self.start
        course = self.course + self.curvature * distance
        c, s = np.cos(course), np.sin(course)
        # The chord of an arc, exact for a line too: np.sinc(x) is sin(pi x) / (pi x).
        chord = distance * np.sinc(self.curvature * distance / (2 * math.pi))
        middle = self.course + 0.5 * self.curvature * distance
        rate = np.full_like(distance, self.rotation / self.length)
        pose = np.column_stack(
            [x + chord * np.cos(middle), y + chord * np.sin(middle), heading + rate * distance]
        )
        slope = np.column_stack([c, s, rate])
        second = self.curvature * np.column_stack([-s, c, np.zeros_like(distance)])
        return pose, slope, second

    @property
    def end(self) -> Pose:
        """Pose at the end [m, m, rad]."""
        x, y, heading = self.at(np.array([self.length]))[0][0].tolist()
        return x, y, heading


def movements(length: float = LENGTH) -> tuple[Movement, ...]:
    """Return the five movements, for straight lines of a length [m]."""
    quarter, full = 0.5 * math.pi, 2 * math.pi
    arc, curvature = 0.75 * math.pi * length, 2.0 / length
    first = Movement("forwards", (0.0, 0.0, 0.0), length, 0.0)
    second = Movement("sideways", (length, 0.0, 0.0), length, quarter)
    third = Movement("backwards", (length, length, 0.0), length, 2 * quarter)
    fourth = Movement("circle 1", (0.0, length, 0.0), arc, 2 * quarter, curvature, full)
    fifth = Movement("circle 2", fourth.end, arc, 5 * quarter, curvature, full)
    return first, second, third, fourth, fifth


def waypoints(spacing: float, length: float = LENGTH) -> Array:
    """Return poses (k, 3) along the path [m, m, rad], at most `spacing` m apart.

    The headings are unwrapped.

    Raises:
        InputError: The spacing is not above 0.
    """
    if not spacing > 0.0:
        raise InputError(f"spacing of waypoints must be above 0 m, got {spacing:g}")
    rows = [np.zeros((1, 3))]
    for movement in movements(length):
        steps = max(math.ceil(movement.length / spacing - 1e-9), 1)
        distance = np.linspace(0.0, movement.length, steps + 1)[1:]
        rows.append(movement.at(distance)[0])
    return np.vstack(rows)


@dataclass(frozen=True)
class TimeLaw:
    """Motion from rest to a constant speed and back, with ramps 10 u^3 - 15 u^4 + 6 u^5."""

    speed: float = 0.4  #: Constant speed [m/s]
    #: Time from rest to speed [s]; the largest acceleration is 1.875 speed / ramp
    ramp: float = 1.5

    def duration(self, length: float) -> float:
        """Return the duration of a movement over a length [m].

        Raises:
            InputError: The length is too short to reach the speed.
        """
        if length < self.speed * self.ramp:
            raise InputError(
                f"{length:g} m are too short to reach {self.speed:g} m/s in {self.ramp:g} s"
            )
        return length / self.speed + self.ramp

    def at(self, time: Array, length: float) -> tuple[Array, Array, Array]:
        """Return path length, speed and acceleration at times (k,) since the start [m, s]."""
        up = np.clip(time / self.ramp, 0.0, 1.0)
        down = np.clip((self.duration(length) - time) / self.ramp, 0.0, 1.0)
        # Integrals of the ramps: of the first so far, and of the part of the last that is left.
        up_integral = up**4 * (2.5 - 3 * up + up**2)
        down_integral = down**4 * (2.5 - 3 * down + down**2)
        cruise = np.clip(time, self.ramp, length / self.speed) - self.ramp
        distance = self.speed * (self.ramp * (up_integral + 0.5 - down_integral) + cruise)
        speed = self.speed * _smooth(np.minimum(up, down))
        slope = 30 * (up**2 * (1 - up) ** 2 - down**2 * (1 - down) ** 2)
        return distance, speed, self.speed / self.ramp * slope


def _smooth(u: Array) -> Array:
    """Return the ramp 10 u^3 - 15 u^4 + 6 u^5, which rises from 0 to 1."""
    smooth: Array = u**3 * (10 - 15 * u + 6 * u**2)
    return smooth


@dataclass(frozen=True)
class Figure7Segment:
    """A movement in time, as the platform controller accepts it."""

    name: str  #: Name for display
    begin: float  #: Time of the start [s]
    preview: Preview  #: Motion from that time on


@dataclass(frozen=True)
class Figure7:
    """The path in time, which is the same for all controllers that drive it."""

    length: float = LENGTH  #: Length of a straight line, and diameter of the circle [m]
    law: TimeLaw = field(default_factory=TimeLaw)  #: Time law of each movement
    rest: float = 0.5  #: Time at rest before, between and after the movements [s]

    @property
    def duration(self) -> float:
        """Duration with the rests before the first and after the last movement [s]."""
        times = [self.law.duration(movement.length) for movement in movements(self.length)]
        return sum(times) + self.rest * (len(times) + 1)

    def legs(self, start: float) -> Sequence[Figure7Segment]:
        """Return the movements from a time `start` [s] on, as previews in the start's frame."""
        legs, begin = [], start + self.rest
        for movement in movements(self.length):
            duration = self.law.duration(movement.length)
            legs.append(
                Figure7Segment(movement.name, begin, self._preview(movement, begin, duration))
            )
            begin += duration + self.rest
        return legs

    def _preview(self, movement: Movement, begin: float, duration: float) -> Preview:
        time = np.linspace(0.0, duration, math.ceil(duration / SAMPLE_PERIOD) + 1)
        distance, speed, rate = (row[:, None] for row in self.law.at(time, movement.length))
        pose, slope, second = movement.at(distance[:, 0])
        velocity, acceleration = slope * speed, slope * rate + second * speed**2
        velocity[[0, -1]] = acceleration[[0, -1]] = 0.0
        return Preview(begin + time, pose, velocity, acceleration)
