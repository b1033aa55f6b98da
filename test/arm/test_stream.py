"""Setpoints along previews, and always to a rest."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omniman_ros.arm.guard import GuardError, JointLimits
from omniman_ros.arm.joint_preview import JointPreview
from omniman_ros.arm.stream import JointStream, StreamSettings, StreamState
from omniman_ros.core.errors import InputError

DT = 0.008
N = 6
HOME = np.array([0.1, -1.0, 1.5, 0.0, 0.3, -2.0])
ACCELERATION = 5.0
T0 = 100.0


def limits(**changes):
    values = {
        "names": ("pan", "lift", "elbow", "wrist_1", "wrist_2", "wrist_3"),
        "lower": np.full(N, -6.3), "upper": np.full(N, 6.3), "velocity": np.full(N, 3.0),
        "acceleration": np.full(N, ACCELERATION), "distance": np.full(N, 0.2),
    }  # fmt: skip
    return JointLimits(**(values | changes))


def swing(amplitude=0.5, omega=2.0, bend=1.0):
    """A motion of all joints from rest at HOME: q, q', q'' of a time [s] since its begin."""
    size = amplitude * np.linspace(1.0, 0.3, N)
    second = bend * np.linspace(0.5, 1.5, N)

    def motion(t):
        t = max(t, 0.0)
        c, s = np.cos(omega * second * t), np.sin(omega * second * t)
        w = omega * second
        return HOME + size * (1 - c), size * w * s, size * w * w * c

    return motion


def preview(motion, start, length=0.4, accelerations=True, tick=DT):
    """The part of a motion that begins at T0, from `start` on."""
    times = start + np.arange(0.0, length + 0.5 * tick, tick)
    rows = [np.array(row) for row in zip(*(motion(t - T0) for t in times), strict=True)]
    return JointPreview(times, rows[0], rows[1], rows[2] if accelerations else None)


class Run:
    """A stream that is ticked; the arm follows at once."""

    def __init__(self, **changes):
        self.stream = JointStream(limits(**changes), StreamSettings(0.05), DT)
        self.now = T0
        self.sent = [self.stream.begin(HOME, self.now)]
        self.times = [self.now]

    def tick(self, count=1):
        for _ in range(count):
            self.now += DT
            self.sent.append(self.stream.tick(self.now, self.sent[-1]))
            self.times.append(self.now)

    def follow(self, motion, seconds, every=5, **options):
        for k in range(round(seconds / DT)):
            if k % every == 0:
                self.stream.preview(preview(motion, self.now + 0.002, **options), self.now + 0.003)
            self.tick()

    @property
    def velocities(self):
        return np.diff(self.sent, axis=0) / DT

    @property
    def accelerations(self):
        return np.diff(self.velocities, axis=0, prepend=np.zeros((1, N))) / DT

    def off_the_path(self, motion, since=0):
        """Largest distance of the setpoints from the curve of a motion, whenever it is there."""
        curve = np.array([motion(t)[0] for t in np.arange(0.0, 4.0, 0.001)])
        return max(np.abs(curve - q).max(axis=1).min() for q in self.sent[since:])


def test_it_holds_where_the_arm_is():
    run = Run()
    run.tick(5)
    assert np.array_equal(run.sent, np.tile(HOME, (6, 1)))
    assert run.stream.at_rest


@pytest.mark.parametrize("accelerations", [True, False])
def test_setpoints_are_the_motion_at_their_own_times(accelerations):
    run, motion = Run(), swing()
    run.follow(motion, 1.0, accelerations=accelerations)
    expected = [motion(t - T0)[0] for t in run.times]
    assert np.allclose(run.sent[5:], expected[5:], rtol=0, atol=1e-5)
    assert run.stream.state is StreamState.FOLLOWING


def test_a_preview_that_ends_at_rest_is_followed_to_its_end_and_held():
    run = Run()
    times = np.array([T0, T0 + 1.0])
    goal = HOME + 0.3
    run.stream.preview(JointPreview(times, np.array([HOME, goal]), np.zeros((2, N))), T0)
    run.tick(200)
    assert np.allclose(run.sent[-1], goal)
    assert run.stream.at_rest
    assert np.abs(run.accelerations).max() <= ACCELERATION


def test_an_early_preview_waits_for_its_begin():
    run = Run()
    times = np.array([T0 + 0.5, T0 + 1.5])
    goal = JointPreview(times, np.array([HOME, HOME + 0.3]), np.zeros((2, N)))
    run.stream.preview(goal, T0)
    run.tick(62)
    assert np.array_equal(run.sent[-1], HOME)
    run.tick(70)
    assert run.sent[-1] == pytest.approx(goal.sample(run.now)[0])


def test_when_the_source_falls_silent_it_comes_to_rest_on_the_path_and_holds():
    run, motion = Run(), swing()
    run.follow(motion, 0.6)
    count = len(run.sent)
    end = run.now - 5 * DT + 0.002 + 0.4
    run.tick(100)
    moving = np.abs(run.velocities).max(axis=1) > 0.0
    assert not moving[-1]
    rest = run.times[len(moving) - moving[::-1].argmax()]
    assert rest <= end + 0.04  # the rest of the preview is long enough for it
    assert run.off_the_path(motion, count) < 1e-3
    assert np.abs(run.accelerations).max() <= ACCELERATION
    assert run.stream.at_rest


@pytest.mark.parametrize("length", [0.04, 0.1])
def test_a_short_preview_is_left_straight_on_within_the_limits_at_once(length):
    run, motion = Run(), swing()
    run.follow(motion, 0.8, length=length)
    end = run.now - DT * 5 + 0.002 + length
    before = len(run.sent)
    run.tick(150)
    speed = np.abs(run.velocities).max(axis=1)
    last = next(i for i, t in enumerate(run.times) if t > end + 0.04)
    assert speed[last - 1] < speed[before - 2]  # it brakes no later than 40 ms after the end
    after = speed[last - 1 :]
    assert (np.diff(after) <= 1e-9).all()
    assert after[-1] == 0.0
    assert np.abs(run.accelerations).max() <= ACCELERATION


def test_a_velocity_is_never_repeated_for_ever():
    run = Run()
    times = np.array([T0, T0 + 1.0])
    velocities = np.array([np.zeros(N), np.full(N, 0.5)])
    run.stream.preview(JointPreview(times, np.array([HOME, HOME + 0.25]), velocities), T0)
    run.tick(125 + 50)
    assert not run.velocities[-1].any()
    over = run.sent[-1] - (HOME + 0.25)
    assert (over > 0.0).all()
    assert over.max() < 1.2 * 0.5 * 0.5**2 / (0.9 * ACCELERATION) + 0.5 * DT


def test_a_preview_that_comes_while_it_brakes_is_joined():
    run, motion = Run(), swing(0.3)
    run.follow(motion, 0.8, length=0.1)
    run.tick(14)  # 20 ms after the end of the last
    assert run.stream.state is StreamState.BRAKING
    run.follow(motion, 2.0, length=0.1)
    assert run.sent[-1] == pytest.approx(motion(run.now - T0)[0], abs=1e-3)
    assert np.abs(run.accelerations).max() <= ACCELERATION


def test_a_hold_brakes_on_the_path_and_takes_no_preview_until_it_is_released():
    run, motion = Run(), swing()
    run.follow(motion, 0.6)
    speed = np.abs(run.velocities[-1]).max()
    run.stream.hold()
    count = len(run.sent)
    run.tick(math.ceil(speed / (0.8 * ACCELERATION) / DT) + 2)
    assert run.stream.at_rest
    assert not run.velocities[-1].any()
    assert run.off_the_path(motion, count) < 1e-3
    with pytest.raises(InputError, match="held"):
        run.stream.preview(preview(motion, run.now), run.now)
    run.stream.release()
    run.tick(10)
    assert not run.velocities[-1].any()
    here = np.array([run.sent[-1], run.sent[-1] + 0.01])
    run.stream.preview(
        JointPreview(np.array([run.now, run.now + 0.2]), here, np.zeros((2, N))), run.now
    )
    run.tick(30)
    assert run.sent[-1] == pytest.approx(here[1])


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda q: q + 0.06, "pan|lift|elbow.* 0.06 rad away"),
        (lambda q: q + 2 * math.pi, "6.28 rad away"),
        (lambda q: np.where(np.arange(N) == 4, q + 0.16, q), "wrist_2: .* away"),
    ],
)
def test_a_preview_that_is_elsewhere_is_refused_and_changes_nothing(change, why):
    run, motion = Run(), swing()
    run.follow(motion, 0.4)
    elsewhere = preview(lambda t: (change(motion(t)[0]), *motion(t)[1:]), run.now)
    with pytest.raises(InputError, match=why):
        run.stream.preview(elsewhere, run.now)
    run.tick(3)
    assert run.sent[-1] == pytest.approx(motion(run.now - T0)[0], abs=1e-6)


@pytest.mark.parametrize(
    ("start", "why"), [(-1.0, "over"), (1.2, "ahead")], ids=["old", "far ahead"]
)
def test_a_preview_of_another_time_is_refused(start, why):
    run = Run()
    still = JointPreview(np.array([T0 + start]), HOME[None], np.zeros((1, N)))
    with pytest.raises(InputError, match=why):
        run.stream.preview(still, T0)


def test_an_older_preview_does_not_replace_a_newer_one():
    run, motion = Run(), swing()
    run.follow(motion, 0.2)
    with pytest.raises(InputError, match="out of order"):
        run.stream.preview(preview(motion, run.now - 0.1), run.now)


@pytest.mark.parametrize(
    ("motion", "why"),
    [
        (swing(3.0, 2.0), "acceleration"),
        (lambda t: (HOME + 0.1 * (t > 0.1), np.zeros(N), np.zeros(N)), "velocity"),
    ],
)
def test_a_preview_beyond_the_limits_is_refused_before_it_moves_anything(motion, why):
    run = Run()
    with pytest.raises(InputError, match=why):
        run.stream.preview(preview(motion, run.now), run.now)
    run.tick()
    assert not run.velocities.any()


def test_a_preview_through_a_position_limit_is_refused():
    run = Run(upper=HOME + 0.2)
    with pytest.raises(InputError, match="position"):
        run.stream.preview(preview(swing(0.3), run.now, length=1.0), run.now)


def test_an_arm_that_is_left_behind_stops_it_within_the_limits():
    run, motion = Run(), swing()
    run.follow(motion, 0.5)
    with pytest.raises(GuardError, match="distance to measured"):
        run.stream.tick(run.now + DT, HOME - 1.0)
    while not run.stream.at_rest:
        run.now += DT
        run.sent.append(run.stream.tick(run.now, None))
    assert np.abs(run.accelerations).max() <= ACCELERATION * (1 + 1e-9)
    with pytest.raises(InputError, match="held"):
        run.stream.preview(preview(motion, run.now), run.now)


@pytest.mark.parametrize("label", ["velocity", "upper"])
def test_limits_that_are_lowered_in_motion_end_in_a_rest(label):
    run, motion = Run(), swing()
    run.follow(motion, 0.7)
    lowered = {"velocity": np.full(N, 0.05), "upper": HOME}
    run.stream.limits = limits(**{label: lowered[label]})
    with pytest.raises(GuardError):
        run.tick(200)
    for _ in range(400):
        run.now += DT
        run.sent.append(run.stream.tick(run.now, None))
    assert run.stream.at_rest
    assert not run.velocities[-1].any()
    assert np.abs(run.accelerations).max() <= ACCELERATION * (1 + 1e-6)


def test_a_lower_acceleration_makes_no_stop_longer_and_counts_from_the_next_rest_on():
    run, motion = Run(), swing()
    run.follow(motion, 0.7)
    run.stream.limits = limits(acceleration=np.full(N, 0.1))
    run.stream.hold()
    run.tick(60)
    assert run.stream.at_rest
    run.stream.release()

    def way(length):
        ends = np.array([run.sent[-1], run.sent[-1] + length])
        return JointPreview(np.array([run.now, run.now + 0.5]), ends, np.zeros((2, N)))

    with pytest.raises(InputError, match="acceleration"):
        run.stream.preview(way(0.01), run.now)
    run.stream.preview(way(0.002), run.now)


@pytest.mark.parametrize("ahead", [0.006, 0.01, 0.02, 0.05, 0.09])
def test_a_preview_that_begins_a_little_ahead_is_joined_when_it_begins(ahead):
    run, motion = Run(), swing()
    for k in range(100):
        if k % 5 == 0:
            run.stream.preview(preview(motion, run.now + ahead), run.now)
        run.tick()
    expected = [motion(t - T0)[0] for t in run.times]
    since = round(ahead / DT) + 45  # it begins with the part that was waited for
    assert np.allclose(run.sent[since:], expected[since:], rtol=0, atol=2e-3)
    assert np.abs(run.accelerations).max() <= ACCELERATION


def test_a_preview_far_ahead_of_a_motion_is_refused():
    run, motion = Run(), swing()
    run.follow(motion, 0.4)
    with pytest.raises(InputError, match="ahead"):
        run.stream.preview(preview(motion, run.now + 0.2), run.now)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    st.floats(0.05, 0.6), st.floats(0.5, 2.5), st.floats(0.03, 0.4), st.integers(1, 12),
    st.lists(st.tuples(st.sampled_from(["follow", "silent", "hold"]), st.integers(1, 60)),
             min_size=1, max_size=6),
)  # fmt: skip
def test_whatever_comes_the_limits_hold_and_it_ends_at_rest(size, omega, length, every, acts):
    run, motion = Run(), swing(size, omega)
    for act, count in acts:
        if act == "hold":
            run.stream.hold()
        for k in range(count):
            if act == "follow" and k % every == 0:
                run.stream.release()
                try:
                    run.stream.preview(preview(motion, run.now, length), run.now + 0.001)
                except InputError as error:
                    assert any(w in str(error) for w in ("away", "acceleration", "velocity"))
            run.tick()
    run.tick(500)
    assert run.stream.at_rest
    assert np.abs(run.velocities).max() <= 3.0 * (1 + 1e-6)
    assert np.abs(run.accelerations).max() <= ACCELERATION * (1 + 1e-6)
    assert not run.velocities[-1].any()


LEAD = 0.042


def leading(lead=LEAD):
    """A stream whose arm is so much behind its setpoints [s]."""
    run = Run()
    run.stream = JointStream(limits(), StreamSettings(0.05, lead), DT)
    run.sent = [run.stream.begin(HOME, run.now)]
    return run


def gathering(jerk=50.0, top=ACCELERATION):
    """All joints gather speed as fast as they may: q, q', q'' of a time [s]."""
    ramp = top / jerk

    def motion(t):
        t = max(t, 0.0)
        u, w = min(t, ramp), max(t - ramp, 0.0)
        v = 0.5 * jerk * u * u
        q = jerk * u**3 / 6.0 + v * w + 0.5 * top * w * w
        one = np.ones(N)
        return HOME + q * one, (v + top * w) * one, jerk * u * one

    return motion


def test_setpoints_are_those_of_the_time_at_which_the_arm_is_there():
    run, motion = leading(), swing(bend=0.0)
    run.follow(motion, 1.0)
    expected = [motion(t + LEAD - T0)[0] for t in run.times]
    assert np.allclose(run.sent[60:], expected[60:], rtol=0, atol=1e-5)


@pytest.mark.parametrize("ahead", [0.0, 0.012, 0.024, 0.04, 0.06])
def test_a_motion_that_begins_sooner_than_the_arm_can_be_there_is_joined_under_way(ahead):
    run, motion = leading(), gathering()
    for k in range(30):
        if k % 5 == 0:  # none of them is refused
            late = preview(lambda t: motion(t - ahead), run.now, length=0.4)
            run.stream.preview(late, run.now)
        run.tick()
    expected = [motion(t + LEAD - ahead - T0)[0] for t in run.times]
    off = np.abs(np.array(run.sent) - expected).max(axis=1)
    assert off.max() < 2e-3
    assert off[-8:].max() < 1e-5
    assert np.abs(run.accelerations).max() <= ACCELERATION + 1e-6


def test_an_end_that_the_setpoints_have_passed_is_gone_to():
    run = leading()
    times = np.array([T0, T0 + 0.02])
    run.stream.preview(JointPreview(times, np.array([HOME, HOME + 0.01]), np.zeros((2, N))), T0)
    run.tick(40)
    assert run.stream.at_rest
    assert run.sent[-1] == pytest.approx(HOME + 0.01, abs=1e-6)


@pytest.mark.parametrize(
    ("start", "why"), [(-0.001, "over"), (1.001, "ahead")], ids=["old", "far ahead"]
)
def test_a_preview_is_judged_by_the_time_at_which_it_comes(start, why):
    def still(at):
        return JointPreview(np.array([T0 + at]), HOME[None], np.zeros((1, N)))

    with pytest.raises(InputError, match=why):
        leading().stream.preview(still(start), T0)
    leading().stream.preview(still(0.001), T0)
    leading().stream.preview(still(0.999), T0)


def test_a_silent_source_is_noticed_as_soon_with_a_lead_as_without():
    def braked(run):
        run.follow(swing(bend=0.0), 0.6, length=0.15)
        while run.stream.state is StreamState.FOLLOWING:
            run.tick()
        return run.now

    # On the same way, only so much sooner as the way is left sooner.
    assert braked(Run()) - braked(leading()) == pytest.approx(LEAD, abs=2 * DT)
