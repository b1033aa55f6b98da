import itertools

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.motion.figure7 import LENGTH, Figure7, Movement, TimeLaw, movements, waypoints

FIGURE = Figure7()


def test_the_movements_are_contiguous_and_return_to_the_start():
    parts = movements(2.0)
    assert [part.name for part in parts] == [
        "forwards",
        "sideways",
        "backwards",
        "circle 1",
        "circle 2",
    ]
    for one, after in itertools.pairwise(parts):
        gap = np.array(after.start) - one.end
        np.testing.assert_allclose(gap[:2], 0, atol=1e-12)
        assert np.cos(gap[2]) == pytest.approx(1.0)
    x, y, heading = parts[-1].end
    assert (x, y) == pytest.approx((0, 0), abs=1e-12)
    assert np.cos(heading) == pytest.approx(1.0)


def test_the_lines_lead_forwards_sideways_and_backwards_without_a_turn():
    ends = [part.end for part in movements(1.5)[:3]]
    np.testing.assert_allclose(ends, [(1.5, 0, 0), (1.5, 1.5, 0), (0, 1.5, 0)], atol=1e-12)


def test_the_full_circle_is_driven_and_the_platform_turns_twice():
    points = waypoints(0.01, 1.5)
    on_circle = points[-round(1.5 * np.pi * 1.5 / 0.01) :]
    np.testing.assert_allclose(np.hypot(on_circle[:, 0], on_circle[:, 1] - 0.75), 0.75)
    angle = np.unwrap(np.arctan2(on_circle[:, 1] - 0.75, on_circle[:, 0]))
    assert angle[-1] - angle[0] == pytest.approx(3 * np.pi, abs=0.05)
    assert points[-1, 2] == pytest.approx(4 * np.pi)


@pytest.mark.parametrize("spacing", [0.01, 0.07, 0.5, 10.0])
def test_waypoints_keep_the_spacing_and_end_at_the_start(spacing):
    points = waypoints(spacing)
    assert points.ndim == 2
    assert points.shape[1] == 3
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    assert steps.max() <= spacing * (1 + 1e-9)
    assert steps.min() > 1e-6
    assert (np.diff(points[:, 2]) >= 0).all()
    np.testing.assert_array_equal(points[0], 0)
    np.testing.assert_allclose(points[-1], [0, 0, 4 * np.pi], atol=1e-12)


@pytest.mark.parametrize("spacing", [0.0, -1.0, float("nan")])
def test_a_non_positive_spacing_is_refused(spacing):
    with pytest.raises(InputError, match="spacing"):
        waypoints(spacing)


@pytest.mark.parametrize("part", movements(), ids=lambda part: part.name)
def test_slope_and_curvature_are_derivatives_by_path_length(part):
    distance, h = np.linspace(0.1, part.length - 0.1, 7), 1e-4
    pose, slope, curvature = part.at(distance)
    ahead, back = part.at(distance + h)[0], part.at(distance - h)[0]
    np.testing.assert_allclose((ahead - back) / (2 * h), slope, atol=1e-7)
    np.testing.assert_allclose((ahead - 2 * pose + back) / h**2, curvature, atol=1e-6)


def test_the_time_law_begins_and_ends_at_rest_and_holds_its_speed_between():
    law, length = TimeLaw(0.4, 1.5), 2.0
    end = law.duration(length)
    assert end == pytest.approx(2.0 / 0.4 + 1.5)
    distance, speed, rise = law.at(np.linspace(0, end, 1001), length)
    assert (distance[0], distance[-1]) == pytest.approx((0, length))
    for edge in (speed[0], speed[-1], rise[0], rise[-1]):
        assert edge == pytest.approx(0, abs=1e-9)
    assert speed.max() == pytest.approx(0.4)
    assert (speed > 0.3999).mean() == pytest.approx(1 - 2 * 1.5 / end, abs=0.05)
    assert abs(rise).max() == pytest.approx(1.875 * 0.4 / 1.5, rel=1e-3)


def test_speed_and_acceleration_are_derivatives_by_time():
    law, h = TimeLaw(), 1e-4
    time = np.linspace(0.1, law.duration(1.5) - 0.1, 50)
    distance, speed, rise = law.at(time, 1.5)
    ahead, back = law.at(time + h, 1.5)[0], law.at(time - h, 1.5)[0]
    np.testing.assert_allclose((ahead - back) / (2 * h), speed, atol=1e-7)
    np.testing.assert_allclose((ahead - 2 * distance + back) / h**2, rise, atol=1e-5)


def test_a_length_too_short_for_the_speed_is_refused():
    with pytest.raises(InputError, match="too short"):
        Figure7(length=0.3).legs(0.0)


def test_legs_are_previews_from_rest_to_rest_with_pauses_between():
    legs = FIGURE.legs(5.0)
    time = 5.0
    for leg, part in zip(legs, movements(LENGTH), strict=True):
        assert leg.begin == pytest.approx(time + FIGURE.rest)
        assert leg.preview.start == pytest.approx(leg.begin)
        time = leg.preview.end
        assert leg.preview.end_speed == 0.0
        np.testing.assert_allclose(leg.preview.sample(time + 1).pose[:2], part.end[:2], atol=1e-9)
    assert FIGURE.duration == pytest.approx(time + FIGURE.rest - 5.0)


def test_previews_follow_the_movement_in_velocity_and_acceleration():
    leg, h = FIGURE.legs(0.0)[3], 1e-4
    for now in np.linspace(leg.begin + 0.1, leg.preview.end - 0.1, 40):
        point, ahead, back = (leg.preview.sample(now + step) for step in (0.0, h, -h))
        np.testing.assert_allclose((ahead.pose - back.pose) / (2 * h), point.velocity, atol=1e-5)
        np.testing.assert_allclose(
            (ahead.velocity - back.velocity) / (2 * h), point.acceleration, atol=1e-4
        )
        assert np.hypot(*(point.pose[:2] - [0.0, LENGTH / 2])) == pytest.approx(LENGTH / 2)
    assert np.hypot(*leg.preview.sample(leg.begin + 5).velocity[:2]) == pytest.approx(0.4)


def test_a_custom_movement_begins_at_its_given_start():
    part = Movement("arc", (1.0, 2.0, 0.5), np.pi, 0.0, 1.0, -1.0)
    np.testing.assert_allclose(part.end, (1.0, 4.0, -0.5), atol=1e-12)
