import math

import numpy as np
import pytest

from omniman_ros.control.wheel_feedback import WheelFeedback
from omniman_ros.core.errors import InputError

DT = 0.005


def make(span=0.0, max_speed=20.0):
    return WheelFeedback(2, span, max_speed)


def test_first_report_is_the_origin():
    feedback = make()
    assert not feedback.received
    assert feedback.age(5.0) == math.inf
    assert feedback.update(1.0, 1.0, np.array([7.0, 8]), np.array([1.0, 2])) is None
    assert feedback.received
    np.testing.assert_array_equal(feedback.speeds, [1, 2])


def test_report_gives_rotation_speed_and_time_since_the_previous_report():
    feedback = make()
    feedback.update(1.0, 1.0, np.array([7.0, 8]), np.array([1.0, 2]))
    step = feedback.update(1.0 + DT, 1.01, np.array([7.01, 7.99]), np.array([1.5, 2.5]))
    np.testing.assert_allclose(step.moved, [0.01, -0.01])
    np.testing.assert_array_equal(step.speeds, [1.5, 2.5])
    assert step.dt == pytest.approx(DT)
    assert step.warning == ""


def test_age_is_the_larger_of_stamp_and_arrival_age():
    feedback = make()
    feedback.update(1.0, 1.03, np.zeros(2), np.zeros(2))
    assert feedback.age(1.05) == pytest.approx(0.05)
    feedback.update(2.0, 1.95, np.zeros(2), np.zeros(2))
    assert feedback.age(2.05) == pytest.approx(0.10)


@pytest.mark.parametrize(
    ("time", "position", "velocity", "why"),
    [
        (2.0, None, None, "neither positions nor velocities"),
        (2.0, np.zeros(3), np.zeros(2), "3 positions for 2 wheels"),
        (2.0, np.zeros(2), np.zeros(1), "1 velocities for 2 wheels"),
        (2.0, np.zeros((1, 2)), None, "2 positions for 2 wheels"),
        (2.0, np.array([0, math.nan]), np.zeros(2), "positions .* not finite"),
        (2.0, np.zeros(2), np.array([math.inf, 0]), "velocities .* not finite"),
        (1.0, np.zeros(2), np.zeros(2), "out of order"),
        (0.5, np.zeros(2), np.zeros(2), "out of order, 0.5000 s before"),
    ],
)
@pytest.mark.parametrize("span", [0.0, math.tau])
def test_invalid_report_is_rejected_and_changes_no_state(span, time, position, velocity, why):
    feedback, clean = make(span), make(span)
    for each in (feedback, clean):
        each.update(1.0, 1.0, np.array([3.0, 3.1]), np.array([1.0, 2]))
    with pytest.raises(InputError, match=why):
        feedback.update(time, 2.0, position, velocity)
    np.testing.assert_array_equal(feedback.speeds, [1, 2])
    assert feedback.age(2.0) == pytest.approx(1.0)
    after = [each.update(1.01, 2.0, np.array([3.05, 3.15]), None) for each in (feedback, clean)]
    np.testing.assert_array_equal(after[0].moved, after[1].moved)
    np.testing.assert_array_equal(after[0].speeds, after[1].speeds)


def test_wrapping_positions_are_unwrapped_in_both_directions():
    feedback = make(span=math.tau)
    total, true = np.zeros(2), np.zeros(2)
    for i in range(1, 400):
        feedback_position = np.mod(true, math.tau)
        step = feedback.update(i * DT, i * DT, feedback_position, np.array([15.0, -15]))
        total += 0 if step is None else step.moved
        true = true + np.array([15.0, -15]) * DT
    np.testing.assert_allclose(total, true - np.array([15.0, -15]) * DT, atol=1e-9)


def test_observer_replaces_missing_speeds():
    feedback = make()
    for i in range(1, 200):
        feedback.update(i * DT, i * DT, np.array([4.0, -2]) * i * DT, None)
    np.testing.assert_allclose(feedback.speeds, [4, -2], atol=1e-6)


def test_speeds_are_integrated_where_positions_are_missing():
    feedback = make()
    feedback.update(1.0, 1.0, None, np.array([1.0, -1]))
    step = feedback.update(1.1, 1.1, None, np.array([3.0, -1]))
    np.testing.assert_allclose(step.moved, [0.2, -0.1])
    # Intermittent positions are not connected over the gap between them.
    step = feedback.update(1.2, 1.2, np.array([50.0, 50]), np.array([3.0, -1]))
    np.testing.assert_allclose(step.moved, [0.3, -0.1])
    step = feedback.update(1.3, 1.3, np.array([50.1, 50]), np.array([3.0, -1]))
    np.testing.assert_allclose(step.moved, [0.1, 0.0])


def test_jumping_positions_are_skipped_with_a_warning():
    feedback = make(max_speed=20.0)
    feedback.update(1.0, 1.0, np.zeros(2), np.ones(2))
    step = feedback.update(1.0 + DT, 1.0, np.array([0.0, 1.3]), np.ones(2))
    assert "positions jumped (encoder_span, if they wrap around)" in step.warning
    assert not step.moved.any()
    step = feedback.update(1.0 + 2 * DT, 1.0, np.array([0.005, 1.305]), np.ones(2))
    np.testing.assert_allclose(step.moved, 0.005)
    assert step.warning == ""


def test_position_jump_does_not_appear_as_speed():
    feedback = make()
    for i in range(1, 100):
        feedback.update(i * DT, i * DT, np.array([2.0, -2]) * i * DT, None)
    jumped = feedback.update(100 * DT, 100 * DT, np.array([500.0, 500]), None)
    assert "jumped" in jumped.warning
    assert abs(jumped.speeds).max() <= 2.1
    for i in range(101, 200):
        step = feedback.update(i * DT, i * DT, 500 + np.array([2.0, -2]) * (i - 100) * DT, None)
        assert abs(step.speeds).max() <= 2.5
    np.testing.assert_allclose(step.speeds, [2, -2], atol=1e-3)


GAP = 0.7


def over_a_gap(before, after, moved, span=0.0):
    """Return the step of two wheels over a gap; positions may be missing."""
    feedback = make(span=span)
    feedback.update(1.0, 1.0, np.zeros(2) if moved is not None else None, np.array(before))
    position = None if moved is None else np.array(moved, dtype=float)
    step = feedback.update(1.0 + GAP, 1.0 + GAP, position, np.array(after))
    assert "no report for" in step.warning
    return step


@pytest.mark.parametrize(
    ("before", "after", "moved"),
    [
        ([5.0, -5.0], [5.0, -5.0], [3.5, -3.5]),  # at its speed
        ([5.0, -5.0], [0.0, 0.0], [1.2, -1.2]),  # to rest
        ([0.0, 0.0], [5.0, 5.0], [2.0, 1.0]),  # from rest
        ([2.0, 2.0], [-2.0, -2.0], [0.4, -0.4]),  # there and back
    ],
)
def test_positions_tell_the_motion_in_a_gap(before, after, moved):
    step = over_a_gap(before, after, moved)
    np.testing.assert_array_equal(step.moved, moved)
    np.testing.assert_array_equal(step.unknown, 0.0)


@pytest.mark.parametrize(
    ("moved", "span"),
    [
        (None, 0.0),
        ([-20.0, -20.0], 0.0),  # the drives began anew
        ([2.0, -2.0], 0.0),  # a wheel has turned against its speed
        ([2.0, 2.0], 6.0),  # or a whole turn more
    ],
)
def test_motion_in_a_gap_that_nothing_tells_is_missing(moved, span):
    step = over_a_gap([5.0, 5.0], [-1.0, 0.0], moved, span)
    assert not step.moved.any()
    np.testing.assert_allclose(step.unknown, [GAP * 6.0, GAP * 5.0])


def test_positions_of_a_drive_that_has_restarted_do_not_tell_the_motion_in_a_gap():
    """Its wheel has coasted, but its position continues from where it was."""
    feedback = make()
    feedback.update(1.0, 1.0, np.zeros(2), np.array([5.0, 5.0]))
    feedback.note_restart()
    feedback.update(1.01, 1.01, np.array([0.05, 0.05]), np.array([5.0, 5.0]))
    step = feedback.update(1.01 + GAP, 1.01 + GAP, np.array([0.05, 1.6]), np.zeros(2))
    assert "a drive has restarted" in step.warning
    assert not step.moved.any()
    np.testing.assert_allclose(step.unknown, [GAP * 5.0, GAP * 5.0])
    later = 1.01 + 2.0 * GAP
    step = feedback.update(later, later, np.array([0.05, 1.6]), np.zeros(2))
    assert "the positions tell the motion" in step.warning, "it counts for one gap"


def agree(seconds, position_of, speed_of):
    """Return the feedback after some time; positions and speeds (2,) are functions of time."""
    feedback = make()
    for i in range(1, round(seconds / DT)):
        feedback.update(i * DT, i * DT, np.array(position_of(i * DT)), np.array(speed_of(i * DT)))
        if feedback.suspect is not None:
            break
    return feedback, i * DT


@pytest.mark.parametrize(
    ("position_of", "speed_of"),
    [
        (lambda t: [2 * t, 0.7], lambda t: [2.0, 2.0]),  # a frozen encoder
        (lambda t: [2 * t, 2 * t], lambda t: [2.0, 0.0]),  # a frozen speed
        (lambda t: [2 * t, -2 * t], lambda t: [2.0, 2.0]),  # a wrong sign
    ],
)
def test_wheel_with_inconsistent_speed_and_position_is_detected(position_of, speed_of):
    feedback, when = agree(2.0, position_of, speed_of)
    assert feedback.suspect == 1
    assert 0.05 < when < 0.6
    feedback.forget()
    assert feedback.suspect is None


@pytest.mark.parametrize("lag", [0.0, 0.01, 0.03])
def test_healthy_wheels_are_not_suspected(lag):
    def position(t):  # starts, reversals and 14 rad/s, seen through a coarse encoder
        return (np.array([7 * math.sin(2 * t), 14 * t]) // 0.0131 * 0.0131).tolist()

    feedback, when = agree(4.0, position, lambda t: [14 * math.cos(2 * (t - lag)), 14.0])
    assert feedback.suspect is None, f"after {when:.2f} s"


@pytest.mark.parametrize("held", [0.1, 0.2, 0.35])
@pytest.mark.parametrize("speed", [2.0, 6.0, 14.0])
def test_burst_of_delayed_reports_is_not_a_lost_encoder(held, speed):
    feedback = make()
    for t in np.arange(1, 600) * DT:
        late = 1.0 < t <= 1.0 + held  # all reports arrive after the delay, one after the other
        arrival = 1.0 + held + (t - 1.0) * 0.01 if late else t
        feedback.update(arrival, arrival, np.full(2, speed * t), np.full(2, speed))
        assert feedback.suspect is None, f"after {t:.2f} s"


def test_forget_restarts_from_the_next_report():
    feedback = make(span=math.tau)
    feedback.update(1.0, 1.0, np.ones(2), np.ones(2))
    feedback.forget()
    assert not feedback.received
    assert not feedback.speeds.any()
    assert feedback.age(1.0) == math.inf
    assert feedback.update(0.5, 2.0, np.array([6.0, 0.1]), np.ones(2)) is None
