import math

import numpy as np
import pytest

from omniman_ros.viewer.optimistic_updates import DRAG_TIMEOUT, RELEASE_TIMEOUT, OptimisticUpdates
from omniman_ros.viewer.page.dragging import MAX_DISTANCE, DragTracker, on_plane

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
        pytest.param((-2.0, 1.0, 2.5 - 2.4 / MAX_DISTANCE), id="to the horizon"),
        pytest.param((math.nan, 0.0, 0.0), id="unknown"),
        pytest.param(EYE, id="no ray"),
    ],
)
def test_a_ray_that_does_not_descend_meets_no_plane(through):
    assert on_plane(EYE, through, 0.0) is None


def test_a_ray_reaches_up_to_the_largest_distance():
    x, y = on_plane(EYE, (-2.0, 1.0, 2.5 - 2.6 / MAX_DISTANCE), 0.0)
    assert 0.9 * MAX_DISTANCE < x - EYE[0] < MAX_DISTANCE and y == pytest.approx(1.0)


def test_an_object_grabbed_off_its_centre_does_not_jump():
    tracker = DragTracker()
    point = (1.2, 0.3, 0.6)
    tracker.start("left", "goal", (1.0, 0.5), point, HERE)
    assert tracker.update("left", EYE, point, HERE).position == pytest.approx((1.0, 0.5))


def test_the_grabbed_point_stays_under_the_pointer():
    """This holds high above the floor too, and with the floor moved below the camera."""
    tracker, floor = DragTracker(), (-2.0, 0.7)
    position = (3.0, 0.5)
    point = np.array([position[0] + floor[0] + 0.1, position[1] + floor[1] - 0.2, 0.6])
    tracker.start("left", "goal", position, point, floor)
    goes = np.array([0.4, -0.9, 0.0])
    pointer = EYE + 0.5 * (point + goes - EYE)
    drag = tracker.update("left", EYE, pointer, floor)
    assert drag.key == "goal"
    assert drag.position == pytest.approx((3.4, -0.4))


def test_a_resting_pointer_drags_along_a_moving_floor():
    """While the page follows the robot, an object held at one pixel moves over the floor."""
    tracker, point = DragTracker(), (1.0, 0.0, 0.0)
    tracker.start("left", "goal", (1.0, 0.0), point, HERE)
    assert tracker.update("left", EYE, point, (-0.5, 0.0)).position == pytest.approx((1.5, 0.0))


def test_beyond_the_horizon_an_object_stays_at_its_last_position():
    tracker = DragTracker()
    tracker.start("left", "goal", (1.0, 0.0), (1.0, 0.0, 0.0), HERE)
    tracker.update("left", EYE, (2.0, 0.0, 0.0), HERE)
    assert tracker.update("left", EYE, (0.0, 0.0, 9.0), HERE).position == pytest.approx((2.0, 0.0))


def test_two_pointers_drag_independently():
    tracker = DragTracker()
    tracker.start((1, "a"), "goal", (1.0, 0.0), (1.0, 0.0, 0.0), HERE)
    tracker.start((2, "a"), "start", (5.0, 0.0), (5.0, 0.0, 0.0), HERE)
    assert tracker.update((1, "a"), EYE, (1.5, 0.0, 0.0), HERE).key == "goal"
    assert tracker.update((2, "a"), EYE, (5.5, 0.0, 0.0), HERE).position == pytest.approx(
        (5.5, 0.0)
    )
    tracker.end((1, "a"))
    tracker.end((1, "a"))
    assert tracker.update((1, "a"), EYE, (1.5, 0.0, 0.0), HERE) is None
    assert tracker.update((2, "a"), EYE, (5.5, 0.0, 0.0), HERE) is not None


def test_a_drag_overrides_the_confirmed_value():
    updates = OptimisticUpdates()
    updates.put("goal", 1, False)
    updates.put("goal", 2, False)
    updates.put("start", 3, False)
    assert dict(updates.values(10.0)) == {"goal": 2, "start": 3}


def test_a_silent_drag_expires():
    updates = OptimisticUpdates()
    updates.put("goal", 1, False)
    assert updates.values(10.0) and updates.values(10.0 + 0.99 * DRAG_TIMEOUT)
    assert not updates.values(10.0 + DRAG_TIMEOUT)
    updates.put("goal", 2, False)
    assert dict(updates.values(20.0)) == {"goal": 2}, "until it moves on"


def test_a_released_value_expires_sooner():
    updates = OptimisticUpdates()
    updates.put("goal", 1, False)
    updates.values(10.0)
    updates.put("goal", 2, True)
    assert dict(updates.values(10.1)) == {"goal": 2}
    assert not updates.values(10.1 + RELEASE_TIMEOUT)
