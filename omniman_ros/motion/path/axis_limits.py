"""Limits of single axes, and checks that a motion keeps them."""

from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.validated import Validated
from omniman_ros.motion.path.axis_group import AxisGroup
from omniman_ros.motion.path.time_profile import SpeedCap
from omniman_ros.motion.path.timed_curve import TimedCurve

ROUND_OFF = 1e-6  #: Relative excess over a limit that counts as round-off
#: Name of each derivative, and the suffix of its unit after that of the position
QUANTITIES = (("position", ""), ("velocity", "/s"), ("acceleration", "/s^2"), ("jerk", "/s^3"))


@dataclass(frozen=True)
class AxisLimits(Validated):
    """Names and limits of d axes; the limits are read-only arrays (d,).

    Attributes:
        lower, upper: Range of the positions [rad or m].
        velocity, acceleration, jerk: Limits of the absolute values [the same per s, s^2, s^3].

    Raises:
        InputError: A limit has not one finite number for each axis, or is not above 0.
    """

    names: tuple[str, ...]  #: Names of the axes
    lower: Annotated[Array, Shape("d")]
    upper: Annotated[Array, Shape("d")]
    velocity: Annotated[Array, Shape("d")]
    acceleration: Annotated[Array, Shape("d")]
    jerk: Annotated[Array, Shape("d")]
    units: tuple[str, ...]  #: Units of the positions, for messages

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.lower) != len(self.names):
            raise InputError(f"AxisLimits has {len(self.lower)} limits for the axes {self.names}")
        for label in ("velocity", "acceleration", "jerk"):
            if not (getattr(self, label) > 0.0).all():
                limits = getattr(self, label).tolist()
                raise InputError(f"AxisLimits.{label} = {limits} is refused: must be above 0")

    @classmethod
    def of_arm(cls, arm: ArmParameters) -> Self:
        """Create the limits of the arm's joints."""
        lower, upper, velocity, acceleration, jerk = (
            np.array(arm.each(label))
            for label in ("lower", "upper", "velocity", "acceleration", "jerk")
        )
        units = ("rad",) * len(arm.joints)
        return cls(arm.joints, lower, upper, velocity, acceleration, jerk, units)

    def groups(self, scale: float, tolerance: float) -> tuple[AxisGroup, ...]:
        """Return each axis as a group of its own.

        Args:
            scale: Fraction of the limits on velocity, acceleration and jerk.
            tolerance: Tolerance at corners [rad or m].
        """
        rows = zip(*(scale * np.stack([self.velocity, self.acceleration, self.jerk])), strict=True)
        return tuple(AxisGroup((i,), *row, tolerance) for i, row in enumerate(map(_floats, rows)))

    def speed_cap(self, scale: float) -> SpeedCap | None:
        """Return a bound on u' beside those of the groups, for scaled limits; here none."""
        return None

    def require_within(self, positions: Array) -> None:
        """Require that positions (k, d) are within the limits.

        Raises:
            InputError: A position is beyond a limit; the message names the axis, the point and the
                limit.
        """
        for i, row in enumerate(positions):
            low, high = self._bounds(0, 1.0)
            for k in np.flatnonzero(~((row >= low) & (row <= high))):
                limit = high[k] if row[k] > high[k] else low[k]
                raise InputError(
                    f"{self.names[k]}: position {row[k]:.6g} {self.units[k]} of point {i}, "
                    f"the limit is {limit:g} {self.units[k]}"
                )

    def require_kept(self, curve: TimedCurve, jerk_scale: float) -> None:
        """Require that a motion keeps all limits at every instant.

        Raises:
            InputError: The motion violates a limit; the message names the axis, the time, the
                value and the limit.
        """
        for order, (times, values) in enumerate(curve.extremes()):
            low, high = self._bounds(order, jerk_scale if order == 3 else 1.0)
            slack = ROUND_OFF * (high - low)
            within = (values >= low - slack) & (values <= high + slack)
            if within.all():
                continue
            # Report the value that is furthest beyond its limit.
            excess = np.maximum(values - high, low - values) / (high - low)
            excess[np.isnan(excess)] = np.inf
            row, piece, k = np.unravel_index(int(excess.argmax()), excess.shape)
            value, word, unit = values[row, piece, k], *QUANTITIES[order]
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
