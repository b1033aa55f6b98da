import numpy as np
import pytest

from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.closed_loop import LATENCY, ClosedLoop
from omniman_ros.simulation.plant.parameters import SimulationParameters
from test import robots


def make(torques=True, **changes):
    parameters = robots.parameters("omniman", changes)
    return ClosedLoop(parameters, build(SimulationParameters, {}), torques)


def drive(loop, ticks, twist=(0.3, 0.0, 0.0)):
    for _ in range(ticks):
        loop.controller.set_twist(np.array(twist), loop.now)
        loop.step()
    return loop


def test_true_state_is_of_the_time_of_the_measurement():
    loop = drive(make(), 400)
    after = loop.drives.ground_truth()[0]
    assert after[0] - loop.truth[0] == pytest.approx(0.3 * LATENCY, rel=0.05)
