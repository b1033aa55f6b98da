"""Wheel controllers for drives without a velocity loop: PI feedback on computed torque.

Source: CCTA 2017 V.B: "feed back control using the wheel encoders plus optional calculated
torque feed forward control".
"""

from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated


@dataclass(frozen=True)
class WheelGains(Validated):
    """Gains of the wheel controllers, for torque and voltage mode only."""

    bandwidth: float = parameter(
        15.0, "Bandwidth of the speed loop: P gain over inertia.", unit="rad/s", low=0, high=500
    )
    integral_time: float = parameter(
        0.2, "Integral time of the speed loop, 0 for no integral part.", unit="s", low=0, high=100
    )


class WheelController:
    """Controls wheel speeds by torques: tau = tau_ff + W (b e + b/Ti integral of e).

    This is PI control of the speed error e, in accelerations. W is the inertia that the wheels
    feel (PlatformDynamics.wheel_inertia), so motions of the platform and motions against the
    constraints get the same bandwidth b.
    """

    def __init__(self, inertia: Array, torque_limit: Array, gains: WheelGains) -> None:
        self._integral: Array = np.zeros(len(torque_limit))
        self.configure(inertia, torque_limit, gains)

    def configure(self, inertia: Array, torque_limit: Array, gains: WheelGains) -> None:
        """Set inertia (n, n) [kg m^2], torque limits (n,) [N m] and gains; keep the integral."""
        self._inertia = inertia
        self._limit = torque_limit
        self._gains = gains

    def reset(self) -> None:
        """Set the integral part to zero."""
        self._integral = np.zeros_like(self._integral)

    def torque(
        self,
        reference: Array,
        measured: Array,
        feed_forward: Array,
        dt: float,
        limits: tuple[Array, Array] | None = None,
    ) -> Array:
        """Return torques (n,) [N m] within the limits; saturated wheels do not wind up.

        Args:
            reference: Demanded wheel speeds (n,) [rad/s].
            measured: Measured wheel speeds (n,) [rad/s].
            limits: Smallest and largest torques (n,) [N m] if they are tighter than those of the
                current limit, else None.
        """
        g = self._gains
        error = reference - measured
        unlimited = feed_forward + self._inertia @ (g.bandwidth * error + self._integral)
        low, high = (-self._limit, self._limit) if limits is None else limits
        torque = np.clip(unlimited, low, high)
        if g.integral_time > 0.0:
            winding = (unlimited != torque) & (error * unlimited > 0.0)
            step = (g.bandwidth / g.integral_time * dt) * error
            self._integral = self._integral + np.where(winding, 0.0, step)
        else:
            self.reset()
        result: Array = torque
        return result
