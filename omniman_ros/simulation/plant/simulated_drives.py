"""Simulated drives: wheels on the plant that are commanded together."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.platform import Platform
from omniman_ros.core.validated import Validated
from omniman_ros.simulation.plant.body import WheeledBody
from omniman_ros.simulation.plant.drive_unit import DriveUnitMode
from omniman_ros.simulation.plant.driven_wheels import DrivenWheels
from omniman_ros.simulation.plant.energy_ledger import EnergyLedger
from omniman_ros.simulation.plant.parameters import SimulationParameters

MIN_RAMP_FRACTION = 0.05  #: Smallest fraction of the deceleration with which a wheel ramps to rest


@dataclass(frozen=True)
class SimulatedWheelStates(Validated):
    """Feedback of all wheels; read-only arrays, shape (n,)."""

    #: Wheel angles in whole encoder steps [rad]; not wrapped
    position: Annotated[Array, Shape("n")]
    velocity: Annotated[Array, Shape("n")]  #: Wheel speeds from the encoders [rad/s]
    #: Torques at the wheels [N m], from the currents by nominal motor values
    effort: Annotated[Array, Shape("n")]


class SimulatedDrives:
    """Wheel drives of a simulated robot. Time is an argument; nothing here reads a clock.

    The substeps are on a fixed grid that begins at the first `now`; feedback is at most one
    substep old. A time before the latest one has no effect. A command, a time or a pose of other
    than finite numbers raises an InputError, refused parameters a ParameterError; neither has an
    effect.

    Raises:
        ParameterError: The robot or the parameters are not valid.
    """

    def __init__(
        self,
        robot: Platform,
        parameters: SimulationParameters,
        seed: int = 0,
        body: WheeledBody | None = None,
    ) -> None:
        self._robot = robot
        self._parameters = parameters
        self._wheels = DrivenWheels(robot, parameters, seed, body)
        self._plant = self._wheels.plant
        self._last_command = -math.inf
        self._is_holding = True
        self._stop_reason: str | None = None

    # commands

    def command_velocity(
        self,
        velocity: Sequence[float] | Array,
        effort: Sequence[float] | Array | None,
        now: float,
    ) -> None:
        """Close the velocity loops at speeds (n,) [rad/s], with torques (n,) fed forward [N m]."""
        speeds = self._checked("velocity", velocity)
        torques = [0.0] * len(speeds) if effort is None else self._checked("effort", effort)
        if self._accept(now):
            for k, (speed, torque) in enumerate(zip(speeds, torques, strict=True)):
                self._wheels.command_velocity(k, speed, torque)

    def command_torque(self, effort: Sequence[float] | Array, now: float) -> None:
        """Close the current loops only, with torques (n,) at the wheels [N m]."""
        torques = self._checked("effort", effort)
        if self._accept(now):
            for k, torque in enumerate(torques):
                self._wheels.command_torque(k, torque)

    def command_voltage(self, volts: Sequence[float] | Array, now: float) -> None:
        """Apply voltages (n,) to the motors [V], clipped to the amplifier's limit."""
        voltages = self._checked("voltage", volts)
        if self._accept(now):
            for k, voltage in enumerate(voltages):
                self._wheels.command_voltage(k, voltage)

    def stop(self, reason: str) -> None:
        """Stop quickly, and ignore commands until :meth:`reset`."""
        if self._stop_reason is None:
            self._stop_reason = reason
            self._halt(self._parameters.firmware.quick_stop_deceleration)

    def reset(self) -> None:
        """Accept commands again; the drives stay at rest until the next command."""
        self._stop_reason = None
        self._last_command = -math.inf
        for k in range(len(self._wheels)):
            self._wheels.reset(k)

    @property
    def stop_reason(self) -> str | None:
        """Why the drives are stopped, or None."""
        return self._stop_reason

    @property
    def holding(self) -> bool:
        """Whether the drives rest, or ramp to rest, without commands: timed out or stopped."""
        return self._is_holding

    @property
    def mode(self) -> DriveUnitMode:
        """Mode of the drives, the same for all."""
        return self._wheels.units[0].mode

    def _checked(self, name: str, values: Sequence[float] | Array) -> list[float]:
        numbers = [float(value) for value in values]
        if len(numbers) != len(self._wheels):
            raise InputError(
                f"{name} must have {len(self._wheels)} values, one per wheel, not {len(numbers)}"
            )
        if not all(map(math.isfinite, numbers)):
            raise InputError(f"{name} must be finite, not {numbers}")
        return numbers

    def _accept(self, now: float) -> bool:
        self.advance(now)
        if self._stop_reason is not None:
            return False
        self._last_command = self._wheels.elapsed(now)
        self._is_holding = False
        return True

    def _halt(self, deceleration: float) -> None:
        """Ramp all wheels to rest in the same time, so that the robot keeps its path."""
        self._is_holding = True
        speeds = [abs(self._wheels.velocity(k)) for k in range(len(self._wheels))]
        fastest = max(speeds)
        for k, speed in enumerate(speeds):
            fraction = speed / fastest if fastest else 1.0
            self._wheels.halt(k, max(fraction, MIN_RAMP_FRACTION) * deceleration)

    # time

    def elapsed(self, now: float) -> float:
        """Return how long after the first substep began a time `now` is [s]."""
        return self._wheels.elapsed(now)

    def advance(self, now: float) -> None:
        """Integrate up to time `now` [s]; the first call sets the origin."""
        wheels = self._wheels
        for time in wheels.due(now):
            firmware = self._parameters.firmware
            if not self._is_holding and time - self._last_command >= firmware.watchdog:
                self._halt(firmware.deceleration)
            wheels.step()
            if self._stop_reason is None and any(unit.lost for unit in wheels.units):
                names = self._robot.wheels.names
                lost = [name for k, name in enumerate(names) if wheels.lost(k)]
                self.stop(f"encoder or motor lost: {', '.join(lost)}")

    # feedback

    def wheel_states(self, now: float) -> SimulatedWheelStates:
        """Integrate up to time `now` [s], and return the measurements of the drives."""
        self.advance(now)
        wheels = self._wheels
        rows = [
            (wheels.position(k), wheels.velocity(k), wheels.torque(k)) for k in range(len(wheels))
        ]
        table = np.array(rows).T
        table.flags.writeable = False
        return SimulatedWheelStates(*table)

    def electrical(self) -> Array:
        """Return voltage [V], measured current [A] and consumed energy [J] per wheel, (n, 3)."""
        return self._wheels.electrical()

    def ground_truth(self) -> tuple[Array, Array]:
        """Return pose (3,) and twist (3,) of base_link, as `DrivenWheels.ground_truth` does."""
        return self._wheels.ground_truth()

    def set_pose(self, pose: Sequence[float] | Array) -> None:
        """Set the pose (3,) in the world [m, m, rad]; the motion in its own frame continues.

        Args:
            pose: Pose (x, y, heading) of base_link [m], [rad], shape (3,).
        """
        self._wheels.set_pose(pose)

    @property
    def energy(self) -> EnergyLedger:
        """Energy balance since the start."""
        return self._wheels.energy

    # parameters

    @property
    def parameters(self) -> SimulationParameters:
        """The parameters in use."""
        return self._parameters

    def set_parameters(self, parameters: SimulationParameters) -> None:
        """Replace the parameters, also in motion."""
        self.configure(self._robot, parameters)

    def configure(self, robot: Platform, parameters: SimulationParameters) -> None:
        """Replace robot data and parameters together."""
        self._wheels.configure(robot, parameters)
        self._robot, self._parameters = robot, parameters
