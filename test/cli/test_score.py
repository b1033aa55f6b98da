import copy
import math

import numpy as np
import pytest

from omniman_ros.cli.figures import Figure, TwistPhase
from omniman_ros.cli.recorder import Recording
from omniman_ros.cli.score import (
    DrivenFigure,
    DrivenTwist,
    drift,
    faults,
    intervals,
    judge,
    tracking,
    twist_error,
)

START = 1000.0
FIGURE = Figure((0.5, 0.2, 0.3))


def followed(error=(0.0, 0.0, 0.0)):
    """Rows of odom of a robot that follows the figure with a constant error."""
    times = np.arange(-1.0, FIGURE.duration + 1.0, 0.01)
    rows = []
    for t in times:
        pose = np.add(FIGURE.sample(t).pose, error)
        rows.append((START + t, *pose, 0.0, 0.0, 0.0))
    return np.array(rows)


def perfect():
    """A recording without fault, its twists and its figure."""
    odom = followed()
    phase = TwistPhase("rest", 3.0, lambda t: (0.0, 0.0, 0.0))
    recording = Recording(
        odom=[tuple(row) for row in odom],
        truth=[tuple(row[:4]) for row in odom],
        coupling=[(0.0, 0.001), (0.1, -0.003)],
        energy=[(1.0, 2.0), (4.0, 2.5)],
        odom_arrivals=(np.arange(1000) * 0.01).tolist(),
        command_arrivals=(np.arange(2000) * 0.005).tolist(),
    )
    return recording, [DrivenTwist(phase, START)], DrivenFigure(FIGURE, START)


def test_a_perfect_run_has_no_fault():
    result = judge(*perfect())
    assert result["faults"] == []
    assert result["tracking"]["rms_mm"] == pytest.approx(0.0, abs=1e-6)
    assert result["coupling"]["rms_rad"] == pytest.approx(math.sqrt(5e-6))
    assert result["coupling"]["max_rad"] == 0.003
    assert result["energy"] == {"total_j": 3.5, "wheels_j": [3.0, 0.5]}
    assert result["timing"]["odom"]["rate_hz"] == pytest.approx(100.0)
    assert result["timing"]["wheel_commands"]["p99_ms"] == pytest.approx(5.0)


def test_a_robot_without_constraints_has_no_coupling_error():
    recording, twists, figure = perfect()
    recording.coupling = [(0.0,), (0.1,)]
    assert judge(recording, twists, figure)["coupling"] == {"rms_rad": 0.0, "max_rad": 0.0}


def test_a_fault_says_whether_the_machine_stood_still():
    recording, twists, figure = perfect()
    recording.energy = [(0.0, 0.0), (1.0, 1.0)]
    recording.odom_arrivals = [0.0, 1.0, 2.0]
    (fault,) = judge(recording, twists, figure)["faults"]
    assert "stood still" not in fault
    recording.stall = 0.5
    (fault,) = judge(recording, twists, figure)["faults"]
    assert "(this machine stood still for 0.50 s meanwhile: try again)" in fault


def test_tracking_error_is_taken_at_the_stamps():
    result = tracking(followed((0.003, 0.004, 0.01)), DrivenFigure(FIGURE, START))
    assert result["rms_mm"] == pytest.approx(5.0)
    assert result["max_mm"] == pytest.approx(5.0)
    assert result["final_mm"] == pytest.approx(5.0)
    assert result["heading_rms_deg"] == pytest.approx(math.degrees(0.01))
    late = tracking(followed(), DrivenFigure(FIGURE, START + 0.02))
    assert late["rms_mm"] > 3.0


def test_a_heading_a_turn_away_is_the_same_heading():
    result = tracking(followed((0.0, 0.0, math.tau)), DrivenFigure(FIGURE, START))
    assert result["heading_max_deg"] == pytest.approx(0.0, abs=1e-6)


def test_a_figure_that_nobody_saw_is_a_fault():
    result = tracking(followed(), DrivenFigure(FIGURE, START + 1e6))
    assert result["rms_mm"] == math.inf


def test_twist_error_is_that_of_the_mean_once_settled():
    phase = TwistPhase("forward", 3.0, lambda t: (0.3, 0.0, 0.0))
    times = np.arange(0.0, 4.0, 0.01)
    odom = np.zeros((len(times), 7))
    odom[:, 0] = START + times
    settled = (times > 0.99) & (times < 3.01)
    odom[settled, 4] = 0.3 + 0.1 * (-1.0) ** np.arange(settled.sum())  # noise has no say
    odom[settled, 5] = 0.02
    odom[settled, 6] = -0.01
    result = twist_error(odom, DrivenTwist(phase, START))
    assert result["linear_m_s"] == pytest.approx(0.02, abs=1e-3)
    assert result["angular_rad_s"] == pytest.approx(0.01)
    unseen = twist_error(odom, DrivenTwist(phase, START + 1e6))
    assert unseen["linear_m_s"] == math.inf


def test_drift_is_between_motions_not_between_frames():
    t = np.linspace(0.0, 1.0, 50)
    truth = np.column_stack([t, 2.0 * t, np.zeros(50), np.zeros(50)])
    c, s = math.cos(1.0), math.sin(1.0)
    odom = np.column_stack([t, 5 + c * 2.1 * t, 7 + s * 2.1 * t, 1.0 + 0.1 * t])
    result = drift(odom, truth)
    assert result["position_mm"] == pytest.approx(100.0)
    assert result["heading_deg"] == pytest.approx(math.degrees(0.1))
    assert result["travel_m"] == pytest.approx(2.0)
    assert result["turn_rad"] == pytest.approx(0.0)


def test_intervals_show_a_gap():
    arrivals = [0.0, 0.01, 0.02, 0.08, 0.09]
    result = intervals(arrivals)
    assert result["max_ms"] == pytest.approx(60.0)
    assert result["p50_ms"] == pytest.approx(10.0)
    assert result["rate_hz"] == pytest.approx(4 / 0.09)


@pytest.mark.parametrize(
    ("path", "value", "says"),
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
    ],
)
def test_every_limit_is_a_fault_of_its_own(path, value, says):
    result = copy.deepcopy(judge(*perfect()))
    inner = result
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    (fault,) = faults(result)
    assert fault.startswith(says)
