"""All simulated drives of an installation, on one bus and one plant."""

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import can
import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.robot import Robot
from omniman_ros.drive.can.drive import BusDrive
from omniman_ros.drive.can.motor import DriveFaults
from omniman_ros.drive.can.parameters import CanFaultParameters, drive_faults
from omniman_ros.drive.can.shaft import MotorShaft
from omniman_ros.drive.parameters import SimulationParameters
from omniman_ros.drive.wheelset import Wheelset

Array = NDArray[np.float64]

PERIOD = 1e-3
"""Time between two runs of the drives' firmware, s."""
LONGEST_GAP = 5.0
"""Of a longer gap between two calls only the first part is run, s: all is at rest by then."""
REST_SPEED = 0.05
"""Wheel speed at which a wheel stands, rad/s."""
STANDSTILL = 0.2
"""Wheel speed at which a drive takes a ramp to rest for done, rad/s."""
UNDERVOLTAGE = 0.5
"""Share of the motor's voltage below which a drive has an error."""
ECHO_TIME = 0.5
"""How long the echo of a frame may take, s."""


@dataclass(frozen=True)
class DriveSetup:
    """What a drive is made of.

    Attributes:
        motor: Its motor.
        node: Its id.
        robot, simulation, can: The installation.
        number: Of the wheel.
    """

    motor: MotorShaft
    node: int
    robot: Robot
    simulation: SimulationParameters
    can: CanParameters
    number: int


def _cia402(setup: DriveSetup) -> BusDrive:
    from omniman_ros.drive.can.cia402 import Cia402Drive, Cia402Settings

    motor, can, data = setup.motor, setup.can, setup.robot.motor
    firmware, gear = setup.simulation.firmware, setup.motor.gear_ratio
    largest = motor.torque_constant * data.max_current
    rated = can.rated_torque or largest
    settings = Cia402Settings(
        counts=can.counts,
        velocity_scale=can.velocity_scale or can.counts,
        rated_torque=rated,
        rated_current=rated / motor.torque_constant,
        quick_stop_deceleration=firmware.quick_stop_deceleration * gear,
        acceleration=firmware.acceleration * gear,
        deceleration=firmware.deceleration * gear,
        max_torque=largest,
        undervoltage=UNDERVOLTAGE * data.max_voltage,
        standstill=STANDSTILL * gear,
        serial=setup.number + 1,
    )
    return Cia402Drive(motor, setup.node, settings)


def _vesc(setup: DriveSetup) -> BusDrive:
    from omniman_ros.drive.can.vesc import VescDrive

    motor, can = setup.motor, setup.can
    rate = 1.0 / (can.feedback_period or can.period)
    return VescDrive(
        motor, setup.node, can.pole_pairs, motor.torque_constant,
        timeout=can.heartbeat_timeout, status_1_rate=rate, status_5_rate=rate,
    )  # fmt: skip


def _odrive(setup: DriveSetup) -> BusDrive:
    from omniman_ros.drive.can.odrive import OdriveDrive

    can = setup.can
    return OdriveDrive(
        setup.motor, setup.node, setup.motor.torque_constant,
        heartbeat=can.drive_heartbeat, encoder=can.feedback_period or can.period,
        watchdog=can.heartbeat_timeout,
    )  # fmt: skip


PROTOCOLS: dict[str, Callable[[DriveSetup], BusDrive]] = {
    "cia402": _cia402,
    "vesc": _vesc,
    "odrive": _odrive,
}
"""Value of `can.protocol` to what makes a drive; each loads its own file only when asked."""


class SimulatedBus:
    """The drives of all wheels. Time is an argument; nothing here reads a clock or opens a bus.

    The drives do not hear each other: none of the protocols asks for it.

    Args:
        robot: The robot.
        simulation: Parameters of the plant and of the drives' loops.
        can: The installation.
        faults: Faults to play; none if None.
        seed: Seed of noise and losses.

    Attributes:
        drives: By wheel's name.
        heard, sent, lost: Frames so far.

    Raises:
        ParameterError: Robot, parameters or installation are refused.
    """

    def __init__(
        self,
        robot: Robot,
        simulation: SimulationParameters,
        can: CanParameters,
        faults: CanFaultParameters | None = None,
        seed: int = 0,
    ) -> None:
        can.check(robot)
        names = robot.wheels.names
        self._names = names
        self._random = random.Random(seed)
        self._wheels = Wheelset(robot, simulation, seed)
        directions = can.directions(len(names))
        self._shafts = [
            MotorShaft(self._wheels, k, robot, can.gear_ratio, directions[k])
            for k in range(len(names))
        ]
        make = PROTOCOLS[can.protocol]
        self.drives: dict[str, BusDrive] = {
            name: make(DriveSetup(self._shafts[k], can.nodes[k], robot, simulation, can, k))
            for k, name in enumerate(names)
        }
        self._simulation = simulation
        self._now: float | None = None
        self._skipped = 0.0
        self._ending = False
        self.heard = self.sent = self.lost = 0
        self._faults: CanFaultParameters | None = None
        self.set_faults(faults or CanFaultParameters())

    # bus

    def receive(self, message: can.Message, now: float) -> list[can.Message]:
        """Let the drives hear a frame; return what they send up to a time, s."""
        result = self.advance(now)
        if self._ending:
            return result
        self.heard += 1
        if self._is_lost():
            return result
        answers: list[can.Message] = []
        for drive in self.drives.values():
            answers += drive.receive(message, now)
        return result + self._carried(answers)

    def advance(self, now: float) -> list[can.Message]:
        """Run plant and drives up to a time, s; return what they send.

        Raises:
            InputError: Not finite.
        """
        frames: list[can.Message] = []
        if self._now is None or not math.isfinite(now):
            frames += self._run(now)
            self._now = now
        gap = max(now - self._now - LONGEST_GAP, 0.0)
        while now - gap - self._now >= PERIOD - 1e-9:
            self._now += PERIOD
            frames += self._run(self._now)
        self._now += gap
        self._skipped += gap
        return self._carried(frames)

    def _run(self, now: float) -> list[can.Message]:
        self._wheels.advance(now - self._skipped)
        if self._ending:
            return []
        return [frame for drive in self.drives.values() for frame in drive.advance(now)]

    def _is_lost(self) -> bool:
        assert self._faults is not None
        share = self._faults.lost_frames
        lost = share > 0.0 and self._random.random() < share
        self.lost += lost
        return lost

    def _carried(self, frames: list[can.Message]) -> list[can.Message]:
        """Return the frames that are not lost."""
        kept = [frame for frame in frames if not self._is_lost()]
        self.sent += len(kept)
        return kept

    # faults and parameters

    @property
    def faults(self) -> tuple[DriveFaults, ...]:
        """Faults of each drive, in the order of the wheels."""
        return tuple(drive.faults for drive in self.drives.values())

    def set_faults(self, faults: CanFaultParameters) -> None:
        """Switch faults on and off.

        Raises:
            ParameterError: A name is no wheel's; nothing has changed then.
        """
        reboots = tuple(drive.faults.reboots for drive in self.drives.values())
        new = drive_faults(faults, self._names, self._faults, reboots)
        self._faults = faults
        for drive, fault in zip(self.drives.values(), new, strict=True):
            drive.faults = fault

    def configure(
        self, robot: Robot, simulation: SimulationParameters, faults: CanFaultParameters
    ) -> None:
        """Take other parameters of robot and plant, in motion too, and faults; the drives stay.

        Raises:
            ParameterError: One of them is refused; nothing has changed then.
        """
        drive_faults(faults, self._names)
        self._wheels.configure(robot, simulation)
        self._simulation = simulation
        self.set_faults(faults)

    # the end

    def halt(self) -> None:
        """Switch the drives off: all wheels ramp to rest together, nothing is heard or sent."""
        self._ending = True
        speeds = [abs(self._wheels.velocity(k)) for k in range(len(self._wheels))]
        fastest, rate = max(speeds), self._simulation.firmware.quick_stop_deceleration
        for k, speed in enumerate(speeds):
            self._wheels.halt(k, rate * (max(speed / fastest, 0.05) if fastest else 1.0))

    def release(self) -> None:
        """Take the power off all motors."""
        for shaft in self._shafts:
            shaft.release()

    @property
    def fastest(self) -> float:
        """Largest measured wheel speed, rad/s."""
        return max(abs(self._wheels.velocity(k)) for k in range(len(self._wheels)))

    @property
    def at_rest(self) -> bool:
        """Whether all wheels stand."""
        return self.fastest < REST_SPEED

    # the plant

    @property
    def wheels(self) -> Wheelset:
        """The wheels, for what only a simulation knows."""
        return self._wheels

    def ground_truth(self) -> tuple[Array, Array]:
        """Pose (x, y, heading) of base_link in the world, and its twist in its own frame.

        Returns:
            Arrays of shape (3,): m, m, rad (not wrapped), and m/s, m/s, rad/s.
        """
        return self._wheels.ground_truth()

    def set_pose(self, pose: Sequence[float] | Array) -> None:
        """Put the robot elsewhere in the world: pose (x, y, heading) of base_link, m and rad.

        Raises:
            InputError: Wrong size or not finite.
        """
        self._wheels.set_pose(pose)


class OwnFrames:
    """Tells the echoes of one's own frames from those of others.

    Some interfaces (udp_multicast) bring back what one has sent. Each frame sent answers for one
    frame heard with the same id and data, for a while.
    """

    def __init__(self) -> None:
        self._sent: dict[tuple[int, bool, bytes], list[float]] = {}
        self._swept = -math.inf

    def add(self, message: can.Message, now: float) -> None:
        """A frame has been sent."""
        if now - self._swept > ECHO_TIME:
            self._swept = now
            self._sent = {
                key: young
                for key, times in self._sent.items()
                if (young := [at for at in times if now - at <= ECHO_TIME])
            }
        self._sent.setdefault(_key(message), []).append(now)

    def is_echo(self, message: can.Message, now: float) -> bool:
        """Whether a frame that was heard is one's own; it is then done with."""
        times = self._sent.get(_key(message), [])
        while times:
            if now - times.pop(0) <= ECHO_TIME:
                return True
        return False


def _key(message: can.Message) -> tuple[int, bool, bytes]:
    return message.arbitration_id, message.is_extended_id, bytes(message.data)
