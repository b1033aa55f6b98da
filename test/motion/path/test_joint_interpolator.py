import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.motion.path.axis_limits import AxisLimits
from omniman_ros.motion.path.interpolator import PathState, RefusedError
from omniman_ros.motion.path.joint_interpolator import JointInterpolator
from omniman_ros.motion.path.joint_parameters import JointTrajectoryOptions
from omniman_ros.motion.path.joint_points import JointPlanner, JointPoints
from test.motion.path.support import DT

LIMITS = AxisLimits.of_arm(ArmParameters())
ALL = tuple(range(6))
HOME = np.array([0.3, -1.2, 1.4, -0.5, 0.2, 0.1])


class Arm:
    """Drives an interpolator and follows its stream, one tick at a time."""

    def __init__(self, **options) -> None:
        self.core = JointInterpolator(LIMITS, build(JointTrajectoryOptions, options))
        self.now, self.here = 100.0, HOME
        self.rows: list[np.ndarray] = []

    def start(self, positions, times=None, columns=ALL, lead=0.0, start=None, **more) -> None:
        given = JointPoints(
            columns,
            None if times is None else np.array(times, dtype=float),
            np.atleast_2d(np.array(positions, dtype=float)),
            **{label: np.atleast_2d(np.array(rows)) for label, rows in more.items()},
        )
        proposal = self.core.propose(given, self.here, self.now, lead, start)
        assert self.core.take(proposal, self.now)

    def run(self, seconds: float) -> np.ndarray:
        first = len(self.rows)
        for _ in range(round(seconds / DT)):
            if self.core.state is not PathState.IDLE:
                x, v, a = self.core.sample(np.array([self.now]))
                self.here = x[0]
                self.rows.append(np.concatenate([x[0], v[0], a[0]]))
            self.now += DT
            self.core.update(self.now)
        return np.array(self.rows[first:])

    def run_to_the_end(self) -> np.ndarray:
        rows = self.run(self.core.remaining(self.now) + 1.5)  # the pace may still be rising
        assert self.core.state in (PathState.IDLE, PathState.PAUSED)
        return rows

    def assert_smooth(self) -> None:
        """Assert limits and continuity, also from position differences as a guard sees them."""
        x, v, a = np.split(np.array(self.rows), 3, axis=1)
        assert (np.abs(v) <= LIMITS.velocity * (1 + 1e-6)).all()
        assert (np.abs(a) <= LIMITS.acceleration * (1 + 1e-6)).all()
        assert (np.abs(np.diff(x, 2, axis=0)) / DT**2 <= LIMITS.acceleration * (1 + 1e-6)).all()
        assert np.abs(np.diff(x, axis=0) / DT - 0.5 * (v[1:] + v[:-1])).max() < 2e-3


@pytest.fixture
def arm() -> Arm:
    return Arm()


@settings(max_examples=15, deadline=None, derandomize=True)
@given(st.integers(0, 10_000))
def test_a_trajectory_without_times_keeps_all_limits_and_passes_each_point(seed):
    arm, rng = Arm(), np.random.default_rng(seed)
    goals = rng.uniform(-1, 1, (int(rng.integers(1, 5)), 6)) * rng.choice([0.01, 0.3, 3.0])
    arm.start(goals)
    x, _v, a = np.split(arm.run_to_the_end(), 3, axis=1)
    arm.assert_smooth()
    assert (np.abs(np.diff(a, axis=0)) / DT <= 0.9 * LIMITS.jerk * (1 + 1e-6)).all()
    for goal in goals:
        assert np.abs(x - goal).max(axis=1).min() < 1e-4
    assert (x[-1] == goals[-1]).all()


def test_a_corner_tolerance_saves_time(arm):
    goals = [HOME + [0.5, 0, 0, 0, 0, 0], HOME + [0.5, 0.5, 0, 0, 0, 0]]
    arm.start(goals)
    exact = arm.core.remaining(arm.now)
    round_off = Arm(corner_tolerance=0.1)
    round_off.start(goals)
    assert round_off.core.remaining(round_off.now) < 0.9 * exact
    x = round_off.run_to_the_end()[:, :6]
    assert 0.01 < np.abs(x - goals[0])[:, :2].max(axis=1).min() <= 0.1


def test_given_times_velocities_and_accelerations_are_kept_exactly(arm):
    times, rng = np.array([0.8, 1.7, 3.0]), np.random.default_rng(3)
    x = HOME + rng.uniform(-0.2, 0.2, (3, 6))
    v, a = rng.uniform(-0.1, 0.1, (2, 3, 6))
    v[-1] = a[-1] = 0.0
    arm.start(x, times, velocities=v, accelerations=a)
    start = arm.core._motion.start
    got = arm.core.sample(start + times)
    for part, wanted in zip(got, (x, v, a), strict=True):
        assert part == pytest.approx(wanted, abs=1e-9)
    arm.run_to_the_end()
    arm.assert_smooth()


def test_a_first_point_at_time_zero_must_be_the_present_position(arm):
    goal = HOME + 0.3
    arm.start([HOME + 0.015, goal], [0.0, 2.0], velocities=np.zeros((2, 6)))
    assert arm.run(DT)[0, :6] == pytest.approx(HOME, abs=0)
    assert arm.run_to_the_end()[-1, :6] == pytest.approx(goal, abs=0)
    arm.assert_smooth()
    with pytest.raises(
        InputError, match=r"0\.03 rad from its present position, at most 0\.02 rad"
    ):
        arm.start([arm.here + 0.03, HOME], [0.0, 2.0])
    with pytest.raises(
        InputError, match=r"starts with 0\.2 rad/s, its present velocity is 0 rad/s"
    ):
        arm.start([arm.here, HOME], [0.0, 2.0], velocities=[[0.2] * 6, [0.0] * 6])


def test_round_off_of_a_planner_is_no_motion(arm):
    """Repeated points, a start just after 0, and 5.2e-05 rad/s at the end."""
    middle, goal = HOME + 0.15, HOME + 0.3
    rows = [HOME, HOME, middle, middle + 1e-6, goal, goal]
    times = [0.0, 3e-9, 1.0, 1.0, 2.0, 2.0 - 1e-9]
    speeds = np.outer([0.0, 0.0, 0.28, 0.28, 5.2e-5, 5.2e-5], np.ones(6))
    arm.start(rows, times, velocities=speeds)
    end = arm.run_to_the_end()[-1]
    assert (end[:6] == goal).all() and not end[6:].any()
    assert not arm.run(1.0).any(), "nothing drifts on"
    arm.assert_smooth()
    with pytest.raises(InputError, match=r"ends with 0\.01 rad/s, not at rest \(up to 0\.001\)"):
        arm.start(goal, [2.0], velocities=[0.01] * 6)


def test_velocities_without_times_may_be_round_off(arm):
    arm.start(HOME + 0.1, velocities=[5e-5] * 6)
    with pytest.raises(InputError, match="velocities without times"):
        arm.start(HOME + 0.1, velocities=[0.1] * 6)


def test_jerky_points_of_other_planners_are_accepted_if_configured():
    """Time-optimal planners accelerate fully from the first point on (bang-bang)."""
    times = np.array([0.0, 0.1, 0.5, 0.9, 1.0])
    a = 0.6 * np.array([4.0, 4.0, 0.0, -4.0, -4.0])
    v = 0.6 * np.array([0.0, 0.4, 1.2, 0.4, 0.0])
    x = HOME[0] + 0.6 * np.array([0.0, 0.02, 0.36, 0.70, 0.72])
    given = {"velocities": v[:, None], "accelerations": a[:, None]}
    with pytest.raises(InputError, match="shoulder_pan_joint: jerk"):
        Arm().start(x[:, None], times, (0,), **given)
    arm = Arm(jerk_scale=20.0)
    arm.start(x[:, None], times, (0,), **given)
    assert arm.run_to_the_end()[-1, 0] == x[-1]
    assert (np.array(arm.rows)[:, 1:6] == HOME[1:]).all()


@pytest.mark.parametrize("given_time", [None, [3.0]])
@pytest.mark.parametrize("after", [0.02, 0.3, 0.6, 0.9])
def test_a_pause_stops_on_the_path_and_can_be_resumed(given_time, after):
    arm = Arm()
    goal = HOME + [1.0, -0.5, 0, 0, 0.2, 0]
    arm.start(goal, given_time)
    arm.run(after)
    arm.core.pause(arm.now)
    arm.run_to_the_end()
    assert arm.core.state is PathState.PAUSED
    held = arm.run(1.0)
    assert (held == held[0]).all() and not held[:, 6:].any()
    arm.core.resume(arm.now)
    rows = arm.run_to_the_end()
    arm.assert_smooth()
    assert (rows[-1, :6] == goal).all()
    fraction = (np.array(arm.rows)[:, [0, 1, 4]] - HOME[[0, 1, 4]]) / (goal - HOME)[[0, 1, 4]]
    assert np.ptp(fraction, axis=1).max() < 1e-9, "the arm stays on its path"


def test_requests_that_the_state_does_not_allow_are_refused(arm):
    for request in (arm.core.pause, arm.core.resume, arm.core.cancel):
        with pytest.raises(RefusedError, match="idle"):
            request(arm.now)
    arm.start(HOME + 0.5)
    with pytest.raises(RefusedError, match="following"):
        arm.core.resume(arm.now)
    arm.core.cancel(arm.now)
    with pytest.raises(RefusedError, match="cancelling"):
        arm.core.pause(arm.now)


def test_moving_joints_that_a_new_trajectory_omits_come_to_rest(arm):
    arm.start(HOME + [1.0, 0.8, 0, 0, 0, 0], [2.0])
    arm.run(1.0)
    arm.start([[HOME[1]]], [1.5], (1,))
    rows = arm.run_to_the_end()
    arm.assert_smooth()
    assert rows[-1, 1] == HOME[1] and 0.3 < rows[-1, 0] - HOME[0] < 1.5


def test_a_plan_that_took_longer_than_its_lead_is_not_driven(arm):
    arm.start(HOME + 0.5)
    arm.run(0.3)
    given = JointPoints(ALL, None, HOME[None, :])
    proposal = arm.core.propose(given, HOME, arm.now, 0.05)
    assert not arm.core.take(proposal, arm.now + 0.2)
    assert arm.core.take(proposal, arm.now + 0.04)


def test_a_stop_window_leads_to_rest_from_anywhere(arm):
    arm.start(HOME + [1.0, 0.8, 0, 0, 0, 0])
    for _ in range(20):
        arm.run(0.04)
        window = arm.core.stop_window(arm.now)
        assert not window.velocities[-1].any()
        assert window.positions[0] == pytest.approx(arm.core.sample(window.times[:1])[0][0])
        assert (np.abs(window.accelerations) <= LIMITS.acceleration * (1 + 1e-6)).all()


@pytest.mark.parametrize("seed", range(4))
def test_the_stream_keeps_its_limits_under_random_requests(seed):
    """The requests are timed and untimed trajectories, pauses, resumes and cancels."""
    arm, rng, states = Arm(), np.random.default_rng(seed), set()
    for _ in range(50):
        arm.run(float(rng.choice([DT, 0.05, 0.3, 0.8])))
        action = rng.choice(["fast", "timed", "pause", "resume", "cancel"])
        try:
            if action in ("fast", "timed"):
                times = np.cumsum(rng.uniform(0.5, 2, 2)) if action == "timed" else None
                columns = tuple(rng.permutation(6)[:3].tolist())
                lead = float(rng.choice([0.0, 0.1]))
                arm.start(rng.uniform(-1, 1, (2, 3)), times, columns, lead)
            else:
                getattr(arm.core, action)(arm.now)
        except (InputError, RefusedError):
            pass
        states.add(arm.core.state)
    assert len(states) >= 4
    arm.assert_smooth()


def test_a_replaced_motion_can_be_sampled_for_a_while():
    """A measurement is older than the present and is compared with its own setpoint."""
    core = JointInterpolator(AxisLimits.of_arm(ArmParameters()), JointTrajectoryOptions())
    core.take(core.propose(JointPoints((0,), None, np.array([[3.0]])), np.zeros(6), 0.0), 0.0)
    before = JointPoints((0,), np.array([2.0]), np.array([[3.1]]))
    core.take(core.propose(before, np.zeros(6), 1.0, 0.03), 1.0)
    since = core._since
    expected = core.sample(np.array([since - 0.012]))
    core.update(since + 0.2)
    again = core.sample(np.array([since - 0.012]))
    assert again[0] == pytest.approx(expected[0]) and again[1] == pytest.approx(expected[1])
    assert abs(expected[1][0, 0]) > 0.5


def test_between_two_points_all_joints_are_in_step():
    planner = JointPlanner(LIMITS, build(JointTrajectoryOptions, {}))
    end = HOME + [0.4, -0.3, 1.0, 0.2, -0.7, 0.0]
    curve = planner.through(end[None], HOME)
    covered = (curve.sample(np.linspace(0.0, curve.duration, 50))[0] - HOME)[:, :5]
    fractions = covered / (end - HOME)[:5]
    np.testing.assert_allclose(fractions, fractions[:, :1].repeat(5, axis=1), atol=1e-9)
    np.testing.assert_allclose(fractions[[0, -1], 0], [0.0, 1.0], atol=1e-9)
