"""Worlds for the tests."""

from typing import Any

import numpy as np
import pytest

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives
from omniman_ros.simulation.world.parameters import WorldParameters
from omniman_ros.simulation.world.scene import Scene
from test import robots

pytest.importorskip("mujoco")

from omniman_ros.simulation.world.world import World

EMPTY = Scene()
NO_FRICTION = {"friction__viscous": [0.0], "friction__coulomb": [0.0], "friction__roller": [0.0]}
STEP = 0.001


class Bench:
    """A robot in a world, with its drives, and time that the test advances."""

    def __init__(
        self, name: str = "omniman", scene: Scene = EMPTY, plant: bool = False, **changes: Any
    ) -> None:
        values = robots.values(name, {key.replace("__", "."): v for key, v in changes.items()})
        self.description = build(DescriptionParameters, values)
        self.robot = self.description.robot
        self.simulation = build(SimulationParameters, values)
        self.parameters = build(WorldParameters, values, "world.")
        self.world = World(self.description, self.simulation, self.parameters, scene)
        body = None if plant else self.world
        self.drives = SimulatedDrives(self.robot, self.simulation, 0, body)
        self.inverse = PlatformKinematics(self.robot.wheels).J
        self.ticks = 0
        self.drives.advance(self.now)

    def drive(self, twist: Any, seconds: float) -> None:
        """Command a twist in velocity mode every 5 ms."""
        speeds = self.inverse @ np.asarray(twist)
        for _ in range(round(seconds / 0.005)):
            self.drives.command_velocity(speeds, None, self.now)
            self.ticks += 5
            self.drives.advance(self.now)

    def volts(self, voltage: Any, seconds: float) -> None:
        """Command voltages every 5 ms."""
        for _ in range(round(seconds / 0.005)):
            self.drives.command_voltage(voltage, self.now)
            self.ticks += 5
            self.drives.advance(self.now)

    def wait(self, seconds: float) -> None:
        """Let the drives rest."""
        self.ticks += round(seconds / STEP)
        self.drives.advance(self.now)

    @property
    def now(self) -> float:
        return self.ticks * STEP


def ideal(name: str = "omniman", scene: Scene = EMPTY, **changes: Any) -> Bench:
    """Return a robot on ideal wheels."""
    return Bench(name, scene, world__wheels="ideal", **changes)


def rollers(name: str = "omniman", scene: Scene = EMPTY, **changes: Any) -> Bench:
    """Return a robot on rollers."""
    return Bench(name, scene, world__wheels="rollers", **changes)
