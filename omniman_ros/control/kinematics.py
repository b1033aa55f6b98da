"""Kinematics of a platform with n >= 3 Mecanum or Omni wheels, motion constraints included.

Source: CCTA 2017, section III, equations (2) to (14). The matrices are computed for any wheels;
the paper's closed forms (15) to (18) hold for the symmetric platform of four equal wheels only.
"""

import math
from collections.abc import Collection
from typing import Any

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import GeometryError, InputError
from omniman_ros.core.platform import Wheels

#: Smallest pivot of J that adds to its rank (J normalised, lengths scaled by the platform's size)
RANK_TOLERANCE = 1e-6
#: Smallest accepted cos(gamma): at 90 degrees a wheel cannot drive; 1.57 rad counts as 90
ROLLER_TOLERANCE = 0.01
#: Fraction of J's smallest singular value (lengths scaled) that the remaining wheels must keep. In
#: the worst direction, a force takes up to 1 / share times the wheel torque that it takes with all
#: wheels, and slip moves the odometry as much farther. On the plant, wheels that keep 0.2 cannot
#: follow a twist at the limits even in velocity mode; wheels that keep 0.26 can.
MIN_REMAINING_FRACTION = 0.25
#: Magnitude of an entry of T from which the constraint depends on the wheel [-]
CONSTRAINED_ENTRY = 1e-6


def wheel_row(x: float, y: float, heading: float, roller_angle: float, radius: float) -> Array:
    """Return one wheel's row of the inverse Jacobian, CCTA 2017 (8).

    phi' = (cos(d+g), sin(d+g), x sin(d+g) - y cos(d+g)) . (x'_R, y'_R, theta') / (r cos g)

    Args:
        x: Position of the contact in base_link, forward [m].
        y: Position of the contact in base_link, left [m].
        heading: Rolling direction d in base_link [rad].
        roller_angle: Roller angle g [rad], 0 for an Omni wheel.
        radius: Wheel radius r [m].

    Returns:
        Row (3,) [1/m, 1/m, 1].
    """
    c, s = math.cos(heading + roller_angle), math.sin(heading + roller_angle)
    return np.array([c, s, x * s - y * c]) / (radius * math.cos(roller_angle))


class PlatformKinematics:
    """Converts between n wheel speeds and the twist with m = n - 3 constraint rates.

    Attributes (read-only arrays):
        J: (n, 3) inverse Jacobian, phi' = J x'_R, CCTA (9).
        J_pinv: (3, n) least-squares forward Jacobian J+, CCTA (3).
        T: (m, n) motion constraints, T phi' = 0, CCTA (11). Its columns for the three wheels that
            span J hold J_m J_3^-1, the others -I.
        T_pinv: (n, m) right inverse of T; the last m columns of J_a.
        J_a: (n, n) augmented inverse Jacobian (J, T+), CCTA (14), corrected.
        J_a_inv: (n, n) augmented forward Jacobian (J+ ; T), CCTA (13).
        base_wheels: Indices of the three wheels that span J, found by pivoting.
        idle: Indices of wheels that only the floor rotates: least squares and constraints leave
            them out. Their columns of J+ and T and rows of T+ are zero; T keeps its m rows, the
            last of which are zero, and J_a is then not invertible.
        roller_side: Side (n,) to which each wheel's rollers lean: the sign of gamma, 0 for Omni
            wheels.
        unconstrained: Indices of wheels that drive, but that no constraint depends on: their slip
            does not show. With three wheels all are, with four some may be.

    Raises:
        InputError: An idle wheel is none of the n.
        GeometryError: A wheel cannot drive (gamma at +-90 degrees), or the wheels together cannot
            move the platform in all three directions (rank of J below 3).
    """

    def __init__(self, wheels: Wheels, idle: Collection[int] = ()) -> None:
        n = len(wheels.names)
        self.idle = tuple(sorted(idle))
        if not set(self.idle) <= set(range(n)):
            raise InputError(f"idle wheels {self.idle} are not indices from 0 to {n - 1}")
        for name, gamma in zip(wheels.names, wheels.roller_angle, strict=True):
            if abs(math.cos(gamma)) < ROLLER_TOLERANCE:
                raise GeometryError(
                    f"wheel '{name}': roller angle {gamma:.4f} rad is +-90 degrees, "
                    "such a wheel cannot drive the platform",
                    name,
                )
        rows = zip(
            wheels.x, wheels.y, wheels.heading, wheels.roller_angle, wheels.radius, strict=True
        )
        self.J = _frozen(np.array([wheel_row(*row) for row in rows]))
        self.roller_side = _frozen(np.sign(wheels.roller_angle))
        self._size = max(map(math.hypot, wheels.x, wheels.y)) or 1.0
        self.base_wheels = self._independent_rows(wheels)
        base = list(self.base_wheels)
        others = [i for i in range(n) if i not in base and i not in self.idle]
        rows_used = range(len(others))
        constraints = np.zeros((n - 3, n))
        constraints[np.ix_(rows_used, base)] = np.linalg.solve(self.J[base].T, self.J[others].T).T
        constraints[rows_used, others] = -1.0
        self.T = _frozen(constraints)
        driven = [i for i in range(n) if i not in self.idle]
        forward, spread = np.zeros((3, n)), np.zeros((n, n - 3))
        forward[:, driven] = np.linalg.pinv(self.J[driven])
        if others:
            active = constraints[np.ix_(rows_used, driven)]
            spread[np.ix_(driven, rows_used)] = np.linalg.pinv(active)
        constrained = np.abs(constraints).max(axis=0, initial=0.0) > CONSTRAINED_ENTRY
        self.unconstrained = tuple(i for i in driven if not constrained[i])
        self.J_pinv, self.T_pinv = _frozen(forward), _frozen(spread)
        self.J_a = _frozen(np.hstack([self.J, self.T_pinv]))
        self.J_a_inv = _frozen(np.vstack([self.J_pinv, self.T]))

    @property
    def wheel_count(self) -> int:
        """Number of wheels n."""
        return int(self.J.shape[0])

    @property
    def constraint_count(self) -> int:
        """Number of motion constraints m = n - 3."""
        return int(self.T.shape[0])

    def remaining_fraction(self, idle: Collection[int]) -> float:
        """Return the fraction of J's smallest singular value that is left without some wheels.

        Lengths are scaled by the platform's size. Four equal Mecanum wheels keep 0.54 without one
        of them. The count does not tell: of eight wheels, the four with parallel rollers keep 0.
        The share is 0 if the other wheels do not determine the twist.
        """
        scaled = self.J * [1.0, 1.0, 1.0 / self._size]
        remaining = np.delete(scaled, sorted(idle), axis=0)
        if len(remaining) < 3:
            return 0.0
        smallest = [np.linalg.svd(rows, compute_uv=False)[2] for rows in (remaining, scaled)]
        return float(smallest[0] / smallest[1])

    def _independent_rows(self, wheels: Wheels) -> tuple[int, int, int]:
        """Return three independent rows of J, found by pivoting (Gram-Schmidt, largest first)."""
        rest = self.J * [1.0, 1.0, 1.0 / self._size] / np.linalg.norm(self.J, axis=1).max()
        rest[list(self.idle)] = 0.0
        chosen: list[int] = []
        for _ in range(3):
            lengths = np.linalg.norm(rest, axis=1)
            lengths[chosen] = -1.0
            # The first of equals, so that the choice does not depend on round-off.
            pivot = int(np.argmax(lengths >= lengths.max() * (1 - 1e-9)))
            if lengths[pivot] < RANK_TOLERANCE:
                raise GeometryError(
                    f"the wheels {', '.join(wheels.names)} move the platform in {len(chosen)} "
                    f"independent directions only (rank of J < 3); '{wheels.names[pivot]}' adds "
                    "none: change the headings of the wheels or their roller angles",
                    wheels.names[pivot],
                )
            chosen.append(pivot)
            direction = rest[pivot] / lengths[pivot]
            rest = rest - np.outer(rest @ direction, direction)
        first, second, third = sorted(chosen)
        return first, second, third


def _frozen(array: Any) -> Array:
    frozen: Array = np.ascontiguousarray(array, dtype=np.float64)
    frozen.setflags(write=False)
    return frozen
