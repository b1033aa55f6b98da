from itertools import count

import numpy as np
import pytest

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.closed_loop import PERIOD
from omniman_ros.lab.studies.mpc_loop import SOLVE_TICKS, LoopOptions, MpcLoop
from omniman_ros.planning.goals import PoseGoal
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.plant.parameters import SimulationParameters


@pytest.mark.parametrize(
    ("timed", "each", "published", "ticks"),
    [
        (False, 0.024, SOLVE_TICKS, 10),
        (True, 0.012, 5, 10),  # 12 ms for the plan, for the choice, and for the route
        (True, 0.024, 10, 20),  # a cycle of 72 ms: the next one begins after 100 ms
    ],
)
def test_an_answer_takes_what_it_took_where_the_loop_is_timed(timed, each, published, ticks):
    robot, readings = robot_parameters("ig42"), count(step=each)
    parameters, platform = build(PlannerParameters, robot), build(PlatformParameters, robot)
    options = LoopOptions(timer=lambda: float(next(readings)), timed=timed)
    loop = MpcLoop(parameters, platform, build(SimulationParameters, {}), options)
    loop.drive(PoseGoal(np.array([1.0, 0.0, 0.0])))
    begin = loop.now
    loop.cycle()
    assert loop.cycles[-1].cycle_time == pytest.approx(3.0 * each)
    assert loop.cycles[-1].time - begin == pytest.approx(published * PERIOD)
    assert loop.now - begin == pytest.approx(ticks * PERIOD)
