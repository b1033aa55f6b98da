import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.core.preview import Preview
from omniman_ros.motion.path.interpolator import LEAD, PathInterpolator, PathState, RefusedError
from omniman_ros.motion.path.parameters import PathParameters
from omniman_ros.robots import robot_parameters
from test.motion.path.support import DT, ROUND_OFF, off_path

ORIGIN = (0.0, 0.0, 0.0)
CORNER = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0.5]], dtype=float)
LINE = np.array([[0, 0, 0], [2, 0, 0]], dtype=float)


def parameters(**changes) -> PathParameters:
    given = {f"path.{name}": value for name, value in changes.items()}
    return build(PathParameters, robot_parameters("omniman") | given)


class Driver:
    """Drives an interpolator and follows its stream, one tick at a time."""

    def __init__(self, **changes) -> None:
        self.core = PathInterpolator(parameters(**changes))
        self.groups = self.core.parameters.groups()
        self.now = 100.0
        self.rows: list[np.ndarray] = []

    def start(self, poses, here=ORIGIN, lead=0.0) -> None:
        proposal = self.core.propose(np.asarray(poses, dtype=float), here, self.now, lead)
        assert self.core.take(proposal, self.now)

    def run(self, seconds: float) -> np.ndarray:
        """Follow the stream and return x, x', x'' as rows (k, 9)."""
        first = len(self.rows)
        for _ in range(round(seconds / DT)):
            window = self.core.window(self.now, 0.4)
            if window is not None:
                preview = Preview(
                    window.times, window.positions, window.velocities, window.accelerations
                )
                at = preview.sample(max(self.now, preview.start))
                self.rows.append(np.concatenate([at.pose, at.velocity, at.acceleration]))
            self.now += DT
            self.core.update(self.now)
        return np.array(self.rows[first:])

    def run_to_the_end(self) -> np.ndarray:
        seconds = self.core.remaining(self.now) + self.core.parameters.path.settle + 0.1
        rows = self.run(seconds)
        assert self.core.state in (PathState.IDLE, PathState.PAUSED)
        return rows

    def assert_smooth(self) -> None:
        """Assert that the whole stream keeps all limits and never jumps."""
        x, v, a = np.split(np.array(self.rows), 3, axis=1)
        jerk = np.diff(a, axis=0) / DT
        for group in self.groups:
            assert group.norm(v).max() <= group.velocity * (1 + ROUND_OFF)
            assert group.norm(a).max() <= group.acceleration * (1 + ROUND_OFF)
            # The rows lie between ticks: a difference spans two cubics and two jerks.
            assert group.norm(jerk).max() <= group.jerk * (1 + ROUND_OFF)
        assert np.abs(np.diff(x, axis=0) / DT - (v[1:] + v[:-1]) / 2).max() < 1e-4
        assert np.abs(np.diff(v, axis=0) / DT - (a[1:] + a[:-1]) / 2).max() < 0.05


@pytest.fixture
def driver() -> Driver:
    return Driver()


def test_a_path_is_driven_to_its_exact_end(driver):
    driver.start(CORNER)
    assert driver.core.state is PathState.FOLLOWING
    rows = driver.run_to_the_end()
    driver.assert_smooth()
    assert rows[-1, :3] == pytest.approx(CORNER[-1], abs=1e-12)
    assert driver.core.state is PathState.IDLE and driver.core.window(driver.now, 0.4) is None


def test_the_robot_drives_straight_to_the_first_pose(driver):
    driver.start(CORNER, (-0.3, 0.2, -0.4))
    rows = driver.run_to_the_end()
    assert rows[0, :3] == pytest.approx([-0.3, 0.2, -0.4])
    assert np.hypot(*rows[:, :2].T).min() <= 0.05
    driver.assert_smooth()


def test_progress_is_monotonic_and_ends_at_1(driver):
    driver.start(CORNER)
    seen = []
    while driver.core.state is not PathState.IDLE:
        seen.append(driver.core.progress(driver.now))
        driver.run(0.04)
    assert seen[0] == 0.0 and seen[-1] == 1.0 and seen == sorted(seen)
    assert driver.core.progress(driver.now) == 0.0


def test_the_end_is_exact_when_the_last_two_poses_are_close():
    driver = Driver(corner_tolerance=10.0, start_distance=10.0)
    end = np.array([[0, 0, 0], [3, 0, 0], [3 + 5e-6, 0, 0]])
    driver.start(end)
    assert (driver.run_to_the_end()[-1, :3] == end[-1]).all()


@pytest.mark.parametrize("after", [0.05, 0.4, 1.0, 1.5, 2.0, 2.6, 3.5])
def test_a_pause_stops_on_the_path_and_can_be_resumed(driver, after):
    driver.start(CORNER)
    driver.run(after)
    driver.core.pause(driver.now)
    assert driver.core.state is PathState.PAUSING
    rows = driver.run_to_the_end()
    assert driver.core.state is PathState.PAUSED
    assert not rows[-1, 3:].any()
    assert (driver.run(5.0) == rows[-1]).all(), "it holds its place"
    driver.core.resume(driver.now)
    end = driver.run_to_the_end()[-1]
    assert end[:3] == pytest.approx(CORNER[-1], abs=1e-12)
    driver.assert_smooth()
    whole = np.array(driver.rows)
    assert off_path(whole[:, :3], CORNER).max() <= 0.05 + 1e-9


def test_a_pause_is_as_short_as_the_limits_allow(driver):
    driver.start(LINE)
    driver.run(1.6)
    speed = driver.run(DT)[-1, 3]
    driver.core.pause(driver.now)
    linear = driver.groups[0]
    ideal = speed / linear.acceleration + linear.acceleration / linear.jerk
    lag = 2 * linear.acceleration / linear.jerk + (LEAD + 3) * DT
    assert driver.core.remaining(driver.now) <= ideal + lag


def test_a_path_can_be_resumed_while_braking(driver):
    driver.start(LINE)
    driver.run(1.5)
    driver.core.pause(driver.now)
    driver.run(0.2)
    driver.core.resume(driver.now)
    rows = driver.run_to_the_end()
    assert rows[5:100, 3].min() > 0.1, "it does not come to rest first"
    driver.assert_smooth()


def test_a_cancel_stops_on_the_path_and_discards_it(driver):
    driver.start(CORNER)
    driver.run(1.9)
    driver.core.cancel(driver.now)
    rows = driver.run_to_the_end()
    assert driver.core.state is PathState.IDLE
    assert not rows[-1, 3:].any() and np.hypot(*(rows[-1, :2] - CORNER[-1, :2])) > 0.3
    driver.assert_smooth()
    with pytest.raises(RefusedError, match="no pause to end: idle"):
        driver.core.resume(driver.now)


def test_requests_that_the_state_does_not_allow_are_refused(driver):
    for request in (driver.core.pause, driver.core.resume, driver.core.cancel):
        with pytest.raises(RefusedError, match="idle"):
            request(driver.now)
    driver.start(LINE)
    with pytest.raises(RefusedError, match="following"):
        driver.core.resume(driver.now)
    driver.run(1.0)
    driver.core.cancel(driver.now)
    with pytest.raises(RefusedError, match="cancelling"):
        driver.core.pause(driver.now)
    driver.core.cancel(driver.now)  # a repeated cancel is accepted


def test_an_abort_discards_the_path_at_once(driver):
    driver.start(LINE)
    driver.run(1.0)
    driver.core.abort()
    assert driver.core.window(driver.now, 0.4) is None


@pytest.mark.parametrize("after", [0.02, 0.3, 0.9, 1.7, 2.3, 3.0])
def test_a_new_path_during_motion_continues_without_a_jump(driver, after):
    driver.start(CORNER)
    driver.run(after)
    here = driver.rows[-1][:3]
    away = here + np.array([[0, 0, 0], [-0.5, 0.5, -1], [-1, 0.5, 0]])
    driver.start(away)
    rows = driver.run_to_the_end()
    driver.assert_smooth()
    assert rows[-1, :3] == pytest.approx(away[-1], abs=1e-12)


def test_sending_the_same_path_again_costs_no_time(driver):
    """A planner may resend its path once a second, so the first poses lie behind the robot."""
    driver.start(LINE)
    driver.run(1.5)
    rest = driver.core.remaining(driver.now)
    driver.start(LINE)
    assert driver.core.remaining(driver.now) == pytest.approx(rest, abs=0.1)
    rows = driver.run_to_the_end()
    assert rows[:, 3].min() > -1e-9, "the robot never drives backwards"
    assert rows[-1, :3] == pytest.approx(LINE[-1], abs=1e-12)
    driver.assert_smooth()


def test_a_plan_that_took_longer_than_its_lead_is_not_driven(driver):
    driver.start(LINE)
    driver.run(1.0)
    proposal = driver.core.propose(CORNER, ORIGIN, driver.now, lead=0.05)
    before = driver.core.window(driver.now + 0.2, 0.4)
    assert not driver.core.take(proposal, driver.now + 0.2)
    assert (driver.core.window(driver.now + 0.2, 0.4).positions == before.positions).all()
    proposal = driver.core.propose(CORNER, ORIGIN, driver.now, lead=0.3)
    driver.run(0.2)
    assert driver.core.take(proposal, driver.now)
    driver.run_to_the_end()
    driver.assert_smooth()


def test_requests_within_the_lead_of_a_new_path_apply_to_the_new_path(driver):
    driver.start(CORNER)
    driver.run(1.0)
    driver.start(CORNER[::-1] * [1, 1, 0] + [0.2, 0, 0], lead=0.5)
    driver.core.pause(driver.now)
    driver.run_to_the_end()
    driver.core.resume(driver.now)
    rows = driver.run_to_the_end()
    assert rows[-1, :3] == pytest.approx([0.2, 0, 0], abs=1e-9)
    driver.assert_smooth()


def test_new_limits_apply_from_the_next_path_that_begins_at_rest(driver):
    driver.start(LINE)
    driver.run(1.0)
    slow = build(PathParameters, robot_parameters("omniman") | {"limits.linear_velocity": 0.1})
    driver.core.parameters = slow
    driver.start(LINE + [0, 0.3, 0])
    assert driver.run_to_the_end()[:, 3].max() > 0.4
    driver.start(LINE, tuple(LINE[0]))
    assert driver.run_to_the_end()[:, 3].max() <= 0.09 * (1 + ROUND_OFF)


@pytest.mark.parametrize("after", [0.3, 1.4, 2.4])
def test_a_path_can_be_slowed_down_during_motion(driver, after):
    driver.start(CORNER)
    driver.run(after)
    driver.core.scale_limits(0.4, driver.now)
    assert driver.core.state is PathState.SLOWING
    braked = driver.run(2.0)
    rows = driver.run_to_the_end()
    driver.assert_smooth()
    later = np.vstack([braked[braked[:, 3:5].any(axis=1).argmin() :], rows])
    linear = driver.groups[0]
    assert 0.3 * 0.5 < linear.norm(later[:, 3:6]).max() <= 0.4 * 0.5 * (1 + ROUND_OFF)
    assert linear.norm(later[:, 6:9]).max() <= 0.4 * linear.acceleration * (1 + ROUND_OFF)
    assert rows[-1, :3] == pytest.approx(CORNER[-1], abs=1e-12)
    driver.core.scale_limits(1.0, driver.now)
    driver.start(LINE + rows[-1, :3], tuple(rows[-1, :3]))
    assert driver.run_to_the_end()[:, 3:5].max() > 0.4, "the next path runs at full speed again"


def test_slowing_can_be_paused_and_cancelled_and_applies_to_new_paths(driver):
    driver.start(LINE)
    driver.run(1.5)
    driver.core.scale_limits(0.3, driver.now)
    driver.core.pause(driver.now)
    driver.core.resume(driver.now)
    assert driver.core.state is PathState.SLOWING, (
        "the robot comes to rest before it continues slowly"
    )
    driver.core.pause(driver.now)
    driver.run(3.0)
    assert driver.core.state is PathState.PAUSED
    driver.core.resume(driver.now)
    assert driver.run(2.0)[:, 3].max() <= 0.15 * (1 + ROUND_OFF)
    driver.start(LINE + [0, 0.2, 0])
    assert driver.run(2.0)[:, 3].max() <= 0.15 * (1 + ROUND_OFF)
    driver.core.cancel(driver.now)
    driver.run_to_the_end()
    here = driver.rows[-1][:3]
    driver.start(LINE + here, tuple(here))
    assert driver.run_to_the_end()[:, 3].max() <= 0.15 * (1 + ROUND_OFF)
    driver.assert_smooth()


def test_the_limit_scale_applies_to_a_new_path_after_a_pause(driver):
    driver.core.scale_limits(0.3, driver.now)
    driver.start(LINE)
    driver.run(2.0)
    driver.core.pause(driver.now)
    driver.run(2.0)
    driver.core.scale_limits(1.0, driver.now)
    driver.start(LINE)
    assert driver.run_to_the_end()[:, 3].max() > 0.4
    driver.assert_smooth()


def test_a_path_planned_before_the_slowing_is_slowed_too(driver):
    driver.start(LINE)
    driver.run(1.0)
    proposal = driver.core.propose(LINE + [0, 0.3, 0], ORIGIN, driver.now, 0.1)
    driver.core.scale_limits(0.3, driver.now)
    assert driver.core.take(proposal, driver.now)
    driver.run(1.5)
    assert driver.run_to_the_end()[:, 3].max() <= 0.15 * (1 + ROUND_OFF)
    driver.assert_smooth()


def test_a_path_that_the_limit_scale_makes_too_long_is_paused(driver):
    driver.start(LINE)
    driver.run(1.0)
    driver.core.scale_limits(1e-6, driver.now)
    with pytest.raises(InputError, match="the path takes"):
        driver.run(3.0)
    assert driver.core.state is PathState.PAUSED
    with pytest.raises(RefusedError, match="cannot continue: the path takes"):
        driver.core.resume(driver.now)
    driver.core.scale_limits(1.0, driver.now)
    driver.core.resume(driver.now)
    assert driver.run_to_the_end()[-1, :3] == pytest.approx(LINE[-1], abs=1e-12)
    driver.assert_smooth()


def test_headings_can_follow_the_path():
    driver = Driver(heading="along")
    driver.start([[0, 0, 2], [2, 0, 2], [2, 2, 2]])
    rows = driver.run_to_the_end()
    fast = np.hypot(rows[:, 3], rows[:, 4]) > 0.05
    course = np.unwrap(np.arctan2(rows[fast, 4], rows[fast, 3]))
    away = np.hypot(*(rows[fast, :2] - [2, 0]).T) > 0.4
    assert np.abs((rows[fast, 2] - course)[away]).max() < 0.05
    assert rows[-1, 2] == pytest.approx(np.pi / 2)
    driver.assert_smooth()


def test_the_robot_turns_the_short_way_round(driver):
    driver.start([[0, 0, 3.0], [1, 0, -3.0]], (0.0, 0.0, 3.0))
    rows = driver.run_to_the_end()
    assert rows[:, 2].min() >= 3.0 - 1e-9 and rows[-1, 2] == pytest.approx(2 * np.pi - 3.0)


@pytest.mark.parametrize(
    ("poses", "words"),
    [
        (np.zeros((0, 3)), "the path is empty"),
        (np.zeros((3, 2)), "shape"),
        (np.zeros(3), "shape"),
        (np.zeros((20001, 3)), "20001 poses, at most 20000"),
        (np.array([[0, np.nan, 0]]), "positions"),
        (np.array([[np.inf, 0, 0]]), "positions"),
        (np.array([[1e7, 0, 0]]), "positions"),
        (np.array([[0, 0, np.nan]]), "headings"),
        (np.array([[3, 4, 0]]), "starts 5.00 m from the robot, at most 1 m"),
        (np.zeros((5, 3)), "nothing to drive"),
    ],
)
def test_invalid_paths_are_refused_and_change_nothing(driver, poses, words):
    with pytest.raises(InputError, match=words):
        driver.core.propose(poses, ORIGIN, driver.now)
    assert driver.core.state is PathState.IDLE
    driver.start(LINE)
    driver.run(1.0)
    window = driver.core.window(driver.now, 0.4)
    if words != "nothing to drive":
        with pytest.raises(InputError):
            driver.core.propose(poses, ORIGIN, driver.now)
    assert (driver.core.window(driver.now, 0.4).positions == window.positions).all()


def test_no_wheel_exceeds_its_permitted_speed():
    from omniman_ros.control.kinematics import PlatformKinematics
    from omniman_ros.core.se2 import to_robot

    driver = Driver(start_distance=10.0, linear_velocity=5.0, angular_velocity=5.0)
    robot = driver.core.parameters.robot
    driver.start([[0, 0, 0], [2, 2, 2.5], [4, 0, 0]])
    rows = driver.run_to_the_end()
    jacobian = PlatformKinematics(robot.wheels).J
    wheels = np.array([jacobian @ to_robot(row[2], row[3:6]) for row in rows])
    fraction = np.abs(wheels).max() / robot.motor.max_speed
    assert 0.8 < fraction <= 0.905


@pytest.mark.parametrize("seed", range(6))
def test_the_stream_keeps_its_limits_under_random_requests(seed):
    """The requests are paths, pauses, resumes and cancels at random times."""
    rng = np.random.default_rng(seed)
    driver = Driver(start_distance=10.0, reserve=0.0)
    core = driver.core
    kinds = set()
    for _ in range(60):
        driver.run(float(rng.choice([DT, 0.05, 0.3, 1.0])))
        here = driver.rows[-1][:3] if driver.rows else np.zeros(3)
        action = rng.choice(
            ["start", "pause", "resume", "cancel", "wait"], p=[0.3, 0.2, 0.3, 0.05, 0.15]
        )
        if action == "start" or (core.state is PathState.IDLE and action != "wait"):
            k = int(rng.integers(1, 8))
            steps = rng.normal(size=(k, 3)) * rng.choice([0.01, 0.1, 1.0])
            driver.start(here + np.cumsum(steps, axis=0), tuple(here), float(rng.choice([0, 0.1])))
        elif action == "pause" and core.state is PathState.FOLLOWING:
            core.pause(driver.now)
        elif action == "resume" and core.state in (PathState.PAUSING, PathState.PAUSED):
            core.resume(driver.now)
        elif action == "cancel":
            core.cancel(driver.now)
        kinds.add(core.state)
    assert len(kinds) >= 3
    driver.assert_smooth()
