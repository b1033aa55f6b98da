"""Drive policy and simulated drives on one bus, in injected time and one process."""

import math
from dataclasses import fields, replace
from pathlib import Path

import can
import numpy as np

from omniman_ros.can_drives.drives import CanDrives, CanDrivesPhase
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.control.wheel_cascade import DriveMode, WheelCommand
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.can_drives.network import SimulatedBus
from omniman_ros.simulation.can_drives.parameters import CanFaultParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters

CONFIG = Path(__file__).resolve().parents[2] / "config" / "can"
STEP = 1e-3
LATENCY = 2e-4  #: Latency of a frame on the bus [s]
SPEED = np.array([4.0, 4.0, 4.0, 4.0])


class Rig:
    """Policy and simulated drives, stepped by the millisecond, with a record of all frames.

    Attributes:
        host: Times and frames of the host.
        other: Times and frames of the drives.
        speeds: Wheel speeds in each step [rad/s].
    """

    def __init__(self, protocol="cia402", robot="omniman", simulation=None, **changes):
        values = robot_parameters(robot)
        self.robot = build(Platform, values)
        given = dict(robot_parameters(str(CONFIG / f"{protocol}.yaml")))
        given |= {f"can.{key}": value for key, value in changes.items()}
        self.parameters = build(CanParameters, given, "can.")
        plant = build(SimulationParameters, {"plant.lifted": True} | (simulation or {}))
        self.bus = SimulatedBus(self.robot, plant, self.parameters)
        self.drives = CanDrives(self.robot, self.parameters)
        self.now = 50.0
        self.due = self.now
        self.frozen = False
        self.deaf = False
        self.command = None
        self.host, self.other = [], []
        self.speeds = []
        self.faults = CanFaultParameters()

    @property
    def names(self):
        return self.robot.wheels.names

    def set_faults(self, **changes):
        assert set(changes) <= {field.name for field in fields(CanFaultParameters)}
        self.faults = replace(self.faults, **changes)
        self.bus.set_faults(self.faults)

    def send(self, frames, at):
        """Deliver frames of the host to the drives, and their answers to the host."""
        for frame in frames:
            self.host.append((at, frame))
            message = can.Message(
                arbitration_id=frame.id,
                data=frame.data,
                is_extended_id=frame.extended,
                is_remote_frame=frame.remote,
            )
            self.hear(self.bus.receive(message, at))

    def hear(self, messages):
        for message in messages:
            frame = CanFrame(
                message.arbitration_id,
                bytes(message.data),
                message.is_extended_id,
                message.is_remote_frame,
            )
            self.other.append((self.now, frame))
            if not (self.frozen or self.deaf):
                self.send(self.drives.receive(frame, self.now + LATENCY), self.now + 2 * LATENCY)

    def run(self, seconds):
        for _ in range(round(seconds / STEP)):
            self.now += STEP
            if self.now >= self.due - 1e-9:
                self.due += self.parameters.period
                if not self.frozen:
                    if self.command is not None:
                        self.drives.set_command(self.command, self.now)
                    self.send(self.drives.tick(self.now), self.now)
            self.hear(self.bus.advance(self.now))
            self.speeds.append([self.bus.wheels.velocity(k) for k in range(len(self.names))])
        return self

    def until(self, done, patience=10.0):
        start = self.now
        while not done():
            assert self.now - start < patience, f"not within {patience} s: {self.say()}"
            self.run(STEP)
        return self.now - start

    def say(self):
        axes = [(axis.state.value, axis.fault_reason) for axis in self.drives.axes]
        return f"{self.drives.phase} '{self.drives.stop_reason}' {axes}"

    def up(self):
        self.run(0.05)
        self.drives.configure(self.now)
        self.until(lambda: self.drives.phase is not CanDrivesPhase.CONFIGURING)
        assert self.drives.phase is CanDrivesPhase.IDLE, self.drives.stop_reason
        self.drives.enable(self.now)
        self.until(lambda: self.drives.phase is CanDrivesPhase.DRIVING)
        return self

    def driving(self, speed=SPEED):
        """Bring the drives up, and all wheels to their speeds."""
        self.up()
        self.command = WheelCommand(DriveMode.VELOCITY, np.zeros(len(speed)), speed)
        self.until(lambda: np.abs(np.array(self.speeds[-1]) - speed).max() < 0.2)
        return self.run(0.1)

    @property
    def fastest(self):
        return max(map(abs, self.speeds[-1]))

    @property
    def standing(self):
        return self.fastest < 0.05

    def stopped_after(self, patience=3.0):
        """Return the time until the policy stops [s]."""
        return self.until(lambda: self.drives.stop_reason, patience)

    def steepest(self, since):
        """Return the largest deceleration of a wheel since a step, over 20 ms [rad/s^2]."""
        speeds = np.abs(np.array(self.speeds[since:]))
        return float(((speeds[:-20] - speeds[20:]) / 0.02).max()) if len(speeds) > 20 else math.nan
