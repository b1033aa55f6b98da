"""Checks shared by the codecs: settings, setpoints, and the plausibility of reported positions."""

import math
from dataclasses import replace

from omniman_ros.can_drives.axis import AxisSettings, DriveSetpoint
from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.core.errors import ParameterError

#: Ratio of a speed that a shaft certainly cannot reach to its largest speed
IMPOSSIBLE_SPEED = 3.0


def require_positive(settings: AxisSettings, *names: str) -> None:
    """Raise ParameterError unless settings by which a codec divides are finite and above zero."""
    for name in names:
        value = getattr(settings, name)
        if not (math.isfinite(value) and value > 0.0):
            raise ParameterError(f"{settings.name}.{name}", value, "must be finite and above zero")


def clip_setpoint(setpoint: DriveSetpoint, settings: AxisSettings) -> DriveSetpoint:
    """Clip speed and torque, not voltage; raise ValueError if the setpoint is not finite."""
    value, torque = setpoint.value, setpoint.feedforward
    if not (math.isfinite(value) and math.isfinite(torque)):
        raise ValueError(f"setpoint of {settings.name} must be finite: {value}, {torque}")
    limits = {DriveMode.VELOCITY: settings.max_speed, DriveMode.TORQUE: settings.max_torque}
    limit = limits.get(setpoint.mode, math.inf)
    return replace(
        setpoint,
        value=min(max(value, -limit), limit),
        feedforward=min(max(torque, -settings.max_torque), settings.max_torque),
    )


def is_reachable(step: float, elapsed: float, settings: AxisSettings) -> bool:
    """Return whether a shaft can rotate by a step [rad] between reports `elapsed` [s] apart.

    Reports may be late: each may be as old as the feedback timeout, on top of the time that
    elapsed between the receptions. After a long silence nearly any step is reachable.
    """
    longest_time = max(elapsed, 0.0) + settings.feedback_timeout
    return abs(step) <= IMPOSSIBLE_SPEED * settings.max_speed * longest_time + 0.5 * math.pi
