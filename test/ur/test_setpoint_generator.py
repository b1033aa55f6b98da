"""The setpoint generator follows previews and always ends at rest."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omniman_ros.core.errors import InputError
from omniman_ros.ur.joint_guard import GuardError, JointLimits
from omniman_ros.ur.joint_preview import JointPreview
from omniman_ros.ur.setpoint_generator import (
    GeneratorSettings,
    GeneratorState,
    JointSetpointGenerator,
)

DT = 0.008
N = 6
HOME = np.array([0.1, -1.0, 1.5, 0.0, 0.3, -2.0])
ACCELERATION = 5.0
T0 = 100.0


def limits(**changes):
    values = {
        "names": ("pan", "lift", "elbow", "wrist_1", "wrist_2", "wrist_3"),
        "lower": np.full(N, -6.3),
        "upper": np.full(N, 6.3),
        "velocity": np.full(N, 3.0),
        "acceleration": np.full(N, ACCELERATION),
        "distance": np.full(N, 0.2),
    }
    return JointLimits(**(values | changes))


def swing(amplitude=0.5, omega=2.0, bend=1.0):
    """Return a joint motion from rest at HOME: q, q', q'' at a time since the start [s]."""
    size = amplitude * np.linspace(1.0, 0.3, N)
    second = bend * np.linspace(0.5, 1.5, N)

    def motion(t):
        t = max(t, 0.0)
        c, s = np.cos(omega * second * t), np.sin(omega * second * t)
        w = omega * second
        return HOME + size * (1 - c), size * w * s, size * w * w * c

    return motion


def preview(motion, start, length=0.4, accelerations=True, tick=DT):
    """Return the part of a motion starting at T0 from time `start` on."""
    times = start + np.arange(0.0, length + 0.5 * tick, tick)
    rows = [np.array(row) for row in zip(*(motion(t - T0) for t in times), strict=True)]
    return JointPreview(times, rows[0], rows[1], rows[2] if accelerations else None)


def test_a_preview_that_ends_at_rest_but_for_round_off_does_not_drift_on():
    times, rows = np.array([0.0, 1.0]), np.zeros((2, N))
    made = JointPreview(times, rows, np.outer([0.0, 1.0], np.full(N, 5.2e-5)))
    position, velocity, _ = made.sample(1000.0)
    assert not position.any() and not velocity.any()


class Run:
    """A ticked generator whose arm follows at once."""

    def __init__(self, **changes):
        self.stream = JointSetpointGenerator(limits(**changes), GeneratorSettings(0.05), DT)
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
                self.stream.follow(preview(motion, self.now + 0.002, **options), self.now + 0.003)
            self.tick()

    @property
    def velocities(self):
        return np.diff(self.sent, axis=0) / DT

    @property
    def accelerations(self):
        return np.diff(self.velocities, axis=0, prepend=np.zeros((1, N))) / DT

    def off_the_path(self, motion, since=0):
        """Return the largest distance of the setpoints from the path of a motion at any time."""
        curve = np.array([motion(t)[0] for t in np.arange(0.0, 4.0, 0.001)])
        return max(np.abs(curve - q).max(axis=1).min() for q in self.sent[since:])


def test_generator_holds_the_arm_at_its_position():
    run = Run()
    run.tick(5)
    assert np.array_equal(run.sent, np.tile(HOME, (6, 1)))
    assert run.stream.at_rest


@pytest.mark.parametrize("accelerations", [True, False])
def test_setpoints_sample_the_motion_at_their_times(accelerations):
    run, motion = Run(), swing()
    run.follow(motion, 1.0, accelerations=accelerations)
    expected = [motion(t - T0)[0] for t in run.times]
    assert np.allclose(run.sent[5:], expected[5:], rtol=0, atol=1e-5)
    assert run.stream.state is GeneratorState.FOLLOWING


def test_preview_that_ends_at_rest_is_followed_to_its_end_and_kept():
    run = Run()
    times = np.array([T0, T0 + 1.0])
    goal = HOME + 0.3
    run.stream.follow(JointPreview(times, np.array([HOME, goal]), np.zeros((2, N))), T0)
    run.tick(200)
    assert np.allclose(run.sent[-1], goal)
    assert run.stream.at_rest
    assert np.abs(run.accelerations).max() <= ACCELERATION


def test_early_preview_waits_for_its_start():
    run = Run()
    times = np.array([T0 + 0.5, T0 + 1.5])
    goal = JointPreview(times, np.array([HOME, HOME + 0.3]), np.zeros((2, N)))
    run.stream.follow(goal, T0)
    run.tick(62)
    assert np.array_equal(run.sent[-1], HOME)
    run.tick(70)
    assert run.sent[-1] == pytest.approx(goal.sample(run.now)[0])


def test_silent_source_causes_rest_on_the_path():
    run, motion = Run(), swing()
    run.follow(motion, 0.6)
    count = len(run.sent)
    end = run.now - 5 * DT + 0.002 + 0.4
    run.tick(100)
    moving = np.abs(run.velocities).max(axis=1) > 0.0
    assert not moving[-1]
    rest = run.times[len(moving) - moving[::-1].argmax()]
    assert rest <= end + 0.04  # the remaining preview is long enough to brake
    assert run.off_the_path(motion, count) < 1e-3
    assert np.abs(run.accelerations).max() <= ACCELERATION
    assert run.stream.at_rest


@pytest.mark.parametrize("length", [0.04, 0.1])
def test_motion_after_a_short_preview_brakes_straight_on_within_the_limits(length):
    run, motion = Run(), swing()
    run.follow(motion, 0.8, length=length)
    end = run.now - DT * 5 + 0.002 + length
    before = len(run.sent)
    run.tick(150)
    speed = np.abs(run.velocities).max(axis=1)
    last = next(i for i, t in enumerate(run.times) if t > end + 0.04)
    assert speed[last - 1] < speed[before - 2]  # braking begins no later than 40 ms after the end
    after = speed[last - 1 :]
    assert (np.diff(after) <= 1e-9).all()
    assert after[-1] == 0.0
    assert np.abs(run.accelerations).max() <= ACCELERATION


def test_final_velocity_of_a_preview_is_not_continued():
    run = Run()
    times = np.array([T0, T0 + 1.0])
    velocities = np.array([np.zeros(N), np.full(N, 0.5)])
    run.stream.follow(JointPreview(times, np.array([HOME, HOME + 0.25]), velocities), T0)
    run.tick(125 + 50)
    assert not run.velocities[-1].any()
    over = run.sent[-1] - (HOME + 0.25)
    assert (over > 0.0).all()
    assert over.max() < 1.2 * 0.5 * 0.5**2 / (0.9 * ACCELERATION) + 0.5 * DT


def test_preview_received_while_braking_is_joined():
    run, motion = Run(), swing(0.3)
    run.follow(motion, 0.8, length=0.1)
    run.tick(14)  # 20 ms after the end of the previous preview
    assert run.stream.state is GeneratorState.BRAKING
    run.follow(motion, 2.0, length=0.1)
    assert run.sent[-1] == pytest.approx(motion(run.now - T0)[0], abs=1e-3)
    assert np.abs(run.accelerations).max() <= ACCELERATION


def test_hold_brakes_on_the_path_and_accepts_no_preview_until_released():
    run, motion = Run(), swing()
    run.follow(motion, 0.6)
    speed = np.abs(run.velocities[-1]).max()
    run.stream.hold()
    count = len(run.sent)
    run.tick(math.ceil(speed / (0.8 * ACCELERATION) / DT) + 2)
    assert run.stream.at_rest
    assert not run.velocities[-1].any()
    assert run.off_the_path(motion, count) < 1e-3
    with pytest.raises(InputError, match="the arm holds"):
        run.stream.follow(preview(motion, run.now), run.now)
    run.stream.release()
    run.tick(10)
    assert not run.velocities[-1].any()
    here = np.array([run.sent[-1], run.sent[-1] + 0.01])
    run.stream.follow(
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
def test_distant_preview_is_rejected_and_changes_nothing(change, why):
    run, motion = Run(), swing()
    run.follow(motion, 0.4)
    elsewhere = preview(lambda t: (change(motion(t)[0]), *motion(t)[1:]), run.now)
    with pytest.raises(InputError, match=why):
        run.stream.follow(elsewhere, run.now)
    run.tick(3)
    assert run.sent[-1] == pytest.approx(motion(run.now - T0)[0], abs=1e-6)


@pytest.mark.parametrize(
    ("start", "why"), [(-1.0, "ended"), (1.2, "ahead")], ids=["old", "far ahead"]
)
def test_preview_of_another_time_is_rejected(start, why):
    run = Run()
    still = JointPreview(np.array([T0 + start]), HOME[None], np.zeros((1, N)))
    with pytest.raises(InputError, match=why):
        run.stream.follow(still, T0)


def test_older_preview_does_not_replace_a_newer_one():
    run, motion = Run(), swing()
    run.follow(motion, 0.2)
    with pytest.raises(InputError, match="out of order"):
        run.stream.follow(preview(motion, run.now - 0.1), run.now)


@pytest.mark.parametrize(
    ("motion", "why"),
    [
        (swing(3.0, 2.0), "acceleration"),
        (lambda t: (HOME + 0.1 * (t > 0.1), np.zeros(N), np.zeros(N)), "velocity"),
    ],
)
def test_preview_beyond_the_limits_is_rejected_before_any_motion(motion, why):
    run = Run()
    with pytest.raises(InputError, match=why):
        run.stream.follow(preview(motion, run.now), run.now)
    run.tick()
    assert not run.velocities.any()


def test_preview_through_a_position_limit_is_rejected():
    run = Run(upper=HOME + 0.2)
    with pytest.raises(InputError, match="position"):
        run.stream.follow(preview(swing(0.3), run.now, length=1.0), run.now)


def test_lagging_arm_causes_a_stop_within_the_limits():
    run, motion = Run(), swing()
    run.follow(motion, 0.5)
    with pytest.raises(GuardError, match="distance to measured"):
        run.stream.tick(run.now + DT, HOME - 1.0)
    while not run.stream.at_rest:
        run.now += DT
        run.sent.append(run.stream.tick(run.now, None))
    assert np.abs(run.accelerations).max() <= ACCELERATION * (1 + 1e-9)
    with pytest.raises(InputError, match="the arm holds"):
        run.stream.follow(preview(motion, run.now), run.now)


@pytest.mark.parametrize("label", ["velocity", "upper"])
def test_limits_lowered_in_motion_lead_to_rest(label):
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


def test_lower_acceleration_applies_from_the_next_rest_and_prolongs_no_stop():
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
        run.stream.follow(way(0.01), run.now)
    run.stream.follow(way(0.002), run.now)


@pytest.mark.parametrize("ahead", [0.006, 0.01, 0.02, 0.05, 0.09])
def test_preview_slightly_in_the_future_is_joined_at_its_start(ahead):
    run, motion = Run(), swing()
    for k in range(100):
        if k % 5 == 0:
            run.stream.follow(preview(motion, run.now + ahead), run.now)
        run.tick()
    expected = [motion(t - T0)[0] for t in run.times]
    since = round(ahead / DT) + 45  # the joined motion starts at the awaited part
    assert np.allclose(run.sent[since:], expected[since:], rtol=0, atol=2e-3)
    assert np.abs(run.accelerations).max() <= ACCELERATION


def test_preview_far_ahead_of_a_motion_is_rejected():
    run, motion = Run(), swing()
    run.follow(motion, 0.4)
    with pytest.raises(InputError, match="ahead"):
        run.stream.follow(preview(motion, run.now + 0.2), run.now)


SEQUENCES = (
    st.floats(0.05, 0.6),
    st.floats(0.5, 2.5),
    st.floats(0.03, 0.4),
    st.integers(1, 12),
    st.lists(
        st.tuples(st.sampled_from(["follow", "silent", "hold"]), st.integers(1, 60)),
        min_size=1,
        max_size=6,
    ),
)  #: Amplitude [rad], frequency [rad/s], length [s] and period of previews, and the events


@settings(max_examples=20, deadline=None, derandomize=True)
@given(*SEQUENCES)
def test_random_sequences_stay_within_the_limits_and_end_at_rest(size, omega, length, every, acts):
    check_sequence(size, omega, length, every, acts)


@pytest.mark.exhaustive
@settings(max_examples=150, deadline=None, derandomize=True)
@given(*SEQUENCES)
def test_many_random_sequences_stay_within_the_limits_and_end_at_rest(
    size, omega, length, every, acts
):
    check_sequence(size, omega, length, every, acts)


def check_sequence(size, omega, length, every, acts):
    run, motion = Run(), swing(size, omega)
    for act, count in acts:
        if act == "hold":
            run.stream.hold()
        for k in range(count):
            if act == "follow" and k % every == 0:
                run.stream.release()
                try:
                    run.stream.follow(preview(motion, run.now, length), run.now + 0.001)
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
    """Return a run whose arm lags its setpoints by `lead` [s]."""
    run = Run()
    run.stream = JointSetpointGenerator(limits(), GeneratorSettings(0.05, lead), DT)
    run.sent = [run.stream.begin(HOME, run.now)]
    return run


def gathering(jerk=50.0, top=ACCELERATION):
    """Return a motion of maximal acceleration of all joints: q, q', q'' at a time [s]."""
    ramp = top / jerk

    def motion(t):
        t = max(t, 0.0)
        u, w = min(t, ramp), max(t - ramp, 0.0)
        v = 0.5 * jerk * u * u
        q = jerk * u**3 / 6.0 + v * w + 0.5 * top * w * w
        one = np.ones(N)
        return HOME + q * one, (v + top * w) * one, jerk * u * one

    return motion


def test_setpoints_lead_by_the_lag_of_the_arm():
    run, motion = leading(), swing(bend=0.0)
    run.follow(motion, 1.0)
    expected = [motion(t + LEAD - T0)[0] for t in run.times]
    assert np.allclose(run.sent[60:], expected[60:], rtol=0, atol=1e-5)


@pytest.mark.parametrize("ahead", [0.0, 0.012, 0.024, 0.04, 0.06])
def test_motion_that_starts_within_the_lead_time_is_joined_in_progress(ahead):
    run, motion = leading(), gathering()
    for k in range(30):
        if k % 5 == 0:  # no preview is rejected
            late = preview(lambda t: motion(t - ahead), run.now, length=0.4)
            run.stream.follow(late, run.now)
        run.tick()
    expected = [motion(t + LEAD - ahead - T0)[0] for t in run.times]
    off = np.abs(np.array(run.sent) - expected).max(axis=1)
    assert off.max() < 2e-3
    assert off[-8:].max() < 1e-5
    assert np.abs(run.accelerations).max() <= ACCELERATION + 1e-6


def test_end_point_within_the_lead_time_is_still_reached():
    run = leading()
    times = np.array([T0, T0 + 0.02])
    run.stream.follow(JointPreview(times, np.array([HOME, HOME + 0.01]), np.zeros((2, N))), T0)
    run.tick(40)
    assert run.stream.at_rest
    assert run.sent[-1] == pytest.approx(HOME + 0.01, abs=1e-6)


@pytest.mark.parametrize(
    ("start", "why"), [(-0.001, "ended"), (1.001, "ahead")], ids=["old", "far ahead"]
)
def test_preview_time_is_checked_at_reception(start, why):
    def still(at):
        return JointPreview(np.array([T0 + at]), HOME[None], np.zeros((1, N)))

    with pytest.raises(InputError, match=why):
        leading().stream.follow(still(start), T0)
    leading().stream.follow(still(0.001), T0)
    leading().stream.follow(still(0.999), T0)


def test_lead_does_not_delay_the_detection_of_a_silent_source():
    def braked(run):
        run.follow(swing(bend=0.0), 0.6, length=0.15)
        while run.stream.state is GeneratorState.FOLLOWING:
            run.tick()
        return run.now

    # On the same path, earlier only by the time by which the path is left earlier.
    assert braked(Run()) - braked(leading()) == pytest.approx(LEAD, abs=2 * DT)


def follow_as_allowed(run, motion, seconds):
    """Feed previews that may be refused; return the number of refusals."""
    refused = 0
    for k in range(round(seconds / DT)):
        if k % 5 == 0:
            try:
                run.stream.follow(preview(motion, run.now + 0.002), run.now + 0.003)
            except InputError:
                refused += 1
        run.tick()
    return refused


def test_a_source_that_ignores_its_limit_is_braked_on_its_path_and_refused():
    run, motion = Run(), swing(amplitude=1.0, omega=1.0)
    follow_as_allowed(run, motion, 0.6)
    assert np.abs(run.velocities[-1]).max() > 0.3
    run.stream.allowed.target = 0.0
    assert follow_as_allowed(run, motion, 1.0) > 0
    assert run.stream.at_rest
    assert np.abs(run.accelerations).max() <= ACCELERATION * (1 + 1e-6)
    assert run.off_the_path(motion) < 1e-3
    rest = run.sent[-1]
    assert follow_as_allowed(run, motion, 0.4) > 0
    np.testing.assert_array_equal(run.sent[-1], rest)


def test_a_source_that_keeps_to_its_limit_is_not_interfered_with():
    slow, run = swing(omega=0.1), Run()
    run.stream.allowed.target = 0.1
    assert follow_as_allowed(run, slow, 1.0) == 0
    assert run.stream.state is GeneratorState.FOLLOWING
    expected = [slow(t - T0)[0] for t in run.times]
    assert np.allclose(run.sent[5:], expected[5:], rtol=0, atol=1e-4)


def test_a_limit_that_opens_lets_the_next_preview_move_the_arm():
    run = Run()
    run.stream.allowed.target = 0.0
    run.tick(200)
    motion = swing()
    later = run.now - T0
    assert follow_as_allowed(run, lambda t: motion(t - later), 0.3) > 0
    assert run.stream.at_rest
    run.stream.allowed.target = 1.0
    run.tick()
    begin = run.now - T0
    assert follow_as_allowed(run, lambda t: motion(t - begin), 0.5) == 0
    assert np.abs(run.velocities[-1]).max() > 0.1
