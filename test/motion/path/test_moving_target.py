"""A stream of single points leads the arm, at most as fast as its limits allow."""

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.motion.path.joint_points import JointPoints
from omniman_ros.motion.path.moving_target import LONGEST, MovingTarget
from test.motion.path.support import DT
from test.motion.path.test_joint_interpolator import ALL, HOME, LIMITS, Arm

LEAD = 0.15
RATE = 0.3 * np.array([1.0, -0.5, 0.3, 0.0, 0.0, 1.0])


def line(time):
    return HOME + RATE * time


class StreamedArm(Arm):
    def point(self, position, velocity=None, due=LEAD, columns=ALL) -> None:
        velocity = np.zeros(len(columns)) if velocity is None else velocity
        target = MovingTarget(columns, np.asarray(position), velocity, due)
        proposal = self.core.propose_meeting(target, self.here, self.now, 0.01)
        assert self.core.take(proposal, self.now)

    def follow(self, course, seconds, rate=None) -> np.ndarray:
        """Send a point every 24 ms; return the distances (k,) from the course [rad]."""
        begin, away = self.now, []
        while self.now < begin + seconds:
            self.point(course(self.now - begin + LEAD), rate)
            self.run(3 * DT)
            away.append(np.abs(self.here - course(self.now - begin)).max())
        return np.array(away)

    def assert_limits(self) -> None:
        self.assert_smooth()
        a = np.array(self.rows)[:, 12:]
        assert (np.abs(np.diff(a, axis=0)) / DT <= LIMITS.jerk * (1 + 1e-6)).all()


def test_the_arm_follows_points_and_rests_at_the_last_one():
    arm = StreamedArm()
    away = arm.follow(line, 2.0)
    assert away[40:].max() < 0.05, "the lead of the points makes up for most of the delay"
    arm.run(0.6)
    assert arm.core.state is PathState.IDLE
    assert arm.here == pytest.approx(line(83 * 3 * DT + LEAD), abs=1e-9)
    arm.assert_limits()


def test_points_with_velocities_are_met_in_motion_and_the_arm_rests_soon_after():
    arm = StreamedArm()
    away = arm.follow(line, 2.0, RATE)
    assert away[40:].max() < 0.01
    arm.run(1.0)
    assert arm.core.state is PathState.IDLE
    beyond = (arm.here - line(83 * 3 * DT + LEAD))[0] / RATE[0]
    assert 0.0 < beyond < 0.5, "it moves on for less than half a second"
    arm.assert_limits()


def test_a_point_that_can_be_reached_in_time_is_reached_in_time():
    arm = StreamedArm()
    arm.point(HOME + 0.01, due=0.4)
    arm.run(0.4 + DT)
    assert arm.here == pytest.approx(HOME + 0.01, abs=1e-9)


def test_axes_that_points_omit_come_to_rest():
    arm = StreamedArm()
    arm.follow(line, 1.0)
    for _ in range(60):
        arm.point([HOME[1]], columns=(1,))
        arm.run(3 * DT)
    assert arm.here[1] == pytest.approx(HOME[1], abs=1e-6)
    assert np.abs(np.array(arm.rows)[-1, 6:]).max() < 1e-6 and 0.2 < arm.here[0] - HOME[0] < 0.5
    arm.assert_limits()


@pytest.mark.parametrize("step", [-0.05, 0.3])
def test_a_stream_takes_over_from_a_trajectory_at_full_speed(step):
    """A point that is too near to be reached at this speed is reached after braking."""
    arm = StreamedArm(reserve=0.0)
    arm.start(HOME - 0.4)
    arm.run(0.3)
    here = arm.here.copy()
    for _ in range(100):
        arm.point(here + step)
        arm.run(3 * DT)
    assert arm.here == pytest.approx(here + step, abs=1e-6)
    arm.assert_smooth()


@pytest.mark.parametrize("seed", range(3))
def test_limits_hold_whatever_a_stream_asks_for(seed):
    arm, rng, refused = StreamedArm(), np.random.default_rng(seed), 0
    goal, speed = HOME.copy(), np.zeros(6)
    for _ in range(200):
        if rng.random() < 0.1:
            goal = HOME + rng.uniform(-0.4, 0.4, 6)
            speed = rng.uniform(-1.0, 1.0, 6) * rng.choice([0.0, 1.0, 4.0])
        try:
            arm.point(goal, speed, float(rng.uniform(0.01, 0.3)))
        except InputError:
            refused += 1
        arm.run(DT * int(rng.integers(1, 8)))
    assert refused < 100
    arm.assert_limits()


@pytest.mark.parametrize(
    ("position", "due", "words"),
    [
        (HOME + [0, 0, 3.0, 0, 0, 0], LEAD, "elbow_joint: position 4.4 rad"),
        (HOME + [2.0, 0, 0, 0, 0, 0], LEAD, f"2 rad away cannot be reached within {LONGEST:g} s"),
    ],
)
def test_points_that_cannot_be_reached_are_refused_and_change_nothing(position, due, words):
    arm = StreamedArm()
    with pytest.raises(InputError, match=words):
        arm.point(position, due=due)
    assert arm.core.state is PathState.IDLE


def test_a_point_that_was_due_is_refused():
    given = JointPoints((0,), np.array([0.15]), np.zeros((1, 1)))
    with pytest.raises(InputError, match=r"due 0\.050 s ago"):
        MovingTarget.last_of(given, -0.2)


def test_motions_that_are_replaced_before_they_begin_are_forgotten():
    """As a limit holds motion time still, no replaced motion ever becomes old."""
    arm = StreamedArm()
    for _ in range(50):
        arm.point(HOME + 0.05)
    assert len(arm.core._before) <= 1
