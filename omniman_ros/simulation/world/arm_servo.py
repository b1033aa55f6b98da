"""The servo of the arm's joints."""

from collections.abc import Sequence

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.description.ur5 import EFFORTS
from omniman_ros.simulation.world.engine import Engine

BANDWIDTH = 200.0
"""Angular frequency of the closed position loop, critically damped [rad/s]."""


class ArmServo:
    """Moves the arm's joints to their setpoints: computed torque with a position loop.

        torque = M (w^2 (setpoint - q) - 2 w q') + bias,     within the joints' limits

    Each joint follows as a critically damped system of second order at w = BANDWIDTH, with a lag
    of 2 / w = 10 ms. `bias` holds gravity and Coriolis forces. As no force acts from outside, the
    platform carries the arm and feels its reaction.

    Args:
        engine: The engine.
        joints: Names of the joints.

    Attributes:
        torques: Torques of the joints in the latest step [N m], (6,).
    """

    def __init__(self, engine: Engine, joints: Sequence[str]) -> None:
        self._engine = engine
        first, start = engine.dof(joints[0]), engine.coordinate(joints[0])
        self.dofs = slice(first, first + len(joints))
        self._coordinates = slice(start, start + len(joints))
        self._limits = np.array(EFFORTS)
        self._setpoint = self.positions
        self.torques: Array = np.zeros(len(joints))

    @property
    def positions(self) -> Array:
        """Angles of the joints [rad], (6,)."""
        return self._engine.coordinates[self._coordinates].copy()

    @property
    def velocities(self) -> Array:
        """Speeds of the joints [rad/s], (6,)."""
        return self._engine.velocities[self.dofs].copy()

    def command(self, positions: Sequence[float] | Array) -> None:
        """Set the setpoint of the joints' angles [rad], (6,).

        Raises:
            InputError: They are not six finite numbers; the setpoint stays.
        """
        self._setpoint = self._checked(positions)

    def place(self, positions: Sequence[float] | Array) -> None:
        """Put the joints, at rest, at angles [rad], (6,), and hold them there.

        Raises:
            InputError: They are not six finite numbers; nothing moves.
        """
        self._setpoint = self._checked(positions)
        self._engine.coordinates[self._coordinates] = self._setpoint
        self._engine.velocities[self.dofs] = 0.0
        self._engine.refresh()

    def _checked(self, positions: Sequence[float] | Array) -> Array:
        """Return angles as an array of its own."""
        values = np.array(positions, dtype=np.float64)
        if values.shape != self._limits.shape or not np.isfinite(values).all():
            raise InputError(f"the arm's angles must be six finite numbers, not {positions!r}")
        return values

    def update(self) -> None:
        """Set the torques of the next step."""
        engine = self._engine
        error = self._setpoint - engine.coordinates[self._coordinates]
        rate = engine.velocities[self.dofs]
        demanded = BANDWIDTH * (BANDWIDTH * error - 2.0 * rate)
        torques = engine.inertia(self.dofs) @ demanded + engine.bias[self.dofs]
        self.torques = np.clip(torques, -self._limits, self._limits)
        engine.applied[self.dofs] = self.torques
