import numpy as np
import pytest

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.mpc_loop import PLANNER_PERIOD, LoopOptions, MovingObstacle, MpcLoop
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.planning.goals import PoseGoal
from omniman_ros.planning.obstacles.ellipses import Ellipses
from omniman_ros.planning.obstacles.separation import box_gap
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.simulation.plant.parameters import SimulationParameters
from test import robots
from test.tiers import exhaustive

GOAL = np.array([1.2, 0.4, 0.3])


def a_loop(name="ig42", **kwargs):
    values = robots.values(name)
    return MpcLoop(
        build(PlannerParameters, values),
        build(PlatformParameters, values),
        build(SimulationParameters, {}),
        LoopOptions(**kwargs),
    )


@pytest.mark.parametrize("voltages", [exhaustive(False), True])
def test_slipping_plant_reaches_the_goal_past_an_obstacle(voltages):
    beside = MovingObstacle((0.2, 0.15), lambda t: np.array([0.75, -0.35 + 0.01 * t]), 0.4)
    loop = a_loop(voltages=voltages, obstacles=[beside], start=(0.0, 0.1, 0.0))
    loop.drive(PoseGoal(GOAL))
    loop.run(9.0)
    trace = loop.trace
    assert trace.states[-1] is PlannerState.ARRIVED or loop.planner.state is PlannerState.ARRIVED
    poses, times = np.array(trace.poses), np.array(trace.times)
    assert np.hypot(*(poses[-1] - GOAL)[:2]) < 0.04
    assert abs(poses[-1, 2] - GOAL[2]) < 0.04
    np.testing.assert_allclose(np.diff(times), PLANNER_PERIOD, atol=1e-9)
    # The true shapes stay clear of each other.
    places = np.array(trace.obstacles)
    assert places.shape == (len(times), 1, 2)
    axes = np.tile([0.2, 0.15], (len(times), 1, 1))
    gaps = box_gap(poses, loop.planner.footprint.whole, places, axes, np.array([0.4]))
    assert gaps.min() > 0.0
    # Most solutions are used, and energy is consumed.
    used = [report.used for report in trace.reports]
    assert np.mean(used) > 0.9
    assert all(
        report.lateness < 0.0 for report, was in zip(trace.reports, used, strict=True) if was
    )
    assert trace.energy[-1] > trace.energy[0] + 5.0
    assert isinstance(loop.observed.ellipses(loop.now), Ellipses)
    # The setpoints are followed.
    away = np.hypot(*(poses - np.array(trace.references))[:, :2].T)
    assert away.max() < 0.12
