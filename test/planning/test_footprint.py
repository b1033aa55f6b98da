"""Plans and checks of a robot whose arm stands out, among things of all heights."""

import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint, Limbs
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.errors import InputError
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.planning.goal_tracking import require_reachable
from omniman_ros.planning.goals import PoseGoal
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.obstacles.environment import Environment
from omniman_ros.planning.obstacles.pairs import Pairs
from omniman_ros.planning.obstacles.walls import Walls
from omniman_ros.planning.route.problem import RouteProblem
from omniman_ros.planning.route.search import FINEST_WHOLE, RouteSearch
from omniman_ros.planning.safety import Surroundings
from test.outlines import outlined
from test.planning.support import SimulatedRun, ellipses, planner

HALF = np.array([0.4, 0.25])
WIDE = (-9.0, -9.0, 9.0, 9.0)
AHEAD = Footprint(
    Rectangles.centred(HALF),
    (0.0, 0.5),
    Limbs(
        np.array([[0.0], [0.0], [0.8]]),
        np.array([[0.9], [0.0], [0.8]]),
        np.array([0.05]),
        np.array([0]),
    ),
    margin=0.05,
)  #: An arm 0.8 m above the floor that ends 0.95 m ahead of base_link
POST = (0.0, 2.0)
PALLET = (0.0, 0.2)
LAMP = (1.0, 2.0)
SHELF = (0.7, 0.75)
STEP = 0.1  #: Of the motions here, as of planned ones [s]


def things(*rows, heights, **more):
    known = ellipses(*rows, **more)
    low, high = np.array(heights, float).T
    return replace(known, lower=low, upper=high)


def straight_ahead(speed=0.4, seconds=3.0):
    times = np.linspace(0.0, seconds, round(seconds / STEP) + 1)
    poses, velocities = np.zeros((2, len(times), 3))
    poses[:, 0], velocities[:, 0] = speed * times, speed
    return HermiteTrajectory(times, poses, velocities, np.zeros((len(times) - 1, 4)))


@pytest.mark.parametrize(
    ("heights", "reach"),
    [
        (POST, 0.95),
        (SHELF, 0.95),
        (PALLET, 0.4),
        (LAMP, math.inf),  # 15 cm above the arm
        ((0.87, 2.0), 0.95),  # 2 cm above it: not above the margin
        ((0.54, 0.6), 0.4),  # 4 cm above the platform, 15 cm below the arm
        ((0.6, 0.65), math.inf),
    ],
)
def test_the_check_of_a_motion_finds_what_is_at_the_height_of_a_part(heights, reach):
    known = things((1.5, 0.0, 0.1), heights=[heights])
    contact = Surroundings(AHEAD, known, WIDE, 0.0).contact(straight_ahead(), 0.0)
    expected = (1.5 - 0.1 - reach) / 0.4 if reach < 2.0 else math.inf
    assert contact == (math.inf if reach > 2.0 else pytest.approx(expected, abs=0.03))
    assert contact <= expected + 1e-9


def test_a_wall_and_the_workspace_stop_the_arm():
    walls = Walls(np.column_stack([np.full(41, 1.5), np.linspace(-1, 1, 41)]), 0.035)
    none = ellipses()
    at = straight_ahead(0.1, 6.0)
    by_wall = Surroundings(AHEAD, none, WIDE, 0.0, walls=walls).contact(at, 0.0)
    assert by_wall == pytest.approx((1.5 - 0.035 - 0.95) / 0.1, abs=0.03)
    by_edge = Surroundings(AHEAD, none, (-9, -9, 1.2, 9), 0.0).contact(at, 0.0)
    assert by_edge == pytest.approx((1.2 - 0.95) / 0.1, abs=0.03)


@pytest.mark.parametrize(("heights", "fits"), [(POST, False), (SHELF, False), (PALLET, True)])
def test_a_goal_at_which_the_arm_would_touch_is_refused(heights, fits):
    known = things((1.8, 0.0, 0.1), heights=[heights])
    there = Environment(AHEAD, known, WIDE, None, Walls.none())
    goal = PoseGoal(np.array([1.0, 0.0, 0.0]))
    if fits:
        require_reachable(goal, there)
        return
    with pytest.raises(InputError, match="an obstacle stands"):
        require_reachable(goal, there)
    require_reachable(PoseGoal(np.array([1.0, 0.0, math.pi])), there)


def test_a_pair_is_made_for_each_part_at_the_height():
    known = things(*[(1.0, 0.0, 0.1)] * 4, heights=[POST, PALLET, SHELF, LAMP])
    pairs = Pairs.of(AHEAD, known)
    assert len(pairs) == 4  # platform and arm, platform, arm, none
    np.testing.assert_allclose(pairs.boxes.half[:2, 0], [0.4, 0.5], atol=1e-9)


@pytest.mark.parametrize(
    ("heights", "turns"), [(SHELF, True), (PALLET, False)], ids=["shelf", "pallet"]
)
def test_a_route_leads_the_arm_around_what_the_platform_passes_below(heights, turns):
    """Two obstacles leave 1.2 m for a robot that drives sideways with its arm ahead."""
    known = things((0.75, 1.2, 0.15), (-2.0, 1.2, 0.15), heights=[heights] * 2)
    start, goal = np.array([0.0, 0.0, 0.0]), np.array([0.0, 2.4, 0.0])
    search = RouteSearch(RouteProblem(start, goal, AHEAD, 0.05, (0.8, 1.5), known, None, WIDE))
    while not search.advance(4000):
        pass
    assert search.route is not None and search._headings == FINEST_WHOLE
    _, poses = search.route.samples(AHEAD.radius)
    clear = Environment(AHEAD, known, WIDE, None, Walls.none()).gaps(poses, 0.3)
    assert clear.min() > 0.024
    leaves_the_line = bool(np.abs(poses[:, [0, 2]]).max() > 0.1)
    assert leaves_the_line == turns


def arm_gap(sim, known):
    """Return the least distance of arm and platform from what is at their height [m]."""
    poses = np.array(sim.poses)
    return Environment(sim.planner.footprint, known, WIDE, None, Walls.none()).gaps(poses, 1.0)


def test_the_robot_drives_with_its_arm_over_a_pallet_and_around_a_post():
    """The arm meets a post on the straight line, and is above a pallet at the goal."""
    known = things((1.3, 0.25, 0.1), (2.75, 0.0, 0.15), heights=[POST, PALLET], time=100.0)
    sim = SimulatedRun(planner(), seen=known)
    sim.planner.footprint = AHEAD
    sim.drive(PoseGoal(np.array([2.0, 0.0, 0.0])))
    sim.run(20.0)
    assert sim.planner.state is PlannerState.ARRIVED
    assert arm_gap(sim, known).min() > 0.02
    as_high = replace(known, lower=np.zeros(2), upper=np.full(2, 2.0))
    assert arm_gap(sim, as_high).min() < 0.0


def test_an_arm_that_is_stretched_out_on_the_way_stops_the_robot_before_it_touches():
    """The way past two posts is wide enough for the platform, not for the arm across it."""
    known = things((1.9, 0.55, 0.15), (1.9, -0.55, 0.15), heights=[POST] * 2, time=100.0)
    across = Footprint(
        Rectangles.centred(HALF),
        (0.0, 0.5),
        Limbs(
            np.array([[0.0], [0.0], [0.8]]),
            np.array([[0.0], [0.7], [0.8]]),
            np.array([0.05]),
            np.array([0]),
        ),
    )
    sim = SimulatedRun(planner(), seen=known)
    sim.drive(PoseGoal(np.array([3.5, 0.0, 0.0])))
    sim.run(20.0, until=lambda: sim.pose()[0] > 0.8)
    assert len(sim.poses) and np.abs(sim.poses[-1][1]) < 0.1
    moved = len(sim.poses)
    sim.planner.footprint = across
    sim.run(6.0)
    gaps = arm_gap(sim, known)[moved:]
    assert gaps[0] > 0.1
    assert gaps.min() > 0.0


def test_of_two_motions_without_contact_the_one_in_the_workspace_is_better():
    """The margin counts; a robot that is outside already may come back."""
    room = Surroundings(AHEAD, ellipses(), (-9.0, -9.0, 1.4, 9.0), 0.02)
    none, inside = room.threat(straight_ahead(0.1), 0.0)
    assert none == math.inf and inside > 0.0
    # The arm ends 0.95 m ahead: 1.2 m further it is 0.75 m outside, and 2 cm nearer to the edge.
    out, gap = room.threat(straight_ahead(0.4), 0.0)
    assert out == math.inf
    assert inside - gap == pytest.approx(0.77, abs=0.01)
    back = HermiteTrajectory(
        np.array([0.0, 3.0]),
        np.array([[1.0, 0.0, 0.0], [-0.2, 0.0, 0.0]]),
        np.array([[-0.4, 0.0, 0.0]] * 2),
        np.zeros((1, 4)),
    )
    assert room.threat(back, 0.0) == (math.inf, inside)


def test_a_platform_with_forks_drives_up_to_a_post_between_them():
    """The rectangle around the outline would overlap the post at the goal by 0.25 m."""
    half = [(-0.4, 0.25), (0.4, 0.25), (0.4, 0.2), (0.0, 0.2)]
    outline = [*half, *((x, -y) for x, y in reversed(half))]
    forks = Rectangles.around(outlined(outline, "ig42").robot.body)
    known = things((1.25, 0.0, 0.01), heights=[POST], time=100.0)
    sim = SimulatedRun(planner(), seen=known)
    sim.planner.footprint = Footprint(forks)
    sim.drive(PoseGoal(np.array([1.0, 0.0, 0.0])))
    sim.run(20.0)
    assert sim.planner.state is PlannerState.ARRIVED
    assert arm_gap(sim, known).min() > 0.0
    assert sim.pose()[0] == pytest.approx(1.0, abs=0.02)
