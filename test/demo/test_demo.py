"""The judgement of the demo: its figures and their limits."""

import copy
import math

import pytest

from omniman_ros.demo.demo import LIMITS, Demo, expendable_wheel, judge
from omniman_ros.demo.limits import violations
from test import robots
from test.demo.samples import arm_run, perfect_run

GOAL = {"position_mm": 5.0, "heading_deg": 0.5, "clearance_m": 0.1, "time_s": 7.0}


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
    recording, legs = perfect_run()
    recording.energy = [(0.0, 0.0), (1.0, 1.0)]
    recording.commands = [0.0, 1.0, 2.0]
    (fault,) = judge(recording, legs)["faults"]
    assert "stalled" not in fault
    recording.stall = 0.5
    (fault,) = judge(recording, legs)["faults"]
    assert "(this machine stalled for 0.50 s meanwhile: try again)" in fault


@pytest.mark.parametrize(
    ("path", "value", "fault"),
    [
        (("tracking", "rms_mm"), 5.1, "tracking RMS, mm: 5.1, at most 5"),
        (("tracking", "rms_mm"), math.nan, "tracking RMS"),
        (("tracking", "max_mm"), 21.0, "tracking max"),
        (("tracking", "final_mm"), 11.0, "final position"),
        (("tracking", "final_heading_deg"), 2.0, "final heading"),
        (("odometry", "position_mm"), 101.0, "odometry position"),
        (("odometry", "heading_deg"), 7.0, "odometry heading"),
        (("twists", 0, "linear_m_s"), 0.04, "twist error, m/s"),
        (("twists", 0, "angular_rad_s"), 0.06, "twist error, rad/s"),
        (("timing", "odom", "rate_hz"), 70.0, "odom rate, Hz: 70, at least 80"),
        (("timing", "wheel_commands", "rate_hz"), math.nan, "wheel_commands rate"),
        (("goal", "position_mm"), 41.0, "goal position, mm: 41"),
        (("goal", "heading_deg"), math.nan, "goal heading, deg: nan"),
        (("goal", "clearance_m"), 0.0, "clearance of the obstacles, m: 0, above 0"),
        (("goal", "clearance_m"), math.nan, "clearance of the obstacles, m: nan"),
        (("arm", "final_mrad"), 3.1, "arm final position, mrad"),
        (("arm", "lag_ms"), -101.0, "arm behind its reference, ms: -101, at most 100"),
        (("arm", "rms_mrad"), 11.0, "arm off its path, mrad"),
        (("tool", "rms_mm"), 2.1, "tool off its path RMS, mm"),
        (("tool", "max_mm"), 5.1, "tool off its path max, mm"),
        (("dead_wheel", "noticed_s"), 2.1, "dead wheel noticed, s"),
        (("dead_wheel", "rms_mm"), math.inf, "tracking without a wheel RMS, mm: inf"),
        (("emergency_stop", "rest_s"), math.inf, "at rest after an emergency stop, s: inf"),
        (("emergency_stop", "arm_rest_s"), 1.2, "arm at rest after an emergency stop, s"),
        (("emergency_stop", "moved_mm"), 2.0, "moved after the reset, mm"),
        (("emergency_stop", "arm_moved_mrad"), 3.0, "arm moved after the reset, mrad"),
    ],
)
def test_every_figure_beyond_its_limit_is_a_fault_of_its_own(path, value, fault):
    result = copy.deepcopy(judge(*perfect_run())) | {
        "goal": dict(GOAL),
        "arm": {"final_mrad": 1.0, "lag_ms": 40.0, "rms_mrad": 1.0},
        "tool": {"rms_mm": 1.0, "max_mm": 2.0},
        "dead_wheel": {"noticed_s": 0.5, "rms_mm": 9.0},
        "emergency_stop": {
            "rest_s": 0.3,
            "arm_rest_s": 0.3,
            "moved_mm": 0.0,
            "arm_moved_mrad": 0.0,
        },
    }
    assert violations(result, LIMITS) == []
    inner = result
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    (found,) = violations(result, LIMITS)
    assert found.startswith(fault)


def test_an_arm_that_ends_at_other_angles_is_a_fault():
    recording, legs, moves = arm_run(offset=0.05)
    result = judge(recording, legs, moves)
    assert result["arm"]["final_mrad"] == pytest.approx(50.0, abs=12.0)
    assert any(fault.startswith("arm final position, mrad") for fault in result["faults"])
    assert any(fault.startswith("arm off its path, mrad") for fault in result["faults"])


def test_the_tool_is_led_only_with_an_arm():
    with_arm, without_arm = Demo("omniman"), Demo("omniman", has_arm=False)
    assert with_arm.tool in with_arm.legs
    assert without_arm.tool is None
    assert len(without_arm.legs) == len(with_arm.legs) - 1


@pytest.mark.parametrize("name", robots.ALL)
def test_a_wheel_is_lost_only_where_three_remain(name):
    robot = robots.robot(name)
    wheel = expendable_wheel(robot)
    assert wheel == (robot.wheels.names[-1] if robot.wheel_count > 3 else "")
