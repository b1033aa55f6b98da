"""Platform controller and simulated drives in a closed loop in simulated time."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from omniman_ros.control.platform import PlatformController
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.control.wheel_cascade import DriveMode, WheelCommand
from omniman_ros.core.arbiter import Source
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import OmnimanError
from omniman_ros.core.parameters import build
from omniman_ros.core.planar import Triple
from omniman_ros.core.platform import Platform
from omniman_ros.core.preview import Preview
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.simulation.plant.parameters import MismatchParameters, SimulationParameters
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives, SimulatedWheelStates

if TYPE_CHECKING:  # The command line must do without the engine.
    from omniman_ros.simulation.world.world import World

PERIOD = 0.005  #: time between two ticks [s]
#: Time from a measurement to the tick that uses it, which is also when the drives receive the
#: tick's command [s].
LATENCY = 0.001


class StudyError(OmnimanError):
    """A drive did not come to its end, so that its figures would be meaningless."""


class ClosedLoop:
    """Runs controller and drives one tick at a time, without waiting and without a real clock."""

    def __init__(
        self,
        parameters: PlatformParameters,
        simulation: SimulationParameters,
        torques: bool = True,
        world: WorldChoice | None = None,
        robot: Platform | None = None,
    ) -> None:
        self.controller = PlatformController(parameters)
        robot = robot or parameters.robot
        self.world: World | None = None if world is None else world.body(robot, simulation)
        self.drives = SimulatedDrives(robot, simulation, body=self.world)
        self.tick = 0
        self._torques = torques
        self.states: SimulatedWheelStates = self.drives.wheel_states(self.now)
        self.truth: Array = self.drives.ground_truth()[0]  # pose (3,) at the time of `states`
        self.step()

    @staticmethod
    def of_robot(
        values: Mapping[str, Any],
        world: WorldChoice | None = None,
        mismatch: MismatchParameters | None = None,
    ) -> "ClosedLoop":
        """Return the loop of a robot by its parameters, full names to values.

        It gets no torques reported: without, dead wheels are not detected.

        Args:
            mismatch: Errors of its wheels; None for those that the parameters give.
        """
        simulation = build(SimulationParameters, values)
        if mismatch is not None:
            simulation = replace(simulation, mismatch=mismatch)
        return ClosedLoop(build(PlatformParameters, values), simulation, False, world)

    @property
    def now(self) -> float:
        """Time of the next measurement [s]."""
        return self.tick * PERIOD

    def set_pose(self, pose: Triple) -> None:
        """Put the robot at a pose in odom [m, m, rad], which its odometry knows."""
        self.drives.set_pose(pose)
        self.controller.set_pose(pose)

    def send(self, source: Source, preview: Preview) -> None:
        """Pass a preview to the controller.

        Raises:
            StudyError: The controller refuses it.
        """
        refusal = self.controller.set_preview(source, preview, self.now)
        if refusal:
            raise StudyError(f"{source.value}/reference was refused: {refusal}")

    def check(self, about: object) -> None:
        """Raise an error about a drive that has ended early.

        Raises:
            StudyError: A movement was cancelled, or controller or drives have stopped.
        """
        core = self.controller
        stopped = core.cancelled or core.latch.status.reason or self.drives.stop_reason
        if stopped:
            raise StudyError(f"{about}: {stopped}")

    def step(self) -> None:
        """Run one tick: from the drives to the controller and back."""
        now, core = self.now, self.controller
        states = self.states = self.drives.wheel_states(now)
        self.truth = self.drives.ground_truth()[0]
        effort = states.effort if self._torques else None
        core.update_wheels(now, now + LATENCY, states.position, states.velocity, effort)
        self._deliver(core.tick(now + LATENCY), now + LATENCY)
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


@dataclass
class MotionRecord:
    """The record of a robot's motion, with a row for each tick of the controller."""

    times: list[float] = field(default_factory=list)  #: times of the ticks [s]
    poses: list[Array] = field(default_factory=list)  #: true poses (3,) in odom [m, m, rad]
    odometry: list[Array] = field(default_factory=list)  #: poses (3,) by odometry [m, m, rad]
    twists: list[Array] = field(default_factory=list)  #: (3,) in base_link [m/s, m/s, rad/s]
    energy: list[float] = field(default_factory=list)  #: electric energy consumed so far [J]

    def add(self, loop: ClosedLoop) -> None:
        """Record the latest tick of a loop."""
        odometry = loop.controller.odometry
        self.times.append(loop.now - PERIOD)
        self.poses.append(loop.truth.copy())
        self.odometry.append(np.array(odometry.pose))
        self.twists.append(np.array(odometry.twist))
        self.energy.append(float(loop.drives.electrical()[:, 2].sum()))
