"""Tests of what Nav2's parameters for a robot are merged from."""

import pytest

from omniman_ros.nav2.configuration import merged
from omniman_ros.processes.nav2_setup import nav2_parameters


def test_groups_are_merged_and_values_replaced():
    base = {"a": {"b": 1, "c": {"d": 2}}, "e": 3}
    assert merged(base, {"a": {"c": {"f": 4}}, "e": {"g": 5}}) == {
        "a": {"b": 1, "c": {"d": 2, "f": 4}},
        "e": {"g": 5},
    }
    assert base == {"a": {"b": 1, "c": {"d": 2}}, "e": 3}


@pytest.mark.parametrize("speed", [0.3, 1.5])
def test_the_local_costmap_is_as_large_as_the_horizon_at_the_robots_speed(speed):
    nav2 = nav2_parameters("ig42", values={"limits.linear_velocity": speed})
    mppi = nav2["controller_server"]["ros__parameters"]["FollowPath"]
    way = mppi["time_steps"] * mppi["model_dt"] * 0.8 * speed
    assert mppi["prune_distance"] == pytest.approx(way)
    local = nav2["local_costmap"]["local_costmap"]["ros__parameters"]
    assert 0.0 <= local["width"] / 2 - way - 0.472 < 1.0
