"""Limits of the arm's safety system, whose violation is a protective stop."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.simulation.ur.arm import CYCLE, UrArmParameters
from omniman_ros.simulation.ur.arm_body import ArmBody


@dataclass(frozen=True)
class Violation:
    """Exceeded limit."""

    reason: str  #: Which limit is exceeded, and the values
    is_hindered: bool  #: Whether something keeps the joints from their reference in any case


class SafetyChecks:
    """Compares the arm with its limits, once per cycle."""

    def __init__(self, parameters: UrArmParameters) -> None:
        self._parameters = parameters
        self._collision_cycles = math.ceil(parameters.collision_time / CYCLE - 1e-9)
        self._exceeding = np.zeros(len(parameters.collision_torque), dtype=np.intp)

    def violation(self, arm: ArmBody, target: Array) -> Violation | None:
        """Return which limit is exceeded, or None; the reference follows `target` (6,) [rad]."""
        p = self._parameters
        # A joint beyond its range may move back.
        outward = np.where(arm.q * arm.qd > 0.0, np.abs(arm.q), 0.0)
        deviation = np.abs(target - arm.reference.q + arm.lost_motion)
        checks = (
            ("position", "rad", outward, p.range),
            ("speed", "rad/s", np.abs(arm.qd), p.speed),
            ("deviation", "rad", deviation, p.deviation),
        )
        torque = np.abs(arm.unexpected_torque)
        self._exceeding = np.where(torque > p.collision_torque, self._exceeding + 1, 0)
        is_deviating = not np.all(deviation <= p.deviation)
        is_hindered = bool(is_deviating or np.any(self._exceeding))
        for name, unit, values, limit in checks:
            # Negated, so that NaN violates the limit.
            bad = np.flatnonzero(~(values <= limit))
            if bad.size:
                k = int(bad[0])
                text = f"{name} of joint {k}: {values[k]:.3f} above {limit:.3f} {unit}"
                return Violation(text, is_hindered)
        colliding = np.flatnonzero(self._exceeding >= self._collision_cycles)
        if colliding.size:
            k = int(colliding[0])
            text = f"collision detected by joint {k}: {torque[k]:.1f} N m that no motion explains"
            return Violation(text, is_hindered=True)
        return None
