import math

import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.obstacles.separation import outside_by
from omniman_ros.planning.safety import MARGIN_TOLERANCE, Surroundings
from test.planning.support import ellipses, true_gaps

HALF = np.array([0.4, 0.25])
WIDE = (-9.0, -9.0, 9.0, 9.0)
DECELERATION = (1.5, 4.0)
NOW = 5.0


def around(known=None, margin=0.02, workspace=WIDE):
    return Surroundings(
        Footprint(Rectangles.centred(HALF)),
        ellipses() if known is None else known,
        workspace,
        margin,
    )


def a_motion(random, count=21, step=0.1):
    """Return a motion of constant accelerations, each for half a second."""
    acceleration = np.repeat(random.uniform(-1, 1, (5, 3)) * [1, 1, 2], 5, axis=0)
    velocities, poses = np.zeros((count, 3)), np.zeros((count, 3))
    velocities[0] = random.uniform(-0.8, 0.8, 3)
    for k in range(count - 1):
        velocities[k + 1] = velocities[k] + step * acceleration[k]
        poses[k + 1] = poses[k] + step * velocities[k] + 0.5 * step**2 * acceleration[k]
    return HermiteTrajectory(
        NOW + step * np.arange(count), poses, velocities, np.zeros((count - 1, 4))
    )


def a_line(*velocity, start=(0.0, 0.0, 0.0), seconds=2.0):
    """Return a motion at a constant velocity."""
    times = np.arange(0.0, seconds + 1e-9, 0.1)
    poses = np.array(start) + times[:, None] * np.array(velocity, float)
    velocities = np.tile(np.array(velocity, float), (len(times), 1))
    return HermiteTrajectory(NOW + times, poses, velocities, np.zeros((len(times) - 1, 4)))


def some_obstacles(random, count=6):
    rows = [
        (*random.uniform(-2.5, 2.5, 2), *random.uniform(0.1, 0.5, 2), random.uniform(-3, 3))
        for _ in range(count)
    ]
    return ellipses(*rows, time=NOW, velocities=random.uniform(-0.8, 0.8, (count, 2)))


def closest(motion, known, first=NOW):
    """Return the minimum true gap of a finely sampled motion."""
    times = np.arange(first, max(motion.end, first + 0.1), 0.01)
    return true_gaps(times, motion.at(times)[0], HALF, known)


# ---- contact ----------------------------------------------------------------------------------


def test_time_of_contact_matches_dense_samples():
    random = np.random.default_rng(1)
    touched = free = early = 0
    for _ in range(90):
        motion, known = a_motion(random).braked(NOW + 2.0, DECELERATION), some_obstacles(random)
        if true_gaps(np.array([NOW]), motion.poses[:1], HALF, known).min() < 0.1:
            continue
        contact = around(known, margin=0.0).contact(motion, NOW)
        gaps = closest(motion, known).min(axis=1)
        if (gaps <= 0.0).any():
            sampled = NOW + 0.01 * np.argmax(gaps <= 0.0)
            assert contact <= sampled
            early += contact < sampled - 0.1
            touched += 1
        elif gaps.min() > 0.05:
            free += contact == math.inf
            early += contact < math.inf
    assert touched > 15 and free > 15
    assert early <= 3  # the bound is conservative, but only slightly


def test_thin_obstacle_between_two_samples_is_found():
    # At 10 m/s the box moves 25 cm between two samples.
    motion = a_line(10.0, 0.0, 0.0, seconds=1.0)
    for x in np.linspace(1.0, 8.0, 29):
        contact = around(ellipses((x, 0.0, 0.005))).contact(motion, NOW)
        assert contact <= NOW + (x - 0.405) / 10.0
        assert contact > NOW + (x - 0.405) / 10.0 - 0.1


def test_fast_small_obstacle_between_two_samples_is_found():
    motion = a_line(0.5, 0.0, 0.0)
    for speed in (5.0, 20.0, 60.0):
        for meets in np.linspace(0.2, 1.7, 16):
            known = ellipses(
                (0.5 * meets, -speed * meets, 0.02), time=NOW, velocities=[(0.0, speed)]
            )
            assert around(known).contact(motion, NOW) <= NOW + meets
            passes = ellipses((3.0, -speed * meets, 0.02), time=NOW, velocities=[(0.0, speed)])
            assert around(passes).contact(motion, NOW) == math.inf


def test_corner_that_rotates_into_an_obstacle_is_found():
    # The box is clear at both ends of a quarter turn, but its corner is not in between.
    times = np.array([0.0, 1.0])
    turn = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5 * math.pi]])
    motion = HermiteTrajectory(
        NOW + times, turn, np.tile([0, 0, 0.5 * math.pi], (2, 1)), np.zeros((1, 4))
    )
    corner = np.hypot(*HALF) * np.sqrt(0.5)
    known = ellipses((corner + 0.02, corner + 0.02, 0.05))
    assert true_gaps(times, turn, HALF, known).min() > 0.05
    assert around(known, margin=0.0).contact(motion, NOW) < NOW + 1.0


def test_margins_grow_with_the_time_ahead():
    motion = a_line(0.5, 0.0, 0.0)
    beside = ellipses((1.0, 0.75, 0.3), time=NOW)
    assert around(beside).contact(motion, NOW) == math.inf
    assert around(beside, margin=0.25).contact(motion, NOW) < math.inf
    growing = ellipses((1.0, 0.75, 0.3), time=NOW, growth=0.3)
    assert around(growing).contact(motion, NOW) < math.inf


def test_leaving_the_workspace_is_a_contact_at_that_time():
    motion = a_line(0.5, 0.0, 0.0)
    contact = around(workspace=(-9, -9, 1.0, 9), margin=0.02).contact(motion, NOW)
    assert contact == pytest.approx(NOW + (1.0 - 0.42) / 0.5, abs=0.026)
    turning = a_line(0.0, 0.0, 1.0)
    contact = around(workspace=(-9, -9, 0.45, 9), margin=0.0).contact(turning, NOW)
    times = np.arange(0.0, 2.0, 0.001)
    poses = np.column_stack([0 * times, 0 * times, times])
    outside = outside_by(poses, Rectangles.centred(HALF), (-9, -9, 0.45, 9))
    sampled = NOW + times[np.argmax(outside > 0.0)]
    assert contact == pytest.approx(sampled, abs=0.026)


def test_input_that_is_not_finite_is_a_contact():
    motion = a_line(0.5, 0.0, 0.0)
    poses = motion.poses.copy()
    poses[5, 1] = math.nan
    broken = HermiteTrajectory(motion.times, poses, motion.velocities, motion.currents)
    assert around().contact(broken, NOW) <= NOW + 0.5
    unknown = ellipses((math.nan, 0.0, 0.2), (5.0, 5.0, 0.2))
    assert around(unknown).contact(motion, NOW) < math.inf


@pytest.mark.parametrize("until", [-math.inf, NOW + 4.0])
def test_approaching_obstacle_hits_a_robot_at_rest(until):
    motion = HermiteTrajectory.rest(NOW - 1.0, np.zeros(3), 4)
    known = ellipses((2.7, 0.0, 0.3), time=NOW, velocities=[(-1.0, 0.0)])
    stands = Surroundings(Footprint(Rectangles.centred(HALF)), known, WIDE, 0.0, until)
    contact = stands.contact(motion, NOW)
    assert contact == pytest.approx(NOW + 2.0, abs=0.11) if until > 0 else contact == math.inf


# ---- too close already ------------------------------------------------------------------------


def test_robot_too_close_may_leave_but_not_come_closer():
    for x in (0.71, 0.6, 0.45):  # clear by 1 cm, or inside
        known = ellipses((x, 0.0, 0.3))
        assert around(known).contact(a_line(-0.5, 0.0, 0.0), NOW) == math.inf
        stays = HermiteTrajectory.rest(NOW, np.zeros(3), 4)
        assert around(known).contact(stays, NOW) == math.inf
        closer = a_line(0.2, 0.0, 0.0, seconds=0.5)
        assert around(known).contact(closer, NOW) <= NOW + 0.2


def test_small_approaches_do_not_add_up():
    known, x = ellipses((1.0, 0.0, 0.3)), 0.0
    for _ in range(300):
        step = a_line(0.05, 0.0, 0.0, start=(x, 0.0, 0.0), seconds=0.2)
        if around(known).contact(step, NOW) < math.inf:
            break
        x = step.poses[-1, 0]
    assert 0.3 - 0.02 - 0.02 < x <= 0.3  # contact is at 0.3
    # Nor do the smallest approaches of a robot deep inside an obstacle.
    x = 0.35
    step = a_line(0.001, 0.0, 0.0, start=(x, 0.0, 0.0), seconds=0.2)
    assert around(known).contact(step, NOW) < math.inf


def test_robot_outside_the_workspace_may_return():
    out = around(workspace=(-9, -9, 0.3, 9))
    assert out.contact(a_line(-0.5, 0.0, 0.0), NOW) == math.inf
    assert out.contact(a_line(0.5, 0.0, 0.0), NOW) < NOW + 0.2


# ---- current pose -----------------------------------------------------------------------------


def test_overlap_and_outside_are_depths():
    poses = np.zeros((1, 3))
    assert around(ellipses((1.0, 0.0, 0.3))).overlap(poses) == pytest.approx(-0.28)
    assert around(ellipses((0.5, 0.0, 0.3))).overlap(poses) > 0.1
    assert around().overlap(poses) == -math.inf
    assert around(workspace=(-1, -1, 1, 1)).outside(poses) == pytest.approx(-0.6 + 0.02)
    assert around(workspace=(-1, -1, 0.3, 1)).outside(poses) == pytest.approx(0.12)
    assert MARGIN_TOLERANCE <= 0.02


def test_what_is_touched_already_does_not_hide_what_would_be_touched_next():
    """A track that overlaps the robot is behind it; a post is 0.5 m ahead."""
    known = ellipses((-0.4, 0.0, 0.2, 0.2, 0.0), (1.0, 0.0, 0.1, 0.1, 0.0), time=NOW)
    ahead, _ = around(known).threat(a_line(1.0, 0.0, 0.0), NOW)
    assert ahead == pytest.approx(NOW + 0.5, abs=0.11)
    aside, wider = around(known).threat(a_line(0.3, 0.0, 0.0, seconds=1.0), NOW)
    assert aside == math.inf and wider < 0.0
