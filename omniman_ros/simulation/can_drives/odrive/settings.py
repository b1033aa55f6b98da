"""Settings of a simulated ODrive axis."""

import math
from dataclasses import dataclass, fields

from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.can_drives.firmware import require_above


@dataclass(frozen=True, kw_only=True)
class OdriveSettings:
    """Settings with which an ODrive axis was commissioned.

    Raises:
        ParameterError: A number is negative or not finite, or the torque constant is 0.
    """

    torque_constant: float  #: Torque constant of the motor [N m/A]
    heartbeat: float = 0.1  #: Period of the heartbeat [s]; 0 if it is never sent
    encoder: float = 0.01  #: Period of the encoder estimates [s]; 0 if sent only on request
    iq: float = 0.0  #: Period of the current reports [s]; 0 if they are sent only on request
    bus: float = 0.0  #: Period of the supply reports [s]; 0 if they are sent only on request
    watchdog: float = 0.1  #: Timeout of the watchdog [s]; 0 if there is none
    #: Whether the watchdog also runs while the axis is idle, as in firmware 0.5. The vendor's
    #: examples for 0.6 arm the axis after any time without frames, without clearing errors.
    watchdog_when_idle: bool = False
    velocity_limit: float = 1000.0  #: Velocity limit until the host sets it [rev/s]
    current_limit: float = 1000.0  #: Current limit until the host sets it [A]
    velocity_ramp: float = 1.0  #: Rate of the ramped velocity mode [rev/s^2]
    torque_ramp: float = 0.01  #: Rate of the ramped torque mode [N m/s]
    min_supply: float = 10.0  #: Supply voltage below which there is an error [V]
    brake_deceleration: float = 0.0  #: Deceleration of a mechanical brake [rad/s^2]; 0: none
    boot_time: float = 1.0  #: Time after a restart in which no frame is received or sent [s]
    position: float = 0.0  #: Position at power-up [rev]; a restart sets it to 0

    def __post_init__(self) -> None:
        require_above("torque_constant", self.torque_constant, inclusive=False)
        if not math.isfinite(self.position):
            raise ParameterError("position", self.position, "must be finite")
        for field in fields(self):
            if field.name != "position":
                require_above(field.name, getattr(self, field.name))
