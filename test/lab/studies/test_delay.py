import math

import pytest

from omniman_ros.control.coupling_controller import CouplingParameters
from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.closed_loop import PERIOD
from omniman_ros.lab.studies.delay import EPSILON_STEP, step_response
from test import robots

DEFAULT = build(CouplingParameters, {}).k_epsilon


@pytest.mark.parametrize("robot", robots.SHIPPED)
def test_default_gain_settles_with_delayed_commands(robot):
    response = step_response(robots.values(robot), DEFAULT, 0.05)
    assert response.delay == pytest.approx(0.05)
    assert response.settled
    assert 0.1 < response.overshoot < 0.5
    count = 2 * math.pi / robots.robot(robot).motor.encoder_counts
    late = step_response(robots.values(robot), DEFAULT, 0.02)
    assert late.overshoot <= 0.02 + 3 * count / EPSILON_STEP


@pytest.mark.exhaustive
def test_overshoot_grows_with_delay_up_to_oscillation():
    robot = robots.values("omniman")
    calm, late, lost = (step_response(robot, k, d) for k, d in ((20, 0.0), (20, 0.05), (40, 0.05)))
    assert calm.overshoot < 0.05
    assert 0.3 < late.overshoot < 1.0
    assert calm.settled and late.settled
    assert not lost.settled
    assert lost.swing > 1.0


def test_delays_are_whole_ticks():
    assert step_response(robots.values("omniman"), 5.0, 0.012).delay == pytest.approx(2 * PERIOD)


@pytest.mark.exhaustive
def test_floor_damps_a_gain_that_oscillates_on_blocks():
    robot = robots.values("omniman")
    on_blocks, on_floor = (step_response(robot, 30.0, 0.05, lifted) for lifted in (True, False))
    assert not on_blocks.settled
    assert on_floor.settled and not on_floor.lifted
