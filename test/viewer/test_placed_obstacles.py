"""Tests of the properties of obstacles placed on a page."""

import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.planning.cases import CASES, TwoVelocityPath
from omniman_ros.viewer.obstacle_paths import (
    MAX_WAYPOINTS,
    AtEnd,
    PathKind,
    WaypointPath,
    motion,
)
from omniman_ros.viewer.placed_obstacles import (
    MAX_OBSTACLES,
    MAX_SEMI_AXIS,
    MAX_VELOCITY,
    MIN_SEMI_AXIS,
    PlacedObstacles,
)

SEEDS = range(20)
NAN = math.nan


def any_path(rng):
    return TwoVelocityPath(tuple(rng.uniform(-5.0, 5.0, 2)), tuple(rng.uniform(-1.0, 1.0, 2)))


def moving_obstacles(rng, now=0.0):
    """Return a few moving obstacles."""
    obstacles = PlacedObstacles()
    for _ in range(rng.integers(1, 8)):
        obstacles.add(any_path(rng), now, tuple(rng.uniform(0.1, 1.0, 2)), rng.uniform(-3.0, 3.0))
    return obstacles


def are_equal(first, second):
    return all(
        np.allclose(getattr(first, name), getattr(second, name), atol=1e-9)
        for name in ("numbers", "centers", "semi_axes", "angles")
    )


def test_there_are_no_obstacles_initially():
    obstacles = PlacedObstacles()
    arrays = obstacles.arrays(10.0)
    assert len(obstacles) == 0 and not obstacles.paused
    assert arrays.centers.shape == arrays.velocities.shape == arrays.semi_axes.shape == (0, 2)
    assert arrays.numbers.shape == arrays.angles.shape == (0,)


@pytest.mark.parametrize("seed", SEEDS)
def test_obstacles_move_at_their_velocities(seed):
    rng = np.random.default_rng(seed)
    obstacles = moving_obstacles(rng, 10.0)
    before, after = obstacles.arrays(10.0), obstacles.arrays(12.5)
    assert after.centers == pytest.approx(before.centers + 2.5 * before.velocities)
    assert np.abs(before.velocities).max() > 0.0


@pytest.mark.parametrize("seed", SEEDS)
def test_a_pause_does_not_count_as_time(seed):
    """However often they are paused and resumed, the obstacles move only in between."""
    rng = np.random.default_rng(seed)
    paused, free = (
        moving_obstacles(np.random.default_rng(seed), 0.0),
        moving_obstacles(np.random.default_rng(seed), 0.0),
    )
    now = gone = 0.0
    for _ in range(5):
        step, rest = rng.uniform(0.0, 3.0, 2)
        now, gone = now + step, gone + step
        paused.pause(now)
        paused.pause(now + 0.3 * rest)  # a repeated pause has no effect
        arrays = paused.arrays(now + rest)
        assert are_equal(arrays, free.arrays(gone)) and not arrays.velocities.any()
        now += rest
        paused.resume(now)
        paused.resume(now + 0.1)
        assert are_equal(paused.arrays(now + 0.1), free.arrays(gone + 0.1))


@pytest.mark.parametrize("paused", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_restart_brings_all_obstacles_to_their_homes(seed, paused):
    rng = np.random.default_rng(seed)
    obstacles = moving_obstacles(rng, 0.0)
    begin = obstacles.arrays(0.0)
    if paused:
        obstacles.pause(3.0)
    obstacles.restart(5.0)
    assert obstacles.paused == paused
    assert are_equal(obstacles.arrays(5.0), begin)
    assert paused == are_equal(obstacles.arrays(6.0), begin), "they resume, unless they are paused"
    obstacles.resume(7.0)
    ahead = obstacles.arrays(8.0).centers - obstacles.arrays(7.0).centers
    assert ahead == pytest.approx(begin.velocities)


@pytest.mark.parametrize("paused", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_moved_obstacle_has_a_new_home(seed, paused):
    rng = np.random.default_rng(seed)
    obstacles = moving_obstacles(rng, 0.0)
    velocities = obstacles.arrays(0.0).velocities
    if paused:
        obstacles.pause(1.0)
    obstacles.move(0, (3.0, -2.0), 2.0)
    assert obstacles.arrays(2.0).centers[0] == pytest.approx([3.0, -2.0])
    obstacles.resume(2.0)
    assert obstacles.arrays(3.0).centers[0] == pytest.approx([3.0, -2.0] + velocities[0])
    obstacles.restart(4.0)
    assert obstacles.arrays(4.0).centers[0] == pytest.approx([3.0, -2.0])


@pytest.mark.parametrize("seed", SEEDS)
def test_a_new_velocity_applies_now_and_after_a_restart(seed):
    obstacles = moving_obstacles(np.random.default_rng(seed), 0.0)
    home, there = obstacles.arrays(0.0).centers[0], obstacles.arrays(2.0).centers[0]
    obstacles.set_velocity(0, (0.3, -0.2), 2.0)
    assert obstacles.arrays(2.0).centers[0] == pytest.approx(there)
    assert obstacles.arrays(3.0).centers[0] == pytest.approx(there + [0.3, -0.2])
    obstacles.restart(5.0)
    assert obstacles.arrays(6.0).centers[0] == pytest.approx(home + [0.3, -0.2])


def test_a_velocity_set_during_a_pause_applies_after_it():
    obstacles = PlacedObstacles()
    obstacles.pause(0.0)
    obstacles.add(TwoVelocityPath((1.0, 1.0)), 0.0)
    obstacles.set_velocity(0, (0.5, 0.0), 1.0)
    assert obstacles.arrays(5.0).centers.tolist() == [[1.0, 1.0]]
    obstacles.resume(5.0)
    assert obstacles.arrays(7.0).centers.tolist() == [[2.0, 1.0]]


@pytest.mark.parametrize("paused", [False, True])
def test_the_resumed_velocity_applies_after_the_pause(paused):
    obstacles = moving_obstacles(np.random.default_rng(3), 0.0)
    if paused:
        obstacles.pause(1.0)
    resumed_velocities = obstacles.arrays(2.0).resumed_velocities
    obstacles.resume(2.0)
    ahead = obstacles.arrays(3.0).centers - obstacles.arrays(2.0).centers
    assert ahead == pytest.approx(resumed_velocities) and np.abs(resumed_velocities).max() > 0.0


def test_a_size_is_kept_through_a_restart_and_a_drag():
    obstacles = moving_obstacles(np.random.default_rng(0), 0.0)
    obstacles.resize(0, (0.7, 0.1), 1.5)
    obstacles.move(0, (0.0, 0.0), 1.0)
    obstacles.restart(2.0)
    arrays = obstacles.arrays(2.0)
    assert arrays.semi_axes[0].tolist() == [0.7, 0.1] and arrays.angles[0] == 1.5


def test_numbers_are_never_reused():
    """Another node would take the new obstacle for the old one, which has jumped."""
    obstacles = PlacedObstacles()
    numbers = []
    for k in range(10):
        numbers.append(obstacles.add(TwoVelocityPath((float(k), 0.0)), 0.0))
        if k % 2:
            obstacles.delete(numbers[-1])
        if k == 6:
            obstacles.delete(None)
    assert len(set(numbers)) == 10
    assert obstacles.arrays(0.0).numbers.tolist() == [8]
    assert 8 in obstacles and 9 not in obstacles


def test_a_change_of_velocity_follows_the_obstacles_own_time():
    obstacles = PlacedObstacles()
    obstacles.pause(0.0)
    obstacles.add(CASES["moving"].paths[2], 0.0)
    obstacles.resume(100.0)
    assert obstacles.arrays(104.4).velocities[0] == pytest.approx([0.0, -0.15])
    assert obstacles.arrays(104.6).velocities[0] == pytest.approx([0.0, -0.9])


WALK = WaypointPath(((0.0, 0.0), (2.0, 0.0), (2.0, 2.0)), 0.5, AtEnd.BACK_AND_FORTH)
TURN = TwoVelocityPath((1.0, 1.0), (0.5, 0.0), 2.0, (0.0, -0.5))


def test_a_pause_does_not_count_as_time_on_way_points():
    obstacles = PlacedObstacles()
    obstacles.add(WALK, 0.0)
    obstacles.pause(3.0)
    arrays = obstacles.arrays(50.0)
    assert arrays.centers.tolist() == [[1.5, 0.0]] and not arrays.velocities.any()
    assert arrays.resumed_velocities.tolist() == [[0.5, 0.0]]
    obstacles.resume(50.0)
    assert obstacles.arrays(52.0).centers == pytest.approx(np.array([[2.0, 0.5]]))
    assert obstacles.arrays(52.0).velocities == pytest.approx(np.array([[0.0, 0.5]]))


@pytest.mark.parametrize("path", [WALK, TURN], ids=["way points", "turn"])
def test_a_restart_begins_a_path_anew(path):
    obstacles = PlacedObstacles()
    obstacles.add(path, 0.0)
    obstacles.restart(7.0)
    for time in (0.0, 1.0, 3.0, 9.0):
        assert obstacles.arrays(7.0 + time).centers[0] == pytest.approx(path(time))


@pytest.mark.parametrize("path", [WALK, TURN], ids=["way points", "turn"])
def test_a_dragged_obstacle_begins_its_path_where_it_is_dropped(path):
    obstacles = PlacedObstacles()
    obstacles.add(path, 0.0)
    obstacles.move(0, (5.0, -3.0), 6.0)
    shift = np.array([5.0, -3.0]) - path(0.0)
    for time in (0.0, 1.0, 3.0, 9.0):
        assert obstacles.arrays(6.0 + time).centers[0] == pytest.approx(path(time) + shift)


def test_a_turn_counts_from_its_change_and_begins_where_the_obstacle_is():
    obstacles = PlacedObstacles()
    obstacles.add(TwoVelocityPath((1.0, 1.0), (0.5, 0.0)), 0.0)
    obstacles.set_path(0, TURN, 10.0)
    assert obstacles.arrays(12.0).centers[0] == pytest.approx([7.0, 1.0])
    assert obstacles.arrays(14.0).centers[0] == pytest.approx([7.0, 0.0])
    obstacles.restart(20.0)
    assert obstacles.arrays(24.0).centers[0] == pytest.approx([2.0, 0.0])


def test_an_obstacle_goes_on_where_it_is_when_its_way_points_or_speed_change():
    obstacles = PlacedObstacles()
    obstacles.add(replace(WALK, at_end=AtEnd.ONCE), 0.0)
    before = obstacles.arrays(5.0).centers
    obstacles.add_waypoint(0, (0.0, 5.0), 5.0)
    assert obstacles.arrays(5.0).centers == pytest.approx(before)
    obstacles.set_path(0, replace(obstacles[0].home, speed=2.0), 5.0)
    assert obstacles.arrays(5.0).centers == pytest.approx(before)
    assert obstacles.arrays(5.5).centers == pytest.approx(before + [0.0, 1.0])
    assert obstacles.arrays(60.0).centers == pytest.approx(np.array([[0.0, 5.0]]))


def test_an_obstacle_that_has_arrived_goes_on_to_a_new_way_point():
    obstacles = PlacedObstacles()
    obstacles.add(replace(WALK, at_end=AtEnd.ONCE), 0.0)
    obstacles.add_waypoint(0, (4.0, 2.0), 100.0)
    assert obstacles.arrays(102.0).centers == pytest.approx(np.array([[3.0, 2.0]]))


@pytest.mark.parametrize("kind", PathKind)
@pytest.mark.parametrize("path", [WALK, TURN], ids=["way points", "turn"])
def test_another_kind_of_motion_does_not_move_the_obstacle(path, kind):
    obstacles = PlacedObstacles()
    obstacles.add(path, 0.0)
    before = obstacles.arrays(1.5).centers
    obstacles.set_motion(0, kind, 1.5)
    assert obstacles.arrays(1.5).centers == pytest.approx(before)
    assert motion(obstacles[0].home) is kind


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c.set_velocity(0, (0.1, 0.0), 0.0),
        lambda c: c.add_waypoint(0, (NAN, 0.0), 0.0),
        lambda c: c.add_waypoint(0, (0.0, 2e6), 0.0),
        lambda c: c.add_waypoint(1, (0.0, 0.0), 0.0),
        lambda c: c.add_waypoint(9, (0.0, 0.0), 0.0),
        lambda c: c.set_path(9, WALK, 0.0),
        lambda c: c.set_motion(9, PathKind.STRAIGHT, 0.0),
        lambda c: c.set_path(0, replace(TURN, time=-0.1), 0.0),
        lambda c: c.set_path(0, replace(TURN, time=NAN), 0.0),
        lambda c: c.set_path(0, replace(TURN, then=(4.0, 0.0)), 0.0),
    ],
)
def test_an_invalid_change_of_a_path_is_refused_and_has_no_effect(change):
    obstacles = PlacedObstacles()
    obstacles.add(WALK, 0.0)
    obstacles.add(TURN, 0.0)
    with pytest.raises(InputError):
        change(obstacles)
    assert (obstacles[0].path, obstacles[1].path) == (WALK, TURN)


def test_the_number_of_way_points_is_limited():
    obstacles = PlacedObstacles()
    obstacles.add(WaypointPath(((0.0, 0.0),) * MAX_WAYPOINTS), 0.0)
    with pytest.raises(InputError, match=str(MAX_WAYPOINTS)):
        obstacles.add_waypoint(0, (1.0, 0.0), 0.0)


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c.move(0, (NAN, 0.0), 0.0),
        lambda c: c.move(0, (0.0, 2e6), 0.0),
        lambda c: c.move(9, (0.0, 0.0), 0.0),
        lambda c: c.set_velocity(0, (NAN, 0.0), 0.0),
        lambda c: c.set_velocity(0, (0.0, -1.01 * MAX_VELOCITY), 0.0),
        lambda c: c.set_velocity(9, (0.0, 0.0), 0.0),
        lambda c: c.resize(0, (0.99 * MIN_SEMI_AXIS, 1.0), 0.0),
        lambda c: c.resize(9, (1.0, 1.0), 0.0),
        lambda c: c.resize(0, (1.0, 1.01 * MAX_SEMI_AXIS), 0.0),
        lambda c: c.resize(0, (1.0, NAN), 0.0),
        lambda c: c.resize(0, (1.0, 1.0), math.inf),
        lambda c: c[9],
        lambda c: c.add(TwoVelocityPath((0.0, 0.0), (4.0, 0.0)), 0.0),
        lambda c: c.add(TwoVelocityPath((0.0, 0.0), (0.0, 0.0), 1.0, (NAN, 0.0)), 0.0),
    ],
)
def test_an_invalid_change_is_refused_and_has_no_effect(change):
    obstacles = PlacedObstacles()
    obstacles.add(TwoVelocityPath((1.0, 2.0), (0.1, 0.0)), 0.0)
    with pytest.raises(InputError):
        change(obstacles)
    arrays = obstacles.arrays(0.0)
    assert arrays.centers.tolist() == [[1.0, 2.0]] and arrays.velocities.tolist() == [[0.1, 0.0]]


def test_the_bounds_themselves_are_accepted():
    obstacles = PlacedObstacles()
    obstacles.add(TwoVelocityPath((1.0, 2.0)), 0.0)
    obstacles.resize(0, (MIN_SEMI_AXIS, MAX_SEMI_AXIS), 0.0)
    obstacles.set_velocity(0, (MAX_VELOCITY, -MAX_VELOCITY), 0.0)
    assert obstacles.arrays(1.0).centers.tolist() == [[1.0 + MAX_VELOCITY, 2.0 - MAX_VELOCITY]]


def test_the_number_of_obstacles_is_limited():
    obstacles = PlacedObstacles()
    for _ in range(MAX_OBSTACLES):
        obstacles.add(TwoVelocityPath((0.0, 0.0)), 0.0)
    with pytest.raises(InputError, match=str(MAX_OBSTACLES)):
        obstacles.add(TwoVelocityPath((0.0, 0.0)), 0.0)
    obstacles.delete(0)
    assert obstacles.add(TwoVelocityPath((0.0, 0.0)), 0.0) == MAX_OBSTACLES
