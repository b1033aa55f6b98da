"""Tests of the paths of obstacles: positions, velocities and changes of the kind of motion."""

import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.planning.cases import CASES, TwoVelocityPath
from omniman_ros.viewer.obstacle_paths import (
    DEFAULT_SPEED,
    MAX_SPEED,
    MAX_WAYPOINTS,
    MIN_SPEED,
    AtEnd,
    PathKind,
    WaypointPath,
    converted,
    drawn_course,
    motion,
    moved,
    velocity,
)

SEEDS = range(10)
CORNER = ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0))


def any_path(seed, at_end):
    rng = np.random.default_rng(seed)
    points = tuple(map(tuple, rng.uniform(-3.0, 3.0, (rng.integers(2, 7), 2)).tolist()))
    return WaypointPath(points, float(rng.uniform(0.1, 2.0)), at_end)


@pytest.mark.parametrize(
    ("at_end", "places"),
    [
        (AtEnd.LOOP, {0: (0, 0), 1: (1, 0), 2.5: (2, 0.5), 3: (2, 1), 3 + math.sqrt(5): (0, 0)}),
        (AtEnd.BACK_AND_FORTH, {2.5: (2, 0.5), 3.5: (2, 0.5), 5: (1, 0), 6: (0, 0), 7: (1, 0)}),
        (AtEnd.ONCE, {2.5: (2, 0.5), 3: (2, 1), 1e6: (2, 1)}),
    ],
)
def test_way_points_are_passed_at_the_speed_in_their_order(at_end, places):
    for speed in (0.5, 1.0, 2.0):
        path = WaypointPath(CORNER, speed, at_end)
        for arc_length, position in places.items():
            assert path(arc_length / speed) == pytest.approx(position, abs=1e-9)


@pytest.mark.parametrize("at_end", AtEnd)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_velocity_is_the_derivative_of_the_position_and_has_the_speed(seed, at_end):
    path, step = any_path(seed, at_end), 1e-6
    for time in np.random.default_rng(seed).uniform(0.0, 60.0, 50):
        derivative = (path(time + step) - path(time)) / step
        vx, vy = path.velocity_at(time)
        assert (vx, vy) == pytest.approx(derivative, abs=1e-5)
        stands = at_end is AtEnd.ONCE and path(time) == pytest.approx(path.points[-1])
        assert math.hypot(vx, vy) == pytest.approx(0.0 if stands else path.speed)


@pytest.mark.parametrize(
    ("at_end", "at_last"), [(AtEnd.LOOP, (-1, -0.5)), (AtEnd.BACK_AND_FORTH, (0, -1))]
)
def test_the_velocity_at_a_corner_is_that_after_it(at_end, at_last):
    path = WaypointPath(CORNER, 1.0, at_end)
    assert path.velocity_at(0.0) == (1.0, 0.0) and path.velocity_at(2.0) == (0.0, 1.0)
    at_last /= np.hypot(*at_last)
    assert path.velocity_at(3.0) == pytest.approx(at_last)


@pytest.mark.parametrize("at_end", AtEnd)
def test_way_points_that_all_but_coincide_are_walked(at_end):
    path = WaypointPath(((0.0, 0.0), (1e-320, 0.0)), 1.0, at_end)
    for time in (0.0, 1e-321, 5.0):
        assert path(time) == pytest.approx([0.0, 0.0])
        assert math.hypot(*path.velocity_at(time)) <= 1.0 + 1e-9
    assert math.isfinite(path.time_nearest((3.0, 0.0)))


@pytest.mark.parametrize("at_end", AtEnd)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_position_never_jumps(seed, at_end):
    path = any_path(seed, at_end)
    places = np.array([path(time) for time in np.arange(0.0, 80.0, 0.01)])
    steps = np.hypot(*np.diff(places, axis=0).T)
    assert steps.max() <= 0.01 * path.speed + 1e-9


@pytest.mark.parametrize("at_end", AtEnd)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_nearest_time_of_a_position_on_the_path_leads_there(seed, at_end):
    path = any_path(seed, at_end)
    for time in np.random.default_rng(seed).uniform(0.0, 40.0, 20):
        position = path(time)
        nearest = path.time_nearest(tuple(position))
        assert nearest >= 0.0 and path(nearest) == pytest.approx(position, abs=1e-9)


def test_the_nearest_time_of_a_position_beside_the_path_leads_to_its_foot():
    path = WaypointPath(CORNER, 0.5, AtEnd.ONCE)
    assert path.time_nearest((0.6, -3.0)) == pytest.approx(1.2)
    assert path.time_nearest((9.0, 9.0)) == pytest.approx(6.0)
    assert path.time_nearest((-9.0, 0.0)) == 0.0


@pytest.mark.parametrize("at_end", AtEnd)
@pytest.mark.parametrize("count", [1, 2, 3])
def test_coinciding_way_points_are_stood_on(count, at_end):
    path = WaypointPath(((1.0, 2.0),) * count, 1.0, at_end)
    for time in (0.0, 5.0):
        assert path(time).tolist() == [1.0, 2.0] and path.velocity_at(time) == (0.0, 0.0)
    assert path.time_nearest((4.0, 4.0)) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("at_end", AtEnd)
def test_a_repeated_way_point_delays_nothing(at_end):
    repeated = WaypointPath((CORNER[0], CORNER[1], CORNER[1], CORNER[2], CORNER[2]), 1.0, at_end)
    path = WaypointPath(CORNER, 1.0, at_end)
    for time in np.arange(0.0, 12.0, 0.25):
        assert repeated(time) == pytest.approx(path(time))
        assert repeated.velocity_at(time) == pytest.approx(path.velocity_at(time))


@pytest.mark.parametrize(
    ("bad", "text"),
    [
        ({"points": ()}, "0 way points"),
        ({"points": ((0.0, 0.0),) * (MAX_WAYPOINTS + 1)}, str(MAX_WAYPOINTS)),
        ({"points": ((0.0, 0.0), (math.nan, 0.0))}, "way points"),
        ({"points": ((0.0, 2e6),)}, "way points"),
        ({"points": CORNER, "speed": 0.9 * MIN_SPEED}, "m/s"),
        ({"points": CORNER, "speed": 1.1 * MAX_SPEED}, "m/s"),
        ({"points": CORNER, "speed": math.nan}, "m/s"),
    ],
)
def test_implausible_way_points_are_refused(bad, text):
    with pytest.raises(InputError, match=text):
        WaypointPath(**bad)


def test_a_moved_path_keeps_its_shape():
    path = moved(WaypointPath(CORNER), (1.0, -1.0))
    assert path.points == ((1.0, -1.0), (3.0, -1.0), (3.0, 0.0))
    turn = TwoVelocityPath((0.0, 0.0), (1.0, 0.0), 2.0, (0.0, 1.0))
    assert moved(turn, (5.0, 5.0))(3.0) == pytest.approx(turn(3.0) + 5.0)


PATHS = {
    PathKind.STRAIGHT: TwoVelocityPath((1.0, 0.0), (0.3, 0.4)),
    PathKind.ONE_TURN: TwoVelocityPath((1.0, 0.0), (0.3, 0.4), 2.0, (-0.4, 0.3)),
    PathKind.WAYPOINTS: WaypointPath(((1.0, 0.0), (4.0, 4.0)), 0.5),
}


@pytest.mark.parametrize("wanted", PathKind)
@pytest.mark.parametrize("before", PathKind)
def test_a_path_becomes_one_of_the_wanted_kind_with_the_same_velocity(before, wanted):
    home = PATHS[before]
    assert motion(home) is before
    position = tuple(home(1.0).tolist())
    path = converted(home, position, velocity(home, 1.0), wanted)
    assert motion(path) is wanted
    if before is wanted:
        assert path is home
    elif wanted is PathKind.WAYPOINTS:
        assert path.points == (position,) and path.speed == pytest.approx(0.5)
    else:
        assert path.position == home.position
        assert velocity(path, 0.0) == pytest.approx((0.3, 0.4))
    if wanted is PathKind.ONE_TURN and before is not wanted:
        assert path.then == pytest.approx((-0.4, 0.3)), "to the left by 90 degrees"


def test_a_standing_obstacle_follows_way_points_at_the_default_speed():
    path = converted(TwoVelocityPath((1.0, 0.0)), (1.0, 0.0), (0.0, 0.0), PathKind.WAYPOINTS)
    assert path.speed == DEFAULT_SPEED


@pytest.mark.parametrize("speed", [0.01, 5.0])
def test_the_speed_on_way_points_is_kept_within_its_range(speed):
    home = TwoVelocityPath((1.0, 0.0), (speed, 0.0))
    path = converted(home, (1.0, 0.0), (speed, 0.0), PathKind.WAYPOINTS)
    assert path.speed == min(max(speed, MIN_SPEED), MAX_SPEED)


def test_the_obstacle_of_mpc_2021_that_changes_its_velocity_makes_one_turn():
    assert [motion(path) for path in CASES["moving"].paths].count(PathKind.ONE_TURN) == 1


def test_turns_and_way_points_are_drawn_and_straight_paths_are_not():
    assert drawn_course(PATHS[PathKind.STRAIGHT]).shape == (0, 2)
    turn = PATHS[PathKind.ONE_TURN]
    assert drawn_course(turn) == pytest.approx(np.array([turn(0.0), turn(2.0), turn(4.0)]))
    closed = np.array([*CORNER, CORNER[0]])
    assert drawn_course(WaypointPath(CORNER)) == pytest.approx(closed)
