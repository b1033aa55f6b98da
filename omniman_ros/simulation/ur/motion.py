"""Motion commands of a program: how each moves the target of the joints, cycle by cycle.

The target is the point of the trajectory that the joints follow. Commands run in the time of the
program, which the speed slider stretches; stops run in real time.
"""

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from omniman_ros.core.arrays import Array

JOINTS = 6  #: Number of joints
TIME_TOLERANCE = 1e-9  #: Remaining time up to which a command counts as over [s]
REST_SPEED = 1e-6  #: Speed below which the target counts as at rest [rad/s]


@dataclass
class Target:
    """Point of the trajectory."""

    q: Array  #: Joint angles (6,) [rad]
    #: Joint velocities (6,) in the time of the program [rad/s]
    w: Array = field(default_factory=lambda: np.zeros(JOINTS))


class MotionCommand(Protocol):
    """Motion command."""

    stretched: bool  #: Whether the speed slider stretches the time of the command

    @property
    def over(self) -> bool:
        """Whether the time of the command has passed, or its goal is reached."""

    def advance(self, target: Target, dt: float) -> None:
        """Move the target for a time [s]."""


def _shift(target: Target, w: Array, dt: float) -> None:
    target.w = w
    target.q = target.q + w * dt


class StopJ:
    """Come to rest: the fastest joint decelerates with `a` [rad/s^2], the others in proportion."""

    stretched = False

    def __init__(self, a: float) -> None:
        self._a = a
        self.over = False

    def advance(self, target: Target, dt: float) -> None:
        """Decelerate for a time [s]."""
        fastest = float(np.max(np.abs(target.w)))
        fraction = 0.0 if fastest < REST_SPEED else max(0.0, 1.0 - self._a * dt / fastest)
        _shift(target, target.w * fraction, dt)
        self.over = fraction == 0.0


class ServoJ:
    """servoj: go to angles as a spring and a damper would, for a time.

    The gain pulls towards the angles from where the target would be after the lookahead time at
    its present speed (The URScript Programming Language for CB-Series, servoj). In steady motion
    the target lags by the lookahead time.

    Args:
        q: Angles [rad].
        gain: Stiffness of the spring per inertia [1/s^2].

    Attributes:
        overrun: Time by which the cycle in which the command ended exceeded `t` [s]; 0 before and
            after that cycle.
    """

    stretched = True

    def __init__(self, q: Array, t: float, lookahead_time: float, gain: float) -> None:
        self._q, self._remaining, self.overrun = q, t, 0.0
        self._lookahead, self._gain = lookahead_time, gain

    @property
    def over(self) -> bool:
        """Whether the time of the command has passed."""
        return self._remaining <= TIME_TOLERANCE

    def advance(self, target: Target, dt: float) -> None:
        """Servo for a time [s], by an implicit step that is stable for every gain."""
        previous, self._remaining = self._remaining, self._remaining - dt
        self.overrun = -self._remaining if previous > TIME_TOLERANCE and self.over else 0.0
        spring = dt * self._gain
        w = (target.w + spring * (self._q - target.q)) / (1.0 + spring * (dt + self._lookahead))
        _shift(target, w, dt)


class SpeedJ:
    """speedj: accelerate to speeds, for a time or until they are reached.

    Args:
        w: Speeds [rad/s].
        a: Acceleration of the joint that changes most [rad/s^2].
        t: Time [s]; if 0, the command runs until the speeds are reached.
    """

    stretched = True

    def __init__(self, w: Array, a: float, t: float) -> None:
        self._w, self._a = w, a
        self._remaining = t if t > 0.0 else math.inf
        self._reached = False

    @property
    def over(self) -> bool:
        """Whether the time has passed or, without a time, the speeds are reached."""
        return self._remaining <= TIME_TOLERANCE or (self._reached and math.isinf(self._remaining))

    def advance(self, target: Target, dt: float) -> None:
        """Accelerate for a time [s]."""
        self._remaining -= dt
        change = self._w - target.w
        largest = float(np.max(np.abs(change)))
        self._reached = largest <= self._a * dt
        fraction = 1.0 if self._reached else self._a * dt / largest
        _shift(target, target.w + fraction * change, dt)


class MoveJ:
    """movej: move straight in joint space with a trapezoidal speed, and end at rest.

    It first comes to rest if the arm moves. It may be interrupted at any time, and then continues
    from where the target is.

    Args:
        q: Angles [rad].
        a: Acceleration of the leading joint [rad/s^2].
        v: Speed of the leading joint [rad/s].
        t: Time [s]; if it is not 0, it replaces acceleration and speed.
    """

    stretched = True

    def __init__(self, q: Array, a: float, v: float, t: float) -> None:
        self._q, self._a, self._v, self._t = q, a, v, t
        self._speed: float | None = None
        self.over = False

    def restart(self) -> None:
        """Begin again from the present position, after something else has stopped the arm."""
        self._speed = None

    def advance(self, target: Target, dt: float) -> None:
        """Move for a time [s]."""
        change = self._q - target.q
        distance = float(np.max(np.abs(change)))
        if self._speed is None:
            if np.max(np.abs(target.w)) > REST_SPEED:
                StopJ(self._a).advance(target, dt)
                return
            self._speed = 0.0
            if self._t > 0.0 and distance > 0.0:
                self._a, self._v = _timed(distance, self._t, self._a)
                self._t = 0.0
        # The speed is limited to the highest one from which the distance suffices to stop.
        braking = math.sqrt(2.0 * self._a * distance + (0.5 * self._a * dt) ** 2)
        braking -= 0.5 * self._a * dt
        self._speed = min(self._speed + self._a * dt, self._v, braking)
        step = self._speed * dt
        if distance <= max(step, 1e-7):
            target.q, target.w = self._q.copy(), np.zeros(JOINTS)
            self.over = True
            return
        _shift(target, change * (self._speed / distance), dt)


def _timed(distance: float, t: float, a: float) -> tuple[float, float]:
    """Return acceleration and speed that cover a distance in time t, with `a` if possible."""
    discriminant = (a * t) ** 2 - 4.0 * a * distance
    if discriminant > 0.0:
        return a, 0.5 * (a * t - math.sqrt(discriminant))
    return 4.0 * distance / t**2, 2.0 * distance / t
