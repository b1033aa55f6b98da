import math

import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint, Limbs
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.planning.obstacles.clearance import Clearance
from omniman_ros.planning.route.lattice import Lattice, LatticeFrame, Region
from omniman_ros.planning.route.occupancy import CROWDED, MAX_KINDS, HeadingOccupancy
from omniman_ros.planning.route.problem import RouteProblem
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.surroundings.grid_map import GridMap
from test.planning.support import ellipses

HALF = np.array([0.4, 0.25])
FOOTPRINT = Footprint(Rectangles.centred(HALF))
LIMBS = Limbs(
    np.array([[0.2, 0.7], [0.0, 0.1], [0.6, 0.6]]),
    np.array([[0.7, 0.7], [0.1, 0.35], [0.6, 0.6]]),
    np.array([0.06, 0.05]),
    np.array([0, 1]),
)
WITH_ARM = Footprint(Rectangles.centred(HALF), (0.0, 0.5), LIMBS)
EDGE = (-1.5, -1.2, 3.4, 2.6)
HEADINGS = 24


def filled(obstacles, grid, yaw, room=(1.0, 1.0), footprint=FOOTPRINT):
    start, goal = np.array([-0.5, 0.3, 0.1]), np.array([2.5, 0.2, 1.0])
    known = Ellipses.none() if obstacles is None else obstacles
    problem = RouteProblem(start, goal, footprint, 0.1, (1.0, 1.0), known, grid, EDGE)
    frame = LatticeFrame.of(start, grid, 0.05) if grid else LatticeFrame(start[:2], yaw, 0.05)
    region = Region.around(frame.own(problem.ends), 2.0, frame.extent(problem), frame.edge)
    lattice = Lattice(frame, region, HEADINGS, problem.ends, footprint.is_symmetric)
    marks = HeadingOccupancy(problem, lattice, np.array(room))
    assert sum(marks.fill()) > 0
    return problem, lattice, marks


def inner_states(lattice, count=4000):
    """Return the states whose nodes are not in the outermost rows or columns."""
    rng = np.random.default_rng(2)
    x = rng.integers(1, lattice.region.columns - 1, count)
    y = rng.integers(1, lattice.region.rows - 1, count)
    return y * lattice.region.columns + x, rng.integers(HEADINGS, size=count)


CELLS = np.zeros((40, 50), dtype=bool)
CELLS[18:20, 10:30] = True
KNOWN = ellipses((1.0, 0.6, 0.4), (0.2, -0.5, 0.6, 0.15, 0.8))
ON_QUARTERS = np.random.default_rng(5).integers(-80, 0, (2 * CROWDED, 2)) / 80.0
ANYWHERE = np.random.default_rng(5).uniform(0.0, 1.5, (2 * MAX_KINDS, 2))


def discs(centers):
    """Return discs of one size, and another obstacle."""
    return Ellipses.circles(0.0, centers, (0.0, 0.0), 0.03).joined(ellipses((2.0, 1.0, 0.3)))


@pytest.mark.parametrize("footprint", [FOOTPRINT, WITH_ARM], ids=["platform", "with arm"])
@pytest.mark.parametrize(
    ("obstacles", "grid", "yaw"),
    [
        (KNOWN, None, 0.0),
        (KNOWN, None, 0.7),
        (None, GridMap(CELLS, 0.05, np.array([-0.3, -0.4, 0.5])), 0.5),
        (discs(ON_QUARTERS), None, 0.0),
    ],
)
def test_bit_is_set_exactly_where_the_gap_is_below_the_level(obstacles, grid, yaw, footprint):
    problem, lattice, marks = filled(obstacles, grid, yaw, footprint=footprint)
    assert lattice.bits == (HEADINGS if footprint is WITH_ARM else HEADINGS // 2)
    nodes, headings = inner_states(lattice)
    poses = lattice.frame.odom(lattice.poses(nodes, headings))
    gaps = Clearance(footprint, problem.around, EDGE).gaps(poses)
    for level, threshold in enumerate(problem.rooms.levels):
        bit = marks.words[level, nodes] >> (headings % lattice.bits).astype(np.uint64)
        sure = np.abs(gaps - threshold) > 1e-9
        taken = (bit & np.uint64(1)).astype(bool)
        np.testing.assert_array_equal(taken[sure], gaps[sure] < threshold)
        assert 0.05 < taken.mean() < 0.95


def test_many_discs_anywhere_are_marked_to_an_eighth_of_an_edge():
    problem, lattice, marks = filled(discs(ANYWHERE), None, 0.3)
    nodes, headings = inner_states(lattice)
    poses = lattice.frame.odom(lattice.poses(nodes, headings))
    gaps = Clearance(FOOTPRINT, problem.around, EDGE).gaps(poses)
    sure = np.abs(gaps - problem.rooms.levels[0]) > math.hypot(0.05, 0.05) / 16.0
    assert 0.9 < sure.mean() < 1.0
    taken = marks.taken(nodes, headings)
    np.testing.assert_array_equal(taken[sure], gaps[sure] < problem.rooms.levels[0])


def test_heading_and_its_opposite_are_forbidden_together():
    _, lattice, marks = filled(KNOWN, None, 0.0)
    nodes, headings = inner_states(lattice)
    taken = marks.taken(nodes, headings)
    np.testing.assert_array_equal(taken, marks.taken(nodes, headings + lattice.bits))
    free = np.flatnonzero(~taken)[:5]
    marks.forbid(nodes[free], headings[free])
    assert marks.taken(nodes[free], headings[free] + lattice.bits).all()


def test_margin_is_reduced_around_a_tight_start_only():
    problem, lattice, marks = filled(KNOWN, None, 0.0, room=(0.01, 1.0))
    _, _, usual = filled(KNOWN, None, 0.0)
    nodes, headings = inner_states(lattice)
    poses = lattice.poses(nodes, headings)
    near = np.hypot(*(poses[:, :2] - lattice.ends[0, :2]).T) < 3 * math.hypot(*HALF)
    eased = usual.taken(nodes, headings) & ~marks.taken(nodes, headings)
    assert eased[near].any() and not eased[~near].any()
    assert marks.floor(poses)[near].max() == pytest.approx(0.0025)
    assert marks.floor(poses)[~near].min() == problem.rooms.floor


def test_outermost_nodes_are_never_free():
    _, lattice, marks = filled(None, None, 0.3)
    rows = marks.words[0].reshape(lattice.region.rows, -1)
    for edge in (rows[0], rows[-1], rows[:, 0], rows[:, -1]):
        assert (edge == marks.full).all()
