"""Motion that the arm's joints are told to make: from setpoint to setpoint, and to rest."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.simulation.arm_link.frames import ArmSetpoint

COASTING_TIME = 0.016  #: Time after the last setpoint for which speeds are kept [s]: two cycles
DECELERATION = 15.0  #: Deceleration of the fastest joint without setpoints [rad/s^2]
TIME_TOLERANCE = 1e-6  #: Time before an instant at which it counts as reached [s]
MAX_OFFSET = 2.0  #: Largest time by which a setpoint may be ahead or late [s]


@dataclass(frozen=True)
class _Way:
    """Cubic polynomials of time; position, velocity, acceleration and jerk at the beginning."""

    begin: float
    position: Array
    velocity: Array
    acceleration: Array
    jerk: Array

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """Return angles, speeds and accelerations at a time [s]."""
        s = time - self.begin
        acceleration = self.acceleration + s * self.jerk
        middle = self.acceleration + (0.5 * s) * self.jerk
        velocity = self.velocity + s * middle
        third = self.acceleration + (s / 3.0) * self.jerk
        return self.position + s * (self.velocity + (0.5 * s) * third), velocity, acceleration


class ArmReference:
    """Passes each setpoint's angles at its speeds and at its instant.

    Between two setpoints, each angle is a cubic polynomial of time. Where the acceleration is
    constant from one setpoint to the next, so is the reference's. Without a next setpoint, the
    joints keep their speeds for :data:`COASTING_TIME`, and then brake on their path.

    Args:
        positions: Angles (6,) [rad].
    """

    def __init__(self, positions: Array) -> None:
        self._queue: deque[ArmSetpoint] = deque()
        self._way: _Way | None = None
        self._time, self._last_due = 0.0, 0.0
        self.place(positions)

    def place(self, positions: Sequence[float] | Array) -> None:
        """Rest at angles (6,) [rad] from now on, and forget all setpoints."""
        self._queue.clear()
        self._way = None
        self.positions: Array = np.array(positions, dtype=np.float64)  #: Angles (6,) [rad]
        self.velocities: Array = np.zeros_like(self.positions)  #: Speeds (6,) [rad/s]
        #: Accelerations (6,) [rad/s^2]
        self.accelerations: Array = np.zeros_like(self.positions)
        self.is_braked = False  #: Whether the brakes are on

    def abandon(self) -> None:
        """Forget all setpoints, and brake at once; the brakes stay as they are."""
        self._queue.clear()
        self._way = None
        self._last_due = self._time - COASTING_TIME

    def add(self, setpoint: ArmSetpoint) -> None:
        """Take a setpoint, whose time is that of :meth:`advance`.

        Raises:
            InputError: It is not due after the last one, or more than :data:`MAX_OFFSET` from
                now.
        """
        if self._queue and setpoint.due <= self._queue[-1].due:
            raise InputError(f"setpoint {setpoint.sequence} is due before the one before it")
        lead = setpoint.due - self._time
        if abs(lead) > MAX_OFFSET:
            raise InputError(
                f"setpoint {setpoint.sequence} is due in {lead:.3f} s: the controller's time "
                "is another one"
            )
        self._queue.append(setpoint)

    def advance(self, time: float) -> None:
        """Move on to a time [s]."""
        begin, self._time = self._time, time
        while self._queue and self._queue[0].due <= time + TIME_TOLERANCE:
            passed = self._queue.popleft()
            self.positions = np.array(passed.positions)
            self.velocities = np.array(passed.velocities)
            begin = self._last_due = passed.due
            self.is_braked = passed.braked
            self._way = None
        if self._queue:
            if self._way is None:
                self._way = self._way_to(self._queue[0], begin)
            self.positions, self.velocities, self.accelerations = self._way.at(time)
        elif time - self._last_due <= COASTING_TIME:
            self._move(np.zeros_like(self.velocities), time - begin)
        else:
            self._brake(time - begin)

    def _way_to(self, goal: ArmSetpoint, begin: float) -> _Way:
        """Return the way to a setpoint from the present state, which is that at `begin` [s]."""
        duration = goal.due - begin
        end, end_rate = np.array(goal.positions), np.array(goal.velocities)
        if goal.begins_anew:
            self.positions, self.velocities = end - duration * end_rate, end_rate
        self.is_braked = goal.braked
        mean = (end - self.positions) / duration
        start_rate = self.velocities
        # The cubic with these angles and speeds at both ends.
        acceleration = (6.0 * mean - 4.0 * start_rate - 2.0 * end_rate) / duration
        jerk = 6.0 * (start_rate + end_rate - 2.0 * mean) / duration**2
        return _Way(begin, self.positions, start_rate, acceleration, jerk)

    def _brake(self, step: float) -> None:
        if not self.velocities.any():
            self.accelerations = self.velocities
            return
        fastest = float(np.abs(self.velocities).max())
        fraction = max(0.0, 1.0 - DECELERATION * step / fastest)
        if step > 0.0:
            self._move((fraction - 1.0) / step * self.velocities, step)
        if not fraction:
            self.velocities = np.zeros_like(self.velocities)
            self.accelerations = np.zeros_like(self.velocities)

    def _move(self, accelerations: Array, step: float) -> None:
        self.accelerations = accelerations
        self.positions = self.positions + step * (self.velocities + 0.5 * step * accelerations)
        self.velocities = self.velocities + step * accelerations
