"""The platform controller with ideal drives and without a real clock."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from omniman_ros.control.platform import PlatformController
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.control.wheel_cascade import DriveMode, WheelCommand
from omniman_ros.core.preview import Preview
from test.robots import parameters

DT = 0.005
START = 1000.0


class Rig:
    """A controller and its wheels; a tick is one report, one command and one step of the wheels.

    Attributes:
        core: The controller.
        now: Time of the latest tick [s].
        position, speed: (n,) angles [rad] and speeds [rad/s] of the wheels.
        true_pose: Pose of the platform if its wheels do not slip.
        setpoints, commands, poses: One entry per tick.
        drive: Maps a command to the wheels' speeds; replace it for drives that are not ideal.
        effort: Returns the torques (n,) that the drives report, or None.
    """

    def __init__(
        self, robot: str | PlatformParameters = "omniman", changes: Mapping[str, Any] | None = None
    ) -> None:
        made = parameters(robot, changes) if isinstance(robot, str) else robot
        self.core = PlatformController(made)
        self.now = START
        self.position = np.zeros(made.robot.wheel_count)
        self.speed = np.zeros(made.robot.wheel_count)
        self.setpoints: list[np.ndarray] = []
        self.commands: list[WheelCommand] = []
        self.poses: list[tuple[float, float, float]] = []
        self.drive = self.ideal
        self.reports = True
        self.effort: Callable[[], np.ndarray | None] = lambda: None

    @property
    def count(self) -> int:
        """Return the number of wheels."""
        return len(self.position)

    def ideal(self, command: WheelCommand) -> np.ndarray:
        """Return the speeds of drives that follow at once; a voltage gives its no-load speed."""
        if command.velocity is not None:
            return command.velocity
        if self.core.arbiter.active is not None and command.mode.value != self.mode:
            motor = self.core.parameters.robot.motor
            return command.effort / (motor.gear_ratio * motor.torque_constant)
        return self.core.cascade.reference

    @property
    def mode(self) -> str:
        """Return the mode of the drives while a source drives."""
        return self.core.parameters.drive.mode

    def report(self) -> str:
        """Report the state of the wheels to the controller."""
        return self.core.update_wheels(
            self.now, self.now, self.position.copy(), self.speed.copy(), self.effort()
        )

    def torques(self, *dead: int) -> np.ndarray:
        """Return the requested torques, including a probe, with those of dead wheels at zero."""
        command = self.commands[-1]
        result = np.array(command.effort)
        result[list(dead)] = 0.0
        return result

    def tick(self, dt: float = DT) -> WheelCommand | None:
        """Run one tick; without a command, the wheels keep their speeds."""
        self.now += dt
        if self.reports:
            self.report()
        command = self.core.tick(self.now)
        if command is not None:
            self.speed = np.array(self.drive(command))
        self.position = self.position + self.speed * dt
        self.setpoints.append(self.core.setpoint)
        self.commands.append(command)
        self.poses.append(self.core.odometry.pose)
        return command

    def run(self, seconds: float, feed: Callable[[], object] | None = None) -> "Rig":
        """Run ticks for a duration; `feed` is called 50 times per second, before the tick."""
        for i in range(round(seconds / DT)):
            if feed is not None and i % 4 == 0:
                feed()
            self.tick()
        return self

    def twist(self, *numbers: float, age: float | None = None, sent: float | None = None) -> str:
        """Send a cmd_vel."""
        return self.core.set_twist(np.array(numbers, dtype=float), self.now, age, sent)

    def cruise(self, *numbers: float, seconds: float = 2.5) -> "Rig":
        """Drive by cmd_vel until the platform reaches the twist."""
        return self.run(seconds, lambda: self.twist(*numbers))

    def line(
        self, velocity: tuple[float, float, float], seconds: float, start: float = 0.0
    ) -> Preview:
        """Return a preview at constant world-frame velocity from the pose; it ends in motion."""
        times = np.linspace(0, seconds, 5)
        pose = np.array(self.core.odometry.pose)
        poses = pose + np.outer(times, velocity)
        return Preview(self.now + start + times, poses, np.tile(np.array(velocity, float), (5, 1)))

    def move(
        self, goal: tuple[float, float, float], seconds: float, offset: float = 0.0
    ) -> Preview:
        """Return a minimum-jerk preview from rest to rest, relative to the current pose."""
        u = np.linspace(0, 1, 41)
        shape = 10 * u**3 - 15 * u**4 + 6 * u**5
        rate = (30 * u**2 - 60 * u**3 + 30 * u**4) / seconds
        bend = (60 * u - 180 * u**2 + 120 * u**3) / seconds**2
        pose = np.array(self.core.odometry.pose) + [offset, 0, 0]
        return Preview(
            self.now + u * seconds,
            pose + np.outer(shape, goal),
            np.outer(rate, goal),
            np.outer(bend, goal),
        )

    def trace(self, since: int = 0) -> list[tuple[Any, ...]]:
        """Return all outputs, for comparison bit for bit."""
        return [
            (
                command.mode.value,
                command.effort.tobytes(),
                None if command.velocity is None else command.velocity.tobytes(),
                pose,
            )
            for command, pose in zip(self.commands[since:], self.poses[since:], strict=True)
        ]

    @property
    def still(self) -> bool:
        """Return whether the latest command was exactly zero speed."""
        last = self.commands[-1]
        return (
            last.mode is DriveMode.VELOCITY
            and last.velocity is not None
            and not last.velocity.any()
            and not last.effort.any()
        )


def with_robot(made: Any) -> PlatformParameters:
    """Return parameters for another robot with wheels fast enough for the limits.

    It may have its mass anywhere, even beside its wheels: it cannot tip over.
    """
    known = parameters("omniman")
    motor = replace(made.motor, max_speed=1000.0)
    stability = replace(known.stability, limit=False)
    return replace(known, robot=replace(made, motor=motor), stability=stability)


def finite(command: WheelCommand) -> bool:
    """Return whether all numbers of a command are finite."""
    arrays = [command.effort] if command.velocity is None else [command.effort, command.velocity]
    return all(math.isfinite(float(np.abs(array).sum())) for array in arrays)
