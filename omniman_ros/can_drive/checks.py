"""What an axis checks in setpoints that it is given and in positions that are reported to it."""

import math
from dataclasses import replace

from omniman_ros.can_drive.axis import AxisSettings, Setpoint
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.wheel_cascade import DriveMode

SLACK = 3.0
"""Speed at which a shaft can surely not turn, over its largest speed."""


def positive(settings: AxisSettings, *names: str) -> None:
    """Refuse settings that a codec divides by.

    Raises:
        ParameterError: One of them is not finite or not above zero.
    """
    for name in names:
        value = getattr(settings, name)
        if not (math.isfinite(value) and value > 0.0):
            raise ParameterError(f"{settings.name}.{name}", value, "finite and above zero")


def clipped(setpoint: Setpoint, settings: AxisSettings) -> Setpoint:
    """Return a setpoint within the largest speed [rad/s] and torque [N m]; volts stay.

    Raises:
        ValueError: Its value or its feed-forward torque is not finite.
    """
    value, torque = setpoint.value, setpoint.feedforward
    if not (math.isfinite(value) and math.isfinite(torque)):
        raise ValueError(f"setpoint of {settings.name} is not finite: {value}, {torque}")
    limits = {DriveMode.VELOCITY: settings.max_speed, DriveMode.TORQUE: settings.max_torque}
    limit = limits.get(setpoint.mode, math.inf)
    return replace(
        setpoint,
        value=min(max(value, -limit), limit),
        feedforward=min(max(torque, -settings.max_torque), settings.max_torque),
    )


def reachable(step: float, elapsed: float, settings: AxisSettings) -> bool:
    """Whether a shaft can have turned by a step [rad] in the time between two reports [s].

    Reports come late: each may be as old as the feedback timeout, on top of the time elapsed
    at reception. After a long silence nearly any step is reachable.
    """
    time = max(elapsed, 0.0) + settings.feedback_timeout
    return abs(step) <= SLACK * settings.max_speed * time + 0.5 * math.pi
