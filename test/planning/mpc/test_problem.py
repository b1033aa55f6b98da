import math

import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.goals import PoseGoal, StateGoal
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.mpc.gap_rows import OBSTACLE
from omniman_ros.planning.mpc.problem import Problem
from omniman_ros.planning.mpc.solver import Solver
from omniman_ros.planning.mpc.transcription import SIDES, Transcription
from omniman_ros.planning.obstacles.pairs import Pairs
from omniman_ros.planning.obstacles.separation import box_gap
from omniman_ros.surroundings.ellipses import inflated
from test.planning.support import ellipses, model, parameters

STEPS, STEP, SLOTS = 20, 0.1, 3
NOW = 100.0


def a_problem(name="ig42", **changes):
    return Problem(model(name), EffectiveLimits(parameters(name, **changes)))


def a_line(vx=0.5, vy=0.0, w=0.0):
    """Return a guess that moves at a constant velocity."""
    times = NOW + STEP * np.arange(STEPS + 1)
    velocity = np.array([vx, vy, w], float)
    poses = (times[:, None] - NOW) * velocity
    return HermiteTrajectory(times, poses, np.tile(velocity, (STEPS + 1, 1)), np.zeros((STEPS, 4)))


def stage_of(problem, start=None, guess=None, goal=None, around=None):
    begin = np.zeros(6) if start is None else np.array(start, float)
    return problem.stage(
        begin,
        guess or a_line(),
        goal or PoseGoal(np.array([1.0, 0.0, 0.0])),
        Pairs.of(
            Footprint(Rectangles.centred(problem.model.half)),
            ellipses() if around is None else around,
        ),
        SLOTS,
    )


# ---- limits -----------------------------------------------------------------------------------


def test_limits_are_the_parameters_minus_the_reserve():
    p = parameters()
    limits = stage_of(a_problem()).limits
    assert limits.shape == (STEPS, 6)
    room = 1.0 - p.reserve
    np.testing.assert_allclose(limits[:, 0], room * p.limits.linear_velocity)
    np.testing.assert_allclose(limits[:, 1], room * p.limits.angular_velocity)
    np.testing.assert_allclose(limits[:, 2], p.robot.motor.max_speed)
    np.testing.assert_allclose(limits[:, 3], p.robot.motor.max_voltage)
    assert (limits[:, 4] <= p.limits.linear_acceleration).all()
    assert (limits[:, 5] <= p.limits.angular_acceleration).all()


@pytest.mark.parametrize("fraction", [1.0, 0.5, 0.1, 0.01])
@pytest.mark.parametrize("angle", np.linspace(0, np.pi / 3, 5))
def test_robot_above_its_speed_limit_may_not_accelerate_further(fraction, angle):
    # Each plan is allowed no more than the last; otherwise speed would add up over cycles.
    problem = a_problem()
    problem.limits = EffectiveLimits(parameters(), fraction)
    fastest = problem.limits.parameters.limits.linear_velocity
    for speed in (0.5 * fastest, 1.0 * fastest, 1.5 * fastest):
        start = [0, 0, 0, speed * math.cos(angle), speed * math.sin(angle), 0.5]
        stage = stage_of(problem, start)
        limits = stage.limits
        spokes = (np.arange(SIDES) + 0.5) * 2 * np.pi / SIDES + stage.direction
        row = (np.cos(spokes) * start[3] + np.sin(spokes) * start[4]).max()
        row /= np.cos(np.pi / SIDES)
        most = 0.85 * fraction * fastest
        assert limits[0, 0] <= max(row, most) + 1e-9
        assert (np.diff(limits[:, 0]) <= 1e-12).all()
        # The limits are feasible: they fall no faster than the robot may brake.
        drop = -np.diff(np.append(row, limits[:, 0]))
        assert drop.max() <= fraction * fastest * STEP + 1e-9


def test_limit_scale_applies_to_velocities_and_accelerations():
    problem = a_problem()
    whole = stage_of(problem).limits
    problem.limits = EffectiveLimits(parameters(), 0.4)
    part = stage_of(problem).limits
    for column in (0, 1, 4, 5):
        np.testing.assert_allclose(part[:, column], 0.4 * whole[:, column])
    np.testing.assert_allclose(part[:, 2:4], whole[:, 2:4])


# ---- goal -------------------------------------------------------------------------------------


def test_weight_of_a_goal_does_not_grow_with_its_distance():
    problem = a_problem()
    p = problem.limits.parameters
    reach = p.weights.reach + p.limits.linear_velocity * p.horizon.duration
    near = PoseGoal(np.array([1.0, 0.5, 0.3]))
    np.testing.assert_allclose(stage_of(problem, goal=near).target[:, :2], [[1.0, 0.5]] * STEPS)
    far = stage_of(problem, goal=PoseGoal(np.array([300.0, 400.0, 0.3])))
    np.testing.assert_allclose(far.target[:, :2], np.tile([0.6 * reach, 0.8 * reach], (STEPS, 1)))
    np.testing.assert_allclose(far.target[:, 2], 0.3)


def test_slack_costs_more_than_any_goal_can_gain():
    for changes in ({}, {"weights__position": 1e5}, {"weights__running": 50.0}):
        problem = a_problem(**changes)
        stage = stage_of(problem, goal=PoseGoal(np.array([300.0, 400.0, 0.0])))
        away = np.linalg.norm(stage.target[:, :2], axis=1)
        pull = (2.0 * stage.weights[:, 0] * away).sum()
        assert min(stage.slack) > pull


def test_weights_are_terminal_and_per_second_of_the_horizon():
    problem = a_problem(weights__running=0.5)
    w, eta = (
        problem.limits.parameters.weights,
        problem.limits.parameters.robot.motor.gear_efficiency,
    )
    weights = stage_of(problem).weights
    assert weights.shape == (STEPS, 5)
    np.testing.assert_allclose(weights[:-1, 0], 0.5 * STEP * w.position)
    np.testing.assert_allclose(weights[-1, 0], (1 + 0.5 * STEP) * w.position)
    np.testing.assert_allclose(weights[-1, 1], (1 + 0.5 * STEP) * w.heading)
    assert not weights[:, 2:4].any()  # a pose goal has no velocity
    np.testing.assert_allclose(weights[-1, 4], w.energy / eta)
    assert not weights[:-1, 4].any()
    moving = StateGoal(np.array([1.0, 0, 0]), np.array([0.3, 0, 0]), NOW + 1.0)
    assert (stage_of(problem, goal=moving).weights[:, 2:4] > 0.0).all()
    paper = stage_of(a_problem(weights__running=0.0)).weights
    assert not paper[:-1].any()


def test_clearance_shrinks_the_workspace():
    room = {"workspace__x_min": -1.0, "workspace__y_min": -2.0, "workspace__x_max": 3.0}
    stage = stage_of(a_problem(**room, workspace__y_max=4.0, safety__clearance=0.1))
    np.testing.assert_allclose(stage.workspace, [-0.9, -1.9, 2.9, 3.9])


# ---- obstacles --------------------------------------------------------------------------------


def test_obstacles_are_predicted_with_their_margins():
    known = ellipses(
        (1.0, -1.0, 0.4, 0.2, 0.5), time=NOW - 0.2, velocities=[(0.1, 0.3)], growth=0.05
    )
    problem = a_problem()
    stage = stage_of(problem, guess=a_line(0.0), around=known)
    safety = problem.limits.parameters.safety
    clearance = safety.clearance + safety.berth * math.hypot(0.1, 0.3)
    for k, row in enumerate(stage.obstacles[:, 0]):
        ahead = STEP * (k + 1) + 0.2
        np.testing.assert_allclose(row[:2], [1.0 + 0.1 * ahead, -1.0 + 0.3 * ahead])
        np.testing.assert_allclose(row[2:4], [math.cos(0.5), math.sin(0.5)])
        axes = inflated(np.array([0.4, 0.2]), clearance + 0.05 * ahead)
        np.testing.assert_allclose(row[4:6], axes)
        np.testing.assert_allclose(row[6:8], [0.1, 0.3])


@pytest.mark.parametrize(("speed", "more"), [(0.0, 0.0), (0.25, 0.1), (5.0, 0.3)])
def test_margin_grows_with_obstacle_speed_up_to_a_limit(speed, more):
    known = ellipses((1.0, 1.0, 0.3), time=NOW, velocities=[(0.0, speed)])
    still = ellipses((1.0, 1.0, 0.3), time=NOW, velocities=[(0.0, 0.0)])
    problem = a_problem(safety__berth=0.4)
    (least, wide) = (stage_of(problem, around=seen).obstacles[0, 0, 4] for seen in (still, known))
    assert wide - least == pytest.approx(more, abs=1e-6)


def test_slots_hold_the_nearest_obstacle_on_every_side_at_every_step():
    places = np.random.default_rng(3).uniform(-2, 2, (40, 2)).round(3)
    rows = [(x, y, 0.1) for x, y in places if abs(y) > 0.4]
    known, guess = ellipses(*rows, time=NOW), a_line(0.5)
    stage = stage_of(a_problem(), guess=guess, around=known)
    half = model("ig42").half
    axes = known.axes_at(guess.times[1:])
    box, centers = Rectangles.centred(half), known.centers_at(guess.times[1:])
    gaps = box_gap(guess.poses[1:], box, centers, axes, known.angles)
    for k, (x, y, _) in enumerate(guess.poses[1:]):
        ahead, aside = (known.centers - [x, y]).T / half[:, None]  # the guess has heading zero
        sector = np.floor(np.arctan2(aside, ahead) % math.tau / (math.tau / SLOTS)).astype(int)
        found = {tuple(row) for row in stage.obstacles[k, :, :2].round(6).tolist()}
        assert len(found) == SLOTS
        assert tuple(known.centers[gaps[k].argmin()]) in found
        for side in set(sector.tolist()):
            inside = np.flatnonzero(sector == side)
            assert tuple(known.centers[inside[gaps[k, inside].argmin()]]) in found


def test_wall_of_many_discs_does_not_use_up_the_slots_of_the_other_side():
    wall = [(x, 0.5, 0.03) for x in np.arange(-2.0, 3.0, 0.05).round(3)]
    other = (1.0, -0.9, 0.1)
    stage = stage_of(a_problem(), guess=a_line(0.5), around=ellipses(*wall, other, time=NOW))
    assert (stage.obstacles[:, :, :2] == np.array(other[:2])).all(axis=2).any(axis=1).all()


def test_empty_slots_hold_an_obstacle_far_away():
    stage = stage_of(a_problem(), around=ellipses((1.0, 0.8, 0.2)))
    assert np.hypot(*stage.obstacles[0, 0, :2]) < 2.0
    assert (np.abs(stage.obstacles[:, 1:, :2]) > 100.0).all()
    np.testing.assert_allclose(
        stage.obstacles[:, 1:, 2:8], np.tile([1, 0, 1, 1, 0, 0], (STEPS, 2, 1))
    )
    none = stage_of(a_problem())
    assert none.obstacles.shape == (STEPS, SLOTS, OBSTACLE)


def test_no_reachable_obstacle_is_left_out():
    random, problem = np.random.default_rng(1), a_problem()
    met = 0
    for _ in range(200):
        row = (*random.uniform(-4, 4, 2), 0.2)
        known = ellipses(row, time=NOW, velocities=random.uniform(-2, 2, (1, 2)))
        stage = stage_of(problem, guess=a_line(0.0), around=known)
        kept = np.abs(stage.obstacles[0, 0, 0]) < 100.0
        # Drive straight at the obstacle at full speed from where the robot stands.
        for k in range(1, STEPS + 1):
            centre = known.centers[0] + STEP * k * known.velocities[0]
            if np.hypot(*centre) < 0.4 + 0.2 + 1.0 * STEP * k:
                met += 1
                assert kept
                break
    assert 50 < met < 190


# ---- workspace --------------------------------------------------------------------------------


def test_a_problem_is_confined_where_the_robot_can_reach_the_border():
    random, met = np.random.default_rng(2), 0
    problem = a_problem(workspace__x_min=-4.0, workspace__y_min=-4.0, workspace__x_max=4.0)
    p = problem.limits.parameters
    outline = Footprint(Rectangles.centred(problem.model.half))
    gap, horizon = p.safety.clearance, p.horizon.duration
    for _ in range(200):
        start = np.append(random.uniform(-4, 4, 3), random.uniform(-1, 1, 3))
        fastest = max(p.limits.linear_velocity, math.hypot(start[3], start[4]))
        corners = outline.radius + gap + fastest * horizon
        room = np.append(start[:2] + 4.0, 4.0 - start[0]).min()
        is_confined = problem.is_confined(start, outline)
        assert is_confined or room > corners
        met += not is_confined
    assert 10 < met < 190


def test_a_problem_without_a_border_has_no_points_of_the_outline():
    problem = a_problem()
    pairs = Pairs.of(Footprint(Rectangles.centred(problem.model.half)), ellipses())
    goal = PoseGoal(np.array([1.0, 0.0, 0.0]))
    stage = problem.stage(np.zeros(6), a_line(), goal, pairs, SLOTS, confined=False)
    assert stage.extremes.shape == (STEPS, 0, 2)


@pytest.mark.parametrize("turn", [-0.6, 0.0, 0.6])
def test_currents_along_poses_lead_to_them(turn):
    """From rest, at accelerations within the limits, round a bend."""
    problem, solver = a_problem(), Solver(Transcription(model("ig42"), STEPS, STEP, 0, False))
    times = STEP * np.arange(1.0, STEPS + 1.0)
    way = 0.5 * 0.3 * times**2
    poses = np.column_stack([way, 0.2 * way**2, turn * way])
    states = solver.states(np.zeros(6), problem.along(np.zeros(6), poses))
    np.testing.assert_allclose(states[1:, :3], poses, atol=0.02)


def test_currents_along_poses_out_of_reach_stay_within_the_limits():
    problem, solver = a_problem(), Solver(Transcription(model("ig42"), STEPS, STEP, 0, False))
    poses = np.tile([50.0, -50.0, 3.0], (STEPS, 1))
    currents = problem.along(np.zeros(6), poses)
    assert (np.abs(currents) <= problem.model.max_current).all()
    speed, rate = problem.limits.speeds
    states = solver.states(np.zeros(6), currents)
    assert np.hypot(states[:, 3], states[:, 4]).max() <= 1.05 * speed
    assert np.abs(states[:, 5]).max() <= 1.05 * rate
