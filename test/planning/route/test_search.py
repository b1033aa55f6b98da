import math

import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.errors import InputError
from omniman_ros.planning.obstacles.clearance import Clearance
from omniman_ros.planning.obstacles.separation import outside_by
from omniman_ros.planning.route.problem import RouteProblem
from omniman_ros.planning.route.search import RouteSearch
from omniman_ros.surroundings.grid_map import GridMap
from test.planning.support import ellipses
from test.tiers import exhaustive, representative

HALF = np.array([0.4, 0.25])
FOOTPRINT = Footprint(Rectangles.centred(HALF))
RADIUS = math.hypot(0.4, 0.25)
SPEEDS = (0.8, 1.5)
MARGIN = 0.02
WIDE = (-1e3, -1e3, 1e3, 1e3)
EASED = 3 * RADIUS  #: Within so much of a tight start or goal the margin is eased [m]


def wall(first, last, radius=0.05):
    """Return rows of discs 5 cm apart between two points."""
    first, last = np.array(first, float), np.array(last, float)
    count = max(math.ceil(np.hypot(*(last - first)) / 0.05), 1)
    return [(*(first + (last - first) * k / count), radius) for k in range(count + 1)]


def turned(rows, angle):
    """Rotate rows of discs about the origin."""
    c, s = math.cos(angle), math.sin(angle)
    return [(c * x - s * y, s * x + c * y, r) for x, y, r in rows]


def pose_turned(pose, angle):
    (x, y, _), heading = turned([(*pose[:2], 0.0)], angle)[0], pose[2]
    return x, y, heading + angle


def made(start, goal, obstacles=None, grid=None, workspace=WIDE, margin=MARGIN, **more):
    start, goal = np.array(start, float), np.array(goal, float)
    known = ellipses() if obstacles is None else obstacles
    problem = RouteProblem(start, goal, FOOTPRINT, margin, SPEEDS, known, grid, workspace)
    return RouteSearch(problem, **more)


def searched(*args, **more):
    """Run a search to its end in one call."""
    search = made(*args, **more)
    assert search.advance(10**9)
    return search


def checked(search, start, goal, margin=MARGIN):
    """Assert that the route connects start and goal with half of the margin; return the route."""
    assert search.finished and not search.failed, search.reason
    route = search.route
    start, goal = np.array(start, float), np.array(goal, float)
    np.testing.assert_array_equal(route.poses[0], start)
    np.testing.assert_array_equal(route.poses[-1, :2], goal[:2])
    assert abs(math.remainder(route.poses[-1, 2] - goal[2], math.tau)) < 1e-9
    grid = search.problem.grid
    clearance = Clearance(FOOTPRINT, search.problem.around, search.problem.workspace, 0.5)
    steps = np.abs(np.diff(route.poses, axis=0))
    count = int((np.hypot(steps[:, 0], steps[:, 1]) + RADIUS * steps[:, 2]).sum() / 0.004)
    poses = route.at(np.linspace(0, route.duration, max(count, 50)))
    gaps, ends = clearance.gaps(poses), clearance.gaps(np.stack([start, goal]))
    least = np.full(len(poses), 0.5 * margin)
    for place, gap in zip((start, goal), ends, strict=True):
        if gap < margin:
            least[np.hypot(*(poses[:, :2] - place[:2]).T) < EASED] = 0.2 * gap
    assert (gaps >= least - 5e-4).all(), (gaps - least).min()
    assert (gaps > 0).all()
    if grid is not None:
        assert not grid.occupied_at(poses[:, :2]).any()
    return route


def find(start, goal, *args, **more):
    return checked(searched(start, goal, *args, **more), start, goal, more.get("margin", MARGIN))


# ---- open space -------------------------------------------------------------------------------


@pytest.mark.parametrize("far", [(3.0, 1, 2), (0, 0, 0.5), (0, 0, 0), (-400, 300, -3)])
def test_without_obstacles_the_route_is_the_straight_line(far):
    route = find((0, 0, 0), far)
    np.testing.assert_allclose(route.poses, [[0, 0, 0], far])


def test_robot_turns_the_shorter_way_on_the_branch_of_the_start():
    route = find((0, 0, 9), (1, 0, 9 + 2 * math.pi + 3.3))
    assert route.poses[-1, 2] == pytest.approx(9 + 3.3 - 2 * math.pi)


def test_obstacles_away_from_the_route_do_not_change_the_route():
    known = ellipses((1.5, 1.5, 0.6), (1, -2, 1, 0.5, 0.3), (400, 0, 3))
    route = find((0, 0, 0), (3, 0, 1), known)
    np.testing.assert_allclose(route.poses, [[0, 0, 0], [3, 0, 1]])


def test_route_around_one_disc_is_short_and_keeps_a_distance():
    known = ellipses((2, 0.1, 0.5))
    route = find((0, 0, 0), (4, 0, 0), known)
    assert 4 < route.length < 5
    _, poses = route.samples(FOOTPRINT.radius)
    assert Clearance(FOOTPRINT, known, WIDE).gaps(poses).min() > MARGIN + 0.02


# ---- traps ------------------------------------------------------------------------------------


def test_route_leads_out_of_a_u_and_around_the_u():
    known = ellipses(*wall((1, -1), (1, 1)), *wall((-1, 1), (1, 1)), *wall((-1, -1), (1, -1)))
    route = find((0, 0, 0), (2.5, 0, 0), known)
    assert route.poses[:, 0].min() < -1  # out at the open side
    assert np.abs(route.poses[:, 1]).max() > 1.2
    assert route.length < 9


def test_route_leads_out_of_one_bug_trap_into_another():
    def trap(x, sign):
        box = wall((x, -1.5), (x, 1.5)) + wall((x, 1.5), (x - 2 * sign, 1.5))
        box += wall((x, -1.5), (x - 2 * sign, -1.5))
        back = x - 2 * sign
        return box + wall((back, 1.5), (back, 0.5)) + wall((back, -1.5), (back, -0.5))

    start, goal = (0, 0, 0), (4.5, 0, math.pi / 2)
    find(start, goal, ellipses(*trap(1, 1), *trap(3.5, -1)))


def test_route_leads_around_a_wall_of_any_length():
    known = ellipses((2, 0, 9, 0.1, math.pi / 2))
    route = find((0, 0, 0), (4, 0, 0), known)
    assert np.abs(route.poses[:, 1]).max() > 9
    assert route.length < 20.5


def test_no_route_leads_outside_the_workspace():
    known = ellipses((2, 0, 9, 0.1, math.pi / 2))
    search = searched((0, 0, 0), (4, 0, 0), known, workspace=(-2, -9.5, 6, 9.5))
    assert search.failed and search.route is None
    assert search.reason == "there is no way"


def test_box_stays_in_the_workspace():
    known = ellipses((2, 0.9, 1))
    edge = (-1, -0.6, 5, 1e3)
    route = find((0, 0, 0), (4, 0, 0), known, workspace=edge)
    _, poses = route.samples(FOOTPRINT.radius)
    assert outside_by(poses, FOOTPRINT.whole, edge).max() <= -0.5 * MARGIN
    assert poses[:, 1].max() > 1  # there is no room below the disc


# ---- doors ------------------------------------------------------------------------------------


def door(width, angle):
    """Return a rotated wall of discs with a door of a given width in the middle."""
    h = 0.5 * width + 0.05
    return ellipses(*turned(wall((h, 0), (3, 0)) + wall((-h, 0), (-3, 0)), angle))


@pytest.mark.parametrize("degrees", representative(range(0, 91, 7)))
def test_door_of_60_cm_is_found_at_any_angle(degrees):
    angle = math.radians(degrees)
    start, goal = pose_turned((0.1, -1.2, 0), angle), pose_turned((-0.2, 1.2, 1), angle)
    route = find(start, goal, door(0.6, angle), workspace=(-2.5, -2.5, 2.5, 2.5))
    assert route.length < 3.2


@pytest.mark.parametrize("degrees", [0, 31, 77])
def test_corridor_of_60_cm_is_found_at_any_angle(degrees):
    start, goal, known = corridor(math.radians(degrees))
    assert find(start, goal, known).length < 4.5


def corridor(angle):
    """Return start, goal and walls of a rotated corridor 60 cm wide and 2 m long."""
    rows = wall((-1, 0.35), (1, 0.35)) + wall((-1, -0.35), (1, -0.35))
    for side in (1, -1):
        rows += wall((-1, 0.35 * side), (-1, 4 * side))
    start, goal = pose_turned((-2, 0.3, 0), angle), pose_turned((1.8, 0.2, 0.02), angle)
    return start, goal, ellipses(*turned(rows, angle))


def test_finer_lattice_finds_a_route_that_the_coarse_lattice_misses():
    start, goal, known = corridor(math.radians(77))
    edge = (-2.7, -2.7, 2.7, 2.7)
    assert find(start, goal, known, workspace=edge, headings=72).length < 4.5


@pytest.mark.parametrize("width", [exhaustive(0.46), 0.52])
def test_door_that_is_too_narrow_is_not_passed(width):
    edge = (-2.5, -1.8, 2.5, 1.8)
    assert searched((0, -1.2, 0), (0, 1.2, 0), door(width, 0.0), workspace=edge).failed
    round_it = find((0, -1.2, 0), (0, 1.2, 0), door(width, 0.0))
    assert np.abs(round_it.poses[:, 0]).max() > 3


def test_door_of_any_number_of_cells_is_found_at_any_position():
    for first in range(20, 24):
        for count in (12, 13):
            cells = np.zeros((60, 60), dtype=bool)
            cells[30:32] = True
            cells[30:32, first : first + count] = False
            grid = GridMap(cells, 0.05, np.array([0.3, -0.2, 0]))
            start, goal, edge = (1.4, 0.3, 0), (1.4, 2.3, 0), (0.2, -0.2, 3.4, 3)
            search = searched(start, goal, grid=grid, workspace=edge, headings=72)
            assert checked(search, start, goal).length < 3.5
            assert search.worked < 40_000  # without a finer lattice


# ---- what cannot be reached -------------------------------------------------------------------


def ring(x, y, radius):
    angles = np.linspace(0, math.tau, 80)
    return ellipses(*[(x + radius * math.cos(a), y + radius * math.sin(a), 0.1) for a in angles])


@pytest.mark.parametrize("inside", ["goal", "start"])
def test_enclosed_goal_or_start_has_no_route(inside):
    ends = [(0, 0, 0), (3, 0, 0)]
    search = searched(*(ends if inside == "goal" else ends[::-1]), ring(3, 0, 1.2))
    assert search.failed
    assert search.reason == "there is no way"


@pytest.mark.exhaustive
def test_route_does_not_turn_where_there_is_no_room():
    rows = wall((-3, 0.45), (4, 0.45)) + wall((-3, -0.45), (4, -0.45))
    ends = wall((-3, -0.45), (-3, 0.45)) + wall((4, -0.45), (4, 0.45))
    assert find((0, 0, 0), (2, 0, 0.1), ellipses(*rows, *ends)).length < 2.1
    assert find((0, 0, 0), (2, 0, math.pi), ellipses(*rows)).length > 6  # the robot turns outside
    search = searched((0, 0, 0), (1, 0, math.pi), ellipses(*rows, *ends), headings=36)
    assert search.failed
    assert "heading" in search.reason


@pytest.mark.parametrize("end", ["start", "goal"])
def test_end_that_touches_an_obstacle_is_reported(end):
    upon = (0, 0.3, 0.06) if end == "start" else (3, 0.3, 0.06)
    search = searched((0, 0, 0), (3, 0, 0), ellipses(upon, (1.5, 0, 0.2)))
    assert search.failed
    assert search.reason.startswith(f"the {end} touches")


def test_end_amid_occupied_cells_touches_an_obstacle():
    cells = np.zeros((100, 100), dtype=bool)
    cells[20:80, 20:80] = True  # no boundary cell is near its middle
    grid = GridMap(cells, 0.05, np.zeros(3))
    assert searched((2.5, 2.5, 0), (6, 2.5, 0), grid=grid).reason.startswith("the start touches")
    assert searched((6, 2.5, 0), (2.5, 2.5, 0), grid=grid).reason.startswith("the goal touches")


def test_goal_outside_the_workspace_is_reported():
    search = searched((0, 0, 0), (3, 0, 0), workspace=(-1, -1, 3.3, 1))
    assert search.reason.startswith("the goal touches")


# ---- tight ends -------------------------------------------------------------------------------


def test_start_and_goal_within_the_margin_have_a_route():
    beside = ellipses(*wall((-1, 0.303), (1, 0.303)))
    find((0, 0, 0), (0, 1.2, 0), beside)
    find((0, 1.2, 0), (0, 0, 0), beside)


def test_margin_is_reduced_at_the_ends_only():
    # Start 3 mm from a wall; a door further away is too narrow for the margin.
    rows = wall((-1, 0.303), (0.6, 0.303))
    edge = (-1, -4, 1, 1)
    narrow = [(x, y - 2.5, r) for x, y, r in wall((0.31, 0), (2, 0)) + wall((-0.31, 0), (-2, 0))]
    start, goal = (0, 0, 0), (0, -3.3, 0)
    assert find(start, (0, -1.2, 0), ellipses(*rows, *narrow), workspace=edge).length < 1.5
    assert searched(start, goal, ellipses(*rows, *narrow), workspace=edge).failed


@pytest.mark.parametrize("angle", [0.0, 0.3])
@pytest.mark.parametrize("width", [0.52, 0.55])
def test_route_leads_out_of_and_into_a_slot(width, angle):
    h = 0.5 * width + 0.05
    rows = wall((-0.6, h), (0.6, h)) + wall((-0.6, -h), (0.6, -h)) + wall((-0.6, -h), (-0.6, h))
    slot = ellipses(*turned(rows, angle))
    inside, outside = pose_turned((0, 0, 0), angle), (2, 1, 0)
    find(inside, outside, slot)
    find(outside, inside, slot)


def test_start_just_outside_the_workspace_has_a_route_inside():
    edge = (0, 0, 8, 6)
    start, goal = (0.35, 0.4, 0), (4, 4, 0)
    known = ellipses((2, 2, 0.5))
    search = searched(start, goal, known, workspace=edge)
    _, poses = checked(search, start, goal).samples(FOOTPRINT.radius)
    out = outside_by(poses, FOOTPRINT.whole, edge)
    assert out.max() < 0.055
    assert out[len(out) // 2 :].max() < 0
    assert searched((0.1, 0.4, 0), goal, known, workspace=edge).failed


# ---- maps -------------------------------------------------------------------------------------


def labyrinth(count, seed=3):
    """Return a perfect maze of 1 m cells: 0.9 m corridors, one passage in five a 0.6 m door."""
    rng = np.random.default_rng(seed)
    cells = np.zeros((20 * count + 2, 20 * count + 2), dtype=bool)
    for k in range(0, 20 * count + 1, 20):
        cells[k : k + 2] = True
        cells[:, k : k + 2] = True
    seen, stack = {(0, 0)}, [(0, 0)]
    while stack:
        y, x = stack[-1]
        beside = [(y, x + 1), (y + 1, x), (y, x - 1), (y - 1, x)]
        beside = [c for c in beside if set(c) <= set(range(count)) and c not in seen]
        if not beside:
            stack.pop()
            continue
        to = beside[rng.integers(len(beside))]
        seen.add(to)
        stack.append(to)
        low, high = (5, 17) if rng.random() < 0.2 else (2, 20)
        if to[0] == y:
            at = 20 * max(x, to[1])
            cells[20 * y + low : 20 * y + high, at : at + 2] = False
        else:
            at = 20 * max(y, to[0])
            cells[at : at + 2, 20 * x + low : 20 * x + high] = False
    return cells


@pytest.mark.parametrize("origin", [exhaustive((0, 0, 0)), (-3, 2, 0.4)])
def test_route_leads_through_a_labyrinth(origin):
    grid = GridMap(labyrinth(8), 0.05, np.array(origin, float))
    c, s = math.cos(origin[2]), math.sin(origin[2])

    def placed(x, y, heading):
        return origin[0] + c * x - s * y, origin[1] + s * x + c * y, heading + origin[2]

    route = find(placed(0.55, 0.55, 0), placed(7.55, 7.55, 0), grid=grid)
    assert 10 < route.length < 60


def test_route_avoids_map_and_obstacles_together():
    cells = np.zeros((60, 60), dtype=bool)
    cells[30:32] = True
    cells[30:32, 10:26] = cells[30:32, 36:52] = False  # two doors of 0.8 m
    grid = GridMap(cells, 0.05, np.zeros(3))
    edge = (0, 0, 3, 3)
    start, goal = (0.9, 0.7, 0), (0.9, 2.3, 0)
    assert find(start, goal, grid=grid, workspace=edge).length < 2
    shut = ellipses((0.9, 1.55, 0.35, 0.1, 0))
    assert find(start, goal, shut, grid=grid, workspace=edge).poses[:, 0].max() > 2
    both = ellipses((0.9, 1.55, 0.35, 0.1, 0), (2.2, 1.55, 0.35, 0.1, 0))
    assert searched(start, goal, both, grid=grid, workspace=edge).failed


@pytest.mark.parametrize("resolution", [0.02, 0.1, 0.13])
def test_maps_of_any_resolution_are_supported(resolution):
    count = round(3 / resolution)
    cells = np.zeros((count, count), dtype=bool)
    middle = count // 2
    cells[middle] = True
    cells[middle, : math.ceil(0.85 / resolution)] = False
    grid = GridMap(cells, resolution, np.array([0.0, 0, 0.2]))
    route = find((1, 0.7, 0), (1, 2.7, 0), grid=grid, workspace=(-0.6, -0.5, 3.2, 4))
    assert route.length > 2


# ---- slices -----------------------------------------------------------------------------------


def scattered(seed, count=12):
    """Draw obstacles of all shapes and two free poses."""
    rng = np.random.default_rng(seed)
    rows = []
    for k in range(count):
        x, y = rng.uniform((0, 0), (6, 5))
        a, b = rng.uniform(0.05, 0.5, 2)
        rows.append((x, y, a, a, 0.0) if k % 2 else (x, y, a, b, rng.uniform(-3, 3)))
    known = ellipses(*rows)
    clearance = Clearance(FOOTPRINT, known, WIDE)
    while True:
        ends = rng.uniform((0, 0, -4), (6, 5, 4), (2, 3))
        if clearance.gaps(ends).min() > 0.002 and np.hypot(*(ends[0] - ends[1])[:2]) > 3:
            return ends[0], ends[1], known


@pytest.mark.parametrize("nodes", [1, 700, 5000])
def test_sliced_search_finds_the_same_route(nodes):
    start, goal, known = scattered(4)
    whole, sliced = searched(start, goal, known), made(start, goal, known)
    slices = 1
    while not sliced.advance(nodes):
        assert not sliced.failed and sliced.route is None
        slices += 1
    np.testing.assert_array_equal(sliced.route.poses, whole.route.poses)
    assert len(whole.route.poses) > 2
    assert sliced.worked == whole.worked
    # A slice may exceed its budget and the next then does less: the sum is as requested.
    assert whole.worked / nodes - 3000 / nodes <= slices <= whole.worked / nodes + 1
    assert sliced.advance(nodes) and sliced.worked == whole.worked


def test_no_unit_of_work_is_much_larger_than_a_slice():
    search = made(*scattered(4)[:2], scattered(4)[2])
    last, largest = 0, 0
    while not search.advance(1):
        largest, last = max(largest, search.worked - last), search.worked
    assert largest <= 2000


def test_search_is_deterministic():
    one, two = (searched(*scattered(7)[:2], scattered(7)[2]).route for _ in range(2))
    np.testing.assert_array_equal(one.poses, two.poses)


def test_route_does_not_depend_on_the_branch_of_the_goal_heading():
    start, goal, known = scattered(4)
    one = searched(start, goal, known).route
    two = searched(start, goal + [0, 0, 4 * math.pi], known).route
    np.testing.assert_allclose(one.poses, two.poses, atol=1e-9)


# ---- properties -------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", representative(range(25)))
def test_route_among_random_obstacles_keeps_clear_of_them(seed):
    start, goal, known = scattered(seed, 6 + seed)
    search = searched(start, goal, known)
    route = checked(search, start, goal)
    assert route.duration < 5 * np.hypot(*(goal - start)[:2]) / SPEEDS[0] + 5


@pytest.mark.parametrize("seed", representative([12, 23, 24, 32, 39], 2))
def test_obstacle_between_the_nodes_of_a_coarse_lattice_is_respected(seed):
    places = np.random.default_rng(seed).uniform((0.7, -1.3), (3.3, 1.3), (9, 2))
    posts = ellipses(*[(x, y, 0.01) for x, y in places])
    start, goal, edge = (0, 0, 0), (4, 0, 0), (-0.8, -1.4, 4.8, 1.4)
    find(start, goal, posts, workspace=edge, resolution=0.25, headings=24)


def test_route_keeps_a_zero_or_a_large_margin():
    start, goal, known = scattered(4)
    known = known.select(np.arange(6))
    for margin in (0.0, 0.2):
        checked(searched(start, goal, known, margin=margin), start, goal, margin)


# ---- what is refused --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"start": np.array([0, math.nan, 0])}, "start.*nan"),
        ({"start": np.zeros(2)}, r"start.*\(2,\)"),
        ({"goal": np.array([0, 0, math.inf])}, "goal.*inf"),
        ({"footprint": Footprint(Rectangles.centred(np.array([0.4, 0.0])))}, "0.0"),
        ({"margin": -0.1}, "-0.1"),
        ({"margin": math.nan}, "nan"),
        ({"speeds": (0.0, 1.0)}, "0.0"),
        ({"resolution": 0.001}, "0.001"),
        ({"headings": 71}, "71"),
        ({"headings": 122}, "122"),
        ({"obstacles": ellipses((math.inf, 0, 0.1))}, "obstacles.*inf"),
    ],
)
def test_invalid_input_is_refused_with_its_value(changes, named):
    valid = {
        "start": np.zeros(3),
        "goal": np.ones(3),
        "footprint": FOOTPRINT,
        "margin": 0.02,
        "speeds": SPEEDS,
        "obstacles": ellipses(),
        "grid": None,
        "workspace": WIDE,
    }
    options = {name: changes[name] for name in ("resolution", "headings") if name in changes}
    problem = valid | {name: value for name, value in changes.items() if name in valid}
    with pytest.raises(InputError, match=named):
        RouteSearch(RouteProblem(**problem), **options)


def test_region_that_is_too_large_is_reported():
    grid = GridMap(np.zeros((2, 2), dtype=bool), 0.05, np.zeros(3))
    around = ellipses((90, 0, 0.5))
    search = searched((0, 0, 0), (180, 180, 0), around, grid=grid)
    assert search.route is not None  # straight on
    blocked = ellipses((90, 90, 0.5))
    assert "too many" in searched((0, 0, 0), (180, 180, 0), blocked).reason
