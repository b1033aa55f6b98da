"""Wheels of a simulated robot: a drive unit and an encoder each, all on one body."""

import math
import random
from collections.abc import Iterator, Sequence

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.platform import Platform
from omniman_ros.simulation.plant.body import WheeledBody
from omniman_ros.simulation.plant.drive_unit import DriveUnit, drive_settings
from omniman_ros.simulation.plant.encoder import Encoder
from omniman_ros.simulation.plant.energy_ledger import EnergyLedger
from omniman_ros.simulation.plant.parameters import SimulationParameters, flags
from omniman_ros.simulation.plant.plant import Plant

MAX_GAP = 5.0  #: Longest time between two calls that is integrated [s]; all rests by then


class DrivenWheels:
    """Wheels that are commanded individually; the caller coordinates them.

    The substeps are on a fixed grid that begins at the first `now`; measurements are at most one
    substep old. A time before the latest one changes nothing. Wheels are numbered in the
    robot's order. Times and poses raise the errors of :class:`SimulatedDrives`.

    Args:
        body: What the drives move, of this robot and with these parameters; None for a
            :class:`Plant`.

    Raises:
        ParameterError: The robot or the parameters are refused.
    """

    def __init__(
        self,
        robot: Platform,
        parameters: SimulationParameters,
        seed: int = 0,
        body: WheeledBody | None = None,
    ) -> None:
        self._random = random.Random(seed)
        self.plant = Plant(robot, parameters) if body is None else body  #: Body and wheels
        firmware, step = parameters.firmware, parameters.plant.substep
        #: Drive units of the wheels
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
        self.steps = 0  #: Number of substeps that were run
        self.configure(robot, parameters)

    def __len__(self) -> int:
        return len(self.units)

    # Commands are speeds, torques and decelerations of the wheel, not of the motor.

    def command_velocity(self, wheel: int, velocity: float, torque: float = 0.0) -> None:
        """Close the velocity loop [rad/s], with a feed-forward torque [N m]."""
        self._connect(wheel)
        self.units[wheel].command_velocity(
            velocity, torque, self.encoders[wheel].velocity, self._currents[wheel]
        )

    def command_torque(self, wheel: int, torque: float) -> None:
        """Close the current loop only, for a torque at the wheel [N m]."""
        self._connect(wheel)
        self.units[wheel].command_torque(
            torque, self.encoders[wheel].velocity, self._currents[wheel]
        )

    def command_voltage(self, wheel: int, voltage: float) -> None:
        """Apply a voltage to the motor [V], clipped to the largest."""
        self._connect(wheel)
        self.units[wheel].command_voltage(voltage)

    def halt(self, wheel: int, deceleration: float) -> None:
        """Ramp to rest at a deceleration [rad/s^2], and hold."""
        self._connect(wheel)
        self.units[wheel].halt(deceleration, self.encoders[wheel].velocity, self._currents[wheel])

    def release(self, wheel: int) -> None:
        """Open the motor's circuit, so that it rotates freely, and clear the unit's faults."""
        self.units[wheel].release()
        self._released[wheel] = self.plant.wheels[wheel].open_circuit = True

    def reset(self, wheel: int) -> None:
        """Clear the unit's faults of encoder and motor; the wheel does not move."""
        self.units[wheel].reset()

    def _connect(self, wheel: int) -> None:
        if self._released[wheel]:
            self._released[wheel] = False
            self.plant.wheels[wheel].open_circuit = self._dead[wheel]

    # time

    def advance(self, now: float) -> None:
        """Integrate up to time `now` [s]; the first call sets the origin."""
        for _ in self.due(now):
            self.step()

    def due(self, now: float) -> Iterator[float]:
        """Yield the start of each substep up to time `now` [s], relative to the origin [s].

        The caller must run each by :meth:`step` before it requests the next.
        """
        if not math.isfinite(now):
            raise InputError(f"time must be finite: {now}")
        if self._origin is None:
            self._origin = now
        step = self._step
        skipped = max(now - self._origin - self.steps * step - MAX_GAP, 0.0)
        until = now - self._origin - skipped
        while self.steps * step + step <= until + 1e-6 * step:
            yield self.steps * step
        self._origin += skipped

    def elapsed(self, now: float) -> float:
        """Return the time since the origin of :meth:`due` [s]; 0 before its first call."""
        return now - self._origin if self._origin is not None else 0.0

    def step(self) -> None:
        """Run one substep of units, plant, encoders and current sensors."""
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
        """Return the unwrapped angle, in whole encoder steps [rad]."""
        return self.encoders[wheel].position

    def velocity(self, wheel: int) -> float:
        """Return the speed from the encoder [rad/s]."""
        return self.encoders[wheel].velocity

    def torque(self, wheel: int) -> float:
        """Return the torque at the wheel, from the current by nominal motor values [N m]."""
        return self.units[wheel].torque_of(self._currents[wheel], self.encoders[wheel].velocity)

    def current(self, wheel: int) -> float:
        """Return the measured current of the motor [A]."""
        return self._currents[wheel]

    def voltage(self, wheel: int) -> float:
        """Return the voltage of the amplifier [V]."""
        return self.plant.wheels[wheel].voltage

    def lost(self, wheel: int) -> bool:
        """Return whether the unit has detected a wrong encoder."""
        return self.units[wheel].lost

    def electrical(self) -> Array:
        """Return voltage [V], measured current [A] and energy drawn [J] of each wheel, (n, 3)."""
        return np.array(
            [
                (wheel.voltage, current, wheel.electrical)
                for wheel, current in zip(self.plant.wheels, self._currents, strict=True)
            ]
        )

    def ground_truth(self) -> tuple[Array, Array]:
        """Return pose (x, y, heading) of base_link in the world, and twist in its own frame.

        Returns:
            Pose (3,) [m, m, rad], heading not wrapped, and twist (3,) [m/s, m/s, rad/s].
        """
        return self.plant.pose, self.plant.twist

    def set_pose(self, pose: Sequence[float] | Array) -> None:
        """Move the robot to a pose (3,) in the world [m, m, rad]; its own motion continues."""
        values = [float(value) for value in pose]
        if len(values) != 3 or not all(map(math.isfinite, values)):
            raise InputError(f"a pose must be three finite numbers, got {values}")
        self.plant.set_pose(values)

    @property
    def energy(self) -> EnergyLedger:
        """Energy balance since the start."""
        return self.plant.energy

    # parameters

    def configure(self, robot: Platform, parameters: SimulationParameters) -> None:
        """Replace robot data and parameters together, also in motion."""
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
