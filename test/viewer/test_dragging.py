import math

import numpy as np
import pytest

from omniman_ros.viewer.dragging import FARTHEST, FORGET, LINGER, Ahead, Hands, on_plane

EYE = (-3.0, 1.0, 2.5)
HERE = (0.0, 0.0)


def test_a_ray_meets_the_plane_on_the_line_from_the_camera():
    rng = np.random.default_rng(3)
    for _ in range(50):
        eye, target = rng.uniform([-5, -5, 1], [5, 5, 4]), rng.uniform(-5, 5, 3)
        target[2] = rng.uniform(0.0, 0.8)
        # Any point of the ray will do: the plane of the browser is another one.
        through = eye + rng.uniform(0.1, 3.0) * (target - eye)
        assert on_plane(eye, through, target[2]) == pytest.approx(target[:2])


@pytest.mark.parametrize(
    "through",
    [
        pytest.param((0.0, 0.0, 2.5), id="level"),
        pytest.param((0.0, 0.0, 3.0), id="upwards"),
        pytest.param((-2.0, 1.0, 2.5 - 2.4 / FARTHEST), id="to the horizon"),
        pytest.param((math.nan, 0.0, 0.0), id="unknown"),
        pytest.param(EYE, id="no ray"),
    ],
)
def test_a_ray_that_does_not_come_down_leads_nowhere(through):
    assert on_plane(EYE, through, 0.0) is None


def test_a_ray_reaches_as_far_as_it_may():
    x, y = on_plane(EYE, (-2.0, 1.0, 2.5 - 2.6 / FARTHEST), 0.0)
    assert 0.9 * FARTHEST < x - EYE[0] < FARTHEST and y == pytest.approx(1.0)


def test_what_is_grabbed_off_its_centre_does_not_jump():
    hands = Hands()
    point = (1.2, 0.3, 0.6)
    hands.grab("left", "goal", (1.0, 0.5), point, HERE)
    assert hands.lead("left", EYE, point, HERE).place == pytest.approx((1.0, 0.5))


def test_the_point_that_was_grabbed_stays_under_the_pointer():
    """Even high above the floor, and with the floor moved below the camera."""
    hands, floor = Hands(), (-2.0, 0.7)
    place = (3.0, 0.5)
    point = np.array([place[0] + floor[0] + 0.1, place[1] + floor[1] - 0.2, 0.6])
    hands.grab("left", "goal", place, point, floor)
    goes = np.array([0.4, -0.9, 0.0])
    pointer = EYE + 0.5 * (point + goes - EYE)
    grip = hands.lead("left", EYE, pointer, floor)
    assert grip.thing == "goal"
    assert grip.place == pytest.approx((3.4, -0.4))


def test_a_floor_that_moves_takes_the_thing_along_the_floor():
    """Following the robot, what is held over one pixel goes on over the floor."""
    hands, point = Hands(), (1.0, 0.0, 0.0)
    hands.grab("left", "goal", (1.0, 0.0), point, HERE)
    assert hands.lead("left", EYE, point, (-0.5, 0.0)).place == pytest.approx((1.5, 0.0))


def test_over_the_horizon_a_thing_stays_where_it_was_led_last():
    hands = Hands()
    hands.grab("left", "goal", (1.0, 0.0), (1.0, 0.0, 0.0), HERE)
    hands.lead("left", EYE, (2.0, 0.0, 0.0), HERE)
    assert hands.lead("left", EYE, (0.0, 0.0, 9.0), HERE).place == pytest.approx((2.0, 0.0))


def test_two_hands_hold_two_things_and_an_empty_hand_none():
    hands = Hands()
    hands.grab((1, "a"), "goal", (1.0, 0.0), (1.0, 0.0, 0.0), HERE)
    hands.grab((2, "a"), "start", (5.0, 0.0), (5.0, 0.0, 0.0), HERE)
    assert hands.lead((1, "a"), EYE, (1.5, 0.0, 0.0), HERE).thing == "goal"
    assert hands.lead((2, "a"), EYE, (5.5, 0.0, 0.0), HERE).place == pytest.approx((5.5, 0.0))
    hands.let_go((1, "a"))
    hands.let_go((1, "a"))
    assert hands.lead((1, "a"), EYE, (1.5, 0.0, 0.0), HERE) is None
    assert hands.lead((2, "a"), EYE, (5.5, 0.0, 0.0), HERE) is not None


def test_what_is_dragged_is_shown_where_it_is_led():
    ahead = Ahead()
    ahead.put("goal", 1, False)
    ahead.put("goal", 2, False)
    ahead.put("start", 3, False)
    assert dict(ahead.values(10.0)) == {"goal": 2, "start": 3}


def test_a_hand_that_falls_silent_is_forgotten():
    ahead = Ahead()
    ahead.put("goal", 1, False)
    assert ahead.values(10.0) and ahead.values(10.0 + 0.99 * FORGET)
    assert not ahead.values(10.0 + FORGET)
    ahead.put("goal", 2, False)
    assert dict(ahead.values(20.0)) == {"goal": 2}, "until it moves on"


def test_what_is_let_go_is_soon_shown_as_it_is_known():
    ahead = Ahead()
    ahead.put("goal", 1, False)
    ahead.values(10.0)
    ahead.put("goal", 2, True)
    assert dict(ahead.values(10.1)) == {"goal": 2}
    assert not ahead.values(10.1 + LINGER)
