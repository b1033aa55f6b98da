import copy
import math

import numpy as np
import pytest

from omniman_ros.cli.figures import TwistPhase
from omniman_ros.cli.recorder import Recording
from omniman_ros.cli.score import (
    ArmMove,
    DrivenLeg,
    DrivenTwist,
    Reference,
    arm_figures,
    coupling,
    drift,
    faults,
    intervals,
    judge,
    tracking,
    twist_error,
)

START = 1000.0
DURATION = 8.0
LEGS = [DrivenLeg("there", START, START + 5.0), DrivenLeg("back", START + 6.0, START + DURATION)]


def wanted(times):
    """Poses (k, 3) of a curve that is driven with a turning heading."""
    return np.column_stack([0.5 + 0.4 * times, 0.2 * np.sin(times), 0.3 + 0.9 * times])


def asked():
    """Rows of Recording.reference: as previews that overlap, headings wrapped as messages' are."""
    rows = []
    for begin in np.arange(0.0, DURATION, 0.04):
        times = begin + 0.008 * np.arange(6)
        poses = wanted(times)
        poses[:, 2] = np.remainder(poses[:, 2] + math.pi, math.tau) - math.pi
        rows += [(START + t, *pose) for t, pose in zip(times, poses, strict=True)]
    return rows


def followed(error=(0.0, 0.0, 0.0), late=0.0):
    """Rows of odom of a robot that follows with a constant error, or late."""
    times = np.arange(0.0, DURATION, 0.01)
    poses = wanted(times - late) + error
    return np.column_stack([START + times, poses, np.zeros((len(times), 3))])


def perfect():
    """A recording without fault, its twists and its legs."""
    odom = followed()
    phase = TwistPhase("rest", 3.0, lambda t: (0.0, 0.0, 0.0))
    recording = Recording(
        odom=[tuple(row) for row in odom],
        truth=[tuple(row[:4]) for row in odom],
        coupling=[(START, 0.001), (START + 5.5, 0.1), (START + 7.0, -0.003)],
        reference=asked(),
        energy=[(1.0, 2.0), (4.0, 2.5)],
        odom_arrivals=(np.arange(1000) * 0.01).tolist(),
        command_arrivals=(np.arange(2000) * 0.005).tolist(),
    )
    return recording, [DrivenTwist(phase, START)], LEGS


def test_a_perfect_run_has_no_fault():
    result = judge(*perfect())
    assert result["faults"] == []
    assert result["tracking"]["rms_mm"] == pytest.approx(0.0, abs=0.01)
    assert result["coupling"] == {
        "rms_rad": pytest.approx(math.sqrt(5e-6)),
        "max_rad": 0.003,
        "movements": {"there": 0.001, "back": 0.003},
    }  # what lies between the movements does not count
    assert result["energy"] == {"total_j": 3.5, "wheels_j": [3.0, 0.5]}
    assert result["timing"]["odom"]["rate_hz"] == pytest.approx(100.0)
    assert result["timing"]["wheel_commands"]["p99_ms"] == pytest.approx(5.0)


def test_a_robot_without_constraints_has_no_coupling_error():
    none = {"rms_rad": 0.0, "max_rad": 0.0, "movements": {}}
    assert coupling([(0.0,), (0.1,)], LEGS) == none


def test_a_fault_says_whether_the_machine_stood_still():
    recording, twists, legs = perfect()
    recording.energy = [(0.0, 0.0), (1.0, 1.0)]
    recording.odom_arrivals = [0.0, 1.0, 2.0]
    (fault,) = judge(recording, twists, legs)["faults"]
    assert "stood still" not in fault
    recording.stall = 0.5
    (fault,) = judge(recording, twists, legs)["faults"]
    assert "(this machine stood still for 0.50 s meanwhile: try again)" in fault


def test_tracking_error_is_taken_at_the_stamps():
    reference = Reference(asked())
    result = tracking(followed((0.003, 0.004, 0.01)), reference, LEGS)
    assert result["rms_mm"] == pytest.approx(5.0, abs=0.01)
    assert result["max_mm"] == pytest.approx(5.0, abs=0.01)
    assert result["final_mm"] == pytest.approx(5.0, abs=0.01)
    assert result["heading_rms_deg"] == pytest.approx(math.degrees(0.01), abs=0.01)
    assert tracking(followed(late=0.02), reference, LEGS)["rms_mm"] > 5.0


def test_a_heading_a_turn_away_is_the_same_heading():
    result = tracking(followed((0.0, 0.0, math.tau)), Reference(asked()), LEGS)
    assert result["heading_max_deg"] == pytest.approx(0.0, abs=0.01)


def test_what_is_driven_after_the_path_is_not_its_end():
    recording, _, legs = perfect()
    odom = np.array(recording.odom)
    later = odom[-1] + np.array([3.0, 0.5, 0.5, 1.0, 0.0, 0.0, 0.0])
    result = tracking(np.vstack([odom, later]), Reference(recording.reference), legs)
    assert result["final_mm"] == pytest.approx(0.0, abs=0.01)
    assert result["final_heading_deg"] == pytest.approx(0.0, abs=0.01)


def test_only_the_movements_count():
    odom = followed()
    between = (odom[:, 0] > START + 5.01) & (odom[:, 0] < START + 5.99)
    odom[between, 1] += 1.0
    assert tracking(odom, Reference(asked()), LEGS)["max_mm"] < 0.1


@pytest.mark.parametrize(
    ("rows", "legs"), [([], LEGS), (asked(), []), (asked(), [DrivenLeg("x", 1.0, 2.0)])]
)
def test_a_path_that_nobody_saw_is_a_fault(rows, legs):
    assert tracking(followed(), Reference(rows), legs)["rms_mm"] == math.inf


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


def led(lag=0.04, off=0.0):
    """A recording of an arm that follows late, and the moves that it made: there and back."""

    def joints(times):
        return np.column_stack([1.0 - np.cos(np.pi * times / 2.0), 0.5 * np.sin(np.pi * times)])

    times = np.arange(0.0, 4.0, 0.008)
    late = np.clip(times - lag, 0.0, 4.0)
    recording, twists, legs = perfect()
    recording.arm = [(START + t, *q) for t, q in zip(times, joints(late) + off, strict=True)]
    recording.arm_reference = [
        (START + t, *q) for t, q in zip(times, joints(times), strict=True) for _ in range(2)
    ]
    recording.arm_intervals = [0.008] * 500
    moves = [
        ArmMove(tuple(joints(np.array([2.0 - lag]))[0]), START, START + 2.0),
        ArmMove(tuple(joints(np.array([3.9 - lag]))[0]), START + 2.0, START + 3.9),
    ]
    return recording, twists, legs, moves


def test_the_arms_lag_is_told_apart_from_its_error():
    recording, _, _, moves = led(lag=0.04)
    figures = arm_figures(recording, moves)
    assert figures["moves"] == 2
    assert figures["lag_ms"] == pytest.approx(40.0, abs=2.1)
    assert figures["rms_mrad"] < 1.0
    assert figures["final_mrad"] < 12.0  # the last sample is up to 8 ms old
    assert figures["travel_rad"] == pytest.approx(4.0, rel=0.3)
    assert figures["setpoints"]["p99_ms"] == pytest.approx(8.0)


def test_an_arm_that_ends_elsewhere_is_a_fault():
    recording, twists, legs, moves = led(off=0.05)
    result = judge(recording, twists, legs, moves=moves)
    assert result["arm"]["final_mrad"] == pytest.approx(50.0, abs=12.0)
    assert any(fault.startswith("arm final position, mrad") for fault in result["faults"])
    assert any(fault.startswith("arm off its path, mrad") for fault in result["faults"])
