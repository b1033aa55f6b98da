"""The simulated drives: drive units and encoders on the plant, behind one small interface."""

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import InputError
from omniman_ros.core.robot import Robot
from omniman_ros.drive.encoder import Encoder
from omniman_ros.drive.energy import EnergyLedger
from omniman_ros.drive.firmware import DriveUnit, Mode, drive_settings
from omniman_ros.drive.parameters import SimulationParameters, flags
from omniman_ros.drive.plant import Plant

Array = NDArray[np.float64]

SLOWEST_RAMP = 0.05
"""Least share of the deceleration with which a wheel ramps to rest."""
LONGEST_GAP = 5.0
"""A longer gap between two calls is integrated for this long, s: all is at rest by then."""


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
        self._random = random.Random(seed)
        self._plant = Plant(robot, parameters)
        firmware, step = parameters.firmware, parameters.plant.substep
        self._units = [DriveUnit(settings) for settings in drive_settings(robot, firmware, step)]
        self._encoders = [
            Encoder(
                robot.motor.encoder_counts, firmware.observer_window, firmware.observer_timeout
            )
            for _ in self._units
        ]
        self._currents = [0.0 for _ in self._units]
        self._step = step
        self._origin: float | None = None
        self._steps = 0
        self._last_command = -math.inf
        self._held = True
        self._stop_reason: str | None = None
        self.set_parameters(parameters)

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
            for k, unit in enumerate(self._units):
                unit.command_velocity(
                    speeds[k], torques[k], self._encoders[k].velocity, self._currents[k]
                )

    def command_torque(self, effort: Sequence[float] | Array, now: float) -> None:
        """Close the current loops only: torques at the wheels, N m, shape (n,).

        Raises:
            InputError: Wrong size or not finite; it is then no valid command.
        """
        torques = self._checked("effort", effort)
        if self._accept(now):
            for k, unit in enumerate(self._units):
                unit.command_torque(torques[k], self._encoders[k].velocity, self._currents[k])

    def command_voltage(self, volts: Sequence[float] | Array, now: float) -> None:
        """Give voltages to the motors, V, shape (n,), clipped to the largest.

        Raises:
            InputError: Wrong size or not finite; it is then no valid command.
        """
        voltages = self._checked("voltage", volts)
        if self._accept(now):
            for k, unit in enumerate(self._units):
                unit.command_voltage(voltages[k])

    def stop(self, reason: str) -> None:
        """Stop quickly, and stay stopped until :meth:`reset`: commands are not heard."""
        if self._stop_reason is None:
            self._stop_reason = reason
            self._halt(self._parameters.firmware.quick_stop_deceleration)

    def reset(self) -> None:
        """Hear commands again. This moves nothing."""
        self._stop_reason = None
        self._last_command = -math.inf
        for unit in self._units:
            unit.reset()

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
        return self._units[0].mode

    def _checked(self, name: str, values: Sequence[float] | Array) -> list[float]:
        numbers = [float(value) for value in values]
        if len(numbers) != len(self._units):
            raise InputError(f"{name} has {len(numbers)} values, the robot {len(self._units)}")
        if not all(map(math.isfinite, numbers)):
            raise InputError(f"{name} is not finite: {numbers}")
        return numbers

    def _accept(self, now: float) -> bool:
        self.advance(now)
        if self._stop_reason is not None:
            return False
        self._last_command = now - self._origin if self._origin is not None else 0.0
        self._held = False
        return True

    def _halt(self, deceleration: float) -> None:
        """Ramp to rest, all wheels in the same time: the robot stays on its curve."""
        self._held = True
        fastest = max(abs(encoder.velocity) for encoder in self._encoders)
        for unit, encoder, current in zip(
            self._units, self._encoders, self._currents, strict=True
        ):
            share = abs(encoder.velocity) / fastest if fastest else 1.0
            unit.halt(max(share, SLOWEST_RAMP) * deceleration, encoder.velocity, current)

    # time

    def advance(self, now: float) -> None:
        """Integrate up to a time, s; the first call sets the origin.

        Raises:
            InputError: Not finite.
        """
        if not math.isfinite(now):
            raise InputError(f"time is not finite: {now}")
        if self._origin is None:
            self._origin = now
        skipped = max(now - self._origin - self._steps * self._step - LONGEST_GAP, 0.0)
        self._integrate(now - self._origin - skipped)
        self._origin += skipped

    def _integrate(self, until: float) -> None:
        """Run the substeps up to a time from the origin, s."""
        firmware = self._parameters.firmware
        step, wheels = self._step, self._plant.wheels
        noise = self._parameters.faults.current_noise
        units, encoders, currents = self._units, self._encoders, self._currents
        time = self._steps * step
        while time + step <= until + 1e-6 * step:
            if not self._held and time - self._last_command >= firmware.watchdog:
                self._halt(firmware.deceleration)
            self._plant.step(
                [
                    unit.update(encoder.velocity, current)
                    for unit, encoder, current in zip(units, encoders, currents, strict=True)
                ]
            )
            self._steps += 1
            end = self._steps * step
            for k, wheel in enumerate(wheels):
                encoders[k].update(time, end, wheel.last_angle, wheel.angle)
                currents[k] = wheel.mean_current
            if noise:
                for k in range(len(currents)):
                    currents[k] += self._random.gauss(0.0, noise)
            time = end
            if self._stop_reason is None and any(unit.lost for unit in units):
                names = self._robot.wheels.names
                lost = [name for name, unit in zip(names, units, strict=True) if unit.lost]
                self.stop(f"encoder or motor lost: {', '.join(lost)}")

    # feedback

    def wheel_states(self, now: float) -> WheelStates:
        """Integrate up to a time, s, and give what the drives measure."""
        self.advance(now)
        rows = [
            (encoder.position, encoder.velocity, unit.torque_of(current, encoder.velocity))
            for unit, encoder, current in zip(
                self._units, self._encoders, self._currents, strict=True
            )
        ]
        table = np.array(rows).T
        table.flags.writeable = False
        return WheelStates(*table)

    def electrical(self) -> Array:
        """Voltage in V, measured current in A and energy taken in J of each wheel, (n, 3)."""
        return np.array(
            [
                (wheel.voltage, current, wheel.electrical)
                for wheel, current in zip(self._plant.wheels, self._currents, strict=True)
            ]
        )

    def ground_truth(self) -> tuple[Array, Array]:
        """Pose (x, y, heading) of base_link in the world, and its twist in its own frame.

        Returns:
            Arrays of shape (3,): m, m, rad (not wrapped), and m/s, m/s, rad/s.
        """
        return self._plant.pose, self._plant.twist

    def set_pose(self, pose: Sequence[float] | Array) -> None:
        """Put the robot elsewhere in the world; it goes on moving as it did in its own frame.

        Args:
            pose: Pose (x, y, heading) of base_link, m and rad, shape (3,).

        Raises:
            InputError: Wrong size or not finite.
        """
        values = [float(value) for value in pose]
        if len(values) != 3 or not all(map(math.isfinite, values)):
            raise InputError(f"a pose is three finite numbers, not {values}")
        self._plant.set_pose(values)

    @property
    def energy(self) -> EnergyLedger:
        """Where the energy has gone since the start."""
        return self._plant.energy

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
        firmware, faults = parameters.firmware, parameters.faults
        frozen = flags("faults.frozen_encoder", faults.frozen_encoder, robot.wheels.names)
        self._plant.configure(robot, parameters)
        self._robot, self._parameters = robot, parameters
        settings = drive_settings(robot, firmware, self._step)
        for unit, setting in zip(self._units, settings, strict=True):
            unit.configure(setting)
        for encoder, freeze in zip(self._encoders, frozen, strict=True):
            encoder.window, encoder.timeout = firmware.observer_window, firmware.observer_timeout
            encoder.frozen = freeze
