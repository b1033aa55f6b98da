"""Static environment for routes, and walls in the final check of motions."""

import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.obstacles.environment import Environment
from omniman_ros.planning.obstacles.walls import Walls
from omniman_ros.planning.safety import MARGIN_TOLERANCE, Surroundings
from test.planning.support import ellipses, true_gaps
from test.planning.test_motion_choice import longest

HALF = np.array([0.4, 0.25])
FOOTPRINT = Footprint(Rectangles.centred(HALF))
BOX = FOOTPRINT.whole
WIDE = (-9.0, -9.0, 9.0, 9.0)
DECELERATION = (1.5, 4.0)
NOW = 5.0
MARGIN = 0.02
RADIUS = 0.036  #: Of a disc that covers a cell of 5 cm


def a_wall(*ends):
    """Return a wall of discs 5 cm apart through the given points."""
    first, last = np.array(ends, float)
    count = round(float(np.hypot(*(last - first))) / 0.05) + 1
    fraction = np.linspace(0.0, 1.0, count)[:, None]
    return Walls(first + fraction * (last - first), RADIUS)


AHEAD = a_wall((1.5, -1.0), (1.5, 1.0))


def around(walls=AHEAD, known=None, margin=MARGIN, until=-math.inf):
    known = ellipses() if known is None else known
    return Surroundings(FOOTPRINT, known, WIDE, margin, until, walls)


def a_line(*velocity, start=(0.0, 0.0, 0.0), seconds=2.0):
    """Return a motion at a constant velocity."""
    times = np.arange(0.0, seconds + 1e-9, 0.1)
    poses = np.array(start) + times[:, None] * np.array(velocity, float)
    velocities = np.tile(np.array(velocity, float), (len(times), 1))
    return HermiteTrajectory(NOW + times, poses, velocities, np.zeros((len(times) - 1, 4)))


def a_stop(*velocity, start=(0.0, 0.0, 0.0), seconds=2.0):
    """Return a motion at a constant velocity that then brakes to rest."""
    motion = a_line(*velocity, start=start, seconds=seconds)
    return motion.braked(motion.end, DECELERATION)


def test_gap_is_to_the_nearest_of_walls_obstacles_and_workspace():
    random = np.random.default_rng(1)
    known = ellipses((2.0, 2.0, 0.3), (-2.0, 1.0, 0.5, 0.2, 0.4))
    walls = a_wall((-3.0, -2.0), (3.0, -2.0))
    poses = random.uniform(-1.0, 1.0, (200, 3)) * [3.5, 3.5, 4.0]
    room = (-3.2, -3.2, 3.2, 3.2)
    found = Environment(FOOTPRINT, known, room, None, walls).gaps(poses, 0.2)
    parts = (
        Environment(FOOTPRINT, known, WIDE, None, Walls.none()).gaps(poses, 0.2),
        Environment(FOOTPRINT, ellipses(), room, None, Walls.none()).gaps(poses, 0.2),
        walls.gaps(poses, BOX),
    )
    # Walls beyond their reach report that reach; nearer objects are still exact.
    np.testing.assert_allclose(np.minimum(found, 0.2), np.minimum(np.min(parts, axis=0), 0.2))
    nearest = np.argmin(parts, axis=0)[found < 0.2]
    assert set(nearest.tolist()) == {0, 1, 2}, "each of them counts somewhere"


def test_contact_of_a_motion_into_a_wall_is_at_the_time_of_arrival():
    for start in (0.0, 0.6, 0.95):
        motion = a_stop(0.3, 0.0, 0.0, start=(start, 0.0, 0.0), seconds=5.0)
        contact = around().contact(motion, NOW)
        touches = (1.5 - RADIUS - MARGIN - HALF[0] - start) / 0.3
        assert NOW + touches - 0.03 < contact <= NOW + touches
        assert around(Walls.none()).contact(motion, NOW) == math.inf


@pytest.mark.parametrize("gap", [0.003, 0.02])
def test_motion_along_a_wall_is_clear_down_to_the_margin(gap):
    wall = a_wall((-1.0, 0.25 + RADIUS + MARGIN + gap), (4.0, 0.25 + RADIUS + MARGIN + gap))
    assert around(wall).contact(a_stop(0.85, 0.0, 0.0), NOW) == math.inf
    # With a slight rotation, it reaches the wall.
    assert around(wall).contact(a_stop(0.85, 0.05, 0.0), NOW) < math.inf


@pytest.mark.parametrize("seed", range(4))
def test_time_of_contact_matches_dense_samples(seed):
    random = np.random.default_rng(seed)
    touched = free = early = 0
    for _ in range(12):
        walls = Walls(random.uniform(-2.0, 2.0, (12, 2)), RADIUS)
        motion = a_stop(*random.uniform(-0.8, 0.8, 2), random.uniform(-1.5, 1.5))
        times = np.arange(NOW, motion.end, 0.005)
        gaps = walls.gaps(motion.at(times)[0], BOX)
        if gaps[0] < 0.1:
            continue
        contact = around(walls, margin=0.0).contact(motion, NOW)
        if (gaps <= -1e-6).any():
            sampled = float(times[int(np.argmax(gaps <= 0.0))])
            assert contact <= sampled + 1e-9
            early += contact < sampled - 0.1
            touched += 1
        elif gaps.min() > 0.03:
            assert contact == math.inf
            free += 1
    assert touched + free > 3 and touched > 0 and early <= 1


def test_robot_that_is_too_close_may_leave_but_not_come_closer():
    for gap in (0.015, 0.005, 0.0, -0.05):
        x = 1.5 - RADIUS - HALF[0] - gap
        start = (x, 0.0, 0.0)
        away = a_stop(-0.3, 0.0, 0.0, start=start)
        assert around().contact(away, NOW) == math.inf, gap
        closer = around().contact(a_stop(0.3, 0.0, 0.0, start=start), NOW)
        assert closer <= NOW + max(gap, 0.0) / 0.3 + 0.1, gap
        back = around().contact(a_stop(-0.3, 0.0, 0.0, start=start, seconds=0.5), NOW)
        assert back == math.inf


def test_repeated_small_approaches_to_a_wall_end_before_contact():
    """Approach the wall a little every cycle: the approach ends before contact."""
    x, speed = 1.5 - RADIUS - HALF[0] - MARGIN, 0.01
    for _ in range(60):
        motion = a_stop(speed, 0.0, 0.0, start=(x, 0.0, 0.0), seconds=1.0)
        if around().contact(motion, NOW) < math.inf:
            break
        x += 0.1 * speed
    assert x < 1.5 - RADIUS - HALF[0] - MARGIN + MARGIN_TOLERANCE + 1e-3
    assert a_wall((1.5, -1.0), (1.5, 1.0)).gaps(np.array([[x, 0, 0]]), BOX)[0] > -1e-3


def test_walls_far_from_the_motion_cause_no_contact():
    random = np.random.default_rng(3)
    far = Walls(random.uniform(3.5, 60.0, (4000, 2)), RADIUS)
    both = Walls(np.vstack([AHEAD.centers, far.centers]), RADIUS)
    for motion in (a_stop(0.8, 0.0, 0.0), a_stop(-0.8, 0.1, 0.5), a_stop(0.3, 0.6, 0.0)):
        assert around(far).contact(motion, NOW) == math.inf
        assert around(both).contact(motion, NOW) == around(AHEAD).contact(motion, NOW)
        assert around(both).threat(motion, NOW) == around(AHEAD).threat(motion, NOW)


def test_robot_at_rest_next_to_a_wall_has_no_contact():
    for gap in (0.1, 0.001, -0.01):
        still = HermiteTrajectory.rest(NOW, np.array([1.5 - RADIUS - HALF[0] - gap, 0.0, 0.0]), 4)
        assert around(until=NOW + 2.0).contact(still, NOW) == math.inf


def test_robot_localised_inside_a_wall_may_leave_on_either_side():
    """After a relocalisation into a wall, the robot must not be trapped there."""
    inside = (1.5, 0.2, 0.3)
    for velocity in ((-0.5, 0.0, 0.0), (0.5, 0.0, 0.0)):
        motion = a_stop(*velocity, start=inside, seconds=3.0)
        assert around().contact(motion, NOW) == math.inf
    # With its centre on one side of the wall, it may leave on that side only.
    for velocity, clear in ((-0.5, True), (0.5, False)):
        motion = a_stop(velocity, 0.0, 0.0, start=(1.2, 0.2, 0.0), seconds=3.0)
        assert (around().contact(motion, NOW) == math.inf) == clear


def test_overlap_counts_walls_and_obstacles():
    at = np.array([[1.5 - RADIUS - HALF[0] - 0.01, 0.0, 0.0]])
    assert around().overlap(at) == pytest.approx(MARGIN - 0.01)
    assert around(margin=0.0).overlap(at) == pytest.approx(-0.01)
    known = ellipses((at[0, 0], 0.25 + 0.3 - 0.1, 0.3))
    assert around(known=known).overlap(at) > 0.1
    aside = ellipses((-3.0, 0.0, 0.3))
    assert around(known=aside).overlap(at) == pytest.approx(MARGIN - 0.01)
    assert around(Walls.none()).overlap(at) == -math.inf
    assert around(Walls.none(), known).overlap(at) == around(known=known).overlap(at)


def test_threat_of_a_wall_is_the_time_of_contact_without_margin():
    motion = a_stop(0.8, 0.0, 0.0)
    touches = NOW + (1.5 - RADIUS - HALF[0]) / 0.8
    contact, gap = around().threat(motion, NOW)
    assert touches - 0.06 < contact <= touches and gap <= 0.0
    # The sooner of wall and obstacle is reported.
    soon = ellipses((0.9, 0.0, 0.1), time=NOW)
    sooner, _ = around(known=soon).threat(motion, NOW)
    assert sooner < contact and sooner == around(Walls.none(), soon).threat(motion, NOW)[0]
    late = ellipses((1.9, 0.0, 0.1), time=NOW)
    assert around(known=late).threat(motion, NOW) == (contact, gap)
    assert around().threat(a_stop(-0.8, 0.0, 0.0), NOW) == (math.inf, MARGIN_TOLERANCE)


def test_longest_clear_part_ends_before_the_wall():
    motion = a_line(0.8, 0.0, 0.0)
    found = longest(around(), motion, NOW)
    assert found is not None
    end = found.poses[-1, 0]
    free = 1.5 - RADIUS - MARGIN - HALF[0]
    assert free - 0.2 < end <= free
    assert not found.velocities[-1].any()
    whole = longest(around(), a_line(-0.8, 0.0, 0.0), NOW)
    assert whole is not None and whole.end > NOW + 2.0
    assert longest(around(), a_line(2.5, 0.0, 0.0), NOW + 0.2) is None


def test_motion_that_is_not_finite_is_never_clear():
    for row in (0, 7):
        motion = a_stop(0.1, 0.0, 0.0)
        poses = motion.poses.copy()
        poses[row, 0] = math.nan
        motion = replace(motion, poses=poses)
        assert around().contact(motion, NOW) < math.inf
        assert around()._at_wall(motion, NOW, MARGIN) < math.inf


def test_walls_give_the_same_result_as_their_discs():
    """Compare with the same discs as standing obstacles: both find the same contacts."""
    random = np.random.default_rng(8)
    clear = 0
    for _ in range(60):
        walls = Walls(random.uniform(-2.0, 2.0, (6, 2)), RADIUS)
        motion = a_stop(*random.uniform(-0.8, 0.8, 2), 0.0)
        if walls.gaps(motion.poses[:1], BOX)[0] < 0.1:
            continue
        as_walls = around(walls).contact(motion, NOW)
        discs = walls.ellipses(NOW)
        as_discs = around(Walls.none(), discs).contact(motion, NOW)
        times = np.arange(NOW, motion.end, 0.02)
        least = true_gaps(times, motion.at(times)[0], HALF, discs).min()
        if abs(least - MARGIN) > 0.015:
            assert (as_walls == math.inf) == (as_discs == math.inf)
            clear += as_walls == math.inf
    assert 5 < clear < 50
