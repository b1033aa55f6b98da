"""Controller core and simulated drives in one loop, in simulated time: two models, one robot."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.platform import PlatformController
from omniman_ros.core.platform_parameters import PlatformParameters
from omniman_ros.core.wheel_cascade import DriveMode, WheelCommand
from omniman_ros.drive.parameters import SimulationParameters
from omniman_ros.drive.simulated import SimulatedDrives, WheelStates

PERIOD = 0.005
"""Time between two ticks [s]."""
LATENCY = 0.001
"""From the measurement to the tick that uses it, and its command [s]."""


class ClosedLoop:
    """A controller and drives, a tick at a time; nothing waits, nothing reads a clock.

    Args:
        parameters: Of the controller; its robot is the one that the drives move.
        simulation: Of the drives.
        late: Ticks by which commands reach the drives later than they are made.
        torques: Whether the drives report torques, by which the controller finds dead wheels.

    Attributes:
        controller: The controller.
        drives: The drives.
        states: What the drives measured in the last tick.
        truth: (3,) pose of base_link in the world at that time [m, m, rad].
        tick: Ticks so far.
    """

    def __init__(
        self,
        parameters: PlatformParameters,
        simulation: SimulationParameters,
        late: int = 0,
        torques: bool = True,
    ) -> None:
        self.controller = PlatformController(parameters)
        self.drives = SimulatedDrives(parameters.robot, simulation)
        self.tick = 0
        self._late = late
        self._torques = torques
        self._underway: deque[WheelCommand | None] = deque()
        self.states: WheelStates = self.drives.wheel_states(self.now)
        self.truth: NDArray[np.float64] = self.drives.ground_truth()[0]
        self.step()

    @property
    def now(self) -> float:
        """Time of the next measurement [s]."""
        return self.tick * PERIOD

    def step(self) -> None:
        """One tick: drives to controller to drives."""
        now, core = self.now, self.controller
        states = self.states = self.drives.wheel_states(now)
        self.truth = self.drives.ground_truth()[0]
        effort = states.effort if self._torques else None
        core.hear_wheels(now, now + LATENCY, states.position, states.velocity, effort)
        self._underway.append(core.tick(now + LATENCY))
        if len(self._underway) > self._late:
            self._deliver(self._underway.popleft(), now + LATENCY)
        self.tick += 1

    def _deliver(self, command: WheelCommand | None, now: float) -> None:
        if command is None:
            return
        if command.mode is DriveMode.TORQUE:
            self.drives.command_torque(command.effort, now)
        elif command.mode is DriveMode.VOLTAGE:
            self.drives.command_voltage(command.effort, now)
        else:
            assert command.velocity is not None
            self.drives.command_velocity(command.velocity, command.effort, now)
