"""Controller core and simulated drives in one loop, in simulated time."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from omniman_ros.control.platform import PlatformController
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.control.wheel_cascade import DriveMode, WheelCommand
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives, WheelStates

PERIOD = 0.005
"""Time between two ticks [s]."""
LATENCY = 0.001
"""Time from a measurement to the tick that uses it, and to that tick's command [s]."""


class ClosedLoop:
    """Runs controller and drives one tick at a time, without waiting and without a clock.

    Args:
        parameters: Parameters of the controller; its robot is the one that the drives move.
        simulation: Parameters of the drives.
        late: Number of ticks by which commands reach the drives late.
        torques: Whether the drives report torques, from which the controller finds dead wheels.

    Attributes:
        controller: The controller.
        drives: The drives.
        states: Measurements of the drives in the last tick.
        truth: (3,) true pose of base_link in the world at that time [m, m, rad].
        tick: Number of ticks so far.
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
        """Run one tick: from the drives to the controller and back."""
        now, core = self.now, self.controller
        states = self.states = self.drives.wheel_states(now)
        self.truth = self.drives.ground_truth()[0]
        effort = states.effort if self._torques else None
        core.update_wheels(now, now + LATENCY, states.position, states.velocity, effort)
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
