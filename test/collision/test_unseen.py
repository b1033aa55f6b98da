"""The limit before people who step out, against stops that are followed in small steps."""

import math

import numpy as np
import pytest

from omniman_ros.collision.curve import curve_poses
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.collision.unseen import Arrivals, unseen_limit
from omniman_ros.core.errors import InputError

BODY = Rectangles.centred(np.array([0.5, 0.35]))
CELL, RADIUS, SPEED, REACTION = 0.1, 0.2, 1.2, 0.1
ORIGIN = np.array([-4.0, -4.0])
INDEX = np.arange(80)
X, Y = np.meshgrid(*(ORIGIN[k] + CELL * (INDEX + 0.5) for k in (0, 1)))


def arrivals_of(people):
    """Return when people at places (M, 2) can be in the cells of an empty floor."""
    people = np.array(people, dtype=float).reshape(-1, 2, 1, 1)
    apart = np.hypot(people[:, 0] - X, people[:, 1] - Y)
    return Arrivals(apart.min(axis=0) / SPEED, CELL, ORIGIN)


def limit(arrivals, twist, stop_time=1.0):
    courses = [(np.array(twist), stop_time)]
    return unseen_limit(arrivals, BODY, np.zeros(3), courses, RADIUS, REACTION)


def comes_to_somebody(arrivals, twist, fraction, stop_time=1.0):
    """Follow a stop: does the robot come to a place where somebody can be already?"""
    touched = BODY.distances(np.stack((X, Y), axis=-1)) <= RADIUS
    pose, end = np.zeros(3), REACTION + fraction * stop_time
    step = 0.004
    for t in np.arange(0.0, end, step):
        speed = fraction - max(t - REACTION, 0.0) / stop_time
        pose = curve_poses(pose, speed * np.array(twist), np.array([step]))[0]
        c, s = math.cos(pose[2]), math.sin(pose[2])
        dx, dy = X - pose[0], Y - pose[1]
        near = BODY.distances(np.stack((c * dx + s * dy, c * dy - s * dx), axis=-1)) <= RADIUS
        if (near & ~touched & (arrivals.times < t)).any():
            return True
        touched |= near
    return False


@pytest.mark.parametrize("seed", range(6))
def test_the_robot_stops_before_anybody_and_is_not_much_slower_than_it_must_be(seed):
    rng = np.random.default_rng(seed)
    angle, distance = rng.uniform(-math.pi, math.pi), rng.uniform(0.9, 2.5)
    arrivals = arrivals_of([distance * math.cos(angle), distance * math.sin(angle)])
    twist = (*rng.uniform(-1.0, 1.0, 2), rng.uniform(-1.0, 1.0))
    found = limit(arrivals, twist)
    assert not comes_to_somebody(arrivals, twist, found.fraction)
    if found.position is not None:
        faster = (min(found.fraction + more, 1.0) for more in (0.05, 0.1, 0.2))
        assert any(comes_to_somebody(arrivals, twist, fraction) for fraction in faster)


def test_who_is_farther_away_leaves_more_speed():
    fractions = [
        limit(arrivals_of([x, 0.0]), (1.0, 0.0, 0.0)).fraction for x in (0.8, 1.2, 1.8, 3.5)
    ]
    assert fractions == sorted(fractions)
    assert fractions[0] < 0.2
    assert fractions[-1] == 1.0


def test_who_is_behind_or_beside_the_robot_limits_motions_towards_them_only():
    behind = arrivals_of([-0.75, 0.0])
    assert limit(behind, (1.0, 0.0, 0.0)).fraction == 1.0
    found = limit(behind, (-1.0, 0.0, 0.0))
    assert found.fraction < 0.2
    assert found.position[0] < -0.6
    beside = arrivals_of([-0.2, 0.6])
    assert limit(beside, (1.0, 0.0, 0.0)).fraction == 1.0
    assert limit(beside, (0.0, 1.0, 0.0)).fraction < 0.3
    assert limit(beside, (0.0, 0.0, 1.0)).fraction < 0.6


def test_a_robot_at_rest_and_an_empty_floor_have_no_limit():
    assert (
        unseen_limit(arrivals_of([1.0, 0.0]), BODY, np.zeros(3), [], RADIUS, 0.1).fraction == 1.0
    )
    nobody = Arrivals(np.full((80, 80), np.inf), CELL, ORIGIN)
    assert limit(nobody, (1.0, 0.0, 0.0)).fraction == 1.0


def test_times_run_on_while_nothing_is_heard():
    arrivals = arrivals_of([2.0, 0.0])
    later = arrivals.after(0.5)
    assert later.times.min() == 0.0
    ahead = (1.0, 0.0, 0.0)
    assert limit(later, ahead).fraction < limit(arrivals, ahead).fraction


@pytest.mark.parametrize(
    ("times", "resolution"),
    [([[-1.0]], 0.1), ([[math.nan]], 0.1), ([1.0], 0.1), ([[1.0]], 0.0), ([[1.0]], math.nan)],
)
def test_impossible_arrivals_are_refused(times, resolution):
    with pytest.raises(InputError):
        Arrivals(np.array(times), resolution, np.zeros(2))
