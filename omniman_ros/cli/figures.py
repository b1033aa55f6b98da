"""What the demo drives, as pure functions of time: body twists, and a figure to be followed."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from omniman_ros.core.limits import TwistLimits

Triple = tuple[float, float, float]

CRUISE = 0.5
"""Speed of the figure and bound of the twists' speeds [m/s]."""
SPIN = 0.8
"""Bound of the twists' yaw rates [rad/s]."""


@dataclass(frozen=True)
class Pace:
    """How fast the show may go: well within a robot's limits.

    Attributes:
        twist: Linear speed of the twists [m/s].
        spin: Yaw rate of the twists [rad/s].
        figure: Largest speed along the figure [m/s].
        ramp: Time from rest to that speed [s].
    """

    twist: float = 0.3
    spin: float = 0.6
    figure: float = CRUISE
    ramp: float = 1.5

    @classmethod
    def within(cls, limits: TwistLimits) -> "Pace":
        """The pace for a robot's limits."""
        slowest = min(limits.linear_acceleration, limits.linear_deceleration)
        figure = min(CRUISE, 0.7 * limits.linear_velocity, 0.7 * limits.angular_velocity)
        return cls(
            twist=min(0.3, 0.5 * limits.linear_velocity),
            spin=min(SPIN, 0.5 * limits.angular_velocity),
            figure=figure,
            # A smoothstep of degree 5 is 1.875 times as steep as the straight line.
            ramp=max(1.5, 1.875 * figure / (0.8 * slowest)),
        )


@dataclass(frozen=True)
class TwistPhase:
    """A part of the show that is driven by twists.

    Attributes:
        name: For people.
        duration: [s].
        twist: Time since its start [s] to x', y' [m/s], theta' [rad/s] in base_link.
    """

    name: str
    duration: float
    twist: Callable[[float], Triple]


def twist_phases(pace: Pace) -> list[TwistPhase]:
    """Forward, sideways, diagonally back, on the spot, and round a circle while spinning."""
    v, w = pace.twist, pace.spin
    leg, lap = 2.5, 7.0
    slant = v / math.sqrt(2.0)
    turn = math.tau / lap - 0.75 * w

    def circle(t: float) -> Triple:
        return v * math.cos(turn * t), v * math.sin(turn * t), 0.75 * w

    return [
        TwistPhase("forward", leg, lambda t: (v, 0.0, 0.0)),
        TwistPhase("sideways", leg, lambda t: (0.0, v, 0.0)),
        TwistPhase("diagonal", leg * math.sqrt(2.0), lambda t: (-slant, -slant, 0.0)),
        TwistPhase("spin", 4.0, lambda t: (0.0, 0.0, w)),
        TwistPhase("circle + spin", lap, circle),
    ]


@dataclass(frozen=True)
class Sample:
    """Pose [m, m, rad], velocity and acceleration (per s, s^2) in the world frame."""

    pose: Triple
    velocity: Triple
    acceleration: Triple


class Figure:
    """A figure of eight from rest to rest, with the heading swinging to one side and back.

    x = A sin(2 pi s), y = A/2 sin(4 pi s), theta = B/2 (1 - cos(2 pi s)), s from 0 to 1: fastest
    where it crosses itself. s' rises as a quintic smoothstep, stays, and falls as it rose, so
    that velocity, acceleration and jerk have no jump.

    Args:
        start: Pose in odom where it begins and ends [m, m, rad].
        speed: Largest speed [m/s].
        ramp: Time from rest to full speed [s].
        size: A [m].
        swing: B [rad].
    """

    def __init__(
        self, start: Triple, speed: float = CRUISE, ramp: float = 1.5, size: float = 0.6,
        swing: float = math.pi / 2,
    ) -> None:  # fmt: skip
        self.start = start
        self._size = size
        self._swing = swing
        self._ramp = ramp
        self._rate = speed / (math.tau * size * math.sqrt(2.0))
        self.duration = 1.0 / self._rate + ramp
        if self.duration < 2.0 * ramp:
            raise ValueError(f"the ramps of {ramp} s do not fit into {self.duration:.3g} s")

    def sample(self, time: float) -> Sample:
        """The reference `time` seconds after the start; at rest before it and after the end."""
        t = min(max(time, 0.0), self.duration)
        s, rate, bend = self._progress(t)
        a, half = math.tau * s, 0.5 * self._swing
        size = self._size
        first = (
            math.tau * size * math.cos(a),
            math.tau * size * math.cos(2 * a),
            math.tau * half * math.sin(a),
        )
        second = (
            -(math.tau**2) * size * math.sin(a),
            -2.0 * math.tau**2 * size * math.sin(2 * a),
            math.tau**2 * half * math.cos(a),
        )
        pose = (size * math.sin(a), 0.5 * size * math.sin(2 * a), half * (1.0 - math.cos(a)))
        velocity = tuple(p * rate for p in first)
        acceleration = tuple(
            q * rate * rate + p * bend for p, q in zip(first, second, strict=True)
        )
        x, y, theta = self.start
        dx, dy, turn = self._turned(pose)
        return Sample(
            (x + dx, y + dy, theta + turn), self._turned(velocity), self._turned(acceleration)
        )

    def _progress(self, t: float) -> Triple:
        """s, s' and s'' at a time from 0 to the duration."""
        if t > 0.5 * self.duration:
            s, rate, bend = self._progress(self.duration - t)
            return 1.0 - s, rate, -bend
        if t >= self._ramp:
            return self._rate * (t - 0.5 * self._ramp), self._rate, 0.0
        u = t / self._ramp
        area = u**4 * (2.5 + u * (u - 3.0))
        height = u**3 * (10.0 + u * (6.0 * u - 15.0))
        slope = 30.0 * u * u * (1.0 - u) ** 2
        return self._rate * self._ramp * area, self._rate * height, self._rate / self._ramp * slope

    def _turned(self, vector: tuple[float, ...]) -> Triple:
        c, s = math.cos(self.start[2]), math.sin(self.start[2])
        x, y, angle = vector
        return c * x - s * y, s * x + c * y, angle
