"""Simulated drives of an installation, on one bus and one plant."""

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import can

from omniman_ros.core.arrays import Array
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.platform import Platform
from omniman_ros.simulation.can_drives.motor import DriveFaults
from omniman_ros.simulation.can_drives.parameters import CanFaultParameters, drive_faults
from omniman_ros.simulation.can_drives.shaft import MotorShaft
from omniman_ros.simulation.plant.driven_wheels import DrivenWheels
from omniman_ros.simulation.plant.parameters import SimulationParameters

PERIOD = 1e-3  #: Time between two runs of the drives' firmware [s]
MAX_GAP = 5.0  #: Longest time between two calls that is simulated [s]; all rests by then
REST_SPEED = 0.05  #: Speed below which a wheel counts as at rest [rad/s]
RAMP_END_SPEED = 0.2  #: Wheel speed at which a drive considers its ramp to rest complete [rad/s]
UNDERVOLTAGE = 0.5  #: Ratio of a drive's lowest supply to the motor's largest voltage
ECHO_TIMEOUT = 0.5  #: Longest time after which the echo of a frame arrives [s]


class BusDrive(Protocol):
    """Firmware of one drive, which receives and sends frames and controls a motor.

    Times are arguments [s]. A new drive switches its motor's power off.
    """

    faults: DriveFaults  #: Faults to simulate; the caller may change them at any time

    def receive(self, message: can.Message, now: float) -> list[can.Message]:
        """Process a frame from the bus, of any sender and kind; return the answers."""

    def advance(self, now: float) -> list[can.Message]:
        """Run timers and watchdogs up to a time; return the frames that are due.

        It is called often, if possible at least every 2 ms of `now`.
        """


@dataclass(frozen=True)
class DriveSetup:
    """Data from which a drive is created."""

    motor: MotorShaft  #: Motor of the drive
    node: int  #: Id of the drive
    robot: Platform
    simulation: SimulationParameters  #: Parameters of the plant and of the drives' loops
    can: CanParameters  #: The installation
    number: int  #: Number of the wheel


def _cia402(setup: DriveSetup) -> BusDrive:
    from omniman_ros.simulation.can_drives.cia402.drive import Cia402Drive, Cia402Settings

    motor, can, data = setup.motor, setup.can, setup.robot.motor
    firmware, gear = setup.simulation.firmware, setup.motor.gear_ratio
    max_torque = motor.torque_constant * data.max_current
    rated = can.rated_torque or max_torque
    settings = Cia402Settings(
        counts=can.counts,
        velocity_scale=can.velocity_scale or can.counts,
        rated_torque=rated,
        rated_current=rated / motor.torque_constant,
        quick_stop_deceleration=firmware.quick_stop_deceleration * gear,
        acceleration=firmware.acceleration * gear,
        deceleration=firmware.deceleration * gear,
        max_torque=max_torque,
        undervoltage=UNDERVOLTAGE * data.max_voltage,
        standstill=RAMP_END_SPEED * gear,
        serial=setup.number + 1,
    )
    return Cia402Drive(motor, setup.node, settings)


def _vesc(setup: DriveSetup) -> BusDrive:
    from omniman_ros.simulation.can_drives.vesc import VescDrive, VescSettings

    can = setup.can
    rate = 1.0 / (can.feedback_period or can.period)
    settings = VescSettings(
        pole_pairs=can.pole_pairs,
        torque_constant=setup.motor.torque_constant,
        timeout=can.heartbeat_timeout,
        status_1_rate=rate,
        status_5_rate=rate,
    )
    return VescDrive(setup.motor, setup.node, settings)


def _odrive(setup: DriveSetup) -> BusDrive:
    from omniman_ros.simulation.can_drives.odrive.drive import OdriveDrive
    from omniman_ros.simulation.can_drives.odrive.settings import OdriveSettings

    can = setup.can
    settings = OdriveSettings(
        torque_constant=setup.motor.torque_constant,
        heartbeat=can.drive_heartbeat,
        encoder=can.feedback_period or can.period,
        watchdog=can.heartbeat_timeout,
    )
    return OdriveDrive(setup.motor, setup.node, settings)


PROTOCOLS: dict[str, Callable[[DriveSetup], BusDrive]] = {
    "cia402": _cia402,
    "vesc": _vesc,
    "odrive": _odrive,
}  #: Factories of drives by value of the parameter `can.protocol`; each imports its own module


class SimulatedBus:
    """Simulates the drives of all wheels, without a real bus; times are arguments.

    The drives do not receive each other's frames: none of the protocols needs it. Times, poses and
    parameters raise the errors of :class:`SimulatedDrives`.

    Raises:
        ParameterError: Robot, parameters or installation are invalid.
    """

    def __init__(
        self,
        robot: Platform,
        simulation: SimulationParameters,
        can: CanParameters,
        faults: CanFaultParameters | None = None,
        seed: int = 0,
    ) -> None:
        can.check(robot)
        names = robot.wheels.names
        self._names = names
        self._random = random.Random(seed)
        self._wheels = DrivenWheels(robot, simulation, seed)
        directions = can.directions(len(names))
        self._shafts = [
            MotorShaft(self._wheels, k, robot, can.gear_ratio, directions[k])
            for k in range(len(names))
        ]
        if can.protocol not in PROTOCOLS:
            raise ParameterError("can.protocol", can.protocol, "has no simulated drives")
        make = PROTOCOLS[can.protocol]
        #: Drives by name of the wheel
        self.drives: dict[str, BusDrive] = {
            name: make(DriveSetup(self._shafts[k], can.nodes[k], robot, simulation, can, k))
            for k, name in enumerate(names)
        }
        self._simulation = simulation
        self._now: float | None = None
        self._skipped = 0.0
        self._is_halted = False
        self.received = self.sent = self.lost = 0  #: Numbers of frames
        self._faults: CanFaultParameters | None = None
        self.set_faults(faults or CanFaultParameters())

    # ---- bus ----------------------------------------------------------------------------------

    def receive(self, message: can.Message, now: float) -> list[can.Message]:
        """Deliver a frame to the drives; return the frames they send up to a time [s]."""
        result = self.advance(now)
        if self._is_halted:
            return result
        self.received += 1
        if self._is_lost():
            return result
        answers: list[can.Message] = []
        for drive in self.drives.values():
            answers += drive.receive(message, now)
        return result + self._without_lost(answers)

    def advance(self, now: float) -> list[can.Message]:
        """Run plant and drives up to a time [s]; return the frames they send."""
        frames: list[can.Message] = []
        if self._now is None or not math.isfinite(now):
            frames += self._run(now)
            self._now = now
        gap = max(now - self._now - MAX_GAP, 0.0)
        while now - gap - self._now >= PERIOD - 1e-9:
            self._now += PERIOD
            frames += self._run(self._now)
        self._now += gap
        self._skipped += gap
        return self._without_lost(frames)

    def _run(self, now: float) -> list[can.Message]:
        self._wheels.advance(now - self._skipped)
        if self._is_halted:
            return []
        return [frame for drive in self.drives.values() for frame in drive.advance(now)]

    def _is_lost(self) -> bool:
        assert self._faults is not None
        probability = self._faults.lost_frames
        is_lost = probability > 0.0 and self._random.random() < probability
        self.lost += is_lost
        return is_lost

    def _without_lost(self, frames: list[can.Message]) -> list[can.Message]:
        delivered = [frame for frame in frames if not self._is_lost()]
        self.sent += len(delivered)
        return delivered

    # ---- faults and parameters ----------------------------------------------------------------

    @property
    def faults(self) -> tuple[DriveFaults, ...]:
        """Faults of each drive, wheels in the robot's order."""
        return tuple(drive.faults for drive in self.drives.values())

    def set_faults(self, faults: CanFaultParameters) -> None:
        """Switch faults on and off."""
        reboots = tuple(drive.faults.reboots for drive in self.drives.values())
        new = drive_faults(faults, self._names, self._faults, reboots)
        self._faults = faults
        for drive, fault in zip(self.drives.values(), new, strict=True):
            drive.faults = fault

    def configure(
        self, robot: Platform, simulation: SimulationParameters, faults: CanFaultParameters
    ) -> None:
        """Replace parameters of robot and plant, also in motion, and faults; keep the drives.

        A drive whose motor is not dead any more uses it again: no frame tells the host of an open
        circuit, so that the host cannot reset it.
        """
        drive_faults(faults, self._names)
        self._wheels.configure(robot, simulation)
        repaired = set(self._simulation.faults.dead_motor) - set(simulation.faults.dead_motor)
        for name in repaired:
            self._wheels.reset(self._names.index(name))
        self._simulation = simulation
        self.set_faults(faults)

    # ---- shutdown -----------------------------------------------------------------------------

    def halt(self) -> None:
        """Switch the drives off: all wheels ramp to rest together, without any frames."""
        self._is_halted = True
        speeds = [abs(self._wheels.velocity(k)) for k in range(len(self._wheels))]
        fastest, rate = max(speeds), self._simulation.firmware.quick_stop_deceleration
        for k, speed in enumerate(speeds):
            self._wheels.halt(k, rate * (max(speed / fastest, 0.05) if fastest else 1.0))

    def release(self) -> None:
        """Switch the power of all motors off."""
        for shaft in self._shafts:
            shaft.release()

    @property
    def fastest(self) -> float:
        """Largest measured wheel speed [rad/s]."""
        return max(abs(self._wheels.velocity(k)) for k in range(len(self._wheels)))

    @property
    def at_rest(self) -> bool:
        """Whether all wheels are at rest."""
        return self.fastest < REST_SPEED

    # ---- plant --------------------------------------------------------------------------------

    @property
    def simulated_until(self) -> float | None:
        """Instant up to which plant and drives were simulated [s]; None before the first."""
        return self._now

    @property
    def wheels(self) -> DrivenWheels:
        """The simulated wheels, with their true state."""
        return self._wheels

    def ground_truth(self) -> tuple[Array, Array]:
        """Return pose (3,) and twist (3,) of base_link, as `DrivenWheels.ground_truth` does."""
        return self._wheels.ground_truth()

    def set_pose(self, pose: Sequence[float] | Array) -> None:
        """Move the robot to a pose (x, y, heading) of base_link in the world [m, m, rad]."""
        self._wheels.set_pose(pose)


class EchoFilter:
    """Recognises the echoes of a sender's own frames.

    Some interfaces (udp_multicast) return sent frames. For :data:`ECHO_TIMEOUT`, one received
    frame per sent frame with the same id and data counts as its echo.
    """

    def __init__(self) -> None:
        self._sent: dict[tuple[int, bool, bytes], list[float]] = {}
        self._purged_at = -math.inf

    def record_sent(self, message: can.Message, now: float) -> None:
        """Remember a frame that was sent at a time [s]."""
        if now - self._purged_at > ECHO_TIMEOUT:
            self._purged_at = now
            self._sent = {
                key: recent
                for key, times in self._sent.items()
                if (recent := [at for at in times if now - at <= ECHO_TIMEOUT])
            }
        self._sent.setdefault(_key(message), []).append(now)

    def is_echo(self, message: can.Message, now: float) -> bool:
        """Return whether a received frame is an echo; if so, it is expected no longer."""
        times = self._sent.get(_key(message), [])
        while times:
            if now - times.pop(0) <= ECHO_TIMEOUT:
                return True
        return False


def _key(message: can.Message) -> tuple[int, bool, bytes]:
    return message.arbitration_id, message.is_extended_id, bytes(message.data)
