import numpy as np
import pytest

from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.lab.bench import running_judge as judge
from omniman_ros.lab.bench import whole_body_running
from omniman_ros.lab.bench.harness import aims
from omniman_ros.lab.studies.avoidance_scenes import PERSON, POST, START, TABLE, AvoidanceScene
from omniman_ros.lab.studies.running_body import BodyRecording, world_elements
from omniman_ros.motion.path.timed_curve import TimedCurve
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.world.distances import ConfigurationDistances

SCENE = {
    "outcome": "completed",
    "contact": False,
    "contact_at_rest": False,
    "least_gap_mm": 50.0,
    "time_ratio": 1.2,
    "path_rms_mm": 0.1,
    "path_max_mm": 0.2,
    "reference_rms_mm": 0.3,
    "reference_max_mm": 0.4,
    "cycle": {"median_ms": 8.0, "p99_ms": 9.0, "max_ms": 10.0},
}


FIXED = TimedCurve(np.array([0.0, 1.0]), np.array([START, START]), *np.zeros((2, 2, 9)))


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
    ("events", "waits", "expected"),
    [
        (["started", "arrived"], "", "completed"),
        (["started", "given_up"], "", "given_up"),
        (["refused"], "", "refused"),
        (["started"], "a post", "waiting"),
        (["started"], "", "not_there"),
    ],
)
def test_the_outcome_is_the_last_event_or_what_the_robot_waits_for(events, waits, expected):
    recording = BodyRecording(
        events=[(float(k), name, "") for k, name in enumerate(events)],
        statuses=[(0.5, {"waits": waits, "obstruction": "moving obstacle"})],
    )
    assert judge.outcome(recording)["outcome"] == expected


def test_a_contact_counts_as_the_robots_if_it_moves():
    description = build(DescriptionParameters, robot_parameters("omniman"))
    scene = AvoidanceScene(
        np.zeros((1, 4, 4)), FIXED, (POST,), np.array([[0.55, 0.0]]), np.zeros((1, 2))
    )
    distances = ConfigurationDistances(description, [POST])
    recording = at_rest((0.0, 0.0, 0.0))
    found = judge.gap_figures(recording, scene, distances, 1.0)
    assert found["least_gap_mm"] < 0.0
    assert (found["contact"], found["contact_at_rest"]) == (False, True)
    for row in recording.truth:
        row[-1] = 0.1
    assert judge.gap_figures(recording, scene, distances, 1.0)["contact"]


def test_a_robot_rests_from_its_last_movement_on():
    recording = at_rest((0.0, 0.0, 0.0), 2.0)
    for row in recording.true_joints[:80]:
        row[-1] = 0.1
    assert judge.rest_time(recording, 0.5) == pytest.approx(0.29)
    recording.truth[-1][-1] = 0.1
    assert judge.rest_time(recording, 0.5) is None


@pytest.mark.parametrize(
    ("changes", "key", "expected"),
    [
        ({"contact": True}, "contacts", 1),
        ({"contact_at_rest": True}, "safe", 1),
        ({"outcome": "given_up"}, "safe", 1),
        ({"outcome": "waiting"}, "safe", 2),
        ({"outcome": "waiting"}, "completed", 1),
        ({"path_rms_mm": 1.5}, "path_rms_mm", 1.5),
    ],
)
def test_the_summary_counts(changes, key, expected):
    assert judge.summary([SCENE, {**SCENE, **changes}])[key] == expected


def test_only_what_stands_is_in_the_physics_world():
    places, velocities = np.array([[1.0, 2.0], [3.0, 0.0]]), np.array([[0.0, 0.0], [0.0, 0.5]])
    scene = AvoidanceScene(np.zeros((1, 4, 4)), FIXED, (TABLE, PERSON), places, velocities)
    (table,) = world_elements(scene)["posts"]
    assert (table["x"], table["height"]) == (1.0, TABLE.heights[1])
    assert scene.places_at(2.0)[1] == pytest.approx([3.0, 1.0])


def test_the_report_has_a_row_for_each_run_and_a_missed_aim_is_missed():
    scene = {**SCENE, "kind": "posts", "seed": 2, "path_rms_mm": 1.5}
    refused = {**SCENE, "kind": "posts", "seed": 3, "outcome": "refused"}
    for key in ("path_rms_mm", "cycle", "time_ratio"):
        del refused[key]
    course = {**SCENE, "course": "S", "driver": "path_interpolator", "duration_s": 9.0}
    course |= {"tool_acceleration": 0.5, "joint_acceleration": 1.0}
    lost = {"signal": "SIGKILL", "rest_s": None, "path_max_mm": 1.0, "path_rest_mm": 0.5}
    lost["moved_at_rest"] = {"platform_mm": 0.0, "joints_mrad": 0.0}
    scenes = [scene, refused]
    result = {"scenes": scenes, "courses": [course], "lost": [lost]}
    tables = whole_body_running.report({**result, "summary": judge.summary(scenes)})
    assert [len(table.figures) for table in tables] == [2, 1, 1, 6]
    met = aims(tables)
    assert met["contacts of a robot that moves"] is True
    assert met["completed, or waiting without contact"] is False
    assert met["tool off its path, RMS"] is False
