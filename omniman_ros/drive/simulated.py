"""The simulated drives: wheels on the plant, commanded together, behind one small interface."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import InputError
from omniman_ros.core.robot import Robot
from omniman_ros.drive.energy import EnergyLedger
from omniman_ros.drive.firmware import Mode
from omniman_ros.drive.parameters import SimulationParameters
from omniman_ros.drive.wheelset import Wheelset

Array = NDArray[np.float64]

SLOWEST_RAMP = 0.05
"""Least share of the deceleration with which a wheel ramps to rest."""


@dataclass(frozen=True)
class WheelStates:
    """Feedback of all wheels; read-only arrays, shape (n,).

    Attributes:
        position: Wheel angles, whole encoder steps, not wrapped, rad.
        velocity: Wheel speeds, from the encoders, rad/s.
        effort: Torques at the wheels, from the currents by nominal motor values, N m.
    """

    position: Array
    velocity: Array
    effort: Array


class SimulatedDrives:
    """Wheel drives of a simulated robot. Time is an argument; nothing here reads a clock.

    The substeps are on a fixed grid that begins at the first `now`; what is reported is at most
    one substep old. A time before the latest one changes nothing.

    Args:
        robot: The robot.
        parameters: Parameters of the simulation.
        seed: Seed of the sensor noise.

    Raises:
        ParameterError: The robot or the parameters are refused.
    """

    def __init__(self, robot: Robot, parameters: SimulationParameters, seed: int = 0) -> None:
        self._robot = robot
        self._parameters = parameters
        self._wheels = Wheelset(robot, parameters, seed)
        self._plant = self._wheels.plant
        self._last_command = -math.inf
        self._held = True
        self._stop_reason: str | None = None

    # commands

    def command_velocity(
        self,
        velocity: Sequence[float] | Array,
        effort: Sequence[float] | Array | None,
        now: float,
    ) -> None:
        """Close the velocity loops in the drives.

        Args:
            velocity: Wheel speeds, rad/s, shape (n,).
            effort: Feed-forward torques at the wheels, N m, shape (n,), or None for zero.
            now: Time, s.

        Raises:
            InputError: Wrong size or not finite; it is then no valid command.
        """
        speeds = self._checked("velocity", velocity)
        torques = [0.0] * len(speeds) if effort is None else self._checked("effort", effort)
        if self._accept(now):
            for k, (speed, torque) in enumerate(zip(speeds, torques, strict=True)):
                self._wheels.command_velocity(k, speed, torque)

    def command_torque(self, effort: Sequence[float] | Array, now: float) -> None:
        """Close the current loops only: torques at the wheels, N m, shape (n,).

        Raises:
            InputError: Wrong size or not finite; it is then no valid command.
        """
        torques = self._checked("effort", effort)
        if self._accept(now):
            for k, torque in enumerate(torques):
                self._wheels.command_torque(k, torque)

    def command_voltage(self, volts: Sequence[float] | Array, now: float) -> None:
        """Give voltages to the motors, V, shape (n,), clipped to the largest.

        Raises:
            InputError: Wrong size or not finite; it is then no valid command.
        """
        voltages = self._checked("voltage", volts)
        if self._accept(now):
            for k, voltage in enumerate(voltages):
                self._wheels.command_voltage(k, voltage)

    def stop(self, reason: str) -> None:
        """Stop quickly, and stay stopped until :meth:`reset`: commands are not heard."""
        if self._stop_reason is None:
            self._stop_reason = reason
            self._halt(self._parameters.firmware.quick_stop_deceleration)

    def reset(self) -> None:
        """Hear commands again. This moves nothing."""
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
        """Whether the drives ramp to rest, or rest, by themselves: no fresh command, or stop."""
        return self._held

    @property
    def mode(self) -> Mode:
        """Mode of the drives."""
        return self._wheels.units[0].mode

    def _checked(self, name: str, values: Sequence[float] | Array) -> list[float]:
        numbers = [float(value) for value in values]
        if len(numbers) != len(self._wheels):
            raise InputError(f"{name} has {len(numbers)} values, the robot {len(self._wheels)}")
        if not all(map(math.isfinite, numbers)):
            raise InputError(f"{name} is not finite: {numbers}")
        return numbers

    def _accept(self, now: float) -> bool:
        self.advance(now)
        if self._stop_reason is not None:
            return False
        self._last_command = self._wheels.elapsed(now)
        self._held = False
        return True

    def _halt(self, deceleration: float) -> None:
        """Ramp to rest, all wheels in the same time: the robot stays on its curve."""
        self._held = True
        speeds = [abs(self._wheels.velocity(k)) for k in range(len(self._wheels))]
        fastest = max(speeds)
        for k, speed in enumerate(speeds):
            share = speed / fastest if fastest else 1.0
            self._wheels.halt(k, max(share, SLOWEST_RAMP) * deceleration)

    # time

    def advance(self, now: float) -> None:
        """Integrate up to a time, s; the first call sets the origin.

        Raises:
            InputError: Not finite.
        """
        wheels = self._wheels
        for time in wheels.due(now):
            firmware = self._parameters.firmware
            if not self._held and time - self._last_command >= firmware.watchdog:
                self._halt(firmware.deceleration)
            wheels.step()
            if self._stop_reason is None and any(unit.lost for unit in wheels.units):
                names = self._robot.wheels.names
                lost = [name for k, name in enumerate(names) if wheels.lost(k)]
                self.stop(f"encoder or motor lost: {', '.join(lost)}")

    # feedback

    def wheel_states(self, now: float) -> WheelStates:
        """Integrate up to a time, s, and give what the drives measure."""
        self.advance(now)
        wheels = self._wheels
        rows = [
            (wheels.position(k), wheels.velocity(k), wheels.torque(k)) for k in range(len(wheels))
        ]
        table = np.array(rows).T
        table.flags.writeable = False
        return WheelStates(*table)

    def electrical(self) -> Array:
        """Voltage in V, measured current in A and energy taken in J of each wheel, (n, 3)."""
        return self._wheels.electrical()

    def ground_truth(self) -> tuple[Array, Array]:
        """Pose (x, y, heading) of base_link in the world, and its twist in its own frame.

        Returns:
            Arrays of shape (3,): m, m, rad (not wrapped), and m/s, m/s, rad/s.
        """
        return self._wheels.ground_truth()

    def set_pose(self, pose: Sequence[float] | Array) -> None:
        """Put the robot elsewhere in the world; it goes on moving as it did in its own frame.

        Args:
            pose: Pose (x, y, heading) of base_link, m and rad, shape (3,).

        Raises:
            InputError: Wrong size or not finite.
        """
        self._wheels.set_pose(pose)

    @property
    def energy(self) -> EnergyLedger:
        """Where the energy has gone since the start."""
        return self._wheels.energy

    # parameters

    @property
    def parameters(self) -> SimulationParameters:
        """The parameters in use."""
        return self._parameters

    def set_parameters(self, parameters: SimulationParameters) -> None:
        """Take other parameters, in motion too.

        Raises:
            ParameterError: They are refused; nothing has changed then.
        """
        self.configure(self._robot, parameters)

    def configure(self, robot: Robot, parameters: SimulationParameters) -> None:
        """Take other robot data and other parameters together.

        Raises:
            ParameterError: One of them is refused; nothing has changed then.
        """
        self._wheels.configure(robot, parameters)
        self._robot, self._parameters = robot, parameters
