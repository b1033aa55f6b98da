"""Figures of the demo, from what the robot published."""

import math

import numpy as np
import pytest

from omniman_ros.demo import legs
from omniman_ros.demo.demo import judge, load_demo
from omniman_ros.demo.figures import (
    DrivenGoal,
    DrivenStop,
    DrivenTool,
    Reference,
    TwistPhase,
    arm_figures,
    coupling_figures,
    drift_figures,
    goal_figures,
    interval_figures,
    stop_figures,
    tool_clearance,
    tool_figures,
    tool_track,
    tracking_figures,
    twist_figures,
)
from omniman_ros.demo.measures import Interval
from omniman_ros.demo.moving_obstacles import DemoObstacles
from omniman_ros.demo.perception import People, Perception
from omniman_ros.demo.recorder import DemoRecording
from omniman_ros.motion.whole_body.model import Mount, WholeBodyModel, planar_transform
from omniman_ros.simulation.world.scene import Post
from test.demo.samples import (
    MOVEMENTS,
    START,
    arm_run,
    odometry_rows,
    perfect_run,
    reference_rows,
)

# ---- platform -------------------------------------------------------------------------------


def test_a_robot_without_constraints_has_no_coupling_error():
    none = {"rms_rad": 0.0, "max_rad": 0.0, "movements": {}}
    assert coupling_figures([(0.0,), (0.1,)], MOVEMENTS) == none


def test_the_coupling_error_of_a_path_counts_from_its_start():
    before = [(START - 2.0, 0.1), (START - 0.1, 0.4), (START + 1.0, 0.4), (START + 2.0, 0.6)]
    assert coupling_figures(before, MOVEMENTS[:1])["max_rad"] == pytest.approx(0.2)


def test_the_tracking_error_is_taken_at_the_stamps():
    reference = Reference(reference_rows())
    result = tracking_figures(odometry_rows((0.003, 0.004, 0.01)), reference, MOVEMENTS)
    assert result["rms_mm"] == pytest.approx(5.0, abs=0.01)
    assert result["max_mm"] == pytest.approx(5.0, abs=0.01)
    assert result["final_mm"] == pytest.approx(5.0, abs=0.01)
    assert result["heading_rms_deg"] == pytest.approx(math.degrees(0.01), abs=0.01)
    delayed = tracking_figures(odometry_rows(delay=0.02), reference, MOVEMENTS)
    assert delayed["rms_mm"] > 5.0


def test_a_heading_that_is_a_full_turn_away_is_the_same_heading():
    odom = odometry_rows((0.0, 0.0, math.tau))
    result = tracking_figures(odom, Reference(reference_rows()), MOVEMENTS)
    assert result["heading_max_deg"] == pytest.approx(0.0, abs=0.01)


def test_a_pose_after_the_path_is_not_the_final_one():
    _, recording = perfect_run()
    odom = np.array(recording.odom)
    later = odom[-1] + np.array([3.0, 0.5, 0.5, 1.0, 0.0, 0.0, 0.0])
    reference = Reference(recording.reference)
    result = tracking_figures(np.vstack([odom, later]), reference, MOVEMENTS)
    assert result["final_mm"] == pytest.approx(0.0, abs=0.01)
    assert result["final_heading_deg"] == pytest.approx(0.0, abs=0.01)


def test_only_the_movements_count():
    odom = odometry_rows()
    between = (odom[:, 0] > START + 5.01) & (odom[:, 0] < START + 5.99)
    odom[between, 1] += 1.0
    assert tracking_figures(odom, Reference(reference_rows()), MOVEMENTS)["max_mm"] < 0.1


@pytest.mark.parametrize(
    ("rows", "movements"),
    [([], MOVEMENTS), (reference_rows(), []), (reference_rows(), [Interval("x", 1.0, 2.0)])],
)
def test_the_error_is_infinite_without_a_reference_at_those_times(rows, movements):
    figures = tracking_figures(odometry_rows(), Reference(rows), movements)
    assert figures["rms_mm"] == math.inf


def test_the_error_is_infinite_if_one_movement_was_not_driven():
    later = [row for row in reference_rows() if not MOVEMENTS[0].contains(np.array(row[0]))]
    figures = tracking_figures(odometry_rows(), Reference(later), MOVEMENTS)
    assert figures["rms_mm"] == math.inf


def test_the_twist_error_is_that_of_the_mean_once_settled():
    phase = TwistPhase("forward", 3.0, lambda t: (0.3, 0.0, 0.0), START)
    times = np.arange(0.0, 4.0, 0.01)
    odom = np.zeros((len(times), 7))
    odom[:, 0] = START + times
    settled = (times > 0.99) & (times < 3.01)
    noise = 0.1 * (-1.0) ** np.arange(settled.sum())
    odom[settled, 4] = 0.3 + noise
    odom[settled, 5] = 0.02
    odom[settled, 6] = -0.01
    (result,) = twist_figures(odom, [phase])
    assert result["linear_m_s"] == pytest.approx(0.02, abs=1e-3)
    assert result["angular_rad_s"] == pytest.approx(0.01)
    (without_odometry,) = twist_figures(odom[:50], [phase])
    assert without_odometry["linear_m_s"] == math.inf


# ---- arm and tool ---------------------------------------------------------------------------


def test_the_lag_of_the_arm_is_separated_from_its_error():
    demo, recording = arm_run(lag=0.04)
    figures = arm_figures(recording, demo.arm_moves)
    assert figures["moves"] == 2
    assert figures["lag_ms"] == pytest.approx(40.0, abs=2.1)
    assert figures["rms_mrad"] < 1.0
    assert figures["final_mrad"] < 12.0, "the last sample is up to 8 ms old"
    assert figures["travel_rad"] == pytest.approx(4.0, rel=0.3)
    assert figures["setpoints"]["p99_ms"] == pytest.approx(8.0)


MODEL = WholeBodyModel(Mount())
LED = Interval("tool path", 1.0, 3.0)


def led_tool(offset=(0.0, 0.0, 0.0), drift=0.0):
    """A resting arm on a straight; the reference is off [m], and odometry drifts [m/s]."""
    recording = DemoRecording()
    for t in np.arange(0.0, 4.0, 0.01):
        pose = np.array([0.2 * t, 0.1 * t, 0.05 * t + math.pi - 0.1])
        heading = math.remainder(pose[2], math.tau)
        recording.odom.append((t, pose[0], pose[1], heading, 0.0, 0.0, 0.0))
        true = planar_transform(np.array([5.0, 1.0, 0.4])) @ planar_transform(pose)
        angle = math.atan2(true[1, 0], true[0, 0])
        recording.truth.append((t, true[0, 3] + drift * t, true[1, 3], angle))
        recording.arm.append((t + 0.003, *legs.START_ANGLES))
        tool = MODEL.forward(np.concatenate([pose, legs.START_ANGLES]))[:3, 3] + offset
        recording.tool_reference.append((t, *tool))
    return recording


def test_a_tool_on_its_path_has_no_error():
    track = tool_track(led_tool(), MODEL, LED)
    assert track.errors.max() < 1e-4 and track.true_errors.max() < 1e-4
    assert track.times[0] >= 1.0 and track.times[-1] <= 3.0
    figures = tool_figures(track)
    assert figures["platform_m"] == pytest.approx(2.0 * math.hypot(0.2, 0.1), rel=0.02)
    assert figures["time_s"] == pytest.approx(2.0, abs=0.05)


def test_only_the_error_by_the_ground_truth_includes_the_drift():
    offset = tool_figures(tool_track(led_tool((0.003, 0.0, 0.004), drift=0.002), MODEL, LED))
    assert offset["rms_mm"] == pytest.approx(5.0, abs=0.1)
    assert offset["max_mm"] == pytest.approx(5.0, abs=0.1)
    drifted = tool_figures(tool_track(led_tool(drift=0.002), MODEL, LED))
    assert drifted["max_mm"] < 0.1 and drifted["true_max_mm"] == pytest.approx(4.0, abs=0.2)


def test_the_clearance_on_the_tools_path_is_that_of_the_true_body():
    pytest.importorskip("mujoco", reason="it measures the gaps")
    description, track = (
        load_demo("omniman").description,
        tool_track(led_tool(drift=0.1), MODEL, LED),
    )

    def clearance(posts, *reports):
        return tool_clearance(track, description, DrivenTool(LED, posts, People([*reports])))

    # A post that the platform leaves on its left, and a person whom the tool meets in the end.
    x, y, _ = track.truth[0] + planar_transform(track.truth[0])[:3, :3] @ [0.0, 0.85, 0.0]
    post = Post(name="post", x=x, y=y, radius=0.2)
    assert clearance([post], (0.0, np.zeros((0, 3)))) == pytest.approx(0.3, abs=0.005)
    to_world = planar_transform(track.truth) @ np.linalg.inv(planar_transform(track.platform))
    met = to_world[-1] @ [*track.measured[-1], 1.0]
    person = np.array([[met[0], met[1], 0.25]])
    away = person + [[2.0, 0.0, 0.0]]
    assert clearance([], (0.0, away), (LED.end, away)) > 0.5
    late = LED.end - 0.2
    assert clearance([], (0.0, away), (late - 0.1, away), (late, person), (LED.end, person)) < 0.0


# ---- goal -----------------------------------------------------------------------------------

HALF = (0.5, 0.35)


def figures_of(obstacles, poses, goal=(0.0, 0.0, 0.0)):
    """Figures of a robot that is at one of the poses every second."""
    rows = np.array([[START + i, *pose, 0.0, 0.0, 0.0] for i, pose in enumerate(poses)])
    interval = Interval("goal", START, START + len(rows) - 1)
    return goal_figures(rows, rows[:, :4], DrivenGoal(np.array(goal), obstacles, interval), HALF)


def test_the_clearance_is_that_of_robot_and_obstacle_at_the_same_time():
    # The obstacle is beside x = 2 at 102 s, 2 m further left.
    obstacles = DemoObstacles(
        START, np.array([[2.0, 0.0]]), np.array([[0.0, 1.0]]), np.array([0.3])
    )
    at_rest = figures_of(obstacles, [(0, 0, 0)] * 3)
    assert at_rest["clearance_m"] == pytest.approx(2.0 - 0.5 - 0.3)
    behind = figures_of(obstacles, [(0, 0, 0), (0, 0, 0), (2.0, 0.0, 0)])
    assert behind["clearance_m"] == pytest.approx(1.2), "it has gone when the robot is there"
    collision = figures_of(obstacles, [(0, 0, 0), (2.0, 1.0, 0), (2.0, 0.0, 0)])
    assert collision["clearance_m"] < 0.0


def test_the_error_at_the_goal_is_that_of_the_last_pose():
    obstacles = DemoObstacles.in_front_of((50.0, 0.0, 0.0), START)
    poses = [(0, 0, 0), (1.0, 0.0, math.pi)]
    result = figures_of(obstacles, poses, (1.0, 0.02, -math.pi + 0.01))
    assert result["position_mm"] == pytest.approx(20.0)
    assert result["heading_deg"] == pytest.approx(math.degrees(0.01))
    assert result["time_s"] == 1.0


def test_a_goal_without_odometry_is_infinitely_far_away():
    obstacles = DemoObstacles.in_front_of((0.0, 0.0, 0.0), START)
    driven = DrivenGoal(np.zeros(3), obstacles, Interval("goal", START, START + 1.0))
    result = goal_figures(np.zeros((3, 7)), np.zeros((3, 4)), driven, HALF)
    assert result["position_mm"] == math.inf and result["clearance_m"] == -math.inf


def test_a_person_is_where_the_reports_before_and_after_say():
    rows = [np.array([[0.0, y, 0.25], [5.0, 0.0, 0.3]]) for y in (0.0, 1.0, 1.0)]
    people = People(list(zip((10.0, 12.0, 13.0), rows, strict=True)))
    assert people.at(11.0) == pytest.approx(np.array([[0.0, 0.5], [5.0, 0.0]]))
    assert people.at(12.5)[0] == pytest.approx([0.0, 1.0])
    assert people.at(0.0)[0] == pytest.approx([0.0, 0.0]), "nobody knows what was before"
    assert people.at(20.0)[0] == pytest.approx([0.0, 1.0])


def test_the_clearance_of_persons_counts_from_the_true_pose():
    odom, truth = np.zeros((1, 7)), np.array([[START, 0.1, 0.0, 0.0]])
    odom[0, 0] = START

    def figures(persons):
        interval = Interval("goal", START, START)
        driven = DrivenGoal(np.zeros(3), People([(START, persons)]), interval, Perception())
        return goal_figures(odom, truth, driven, HALF)

    person = np.array([[2.0, 0.0, 0.25]])
    assert figures(person)["clearance_m"] == pytest.approx(2.0 - 0.1 - 0.5 - 0.25)
    assert "clearance_m" not in figures(np.zeros((0, 3)))


# ---- emergency stop -------------------------------------------------------------------------

PRESSED, RESET, END = 10.0, 12.0, 13.0
STOP = DrivenStop(PRESSED, RESET, END)
SPEED, BRAKING, DELAY = 0.3, 1.5, 0.04
ARM_SPEED, ARM_BRAKING = 0.8, 4.0


def braking_motion(times, speed, braking, delay=DELAY):
    """Position (k,) and speed (k,) of a motion that brakes evenly, a little after the stop."""
    since = np.clip(times - PRESSED - delay, 0.0, speed / braking)
    position = speed * (np.minimum(times, PRESSED + delay) + since) - 0.5 * braking * since**2
    return position, speed - braking * since


def stopped_robot(creep=0.0, arm_creep=0.0):
    """Recording of a robot that stops; after the reset it creeps [m/s, rad/s]."""
    recording = DemoRecording()
    times = np.arange(8.0, 14.0, 0.01)
    position, speed = braking_motion(times, SPEED, BRAKING)
    position = position + creep * np.maximum(times - RESET, 0.0)
    for t, x, v in zip(times, position, speed, strict=True):
        recording.odom.append((t, x, 0.0, 0.0, v, 0.0, 0.0))
    times = np.arange(8.0, 14.0, 0.008)
    angle, _ = braking_motion(times, ARM_SPEED, ARM_BRAKING)
    angle = angle + arm_creep * np.maximum(times - RESET, 0.0)
    for t, q in zip(times, angle, strict=True):
        recording.arm.append((t, 0.5, -q))
    return recording


def test_the_time_to_rest_counts_from_the_press_of_the_stop():
    figures = stop_figures(stopped_robot(), STOP)
    assert figures["speed_m_s"] == pytest.approx(SPEED)
    assert figures["rest_s"] == pytest.approx(DELAY + SPEED / BRAKING, abs=0.02)
    way = SPEED * DELAY + SPEED**2 / 2 / BRAKING
    assert figures["way_mm"] == pytest.approx(1e3 * way, abs=4.0)
    assert figures["arm_rate_rad_s"] == pytest.approx(ARM_SPEED, rel=0.01)
    rest = DELAY + ARM_SPEED / ARM_BRAKING
    assert rest - 0.02 < figures["arm_rest_s"] < rest + 0.06, "the speed is a mean over 50 ms"
    assert figures["moved_mm"] == figures["arm_moved_mrad"] == 0.0


def test_motion_after_the_reset_is_measured():
    figures = stop_figures(stopped_robot(creep=0.005, arm_creep=0.002), STOP)
    assert figures["moved_mm"] == pytest.approx(5.0, abs=0.1)
    assert figures["arm_moved_mrad"] == pytest.approx(2.0, abs=0.1)


def test_a_robot_that_does_not_stop_never_rests():
    recording = stopped_robot()
    recording.odom = [(t, x, y, a, SPEED, 0.0, 0.0) for t, x, y, a, *_ in recording.odom]
    assert stop_figures(recording, STOP)["rest_s"] == math.inf


def test_a_robot_without_odometry_after_the_reset_counts_as_moved():
    recording = stopped_robot()
    recording.odom = [row for row in recording.odom if row[0] <= RESET]
    assert stop_figures(recording, STOP)["moved_mm"] == math.inf


def test_a_robot_without_an_arm_has_no_figures_of_the_arm():
    recording = stopped_robot()
    recording.arm.clear()
    assert not any(name.startswith("arm") for name in stop_figures(recording, STOP))


# ---- whole drive ----------------------------------------------------------------------------


def test_drift_compares_motions_whatever_the_frames():
    t = np.linspace(0.0, 1.0, 50)
    truth = np.column_stack([t, 2.0 * t, np.zeros(50), np.zeros(50)])
    c, s = math.cos(1.0), math.sin(1.0)
    odom = np.column_stack([t, 5 + c * 2.1 * t, 7 + s * 2.1 * t, 1.0 + 0.1 * t])
    result = drift_figures(odom, truth)
    assert result["position_mm"] == pytest.approx(100.0)
    assert result["heading_deg"] == pytest.approx(math.degrees(0.1))
    assert result["travel_m"] == pytest.approx(2.0)
    assert result["turn_rad"] == pytest.approx(0.0)


def test_the_longest_interval_shows_a_gap():
    result = interval_figures([0.0, 0.01, 0.02, 0.08, 0.09])
    assert result["max_ms"] == pytest.approx(60.0)
    assert result["p50_ms"] == pytest.approx(10.0)
    assert result["rate_hz"] == pytest.approx(4 / 0.09)


@pytest.mark.parametrize(
    ("contacts", "faults"),
    [(None, []), ([], []), (["base_link, post"], ["things that the robot touched: 1, at most 0"])],
)
def test_any_contact_in_a_world_is_a_fault(contacts, faults):
    demo, recording = perfect_run()
    recording.contacts = contacts
    result = judge(demo, recording)
    assert result["faults"] == faults
    assert ("contacts" in result) == (contacts is not None)
    assert not contacts or result["contacts"] == {"count": 1, "with": contacts}
