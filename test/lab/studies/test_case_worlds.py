import importlib.util

import pytest

from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.case_worlds import case_world
from omniman_ros.lab.studies.mpc_cases import Scene, circle
from omniman_ros.lab.studies.mpc_loop import LoopOptions, MpcLoop
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


@IN_WORLD
def test_the_engine_tells_what_touches_the_robot():
    path = TwoVelocityPath((0.85, 0.0), (-0.8, 0.0))
    loop = loop_through(Scene("hit", (5.0, 0.0, 0.0), obstacles=(circle(0.3, path),)))
    for _ in range(6):
        loop.cycle()
    assert loop.touched == ["obstacle 1"]
