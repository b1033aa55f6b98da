"""Robots that tests share: those of config/, those of test/config/, and random ones.

`robots.path(name)` is what nodes take as `robot:=`.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform, Wheels
from omniman_ros.robots import robot_parameters

CONFIG = Path(__file__).resolve().parent / "config"

SHIPPED = ("omniman", "ig42")
TESTED = ("omni3", "mecanum6", "skewed4", "mecanum8")
ALL = SHIPPED + TESTED  #: Names of all robots: n = 4, 4, 3, 6, 4 and 8 wheels


def path(name: str) -> str:
    """What `robot_parameters` and the parameter `robot` of nodes take for one of ALL."""
    return name if name in SHIPPED else str(CONFIG / f"{name}.yaml")


def values(name: str = "omniman", changes: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Full parameter names to values of a robot's file, with changes."""
    return {**robot_parameters(path(name)), **(changes or {})}


def parameters(
    name: str = "omniman", changes: Mapping[str, Any] | None = None
) -> PlatformParameters:
    """Parameters of the platform controller: a robot's file, defaults, and changes.

    Example: parameters("ig42", {"limits.linear_velocity": 0.5, "drive.mode": "torque"})
    """
    return build(PlatformParameters, values(name, changes))


def robot(name: str = "omniman", changes: Mapping[str, Any] | None = None) -> Platform:
    """One of ALL, with changes by full parameter name."""
    return build(Platform, values(name, changes))


def kinematics(name: str = "omniman", changes: Mapping[str, Any] | None = None) -> Any:
    """Kinematics of one of ALL."""
    return PlatformKinematics(robot(name, changes).wheels)


def random_wheels(rng: np.random.Generator, n: int) -> Wheels:
    """n wheels anywhere, mounted at any angle, radii and rollers unequal.

    They are drawn again until they drive the platform in all directions without much effort.
    """
    while True:
        wheels = Wheels(
            names=tuple(f"wheel_{i}" for i in range(n)),
            x=tuple(rng.uniform(-1, 1, n).tolist()),
            y=tuple(rng.uniform(-1, 1, n).tolist()),
            heading=tuple(rng.uniform(-math.pi, math.pi, n).tolist()),
            roller_angle=tuple(rng.uniform(-1.2, 1.2, n).tolist()),
            radius=tuple(rng.uniform(0.03, 0.3, n).tolist()),
            inertia=tuple(rng.uniform(0.001, 0.2, n).tolist()),
        )
        rows = [
            [math.cos(d + g), math.sin(d + g), x * math.sin(d + g) - y * math.cos(d + g)]
            for x, y, d, g in zip(
                wheels.x, wheels.y, wheels.heading, wheels.roller_angle, strict=True
            )
        ]
        if np.linalg.svd(np.array(rows), compute_uv=False)[2] > 0.1:
            return wheels


def random_robot(rng: np.random.Generator, n: int) -> Platform:
    """Random wheels below a random body with an arm, each wheel with its own friction."""
    known = robot("skewed4")
    return Platform(
        wheels=random_wheels(rng, n),
        body=build(
            type(known.body),
            {
                "mass": rng.uniform(5, 200),
                "inertia": rng.uniform(0.1, 30),
                "com_x": rng.uniform(-0.2, 0.2),
                "com_y": rng.uniform(-0.2, 0.2),
                "length": 1.0,
                "width": 0.8,
            },
        ),
        arm=build(
            type(known.arm),
            {
                "mass": rng.uniform(0, 30),
                "inertia": rng.uniform(0, 2),
                "com_x": rng.uniform(-0.3, 0.3),
                "com_y": rng.uniform(-0.3, 0.3),
            },
        ),
        motor=known.motor,
        friction=build(
            type(known.friction),
            {
                "viscous": rng.uniform(0, 0.1, n).tolist(),
                "coulomb": rng.uniform(0, 1, n).tolist(),
                "roller": rng.uniform(0, 0.05, n).tolist(),
                "mu": 0.6,
            },
        ),
    )
