"""The scenes of the test cases as physics worlds, in which the engine judges contact."""

import math
from collections.abc import Mapping
from typing import Any

from omniman_ros.lab.studies.mpc_cases import Scene
from omniman_ros.lab.studies.scene_geometry import Wall
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.simulation.world import scene as things

HEIGHT = 2.0  # height of obstacles and walls [m]


def obstacle_name(index: int) -> str:
    """Return the name in the world of the obstacle with an index in its scene."""
    return f"obstacle {index + 1}"


def case_world(robot: Mapping[str, Any], wheels: str, scene: Scene) -> WorldChoice:
    """Return a scene as a world: circles that stand as posts, those that move as persons."""
    posts, persons = [], []
    for k, obstacle in enumerate(scene.obstacles):
        x, y = (float(value) for value in obstacle.place(0.0))
        name, radius = obstacle_name(k), obstacle.semi_axes[0]
        if obstacle.is_fixed:
            posts.append(things.Post(name=name, x=x, y=y, radius=radius, height=HEIGHT))
        else:
            persons.append(things.Person(name=name, x=(x,), y=(y,), radius=radius, height=HEIGHT))
    walls = tuple(_wall(k, wall) for k, wall in enumerate(scene.walls))
    around = things.Scene(
        start=scene.start, walls=walls, posts=tuple(posts), persons=tuple(persons)
    )
    return WorldChoice.of(robot, wheels, around)


def _wall(index: int, wall: Wall) -> things.Wall:
    """Return a wall of the world from its middle, heading and length."""
    half = 0.5 * wall.length
    along = half * math.cos(wall.heading), half * math.sin(wall.heading)
    return things.Wall(
        name=f"wall {index + 1}",
        x=(wall.x - along[0], wall.x + along[0]),
        y=(wall.y - along[1], wall.y + along[1]),
        thickness=wall.width,
        height=HEIGHT,
    )
