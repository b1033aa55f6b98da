"""The judgement of the demo: its figures and their limits."""

import math

import pytest

from omniman_ros.demo.demo import expendable_wheel, judge
from omniman_ros.demo.measures import LIMITS, Bound, violations
from test import robots
from test.demo.samples import arm_run, perfect_run

RISING = (Bound.AT_LEAST, Bound.ABOVE)


def test_a_perfect_run_has_no_fault():
    result = judge(*perfect_run())
    assert result["faults"] == []
    assert result["tracking"]["rms_mm"] == pytest.approx(0.0, abs=0.01)
    assert result["coupling"] == {
        "rms_rad": pytest.approx(math.sqrt(8e-6)),
        "max_rad": pytest.approx(0.004),
        "movements": {"there": 0.0, "back": pytest.approx(0.004)},
    }, "what lies between the movements does not count"
    assert result["energy"] == {"total_j": 3.5, "wheels_j": [3.0, 0.5]}
    assert result["timing"]["odom"]["rate_hz"] == pytest.approx(100.0)
    assert result["timing"]["wheel_commands"]["p99_ms"] == pytest.approx(5.0)


def test_a_fault_says_whether_the_machine_stalled():
    demo, recording = perfect_run()
    recording.energy = [(0.0, 0.0), (1.0, 1.0)]
    recording.commands = [0.0, 1.0, 2.0]
    (fault,) = judge(demo, recording)["faults"]
    assert "stalled" not in fault
    recording.stall = 0.5
    (fault,) = judge(demo, recording)["faults"]
    assert "(this machine stalled for 0.50 s meanwhile: try again)" in fault


def sections(figures):
    """Figures by section, from keys that are separated by dots."""
    result = {}
    for figure, value in figures.items():
        *path, key = figure.split(".")
        inner = result
        for name in path:
            inner = inner.setdefault(name, {})
        inner[key] = value
    return result


@pytest.mark.parametrize("limit", LIMITS, ids=lambda limit: limit.figure)
def test_every_figure_beyond_its_limit_is_a_fault_of_its_own(limit):
    within = {
        other.figure: other.value * (1.01 if other.bound in RISING else 0.99) for other in LIMITS
    }
    within |= {other.figure: 0.01 for other in LIMITS if other.bound is Bound.ABOVE}
    assert violations(sections(within)) == []
    beyond = {
        Bound.AT_MOST: (1.01 * limit.value + 0.01, -1.01 * limit.value - 0.01),
        Bound.AT_LEAST: (0.99 * limit.value,),
        Bound.ABOVE: (limit.value, limit.value - 0.01),
    }
    for value in (*beyond[limit.bound], math.nan):
        (found,) = violations(sections(within | {limit.figure: value}))
        assert found.startswith(f"{limit.name}: {value:.3g}, {limit.bound.value} ")


def test_each_item_of_a_list_has_the_limit():
    twists = [
        {"linear_m_s": 0.04, "angular_rad_s": 0.0},
        {"linear_m_s": 0.0, "angular_rad_s": 0.06},
    ]
    assert violations({"twists": twists}) == [
        "twist error, m/s: 0.04, at most 0.03",
        "twist error, rad/s: 0.06, at most 0.05",
    ]


def test_an_arm_that_ends_at_other_angles_is_a_fault():
    result = judge(*arm_run(offset=0.05))
    assert result["arm"]["final_mrad"] == pytest.approx(50.0, abs=12.0)
    assert any(fault.startswith("arm final position, mrad") for fault in result["faults"])
    assert any(fault.startswith("arm off its path, mrad") for fault in result["faults"])


@pytest.mark.parametrize("name", robots.ALL)
def test_a_wheel_is_lost_only_where_three_remain(name):
    robot = robots.robot(name)
    wheel = expendable_wheel(robot)
    assert wheel == (robot.wheels.names[-1] if robot.wheel_count > 3 else "")
