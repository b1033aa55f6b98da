"""Platform controller and simulated drives in a closed loop in simulated time."""

from collections import deque
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from omniman_ros.control.platform import PlatformController
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.control.wheel_cascade import DriveMode, WheelCommand
from omniman_ros.core.errors import OmnimanError
from omniman_ros.core.robot import Robot
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives, WheelStates

if TYPE_CHECKING:  # The command line must do without the engine.
    from omniman_ros.simulation.world.world import World

PERIOD = 0.005  # time between two ticks [s]
LATENCY = 0.001
"""Time from a measurement to the tick that uses it, which is also when the drives receive the
tick's command unless it is delayed [s]."""


class StudyError(OmnimanError):
    """A drive did not come to its end, so that its figures would be meaningless."""


class ClosedLoop:
    """Runs controller and drives one tick at a time, without waiting and without a real clock.

    Attributes:
        truth: (3,) true pose of base_link in the world at the time of `states` [m, m, rad].
    """

    def __init__(
        self,
        parameters: PlatformParameters,
        simulation: SimulationParameters,
        late: int = 0,
        torques: bool = True,
        world: WorldChoice | None = None,
        robot: Robot | None = None,
    ) -> None:
        self.controller = PlatformController(parameters)
        robot = robot or parameters.robot
        self.world: World | None = None if world is None else world.body(robot, simulation)
        self.drives = SimulatedDrives(robot, simulation, body=self.world)
        self.tick = 0
        self._late = late
        self._torques = torques
        self._commands: deque[WheelCommand | None] = deque()
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
        self._commands.append(core.tick(now + LATENCY))
        if len(self._commands) > self._late:
            self._deliver(self._commands.popleft(), now + LATENCY)
        self.tick += 1

    def _deliver(self, command: WheelCommand | None, now: float) -> None:
        """Pass a command, if there is one, to the drives at a time [s]."""
        if command is None:
            return
        if command.mode is DriveMode.TORQUE:
            self.drives.command_torque(command.effort, now)
        elif command.mode is DriveMode.VOLTAGE:
            self.drives.command_voltage(command.effort, now)
        else:
            assert command.velocity is not None
            self.drives.command_velocity(command.velocity, command.effort, now)
