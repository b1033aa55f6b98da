import math

import numpy as np
import pytest

from omniman_ros.lab.studies.closed_loop import LATENCY, PERIOD
from omniman_ros.lab.studies.coupling_loop import CouplingLoop
from omniman_ros.lab.studies.delay import step_response
from test import robots
from test.tiers import exhaustive


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.1])
def test_drives_without_lag_leave_the_margin_of_a_sampled_integrator_with_a_dead_time(delay):
    """An integrator with a dead time d is unstable from k = pi / (2 d) on."""
    values = {**robots.values("omniman"), "firmware.integral_time": 100.0}
    total = delay + LATENCY + 0.5 * PERIOD
    critical = CouplingLoop(values).critical_gain(delay)
    assert critical < 0.5 * math.pi / total
    assert critical > 0.5 * math.pi / (total + 0.008)  # the lag of the drives: some milliseconds


def test_small_gains_decay_as_the_continuous_equation():
    loop = CouplingLoop(robots.values("omniman"))
    assert loop.growth(0.5, 0.0) == pytest.approx(math.exp(-0.5 * PERIOD), rel=1e-4)
    assert loop.growth(0.0, 0.0) == pytest.approx(1.0, abs=1e-9)


def test_critical_gain_and_delay_margin_are_the_same_boundary():
    loop = CouplingLoop(robots.values("omniman"))
    for delay in (0.01, 0.05):
        critical = loop.critical_gain(delay)
        assert loop.growth(0.999 * critical, delay) < 1.0 <= loop.growth(1.001 * critical, delay)
        assert loop.delay_margin(0.999 * critical) == pytest.approx(delay)
        assert loop.delay_margin(1.001 * critical) == pytest.approx(delay - 0.001)
    assert np.isnan(loop.delay_margin(400.0))


@pytest.mark.parametrize("delay", [exhaustive(0.01), 0.05])
@pytest.mark.parametrize(("share", "settles"), [(0.9, True), (1.1, False)])
def test_simulated_wheels_oscillate_where_the_model_says(delay, share, settles):
    values = robots.values("omniman")
    gain = share * CouplingLoop(values).critical_gain(delay)
    assert step_response(values, gain, delay).settled is settles
