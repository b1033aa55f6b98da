"""The path of CCTA 2017 V.C and Fig. 7, and its motion in time.

The paper: "The platform moves a path with straight lines forwards, sideways and backwards. After
that, it moves a circular path with two rotations back to the starting point. [...] The five
movements of the platform [...] can be easily distinguished." Sizes are not given. Read here as:

1. forwards, 2. sideways to the left, 3. backwards, `length` each, heading 0: the platform stands
   at (0, length);
4. and 5. the circle that has the way back, from (0, length) to (0, 0), as its diameter. It is gone
   round one and a half times, counter-clockwise, so that it is a whole circle and ends at the
   starting point, and on it the platform turns round itself twice, counter-clockwise: one turn a
   movement, three quarters of the circle each. Heading and direction of travel go apart on the
   way, so that the platform moves in all directions of its own frame.

Each movement is from rest to rest.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import InputError
from omniman_ros.core.preview import Preview

Array = NDArray[np.float64]
Pose = tuple[float, float, float]

LENGTH = 1.2
"""Of a straight line, and diameter of the circle [m]."""
SAMPLE = 0.02
"""Time between two points of a preview, which are joined by quintics [s]."""


@dataclass(frozen=True)
class Movement:
    """A line or an arc that is run through with an even turn of the heading.

    Attributes:
        name: For people.
        start: Pose at its begin [m, m, rad].
        length: Of the way [m].
        course: Direction of travel at its begin, in the world [rad].
        bend: Turn of the direction of travel per way, 0 for a line [rad/m].
        turn: Turn of the heading over the whole way [rad].
    """

    name: str
    start: Pose
    length: float
    course: float
    bend: float = 0.0
    turn: float = 0.0

    def at(self, way: Array) -> tuple[Array, Array, Array]:
        """Pose and its first and second derivative by the way, (k, 3) each, at ways (k,) [m]."""
        x, y, heading = self.start
        course = self.course + self.bend * way
        c, s = np.cos(course), np.sin(course)
        # The chord of an arc, exact for a line too: sinc is sin(pi x) / (pi x).
        chord = way * np.sinc(self.bend * way / (2 * math.pi))
        middle = self.course + 0.5 * self.bend * way
        rate = np.full_like(way, self.turn / self.length)
        pose = np.column_stack(
            [x + chord * np.cos(middle), y + chord * np.sin(middle), heading + rate * way]
        )
        slope = np.column_stack([c, s, rate])
        bend = self.bend * np.column_stack([-s, c, np.zeros_like(way)])
        return pose, slope, bend

    @property
    def end(self) -> Pose:
        """Pose at its end [m, m, rad]."""
        x, y, heading = self.at(np.array([self.length]))[0][0].tolist()
        return x, y, heading


def movements(length: float = LENGTH) -> tuple[Movement, ...]:
    """The five movements, for straight lines of a length [m]."""
    quarter, full = 0.5 * math.pi, 2 * math.pi
    arc, bend = 0.75 * math.pi * length, 2.0 / length
    first = Movement("forwards", (0.0, 0.0, 0.0), length, 0.0)
    second = Movement("sideways", (length, 0.0, 0.0), length, quarter)
    third = Movement("backwards", (length, length, 0.0), length, 2 * quarter)
    fourth = Movement("circle 1", (0.0, length, 0.0), arc, 2 * quarter, bend, full)
    fifth = Movement("circle 2", fourth.end, arc, 5 * quarter, bend, full)
    return first, second, third, fourth, fifth


def waypoints(spacing: float, length: float = LENGTH) -> Array:
    """Poses (k, 3) along the path [m, m, rad], at most `spacing` m apart; headings unwrapped.

    Raises:
        InputError: The spacing is not above 0.
    """
    if not spacing > 0.0:
        raise InputError(f"spacing of waypoints must be above 0 m, got {spacing:g}")
    rows = [np.zeros((1, 3))]
    for movement in movements(length):
        steps = max(math.ceil(movement.length / spacing - 1e-9), 1)
        way = np.linspace(0.0, movement.length, steps + 1)[1:]
        rows.append(movement.at(way)[0])
    return np.vstack(rows)


@dataclass(frozen=True)
class TimeLaw:
    """From rest to a speed, on, and to rest: speed changes as 10 u^3 - 15 u^4 + 6 u^5.

    Attributes:
        speed: [m/s].
        ramp: Time from rest to speed [s]; the largest acceleration is 1.875 speed / ramp.
    """

    speed: float = 0.4
    ramp: float = 1.5

    def duration(self, length: float) -> float:
        """Time for a length [s].

        Raises:
            InputError: The length is too short to get to the speed.
        """
        if length < self.speed * self.ramp:
            raise InputError(
                f"{length:g} m are too short to get to {self.speed:g} m/s in {self.ramp:g} s"
            )
        return length / self.speed + self.ramp

    def at(self, time: Array, length: float) -> tuple[Array, Array, Array]:
        """Way [m], speed [m/s] and acceleration [m/s^2] at times (k,) since the start [s]."""
        up = np.clip(time / self.ramp, 0.0, 1.0)
        down = np.clip((self.duration(length) - time) / self.ramp, 0.0, 1.0)
        share, rest = up**4 * (2.5 - 3 * up + up**2), down**4 * (2.5 - 3 * down + down**2)
        cruise = np.clip(time, self.ramp, length / self.speed) - self.ramp
        way = self.speed * (self.ramp * (share + 0.5 - rest) + cruise)
        speed = self.speed * _smooth(np.minimum(up, down))
        slope = 30 * (up**2 * (1 - up) ** 2 - down**2 * (1 - down) ** 2)
        return way, speed, self.speed / self.ramp * slope


def _smooth(u: Array) -> Array:
    smooth: Array = u**3 * (10 - 15 * u + 6 * u**2)
    return smooth


@dataclass(frozen=True)
class Leg:
    """A movement in time, as the platform controller takes it: `preview` from `begin` [s]."""

    name: str
    begin: float
    preview: Preview


@dataclass(frozen=True)
class Figure7:
    """The path in time; the same for whoever drives it.

    Attributes:
        length: Of a straight line, and diameter of the circle [m].
        law: Speed along the way.
        rest: Time at rest before, between and after the movements [s].
    """

    length: float = LENGTH
    law: TimeLaw = field(default_factory=TimeLaw)
    rest: float = 0.5

    @property
    def duration(self) -> float:
        """From the rest before the first movement to the end of the rest after the last [s]."""
        times = [self.law.duration(movement.length) for movement in movements(self.length)]
        return sum(times) + self.rest * (len(times) + 1)

    def legs(self, start: float) -> Sequence[Leg]:
        """The movements from a time `start` [s] on, a preview each, in a frame at the start."""
        legs, begin = [], start + self.rest
        for movement in movements(self.length):
            duration = self.law.duration(movement.length)
            legs.append(Leg(movement.name, begin, self._preview(movement, begin, duration)))
            begin += duration + self.rest
        return legs

    def _preview(self, movement: Movement, begin: float, duration: float) -> Preview:
        time = np.linspace(0.0, duration, math.ceil(duration / SAMPLE) + 1)
        way, speed, rise = (row[:, None] for row in self.law.at(time, movement.length))
        pose, slope, bend = movement.at(way[:, 0])
        velocity, acceleration = slope * speed, slope * rise + bend * speed**2
        velocity[[0, -1]] = acceleration[[0, -1]] = 0.0
        return Preview(begin + time, pose, velocity, acceleration)
