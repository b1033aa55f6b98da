"""Speed and way of the approach to a station."""

import math

import numpy as np
import pytest

from omniman_ros.motion.station.keeper import approach_speed, path_around

RADIUS = 1.2


@pytest.mark.parametrize("distance", [0.0, 0.01, 0.1, 1.0, 5.0])
def test_approach_speed_can_be_braked_with_the_deceleration_within_the_distance(distance):
    speed = approach_speed(distance, 3.0, 0.4)
    assert speed**2 / (2.0 * 0.4) <= distance
    assert approach_speed(-distance, 3.0, 0.4) == -speed


def test_approach_speed_is_smooth_where_its_two_parts_meet():
    meeting = 0.4 / 3.0**2
    below, at, above = (approach_speed(meeting + d, 3.0, 0.4) for d in (-1e-6, 0.0, 1e-6))
    assert at - below == pytest.approx(3.0e-6, rel=1e-3)
    assert above - at == pytest.approx(3.0e-6, rel=1e-3)


def test_free_way_is_the_straight_line():
    length, direction = path_around((-3.0, -2.0), (0.0, -1.3), RADIUS)
    assert length == pytest.approx(math.hypot(3.0, 0.7))
    assert direction == pytest.approx((3.0 / length, 0.7 / length))
    assert path_around((1.0, 2.0), (1.0, 2.0), RADIUS) == (0.0, (0.0, 0.0))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_way_to_the_other_side_leads_around_the_disc_by_the_shorter_side(side):
    length, direction = path_around((-3.0, 0.0), (1.3, side * 0.1), RADIUS)
    tangent = math.asin(RADIUS / 3.0)
    assert direction == pytest.approx((math.cos(tangent), side * math.sin(tangent)))
    far = math.hypot(1.3, 0.1)
    arc = math.pi - math.atan2(0.1, 1.3) - math.acos(RADIUS / 3.0) - math.acos(RADIUS / far)
    straight = math.sqrt(9.0 - RADIUS**2) + math.sqrt(far**2 - RADIUS**2)
    assert length == pytest.approx(straight + RADIUS * arc)


def test_way_that_is_followed_stays_outside_of_the_disc_and_has_the_length_that_it_states():
    random = np.random.default_rng(3)
    for _ in range(100):
        start, goal = (
            random.uniform(RADIUS * 1.001, 4.0) * np.array([math.cos(a), math.sin(a)])
            for a in random.uniform(-math.pi, math.pi, 2)
        )
        stated, _ = path_around(tuple(start), tuple(goal), RADIUS)
        place, step, walked = start, 0.002, 0.0
        while np.hypot(*(goal - place)) > step:
            _, direction = path_around(tuple(place), tuple(goal), RADIUS)
            place = place + step * np.array(direction)
            walked += step
            assert np.hypot(*place) > RADIUS - 1e-3
            assert walked < 20.0
        assert walked == pytest.approx(stated, abs=0.02)


def test_way_from_inside_the_disc_begins_along_its_edge():
    _, direction = path_around((-1.0, 0.0), (1.3, 0.1), RADIUS)
    assert direction == pytest.approx((0.0, 1.0), abs=1e-12)
