from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.goals import PoseGoal, StateGoal
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.mpc.problem import Problem
from omniman_ros.planning.mpc.solver import TRUST_RADIUS, Solution, Solver, SolverError
from omniman_ros.planning.mpc.transcription import Transcription
from omniman_ros.planning.obstacles.pairs import Pairs
from test.planning.support import ellipses, model, parameters
from test.tiers import combinations

STEPS, STEP, SLOTS = 20, 0.1, 2


FIRM = 16.0  #: Damping with which iterations converge where full steps go around in circles


@cache
def solver(name="ig42", slots=SLOTS, damping=1.0):
    return Solver(Transcription(model(name), STEPS, STEP, slots, damping=damping))


def converged(using, stage, start=None):
    """Iterate to the optimum, which does not depend on the damping."""
    begin = np.zeros(6) if start is None else start
    answer = using.solve(begin, using.cold(), stage)
    for _ in range(250):
        answer = using.solve(begin, answer.currents, stage)
        if answer.step < 5e-3:
            return answer
    raise AssertionError(f"not converged: {answer.step} A")


def stage_of(name, goal, start=None, around=None, **changes):
    """Return problem parameters as the planner sets them for a robot at rest at a pose."""
    begin = np.zeros(6) if start is None else start
    along = HermiteTrajectory.of_states(
        0.0, STEP, np.tile(begin, (STEPS + 1, 1)), np.zeros((STEPS, 1))
    )
    p = parameters(name, **changes)
    problem = Problem(PlanningModel.of(p.robot), EffectiveLimits(p))
    pairs = Pairs.of(Footprint(Rectangles.centred(problem.model.half)), around or ellipses())
    return problem.stage(begin, along, goal, pairs, SLOTS)


def pose(x, y, theta):
    return PoseGoal(np.array([x, y, theta], float))


def rates(planning, states, currents):
    """Return linear (in odom) and yaw acceleration at both ends of each step, (2N, 2)."""
    twist, amps = ca.SX.sym("twist", 3), ca.SX.sym("amps", planning.wheel_count)
    rate = ca.Function("rate", [twist, amps], [planning.twist_rate(twist, amps)])
    found = []
    for first, last, held in zip(states[:-1], states[1:], currents, strict=True):
        for x in (first, last):
            a = np.asarray(rate(x[3:], held)).ravel()
            turned = a[:2] + x[5] * np.array([-x[4], x[3]])
            found.append([np.hypot(*turned), abs(a[2])])
    return np.array(found)


GOALS = [pose(1, 1, 0.8), pose(-0.5, -0.8, 0.3), pose(0.1, -0.1, -1.2), pose(1.5, 0, -0.5)]


# ---- limits -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "goal"), combinations(["ig42", "omniman", "omni3"], GOALS))
def test_converged_solutions_keep_all_limits_at_both_ends_of_every_step(name, goal):
    planning, limits = model(name), parameters(name).limits
    answer = converged(solver(name, damping=FIRM), stage_of(name, goal))
    states, currents = answer.states, answer.currents
    assert answer.slack.max() < 1e-3
    most = 1.0 + 5e-3  # the remaining error of one iteration
    assert (np.abs(currents) <= planning.max_current + 1e-9).all()
    for at in (states[:-1], states[1:]):
        assert np.abs(planning.voltages(currents, at[:, 3:])).max() <= most * planning.max_voltage
    speed, turning = np.hypot(states[:, 3], states[:, 4]), np.abs(states[:, 5])
    assert speed.max() <= most * 0.9 * limits.linear_velocity
    assert turning.max() <= most * 0.9 * limits.angular_velocity
    assert np.abs(states[:, 3:] @ planning.J.T).max() <= most * planning.max_speed
    used = rates(planning, states, currents)
    # The constraint holds at the start of a step; friction and rotation change it slightly.
    assert used[::2, 0].max() <= most * limits.linear_acceleration
    assert used[1::2, 0].max() <= 1.06 * limits.linear_acceleration
    assert used[::2, 1].max() <= most * limits.angular_acceleration
    assert used[1::2, 1].max() <= 1.06 * limits.angular_acceleration


def test_low_battery_voltage_and_low_traction_limit_the_motion():
    for change, bound in (
        ({"motor__max_voltage": 9.0}, "voltage"),
        ({"friction__mu": 0.08}, "current"),
    ):
        p = parameters(**change)
        t = Transcription(PlanningModel.of(p.robot), STEPS, STEP, 0, damping=FIRM)
        weak = Solver(t)
        stage = stage_of("ig42", pose(4, 0, 0), **change)
        stage = replace(stage, obstacles=stage.obstacles[:, :0])
        answer = converged(weak, stage)
        volts = [
            np.abs(t.model.voltages(answer.currents, at[:, 3:])).max()
            for at in (answer.states[:-1], answer.states[1:])
        ]
        assert max(volts) <= 1.005 * t.model.max_voltage
        assert (np.abs(answer.currents) <= t.model.max_current + 1e-9).all()
        if bound == "voltage":
            assert max(volts) > 0.98 * 9.0
        else:
            assert np.abs(answer.currents).max() > 0.99 * t.model.max_current.max()


def test_solutions_stay_clear_and_inside_the_workspace_without_slack():
    around = ellipses((1.0, 0.35, 0.25), (1.6, -0.5, 0.2, 0.4, 0.5))
    stage = stage_of("ig42", pose(1.9, 0.2, 1.0), around=around, workspace__x_max=2.4)
    answer = converged(solver(damping=FIRM), stage)
    assert answer.slack.max() < 1e-3
    t = solver().transcription
    for x, u, row in zip(answer.states, answer.currents, stage.table(), strict=False):
        value = np.asarray(t.stage_rows(x, u, row)[0]).ravel()
        assert value[t.relaxed :].min() > -5e-3
    assert answer.states[-1, 0] > 0.3


# ---- iterations -------------------------------------------------------------------------------


def test_iterations_converge():
    stage = stage_of("ig42", pose(0.8, 0.4, 0.5), around=ellipses((0.9, -0.4, 0.2)))
    costs, guess = [], solver().cold()
    steps = []
    for _ in range(12):
        answer = solver().solve(np.zeros(6), guess, stage)
        assert answer.iterations == 1
        costs.append(answer.cost)
        steps.append(answer.step)
        guess = answer.currents
    assert costs[-1] < 0.5 * costs[0]
    assert steps[-1] < 0.02 * steps[0]
    assert abs(costs[-1] - costs[-2]) < 1e-3 * costs[-1]


def test_converged_solution_is_a_fixed_point_of_the_iteration():
    stage = stage_of("ig42", pose(0.3, 0.0, 0.0))
    answer = solver().solve(np.zeros(6), solver().cold(), stage, 60)
    assert answer.iterations < 60
    again = solver().solve(np.zeros(6), answer.currents, stage, 60)
    assert again.iterations <= 2


def test_states_of_a_solution_follow_from_its_currents():
    start = np.array([1.0, 2.0, 0.5, 0.3, 0.1, -0.2])
    stage = stage_of("ig42", pose(2, 3, 0), start=start)
    answer = solver().solve(start, solver().cold(), stage, 3)
    assert isinstance(answer, Solution)
    assert answer.states.shape == (STEPS + 1, 6) and answer.currents.shape == (STEPS, 4)
    assert answer.slack.shape == (STEPS,)
    x = start
    np.testing.assert_allclose(answer.states[0], start)
    for k in range(STEPS):
        x = np.asarray(solver().transcription.transition(x, answer.currents[k])).ravel()
        np.testing.assert_allclose(answer.states[k + 1], x, atol=1e-9)


def test_position_change_per_iteration_is_bounded():
    stage = stage_of("ig42", pose(1.2, 0.4, 0.3))
    before = solver().solve(np.zeros(6), solver().cold(), stage, 8)
    stage = stage_of("ig42", pose(-4, 0, 0))
    after = solver().solve(np.zeros(6), before.currents, stage)
    moved = np.abs(after.states - before.states)[:, :2].max()
    # The linear step is scaled down to the bound.
    assert 0.5 * TRUST_RADIUS < moved < 1.3 * TRUST_RADIUS


def test_shifted_currents_are_those_of_the_later_time():
    currents = np.random.default_rng(1).uniform(-1, 1, (STEPS, 4))
    np.testing.assert_allclose(solver().shifted(currents, 0.0), currents)
    later = solver().shifted(currents, 0.3)
    np.testing.assert_allclose(later[:-3], currents[3:])
    np.testing.assert_allclose(later[-3:], np.tile(currents[-1], (3, 1)))
    half = solver().shifted(currents, 0.05)
    np.testing.assert_allclose(half[:-1], 0.5 * (currents[:-1] + currents[1:]))
    np.testing.assert_allclose(solver().shifted(currents, 9.0), np.tile(currents[-1], (STEPS, 1)))


def test_warm_start_is_close_to_the_solution():
    stage = stage_of("ig42", pose(1.5, 0.5, 0.5))
    answer = solver().solve(np.zeros(6), solver().cold(), stage, 30)
    start = answer.states[1]
    stage = stage_of("ig42", pose(1.5, 0.5, 0.5), start=start)
    warm = solver().solve(start, solver().shifted(answer.currents, STEP), stage)
    best = solver().solve(start, warm.currents, stage, 30)
    cold = solver().solve(start, solver().cold(), stage)
    off = [np.abs(found.states - best.states)[:, :2].max() for found in (warm, cold)]
    assert off[0] < 0.02 < off[1]


# ---- faults -----------------------------------------------------------------------------------


def changed(stage, **changes):
    """Return a stage with values at some places of its arrays, without a check."""
    arrays = {}
    for name, (place, value) in changes.items():
        arrays[name] = np.array(getattr(stage, name))
        arrays[name][place] = value
    return type(stage).unchecked(**{**vars(stage), **arrays})


@pytest.mark.parametrize("where", ["start", "guess", "target", "obstacle"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_input_that_is_not_finite_raises_an_error(where, value):
    start, guess = np.zeros(6), solver().cold()
    stage = stage_of("ig42", pose(1, 0, 0), around=ellipses((0.9, -0.6, 0.2)))
    if where == "start":
        start[4] = value
    elif where == "guess":
        guess[3, 1] = value
    elif where == "target":
        stage = changed(stage, target=((5, 0), value))
    else:
        # A workspace bound at infinity is valid.
        stage = changed(stage, obstacles=((2, 0, 0), np.nan))
    with pytest.raises((SolverError, RuntimeError)):
        solver().solve(start, guess, stage)


def test_error_does_not_affect_the_next_solution():
    stage = stage_of("ig42", pose(1, 0, 0))
    before = solver().solve(np.zeros(6), solver().cold(), stage, 5)
    bad = changed(stage, target=(slice(None), np.nan))
    with pytest.raises((SolverError, RuntimeError)):
        solver().solve(np.zeros(6), solver().cold(), bad, 5)
    after = solver().solve(np.zeros(6), solver().cold(), stage, 5)
    np.testing.assert_allclose(after.currents, before.currents, atol=1e-9)


def test_contradictory_limits_raise_an_error_that_names_the_cause():
    start = np.array([0, 0, 0, 0.9, 0, 0.0])
    stage = stage_of("ig42", pose(1, 0, 0), start=start)
    # Stop at once, yet with at most 1 m/s^2.
    stage = changed(stage, limits=((slice(None), 0), 0.01))
    with pytest.raises(SolverError, match="not solved"):
        solver().solve(start, solver().cold(), stage)


def test_robot_above_its_speed_limit_still_has_a_solution():
    for speed in (0.95, 1.3, 2.0):
        start = np.array([0, 0, 0, speed, 0.1, 1.0])
        stage = stage_of("ig42", pose(6, 0, 0), start=start)
        answer = solver().solve(start, solver().cold(), stage, 10)
        speeds = np.hypot(answer.states[:, 3], answer.states[:, 4])
        assert speeds.max() <= speeds[0] + 1e-3
        assert speeds[-1] < speeds[0] - 0.02


def test_robot_inside_an_obstacle_gets_a_solution_with_slack_that_leads_out():
    around = ellipses((0.35, 0.0, 0.2))
    stage = stage_of("ig42", pose(-2, 0, 0), around=around)
    answer = solver().solve(np.zeros(6), solver().cold(), stage, 20)
    assert answer.slack[0] > 0.1
    assert answer.slack[-1] < 1e-2
    assert answer.states[-1, 0] < -0.3


def test_solution_approaches_the_goal_velocity():
    goal = StateGoal(np.array([1.0, 0.0, 0.0]), np.array([0.5, 0.0, 0.0]), 2.0)
    ends = []
    for weight in (0.0, 60.0, 3e3):
        stage = stage_of("ig42", goal, weights__velocity=weight)
        ends.append(solver().solve(np.zeros(6), solver().cold(), stage, 30).states[-1, 3])
    assert ends[0] < ends[1] < ends[2]
    assert ends[2] == pytest.approx(0.5, abs=0.02)
