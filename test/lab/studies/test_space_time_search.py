import math
from dataclasses import astuple

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.lab.studies.scene_gaps import ellipse_gap, wall_gap
from omniman_ros.lab.studies.scene_geometry import Box, Ellipse, PolylineMotion, Wall, World
from omniman_ros.lab.studies.scene_judge import judge
from omniman_ros.lab.studies.space_time_grid import FINE_GRIDS, GRIDS, Grid, Mover
from omniman_ros.lab.studies.space_time_nodes import SearchNodes
from omniman_ros.lab.studies.space_time_reach import ReachSearch
from omniman_ros.lab.studies.space_time_search import find_avoiding_path, find_escape, find_path
from test.tiers import representative

MOVER = Mover(Box(0.8, 0.5), speed=1.0, yaw_rate=2.0)
AREA = (0.0, 0.0, 8.0, 6.0)
COARSE = GRIDS[:1]
EAST, WEST = (6.5, 3.0, 0.0), (1.5, 3.0, 0.0)


def disc(radius, x, y, velocity=(0.0, 0.0)):
    return Ellipse((radius, radius), PolylineMotion.straight((x, y), velocity))


def wall_with_door(angle, width, thickness=0.1, center=(4.0, 3.0)):
    """Return a wall with a door across the direction of an angle."""
    c, s = math.cos(angle), math.sin(angle)
    half = 0.5 * width + 5.0
    return tuple(
        Wall(center[0] - s * d, center[1] + c * d, angle, thickness, 10.0) for d in (half, -half)
    )


def wall_of_discs(angle, width, radius=0.3, center=(4.0, 3.0)):
    c, s = math.cos(angle), math.sin(angle)
    away = [0.5 * width + radius + k * 1.8 * radius for k in range(9)]
    return tuple(disc(radius, center[0] - s * d, center[1] + c * d) for a in away for d in (a, -a))


def across(angle, headings=(0.4, -2.0), center=(4.0, 3.0)):
    """Return start and goal on opposite sides of the centre."""
    x, y = 1.8 * math.cos(angle), 1.8 * math.sin(angle)
    return (
        (center[0] - x, center[1] - y, headings[0]),
        (center[0] + x, center[1] + y, headings[1]),
    )


def check(way, world, start, goal=None, mover=MOVER):
    """Assert that a path is contact-free, within area and speeds, from start to goal."""
    assert way is not None
    verdict = judge(way.times, way.poses, mover.box, world)
    assert not verdict.collided
    assert verdict.outside <= 0.0
    speed, yaw_rate = way.speeds
    assert speed <= mover.speed + 1e-9
    assert yaw_rate <= mover.yaw_rate + 1e-9
    assert way.poses[0] == pytest.approx(start)
    if goal is not None:
        assert way.poses[-1, :2] == pytest.approx(goal[:2])
        assert math.remainder(way.poses[-1, 2] - goal[2], math.tau) == pytest.approx(0, abs=1e-9)
    return verdict


# ---- paths found --------------------------------------------------------------------------------


def test_path_through_empty_space_is_nearly_the_fastest():
    start, goal = (1.0, 1.0, 0.3), (6.0, 4.0, 1.5)
    way = find_path(MOVER, World(area=AREA), start, goal, 10.0, 40.0)
    check(way, World(area=AREA), start, goal)
    least = math.dist(start[:2], goal[:2])
    assert way.times[0] == 10.0
    assert least <= way.times[-1] - 10.0 <= least / 0.89 + 0.3


def test_turn_takes_the_time_given_by_the_yaw_rate():
    start, goal = (4.0, 3.0, 0.0), (4.0, 3.0, 3.0)
    way = find_path(MOVER, World(), start, goal, 0.0, 9.0)
    check(way, World(), start, goal)
    assert 3.0 / 2.0 <= way.times[-1] < 1.1 * 3.0 / 2.0 + 0.2
    assert find_path(MOVER, World(), start, goal, 0.0, 1.4) is None


def test_goal_across_the_half_turn_is_reached_the_short_way():
    start, goal = (4.0, 3.0, 3.0), (4.0, 3.0, -3.0)
    way = find_path(MOVER, World(), start, goal, 0.0, 5.0)
    check(way, World(), start, goal)
    assert way.times[-1] < 0.4


def test_path_exists_when_the_robot_is_at_the_goal():
    way = find_path(MOVER, World(), (1, 2, 0.5), (1, 2, 0.5), 0.0, 1.0)
    assert way.poses == pytest.approx(np.array([(1, 2, 0.5)]))


@pytest.mark.parametrize("degrees", representative([0, 17, 45, 76, 100, 163], every=3))
@pytest.mark.parametrize("make", [wall_with_door, wall_of_discs])
def test_door_of_60_cm_is_passed_at_any_angle(degrees, make):
    angle = math.radians(degrees)
    bodies = make(angle, 0.6, center=(4.03, 2.98))
    world = World(area=AREA, **{"walls" if make is wall_with_door else "obstacles": bodies})
    start, goal = across(angle)
    verdict = check(find_path(MOVER, world, start, goal, 0.0, 20.0), world, start, goal)
    assert verdict.gap < 0.05


@pytest.mark.parametrize("degrees", [0, 33])
@pytest.mark.parametrize("make", [wall_with_door, wall_of_discs])
def test_door_narrower_than_the_robot_is_not_passed(degrees, make):
    angle = math.radians(degrees)
    world = World(
        area=AREA, **{"walls" if make is wall_with_door else "obstacles": make(angle, 0.48)}
    )
    assert find_path(MOVER, world, *across(angle), 0.0, 20.0) is None


def test_wall_without_a_door_is_not_passed():
    assert find_path(MOVER, World((), wall_with_door(0.3, 0.0), AREA), *across(0.3), 0, 20) is None


def test_way_around_is_found_where_the_door_is_too_narrow():
    walls = (Wall(4.0, 1.9, 0.0, 0.1, 1.72), Wall(4.0, 3.7, 0.0, 0.1, 0.9))
    world = World((), walls, AREA)
    way = find_path(MOVER, world, WEST, EAST, 0.0, 20.0)
    check(way, world, WEST, EAST)
    at_wall = np.interp(4.0, way.poses[:, 0], way.poses[:, 1])
    assert at_wall > 4.3


@pytest.mark.exhaustive
def test_fine_grid_finds_paths_with_2_cm_to_spare():
    world = World((), wall_with_door(0.5, 0.55), (1.8, 1.4, 6.2, 4.6))
    # Half the spacing of two headings: no node is aligned with the door.
    start, goal = across(0.5, headings=(0.5245, 0.5245))
    assert find_path(MOVER, world, start, goal, 0.0, 6.0) is None
    check(find_path(MOVER, world, start, goal, 0.0, 6.0, FINE_GRIDS), world, start, goal)


@pytest.mark.exhaustive
def test_spare_gap_suffices_for_a_straight_drive():
    # The bodies are beside the straight line from start to goal at this gap.
    found = 0
    for seed in range(16):
        random = np.random.default_rng(seed)
        angle = random.uniform(-math.pi, math.pi)
        start, goal = across(angle, headings=(angle, angle))
        bodies = []
        for _ in range(4):
            axes = tuple(random.uniform(0.1, 0.5, 2).tolist())
            place = random.uniform((2, 1), (6, 5)).tolist()
            bodies.append(Ellipse(axes, PolylineMotion.still(*place), random.uniform(-3, 3)))
        bodies += [Wall(*random.uniform((2, 1, -3), (6, 5, 3)), *random.uniform(0.05, 0.6, 2))]
        world = World(tuple(bodies[:-1]), tuple(bodies[-1:]), (1, 0, 7, 6))
        drive = np.array([start, goal])
        gap = judge(np.array([0.0, 9.0]), drive, MOVER.box, world).gap
        grid = GRIDS[1]
        kept = max(
            grid.wall_margin(MOVER, turning=False),
            *(grid.ellipse_margin(MOVER, b.semi_axes, 0.0) for b in bodies[:-1]),
        )
        if gap >= grid.sufficient_gap(MOVER, kept):
            way = find_path(MOVER, world, start, goal, 0.0, 3.6 / 0.89 + 1.0, (grid,))
            check(way, world, start, goal)
            found += 1
    assert found >= 3


# ---- moving obstacles ---------------------------------------------------------------------------


def closing(at):
    """Return a disc that passes through the wall and stands in the door from a time on."""
    route = PolylineMotion((at - 1.0, at), ((4.0, 4.5), (4.0, 3.0)))
    return World((Ellipse((0.3, 0.3), route),), wall_with_door(0.0, 0.7), AREA)


def test_door_that_closes_is_passed_before():
    world = closing(4.5)
    way = find_path(MOVER, world, WEST, EAST, 0.0, 20.0)
    check(way, world, WEST, EAST)
    assert np.interp(4.0, way.poses[:, 0], way.times) < 4.5


def test_door_that_has_closed_is_not_passed():
    assert find_path(MOVER, closing(4.5), WEST, EAST, 3.0, 11.0) is None


def test_goal_that_becomes_free_later_is_reached_then():
    leaving = Ellipse(
        (0.3, 0.3), PolylineMotion((0.0, 6.0, 7.0), ((6.5, 3.0), (6.5, 3.0), (6.5, 1.0)))
    )
    world = World((leaving,), (), AREA)
    way = find_path(MOVER, world, WEST, EAST, 0.0, 20.0)
    check(way, world, WEST, EAST)
    assert 6.2 < way.times[-1] < 8.0
    assert find_path(MOVER, world, WEST, EAST, 0.0, 6.0) is None


@pytest.mark.parametrize(("near", "passed"), [(0.46, False), (0.86, True)])
def test_discs_far_away_in_each_layer_may_be_near_in_between(near, passed):
    half = 0.5 * COARSE[0].step(MOVER)
    times = tuple((half * np.arange(200)).tolist())

    def shaking(side):
        ys = [3.0 + side * (0.5 * (0.86 if k % 2 == 0 else near) + 0.8) for k in range(200)]
        return Ellipse((0.8, 0.8), PolylineMotion(times, tuple((4.0, y) for y in ys)))

    world = World((shaking(1), shaking(-1)), (), (1.0, 1.5, 7.0, 4.5))
    start, goal = (1.8, 3.0, 0.0), (6.2, 3.0, 0.0)
    way = find_path(MOVER, world, start, goal, 0.0, 8.0, COARSE)
    if passed:
        check(way, world, start, goal)
    else:
        assert way is None


def test_search_waits_for_an_obstacle_that_moves_away():
    leaving = Ellipse(
        (0.3, 0.3), PolylineMotion((0.0, 8.0, 9.0), ((3.0, 0.5), (3.0, 0.5), (3.0, 4.0)))
    )
    world = World((leaving,), (), (0.0, 0.0, 3.5, 1.0))
    start, goal = (0.6, 0.5, 0.0), (2.9, 0.5, 0.0)
    check(find_path(MOVER, world, start, goal, 0.0, 10.0, COARSE), world, start, goal)


def test_no_path_arrives_too_late():
    found = 0
    for until in np.arange(1.0, 1.5, 0.03):
        way = find_path(MOVER, World(), (0, 0, 0), (1.05, 0.3, 0.2), 0.0, float(until), COARSE)
        assert way is None or way.times[-1] <= until + 1e-9
        found += way is not None
    assert 0 < found < 17


@pytest.mark.parametrize("seed", representative(range(7), every=7))
def test_paths_through_a_crowd_are_free_of_contact(seed):
    random = np.random.default_rng(seed)
    bodies = []
    for _ in range(14):
        place, velocity = random.uniform((2.2, 0), (6, 6)), random.uniform(-0.6, 0.6, 2)
        turned = random.uniform(-0.6, 0.6, 2)
        time = random.uniform(0.5, 6.0)
        route = PolylineMotion(
            (0.0, time), (tuple(place), tuple(place + time * velocity)), tuple(turned)
        )
        axes = tuple(random.uniform(0.1, 0.4, 2))
        bodies.append(Ellipse(axes, route, random.uniform(-3, 3)))
    bodies += [disc(0.15, *random.uniform((2.5, 0.5), (5.5, 5.5))) for _ in range(5)]
    world = World(tuple(bodies), (Wall(4.0, 1.0, 0.4, 0.2, 1.5),), AREA)
    grid = GRIDS[seed == 0]
    way = find_path(MOVER, world, WEST, EAST, 0.0, 20.0, (grid,))
    verdict = check(way, world, WEST, EAST)
    assert verdict.gap < 0.5


# ---- escape -------------------------------------------------------------------------------------


def room(length, width, x=4.0, y=3.0):
    """Return four walls around a point."""
    return (
        Wall(x, y + 0.5 * width + 0.05, 0.0, length + 0.2, 0.1),
        Wall(x, y - 0.5 * width - 0.05, 0.0, length + 0.2, 0.1),
        Wall(x + 0.5 * length + 0.05, y, 0.0, 0.1, width),
        Wall(x - 0.5 * length - 0.05, y, 0.0, 0.1, width),
    )


def test_robot_without_threat_stays():
    world = World((), room(1.0, 0.7))
    check(find_escape(MOVER, world, (4.0, 3.0, 0.0), 5.0, 8.0), world, (4.0, 3.0, 0.0))
    assert find_path(MOVER, world, (4.0, 3.0, 0.0), EAST, 0.0, 9.0) is None


def test_no_escape_from_a_disc_that_enters_a_closed_room():
    world = World((disc(0.3, 7.0, 3.0, (-0.6, 0.0)),), room(1.0, 0.7))
    assert find_escape(MOVER, world, (4.0, 3.0, 0.0), 0.0, 6.0) is None
    check(find_escape(MOVER, world, (4.0, 3.0, 0.0), 0.0, 2.5), world, (4.0, 3.0, 0.0))


def test_robot_escapes_sideways_from_an_approaching_disc():
    world = World((disc(0.3, 7.0, 3.0, (-3.0, 0.0)),))
    start = (4.0, 3.0, 0.0)
    assert judge(np.array([0.0, 3.0]), np.array([start, start]), MOVER.box, world).collided
    way = find_escape(MOVER, world, start, 0.0, 3.0)
    check(way, world, start)
    assert np.abs(way.poses[:, 1] - 3.0).max() > 0.3


def corridor(width=0.75):
    return tuple(Wall(4.0, 3.0 + s * (0.5 * width + 0.05), 0.0, 20.0, 0.1) for s in (1, -1))


def test_no_escape_in_a_corridor_from_a_faster_obstacle():
    fast = World((disc(0.3, 7.0, 3.0, (-3.0, 0.0)),), corridor())
    assert find_escape(MOVER, fast, (4.0, 3.0, 0.0), 0.0, 3.0) is None
    slow = World((disc(0.3, 7.0, 3.0, (-0.8, 0.0)),), corridor())
    check(find_escape(MOVER, slow, (4.0, 3.0, 0.0), 2.0, 6.0), slow, (4.0, 3.0, 0.0))


def test_escape_does_not_leave_the_area():
    wide = disc(1.5, 6.0, 3.0, (-1.0, 0.0))
    start = (1.0, 3.0, 0.0)
    assert find_escape(MOVER, World((wide,), (), (0, 2.0, 8, 4.0)), start, 0.0, 6.0) is None
    open_ = World((wide,), (), (0, 0, 8, 6))
    check(find_escape(MOVER, open_, start, 0.0, 6.0), open_, start)


@pytest.mark.parametrize("gap", [0.002, 0.02])
def test_robot_close_to_contact_can_still_escape(gap):
    beside = Wall(4.0, 3.0 + 0.25 + gap + 0.05, 0.0, 2.0, 0.1)
    world = World((disc(0.3, 4.7 + gap, 3.0), disc(0.3, 1.5, 3.0, (1.0, 0.0))), (beside,))
    start = (4.0, 3.0, 0.0)
    check(find_escape(MOVER, world, start, 0.0, 5.0), world, start)
    check(find_path(MOVER, world, start, WEST, 0.0, 9.0), world, start, WEST)


@pytest.mark.exhaustive
def test_escape_does_not_pass_through_an_obstacle_close_to_contact():
    world = World((disc(0.05, 0.39, 0.25 + 0.05 + 0.002),))
    search = SearchNodes(MOVER, world, np.zeros(3), 0.0, 2.0, COARSE[0], (-2.0, -2.0, 2.0, 2.0))
    seeds = ReachSearch(search).seeds
    assert sum(map(len, seeds.values())) > 20
    for layer, nodes in seeds.items():
        for node in nodes:
            move = np.stack((np.zeros(3), search.pose(node)))
            assert not judge(search.times[[0, layer]], move, MOVER.box, world).collided


def test_robot_in_contact_cannot_escape():
    world = World((disc(0.3, 4.65, 3.0),))
    assert find_escape(MOVER, world, (4.0, 3.0, 0.0), 0.0, 1.0) is None


def test_contact_is_avoidable_if_an_escape_existed_two_seconds_before():
    times = np.arange(0.0, 6.0, 0.005)
    poses = np.stack((1.0 + 0.6 * times, 3.0 + 0 * times, 0 * times), axis=1)
    standing = World((disc(0.3, 4.0, 3.0),))
    contact = judge(times, poses, MOVER.box, standing).contact
    assert contact == pytest.approx((4.0 - 0.7 - 1.0) / 0.6, abs=1e-3)
    way = find_avoiding_path(MOVER, standing, times, poses, contact)
    check(way, standing, (1.0 + 0.6 * (contact - 2.0), 3.0, 0.0))
    assert way.times[0] == pytest.approx(contact - 2.0)
    assert way.times[-1] >= contact + 1.0 - 1e-9
    rushing = World((disc(0.3, 10.0, 3.0, (-3.0, 0.0)),), corridor())
    contact = judge(times, poses, MOVER.box, rushing).contact
    assert find_avoiding_path(MOVER, rushing, times, poses, contact, after=3.0) is None
    with pytest.raises(InputError, match="not within the drive"):
        find_avoiding_path(MOVER, rushing, times, poses, math.inf)


# ---- search internals ---------------------------------------------------------------------------


@pytest.mark.parametrize("headings", [64, 128])
@pytest.mark.parametrize("walls", [False, True])
def test_layer_equals_the_result_of_a_plain_search(headings, walls):
    mover = Mover(Box(0.3, 0.2), 1.0, 3.0)
    world = World(
        (disc(0.15, 0.9, 0.4), disc(0.12, 0.2, 0.3, (0.3, 0.2))),
        (Wall(0.5, 1.0, 0.3, 0.5, 0.05),) if walls else (),
        (0.0, 0.0, 1.3, 1.3),
    )
    grid = Grid(0.08, headings)
    search = SearchNodes(mover, world, np.array([0.6, 0.7, 0.2]), 0.0, 0.8, grid, world.area)
    reach = ReachSearch(search)
    _, rows, columns = search.shape

    def bits(state):
        parts = (state[..., None] >> np.arange(64, dtype=np.uint64)) & np.uint64(1)
        return parts.transpose(0, 3, 1, 2).reshape(-1, rows, columns).astype(bool)

    def both(mask):
        return bits(np.broadcast_to(mask, search.shape))

    free, turning = both(search.free), both(search.turning)
    assert free.any() and not free.all()
    state = np.zeros(search.shape, dtype=np.uint64)
    search.add(state, search.home)
    reached = bits(state)
    assert reached.sum() == 1
    steps = [
        (i, j)
        for i in range(-9, 10)
        for j in range(-9, 10)
        if math.hypot(i, j) * grid.cell <= mover.speed * search.step + 1e-9
    ]
    for layer in range(3):
        following = np.zeros_like(reached)
        for heading, row, column in np.argwhere(reached):
            for turn in range(-search.turn, search.turn + 1):
                to = (heading + turn) % headings
                for i, j in steps:
                    if not (0 <= row + i < rows and 0 <= column + j < columns):
                        continue
                    if (
                        turn
                        and (i or j)
                        and not (
                            turning[heading, row, column] and turning[to, row + i, column + j]
                        )
                    ):
                        continue
                    following[to, row + i, column + j] |= free[to, row + i, column + j]
        mask = np.full(search.shape, ~np.uint64(0))
        search.moving[0].apply(mask, layer + 1)
        reached = following & bits(mask)
        assert not bits(mask).all()
        state = reach.advance(state, layer)
        assert (bits(state) == reached).all()
    assert reached.sum() > 300


def test_nodes_are_free_only_where_the_box_keeps_its_gap():
    world = World(
        (Ellipse((0.4, 0.1), PolylineMotion.still(4.0, 3.0), 0.5), disc(0.2, 5.0, 3.5, (0.4, 0))),
        (Wall(3.0, 2.0, 0.3, 0.3, 0.8),),
        AREA,
    )
    for grid in GRIDS:
        search = SearchNodes(MOVER, world, np.array([1.0, 1.0, 0.2]), 0.0, 6.0, grid, AREA)
        layer = 7
        full = np.full(search.shape, ~np.uint64(0))
        state = search.free_at(full, layer)
        random = np.random.default_rng(1)
        nodes = [
            (
                int(random.integers(grid.headings)),
                int(np.searchsorted(search.ys, random.uniform(1, 5))),
                int(np.searchsorted(search.xs, random.uniform(2, 6))),
            )
            for _ in range(1500)
        ]
        poses = np.array([search.pose(node) for node in nodes])
        times = np.full(len(nodes), search.times[layer])
        gaps = np.stack(
            [
                *(
                    ellipse_gap(
                        poses,
                        MOVER.box,
                        o.place.at(times),
                        np.tile(o.semi_axes, (1500, 1)),
                        np.full(1500, o.angle),
                    )
                    for o in world.obstacles
                ),
                wall_gap(poses, MOVER.box, np.tile(astuple(world.walls[0]), (1500, 1))),
            ],
            axis=1,
        )
        rounding = math.sqrt(0.5) * grid.cell / 4
        over = (
            gaps
            - (
                grid.ellipse_margin(MOVER, (0.4, 0.1), 0.0),
                grid.ellipse_margin(MOVER, (0.2, 0.2), 0.4) - rounding,
                grid.wall_margin(MOVER, turning=False),
            )
        ).min(axis=1)
        free = np.array([search.contains(state, node) for node in nodes])
        assert over[free].min() >= -1e-9
        # The loss is limited to rounding and tangents.
        assert over[~free].max() < 2.0 * rounding + 0.003
        assert 100 < free.sum() < 1400


def test_grids_have_the_stated_minimum_gap():
    second, third = FINE_GRIDS[1:]
    assert second.sufficient_gap(MOVER, second.ellipse_margin(MOVER, (0.3, 0.3), 0.0)) < 0.0345
    assert second.sufficient_gap(MOVER, second.ellipse_margin(MOVER, (0.3, 0.3), 0.6)) < 0.0425
    assert second.sufficient_gap(MOVER, second.wall_margin(MOVER, turning=False)) < 0.0535
    assert third.sufficient_gap(MOVER, third.wall_margin(MOVER, turning=False)) < 0.0325
    assert third.sufficient_gap(MOVER, third.ellipse_margin(MOVER, (0.3, 0.3), 0.6)) < 0.0255


def test_robot_smaller_than_a_step_does_not_skip_a_wall():
    mover = Mover(Box(0.01, 0.01), 1.0, 20.0)
    world = World((), (Wall(0.25, 0.0, 0.0, 0.001, 9.0),), (-1.0, -1.0, 1.5, 1.0))
    assert find_path(mover, world, (0, 0, 0), (1, 0, 0), 0.0, 3.0, COARSE) is None


def test_steps_are_within_the_speeds_and_kept_gaps_shrink_with_the_grid():
    for mover in (
        MOVER,
        Mover(Box(1.0, 0.7), 1.0, 1.2),
        Mover(Box(0.4, 0.4), 0.3, 6.0),
        Mover(Box(0.8, 0.5), 1.5, 0.4),
    ):
        kept = []
        for grid in FINE_GRIDS:
            assert grid.turn(mover) * grid.angle <= mover.yaw_rate * grid.step(mover) + 1e-9
            kept.append(
                (
                    grid.wall_margin(mover, True),
                    grid.wall_margin(mover, False),
                    grid.ellipse_margin(mover, (0.3, 0.2), 0.5),
                )
            )
            start, goal = (0.0, 0.0, 0.0), (0.7, 0.4, 0.5)
            if grid is not FINE_GRIDS[-1]:
                way = find_path(mover, World(), start, goal, 0.0, 12.0, (grid,))
                check(way, World(), start, goal, mover)
        # A slow rotation makes steps long for any cell size.
        assert (np.diff(kept, axis=0) <= 0.0).all()
        assert (np.subtract(kept[0], kept[-1]) > 0.01).all()


@pytest.mark.parametrize(
    "make",
    [
        lambda: Grid(0.0, 64),
        lambda: Grid(0.05, 65),
        lambda: Mover(Box(1, 1), 0.0, 1.0),
        lambda: Mover(Box(1, 1), 1.0, math.inf),
        lambda: find_path(MOVER, World(), (0, 0), EAST, 0.0, 1.0),
        lambda: find_path(MOVER, World(), WEST, (0, math.nan, 0), 0.0, 1.0),
        lambda: find_path(MOVER, World(), WEST, EAST, 1.0, 1.0),
        lambda: find_escape(MOVER, World(), WEST, 0.0, math.inf),
    ],
)
def test_invalid_arguments_are_refused(make):
    with pytest.raises(InputError):
        make()
