import numpy as np
import pytest

from omniman_ros.lab.bench import running_judge as judge
from omniman_ros.lab.bench import whole_body_running
from omniman_ros.lab.bench.harness import aims
from omniman_ros.lab.studies.avoidance_scenes import START
from omniman_ros.lab.studies.running_body import BodyRecording


def at_rest(pose, duration=1.0):
    """Return a recording of a robot that stands."""
    times = np.arange(0.0, duration, 0.01)
    return BodyRecording(
        truth=[np.array([t, *pose, 0.0]) for t in times],
        true_joints=[np.array([t, *START[3:], 0.0]) for t in times],
    )


def test_a_tool_that_lags_is_on_its_path_but_not_at_its_reference():
    times = np.linspace(0.0, 1.0, 101)
    still = np.zeros_like(times)
    references = list(np.column_stack([times, times, still, still]))
    tool = np.column_stack([times, times - 0.002, still + 0.001, still])[10:]
    curve = np.column_stack([np.linspace(-1.0, 2.0, 301), *np.zeros((2, 301))])
    errors = judge.tool_errors(tool, references, curve)
    assert errors["path_rms_mm"] == pytest.approx(1.0)
    assert errors["reference_max_mm"] == pytest.approx(np.hypot(1.0, 2.0))


def test_the_distance_from_a_polyline_is_that_from_its_segments():
    curve = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    points = np.array([[0.45, 0.2, 0.0], [1.0, 0.5, 0.3], [-0.4, 0.3, 0.0]])
    assert judge.distances_to_curve(points, curve) == pytest.approx([0.2, 0.3, 0.5])


@pytest.mark.parametrize(
    ("events", "expected"),
    [
        (["started", "arrived"], "completed"),
        (["started", "given_up"], "given_up"),
        (["refused"], "refused"),
        (["started"], "not_there"),
    ],
)
def test_the_outcome_is_the_last_event(events, expected):
    recording = BodyRecording(events=[(float(k), name, "") for k, name in enumerate(events)])
    assert judge.outcome(recording)["outcome"] == expected


def test_a_robot_rests_from_its_last_movement_on():
    recording = at_rest((0.0, 0.0, 0.0), 2.0)
    for row in recording.true_joints[:80]:
        row[-1] = 0.1
    assert judge.rest_time(recording, 0.5) == pytest.approx(0.29)
    recording.truth[-1][-1] = 0.1
    assert judge.rest_time(recording, 0.5) is None


def test_the_report_has_a_row_for_each_run_and_a_missed_aim_is_missed():
    course = {"course": "S", "driver": "path_interpolator", "outcome": "completed"}
    course |= {"duration_s": 9.0, "tool_acceleration": 0.5, "joint_acceleration": 1.0}
    course |= {f"{name}_{key}_mm": 1.5 for name in ("path", "reference") for key in ("rms", "max")}
    given_up = {**course, "driver": "whole_body_planner", "outcome": "given_up"}
    lost = {"signal": "SIGKILL", "rest_s": None, "path_max_mm": 1.0, "path_rest_mm": 0.5}
    lost["moved_at_rest"] = {"platform_mm": 0.0, "joints_mrad": 0.0}
    tables = whole_body_running.report({"courses": [course, given_up], "lost": [lost]})
    assert [len(table.figures) for table in tables] == [2, 1, 3]
    assert aims(tables) == {
        "paths completed": False,
        "tool off its path, RMS": False,
        "tool off its reference, RMS": False,
    }
