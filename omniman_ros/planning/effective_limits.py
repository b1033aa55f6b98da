"""Limits that plans keep to: those of the parameters, scaled and without the reserve."""

from dataclasses import dataclass

from omniman_ros.planning.parameters import PlannerParameters

#: Smallest scale of the limits [-]: without any speed there would be nothing to plan with
MIN_LIMIT_SCALE = 0.01


@dataclass(frozen=True)
class EffectiveLimits:
    """Planner parameters with the scale of the motion limits resolved.

    Plans use `(1 - reserve) * limit_scale` of the velocity and acceleration limits. Braking uses
    `(1 - reserve) * braking_scale` of the deceleration limits.
    """

    parameters: PlannerParameters
    #: Factor on velocity and acceleration limits [-]; 1 unless a wheel is dead, or the arm's
    #: posture supports less. Values below MIN_LIMIT_SCALE are raised to it.
    limit_scale: float = 1.0
    #: Factor on deceleration limits [-]; 1 unless the posture supports less
    braking_scale: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "limit_scale", max(self.limit_scale, MIN_LIMIT_SCALE))

    @property
    def factor(self) -> float:
        """Part of the velocity and acceleration limits that plans may use [-]."""
        return (1.0 - self.parameters.reserve) * self.limit_scale

    @property
    def speeds(self) -> tuple[float, float]:
        """Largest linear [m/s] and angular speed [rad/s] of plans."""
        factor, limits = self.factor, self.parameters.limits
        return factor * limits.linear_velocity, factor * limits.angular_velocity

    @property
    def accelerations(self) -> tuple[float, float]:
        """Largest linear [m/s^2] and angular acceleration [rad/s^2] of plans."""
        factor, limits = self.factor, self.parameters.limits
        return factor * limits.linear_acceleration, factor * limits.angular_acceleration

    @property
    def decelerations(self) -> tuple[float, float]:
        """Linear [m/s^2] and angular deceleration [rad/s^2] of braking."""
        factor = (1.0 - self.parameters.reserve) * self.braking_scale
        linear, angular = self.parameters.limits.deceleration
        return factor * linear, factor * angular
