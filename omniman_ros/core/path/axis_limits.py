"""Limits of single axes, and whether a motion keeps them."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.path.axes import AxisGroup
from omniman_ros.core.path.time_profile import SpeedCap
from omniman_ros.core.path.timed_curve import TimedCurve

Array = NDArray[np.float64]

ROUND_OFF = 1e-6
"""Share by which a limit may be passed."""
WORDS = (("position", ""), ("velocity", "/s"), ("acceleration", "/s^2"), ("jerk", "/s^3"))


@dataclass(frozen=True)
class AxisLimits:
    """Names and limits of d axes, arrays (d,).

    Attributes:
        names: Of the axes.
        lower, upper: Positions [rad or m].
        velocity, acceleration, jerk: Largest amounts [the same per s, s^2, s^3].
        units: Of the positions, for messages.

    Raises:
        ParameterError: Not one number an axis, not finite, or a limit that is not positive.
    """

    names: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    units: tuple[str, ...]

    def __post_init__(self) -> None:
        for label in ("lower", "upper", "velocity", "acceleration", "jerk"):
            array = np.array(getattr(self, label), dtype=float)
            if array.shape != (len(self.names),) or not np.isfinite(array).all():
                raise ParameterError(label, array.tolist(), f"one number for each of {self.names}")
            if label not in ("lower", "upper") and not (array > 0.0).all():
                raise ParameterError(label, array.tolist(), "must be positive")
            array.flags.writeable = False
            object.__setattr__(self, label, array)

    @classmethod
    def of_arm(cls, arm: ArmParameters) -> Self:
        """Those of the arm's joints."""
        lower, upper, velocity, acceleration, jerk = (
            np.array(arm.each(label))
            for label in ("lower", "upper", "velocity", "acceleration", "jerk")
        )
        units = ("rad",) * len(arm.joints)
        return cls(arm.joints, lower, upper, velocity, acceleration, jerk, units)

    def groups(self, share: float, tolerance: float) -> tuple[AxisGroup, ...]:
        """Each axis alone, with a share of its limits and a tolerance at corners [rad or m]."""
        rows = zip(*(share * np.stack([self.velocity, self.acceleration, self.jerk])), strict=True)
        return tuple(AxisGroup((i,), *row, tolerance) for i, row in enumerate(map(_floats, rows)))

    def cap(self, share: float) -> SpeedCap | None:
        """Largest u' besides what the groups say, with a share of all limits; here none."""
        return None

    def demand_within(self, positions: Array) -> None:
        """Demand positions (k, d) within the limits.

        Raises:
            InputError: One is not; the message names the axis, the point and the limit.
        """
        for i, row in enumerate(positions):
            low, high = self._bounds(0, 1.0)
            for k in np.flatnonzero(~((row >= low) & (row <= high))):
                limit = high[k] if row[k] > high[k] else low[k]
                raise InputError(
                    f"{self.names[k]}: position {row[k]:.6g} {self.units[k]} of point {i}, "
                    f"the limit is {limit:g} {self.units[k]}"
                )

    def demand_kept(self, curve: TimedCurve, jerk_scale: float) -> None:
        """Demand that a motion keeps all limits at each instant.

        Args:
            curve: The motion.
            jerk_scale: So many times the largest jerk is allowed.

        Raises:
            InputError: It does not; the message names the axis, the time, the value and the
                limit.
        """
        for order, (times, values) in enumerate(curve.extremes()):
            low, high = self._bounds(order, jerk_scale if order == 3 else 1.0)
            slack = ROUND_OFF * (high - low)
            good = (values >= low - slack) & (values <= high + slack)
            if good.all():
                continue
            # The one that is furthest beyond, of all axes.
            over = np.maximum(values - high, low - values) / (high - low)
            over[np.isnan(over)] = np.inf
            row, piece, k = np.unravel_index(int(over.argmax()), over.shape)
            value, word, unit = values[row, piece, k], *WORDS[order]
            limit = high[k] if value > high[k] else low[k]
            raise InputError(
                f"{self.names[k]}: {word} {value:.4g} {self.units[k]}{unit} at "
                f"{times[row, piece, k]:.3f} s, the limit is {limit:.4g} {self.units[k]}{unit}"
            )

    def _bounds(self, order: int, scale: float) -> tuple[Array, Array]:
        if order == 0:
            return self.lower - ROUND_OFF, self.upper + ROUND_OFF
        high = scale * (self.velocity, self.acceleration, self.jerk)[order - 1]
        return -high, high


def _floats(row: tuple[float, ...]) -> tuple[float, float, float]:
    velocity, acceleration, jerk = row
    return float(velocity), float(acceleration), float(jerk)
