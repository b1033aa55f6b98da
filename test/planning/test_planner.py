import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.preview import Preview
from omniman_ros.planning.cycle import MeasuredState, PlannerState
from omniman_ros.planning.goals import PoseGoal, StateGoal, TrajectoryGoal
from omniman_ros.planning.mpc.quadratic_program import QuadraticProgram
from omniman_ros.planning.mpc.solver import Solver, SolverError
from omniman_ros.planning.obstacles.walls import Walls
from omniman_ros.planning.route.route_planner import RouteSource
from omniman_ros.surroundings.grid_map import GridMap
from test.planning.support import (
    CYCLE,
    SimulatedRun,
    ellipses,
    observed,
    parameters,
    planner,
    true_gaps,
)
from test.tiers import exhaustive, representative


def pose(x, y, theta):
    return PoseGoal(np.array([x, y, theta], float))


def never():
    return False


def speeds(sim):
    """Return linear and angular speed (K, 2) of the driven motion."""
    dt = np.diff(sim.times)
    moved = np.diff(np.array(sim.poses), axis=0) / dt[:, None]
    return np.column_stack([np.hypot(moved[:, 0], moved[:, 1]), np.abs(moved[:, 2])])


def assert_smooth(sim):
    """Assert that pose and speed are continuous."""
    dt = np.diff(sim.times)[:, None]
    velocity = np.diff(np.array(sim.poses), axis=0) / dt
    assert np.abs(velocity[:, :2]).max() < 1.1 and np.abs(velocity[:, 2]).max() < 2.2
    assert np.abs(np.diff(velocity, axis=0) / dt[1:])[:, :2].max() < 4.0


# ---- goals ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "goal"),
    [
        exhaustive("ig42", (2.0, 1.0, 0.5)),
        exhaustive("omniman", (-1.5, 0.5, -2.0)),
        ("omni3", (0.0, -1.0, 1.5)),
    ],
)
def test_pose_is_reached_within_the_limits(name, goal):
    sim = SimulatedRun(planner(name))
    sim.drive(pose(*goal))
    sim.run(12.0)
    assert sim.planner.state is PlannerState.ARRIVED and sim.planner.goal is None
    sim.run(3.0, until=never)
    np.testing.assert_allclose(sim.pose(), goal, atol=0.02)
    limits = parameters(name).limits
    fastest = speeds(sim).max(axis=0)
    assert fastest[0] < 0.92 * limits.linear_velocity
    assert fastest[1] < 0.92 * limits.angular_velocity
    assert fastest.max() > 0.5
    assert_smooth(sim)


def test_robots_of_any_number_of_wheels_reach_the_goal():
    sim = SimulatedRun(planner("mecanum8"))
    sim.drive(pose(0.5, 0.3, 0.2))
    sim.run(8.0)
    assert sim.planner.state is PlannerState.ARRIVED


@pytest.mark.parametrize(
    ("speed", "angle"), [exhaustive(0.2, 0.5), (0.5, -0.6), exhaustive(0.7, 0.0)]
)
def test_pose_is_passed_at_its_velocity(speed, angle):
    sim = SimulatedRun(planner())
    velocity = speed * np.array([math.cos(angle), math.sin(angle), 0.0])
    goal = StateGoal(np.array([2.0, 0.5, 0.2]), velocity)
    sim.drive(goal)
    sim.run(15.0)
    assert sim.planner.state is PlannerState.ARRIVED
    away = np.hypot(*(np.array(sim.poses)[:, :2] - goal.pose[:2]).T)
    passed = int(np.argmin(away[:-1]))
    assert away[passed] < 0.03
    assert passed > len(away) - 60  # the goal counts as reached when it is passed, not earlier
    before, after = sim.poses[passed - 4], sim.poses[passed + 1]
    found = (after - before) / (sim.times[passed + 1] - sim.times[passed - 4])
    np.testing.assert_allclose(found, velocity, atol=0.12)
    assert sim.poses[passed][2] == pytest.approx(0.2, abs=0.03)
    sim.run(4.0, until=never)
    assert not sim.measured().twist.any()


def test_trajectory_is_followed():
    times = np.linspace(101.0, 107.0, 61)
    turn = 0.6 * (times - 101.0)
    poses = np.column_stack([np.sin(turn), 1.0 - np.cos(turn), 0.3 * turn])
    velocities = 0.6 * np.column_stack([np.cos(turn), np.sin(turn), 0.3 + 0 * turn])
    goal = TrajectoryGoal(Preview(times, poses, velocities))
    sim = SimulatedRun(planner())
    sim.drive(goal)
    sim.run(12.0)
    assert sim.planner.state is PlannerState.ARRIVED and 107.0 < sim.now < 109.0
    seen = np.array(sim.times)
    along = (seen > 103.0) & (seen < 106.5)
    wanted, _ = goal.targets(seen[along])
    away = np.array(sim.poses)[along] - wanted
    assert np.hypot(away[:, 0], away[:, 1]).max() < 0.06
    assert np.abs(away[:, 2]).max() < 0.06
    np.testing.assert_allclose(sim.pose(), poses[-1], atol=0.03)


@pytest.mark.parametrize("wrapped", [False, True])
def test_heading_never_unwinds(wrapped):
    sim = SimulatedRun(planner(), (0.0, 0.0, 3.1), wrapped=wrapped)
    for x, heading in ((0.0, -3.1), (0.2, -2.9), (0.2, 3.0), (0.0, -2.5)):
        begin = len(sim.poses)
        sim.drive(pose(x, 0.0, heading))
        sim.run(10.0)
        assert sim.planner.state is PlannerState.ARRIVED
        turned = np.ptp(np.array(sim.poses)[begin:, 2])
        assert turned < 1.0
        assert abs(math.remainder(sim.pose()[2] - heading, math.tau)) < 0.03


def test_branch_of_the_heading_is_fixed_for_a_goal():
    sim = SimulatedRun(planner(), (0.0, 0.0, 3.0), wrapped=True)
    sim.drive(pose(1.0, 0.0, 0.0))  # half a turn: both directions are valid
    sim.run(12.0)
    assert sim.planner.state is PlannerState.ARRIVED
    headings = np.array(sim.poses)[:, 2]
    assert np.ptp(headings) < math.pi
    back = np.diff(headings) * np.sign(headings[-1] - headings[0])
    assert back.min() > -2e-3


def test_new_goal_is_accepted_while_driving():
    sim = SimulatedRun(planner())
    sim.drive(pose(3.0, 0.0, 0.0))
    sim.run(1.5)
    moving = speeds(sim)[-1, 0]
    sim.drive(pose(2.0, 1.5, 0.5))
    sim.run(0.3)
    assert speeds(sim)[-40:, 0].min() > 0.5 * moving  # without a stop
    sim.run(12.0)
    np.testing.assert_allclose(sim.pose(), [2.0, 1.5, 0.5], atol=0.03)
    assert_smooth(sim)


def test_plans_are_shifted_from_cycle_to_cycle(monkeypatch):
    made = []
    solve = Solver.solve

    def noted(self, start, guess, stage, iterations=1):
        answer = solve(self, start, guess, stage, iterations)
        made.append((guess.copy(), iterations, answer))
        return answer

    monkeypatch.setattr(Solver, "solve", noted)
    sim = SimulatedRun(planner())
    sim.drive(pose(2.0, 0.0, 0.0))
    sim.run(1.0)
    assert made[0][1] > 1 and not made[0][0].any()
    assert len(made) == 20
    for before, now in itertools.pairwise(made):
        assert now[1] == 1
        # Half a step later: between two of the last plan's currents.
        expected = 0.5 * (before[2].currents[:-1] + before[2].currents[1:])
        np.testing.assert_allclose(now[0][:-1], expected, atol=1e-6)


# ---- unreachable goals ------------------------------------------------------------------------


def test_goals_in_an_obstacle_or_outside_are_refused():
    room = {
        f"workspace__{name}": value
        for name, value in (("x_min", -3.0), ("y_min", -3.0), ("x_max", 3.0), ("y_max", 3.0))
    }
    sim = SimulatedRun(planner(**room), seen=ellipses((1.5, 0.0, 0.3)))
    still = StateGoal(np.array([9.0, 0.0, 0.0]), np.array([0.2, 0.0, 0.0]))
    for goal in (pose(9.0, 0.0, 0.0), pose(2.8, 0.0, 0.0), still):
        with pytest.raises(InputError, match="not within the workspace"):
            sim.drive(goal)
    blocked = StateGoal(np.array([1.5, 0.0, 0.0]), np.array([0.2, 0.0, 0.0]))
    for goal in (pose(1.5, 0.0, 0.0), pose(1.2, 0.5, 1.57), blocked):
        with pytest.raises(InputError, match=r"obstacle stands .* \(1\.\d+ m, "):
            sim.drive(goal)
    assert sim.planner.goal is None and sim.planner.state is PlannerState.IDLE
    # A moving obstacle may be gone by then.
    sim = SimulatedRun(
        planner(), seen=ellipses((1.5, 0.0, 0.3), velocities=[(0.0, 0.5)], time=100.0)
    )
    sim.drive(pose(1.5, 0.0, 0.0))
    # A refused goal leaves the previous goal in place.
    with pytest.raises(InputError):
        sim.drive(pose(5e3, 0.0, 0.0))
    assert sim.planner.state is PlannerState.DRIVING and sim.planner.goal is not None


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e9])
def test_measured_state_that_is_not_finite_is_refused(bad):
    for place in range(3):
        wrong = np.zeros(3)
        wrong[place] = bad
        with pytest.raises(InputError):
            MeasuredState(0.0, wrong, np.zeros(3))
        with pytest.raises(InputError):
            MeasuredState(0.0, np.zeros(3), wrong)
    with pytest.raises(InputError, match=r"shape = \(2,\) is refused: expected \(3,\)"):
        MeasuredState(0.0, np.zeros(2), np.zeros(3))


# ---- obstacles --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "row",
    representative(
        [(1.5, 0.0, 0.02, 0.5, 0.5), (1.5, 0.1, 0.03), (1.4, -0.15, 0.5, 0.1, 1.0)], every=3
    ),
)
def test_standing_obstacles_are_passed_without_contact(row):
    known = ellipses(row)
    sim = SimulatedRun(planner(), seen=known)
    sim.drive(pose(3.0, 0.0, 0.0))
    sim.run(12.0)
    assert sim.planner.state is PlannerState.ARRIVED
    assert sim.gaps(known).min() > 0.02


@pytest.mark.parametrize(
    ("speed", "meets"), [exhaustive(2.0, 1.8), exhaustive(4.0, 2.0), (8.0, 2.3)]
)
def test_small_fast_obstacle_between_two_steps_is_avoided(speed, meets):
    # The obstacle crosses the way of the robot when the robot would be there.
    known = ellipses((1.5, -speed * meets, 0.05), time=100.0, velocities=[(0.0, speed)])
    sim = SimulatedRun(planner(), seen=known)
    sim.drive(pose(3.0, 0.0, 0.0))
    sim.run(10.0)
    assert sim.planner.state is PlannerState.ARRIVED
    assert sim.gaps(known).min() > 0.02
    # On the way taken without the obstacle, they would collide.
    free = SimulatedRun(planner())
    free.drive(pose(3.0, 0.0, 0.0))
    free.run(10.0)
    assert free.gaps(known).min() == 0.0


@pytest.mark.parametrize("x", [1.9, exhaustive(2.2)])
def test_obstacle_that_appears_ahead_is_not_touched(x):
    known, nothing = ellipses((x, 0.05, 0.3)), ellipses()
    sim = SimulatedRun(planner(), seen=lambda now: known if now > 101.5 else nothing)
    sim.drive(pose(4.0, 0.0, 0.0))
    sim.run(1.5)
    assert speeds(sim)[-1, 0] > 0.7
    assert true_gaps(np.zeros(1), sim.pose()[None], sim.planner.model.half, known).min() > 0.3
    sim.run(15.0)
    assert sim.planner.state is PlannerState.ARRIVED
    assert sim.gaps(known).min() > 0.01


@pytest.mark.parametrize("seed", representative(range(4), 4))
def test_every_motion_is_clear_of_known_obstacles_to_its_end(seed):
    random = np.random.default_rng(seed)
    rows = [
        (*random.uniform(-2.5, 3.5, 2), *random.uniform(0.02, 0.4, 2), random.uniform(-3, 3))
        for _ in range(8)
    ]
    known = ellipses(*rows, time=100.0, velocities=random.uniform(-0.6, 0.6, (8, 2)))
    half = planner().model.half
    start = true_gaps(np.array([100.0]), np.zeros((1, 3)), half, known)[0]
    known = known.select(start > 0.3)
    sim = SimulatedRun(planner(), seen=known)
    sim.drive(pose(3.0, 1.0, 1.0))
    checked = 0
    for _ in range(40):
        sim.cycle()
        motion, report = sim.planner.motion, sim.planner.report
        if report.time_to_contact < math.inf or not sim.planner.active:
            break  # nothing is guaranteed from here on: obstacles may run into the robot
        times = np.arange(sim.now, sim.now + 1.9, 0.01)
        gaps = true_gaps(times, motion.at(times)[0], half, known)
        assert gaps.min() > 0.005
        checked += 1
    assert checked > 5


def test_obstacle_unknown_to_the_optimisation_stops_the_robot():
    wall = ellipses((1.5, 0.0, 0.3))
    # Without running costs, nothing guides the plan around the obstacle.
    sim = SimulatedRun(planner(horizon__slots=0, weights__running=0.0), seen=wall)
    sim.drive(pose(3.0, 0.0, 0.0))
    sim.run(6.5, until=lambda: sim.planner.state is PlannerState.BLOCKED)
    assert sim.planner.state is PlannerState.BLOCKED
    assert 0.5 < sim.pose()[0] < 0.9
    assert sim.gaps(wall).min() > 0.0


def test_planner_handles_a_large_number_of_obstacles():
    random = np.random.default_rng(1)
    places = random.uniform(-20, 20, (7000, 2))
    far = (np.hypot(*places.T) > 1.0) & (np.hypot(*(places - [3.0, 0.0]).T) > 1.0)
    places = places[far][:5000]
    assert len(places) == 5000
    flood = ellipses(*[(x, y, 0.1) for x, y in places])
    sim = SimulatedRun(planner(), seen=flood)
    sim.drive(pose(3.0, 0.0, 0.0))
    sim.run(3.0)
    near = flood.select(np.hypot(*places.T) < 4.0)
    few = slice(None, None, 10)
    times, poses = np.array(sim.times)[few], np.array(sim.poses)[few]
    assert true_gaps(times, poses, sim.planner.model.half, near).min() > 0.0
    assert sim.pose()[0] > 0.05 or sim.planner.state is PlannerState.BLOCKED


def test_robot_pushed_aside_continues_from_its_new_pose():
    beside = ellipses((1.5, 1.0, 0.3))
    sim = SimulatedRun(planner(), seen=beside)
    sim.drive(pose(3.0, -0.5, 0.0))
    sim.run(1.0)
    sim.offset = np.array([0.0, 0.4, 0.1])
    begin = len(sim.poses)
    sim.run(14.0)
    assert sim.planner.state is PlannerState.ARRIVED
    assert np.abs(sim.offset).max() < 0.02
    gaps = sim.gaps(beside)[begin:]
    assert gaps.min() > 0.0


# ---- faults -----------------------------------------------------------------------------------


def a_run(seconds=1.2, **kwargs):
    """Return a run that is under way at speed."""
    sim = SimulatedRun(planner(), **kwargs)
    sim.drive(pose(4.0, 0.0, 0.0))
    sim.run(seconds)
    assert speeds(sim)[-1, 0] > 0.6
    return sim


def test_late_solution_is_discarded_and_the_last_plan_continues():
    sim = a_run()
    before, now = sim.planner.motion, sim.now
    late = sim.planner.parameters.safety.deadline + 0.01
    sim.cycle(solving=late)
    report = sim.planner.report
    assert not report.used and not report.braking and "10 ms late" in report.reason
    assert report.lateness == pytest.approx(0.01)
    times = np.linspace(now, before.end, 50)
    np.testing.assert_allclose(sim.planner.motion.at(times)[0], before.at(times)[0], atol=1e-9)
    sim.cycle()
    assert sim.planner.report.used and sim.planner.report.lateness < 0.0
    assert_smooth(sim)


def test_robot_without_solutions_comes_to_rest():
    sim = a_run()
    end = sim.planner.motion.end
    while sim.now < end + 0.2:
        sim.cycle(solving=sim.planner.parameters.safety.deadline + 0.01)
    assert not sim.measured().twist.any()
    assert sim.planner.state is PlannerState.DRIVING
    sim.run(2.5, until=lambda: sim.planner.state is PlannerState.BLOCKED)
    sim.run(12.0)  # solutions are in time again
    assert sim.planner.state is PlannerState.ARRIVED
    assert_smooth(sim)


@pytest.mark.parametrize(
    "error",
    [
        SolverError("no luck"),
        RuntimeError("casadi says"),
        *map(exhaustive, (ValueError("x"), ZeroDivisionError("y"))),
    ],
)
def test_exception_in_the_solver_is_reported_and_recovered_from(monkeypatch, error):
    sim = a_run()
    before = sim.planner.motion

    def fails(*_, **__):
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(Solver, "solve", fails)
        for _ in range(5):
            sim.cycle()
            report = sim.planner.report
            assert not report.used and report.reason == f"solver: {error}"
            assert sim.planner.motion is before  # the motion is clear to its end
    sim.cycle()
    assert sim.planner.report.used and sim.planner.report.reason == ""
    sim.run(10.0)
    assert sim.planner.state is PlannerState.ARRIVED
    assert_smooth(sim)


def test_exception_in_front_of_an_obstacle_brakes_the_robot(monkeypatch):
    known, nothing = ellipses((2.3, 0.0, 0.3)), ellipses()
    sim = a_run(1.5, seen=lambda now: known if now > 101.5 else nothing)

    def fails(*_, **__):
        raise SolverError("no luck")

    monkeypatch.setattr(Solver, "solve", fails)
    braking = False
    for _ in range(60):
        sim.cycle()
        braking |= sim.planner.report.braking
        assert not sim.planner.report.used
    assert braking
    assert sim.gaps(known).min() > 0.0
    assert not sim.measured().twist.any()


def test_steps_that_are_not_finite_are_reported_and_recovered_from(monkeypatch):
    sim = a_run()
    before = sim.planner.motion
    shape = before.currents.shape[1] + 7
    with monkeypatch.context() as patch:
        patch.setattr(QuadraticProgram, "solve", lambda _: np.full(20 * shape, np.nan))
        for _ in range(4):
            sim.cycle()
            assert not sim.planner.report.used
            assert sim.planner.report.reason == "solver: the plan is not finite"
            assert sim.planner.motion is before
    sim.cycle()
    assert sim.planner.report.used
    sim.run(10.0)
    assert sim.planner.state is PlannerState.ARRIVED


@pytest.mark.parametrize("first", [0, exhaustive(2), 10])
def test_no_solution_produces_a_motion_that_is_not_finite(monkeypatch, first):
    sim = a_run()
    solve = Solver.solve

    def broken(self, *args, **kwargs):
        answer = solve(self, *args, **kwargs)
        states, currents = answer.states.copy(), answer.currents.copy()
        states[first:], currents[first:] = np.nan, np.nan
        return replace(answer, states=states, currents=currents)

    with monkeypatch.context() as patch:
        patch.setattr(Solver, "solve", broken)
        for _ in range(3):
            sim.cycle()
            assert np.isfinite(sim.planner.motion.poses).all()
            assert np.isfinite(sim.planner.motion.velocities).all()
            assert sim.planner.report.reason or first == 10  # the solution is usable up to there
    for _ in range(3):
        sim.cycle()
    assert sim.planner.report.used
    sim.run(10.0)
    assert sim.planner.state is PlannerState.ARRIVED


def test_obstacles_that_are_not_finite_stop_the_robot():
    unknown, nothing = ellipses((math.nan, 0.0, 0.3)), ellipses()
    sim = a_run(seen=lambda now: unknown if 101.2 < now < 103.0 else nothing)
    sim.run(1.5)
    assert not sim.measured().twist.any()
    assert not sim.planner.report.used and sim.planner.report.reason
    sim.run(12.0)
    assert sim.planner.state is PlannerState.ARRIVED


# ---- commands while driving -------------------------------------------------------------------


def test_pause_brakes_at_once_and_resume_continues():
    sim = a_run()
    place, speed = sim.pose()[0], speeds(sim)[-1, 0]
    sim.planner.pause(sim.now)
    assert sim.planner.state is PlannerState.PAUSED and not sim.planner.active
    sim.run(1.5, until=never)
    assert sim.pose()[0] - place == pytest.approx(speed**2 / 3.0, rel=0.3)
    assert not sim.measured().twist.any()
    assert sim.planner.resume(sim.measured())
    assert sim.planner.state is PlannerState.DRIVING
    sim.run(10.0)
    assert sim.planner.state is PlannerState.ARRIVED
    np.testing.assert_allclose(sim.pose(), [4.0, 0.0, 0.0], atol=0.03)
    assert not sim.planner.resume(sim.measured())
    assert_smooth(sim)


def test_resume_while_braking_continues_the_motion():
    sim = a_run()
    sim.planner.pause(sim.now)
    sim.run(0.15, until=never)
    assert sim.measured().twist[0] > 0.3
    assert sim.planner.resume(sim.measured())
    sim.run(10.0)
    assert sim.planner.state is PlannerState.ARRIVED
    assert_smooth(sim)


def test_cancel_brakes_and_discards_the_goal():
    sim = a_run()
    place = sim.pose()[0]
    sim.planner.cancel(sim.now)
    assert sim.planner.goal is None and sim.planner.state is PlannerState.IDLE
    sim.run(1.5, until=never)
    assert sim.pose()[0] - place < 0.4
    assert not sim.planner.resume(sim.measured())
    assert sim.planner.propose(sim.now, sim.measured(), ellipses()).fault == "no goal"


@pytest.mark.parametrize("order", ["pause", "cancel"])
def test_solution_from_before_a_stop_does_not_undo_the_stop(order):
    sim = a_run()
    known = sim.seen(sim.now)
    proposal = sim.planner.propose(sim.now, sim.measured(), known)
    getattr(sim.planner, order)(sim.now + 0.005)
    braking = sim.planner.motion
    sim.planner.take(proposal, sim.now + 0.01, sim.measured(), known)
    assert sim.planner.motion is braking
    assert not sim.planner.report.used and "no goal" in sim.planner.report.reason


def test_abort_sets_the_robot_at_rest_at_its_pose():
    sim = a_run()
    measured = sim.measured()
    sim.planner.abort(sim.now, measured)
    assert sim.planner.goal is None and sim.planner.state is PlannerState.IDLE
    found, velocity = sim.planner.motion.sample(sim.now + 1.0)
    np.testing.assert_allclose(found, measured.pose)
    assert not velocity.any()


# ---- settings ---------------------------------------------------------------------------------


def test_settings_can_change_while_driving():
    sim = a_run()
    sim.planner.configure(parameters(limits__linear_velocity=0.4))
    sim.run(1.5)
    begin = len(sim.poses)
    sim.run(0.5)
    assert speeds(sim)[begin:, 0].max() < 0.4
    sim.planner.configure(parameters(limits__linear_velocity=0.4, body__mass=40.0))
    assert sim.planner.model.inertia[0, 0] > 40.0
    sim.run(15.0)
    assert sim.planner.state is PlannerState.ARRIVED
    assert_smooth(sim)


@pytest.mark.exhaustive
def test_clearance_can_change_while_driving():
    closest = []
    for clearance in (0.05, 0.3):
        known = ellipses((2.5, 0.5, 0.3))
        sim = a_run(seen=known)
        sim.planner.configure(parameters(safety__clearance=clearance))
        sim.run(3.3)
        assert sim.pose()[0] > 2.9
        closest.append(sim.gaps(known).min())
    assert closest[0] < 0.2 and closest[1] > 0.27


@pytest.mark.parametrize("fraction", [exhaustive(0.7), 0.4])
def test_reduced_limit_scale_is_reached_and_never_exceeded(fraction):
    sim = SimulatedRun(planner())
    sim.drive(pose(6.0, 2.0, 0.0))
    sim.run(1.5)
    fast = speeds(sim)[-1, 0]
    sim.planner.set_limit_scale(fraction)
    assert sim.planner.limits.limit_scale == fraction
    begin = len(sim.poses)
    sim.run(4.0)
    slowed = speeds(sim)[begin:, 0]
    assert slowed.max() < fast + 0.01
    assert slowed[-1] < 0.95 * fraction
    sim.planner.set_limit_scale(1.0)
    sim.run(2.0)
    assert speeds(sim)[-400:, 0].max() > slowed[-1] + 0.05


def test_braking_is_as_slow_as_the_posture_demands_also_with_new_parameters():
    made = planner()
    full = made.limits.decelerations
    made.set_limit_scale(0.4)  # a dead wheel: the controller brakes as ever
    assert made.limits.decelerations == full
    made.set_limit_scale(0.4, 0.5)
    made.configure(parameters(limits__linear_velocity=0.4))
    assert made.limits.decelerations == pytest.approx([0.5 * limit for limit in full])
    assert made.limits.speeds[0] == pytest.approx(0.4 * 0.4 * 0.85)


# ---- what is reported -------------------------------------------------------------------------


def test_voltages_are_those_of_the_plan():
    sim = a_run()
    planning, motion = sim.planner.model, sim.planner.motion
    volts = sim.planner.voltages(sim.now + CYCLE)
    assert volts is not None and volts.shape == (4,)
    pose_then, velocity = motion.sample(sim.now + CYCLE)
    c, s = math.cos(pose_then[2]), math.sin(pose_then[2])
    twist = np.array(
        [c * velocity[0] + s * velocity[1], c * velocity[1] - s * velocity[0], velocity[2]]
    )
    expected = planning.voltages(motion.currents_at(sim.now + CYCLE), twist)
    np.testing.assert_allclose(volts, expected, atol=0.3)  # except for friction at very low speed
    assert np.abs(volts).max() > 3.0
    assert sim.planner.voltages(motion.end + 1.0) is None
    sim.planner.cancel(sim.now)
    assert sim.planner.voltages(sim.planner.motion.end - 0.01) is None


def test_error_is_the_distance_to_the_goal():
    sim = a_run()
    distance, angle = sim.planner.error(sim.measured())
    assert distance == pytest.approx(np.hypot(*(sim.pose()[:2] - [4.0, 0.0])))
    assert angle == pytest.approx(abs(sim.pose()[2]))
    sim.planner.cancel(sim.now)
    assert sim.planner.error(sim.measured()) == (0.0, 0.0)


def test_sent_motion_brakes_soon_while_the_plan_continues():
    sim = a_run()
    planner, now = sim.planner, sim.now
    sent, whole = planner.preview, planner.motion
    assert sent.end < now + 1.2 < whole.end
    assert np.abs(sent.velocities[-1]).max() < 1e-9
    early = np.linspace(now, now + 0.3, 20)
    np.testing.assert_allclose(sent.at(early)[0], whole.at(early)[0], atol=1e-9)
    sim.run(12.0)
    assert sim.planner.state is PlannerState.ARRIVED, "each cycle sends more of it"


def test_where_braking_soon_is_not_clear_the_whole_motion_is_sent():
    """An obstacle passes behind: stopping earlier would lead to contact."""
    things = ellipses((-1.3, 0.0, 0.3), velocities=[(0.8, 0.0)], time=100.0)
    sim = SimulatedRun(
        planner(),
        seen=lambda now: replace(things, time=now, centers=things.centers_at(np.array([now]))[0]),
    )
    sim.drive(pose(8.0, 0.0, 0.0))
    whole = []
    for _ in range(60):
        sim.cycle()
        whole.append(sim.planner.preview is sim.planner.motion)
    assert any(whole[30:]) and speeds(sim)[-1, 0] > 0.5


# ---- walls and routes around ------------------------------------------------------------------

CELL = 0.05  #: Of the maps of these tests [m]
CORNER = np.array([-1.0, -1.5, 0.0])  #: Where their first cell is


def floor_plan(*boxes, size=(5.0, 3.0)):
    """Return a map of walls (x0, y0, x1, y1) in odom, closed all around."""
    columns, rows = (round(edge / CELL) for edge in size)
    cells = np.zeros((rows, columns), dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    for box in boxes:
        (x0, y0), (x1, y1) = (np.round((np.reshape(box, (2, 2)) - CORNER[:2]) / CELL)).astype(int)
        cells[y0:y1, x0:x1] = True
    return GridMap(cells, CELL, CORNER)


def wall_gap(sim, grid):
    """Return the minimum gap between the driven motion and the occupied cells [m]."""
    rows, columns = np.nonzero(grid.occupied)
    edge = np.linspace(0.0, 1.0, 3)
    spots = np.stack(np.meshgrid(edge, edge), axis=-1).reshape(1, -1, 2)
    points = (np.column_stack([columns, rows])[:, None] + spots).reshape(-1, 2) * CELL
    walls = Walls(np.unique(points, axis=0) + grid.origin[:2], 0.0)
    few = slice(None, None, 5)
    return float(walls.gaps(np.array(sim.poses)[few], sim.planner.footprint.whole).min())


def test_rooms_are_crossed_through_their_doors_without_touching_a_wall():
    # One door at the top and one at the bottom, 0.65 m wide for a robot of 0.5 m.
    walls = (0.8, -1.5, 0.9, 0.75), (2.3, -0.75, 2.4, 1.5)
    grid = floor_plan(*walls)
    sim = SimulatedRun(planner())
    sim.planner.set_map(grid)
    sim.drive(pose(3.2, 0.8, 0.0))
    sim.run(25.0)
    assert sim.planner.state is PlannerState.ARRIVED
    np.testing.assert_allclose(sim.pose(), [3.2, 0.8, 0.0], atol=0.03)
    assert wall_gap(sim, grid) > 0.015
    across = np.array(sim.poses)
    assert across[np.abs(across[:, 0] - 0.85) < 0.1, 1].min() > 0.7
    assert across[np.abs(across[:, 0] - 2.35) < 0.1, 1].max() < -0.7
    assert_smooth(sim)


@pytest.mark.exhaustive
def test_state_goal_behind_a_wall_is_passed():
    grid = floor_plan((1.2, -1.5, 1.3, 0.6))
    goal = StateGoal(np.array([2.6, -0.5, 0.0]), np.array([0.4, 0.0, 0.0]))
    sim = SimulatedRun(planner())
    sim.planner.set_map(grid)
    sim.drive(goal)
    sim.run(25.0)
    assert sim.planner.state is PlannerState.ARRIVED
    away = np.hypot(*(np.array(sim.poses)[:, :2] - goal.pose[:2]).T)
    passed = int(np.argmin(away))
    assert away[passed] < 0.04
    before, after = sim.poses[passed - 4], sim.poses[passed]
    found = (after - before) / (sim.times[passed] - sim.times[passed - 4])
    np.testing.assert_allclose(found, goal.velocity, atol=0.15)
    sim.run(2.0, until=never)
    assert wall_gap(sim, grid) > 0.01
    assert_smooth(sim)


def test_goals_inside_a_wall_are_refused_and_goals_next_to_a_wall_are_not():
    grid = floor_plan((1.2, -1.5, 1.3, 0.4), (2.0, -1.5, 4.0, 0.2))
    sim = SimulatedRun(planner())
    sim.planner.set_map(grid)
    for inside in (pose(1.25, 0.0, 0.0), pose(0.9, 0.0, 0.0), pose(1.3, 0.5, 1.5)):
        with pytest.raises(InputError, match="obstacle stands where the robot would be"):
            sim.drive(inside)
    assert sim.planner.goal is None
    with pytest.raises(InputError, match="obstacle stands"):
        sim.drive(pose(3.0, -0.7, 0.0))  # far inside, away from every edge
    sim.drive(pose(1.25, 0.9, 0.0))
    assert sim.planner.state is PlannerState.DRIVING
    sim.planner.set_map(None)
    sim.drive(pose(1.25, 0.0, 0.0))


def test_new_goal_replaces_a_goal_whose_route_is_still_searched():
    grid = floor_plan((1.2, -1.5, 1.3, 0.6))
    sim = SimulatedRun(planner())
    sim.planner.set_map(grid)
    sim.drive(pose(2.6, -0.5, 0.0))
    sim.cycle()
    assert sim.planner.route_planner.source is RouteSource.SEARCH
    sim.drive(pose(-0.2, 0.3, 0.0))
    assert sim.planner.route_planner.source is RouteSource.STRAIGHT_LINE
    sim.run(10.0)
    assert sim.planner.state is PlannerState.ARRIVED
    np.testing.assert_allclose(sim.pose(), [-0.2, 0.3, 0.0], atol=0.03)


def test_pause_during_a_search_keeps_the_robot_at_rest():
    grid = floor_plan((1.2, -1.5, 1.3, 0.6))
    sim = SimulatedRun(planner())
    sim.planner.set_map(grid)
    sim.drive(pose(2.6, -0.5, 0.0))
    sim.cycle()
    sim.planner.pause(sim.now)
    sim.run(1.0, until=never)
    assert sim.planner.state is PlannerState.PAUSED and not sim.measured().twist.any()
    assert sim.planner.resume(sim.measured())
    sim.run(20.0)
    assert sim.planner.state is PlannerState.ARRIVED
    assert wall_gap(sim, grid) > 0.01


# ---- blocked, and in what the map calls occupied ------------------------------------------------


def half_plane(*boxes):
    """Return a map that is occupied for x < 0.3 m, and in boxes."""
    return floor_plan((-0.9, -1.4, 0.3, 1.4), *boxes)


def test_a_robot_amid_occupied_cells_leaves_by_the_free_side_and_reaches_the_goal():
    sim = SimulatedRun(planner())
    sim.planner.set_map(half_plane())
    sim.drive(pose(1.5, 0.0, 0.0))
    sim.run(0.3, until=never)
    assert sim.planner.route_planner.source is RouteSource.ESCAPE_PATH
    assert sim.planner.state is PlannerState.DRIVING
    sim.run(10.0)
    assert sim.planner.state is PlannerState.ARRIVED and PlannerState.BLOCKED not in sim.states
    driven = np.array(sim.poses)
    assert driven[:, 0].min() > -0.01 and np.abs(driven[driven[:, 0] < 0.6, 1]).max() < 0.03


def test_a_robot_without_a_way_out_stays_and_names_the_cells():
    sim = SimulatedRun(planner())
    sim.planner.set_map(half_plane((0.5, -1.4, 0.6, 1.4)))
    sim.drive(pose(1.5, 0.0, 0.0))
    sim.run(4.0, until=never)
    assert sim.planner.state is PlannerState.BLOCKED
    assert sim.planner.blocked_by.startswith("the map at (0.")
    assert "where the robot is: no way out" in sim.planner.blocked_by
    assert np.abs(np.array(sim.poses)).max() < 1e-3


def test_a_blocked_robot_steps_aside_for_a_walker_and_names_what_is_in_the_way():
    shut = floor_plan((1.2, -1.5, 1.3, 1.5))
    sim = SimulatedRun(planner())
    sim.planner.set_map(shut)
    sim.drive(pose(2.6, 0.0, 0.0))
    sim.run(5.0, until=never)
    assert sim.planner.state is PlannerState.BLOCKED
    assert sim.planner.blocked_by.startswith("the map at (1.2")
    assert sim.planner.blocked_by.endswith("is in the way: there is no way")
    assert np.abs(np.array(sim.poses)[:, :2]).max() < 0.01
    walker = ellipses((-2.0, 0.1, 0.2), velocities=[(0.5, 0.0)], time=sim.now)
    sim.seen = lambda now: observed(walker, now)
    sim.run(8.0, until=never)
    places = np.array(sim.poses)[:, :2]
    assert sim.gaps(walker).min() > 0.0
    assert places[:, 0].max() < 0.3, "it steps aside, and is not pushed against the wall"
    np.testing.assert_allclose(sim.pose(), np.zeros(3), atol=0.02, err_msg="and comes back")


def test_a_robot_that_finds_no_way_while_it_drives_brakes_and_stays():
    sim = SimulatedRun(planner())
    sim.drive(pose(3.4, 0.0, 0.0))
    sim.run(1.2)
    sim.planner.set_map(floor_plan((2.6, -1.5, 2.7, 1.5)))
    sim.run(6.0, until=lambda: sim.planner.state is PlannerState.BLOCKED)
    assert sim.planner.state is PlannerState.BLOCKED
    sim.run(4.0, until=never)
    stands = sim.pose()
    sim.run(2.0, until=never)
    np.testing.assert_allclose(sim.pose(), stands, atol=5e-3)
    assert stands[0] < 2.05, "not as near to the wall as it gets"


def test_a_goal_that_is_refused_names_what_stands_there():
    sim = SimulatedRun(planner(), seen=ellipses((1.5, 0.3, 0.3)))
    sim.planner.set_map(half_plane())
    with pytest.raises(InputError, match=r"stands .* the obstacle at \(1\.50, 0\.30\) m"):
        sim.drive(pose(1.5, 0.0, 0.0))
    with pytest.raises(InputError, match=r"stands .* the map at \(-?0\.\d+, "):
        sim.drive(pose(0.0, 0.0, 0.0))


# ---- one call a cycle -----------------------------------------------------------------------


def test_a_cycle_in_one_call_drives_to_the_goal_past_an_obstacle():
    """The state is where the robot was told to be, and time passes only between the calls."""
    it, now = planner(), 5.0
    measured = MeasuredState(now, np.zeros(3), np.zeros(3))
    post = ellipses((1.0, 0.05, 0.2), time=now)
    assert it.cycle(now, measured, post).end <= now + CYCLE  # rests without a goal
    it.drive(pose(2.0, 0.0, 0.0), measured, post)
    nearest = math.inf
    while it.state is not PlannerState.ARRIVED and now < 25.0:
        motion = it.cycle(now, measured, post)
        assert np.abs(motion.sample(motion.end)[1]).max() < 1e-9  # ends at rest
        now += CYCLE
        measured = MeasuredState.on(motion, now)
        there = measured.pose[None]
        nearest = min(nearest, true_gaps(np.array([now]), there, it.model.half, post).min())
    assert it.state is PlannerState.ARRIVED
    np.testing.assert_allclose(measured.pose, [2.0, 0.0, 0.0], atol=0.02)
    assert nearest >= it.parameters.safety.least_clearance
