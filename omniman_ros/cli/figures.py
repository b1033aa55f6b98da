"""What the demo drives through cmd_vel: body twists as pure functions of time."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from omniman_ros.core.limits import TwistLimits

Triple = tuple[float, float, float]

SPIN = 0.8
"""Bound of the twists' yaw rates [rad/s]."""


@dataclass(frozen=True)
class Pace:
    """How fast the show may go: well within a robot's limits.

    Attributes:
        twist: Linear speed of the twists [m/s].
        spin: Yaw rate of the twists [rad/s].
    """

    twist: float = 0.3
    spin: float = 0.6

    @classmethod
    def within(cls, limits: TwistLimits) -> "Pace":
        """The pace for a robot's limits."""
        return cls(
            twist=min(0.3, 0.5 * limits.linear_velocity),
            spin=min(SPIN, 0.5 * limits.angular_velocity),
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
    """Diagonally, on the spot, and round a circle while spinning."""
    v, w = pace.twist, pace.spin
    lap = 5.0
    slant = v / math.sqrt(2.0)
    turn = math.tau / lap - 0.75 * w

    def circle(t: float) -> Triple:
        return v * math.cos(turn * t), v * math.sin(turn * t), 0.75 * w

    return [
        TwistPhase("diagonal", 2.5, lambda t: (slant, slant, 0.0)),
        TwistPhase("spin", 3.0, lambda t: (0.0, 0.0, w)),
        TwistPhase("circle + spin", lap, circle),
    ]


@dataclass(frozen=True)
class Sample:
    """Pose [m, m, rad], velocity and acceleration (per s, s^2) in the world frame."""

    pose: Triple
    velocity: Triple
    acceleration: Triple
