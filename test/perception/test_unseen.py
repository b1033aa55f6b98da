"""Where somebody may be whom no scanner sees, against the geometry of rooms."""

import math

import numpy as np
import pytest

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.parameters import build
from omniman_ros.perception.parameters import UnseenParameters
from omniman_ros.perception.unseen import HORIZON, RESOLUTION, UnseenSpace
from test.perception.test_local_map import ANGLES, room_ranges, view_of

SPEED = 1.2
BODY = Rectangles.centred(np.array([0.3, 0.2]))
ORIGIN = (0.0, 0.0, 0.0)


def look(space, ranges, time, standing=None):
    """Enter a scan from the middle, of which all that stands is known, or what is given."""
    view, met = view_of(ranges)
    space.update(time, view, 20.0, met, met if standing is None else standing, (ORIGIN, BODY))


def space_after(*scans):
    space = UnseenSpace(build(UnseenParameters, {"speed": SPEED}), 8.0)
    for k, ranges in enumerate(scans):
        look(space, ranges, 0.1 * k)
    return space


def at(space, cells, x, y):
    column, row = np.floor((np.array([x, y]) - space.origin) / RESOLUTION).astype(int)
    return cells[row, column]


def with_screen(distance, half_angle):
    """A room of 6 x 6 m with a round screen ahead."""
    return np.where(np.abs(ANGLES) < half_angle, distance, room_ranges(3.0))


def test_in_a_room_without_corners_nobody_is_hidden_and_outside_somebody_may_be():
    space = space_after(room_ranges(2.5))
    for x in np.arange(-2.2, 2.21, 0.2):
        for y in np.arange(-2.2, 2.21, 0.2):
            assert not at(space, space.hidden, x, y)
    assert at(space, space.hidden, 3.2, 0.0)
    times = space.arrivals()
    assert np.isinf(at(space, times, 1.5, 0.0)), "nobody comes through a wall"
    assert np.isnan(at(space, times, 2.5, 0.0)), "nobody is in it"


def test_somebody_may_be_behind_a_screen_and_walks_around_it_but_not_behind_a_post():
    space = space_after(with_screen(1.0, 0.5))
    times = space.arrivals()
    assert at(space, space.hidden, 2.0, 0.0)
    before, aside = at(space, times, 0.55, 0.0), at(space, times, 1.6, 1.5)
    assert 0.0 < aside < before, "the way before the screen leads around its end"
    assert 0.5 / SPEED < before < HORIZON
    post = space_after(with_screen(1.0, 0.05))
    assert not at(post, post.hidden, 1.6, 0.0), "too narrow to hide anybody"


def test_what_is_not_seen_any_more_fills_at_the_speed_of_people():
    ahead_only = np.where(np.abs(ANGLES) < 0.5 * math.pi, room_ranges(3.0), math.nan)
    # A room without a wall behind: from there somebody may come.
    open_room = np.where(np.abs(ANGLES) > 0.75 * math.pi, math.inf, room_ranges(3.0))
    space = space_after(open_room)
    assert not at(space, space.hidden, -2.5, 0.0)
    edges = []
    for k in range(1, 26):
        look(space, ahead_only, 0.1 * k, view_of(room_ranges(3.0))[1][np.abs(ANGLES) < 2.3])
        row = space.hidden[round(-space.origin[1] / RESOLUTION)]
        x = space.origin[0] + RESOLUTION * (np.flatnonzero(row) + 0.5)
        edges.append(x[x < 0.0].max())
    gone = np.diff(edges)
    assert gone.min() >= 0.0
    assert edges[20] - edges[5] == pytest.approx(1.5 * SPEED, abs=0.11)
    assert edges[-1] < -0.45, "not where the robot is"
    times = space.arrivals()
    assert at(space, times, 0.5, 0.0) < HORIZON
    assert not at(space, space.hidden, 0.6, 0.0)


def test_it_follows_the_robot_and_forgets_when_it_is_cleared():
    space = space_after(room_ranges(2.5))
    view, met = view_of(room_ranges(2.5))
    moved = (0.8, 0.0, 0.0)
    space.update(0.1, view, 20.0, met, met, (moved, BODY))
    assert space.origin[0] == pytest.approx(-3.2, abs=0.11)
    assert not at(space, space.hidden, 1.5, 0.0)
    space.clear()
    assert space.hidden.all()
