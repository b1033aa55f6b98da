"""Coupling controller: it keeps the wheels within the platform's motion constraints.

Source: CCTA 2017 (12), (24), (25), with J_a corrected (its last columns are T+).

(12) holds for wheels that touch the floor in their middle. The contact of a wheel with rollers
moves along its axle, from one end of a roller to the other, and starts anew with the next roller.
Where the next one takes over late, the mean contact is off the wheel's middle, by a way in
proportion to the wheel's speed. On a platform that rotates, such a contact has another velocity:
the wheels then roll without slip while epsilon grows. Coupling control that holds it makes the
wheels push against each other.
"""

from dataclasses import dataclass

import numpy as np

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated


@dataclass(frozen=True)
class CouplingParameters(Validated):
    """Gain and authority of the coupling controller, and what epsilon it expects."""

    k_epsilon: float = parameter(
        15.0,
        "Gain k_epsilon of the coupling error, 0 for off. The paper's 2 with its (18) as printed "
        "acts like 2 * 4 / r, 63 for a radius r of 0.127 m. Where wheels lose the floor, late "
        "commands make a high gain oscillate: 63 from 20 ms on, 30 from 50 ms, 15 from 100 ms.",
        unit="1/s",
        low=0,
        high=1600,
    )
    authority: float = parameter(
        0.2,
        "Largest correction of a wheel over the fastest wheel's reference speed.",
        low=0,
        high=1,
    )
    reset_at_rest: bool = parameter(
        True,
        "Whether the controlled error starts anew at each rest; if not, it is the paper's (24), "
        "integrated from the start without resets.",
    )
    roller_lag: float = parameter(
        0.0,
        "Time by which the rollers take over late. A wheel's mean contact is off its middle by "
        "what its rim moves in this time, so that the coupling error of a platform that rotates "
        "changes without slip. The controller expects this change, commands it, and controls the "
        "rest. 0 for wheels that touch the floor in their middle.",
        unit="s",
        low=0,
        high=0.2,
    )


class CouplingController:
    """Reduces the coupling error: epsilon'_c = -k_epsilon epsilon, fed to the wheels through J_a.

    The default gain was chosen by `omniman reproduce coupling`: it removes nine tenths of the
    error, and with wheels off the floor (where nothing else damps) the loop settles although
    commands come 50 ms late; a gain of 30 oscillates. There is deliberately no integral part:
    drives have one, and with two epsilon oscillates against the floor and slips more. Unless the
    parameters say otherwise, epsilon is reset at rest: wheels that have slipped stay where they
    are, as to rotate them back would be slip again. `Odometry.coupling_error` is (24) without
    resets, and with what the rollers' lag adds.

    Attributes:
        error: Controlled coupling error epsilon (m,), integrated from the encoders since the last
            reset, less the expected one [rad].
    """

    def __init__(self, kinematics: PlatformKinematics, parameters: CouplingParameters) -> None:
        self.error: Array = np.zeros(kinematics.constraint_count)
        self.configure(kinematics, parameters)

    def configure(self, kinematics: PlatformKinematics, parameters: CouplingParameters) -> None:
        """Set kinematics of the same wheels and new parameters; the error is kept."""
        self._spread = kinematics.T_pinv
        self._lag = parameters.roller_lag * kinematics.T * kinematics.roller_side
        self._parameters = parameters

    def expected_rate(self, wheel_speeds: Array, yaw_rate: float) -> Array:
        """Return the rate (m,) of epsilon at which wheels with rollers roll without slip [rad/s].

        With the lag t, the mean contact of a wheel of radius r and speed phi' is to the right of
        its middle by t s r phi', where s = +-1 is the sign of its roller angle. On a platform that
        rotates with w, (8) then gives the wheel t s phi' w more speed; epsilon' is T times that.
        """
        rate: Array = yaw_rate * (self._lag @ wheel_speeds)
        return rate

    def add(self, step: Array) -> None:
        """Integrate a step (m,) of the coupling error, less the expected one [rad], CCTA (24)."""
        self.error = self.error + step

    def reset(self) -> None:
        """Set the error to zero."""
        self.error = np.zeros_like(self.error)

    def rest(self) -> None:
        """Reset the error, if it starts anew at rest: the wheels have settled where they are."""
        if self._parameters.reset_at_rest:
            self.reset()

    def correction(self, wheel_speeds: Array, yaw_rate: float = 0.0) -> Array:
        """Return the correction (n,) of wheel speeds [rad/s], CCTA (25) through J_a (14).

        The authority bounds it with one factor for all wheels, so that it fades with the speed,
        never moves a platform at rest, and never adds a motion of the platform.
        """
        p = self._parameters
        rate = self.expected_rate(wheel_speeds, yaw_rate) - p.k_epsilon * self.error
        change: Array = self._spread @ rate
        largest = float(np.abs(change).max())
        bound = p.authority * float(np.abs(wheel_speeds).max())
        return change * (bound / largest) if largest > bound else change
