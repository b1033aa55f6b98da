import itertools
import math

import numpy as np
import pytest

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.obstacles.walls import CHUNK, COARSE, MAX_COMPUTED_GAP, Walls

HALF = np.array([0.4, 0.25])
BOX = Rectangles.centred(HALF)


def some_walls(random, count=60, spread=3.0, radius=0.036):
    return Walls(random.uniform(-spread, spread, (count, 2)), radius)


def some_poses(random, count=100, spread=3.5):
    return random.uniform(-1.0, 1.0, (count, 3)) * [spread, spread, 7.0]


def true_gaps(walls, poses, half=HALF):
    """Return the gap of each rectangle to each disc, one by one; negative inside."""
    result = []
    for x, y, theta in poses.tolist():
        least = math.inf
        for cx, cy in walls.centers.tolist():
            ahead = math.cos(theta) * (cx - x) + math.sin(theta) * (cy - y)
            aside = math.cos(theta) * (cy - y) - math.sin(theta) * (cx - x)
            over = abs(ahead) - half[0], abs(aside) - half[1]
            if max(over) <= 0.0:
                distance = max(over)
            else:
                distance = math.hypot(max(over[0], 0.0), max(over[1], 0.0))
            least = min(least, distance - walls.radius)
        result.append(least)
    return np.array(result)


def a_swing(random, count=13, step=0.1):
    """Return a motion with constant acceleration between nodes."""
    velocities = np.cumsum(random.uniform(-0.15, 0.15, (count, 3)) * [1, 1, 2], axis=0)
    velocities += random.uniform(-0.7, 0.7, 3)
    middle = 0.5 * (velocities[:-1] + velocities[1:])
    first = random.uniform(-1.5, 1.5, 3)
    poses = np.vstack([first, first + step * np.cumsum(middle, axis=0)])
    return HermiteTrajectory(step * np.arange(count), poses, velocities, np.zeros((count - 1, 4)))


@pytest.mark.parametrize("seed", range(3))
def test_gaps_are_exact_up_to_their_reach(seed):
    random = np.random.default_rng(seed)
    walls, poses = some_walls(random), some_poses(random)
    expected = true_gaps(walls, poses)
    found = walls.gaps(poses, BOX)
    np.testing.assert_allclose(found, np.minimum(expected, MAX_COMPUTED_GAP), atol=1e-12)
    assert (expected > MAX_COMPUTED_GAP).any() and (expected < 0.0).any()


def test_gap_to_one_disc_matches_values_computed_by_hand():
    walls = Walls(np.array([[1.0, 0.0]]), 0.05)
    poses = np.array(
        [
            [0.4, 0.0, 0.0],  # ahead
            [1.0, -0.4, 0.0],  # at the side
            [1.0, -0.55, 0.5 * math.pi],  # ahead, rotated
            [1.0 - 0.4 - 0.03, 0.25 + 0.04, 0.0],  # off a corner
            [0.7, 0.0, math.tau],  # its centre is 10 cm within
            [-9.0, 0.0, 0.0],
        ]
    )
    np.testing.assert_allclose(
        walls.gaps(poses, BOX), [0.15, 0.1, 0.1, 0.0, -0.15, MAX_COMPUTED_GAP], atol=1e-12
    )
    far = np.tile(poses[-1], (CHUNK, 1))
    np.testing.assert_array_equal(walls.gaps(far, BOX), MAX_COMPUTED_GAP)
    assert walls.gaps(np.vstack([far, poses]), BOX)[CHUNK] == pytest.approx(0.15)


@pytest.mark.parametrize("count", [1, CHUNK - 1, CHUNK, CHUNK + 1, 3 * CHUNK + 5])
def test_gap_of_a_pose_does_not_depend_on_other_poses(count):
    random = np.random.default_rng(count)
    walls, poses = some_walls(random, 2000), some_poses(random, count)
    alone = [walls.gaps(pose[None], BOX)[0] for pose in poses]
    np.testing.assert_array_equal(walls.gaps(poses, BOX), alone)


def test_gaps_to_many_discs_are_exact():
    random = np.random.default_rng(4)
    walls = some_walls(random, 60_000, spread=60.0, radius=0.01)
    poses = some_poses(random, 30, spread=50.0)
    near = np.hypot(*(walls.centers[None] - poses[:, None, :2]).transpose(2, 0, 1)) < 1.2
    expected = [
        true_gaps(Walls(walls.centers[beside], walls.radius), pose[None])[0]
        for pose, beside in zip(poses, near, strict=True)
    ]
    np.testing.assert_allclose(
        walls.gaps(poses, BOX), np.minimum(expected, MAX_COMPUTED_GAP), atol=1e-12
    )


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_pose_that_is_not_finite_has_no_gap_and_does_not_affect_others(bad):
    walls = Walls(np.array([[1.0, 0.0]]), 0.05)
    good = np.array([[0.4, 0.0, 0.0], [1.0, 0.0, 0.0]])
    for axis in range(3):
        poses = np.vstack([good, good])
        poses[2, axis] = bad
        found = walls.gaps(poses, BOX)
        np.testing.assert_allclose(found[[0, 1, 3]], [0.15, -0.3, -0.3])
        assert found[2] == -math.inf
        assert Walls.none().gaps(poses, BOX)[2] == -math.inf


def test_gaps_without_walls_or_poses_are_defined():
    none = Walls.none()
    assert len(none) == 0 and len(none.ellipses(1.0)) == 0 and len(none.near(np.zeros(2), 9)) == 0
    np.testing.assert_array_equal(none.gaps(np.zeros((3, 3)), BOX), [MAX_COMPUTED_GAP] * 3)
    assert Walls(np.zeros((1, 2)), 0.1).gaps(np.zeros((0, 3)), BOX).shape == (0,)
    assert none.gaps(np.zeros((0, 3)), BOX).shape == (0,)


def test_near_selects_discs_in_a_square():
    walls = Walls(np.array([[0.0, 0.0], [1.0, -1.0], [1.001, 0.0], [-5.0, 0.0]]), 0.2)
    near = walls.near(np.array([0.0, 0.0, 9.0]), 1.0)
    np.testing.assert_array_equal(near.centers, [[0.0, 0.0], [1.0, -1.0]])
    assert near.radius == 0.2 and len(near) == 2


def test_walls_as_ellipses_are_at_rest():
    walls = some_walls(np.random.default_rng(5), 7)
    known = walls.ellipses(3.0)
    assert len(known) == 7 and known.time == 3.0
    later = np.array([3.0, 90.0])
    np.testing.assert_array_equal(known.centers_at(later), [walls.centers] * 2)
    np.testing.assert_array_equal(known.axes_at(later, 0.0), np.full((2, 7, 2), walls.radius))


@pytest.mark.parametrize("seed", range(6))
def test_swept_gap_is_a_lower_bound_of_fine_samples(seed):
    random = np.random.default_rng(seed)
    walls, motion = some_walls(random, 25), a_swing(random)
    times, poses, velocities = motion.fine(0.0, -math.inf, 4)
    nodes, between = walls.swept(times, poses, velocities, BOX)
    assert between.shape == (len(times) - 1,)
    np.testing.assert_allclose(nodes, walls.gaps(poses, BOX))
    for k, (first, last) in enumerate(itertools.pairwise(times)):
        fine = walls.gaps(motion.at(np.linspace(first, last, 30))[0], BOX)
        assert between[k] <= fine.min() + 1e-12
        # The bound is conservative by at most the distance travelled meanwhile.
        moved = np.abs(velocities[k : k + 2]).max(axis=0) @ [1.0, 1.0, np.hypot(*HALF)]
        assert between[k] >= fine.min() - 1.5 * (last - first) * moved


def test_speed_that_is_not_finite_has_no_bound():
    walls = Walls(np.array([[5.0, 0.0]]), 0.05)
    velocities = np.zeros((3, 3))
    velocities[1, 0] = math.nan
    _, between = walls.swept(np.arange(3.0), np.zeros((3, 3)), velocities, BOX)
    assert not (between > 0.0).any()


@pytest.mark.parametrize("seed", range(6))
def test_bounds_above_what_is_enough_may_be_coarse_but_no_gap_below_is_missed(seed):
    random = np.random.default_rng(seed)
    walls, motion = some_walls(random, 25), a_swing(random)
    times, poses, velocities = motion.fine(0.0, -math.inf, 4 * COARSE)
    exact, exact_between = walls.swept(times, poses, velocities, BOX)
    for enough in (-0.1, 0.02, 0.2):
        nodes, between = walls.swept(times, poses, velocities, BOX, enough)
        np.testing.assert_array_equal(between > enough, exact_between > enough)
        near = exact_between <= enough
        np.testing.assert_array_equal(between[near], exact_between[near])
        np.testing.assert_array_equal(nodes[1:][near], exact[1:][near])
        np.testing.assert_array_equal(between[:COARSE], exact_between[:COARSE])
        assert (between <= exact_between + 1e-12).all()
