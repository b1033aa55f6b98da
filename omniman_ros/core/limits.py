"""Limits on twists and wheel speeds that keep the twist's direction."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.parameters import REQUIRED, parameter

Array = NDArray[np.float64]
Pair = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class TwistLimits:
    """Limits on the platform's twist; linear ones hold for the vector (x', y')."""

    linear_velocity: float = parameter(
        REQUIRED, "Largest linear speed.", unit="m/s", low=1e-3, high=20
    )
    angular_velocity: float = parameter(
        REQUIRED, "Largest yaw rate.", unit="rad/s", low=1e-3, high=50
    )
    linear_acceleration: float = parameter(
        REQUIRED, "Largest linear acceleration.", unit="m/s^2", low=1e-3, high=100
    )
    angular_acceleration: float = parameter(
        REQUIRED, "Largest yaw acceleration.", unit="rad/s^2", low=1e-3, high=200
    )
    linear_deceleration: float = parameter(
        REQUIRED, "Largest linear deceleration, stops included.", unit="m/s^2", low=0.1, high=100
    )
    angular_deceleration: float = parameter(
        REQUIRED, "Largest yaw deceleration, stops included.", unit="rad/s^2", low=0.1, high=200
    )
    linear_jerk: float = parameter(
        REQUIRED, "Largest linear jerk under cmd_vel and on paths; stops have none.",
        unit="m/s^3", low=1e-2, high=1e4,
    )  # fmt: skip
    angular_jerk: float = parameter(
        REQUIRED, "Largest yaw jerk under cmd_vel and on paths; stops have none.",
        unit="rad/s^3", low=1e-2, high=1e5,
    )  # fmt: skip

    @property
    def velocity(self) -> Pair:
        """Linear and angular limit."""
        return self.linear_velocity, self.angular_velocity

    @property
    def acceleration(self) -> Pair:
        """Linear and angular limit."""
        return self.linear_acceleration, self.angular_acceleration

    @property
    def deceleration(self) -> Pair:
        """Linear and angular limit."""
        return self.linear_deceleration, self.angular_deceleration

    @property
    def jerk(self) -> Pair:
        """Linear and angular limit."""
        return self.linear_jerk, self.angular_jerk


def ratio(vector: Array, limit: Pair) -> float:
    """How much of its limit a vector (x, y, angle) uses: max(|(x, y)| / linear, |angle| / ang)."""
    x, y, angle = vector.tolist()
    used: float = max(math.hypot(x, y) / limit[0], abs(angle) / limit[1])
    return used


def clamp(vector: Array, limit: Pair) -> Array:
    """Scale a vector (3,) down to its limit; its direction stays."""
    used = ratio(vector, limit)
    return vector / used if used > 1.0 else vector


def saturation(wheel_speeds: Array, max_speed: float) -> float:
    """One factor in (0, 1] that brings all wheel speeds (n,) [rad/s] to at most max_speed.

    All wheels are scaled alike, so the twist keeps its direction.
    """
    fastest = float(np.abs(wheel_speeds).max())
    return max_speed / fastest if fastest > max_speed else 1.0


def ramp_down(twist: Array, deceleration: Pair, dt: float) -> Array:
    """The twist after dt of a stop: the robot keeps its curve, the deceleration its limits.

    Exactly zero is reached after ratio(twist, deceleration) seconds.
    """
    rest = ratio(twist, deceleration)
    return twist * (1.0 - dt / rest) if rest > dt else np.zeros(3)


def slew(twist: Array, target: Array, limits: TwistLimits, dt: float) -> Array:
    """The twist after dt on the straight way to the target, within acceleration limits."""
    step = target - twist
    rate = _rate_limit(twist, step, limits)
    used = ratio(step, rate)
    return twist + step * (dt / used) if used > dt else target


def _rate_limit(twist: Array, step: Array, limits: TwistLimits) -> Pair:
    """Acceleration or deceleration limit, by whether the step slows each of the two down."""
    x, y, angle = twist.tolist()
    dx, dy, turn = step.tolist()
    return (
        limits.linear_deceleration if x * dx + y * dy < 0.0 else limits.linear_acceleration,
        limits.angular_deceleration if angle * turn < 0.0 else limits.angular_acceleration,
    )


class TwistLimiter:
    """Leads a twist to its target within velocity, acceleration, deceleration and jerk limits.

    From rest or steady motion the way is straight in (x', y', theta'): the direction is kept and
    all three arrive together. The acceleration is the largest from which it can still be brought
    to zero at the jerk limit without passing the target (exact in discrete time).
    Where a new target bends the way out of the velocity limits, these go before the jerk limit.
    """

    def __init__(self, limits: TwistLimits) -> None:
        self.limits = limits
        self._acceleration: Array = np.zeros(3)

    def restart(self) -> None:
        """Forget the acceleration: the twist was led by something else in between."""
        self._acceleration = np.zeros(3)

    def step(self, twist: Array, target: Array, dt: float) -> Array:
        """Return the twist (3,) dt after `twist` on the way to `target`, both in one frame."""
        if dt <= 0.0:
            return twist
        limits = self.limits
        target = clamp(target, limits.velocity)
        error = target - twist
        rate = _rate_limit(twist, error, limits)
        pace = min(limits.jerk[0] / rate[0], limits.jerk[1] / rate[1])
        distance = ratio(error, rate)  # [s], at full acceleration
        # Whole ticks after this one in which it falls to zero, and the share that does so.
        ticks = math.floor(math.sqrt(0.25 + 2.0 * distance / (pace * dt * dt)) - 0.5)
        share = min(1.0, distance / (dt * (ticks + 1)) + 0.5 * pace * dt * ticks)
        arriving = distance <= dt and ticks == 0
        wanted = error / dt if arriving else error * (share / distance)
        change = wanted - self._acceleration
        used = ratio(change, limits.jerk)
        if used > dt:
            arriving, wanted = False, self._acceleration + change * (dt / used)
        self._acceleration = wanted
        if arriving:
            return target
        # A twist above its limit (which was lowered, or not ours) is led down, not cut off.
        above = max(1.0, ratio(twist, limits.velocity))
        return clamp(twist + wanted * dt, (above * limits.velocity[0], above * limits.velocity[1]))
