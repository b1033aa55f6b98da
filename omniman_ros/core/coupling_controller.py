"""Coupling controller: keeps the wheels within the platform's motion constraints.

Source: CCTA 2017 (12), (24), (25), with J_a corrected (its last columns are T+).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.kinematics import PlatformKinematics
from omniman_ros.core.parameters import parameter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CouplingParameters:
    """Gain and authority of the coupling controller."""

    k_epsilon: float = parameter(
        15.0, "Gain k_epsilon of the coupling error, 0 for off; the paper's value is 2.",
        unit="1/s", low=0, high=50,
    )  # fmt: skip
    authority: float = parameter(
        0.2, "Largest correction of a wheel over the fastest wheel's reference speed.",
        low=0, high=1,
    )  # fmt: skip


class CouplingController:
    """epsilon'_c = -k_epsilon epsilon, fed to the wheels through J_a.

    The default gain is chosen by `omniman reproduce coupling`: nine tenths of the error go, and
    with wheels off the floor (where nothing else damps) it settles though commands come 50 ms
    late; 30 oscillates. There is no integral part on purpose: drives have one, and with two
    epsilon oscillates against the floor and slips more. Epsilon is forgotten at
    rest: wheels that have slipped stay where they are, to turn them back would be slip again.

    Attributes:
        error: (m,) epsilon since the last stop, integrated from the encoders [rad].
    """

    def __init__(self, kinematics: PlatformKinematics, parameters: CouplingParameters) -> None:
        self.error: Array = np.zeros(kinematics.constraint_count)
        self.configure(kinematics, parameters)

    def configure(self, kinematics: PlatformKinematics, parameters: CouplingParameters) -> None:
        """Take over kinematics of the same wheels and new parameters; the error stays."""
        self._spread = kinematics.T_pinv
        self._parameters = parameters

    def add(self, step: Array) -> None:
        """Integrate a step (m,) of the coupling error [rad], CCTA (24)."""
        self.error = self.error + step

    def reset(self) -> None:
        """Forget the error: the platform stands, its wheels have settled where they are."""
        self.error = np.zeros_like(self.error)

    def correction(self, wheel_speeds: Array) -> Array:
        """Change (n,) of the wheels' reference speeds (n,) [rad/s], CCTA (25) through J_a (14).

        It is bounded by the authority, all wheels by one factor, so that it fades with the
        speed, never moves a platform at rest, and never makes up a motion of the platform.
        """
        rate = -self._parameters.k_epsilon * self.error
        change: Array = self._spread @ rate
        largest = float(np.abs(change).max())
        bound = self._parameters.authority * float(np.abs(wheel_speeds).max())
        return change * (bound / largest) if largest > bound else change
