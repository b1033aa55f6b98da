"""Random scenes as physics worlds, in which the engine tells contact."""

import math
from collections.abc import Mapping
from typing import Any

from omniman_ros.lab.studies.case_worlds import HEIGHT, obstacle_name
from omniman_ros.lab.studies.scene_generator import RandomScene
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.simulation.world import scene as things

UPRIGHT = (0.0, -0.5 * math.pi, 0.0, -0.5 * math.pi, 0.0, 0.0)
"""Posture of the arm, if the robot has one, in which it is above the platform [rad]."""


def scene_world(robot: Mapping[str, Any], wheels: str, scene: RandomScene) -> WorldChoice:
    """Return a random scene as a world; each obstacle is a column, where it is at time 0."""
    columns = []
    for k, obstacle in enumerate(scene.obstacles):
        x, y = obstacle.place(0.0).tolist()
        length, width = (2.0 * axis for axis in obstacle.semi_axes)
        columns.append(
            things.Column(
                name=obstacle_name(k),
                x=x,
                y=y,
                yaw=obstacle.angle,
                length=length,
                width=width,
                height=HEIGHT,
            )
        )
    around = things.Scene(start=scene.start, columns=tuple(columns))
    return WorldChoice.of(robot, wheels, around, UPRIGHT)
