"""Motion commands of a program: what each makes of the joints' target, cycle by cycle.

The target is the trajectory's point that the joints are to follow. Commands run in the program's
time, which the speed slider stretches; stops run in real time.
"""

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
JOINTS = 6
SOON = 1e-9
"""Time left that is none [s]."""
REST = 1e-6
"""Speed that is none [rad/s]."""


@dataclass
class Target:
    """Point of the trajectory.

    Attributes:
        q: Angles [rad].
        w: Speeds per time of the program [rad/s].
    """

    q: Array
    w: Array = field(default_factory=lambda: np.zeros(JOINTS))


class Motion(Protocol):
    """One command."""

    stretched: bool
    """Whether the speed slider stretches it."""

    @property
    def over(self) -> bool:
        """Whether its time has passed, or its aim is reached."""
        ...

    def advance(self, target: Target, dt: float) -> None:
        """Move the target for a time [s]."""
        ...


def _shift(target: Target, w: Array, dt: float) -> None:
    target.w = w
    target.q = target.q + w * dt


class Stop:
    """Come to rest: the fastest joint decelerates with `a`, the others in proportion.

    Args:
        a: Deceleration [rad/s^2]; positive.
    """

    stretched = False

    def __init__(self, a: float) -> None:
        self._a = a
        self.over = False

    def advance(self, target: Target, dt: float) -> None:
        """Decelerate for a time [s]."""
        fastest = float(np.max(np.abs(target.w)))
        left = 0.0 if fastest < REST else max(0.0, 1.0 - self._a * dt / fastest)
        _shift(target, target.w * left, dt)
        self.over = left == 0.0


class ServoJ:
    """servoj: go to angles as a spring and a damper would, for a time.

    The gain pulls towards the angles from where the target would be after the lookahead time at
    its present speed (The URScript Programming Language for CB-Series, servoj). In steady motion
    the target lags by the lookahead time.

    Args:
        q: Angles [rad].
        t: Time for which the command holds [s].
        lookahead_time: [s].
        gain: [1/s^2].

    Attributes:
        overrun: By how much the last cycle exceeded its time [s]; 0 if one before already did.
    """

    stretched = True

    def __init__(self, q: Array, t: float, lookahead_time: float, gain: float) -> None:
        self._q, self._left, self.overrun = q, t, 0.0
        self._lookahead, self._gain = lookahead_time, gain

    @property
    def over(self) -> bool:
        """Whether its time has passed."""
        return self._left <= SOON

    def advance(self, target: Target, dt: float) -> None:
        """Servo for a time [s]; an implicit step, stable for every gain."""
        before, self._left = self._left, self._left - dt
        self.overrun = -self._left if before > SOON and self.over else 0.0
        spring = dt * self._gain
        w = (target.w + spring * (self._q - target.q)) / (1.0 + spring * (dt + self._lookahead))
        _shift(target, w, dt)


class SpeedJ:
    """speedj: accelerate to speeds, for a time or until they are reached.

    Args:
        w: Speeds [rad/s].
        a: Acceleration of the joint that changes most [rad/s^2].
        t: Time [s]; 0: until the speeds are reached.
    """

    stretched = True

    def __init__(self, w: Array, a: float, t: float) -> None:
        self._w, self._a = w, a
        self._left = t if t > 0.0 else math.inf
        self._reached = False

    @property
    def over(self) -> bool:
        """Whether its time has passed, or without a time, its speeds are reached."""
        return self._left <= SOON or (self._reached and math.isinf(self._left))

    def advance(self, target: Target, dt: float) -> None:
        """Accelerate for a time [s]."""
        self._left -= dt
        change = self._w - target.w
        most = float(np.max(np.abs(change)))
        self._reached = most <= self._a * dt
        part = 1.0 if self._reached else self._a * dt / most
        _shift(target, target.w + part * change, dt)


class MoveJ:
    """movej: straight in joint space, a trapezoid of speed, all joints end together at rest.

    It first comes to rest if the arm moves. It may be held up at any time: it then goes on from
    where the target is.

    Args:
        q: Angles [rad].
        a: Acceleration of the leading joint [rad/s^2].
        v: Its speed [rad/s].
        t: Time [s]; if it is not 0, it takes the place of acceleration and speed.
    """

    stretched = True

    def __init__(self, q: Array, a: float, v: float, t: float) -> None:
        self._q, self._a, self._v, self._t = q, a, v, t
        self._speed: float | None = None
        self.over = False

    def hold_up(self) -> None:
        """Something else has stopped the arm; begin anew from there."""
        self._speed = None

    def advance(self, target: Target, dt: float) -> None:
        """Move for a time [s]."""
        way = self._q - target.q
        distance = float(np.max(np.abs(way)))
        if self._speed is None:
            if np.max(np.abs(target.w)) > REST:
                Stop(self._a).advance(target, dt)
                return
            self._speed = 0.0
            if self._t > 0.0 and distance > 0.0:
                self._a, self._v = _timed(distance, self._t, self._a)
                self._t = 0.0
        # The speed from which the way is enough to stop, in steps of dt.
        braking = math.sqrt(2.0 * self._a * distance + (0.5 * self._a * dt) ** 2)
        braking -= 0.5 * self._a * dt
        self._speed = min(self._speed + self._a * dt, self._v, braking)
        step = self._speed * dt
        if distance <= max(step, 1e-7):
            target.q, target.w = self._q.copy(), np.zeros(JOINTS)
            self.over = True
            return
        _shift(target, way * (self._speed / distance), dt)


def _timed(distance: float, t: float, a: float) -> tuple[float, float]:
    """Acceleration and speed that cover a distance in a time; a trapezoid with `a` if it can."""
    room = (a * t) ** 2 - 4.0 * a * distance
    if room > 0.0:
        return a, 0.5 * (a * t - math.sqrt(room))
    return 4.0 * distance / t**2, 2.0 * distance / t
