import importlib.util

import pytest

from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.mpc_loop import LoopOptions, MpcLoop
from omniman_ros.lab.studies.scene_geometry import MovingObstacle
from omniman_ros.lab.studies.worlds import scene_world
from omniman_ros.planning.cases import TwoVelocityPath
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters
from test import robots

IN_WORLD = pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="needs mujoco")


@IN_WORLD
def test_the_engine_tells_what_touches_the_robot():
    values = robots.values("ig42")
    obstacle = MovingObstacle((0.3, 0.3), TwoVelocityPath((0.85, 0.0), (-0.8, 0.0)))
    world = scene_world(values, "ideal", (0.0, 0.0, 0.0), [obstacle])
    loop = MpcLoop(
        build(PlannerParameters, values),
        robots.parameters("ig42"),
        build(SimulationParameters, {}),
        LoopOptions(obstacles=[obstacle], world=world),
    )
    for _ in range(6):
        loop.cycle()
    assert loop.touched == ["obstacle 1"]
