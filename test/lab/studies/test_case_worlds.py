import importlib.util
import math

import numpy as np
import pytest

from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.case_worlds import case_world
from omniman_ros.lab.studies.mpc_cases import Scene, circle, corridor, moving
from omniman_ros.lab.studies.mpc_loop import LoopOptions, MpcLoop
from omniman_ros.lab.studies.scene_geometry import Wall
from omniman_ros.planning.cases import TwoVelocityPath
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters
from test import robots

IN_WORLD = pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="needs mujoco")


def loop_through(scene):
    values = robots.values("ig42")
    return MpcLoop(
        build(PlannerParameters, values),
        robots.parameters("ig42"),
        build(SimulationParameters, {}),
        LoopOptions(
            start=scene.start,
            obstacles=scene.obstacles,
            world=case_world(values, "ideal", scene),
        ),
    )


def test_circles_that_stand_are_posts_and_those_that_move_are_persons():
    values = robots.values("ig42")
    standing, walking = (case_world(values, "ideal", make()).scene for make in (corridor, moving))
    assert len(standing.posts) == len(walking.persons) == 4
    assert not standing.persons and not walking.posts
    assert {post.radius for post in standing.posts} == {0.3}


def test_a_wall_keeps_its_middle_heading_length_and_thickness():
    scene = Scene("walls", (5.0, 0.0, 0.0), walls=(Wall(2.0, 1.0, math.pi / 2, 3.0, 0.2),))
    (wall,) = case_world(robots.values("ig42"), "ideal", scene).scene.walls
    np.testing.assert_allclose([wall.x, wall.y], [(2.0, 2.0), (-0.5, 2.5)])
    assert wall.thickness == 0.2


@IN_WORLD
def test_obstacles_move_in_the_world_as_they_do_in_the_scene():
    path = TwoVelocityPath((3.0, -1.0), (0.0, 0.5), 0.2, (0.4, 0.0))
    loop = loop_through(Scene("one", (5.0, 0.0, 0.0), obstacles=(circle(0.3, path),)))
    for _ in range(8):
        loop.cycle()
    (person,) = loop.loop.world.obstacles
    np.testing.assert_allclose(person.pose[:2], path(loop.now - 0.005), atol=0.003)
    assert not loop.touched


@IN_WORLD
def test_the_engine_tells_what_touches_the_robot():
    path = TwoVelocityPath((0.85, 0.0), (-0.8, 0.0))
    loop = loop_through(Scene("hit", (5.0, 0.0, 0.0), obstacles=(circle(0.3, path),)))
    for _ in range(6):
        loop.cycle()
    assert loop.touched == ["obstacle 1"]
