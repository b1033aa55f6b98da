import importlib.util

import pytest

from omniman_ros.lab.studies.roller_lag import measure_roller_lag
from omniman_ros.lab.studies.worlds import WorldChoice
from test import robots

IN_WORLD = pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="needs mujoco")


def lag(wheels, duration):
    values = robots.values("omniman")
    world = WorldChoice.of(values, wheels) if wheels else None
    return measure_roller_lag(values, world, duration)


def test_the_wheels_of_the_plant_have_no_lag():
    assert lag(None, 1.0) < 1e-4


@IN_WORLD
def test_ideal_wheels_have_no_lag_and_rollers_have_one():
    assert lag("ideal", 0.5) < 1e-3
    assert 5e-3 < lag("rollers", 1.0) < 15e-3
