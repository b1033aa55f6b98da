import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.preview import Preview
from omniman_ros.planning.cycle import Measured, PlannerState
from omniman_ros.planning.goals import PoseGoal, StateGoal, TrajectoryGoal
from omniman_ros.planning.grid_map import GridMap
from omniman_ros.planning.solver import Solver, SolverError
from omniman_ros.planning.walls import Walls

from .support import CYCLE, Ride, ellipses, parameters, planner, true_gaps


def pose(x, y, theta):
    return PoseGoal(np.array([x, y, theta], float))


def never():
    return False


def speeds(ride):
    """Linear and angular speed (K, 2) of what the robot did."""
    dt = np.diff(ride.times)
    moved = np.diff(np.array(ride.poses), axis=0) / dt[:, None]
    return np.column_stack([np.hypot(moved[:, 0], moved[:, 1]), np.abs(moved[:, 2])])


def assert_smooth(ride):
    """No jump of pose or speed."""
    dt = np.diff(ride.times)[:, None]
    velocity = np.diff(np.array(ride.poses), axis=0) / dt
    assert np.abs(velocity[:, :2]).max() < 1.1 and np.abs(velocity[:, 2]).max() < 2.2
    assert np.abs(np.diff(velocity, axis=0) / dt[1:])[:, :2].max() < 4.0


# ---- goals ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "goal"),
    [("ig42", (2.0, 1.0, 0.5)), ("omniman", (-1.5, 0.5, -2.0)), ("omni3", (0.0, -1.0, 1.5))],
)
def test_a_pose_is_reached_and_the_limits_are_kept(name, goal):
    ride = Ride(planner(name))
    ride.drive(pose(*goal))
    ride.run(12.0)
    assert ride.planner.state is PlannerState.ARRIVED and ride.planner.goal is None
    ride.run(3.0, until=never)
    np.testing.assert_allclose(ride.pose(), goal, atol=0.02)
    limits = parameters(name).limits
    fastest = speeds(ride).max(axis=0)
    assert fastest[0] < 0.92 * limits.linear_velocity
    assert fastest[1] < 0.92 * limits.angular_velocity
    assert fastest.max() > 0.5
    assert_smooth(ride)


def test_any_number_of_wheels_will_do():
    ride = Ride(planner("mecanum8"))
    ride.drive(pose(0.5, 0.3, 0.2))
    ride.run(8.0)
    assert ride.planner.state is PlannerState.ARRIVED


@pytest.mark.parametrize(("speed", "angle"), [(0.2, 0.5), (0.5, -0.6), (0.7, 0.0)])
def test_a_pose_is_passed_at_its_velocity(speed, angle):
    ride = Ride(planner())
    velocity = speed * np.array([math.cos(angle), math.sin(angle), 0.0])
    goal = StateGoal(np.array([2.0, 0.5, 0.2]), velocity)
    ride.drive(goal)
    ride.run(15.0)
    assert ride.planner.state is PlannerState.ARRIVED
    away = np.hypot(*(np.array(ride.poses)[:, :2] - goal.pose[:2]).T)
    passed = int(np.argmin(away[:-1]))
    assert away[passed] < 0.03
    assert passed > len(away) - 60  # it is told when it is passed, no sooner
    before, after = ride.poses[passed - 4], ride.poses[passed + 1]
    found = (after - before) / (ride.times[passed + 1] - ride.times[passed - 4])
    np.testing.assert_allclose(found, velocity, atol=0.12)
    assert ride.poses[passed][2] == pytest.approx(0.2, abs=0.03)
    ride.run(4.0, until=never)
    assert not ride.measured().twist.any()


def test_a_trajectory_is_followed():
    times = np.linspace(101.0, 107.0, 61)
    turn = 0.6 * (times - 101.0)
    poses = np.column_stack([np.sin(turn), 1.0 - np.cos(turn), 0.3 * turn])
    velocities = 0.6 * np.column_stack([np.cos(turn), np.sin(turn), 0.3 + 0 * turn])
    goal = TrajectoryGoal(Preview(times, poses, velocities))
    ride = Ride(planner())
    ride.drive(goal)
    ride.run(12.0)
    assert ride.planner.state is PlannerState.ARRIVED and 107.0 < ride.now < 109.0
    seen = np.array(ride.times)
    along = (seen > 103.0) & (seen < 106.5)
    wanted, _ = goal.targets(seen[along])
    away = np.array(ride.poses)[along] - wanted
    assert np.hypot(away[:, 0], away[:, 1]).max() < 0.06
    assert np.abs(away[:, 2]).max() < 0.06
    np.testing.assert_allclose(ride.pose(), poses[-1], atol=0.03)


@pytest.mark.parametrize("wrapped", [False, True])
def test_the_heading_never_unwinds(wrapped):
    ride = Ride(planner(), (0.0, 0.0, 3.1), wrapped=wrapped)
    for x, heading in ((0.0, -3.1), (0.2, -2.9), (0.2, 3.0), (0.0, -2.5)):
        begin = len(ride.poses)
        ride.drive(pose(x, 0.0, heading))
        ride.run(10.0)
        assert ride.planner.state is PlannerState.ARRIVED
        turned = np.ptp(np.array(ride.poses)[begin:, 2])
        assert turned < 1.0
        assert abs(math.remainder(ride.pose()[2] - heading, math.tau)) < 0.03


def test_the_branch_of_the_heading_stays_with_a_goal():
    ride = Ride(planner(), (0.0, 0.0, 3.0), wrapped=True)
    ride.drive(pose(1.0, 0.0, 0.0))  # a half turn: either way
    ride.run(12.0)
    assert ride.planner.state is PlannerState.ARRIVED
    headings = np.array(ride.poses)[:, 2]
    assert np.ptp(headings) < math.pi
    back = np.diff(headings) * np.sign(headings[-1] - headings[0])
    assert back.min() > -2e-3


def test_a_new_goal_is_taken_on_the_way():
    ride = Ride(planner())
    ride.drive(pose(3.0, 0.0, 0.0))
    ride.run(1.5)
    moving = speeds(ride)[-1, 0]
    ride.drive(pose(2.0, 1.5, 0.5))
    ride.run(0.3)
    assert speeds(ride)[-40:, 0].min() > 0.5 * moving  # without a stop
    ride.run(12.0)
    np.testing.assert_allclose(ride.pose(), [2.0, 1.5, 0.5], atol=0.03)
    assert_smooth(ride)


def test_plans_are_shifted_from_cycle_to_cycle(monkeypatch):
    made = []
    solve = Solver.solve

    def noted(self, start, guess, stage, iterations=1):
        answer = solve(self, start, guess, stage, iterations)
        made.append((guess.copy(), iterations, answer))
        return answer

    monkeypatch.setattr(Solver, "solve", noted)
    ride = Ride(planner())
    ride.drive(pose(2.0, 0.0, 0.0))
    ride.run(1.0)
    assert made[0][1] > 1 and not made[0][0].any()
    assert len(made) == 20
    for before, now in zip(made[:-1], made[1:], strict=True):
        assert now[1] == 1
        # Half a step later: between two of the last plan's currents.
        expected = 0.5 * (before[2].currents[:-1] + before[2].currents[1:])
        np.testing.assert_allclose(now[0][:-1], expected, atol=1e-6)


# ---- what can't be reached --------------------------------------------------------------------


def test_goals_in_an_obstacle_or_outside_are_refused():
    room = {
        f"workspace__{name}": value
        for name, value in (("x_min", -3.0), ("y_min", -3.0), ("x_max", 3.0), ("y_max", 3.0))
    }
    ride = Ride(planner(**room), seen=ellipses((1.5, 0.0, 0.3)))
    still = StateGoal(np.array([9.0, 0.0, 0.0]), np.array([0.2, 0.0, 0.0]))
    for goal in (pose(9.0, 0.0, 0.0), pose(2.8, 0.0, 0.0), still):
        with pytest.raises(InputError, match="not within the workspace"):
            ride.drive(goal)
    blocked = StateGoal(np.array([1.5, 0.0, 0.0]), np.array([0.2, 0.0, 0.0]))
    for goal in (pose(1.5, 0.0, 0.0), pose(1.2, 0.5, 1.57), blocked):
        with pytest.raises(InputError, match=r"obstacle stands .* \(1\.\d+ m, "):
            ride.drive(goal)
    assert ride.planner.goal is None and ride.planner.state is PlannerState.IDLE
    # One that goes by may be gone until then.
    ride = Ride(planner(), seen=ellipses((1.5, 0.0, 0.3), velocities=[(0.0, 0.5)], time=100.0))
    ride.drive(pose(1.5, 0.0, 0.0))
    # A refused goal leaves the last one as it is.
    with pytest.raises(InputError):
        ride.drive(pose(5e3, 0.0, 0.0))
    assert ride.planner.state is PlannerState.DRIVING and ride.planner.goal is not None


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e9])
def test_a_measured_state_that_is_none_is_refused(bad):
    for place in range(3):
        wrong = np.zeros(3)
        wrong[place] = bad
        with pytest.raises(InputError):
            Measured(0.0, wrong, np.zeros(3))
        with pytest.raises(InputError):
            Measured(0.0, np.zeros(3), wrong)
    with pytest.raises(InputError, match="three"):
        Measured(0.0, np.zeros(2), np.zeros(3))


def test_a_closed_ring_blocks_the_robot_without_contact():
    turn = np.arange(10) * 0.2 * np.pi
    ring = ellipses(*[(1.1 * np.cos(a), 1.1 * np.sin(a), 0.3) for a in turn])
    ride = Ride(planner(), seen=ring)
    ride.drive(pose(3.0, 0.3, 0.0))
    ride.run(8.0, until=lambda: ride.planner.state is PlannerState.BLOCKED)
    assert ride.planner.state is PlannerState.BLOCKED and ride.planner.active
    ride.run(7.0, until=never)
    assert ride.gaps(ring).min() > 0.015
    assert speeds(ride)[-100:, 0].max() < 0.05
    assert ride.planner.goal is not None
    # Where the ring opens, it goes on.
    ride.seen = lambda now: ring.select(np.arange(10) % 9 > 0)  # the two ahead are gone
    ride.run(14.0)
    assert ride.planner.state is PlannerState.ARRIVED


# ---- obstacles --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "row", [(1.5, 0.1, 0.03), (1.5, 0.0, 0.02, 0.5, 0.5), (1.4, -0.15, 0.5, 0.1, 1.0)]
)
def test_standing_obstacles_are_passed_without_contact(row):
    known = ellipses(row)
    ride = Ride(planner(), seen=known)
    ride.drive(pose(3.0, 0.0, 0.0))
    ride.run(12.0)
    assert ride.planner.state is PlannerState.ARRIVED
    assert ride.gaps(known).min() > 0.02


@pytest.mark.parametrize(("speed", "meets"), [(2.0, 1.8), (4.0, 2.0), (8.0, 2.3)])
def test_a_small_fast_obstacle_is_not_stepped_over(speed, meets):
    # It crosses the robot's way when the robot would be there.
    known = ellipses((1.5, -speed * meets, 0.05), time=100.0, velocities=[(0.0, speed)])
    ride = Ride(planner(), seen=known)
    ride.drive(pose(3.0, 0.0, 0.0))
    ride.run(10.0)
    assert ride.planner.state is PlannerState.ARRIVED
    assert ride.gaps(known).min() > 0.02
    # On the way that it takes without the obstacle they would meet.
    free = Ride(planner())
    free.drive(pose(3.0, 0.0, 0.0))
    free.run(10.0)
    assert free.gaps(known).min() == 0.0


@pytest.mark.parametrize("x", [1.9, 2.2])
def test_an_obstacle_that_appears_ahead_is_not_touched(x):
    known, nothing = ellipses((x, 0.05, 0.3)), ellipses()
    ride = Ride(planner(), seen=lambda now: known if now > 101.5 else nothing)
    ride.drive(pose(4.0, 0.0, 0.0))
    ride.run(1.5)
    assert speeds(ride)[-1, 0] > 0.7
    assert true_gaps(np.zeros(1), ride.pose()[None], ride.planner.model.half, known).min() > 0.3
    ride.run(15.0)
    assert ride.planner.state is PlannerState.ARRIVED
    assert ride.gaps(known).min() > 0.01


@pytest.mark.parametrize("seed", range(4))
def test_every_motion_is_clear_of_what_is_known_all_the_way(seed):
    random = np.random.default_rng(seed)
    rows = [
        (*random.uniform(-2.5, 3.5, 2), *random.uniform(0.02, 0.4, 2), random.uniform(-3, 3))
        for _ in range(8)
    ]
    known = ellipses(*rows, time=100.0, velocities=random.uniform(-0.6, 0.6, (8, 2)))
    half = planner().model.half
    start = true_gaps(np.array([100.0]), np.zeros((1, 3)), half, known)[0]
    known = known.select(start > 0.3)
    ride = Ride(planner(), seen=known)
    ride.drive(pose(3.0, 1.0, 1.0))
    checked = 0
    for _ in range(40):
        ride.cycle()
        motion, report = ride.planner.motion, ride.planner.report
        if report.contact < math.inf or not ride.planner.active:
            break  # from here on nothing is promised: obstacles may run into it
        times = np.arange(ride.now, ride.now + 1.9, 0.01)
        gaps = true_gaps(times, motion.at(times)[0], half, known)
        assert gaps.min() > 0.005
        checked += 1
    assert checked > 5


def test_what_the_optimisation_does_not_know_stops_the_robot():
    wall = ellipses((1.5, 0.0, 0.3))
    # Without running costs nothing leads around it.
    ride = Ride(planner(horizon__slots=0, weights__running=0.0), seen=wall)
    ride.drive(pose(3.0, 0.0, 0.0))
    ride.run(6.5, until=lambda: ride.planner.state is PlannerState.BLOCKED)
    assert ride.planner.state is PlannerState.BLOCKED
    assert 0.5 < ride.pose()[0] < 0.9
    assert ride.gaps(wall).min() > 0.0


def test_a_flood_of_obstacles_is_survived():
    random = np.random.default_rng(1)
    places = random.uniform(-20, 20, (7000, 2))
    far = (np.hypot(*places.T) > 1.0) & (np.hypot(*(places - [3.0, 0.0]).T) > 1.0)
    places = places[far][:5000]
    assert len(places) == 5000
    flood = ellipses(*[(x, y, 0.1) for x, y in places])
    ride = Ride(planner(), seen=flood)
    ride.drive(pose(3.0, 0.0, 0.0))
    ride.run(3.0)
    near = flood.select(np.hypot(*places.T) < 4.0)
    few = slice(None, None, 10)
    times, poses = np.array(ride.times)[few], np.array(ride.poses)[few]
    assert true_gaps(times, poses, ride.planner.model.half, near).min() > 0.0
    assert ride.pose()[0] > 0.05 or ride.planner.state is PlannerState.BLOCKED


def test_a_robot_pushed_aside_goes_on_from_there():
    beside = ellipses((1.5, 1.0, 0.3))
    ride = Ride(planner(), seen=beside)
    ride.drive(pose(3.0, -0.5, 0.0))
    ride.run(1.0)
    ride.offset = np.array([0.0, 0.4, 0.1])
    begin = len(ride.poses)
    ride.run(14.0)
    assert ride.planner.state is PlannerState.ARRIVED
    assert np.abs(ride.offset).max() < 0.02
    gaps = ride.gaps(beside)[begin:]
    assert gaps.min() > 0.0


# ---- faults -----------------------------------------------------------------------------------


def a_ride(seconds=1.2, **kwargs):
    """On its way at speed."""
    ride = Ride(planner(), **kwargs)
    ride.drive(pose(4.0, 0.0, 0.0))
    ride.run(seconds)
    assert speeds(ride)[-1, 0] > 0.6
    return ride


def test_a_late_answer_is_not_used_and_the_last_plan_goes_on():
    ride = a_ride()
    before, now = ride.planner.motion, ride.now
    late = ride.planner.parameters.safety.deadline + 0.01
    ride.cycle(solving=late)
    report = ride.planner.report
    assert not report.used and not report.braking and "10 ms late" in report.why
    assert report.late == pytest.approx(0.01)
    times = np.linspace(now, before.end, 50)
    np.testing.assert_allclose(ride.planner.motion.at(times)[0], before.at(times)[0], atol=1e-9)
    ride.cycle()
    assert ride.planner.report.used and ride.planner.report.late < 0.0
    assert_smooth(ride)


def test_a_robot_without_answers_ends_at_rest():
    ride = a_ride()
    end = ride.planner.motion.end
    while ride.now < end + 0.2:
        ride.cycle(solving=ride.planner.parameters.safety.deadline + 0.01)
    assert not ride.measured().twist.any()
    assert ride.planner.state is PlannerState.DRIVING
    ride.run(2.5, until=lambda: ride.planner.state is PlannerState.BLOCKED)
    ride.run(12.0)  # now answers are in time again
    assert ride.planner.state is PlannerState.ARRIVED
    assert_smooth(ride)


@pytest.mark.parametrize(
    "error",
    [SolverError("no luck"), RuntimeError("casadi says"), ValueError("x"), ZeroDivisionError("y")],
)
def test_an_exception_in_the_solver_is_told_and_got_over(monkeypatch, error):
    ride = a_ride()
    before = ride.planner.motion

    def fails(*_, **__):
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(Solver, "solve", fails)
        for _ in range(5):
            ride.cycle()
            report = ride.planner.report
            assert not report.used and report.why == f"solver: {error}"
            assert ride.planner.motion is before  # it is clear to its end
    ride.cycle()
    assert ride.planner.report.used and ride.planner.report.why == ""
    ride.run(10.0)
    assert ride.planner.state is PlannerState.ARRIVED
    assert_smooth(ride)


def test_an_exception_before_an_obstacle_brakes(monkeypatch):
    known, nothing = ellipses((2.3, 0.0, 0.3)), ellipses()
    ride = a_ride(1.5, seen=lambda now: known if now > 101.5 else nothing)

    def fails(*_, **__):
        raise SolverError("no luck")

    monkeypatch.setattr(Solver, "solve", fails)
    braking = False
    for _ in range(60):
        ride.cycle()
        braking |= ride.planner.report.braking
        assert not ride.planner.report.used
    assert braking
    assert ride.gaps(known).min() > 0.0
    assert not ride.measured().twist.any()


def test_steps_that_are_not_finite_are_told_and_got_over(monkeypatch):
    ride = a_ride()
    before = ride.planner.motion
    shape = before.currents.shape[1] + 7
    with monkeypatch.context() as patch:
        patch.setattr(Solver, "_step", lambda *_: np.full((20, shape), np.nan))
        for _ in range(4):
            ride.cycle()
            assert not ride.planner.report.used
            assert ride.planner.report.why == "solver: the plan is not finite"
            assert ride.planner.motion is before
    ride.cycle()
    assert ride.planner.report.used
    ride.run(10.0)
    assert ride.planner.state is PlannerState.ARRIVED


@pytest.mark.parametrize("first", [0, 2, 10])
def test_no_answer_makes_a_motion_that_is_not_finite(monkeypatch, first):
    ride = a_ride()
    solve = Solver.solve

    def broken(self, *args, **kwargs):
        answer = solve(self, *args, **kwargs)
        states, currents = answer.states.copy(), answer.currents.copy()
        states[first:], currents[first:] = np.nan, np.nan
        return replace(answer, states=states, currents=currents)

    with monkeypatch.context() as patch:
        patch.setattr(Solver, "solve", broken)
        for _ in range(3):
            ride.cycle()
            assert np.isfinite(ride.planner.motion.poses).all()
            assert np.isfinite(ride.planner.motion.velocities).all()
            assert ride.planner.report.why or first == 10  # until there it may be of use
    for _ in range(3):
        ride.cycle()
    assert ride.planner.report.used
    ride.run(10.0)
    assert ride.planner.state is PlannerState.ARRIVED


def test_obstacles_that_are_not_finite_stop_the_robot():
    unknown, nothing = ellipses((math.nan, 0.0, 0.3)), ellipses()
    ride = a_ride(seen=lambda now: unknown if 101.2 < now < 103.0 else nothing)
    ride.run(1.5)
    assert not ride.measured().twist.any()
    assert not ride.planner.report.used and ride.planner.report.why
    ride.run(12.0)
    assert ride.planner.state is PlannerState.ARRIVED


# ---- orders on the way ------------------------------------------------------------------------


def test_a_pause_brakes_at_once_and_a_resume_goes_on():
    ride = a_ride()
    place, speed = ride.pose()[0], speeds(ride)[-1, 0]
    ride.planner.pause(ride.now)
    assert ride.planner.state is PlannerState.PAUSED and not ride.planner.active
    ride.run(1.5, until=never)
    assert ride.pose()[0] - place == pytest.approx(speed**2 / 3.0, rel=0.3)
    assert not ride.measured().twist.any()
    assert ride.planner.resume(ride.measured())
    assert ride.planner.state is PlannerState.DRIVING
    ride.run(10.0)
    assert ride.planner.state is PlannerState.ARRIVED
    np.testing.assert_allclose(ride.pose(), [4.0, 0.0, 0.0], atol=0.03)
    assert not ride.planner.resume(ride.measured())
    assert_smooth(ride)


def test_a_resume_while_it_still_brakes():
    ride = a_ride()
    ride.planner.pause(ride.now)
    ride.run(0.15, until=never)
    assert ride.measured().twist[0] > 0.3
    assert ride.planner.resume(ride.measured())
    ride.run(10.0)
    assert ride.planner.state is PlannerState.ARRIVED
    assert_smooth(ride)


def test_a_cancel_brakes_and_forgets():
    ride = a_ride()
    place = ride.pose()[0]
    ride.planner.cancel(ride.now)
    assert ride.planner.goal is None and ride.planner.state is PlannerState.IDLE
    ride.run(1.5, until=never)
    assert ride.pose()[0] - place < 0.4
    assert not ride.planner.resume(ride.measured())
    assert ride.planner.propose(ride.now, ride.measured(), ellipses()).fault == "no goal"


@pytest.mark.parametrize("order", ["pause", "cancel"])
def test_an_answer_of_before_a_stop_does_not_undo_it(order):
    ride = a_ride()
    known = ride.seen(ride.now)
    proposal = ride.planner.propose(ride.now, ride.measured(), known)
    getattr(ride.planner, order)(ride.now + 0.005)
    braking = ride.planner.motion
    ride.planner.take(proposal, ride.now + 0.01, ride.measured(), known)
    assert ride.planner.motion is braking
    assert not ride.planner.report.used and "no goal" in ride.planner.report.why


def test_an_abort_is_at_rest_where_the_robot_is():
    ride = a_ride()
    measured = ride.measured()
    ride.planner.abort(ride.now, measured)
    assert ride.planner.goal is None and ride.planner.state is PlannerState.IDLE
    found, velocity = ride.planner.motion.sample(ride.now + 1.0)
    np.testing.assert_allclose(found, measured.pose)
    assert not velocity.any()


# ---- settings ---------------------------------------------------------------------------------


def test_settings_change_on_the_way():
    ride = a_ride()
    ride.planner.configure(parameters(limits__linear_velocity=0.4))
    ride.run(1.5)
    begin = len(ride.poses)
    ride.run(0.5)
    assert speeds(ride)[begin:, 0].max() < 0.4
    ride.planner.configure(parameters(limits__linear_velocity=0.4, body__mass=40.0))
    assert ride.planner.model.inertia[0, 0] > 40.0
    ride.run(15.0)
    assert ride.planner.state is PlannerState.ARRIVED
    assert_smooth(ride)


def test_clearance_changes_on_the_way():
    closest = []
    for clearance in (0.05, 0.3):
        known = ellipses((2.5, 0.5, 0.3))
        ride = a_ride(seen=known)
        ride.planner.configure(parameters(safety__clearance=clearance))
        ride.run(3.3)
        assert ride.pose()[0] > 2.9
        closest.append(ride.gaps(known).min())
    assert closest[0] < 0.2 and closest[1] > 0.27


@pytest.mark.parametrize("share", [0.7, 0.4])
def test_a_share_of_the_limits_is_come_down_to_and_never_exceeded(share):
    ride = Ride(planner())
    ride.drive(pose(6.0, 2.0, 0.0))
    ride.run(1.5)
    fast = speeds(ride)[-1, 0]
    ride.planner.scale(share)
    assert ride.planner.share == share
    begin = len(ride.poses)
    ride.run(4.0)
    slowed = speeds(ride)[begin:, 0]
    assert slowed.max() < fast + 0.01
    assert slowed[-1] < 0.95 * share
    ride.planner.scale(1.0)
    ride.run(2.0)
    assert speeds(ride)[-400:, 0].max() > slowed[-1] + 0.05


# ---- what is reported -------------------------------------------------------------------------


def test_voltages_are_those_of_the_plan():
    ride = a_ride()
    planning, motion = ride.planner.model, ride.planner.motion
    volts = ride.planner.voltages(ride.now + CYCLE)
    assert volts is not None and volts.shape == (4,)
    pose_then, velocity = motion.sample(ride.now + CYCLE)
    c, s = math.cos(pose_then[2]), math.sin(pose_then[2])
    twist = np.array(
        [c * velocity[0] + s * velocity[1], c * velocity[1] - s * velocity[0], velocity[2]]
    )
    expected = planning.voltages(motion.currents_at(ride.now + CYCLE), twist)
    np.testing.assert_allclose(volts, expected, atol=0.3)  # but for the friction at a crawl
    assert np.abs(volts).max() > 3.0
    assert ride.planner.voltages(motion.end + 1.0) is None
    ride.planner.cancel(ride.now)
    assert ride.planner.voltages(ride.planner.motion.end - 0.01) is None


def test_error_is_the_way_to_the_goal():
    ride = a_ride()
    distance, angle = ride.planner.error(ride.measured())
    assert distance == pytest.approx(np.hypot(*(ride.pose()[:2] - [4.0, 0.0])))
    assert angle == pytest.approx(abs(ride.pose()[2]))
    ride.planner.cancel(ride.now)
    assert ride.planner.error(ride.measured()) == (0.0, 0.0)


def test_what_is_sent_brakes_soon_and_the_motion_goes_on():
    ride = a_ride()
    planner, now = ride.planner, ride.now
    sent, whole = planner.preview, planner.motion
    assert sent.end < now + 1.2 < whole.end
    assert np.abs(sent.velocities[-1]).max() < 1e-9
    early = np.linspace(now, now + 0.3, 20)
    np.testing.assert_allclose(sent.at(early)[0], whole.at(early)[0], atol=1e-9)
    ride.run(12.0)
    assert ride.planner.state is PlannerState.ARRIVED, "each cycle sends more of it"


def test_where_braking_soon_is_not_clear_the_whole_motion_is_sent():
    """Something comes along behind: to stop before it would be worse."""
    things = ellipses((-1.3, 0.0, 0.3), velocities=[(0.8, 0.0)], time=100.0)
    ride = Ride(planner(), seen=lambda now: replace(things, time=now, centers=things.centers_at(
        np.array([now]))[0]))  # fmt: skip
    ride.drive(pose(8.0, 0.0, 0.0))
    whole = []
    for _ in range(60):
        ride.cycle()
        whole.append(ride.planner.preview is ride.planner.motion)
    assert any(whole[30:]) and speeds(ride)[-1, 0] > 0.5


# ---- walls and ways around --------------------------------------------------------------------

CELL = 0.05
"""Of the maps of these tests [m]."""
CORNER = np.array([-1.0, -1.5, 0.0])
"""Where their first cell is."""


def floor_plan(*boxes, size=(5.0, 3.0)):
    """A map of walls (x0, y0, x1, y1) in odom, closed all around."""
    columns, rows = (round(edge / CELL) for edge in size)
    cells = np.zeros((rows, columns), dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    for box in boxes:
        (x0, y0), (x1, y1) = (np.round((np.reshape(box, (2, 2)) - CORNER[:2]) / CELL)).astype(int)
        cells[y0:y1, x0:x1] = True
    return GridMap(cells, CELL, CORNER)


def wall_gap(ride, grid):
    """Least gap between what the robot did and the cells themselves, none of them a disc [m]."""
    rows, columns = np.nonzero(grid.occupied)
    edge = np.linspace(0.0, 1.0, 3)
    spots = np.stack(np.meshgrid(edge, edge), axis=-1).reshape(1, -1, 2)
    points = (np.column_stack([columns, rows])[:, None] + spots).reshape(-1, 2) * CELL
    walls = Walls(np.unique(points, axis=0) + grid.origin[:2], 0.0)
    few = slice(None, None, 5)
    return float(walls.gaps(np.array(ride.poses)[few], ride.planner.model.half).min())


def test_a_trap_is_left_and_the_goal_behind_it_reached():
    sides = [(x, s * 0.8, 0.12) for s in (-1, 1) for x in np.arange(0.0, 1.5, 0.2)]
    trap = ellipses(*sides, *[(1.5, y, 0.12) for y in np.arange(-0.8, 0.9, 0.2)])
    ride = Ride(planner(), seen=trap)
    ride.drive(pose(3.0, 0.0, 0.0))
    ride.run(25.0)
    assert ride.planner.state is PlannerState.ARRIVED
    np.testing.assert_allclose(ride.pose(), [3.0, 0.0, 0.0], atol=0.03)
    assert ride.gaps(trap).min() > 0.01
    assert min(place[0] for place in ride.poses) < -0.2, "it went back out of it"
    assert PlannerState.BLOCKED not in ride.states
    assert_smooth(ride)


def test_rooms_are_crossed_through_their_doors_without_touching_a_wall():
    # Doors of 0.65 m, for a robot of 0.5 m, one at the top and one at the bottom.
    walls = (0.8, -1.5, 0.9, 0.75), (2.3, -0.75, 2.4, 1.5)
    grid = floor_plan(*walls)
    ride = Ride(planner())
    ride.planner.chart(grid)
    ride.drive(pose(3.2, 0.8, 0.0))
    ride.run(25.0)
    assert ride.planner.state is PlannerState.ARRIVED
    np.testing.assert_allclose(ride.pose(), [3.2, 0.8, 0.0], atol=0.03)
    assert wall_gap(ride, grid) > 0.015
    across = np.array(ride.poses)
    assert across[np.abs(across[:, 0] - 0.85) < 0.1, 1].min() > 0.7
    assert across[np.abs(across[:, 0] - 2.35) < 0.1, 1].max() < -0.7
    assert_smooth(ride)


def test_walls_that_become_known_on_the_way_stop_the_robot_until_they_are_gone():
    shut = floor_plan((1.6, -1.5, 1.7, 1.5))
    ride = Ride(planner())
    ride.drive(pose(3.0, 0.0, 0.0))
    ride.run(1.2)
    assert speeds(ride)[-1, 0] > 0.5
    ride.planner.chart(shut)
    assert ride.planner.grid is shut
    ride.run(12.0, until=lambda: ride.planner.state is PlannerState.BLOCKED)
    assert ride.planner.state is PlannerState.BLOCKED and ride.planner.guide.lost
    ride.run(2.0, until=never)
    assert wall_gap(ride, shut) > 0.01
    assert ride.pose()[0] < 1.6 - ride.planner.model.half[1]
    ride.planner.chart(None)
    assert ride.planner.grid is None
    ride.run(15.0)
    assert ride.planner.state is PlannerState.ARRIVED
    np.testing.assert_allclose(ride.pose(), [3.0, 0.0, 0.0], atol=0.03)
    assert_smooth(ride)


def test_a_state_goal_behind_a_wall_is_passed():
    grid = floor_plan((1.2, -1.5, 1.3, 0.6))
    goal = StateGoal(np.array([2.6, -0.5, 0.0]), np.array([0.4, 0.0, 0.0]))
    ride = Ride(planner())
    ride.planner.chart(grid)
    ride.drive(goal)
    ride.run(25.0)
    assert ride.planner.state is PlannerState.ARRIVED
    away = np.hypot(*(np.array(ride.poses)[:, :2] - goal.pose[:2]).T)
    passed = int(np.argmin(away))
    assert away[passed] < 0.04
    before, after = ride.poses[passed - 4], ride.poses[passed]
    found = (after - before) / (ride.times[passed] - ride.times[passed - 4])
    np.testing.assert_allclose(found, goal.velocity, atol=0.15)
    ride.run(2.0, until=never)
    assert wall_gap(ride, grid) > 0.01
    assert_smooth(ride)


def test_goals_in_a_wall_are_refused_and_those_beside_it_are_not():
    grid = floor_plan((1.2, -1.5, 1.3, 0.4), (2.0, -1.5, 4.0, 0.2))
    ride = Ride(planner())
    ride.planner.chart(grid)
    for inside in (pose(1.25, 0.0, 0.0), pose(0.9, 0.0, 0.0), pose(1.3, 0.5, 1.5)):
        with pytest.raises(InputError, match="obstacle stands where the robot would be"):
            ride.drive(inside)
    assert ride.planner.goal is None
    with pytest.raises(InputError, match="obstacle stands"):
        ride.drive(pose(3.0, -0.7, 0.0))  # far within, and off all the edges
    ride.drive(pose(1.25, 0.9, 0.0))
    assert ride.planner.state is PlannerState.DRIVING
    ride.planner.chart(None)
    ride.drive(pose(1.25, 0.0, 0.0))


def test_a_new_goal_while_the_way_to_the_last_is_still_searched():
    grid = floor_plan((1.2, -1.5, 1.3, 0.6))
    ride = Ride(planner())
    ride.planner.chart(grid)
    ride.drive(pose(2.6, -0.5, 0.0))
    ride.cycle()
    assert ride.planner.guide.state == "searches"
    ride.drive(pose(-0.2, 0.3, 0.0))
    assert ride.planner.guide.state == "a straight line"
    ride.run(10.0)
    assert ride.planner.state is PlannerState.ARRIVED
    np.testing.assert_allclose(ride.pose(), [-0.2, 0.3, 0.0], atol=0.03)


def test_a_pause_in_the_middle_of_a_search():
    grid = floor_plan((1.2, -1.5, 1.3, 0.6))
    ride = Ride(planner())
    ride.planner.chart(grid)
    ride.drive(pose(2.6, -0.5, 0.0))
    ride.cycle()
    ride.planner.pause(ride.now)
    ride.run(1.0, until=never)
    assert ride.planner.state is PlannerState.PAUSED and not ride.measured().twist.any()
    assert ride.planner.resume(ride.measured())
    ride.run(20.0)
    assert ride.planner.state is PlannerState.ARRIVED
    assert wall_gap(ride, grid) > 0.01
