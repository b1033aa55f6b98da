import numpy as np
import pytest

from omniman_ros.planning.cycle import MeasuredState
from omniman_ros.planning.motion import BRAKING_STEP, HermiteTrajectory

DECELERATION = (1.5, 4.0)


def a_motion(seed=0, count=9, step=0.1, start=5.0, wheels=4):
    """Return a motion with constant acceleration between its nodes."""
    random = np.random.default_rng(seed)
    acceleration = random.uniform(-1, 1, (count - 1, 3)) * [1, 1, 2]
    velocities = np.vstack([random.uniform(-0.7, 0.7, 3), np.zeros((count - 1, 3))])
    poses = np.vstack([random.uniform(-2, 2, 3), np.zeros((count - 1, 3))])
    for k, a in enumerate(acceleration):
        velocities[k + 1] = velocities[k] + step * a
        poses[k + 1] = poses[k] + step * velocities[k] + 0.5 * step**2 * a
    times = start + step * np.arange(count)
    return HermiteTrajectory(times, poses, velocities, random.uniform(-5, 5, (count - 1, wheels)))


def dense(motion, first=None, last=None, count=2001):
    times = np.linspace(first or motion.start, last or motion.end, count)
    return times, *motion.at(times)


def assert_continuous(motion, first, last, speed=3.0, acceleration=6.0):
    """Assert that pose and velocity are continuous within the motion."""
    times, poses, velocities = dense(motion, first, last)
    tick = times[1] - times[0]
    assert np.abs(np.diff(poses, axis=0)).max() < speed * tick
    inner = (times[1:] <= motion.end) & (times[:-1] >= motion.start)
    assert np.abs(np.diff(velocities, axis=0)[inner]).max() < acceleration * tick + 1e-9


def test_motion_meets_its_nodes_and_constant_acceleration_between_them():
    motion = a_motion()
    poses, velocities = motion.at(motion.times)
    np.testing.assert_allclose(poses, motion.poses, atol=1e-12)
    np.testing.assert_allclose(velocities, motion.velocities, atol=1e-12)
    k, t = 3, 0.037
    pose, velocity = motion.sample(motion.times[k] + t)
    a = (motion.velocities[k + 1] - motion.velocities[k]) / 0.1
    np.testing.assert_allclose(velocity, motion.velocities[k] + a * t, atol=1e-9)
    expected = motion.poses[k] + motion.velocities[k] * t + 0.5 * a * t * t
    np.testing.assert_allclose(pose, expected, atol=1e-9)


def test_velocity_is_the_derivative_of_the_pose():
    motion = a_motion(1)
    bent = HermiteTrajectory(motion.times, motion.poses, 1.3 * motion.velocities, motion.currents)
    times = np.linspace(motion.start + 1e-3, motion.end - 1e-3, 37)
    tiny = 1e-6
    slopes = (bent.at(times + tiny)[0] - bent.at(times - tiny)[0]) / (2 * tiny)
    np.testing.assert_allclose(bent.at(times)[1], slopes, atol=1e-5)


def test_motion_rests_before_its_start_and_after_its_end():
    motion = a_motion()
    for time, node in ((motion.start - 3.0, 0), (motion.end + 3.0, -1)):
        pose, velocity = motion.sample(time)
        np.testing.assert_allclose(pose, motion.poses[node])
        np.testing.assert_array_equal(velocity, np.zeros(3))
        assert np.isnan(motion.currents_at(time)).all()


def test_currents_are_constant_between_nodes():
    motion = a_motion()
    np.testing.assert_array_equal(motion.currents_at(motion.times[2]), motion.currents[2])
    np.testing.assert_array_equal(motion.currents_at(motion.times[3] - 1e-9), motion.currents[2])
    assert motion.currents_at(motion.end).shape == (4,)


def test_states_are_transformed_to_odom():
    states = np.array([[1.0, 2.0, 0.5, 0.6, -0.2, 0.3], [1.1, 2.1, np.pi / 2, 0.5, 0.1, 0.0]])
    motion = HermiteTrajectory.of_states(3.0, 0.1, states, np.zeros((1, 4)))
    np.testing.assert_allclose(motion.times, [3.0, 3.1])
    np.testing.assert_allclose(motion.poses, states[:, :3])
    np.testing.assert_allclose(motion.velocities[1], [-0.1, 0.5, 0.0], atol=1e-12)
    c, s = np.cos(0.5), np.sin(0.5)
    np.testing.assert_allclose(motion.velocities[0], [0.6 * c + 0.2 * s, 0.6 * s - 0.2 * c, 0.3])


@pytest.mark.parametrize("seed", range(6))
def test_braking_keeps_the_deceleration_and_ends_at_rest(seed):
    motion = a_motion(seed)
    time = motion.start + 0.33
    braked = motion.braked(time, DECELERATION)
    before = np.linspace(motion.start, time, 50)
    np.testing.assert_allclose(braked.at(before)[0], motion.at(before)[0], atol=1e-9)
    pose, velocity = motion.sample(time)
    speed, turning = np.hypot(*velocity[:2]), abs(velocity[2])
    longest = max(speed / 1.5, turning / 4.0)
    assert braked.end == pytest.approx(time + longest)
    np.testing.assert_allclose(braked.velocities[-1], 0.0, atol=1e-9)
    times, poses, velocities = dense(braked, time, braked.end, 400)
    slowed = -np.diff(np.hypot(velocities[:, 0], velocities[:, 1])) / np.diff(times)
    assert slowed.max() < 1.5 * 1.001 and slowed.min() > -1e-6
    turned = -np.diff(np.abs(velocities[:, 2])) / np.diff(times)
    assert turned.max() < 4.0 * 1.001 and turned.min() > -1e-6
    # On a straight line by v^2 / 2a, turning in the same sense by w^2 / 2a.
    way = velocity[:2] / speed * speed**2 / 3.0
    np.testing.assert_allclose(poses[-1, :2] - pose[:2], way, atol=1e-9)
    assert poses[-1, 2] - pose[2] == pytest.approx(velocity[2] * turning / 8.0)
    assert_continuous(braked, motion.start - 0.2, braked.end + 0.5)
    assert (np.diff(braked.times) > 0).all()
    assert np.isnan(braked.currents[-1]).all()
    np.testing.assert_array_equal(braked.currents[0], motion.currents[0])


@pytest.mark.parametrize(
    "velocity", [(0.9, 0, 0), (0, 0, 1.0), (0, 1e-8, 0), (0, 0, 0), (3, 4, 9)]
)
def test_braking_is_bounded_from_any_velocity(velocity):
    v = np.array(velocity, float)
    times = np.array([0.0, 0.1])
    motion = HermiteTrajectory(
        times, np.array([0 * v, 0.1 * v]), np.tile(v, (2, 1)), np.zeros((1, 4))
    )
    braked = motion.braked(0.1, DECELERATION)
    assert (np.diff(braked.times) > 0).all()
    assert len(braked.poses) == len(braked.velocities) == len(braked.times)
    assert len(braked.currents) == len(braked.times) - 1
    np.testing.assert_allclose(braked.velocities[-1], 0.0, atol=1e-7)
    way = np.hypot(v[0], v[1]) ** 2 / 3.0
    stop = np.hypot(*(braked.poses[-1] - 0.1 * v)[:2])
    assert stop == pytest.approx(way, abs=1e-6)


def test_braking_is_defined_before_the_start_and_after_the_end():
    motion = a_motion(2)
    at_once = motion.braked(motion.start, DECELERATION)
    assert at_once.start == motion.start
    np.testing.assert_allclose(at_once.poses[0], motion.poses[0])
    rests = motion.braked(motion.end + 1.0, DECELERATION)
    np.testing.assert_allclose(rests.poses[-1], motion.poses[-1])
    assert rests.end == pytest.approx(motion.end + 1.0 + BRAKING_STEP)


def test_part_of_a_motion_equals_the_motion():
    motion = a_motion(3)
    part = motion.between(5.13, 5.58)
    assert part.start == 5.13 and part.end == 5.58
    times = np.linspace(5.13, 5.58, 60)
    np.testing.assert_allclose(part.at(times)[0], motion.at(times)[0], atol=1e-9)
    np.testing.assert_allclose(part.at(times[:-1])[1], motion.at(times[:-1])[1], atol=1e-9)
    for time in (5.14, 5.2001, 5.45, 5.57):
        np.testing.assert_array_equal(part.currents_at(time), motion.currents_at(time))
    assert len(part.currents) == len(part.times) - 1


def test_part_beyond_the_end_rests_at_the_end():
    motion = a_motion(4).braked(5.8, DECELERATION)
    part = motion.between(5.5, motion.end + 1.0)
    pose, velocity = part.sample(motion.end + 0.5)
    np.testing.assert_allclose(pose, motion.poses[-1], atol=1e-9)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-9)
    assert np.isnan(part.currents_at(motion.end + 0.5)).all()


def test_part_of_zero_length_is_a_motion():
    part = a_motion().between(5.2, 5.2)
    assert part.end > part.start


def test_motions_are_concatenated():
    motion = a_motion(5)
    first, second = motion.between(5.0, 5.37), motion.between(5.37, 5.8)
    both = first.then(second)
    assert (np.diff(both.times) > 0).all()
    times = np.linspace(5.0, 5.8 - 1e-9, 81)
    np.testing.assert_allclose(both.at(times)[0], motion.at(times)[0], atol=1e-9)
    np.testing.assert_allclose(both.at(times)[1], motion.at(times)[1], atol=1e-9)
    for time in (5.02, 5.36, 5.38, 5.75):
        np.testing.assert_array_equal(both.currents_at(time), motion.currents_at(time))


def test_fine_samples_include_the_nodes_and_the_start():
    motion = a_motion()
    times, poses, velocities = motion.fine(5.25, -np.inf, 4)
    assert times[0] == 5.25 and times[-1] == motion.end
    assert (np.diff(times) > 0).all() and np.diff(times).max() <= 0.025 + 1e-9
    for node in motion.times[motion.times > 5.25]:
        assert np.abs(times - node).min() < 1e-12
    np.testing.assert_allclose(poses, motion.at(times)[0])
    np.testing.assert_allclose(velocities, motion.at(times)[1])


@pytest.mark.parametrize("last", [-np.inf, 0.0, 7.77])
def test_fine_samples_continue_at_rest(last):
    motion = a_motion().braked(5.8, DECELERATION)
    for first in (motion.end - 0.1, motion.end + 0.2):
        times, poses, velocities = motion.fine(first, last, 4)
        assert len(times) >= 2 and (np.diff(times) > 0).all()
        assert times[0] == first and times[-1] >= last
        rests = times >= motion.end
        np.testing.assert_allclose(velocities[rests], 0.0, atol=1e-9)
        np.testing.assert_allclose(poses[rests] - motion.poses[-1], 0.0, atol=1e-9)


def test_a_robot_that_follows_a_motion_has_its_pose_and_its_twist():
    turned = np.array([[0.0, 0.0, 0.5 * np.pi], [0.0, 1.0, 0.5 * np.pi]])
    motion = HermiteTrajectory(
        np.array([1.0, 2.0]), turned, np.tile([0.0, 1.0, 0.0], (2, 1)), np.zeros((1, 4))
    )
    state = MeasuredState.on(motion, 1.5)
    assert state.time == 1.5
    np.testing.assert_allclose(state.pose, [0.0, 0.5, 0.5 * np.pi])
    np.testing.assert_allclose(state.twist, [1.0, 0.0, 0.0], atol=1e-12)
