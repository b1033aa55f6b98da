import math

import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.planning.obstacles.environment import Environment
from omniman_ros.planning.obstacles.walls import Walls
from omniman_ros.planning.route.route import Route
from omniman_ros.planning.route.sight import DETOUR, SIGHT_GAP, SIGHT_STEP, is_seen, seen_until
from test.planning.support import ellipses

HALF = np.array([0.4, 0.25])
ROUND = Route(
    np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [2.0, 1.0, 0.0], [2.0, 0.0, 0.0]]), (1.0, 1.0)
)  #: around what stands at (1, 0) m


def around(*discs, walls=None):
    """Return an environment of discs (x, y, radius)."""
    everywhere = (-100.0, -100.0, 100.0, 100.0)
    known = ellipses(*discs)
    footprint = Footprint(Rectangles.centred(HALF))
    return Environment(footprint, known, everywhere, None, walls or Walls.none())


def wall(x, first, last):
    """Return a wall of cells across the way at x."""
    y = np.arange(first, last + 1e-9, 0.05)
    return Walls(np.column_stack([np.full(len(y), x), y]), 0.035)


def test_nothing_is_hidden_on_open_floor():
    assert seen_until(ROUND, 0.0, np.zeros(2), around()) == math.inf


@pytest.mark.parametrize("kind", ["walls", "discs"])
def test_a_route_is_seen_up_to_where_it_goes_behind_an_obstacle(kind):
    between = around(walls=wall(1.0, -2.0, 0.5))
    if kind == "discs":
        between = around(*[(1.0, y, 0.035) for y in np.arange(-2.0, 0.51, 0.05)])
    until = seen_until(ROUND, 0.0, np.zeros(2), between)
    # The tangent from the origin to a disc of the robot's size around the wall's end.
    keep = 0.035 + HALF.min() + SIGHT_GAP
    angle = math.atan2(0.5, 1.0) + math.asin(keep / math.hypot(0.5, 1.0))
    assert until == pytest.approx(1.0 + 1.0 / math.tan(angle), abs=SIGHT_STEP)
    at_corner = ROUND.at(np.array([until]))[0, :2]
    assert is_seen(np.zeros(2), at_corner, between)
    assert not is_seen(np.zeros(2), np.array([2.0, 0.0]), between)


def test_a_place_behind_a_post_that_the_route_hardly_bends_around_is_not_cut_off():
    bent = Route(np.array([[0.0, 0.0, 0.0], [1.0, 0.3, 0.0], [2.0, 0.0, 0.0]]), (1.0, 1.0))
    assert bent.length < 2.0 + DETOUR
    post = around((1.0, -0.1, 0.1))
    assert not is_seen(np.zeros(2), np.array([2.0, 0.0]), post)
    assert seen_until(bent, 0.0, np.zeros(2), post) == math.inf


def test_what_the_robot_touches_already_hides_nothing_that_leads_away_from_it():
    touching = around((-0.26, 0.0, 0.02))
    assert is_seen(np.zeros(2), np.array([1.0, 0.0]), touching)
    assert not is_seen(np.zeros(2), np.array([-1.0, 0.0]), touching)


def test_a_robot_at_the_end_of_its_route_sees_it():
    assert seen_until(ROUND, ROUND.duration, np.array([2.0, 0.0]), around((2.0, 0.5, 0.1))) == (
        math.inf
    )
