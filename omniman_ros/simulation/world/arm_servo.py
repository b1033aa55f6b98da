"""The servo of the arm's joints."""

from collections import deque
from collections.abc import Sequence

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.description.ur5 import EFFORTS
from omniman_ros.simulation.arm_link.frames import ArmSetpoint, ArmState
from omniman_ros.simulation.world.arm_reference import TIME_TOLERANCE, ArmReference
from omniman_ros.simulation.world.engine import Engine

BANDWIDTH = 200.0  #: Angular frequency of the closed position loop, critically damped [rad/s]


class ArmServo:
    """Moves the arm's joints along their reference: computed torque with a position loop.

        torque = M (r'' + w^2 (r - q) + 2 w (r' - q')) + bias,     within the joints' limits

    Each joint comes to its reference r as a critically damped system of second order at
    w = BANDWIDTH. `bias` holds gravity and Coriolis forces. As no force acts from outside, the
    platform carries the arm and feels its reaction. With the brakes on, the drives give no torque,
    and the joints have dry friction that withstands the drives' largest torques. Angles other than
    six finite numbers, and setpoints that are not due next, raise an InputError without effect.
    """

    def __init__(self, engine: Engine, joints: Sequence[str]) -> None:
        self._engine = engine
        first, start = engine.dof(joints[0]), engine.coordinate(joints[0])
        self.dofs = slice(first, first + len(joints))
        self._coordinates = slice(start, start + len(joints))
        self._limits = np.array(EFFORTS)
        self._lowest = -self._limits
        self._demanded: Array = np.zeros(len(engine.velocities))
        #: The motion that the joints are told to make; its time is the world's
        self.reference = ArmReference(self.positions)
        #: Torques of the drives in the latest step [N m], (6,)
        self.torques: Array = np.zeros(len(joints))
        self._impulse: Array = np.zeros(len(joints))
        self._time = self._measured_time = 0.0
        self._awaited: deque[tuple[int, float]] = deque()
        self._states: list[ArmState] = []

    @property
    def positions(self) -> Array:
        """Angles of the joints [rad], (6,)."""
        return self._engine.coordinates[self._coordinates].copy()

    @property
    def velocities(self) -> Array:
        """Speeds of the joints [rad/s], (6,)."""
        return self._engine.velocities[self.dofs].copy()

    def command(self, positions: Sequence[float] | Array) -> None:
        """Hold the joints at angles [rad], (6,), from now on, with the brakes off."""
        self.reference.place(self._checked(positions))

    def follow(self, setpoint: ArmSetpoint) -> None:
        """Be at a setpoint when it is due in the time of the world."""
        self.reference.add(setpoint)
        self._awaited.append((setpoint.sequence, setpoint.due))
        self._answer()

    def place(self, positions: Sequence[float] | Array) -> None:
        """Put the joints, at rest, at angles [rad], (6,), and hold them there."""
        self.command(positions)
        self._engine.coordinates[self._coordinates] = self.reference.positions
        self._engine.velocities[self.dofs] = 0.0
        self._engine.refresh()

    def _checked(self, positions: Sequence[float] | Array) -> Array:
        values = np.array(positions, dtype=np.float64)
        if values.shape != self._limits.shape or not np.isfinite(values).all():
            raise InputError(f"the arm's angles must be six finite numbers, not {positions!r}")
        return values

    def update(self, time: float) -> None:
        """Set the torques of the step that begins at a time of the world [s]."""
        engine, reference = self._engine, self.reference
        reference.advance(time)
        if reference.is_braked:
            self.torques = np.zeros_like(self._limits)
            friction: Array | float = self._limits
        else:
            error = reference.positions - engine.coordinates[self._coordinates]
            rate = reference.velocities - engine.velocities[self.dofs]
            # The other joints are held: their accelerations stay zero.
            self._demanded[self.dofs] = reference.accelerations + BANDWIDTH * (
                BANDWIDTH * error + 2.0 * rate
            )
            torques = engine.inertial_forces(self._demanded)[self.dofs] + engine.bias[self.dofs]
            self.torques = np.minimum(np.maximum(torques, self._lowest), self._limits)
            friction = 0.0
        engine.applied[self.dofs] = self.torques
        engine.dry_friction[self.dofs] = friction

    def measure(self, time: float) -> None:
        """Measure at the end of a step, which is at a time of the world [s]."""
        step = self._engine.step_time
        self._impulse = self._impulse + step * self.torques
        self._measured_time += step
        self._time = time
        self._answer()

    def _answer(self) -> None:
        while self._awaited and self._awaited[0][1] <= self._time + TIME_TOLERANCE:
            sequence, _ = self._awaited.popleft()
            self._states.append(self.state(sequence))

    def state(self, sequence: int = 0) -> ArmState:
        """Return what the joints measure now; the mean of the torques begins anew."""
        span = self._measured_time
        mean = self._impulse / span if span else self.torques
        self._impulse, self._measured_time = np.zeros_like(self.torques), 0.0
        rows = (self.positions, self.velocities, mean)
        return ArmState(sequence, *(tuple(row.tolist()) for row in rows))

    def take_states(self) -> list[ArmState]:
        """Return the states at the instants at which setpoints were due since the last call."""
        states, self._states = self._states, []
        return states

    def abandon(self) -> None:
        """Forget all setpoints, and brake: the controller is gone."""
        self.reference.abandon()
        self._awaited.clear()
        self._states.clear()
