"""Gaps to obstacles that are far away need not be exact, those to near ones do."""

import math

import numpy as np
import pytest

from omniman_ros.collision.moving_obstacles import MovingObstacles
from omniman_ros.collision.signed_gaps import point_gap_values
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.motion.whole_body.held_tool import HeldTool
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.tool_curve import ToolCurve
from omniman_ros.planning.whole_body.body_gaps import (
    FAR,
    MOVING,
    NEAR,
    OWN,
    STANDING,
    BodyGaps,
    in_odom,
)
from omniman_ros.planning.whole_body.free_orientation import FreeOrientation
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.parameters import OrientationFreedom
from omniman_ros.planning.whole_body.redundancy import ToolRedundancy
from test.planning.whole_body.support import START, setup, straight

SETUP = setup()
GAPS = BodyGaps(SETUP.description, SETUP.tool, None, 0.1)
MODEL = WholeBodyModel(SETUP.description.mount)


def mixed(seed):
    """Return cells of a map, posts and walls around the robot, and two who walk on."""
    random = np.random.default_rng(seed)
    x, y, yaw = random.uniform(-2.5, 2.5, (3, 60))
    each = [UprightObstacles.box((x[k], y[k], yaw[k]), 0.05, 0.05, (-9, 9)) for k in range(50)]
    each += [UprightObstacles.cylinder(x[k], y[k], 0.1, (0.0, 0.9)) for k in range(50, 55)]
    each += [UprightObstacles.box((x[k], y[k], yaw[k]), 1.0, 0.1, (0, 2)) for k in range(55, 58)]
    walkers = [UprightObstacles.cylinder(x[k], y[k], 0.25, (0.0, 1.8)) for k in (58, 59)]
    moving = MovingObstacles(UprightObstacles.join(walkers), random.uniform(-1, 1, (2, 2)))
    return ObstacleSnapshot(0.0, UprightObstacles.join(each), moving, np.full(2, 0.3))


@pytest.mark.parametrize("seed", range(3))
def test_gaps_to_what_stands_are_exact_where_they_are_near_and_no_larger_elsewhere(seed):
    around, random = mixed(seed), np.random.default_rng(seed)
    poses = np.cumsum(random.uniform(-0.1, 0.1, (30, 3)), axis=0)
    arm = START[3:] + random.uniform(-0.2, 0.2, (30, 6))
    arm[-1] = np.nan  # out of reach
    centre, ages = GAPS.spheres.place(arm).centre, np.linspace(0.0, 2.0, 30)
    exact, parts = (each[:-1] for each in GAPS.to_obstacles(poses, centre, around, ages, math.inf))
    found, found_parts = (
        each[:-1] for each in GAPS.to_obstacles(poses, centre, around, ages, NEAR)
    )
    differs, still = found != exact, len(around.standing)
    assert 0.3 < differs.mean() < 0.95 and differs[:, still:].any()
    assert (found <= exact + 1e-12).all()
    found[:, still:] -= around.growth * ages[:-1, None]
    assert (found[differs] > NEAR).all()
    assert np.array_equal(found_parts[~differs], parts[~differs])
    assert (found_parts[differs] == 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_the_gap_is_that_of_the_nearest_part_to_each_obstacle_where_it_is_then(seed):
    around, random = mixed(seed), np.random.default_rng(seed)
    poses, ages = random.uniform(-0.5, 0.5, (6, 3)), np.linspace(0.0, 2.0, 6)
    placed = GAPS.spheres.place(START[3:] + random.uniform(-0.2, 0.2, (6, 6)))
    gaps, parts = GAPS.to_obstacles(poses, placed.centre, around, ages, math.inf)
    points, still = in_odom(poses, placed.centre), len(around.standing)
    for k in range(6):
        everything = UprightObstacles.join([around.standing, around.moving.after(ages[k])])
        of_arm = point_gap_values(everything, points[k].T) - GAPS.spheres.radius[:, None]
        each = np.vstack([GAPS.platform(poses[k : k + 1], everything), of_arm])
        assert gaps[k] == pytest.approx(each.min(axis=0), abs=1e-12)
        assert np.array_equal(parts[k], each.argmin(axis=0))
    assert (parts[:, :still] == 0).any() and (parts[:, :still] > 0).any()


@pytest.mark.parametrize(("tried", "count"), [(1, 16), (4, 16), (100, 16), (1, 400)])
@pytest.mark.parametrize("seed", range(3))
def test_the_nearest_rows_are_the_same_however_many_obstacles_are_tried_first(
    seed, tried, count, monkeypatch
):
    around = mixed(seed)
    redundancy = ToolRedundancy(MODEL, HeldTool(MODEL.forward(START)), START[3:])
    z = np.column_stack([np.random.default_rng(seed).uniform(-0.1, 0.1, (8, 3)), np.zeros(8)])
    at, ages = redundancy.configurations(z), np.linspace(0.1, 0.8, 8)
    every = GAPS.rows(at, around, ages, 50.0, 1000)
    monkeypatch.setattr("omniman_ros.planning.whole_body.body_gaps.FIRST_TRIED", tried)
    found = GAPS.rows(at, around, ages, 50.0, count)
    for k in range(8):
        order = np.argsort(every.gap[k])[:count]
        mine = np.argsort(found.gap[k])
        assert found.gap[k, mine] == pytest.approx(every.gap[k, order], abs=1e-12)
        assert found.slope[k, mine] == pytest.approx(every.slope[k, order], abs=1e-9)
        assert np.array_equal(found.kind[k, mine], every.kind[k, order])


@pytest.mark.parametrize("seed", range(3))
def test_the_rows_within_a_reach_are_the_same_whatever_is_beyond(seed):
    around, reach = mixed(seed), 0.5
    redundancy = ToolRedundancy(MODEL, HeldTool(MODEL.forward(START)), START[3:])
    z = np.column_stack([np.random.default_rng(seed).uniform(-0.1, 0.1, (8, 3)), np.zeros(8)])
    at, ages = redundancy.configurations(z), np.linspace(0.1, 0.8, 8)
    whole, found = (GAPS.rows(at, around, ages, each, 40) for each in (50.0, reach))
    for k in range(8):
        a, b = (np.sort(rows.gap[k][rows.gap[k] <= reach]) for rows in (whole, found))
        assert len(a) > 5 and a == pytest.approx(b, abs=1e-12)
        assert (np.sort(found.gap[k])[len(a) :] == FAR).all()


@pytest.mark.parametrize("cone", [0.0, 0.4])
def test_derivatives_by_free_coordinates_are_those_of_differences(cone):
    around, step = mixed(0), 1e-6
    free = FreeOrientation(OrientationFreedom("x", cone, 0.1))
    path, begin = free.path_of(MODEL.forward(START), straight(0.6))
    redundancy = ToolRedundancy(MODEL, ToolCurve(path, SETUP.path), START[3:], free)
    z = np.random.default_rng(1).uniform(-0.1, 0.1, (6, 4 + len(begin)))
    z[:, [0, 3]] += 0.3
    ages = np.linspace(0.1, 0.6, 6)

    def rows(coordinates):
        # With more rows than gaps, they have one order at all configurations.
        at = redundancy.configurations(coordinates)
        return GAPS.rows(at, around, ages, 50.0, 1000)

    found = rows(z)
    assert set(found.kind[found.gap < FAR].tolist()) == {OWN, STANDING, MOVING}
    moved = np.stack(
        [rows(z + nudge).gap - rows(z - nudge).gap for nudge in step * np.eye(z.shape[1])], axis=-1
    )
    assert moved / (2.0 * step) == pytest.approx(found.slope, abs=1e-7)
    assert np.abs(found.slope[..., 4:]).max(axis=(0, 1)).min() > 0.05
