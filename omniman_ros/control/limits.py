"""Limitation of twists and wheel speeds that keeps the direction of the twist."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import REQUIRED, parameter
from omniman_ros.core.validated import Validated

Pair = tuple[float, float]  #: A linear and an angular limit, e.g. [m/s, rad/s]


@dataclass(frozen=True, kw_only=True)
class TwistLimits(Validated):
    """Limits of the platform's twist; the linear ones apply to the length of (x', y')."""

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
        REQUIRED, "Largest linear deceleration, also in stops.", unit="m/s^2", low=0.1, high=100
    )
    angular_deceleration: float = parameter(
        REQUIRED, "Largest yaw deceleration, also in stops.", unit="rad/s^2", low=0.1, high=200
    )
    linear_jerk: float = parameter(
        REQUIRED,
        "Largest linear jerk under cmd_vel and on paths; stops are not limited in jerk.",
        unit="m/s^3",
        low=1e-2,
        high=1e4,
    )
    angular_jerk: float = parameter(
        REQUIRED,
        "Largest yaw jerk under cmd_vel and on paths; stops are not limited in jerk.",
        unit="rad/s^3",
        low=1e-2,
        high=1e5,
    )

    @property
    def velocity(self) -> Pair:
        """Largest linear and angular velocity [m/s, rad/s]."""
        return self.linear_velocity, self.angular_velocity

    @property
    def acceleration(self) -> Pair:
        """Largest linear and angular acceleration [m/s^2, rad/s^2]."""
        return self.linear_acceleration, self.angular_acceleration

    @property
    def deceleration(self) -> Pair:
        """Largest linear and angular deceleration [m/s^2, rad/s^2]."""
        return self.linear_deceleration, self.angular_deceleration

    @property
    def jerk(self) -> Pair:
        """Largest linear and angular jerk [m/s^3, rad/s^3]."""
        return self.linear_jerk, self.angular_jerk


def ratio(vector: Array, limit: Pair) -> float:
    """Return the ratio of a vector to its limit: max(|(x, y)| / limit[0], |angle| / limit[1]).

    Args:
        vector: Twist (3,) or one of its derivatives, or a difference of twists.
        limit: Linear and angular limit. If it is a derivative of the vector, the ratio is the
            time [s] that the vector takes to change from zero.
    """
    x, y, angle = vector.tolist()
    result: float = max(math.hypot(x, y) / limit[0], abs(angle) / limit[1])
    return result


def clamp(vector: Array, limit: Pair) -> Array:
    """Return a vector (3,) scaled down to its linear and angular limit; its direction is kept."""
    excess = ratio(vector, limit)
    return vector / excess if excess > 1.0 else vector


def saturation(wheel_speeds: Array, max_speed: float) -> float:
    """Return the factor in (0, 1] that scales wheel speeds (n,) to at most `max_speed` [rad/s].

    The factor is the same for all wheels, so that the twist keeps its direction.
    """
    fastest = float(np.abs(wheel_speeds).max())
    return max_speed / fastest if fastest > max_speed else 1.0


def ramp_down(twist: Array, deceleration: Pair, dt: float) -> Array:
    """Return the twist (3,) after `dt` [s] of a stop in which the robot stays on its curve.

    Exactly zero is reached after ratio(twist, deceleration) seconds.

    Args:
        twist: Present twist (3,) [m/s, m/s, rad/s].
        deceleration: Linear and angular limit [m/s^2, rad/s^2].
    """
    stop_time = ratio(twist, deceleration)
    return twist * (1.0 - dt / stop_time) if stop_time > dt else np.zeros(3)


def slowed(
    twist: Array, before: Array, velocity: Pair, deceleration: Pair, fraction: float, dt: float
) -> Array:
    """Return a twist (3,) scaled to a fraction of the velocity limits, which may fall suddenly.

    A twist within the fraction of the limits stays the same.

    Args:
        twist: Twist (3,) to limit [m/s, m/s, rad/s].
        before: Twist (3,) of the last step, from which it decelerates.
        velocity: Linear and angular limit of the velocity [m/s, rad/s].
        deceleration: Linear and angular limit of the deceleration [m/s^2, rad/s^2].
    """
    used = ratio(twist, velocity)
    if used <= fraction:
        return twist
    slowest = ramp_down(before, deceleration, dt)
    return slowest if ratio(slowest, velocity) > fraction else twist * (fraction / used)


def slew(twist: Array, target: Array, limits: TwistLimits, dt: float) -> Array:
    """Return the twist (3,) `dt` [s] later on the straight line to a target twist (3,).

    The limits of acceleration and deceleration hold, those of velocity and jerk do not.
    """
    step = target - twist
    rate = _rate_limit(twist, step, limits)
    step_time = ratio(step, rate)
    return twist + step * (dt / step_time) if step_time > dt else target


def _rate_limit(twist: Array, step: Array, limits: TwistLimits) -> Pair:
    """Return the linear and the angular limit of the rate of a twist (3,) that changes by a step.

    Each is that of the deceleration if the step (3,) slows the twist down, else that of the
    acceleration.
    """
    x, y, angle = twist.tolist()
    dx, dy, dangle = step.tolist()
    return (
        limits.linear_deceleration if x * dx + y * dy < 0.0 else limits.linear_acceleration,
        limits.angular_deceleration if angle * dangle < 0.0 else limits.angular_acceleration,
    )


class TwistLimiter:
    """Moves a twist to its target within velocity, acceleration, deceleration and jerk limits.

    From rest or constant velocity, the twist changes on a straight line in (x', y', theta'): the
    direction is kept, and all three components arrive together. The acceleration is the largest
    that can still be brought to zero at the jerk limit without overshooting the target (exact in
    discrete time). If the target changes so that the twist would leave the velocity limits, these
    have priority over the jerk limit.
    """

    def __init__(self, limits: TwistLimits) -> None:
        self.limits = limits
        self._acceleration: Array = np.zeros(3)

    def restart(self, acceleration: Array | None = None) -> None:
        """Set the present rate (3,) of the twist; None means zero.

        Call it after the twist was set without this limiter.
        """
        self._acceleration = np.zeros(3) if acceleration is None else acceleration

    def step(self, twist: Array, target: Array, dt: float) -> Array:
        """Return the twist (3,) `dt` [s] after `twist` (3,) in its change to `target` (3,).

        Both are given, and the result is returned, in the same frame.
        """
        if dt <= 0.0:
            return twist
        limits = self.limits
        target = clamp(target, limits.velocity)
        error = target - twist
        rate = _rate_limit(twist, error, limits)
        pace = min(limits.jerk[0] / rate[0], limits.jerk[1] / rate[1])
        target_time = ratio(error, rate)  # Time to the target at the largest acceleration [s].
        # Number of whole ticks after this one in which the acceleration falls to zero, and the
        # fraction of the largest acceleration from which it falls.
        ticks = math.floor(math.sqrt(0.25 + 2.0 * target_time / (pace * dt * dt)) - 0.5)
        fraction = min(1.0, target_time / (dt * (ticks + 1)) + 0.5 * pace * dt * ticks)
        arriving = target_time <= dt and ticks == 0
        acceleration = error / dt if arriving else error * (fraction / target_time)
        change = acceleration - self._acceleration
        change_time = ratio(change, limits.jerk)
        if change_time > dt:
            arriving, acceleration = False, self._acceleration + change * (dt / change_time)
        self._acceleration = acceleration
        if arriving:
            return target
        # A twist above its limit, which was lowered or did not apply before, is reduced gradually.
        excess = max(1.0, ratio(twist, limits.velocity))
        linear, angular = limits.velocity
        return clamp(twist + acceleration * dt, (excess * linear, excess * angular))
