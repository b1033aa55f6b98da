"""The wheels of a simulated robot: a drive unit and an encoder each, all on one plant."""

import math
import random
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import InputError
from omniman_ros.core.robot import Robot
from omniman_ros.drive.encoder import Encoder
from omniman_ros.drive.energy import EnergyLedger
from omniman_ros.drive.firmware import DriveUnit, drive_settings
from omniman_ros.drive.parameters import SimulationParameters, flags
from omniman_ros.drive.plant import Plant

Array = NDArray[np.float64]

LONGEST_GAP = 5.0
"""A longer gap between two calls is integrated for this long, s: all is at rest by then."""


class Wheelset:
    """Wheels that are commanded one by one; what makes them a drive is the caller's policy.

    The substeps are on a fixed grid that begins at the first `now`; what is measured is at most
    one substep old. A time before the latest one changes nothing. Wheels are numbered in the
    order of the robot's.

    Args:
        robot: The robot.
        parameters: Parameters of the simulation.
        seed: Seed of the sensor noise.

    Attributes:
        plant: Body and wheels.
        units, encoders: Of the wheels.
        steps: Substeps done.

    Raises:
        ParameterError: The robot or the parameters are refused.
    """

    def __init__(self, robot: Robot, parameters: SimulationParameters, seed: int = 0) -> None:
        self._random = random.Random(seed)
        self.plant = Plant(robot, parameters)
        firmware, step = parameters.firmware, parameters.plant.substep
        self.units = [DriveUnit(settings) for settings in drive_settings(robot, firmware, step)]
        self.encoders = [
            Encoder(
                robot.motor.encoder_counts, firmware.observer_window, firmware.observer_timeout
            )
            for _ in self.units
        ]
        self._currents = [0.0 for _ in self.units]
        self._released = [False for _ in self.units]
        self._step = step
        self._origin: float | None = None
        self.steps = 0
        self.configure(robot, parameters)

    def __len__(self) -> int:
        return len(self.units)

    # commands: speeds, torques and decelerations of the wheel, not of the motor

    def command_velocity(self, wheel: int, velocity: float, torque: float = 0.0) -> None:
        """Close the velocity loop: rad/s, with a feed-forward torque in N m."""
        self._connect(wheel)
        self.units[wheel].command_velocity(
            velocity, torque, self.encoders[wheel].velocity, self._currents[wheel]
        )

    def command_torque(self, wheel: int, torque: float) -> None:
        """Close the current loop only: N m."""
        self._connect(wheel)
        self.units[wheel].command_torque(
            torque, self.encoders[wheel].velocity, self._currents[wheel]
        )

    def command_voltage(self, wheel: int, voltage: float) -> None:
        """Give a voltage to the motor, V, clipped to the largest."""
        self._connect(wheel)
        self.units[wheel].command_voltage(voltage)

    def halt(self, wheel: int, deceleration: float) -> None:
        """Ramp to rest, rad/s^2, and hold."""
        self._connect(wheel)
        self.units[wheel].halt(deceleration, self.encoders[wheel].velocity, self._currents[wheel])

    def release(self, wheel: int) -> None:
        """Open the motor's circuit: it turns freely. Its unit trusts encoder and motor again."""
        self.units[wheel].release()
        self._released[wheel] = self.plant.wheels[wheel].open_circuit = True

    def reset(self, wheel: int) -> None:
        """Let the unit trust encoder and motor again. This moves nothing."""
        self.units[wheel].reset()

    def _connect(self, wheel: int) -> None:
        if self._released[wheel]:
            self._released[wheel] = False
            self.plant.wheels[wheel].open_circuit = self._dead[wheel]

    # time

    def advance(self, now: float) -> None:
        """Integrate up to a time, s; the first call sets the origin.

        Raises:
            InputError: Not finite.
        """
        for _ in self.due(now):
            self.step()

    def due(self, now: float) -> Iterator[float]:
        """Give the substeps up to a time, s, each by its begin from the origin, s.

        The caller has to do each by :meth:`step` before it asks for the next.

        Raises:
            InputError: Not finite.
        """
        if not math.isfinite(now):
            raise InputError(f"time is not finite: {now}")
        if self._origin is None:
            self._origin = now
        step = self._step
        skipped = max(now - self._origin - self.steps * step - LONGEST_GAP, 0.0)
        until = now - self._origin - skipped
        while self.steps * step + step <= until + 1e-6 * step:
            yield self.steps * step
        self._origin += skipped

    def elapsed(self, now: float) -> float:
        """Time from the origin, s, as `due` counts; 0 before the first call of it."""
        return now - self._origin if self._origin is not None else 0.0

    def step(self) -> None:
        """Do one substep: units, plant, encoders and measured currents."""
        units, encoders, currents = self.units, self.encoders, self._currents
        self.plant.step(
            [
                unit.update(encoder.velocity, current)
                for unit, encoder, current in zip(units, encoders, currents, strict=True)
            ]
        )
        time = self.steps * self._step
        self.steps += 1
        end = self.steps * self._step
        for k, wheel in enumerate(self.plant.wheels):
            encoders[k].update(time, end, wheel.last_angle, wheel.angle)
            currents[k] = wheel.mean_current
        if self._noise:
            for k in range(len(currents)):
                currents[k] += self._random.gauss(0.0, self._noise)

    # measurements

    def position(self, wheel: int) -> float:
        """Angle, whole encoder steps, not wrapped, rad."""
        return self.encoders[wheel].position

    def velocity(self, wheel: int) -> float:
        """Speed, from the encoder, rad/s."""
        return self.encoders[wheel].velocity

    def torque(self, wheel: int) -> float:
        """Torque at the wheel, from the current by nominal motor values, N m."""
        return self.units[wheel].torque_of(self._currents[wheel], self.encoders[wheel].velocity)

    def current(self, wheel: int) -> float:
        """Measured current of the motor, A."""
        return self._currents[wheel]

    def voltage(self, wheel: int) -> float:
        """Voltage that the amplifier gives, V."""
        return self.plant.wheels[wheel].voltage

    def lost(self, wheel: int) -> bool:
        """Whether the unit has found that the encoder misleads it."""
        return self.units[wheel].lost

    def electrical(self) -> Array:
        """Voltage in V, measured current in A and energy taken in J of each wheel, (n, 3)."""
        return np.array(
            [
                (wheel.voltage, current, wheel.electrical)
                for wheel, current in zip(self.plant.wheels, self._currents, strict=True)
            ]
        )

    def ground_truth(self) -> tuple[Array, Array]:
        """Pose (x, y, heading) of base_link in the world, and its twist in its own frame.

        Returns:
            Arrays of shape (3,): m, m, rad (not wrapped), and m/s, m/s, rad/s.
        """
        return self.plant.pose, self.plant.twist

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
        self.plant.set_pose(values)

    @property
    def energy(self) -> EnergyLedger:
        """Where the energy has gone since the start."""
        return self.plant.energy

    # parameters

    def configure(self, robot: Robot, parameters: SimulationParameters) -> None:
        """Take other robot data and other parameters together, in motion too.

        Raises:
            ParameterError: One of them is refused; nothing has changed then.
        """
        firmware, faults, names = parameters.firmware, parameters.faults, robot.wheels.names
        frozen = flags("faults.frozen_encoder", faults.frozen_encoder, names)
        self.plant.configure(robot, parameters)
        self._dead = flags("faults.dead_motor", faults.dead_motor, names)
        for wheel, released in zip(self.plant.wheels, self._released, strict=True):
            wheel.open_circuit |= released
        self._noise = faults.current_noise
        settings = drive_settings(robot, firmware, self._step)
        for unit, setting in zip(self.units, settings, strict=True):
            unit.configure(setting)
        for encoder, freeze in zip(self.encoders, frozen, strict=True):
            encoder.window, encoder.timeout = firmware.observer_window, firmware.observer_timeout
            encoder.frozen = freeze
