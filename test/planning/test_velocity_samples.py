"""Motions among people: their limits, their ranking, and that all can come to rest in time."""

import math

import numpy as np
import pytest

from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.obstacles.ellipses import Ellipses
from omniman_ros.planning.velocity_samples import DURATION, VelocitySamples, _gaps_to_each
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


def test_the_best_motion_can_rest_before_who_comes():
    found = samples()
    wall = Ellipses.circles(0.0, [(1.6, y) for y in (-0.6, 0.0, 0.6)], (-0.5, 0.0), 0.25)
    start = np.array([0.0, 0.0, 0.0, 0.5, 0.0, 0.0])
    best = motions(found, start, [4.0, 0.0, 0.0], wall)[0]

    def can_rest(pose, velocity):
        return found._can_rest(pose[None], velocity[None], best.times[1], wall)

    assert can_rest(best.poses[1], best.velocities[1])
    assert not can_rest(np.array([0.6, 0.0, 0.0]), np.array([0.7, 0.0, 0.0]))


def test_the_planner_drives_through_a_crowd_and_touches_nobody():
    sim = SimulatedRun(planner())
    start, random = sim.now, np.random.default_rng(5)
    places, rates = random.uniform((1.5, -2.0), (4.5, 2.0), (6, 2)), np.array([[-0.6, 0.0]] * 6)

    def seen(now):
        return Ellipses.circles(now, places + (now - start) * rates, rates, 0.2)

    sim.seen = seen
    sim.drive(pose(3.0, 0.0, 0.0))
    sampled = []
    best = sim.planner._samples.best
    sim.planner._samples.best = lambda *it, **more: sampled.append(it[1]) or best(*it, **more)
    sim.run(15.0)
    assert len(sampled) > 20
    assert math.dist(sim.pose()[:2], (3.0, 0.0)) < 0.03
    half = sim.planner.model.half
    for time, at in zip(sim.times, sim.poses, strict=True):
        gaps = _gaps_to_each(np.array(at)[None, None], half, seen(time), np.array([time]))
        assert gaps.min() > 0.0
