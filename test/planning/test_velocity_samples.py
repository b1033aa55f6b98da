"""Motions among people: their limits, their ranking, and that all can come to rest in time."""

import math

import numpy as np
import pytest

from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.velocity_samples import DURATION, VelocitySamples, _gaps_to_each
from omniman_ros.surroundings.ellipses import Ellipses
from test.planning.support import SimulatedRun, parameters, planner
from test.planning.test_planner import pose

NOBODY = Ellipses.none()


def samples():
    values = parameters()
    return VelocitySamples(PlanningModel.of(values.robot), EffectiveLimits(values))


def person(x, y, vx=0.0, vy=0.0):
    return Ellipses.circles(0.0, [(x, y)], (vx, vy), 0.25)


def motions(found, start, goal, people=NOBODY, others=NOBODY, **more):
    step = found.limits.parameters.horizon.step
    best = found.best(np.array(start), 0.0, np.array(goal), people, others, **more)
    return [HermiteTrajectory.of_states(0.0, step, each.states, each.currents) for each in best]


@pytest.mark.parametrize("start", [[0.0] * 6, [0.0, 0.0, 0.4, 0.5, -0.3, 0.2]])
def test_motions_begin_at_the_state_and_keep_the_limits_of_plans(start):
    found = samples()
    step, limits = found.limits.parameters.horizon.step, found.limits
    rng = np.random.default_rng(0)
    for _ in range(10):
        goal = np.append(rng.uniform(-4.0, 4.0, 2), rng.uniform(-3.0, 3.0))
        people = Ellipses.circles(0.0, rng.uniform(-2, 2, (6, 2)), rng.uniform(-1, 1, (6, 2)), 0.2)
        for motion in motions(found, start, goal, people):
            assert motion.poses[0] == pytest.approx(start[:3])
            assert motion.end == pytest.approx(DURATION)
            v = motion.velocities
            assert np.hypot(v[:, 0], v[:, 1]).max() <= limits.speeds[0] + 1e-9
            assert np.abs(v[:, 2]).max() <= limits.speeds[1] + 1e-9
            change = np.diff(v, axis=0) / step
            assert np.hypot(change[:, 0], change[:, 1]).max() <= limits.accelerations[0] + 1e-9
            assert np.abs(change[:, 2]).max() <= limits.accelerations[1] + 1e-9
            moved = 0.5 * step * (v[1:] + v[:-1])
            assert np.diff(motion.poses, axis=0) == pytest.approx(moved, abs=1e-9)


def test_alone_the_best_motion_comes_to_rest_at_the_goal():
    best = motions(samples(), [0.0] * 6, [0.5, 0.1, 0.3])[0]
    assert best.poses[-1] == pytest.approx([0.5, 0.1, 0.3], abs=5e-3)
    assert np.abs(best.velocities[-1]).max() < 0.05


def test_a_person_who_comes_is_passed_without_contact():
    coming = person(2.0, 0.0, -0.8)
    for others, people in ((NOBODY, coming), (person(1.2, 0.0), NOBODY)):
        found = samples()
        best = motions(found, [0.0] * 6, [3.0, 0.0, 0.0], people, others)[0]
        around = people if len(people) else others
        gaps = _gaps_to_each(best.poses[None], found._half, around, best.times)
        assert gaps.min() > 0.0


def test_a_contact_after_arrival_counts_only_where_the_robot_has_to_remain():
    crossing = person(0.6, 2.2, 0.0, -1.0)  # at the goal after it was reached
    start, goal = [0.3, 0.0, 0.0, 0.4, 0.0, 0.0], [0.6, 0.0, 0.0]
    arrives = motions(samples(), start, goal, crossing)[0]
    assert np.hypot(*(arrives.poses[12, :2] - goal[:2])) < 0.05
    found = samples()
    stays = motions(found, start, goal, crossing, is_goal=False)[0]
    gaps = _gaps_to_each(stays.poses[None], found._half, crossing, stays.times)
    assert gaps.min() > 0.0


def test_the_robot_does_not_arrive_where_it_would_be_met_at_once():
    start, goal = [0.0, 0.0, 0.0, 0.3, 0.0, 0.0], [0.5, 0.0, 0.0]
    soon, found = person(0.5, 1.9, 0.0, -1.0), samples()
    waits = motions(found, start, goal, soon)[0]
    gaps = _gaps_to_each(waits.poses[None], found._half, soon, waits.times)
    assert gaps.min() > 0.0
    alone = motions(samples(), start, goal)[0]
    assert _gaps_to_each(alone.poses[None], found._half, soon, alone.times).min() < 0.0


def test_who_stands_where_a_corner_of_the_braking_robot_turns_is_touched():
    found = samples()
    half = found._half
    beside = person(0.9 * half[0], half[1] + 0.25 + 0.06)  # 6 cm from the side, near a corner

    def can_rest(yaw_rate):
        velocity = np.array([[0.0, 0.0, yaw_rate]])
        return bool(found._can_rest(np.zeros((1, 3)), velocity, 0.0, beside)[0])

    assert can_rest(0.0) and can_rest(0.2) and not can_rest(1.2)


def test_the_best_motion_can_rest_before_who_comes():
    found = samples()
    wall = Ellipses.circles(0.0, [(1.6, y) for y in (-0.6, 0.0, 0.6)], (-0.5, 0.0), 0.25)
    start = np.array([0.0, 0.0, 0.0, 0.5, 0.0, 0.0])
    best = motions(found, start, [4.0, 0.0, 0.0], wall)[0]

    def can_rest(pose, velocity):
        return found._can_rest(pose[None], velocity[None], best.times[1], wall)

    assert can_rest(best.poses[1], best.velocities[1])
    assert not can_rest(np.array([0.6, 0.0, 0.0]), np.array([0.7, 0.0, 0.0]))


class Crowd:
    """Six discs that come towards the robot, one of which may be spoilt from a time on."""

    def __init__(self, start, spoilt=None, since=math.inf):
        self._start, self._spoilt, self._since = start, spoilt, since
        random = np.random.default_rng(5)
        self._places = random.uniform((1.5, -2.0), (4.5, 2.0), (6, 2))

    def __call__(self, now):
        rates = np.array([[-0.6, 0.0]] * 6)
        values = {
            "centers": self._places + (now - self._start) * rates,
            "velocities": rates,
            "semi_axes": np.full((6, 2), 0.2),
            "growth": np.zeros(6),
        }
        if self._spoilt is not None and now > self._since:
            name, value = self._spoilt
            values[name][0] = value
        return Ellipses(time=now, angles=np.zeros(6), **values)


def driven_samples(sim):
    """Return a list that gets the time of each call of the samples."""
    called, best = [], sim.planner._samples.best
    sim.planner._samples.best = lambda *it, **more: called.append(it[1]) or best(*it, **more)
    return called


def test_the_planner_drives_through_a_crowd_and_touches_nobody():
    sim = SimulatedRun(planner())
    sim.seen = Crowd(sim.now)
    sim.drive(pose(3.0, 0.0, 0.0))
    sampled = driven_samples(sim)
    sim.run(15.0)
    assert len(sampled) > 20
    assert math.dist(sim.pose()[:2], (3.0, 0.0)) < 0.03
    half = sim.planner.model.half
    for time, at in zip(sim.times, sim.poses, strict=True):
        gaps = _gaps_to_each(np.array(at)[None, None], half, sim.seen(time), np.array([time]))
        assert gaps.min() > 0.0


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(
    "spoilt",
    [
        ("centers", math.nan),
        ("centers", math.inf),
        ("velocities", math.nan),
        ("velocities", 1e300),
        ("semi_axes", math.nan),
        ("semi_axes", 99.0),
        ("growth", math.nan),
    ],
    ids=str,
)
def test_a_spoilt_obstacle_in_a_crowd_brings_the_robot_to_rest(spoilt):
    sim = SimulatedRun(planner())
    sim.seen = Crowd(sim.now, spoilt, sim.now + 1.5)
    sim.drive(pose(4.0, 0.0, 0.0))
    sim.run(1.5, until=lambda: False)
    assert np.hypot(*sim.planner.motion.sample(sim.now)[1][:2]) > 0.3
    sim.run(1.5, until=lambda: False)
    place = sim.pose()
    sim.run(2.0, until=lambda: False)
    assert sim.pose() == pytest.approx(place, abs=1e-9)


def test_a_robot_that_touches_something_leaves_it_straight_in_a_crowd_too():
    sim = SimulatedRun(planner())
    half = sim.planner.model.half
    post = Ellipses.circles(sim.now, [(half[0] + 0.04, 0.0)], (0.0, 0.0), 0.05)

    def seen(now):
        standing = Ellipses.circles(now, post.centers, (0.0, 0.0), 0.05)
        return Crowd(sim.times[0] if sim.times else now)(now).joined(standing)

    sim.seen = seen
    sim.drive(pose(-2.0, 0.0, 0.0))
    sampled = driven_samples(sim)
    for _ in range(40):
        sim.run(0.05, until=lambda: False)
        route = sim.planner.route_planner
        if route is not None and route.escape_path is not None:
            assert not sampled or sampled[-1] < sim.now - 0.05
    assert sim.pose()[0] < -0.05
