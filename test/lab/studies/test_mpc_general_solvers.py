import ctypes
import itertools
import math

import numpy as np
import pytest

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.lab.studies.mpc_general_solvers import (
    OPTIONS,
    ConvergedController,
    Evaluator,
    GeneralSolver,
    Multipliers,
)
from omniman_ros.lab.studies.mpc_scenes import (
    MIN_GAPS,
    STEP,
    WORKSPACE_MARGIN,
    RealTime,
    Rig,
    Scene,
    Task,
    arrived,
    disturbances,
    draw_scene,
    penalty,
    same_sides,
    swept_angles,
)
from omniman_ros.planning.obstacles.ellipses import Ellipses
from omniman_ros.planning.obstacles.separation import box_gap
from omniman_ros.robots import load_robot

STEPS = 4
EMPTY = Ellipses.none()


@pytest.fixture(scope="module")
def free():
    return Rig(load_robot("ig42"), STEPS, 0)


@pytest.fixture(scope="module")
def crowded():
    return Rig(load_robot("ig42"), STEPS, 2)


@pytest.fixture(scope="module")
def peers(free, crowded):
    return {
        (name, rig.transcription.slots): GeneralSolver(rig.transcription, name)
        for name in ("ipopt", "fatrop")
        for rig in (free, crowded)
    }


def scene(*centers, goal=(0.8, 0.3, 0.4), axes=0.2):
    m = len(centers)
    ellipses = Ellipses(
        0.0,
        np.array(centers).reshape(-1, 2),
        np.zeros((m, 2)),
        np.full((m, 2), axes),
        np.zeros(m),
        np.zeros(m),
    )
    return Scene(0, np.zeros(3), np.array(goal), ellipses, (-3.0, -3.0, 3.0, 3.0))


def first_task(rig, drawn):
    return next(iter(rig.cycles(drawn, RealTime(rig.solver), 1, lambda: 0.0))).task


def iterated(rig, task, iterations=150):
    currents = task.guess
    for _ in range(iterations):
        currents = rig.solver.solve(task.start, currents, task.stage).currents
    return currents


@pytest.mark.parametrize("name", ["ipopt", "fatrop"])
def test_peers_agree_with_our_solver_iterated_until_it_converges(free, peers, name):
    task, evaluator = first_task(free, scene()), Evaluator(free.transcription)
    ours = evaluator.value(task.start, iterated(free, task), task.stage)
    found = peers[name, 0].solve(task.start, task.guess, task.states, task.stage)
    theirs = evaluator.value(task.start, found.currents, task.stage)
    assert found.solved, found.status
    assert found.cost == pytest.approx(theirs.cost, rel=1e-4)
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-3)
    assert ours.cost < 0.99 * evaluator.value(task.start, task.guess, task.stage).cost
    # Half a percent: the last iterate keeps the limits except for its last step.
    assert ours.excess < 5e-3 and theirs.excess < 5e-3
    assert found.states == pytest.approx(theirs.states, abs=1e-4)


def test_objective_is_the_cost_of_stages_and_slack(crowded, peers):
    # The obstacle covers the robot, so the slack is positive at first in any case.
    task = first_task(crowded, scene((0.3, 0.0), (2.0, 2.0)))
    found = peers["ipopt", 2].solve(task.start, task.guess, task.states, task.stage)
    value = Evaluator(crowded.transcription).value(task.start, found.currents, task.stage)
    assert found.solved, found.status
    assert found.slack.max() > 0.05 and penalty(task.stage, found.slack) > 100.0
    assert found.slack == pytest.approx(value.slack, abs=1e-4)
    assert found.cost == pytest.approx(value.cost, rel=1e-3)


@pytest.mark.parametrize("name", ["ipopt", "fatrop"])
def test_constraints_are_the_rows_of_the_transcription(crowded, peers, name):
    t, peer, random = crowded.transcription, peers[name, 2], np.random.default_rng(3)
    task = first_task(crowded, scene((0.5, 0.1), (-0.6, 0.3)))
    violated = 0
    for _ in range(5):
        start = np.concatenate([random.uniform(-0.5, 0.5, 3), random.uniform(-1.0, 1.0, 3)])
        currents = random.uniform(-1.0, 1.0, (STEPS, t.controls)) * t.model.max_current
        states = crowded.solver.states(start, currents)
        slack = random.uniform(0.0, 0.3, STEPS)
        w, p = peer.packed(start, currents, states, slack, task.stage)
        g = np.asarray(peer.constraints(w, p)).ravel()
        motion = np.ones(g.size, dtype=bool)
        motion[peer.hard], motion[peer.soft] = False, False
        assert motion.sum() == 6 * STEPS
        assert g[motion] == pytest.approx(0.0, abs=1e-9)
        assert not peer.lower[motion].any() and not peer.upper[motion].any()
        for k, row in enumerate(task.stage.table()):
            value, low, high = (
                np.asarray(part).ravel() for part in t.stage_rows(states[k], currents[k], row)
            )
            value[t.relaxed :] += slack[k]
            places = np.concatenate([peer.hard[k], peer.soft[k]])
            assert g[places] == pytest.approx(value, abs=1e-9)
            assert np.array_equal(peer.lower[places], low)
            assert np.array_equal(peer.upper[places], high)
            out = (value < low) | (value > high)
            assert np.array_equal((g < peer.lower)[places] | (g > peer.upper)[places], out)
            violated += int(out.sum())
    assert violated > 20


def test_states_that_do_not_follow_from_the_currents_violate_the_motion(free, peers):
    peer, task = peers["ipopt", 0], first_task(free, scene())
    states = task.states.copy()
    states[-1] += np.arange(1, 7)
    w, p = peer.packed(task.start, task.guess, states, np.zeros(STEPS), task.stage)
    g = np.asarray(peer.constraints(w, p)).ravel()
    left = np.ones(g.size, dtype=bool)
    left[peer.hard], left[peer.soft] = False, False
    assert g[left][-6:] == pytest.approx(np.arange(1, 7)) and not g[left][:-6].any()


def test_evaluation_reports_slack_and_violation(crowded):
    evaluator, t = Evaluator(crowded.transcription), crowded.transcription
    task = first_task(crowded, scene((0.3, 0.0), (2.0, 2.0)))
    standing = evaluator.value(task.start, np.zeros((STEPS, t.controls)), task.stage)
    # The centre is 0.1 m behind the front edge; the radius is 0.2 m plus 0.05 m.
    assert standing.slack == pytest.approx(0.35, abs=1e-3)
    assert standing.excess == 0.0
    fast = np.tile(10.0 * t.model.max_current, (STEPS, 1))
    assert evaluator.value(task.start, fast, task.stage).excess > 1.0


def test_multipliers_are_shifted_by_a_step(free, peers):
    peer = peers["ipopt", 0]
    bounds, constraints = np.full(peer._least.size, -1.0), np.full(peer.lower.size, -1.0)
    for places in (peer._currents, peer._slack, peer._states):
        bounds[places.reshape(STEPS, -1)] = np.arange(STEPS)[:, None]
    for places in (peer._motion, peer.hard, peer.soft):
        constraints[places] = np.arange(STEPS)[:, None]
    assert bounds.min() == 0.0 and constraints.min() == 0.0  # every multiplier has its own index
    shifted = peer._shifted(Multipliers(bounds, constraints))
    assert np.array_equal(shifted["lam_x0"], np.minimum(bounds + 1, STEPS - 1))
    assert np.array_equal(shifted["lam_g0"], np.minimum(constraints + 1, STEPS - 1))


def test_warm_started_multipliers_save_iterations(free, peers):
    peer, task = peers["ipopt", 0], first_task(free, scene())
    cold = peer.solve(task.start, task.guess, task.states, task.stage)
    again = peer.solve(task.start, cold.currents, cold.states, task.stage, cold.multipliers)
    assert again.solved and again.iterations < cold.iterations
    assert again.cost == pytest.approx(cold.cost, rel=1e-4)


def test_peer_that_does_not_converge_reports_failure_and_keeps_the_guess(free):
    options = {**OPTIONS["ipopt"], "ipopt": {**OPTIONS["ipopt"]["ipopt"], "max_iter": 1}}
    task = first_task(free, scene())
    controller = ConvergedController(
        GeneralSolver(free.transcription, "ipopt", options), dual=True
    )
    currents, solved = controller.plan(task)
    assert not solved and currents is task.guess


def test_folded_functions_are_equivalent_and_smaller():
    rig = Rig(load_robot("ig42"), 2, 0)
    task = first_task(rig, scene())
    plain, folded = (GeneralSolver(rig.transcription, "ipopt", cse=fold) for fold in (False, True))
    problem = task.start, task.guess, task.states, task.stage
    found = [peer.solve(*problem) for peer in (plain, folded)]
    assert found[0].solved and found[0].cost == pytest.approx(found[1].cost, rel=1e-6)
    sizes = [peer._solve.get_function("nlp_hess_l").n_instructions() for peer in (plain, folded)]
    assert sizes[1] < 0.8 * sizes[0]


def test_peer_that_raises_counts_as_failed(free, peers, monkeypatch):
    def thrown(**_):
        raise RuntimeError("out of order")

    task, peer = first_task(free, scene()), peers["fatrop", 0]
    monkeypatch.setattr(peer, "_solve", thrown)
    found = peer.solve(task.start, task.guess, task.states, task.stage)
    assert not found.solved and "out of order" in found.status


@pytest.mark.parametrize("name", ["ipopt", "fatrop"])
def test_peers_print_nothing(free, peers, name, capfd):
    task = first_task(free, scene())
    peers[name, 0].solve(task.start, task.guess, task.states, task.stage)
    ctypes.CDLL(None).fflush(None)  # output from C may still be in its buffer
    written = capfd.readouterr()
    assert written.out == "" and written.err == ""


# ---- scenes and drives ----------------------------------------------------------------------


def test_scenes_are_reproducible_from_a_seed_and_leave_room():
    half = np.array([0.4, 0.25])
    for seed in range(5):
        first, second = draw_scene(seed, 6, half), draw_scene(seed, 6, half)
        assert np.array_equal(first.goal, second.goal) and len(first.ellipses) == 6
        e = first.ellipses
        assert np.array_equal(e.centers, second.ellipses.centers)
        places = np.vstack([first.start, first.goal])
        at = np.zeros(2)
        gaps = box_gap(places, Rectangles.centred(half), e.centers_at(at), e.axes_at(at), e.angles)
        standing = ~e.velocities.any(axis=1)
        assert gaps[0].min() > MIN_GAPS[0]
        assert gaps[1][standing].min(initial=1.0) > MIN_GAPS[1]
        assert first.goal[0] + WORKSPACE_MARGIN - first.workspace[0] > 0.0
    assert not np.array_equal(draw_scene(0, 6, half).goal, draw_scene(1, 6, half).goal)
    assert len(draw_scene(0, 0, half).ellipses) == 0
    with pytest.raises(ValueError, match="no room for 3 obstacles"):
        draw_scene(0, 3, np.array([10.0, 10.0]))


@pytest.mark.parametrize("velocity", [(0.0, 0.0), (0.2, -0.1)])
def test_swept_angles_identify_the_side_of_passing(velocity):
    times = np.linspace(0.0, 4.0, 41)
    ellipses = Ellipses(
        0.0,
        np.array([[2.0, 0.0]]),
        np.array([velocity]),
        np.ones((1, 2)),
        np.zeros(1),
        np.zeros(1),
    )
    moved = np.array(velocity) * times[:, None]

    def around(side):
        angle = math.pi * (1.0 - side * times / 4.0)
        return np.column_stack(
            [2.0 + np.cos(angle) + moved[:, 0], np.sin(angle) + moved[:, 1], times]
        )

    left, right = (swept_angles(times, around(side), ellipses) for side in (1, -1))
    assert left == pytest.approx(-math.pi) and right == pytest.approx(math.pi)
    assert not same_sides(left, right)
    assert same_sides(left, left + 0.5)
    assert same_sides(np.zeros(0), np.zeros(0))


def test_robot_follows_the_model_except_for_the_disturbances(free):
    drawn = draw_scene(2, 0, free.model.half)
    ticks = iter(range(1000))
    cycles = list(free.cycles(drawn, RealTime(free.solver), 6, lambda: float(next(ticks))))
    noise = disturbances(2, 6)
    assert len(cycles) == 6 and [c.task.first for c in cycles] == [True] + 5 * [False]
    for k, (before, after) in enumerate(itertools.pairwise(cycles)):
        due = np.asarray(free.transcription.transition(before.task.start, before.currents[0]))
        assert after.task.start == pytest.approx(due.ravel() + noise[k], abs=1e-12)
        assert np.array_equal(after.task.guess[:-1], before.currents[1:])
    assert all(c.solved and c.cycle_time == 2.0 and c.solver_time == 1.0 for c in cycles)
    assert not any(map(arrived, cycles))


def test_robot_at_the_goal_has_arrived(free):
    drawn = scene(goal=(0.01, 0.0, 0.0))
    assert arrived(next(iter(free.cycles(drawn, RealTime(free.solver), 1, lambda: 0.0))))


class Stand:
    """Controller that applies no current."""

    def plan(self, task: Task):
        return np.zeros_like(task.guess), False


def test_cost_of_a_drive_is_the_sum_of_its_steps_and_its_end(free):
    outcome = free.drive(scene(), Stand(), 1)
    weights = free._parameters.weights
    square = 0.8**2 + 0.3**2
    once = weights.position * square + weights.heading * 0.4**2
    assert outcome.cost == pytest.approx((1.0 + weights.running * STEP) * once, rel=1e-9)
    assert outcome.distance == pytest.approx(math.sqrt(square)) and outcome.slack == 0.0
    assert outcome.failures == 1 and outcome.poses.shape == (2, 3)


def test_cost_of_a_drive_includes_overlap(crowded):
    # 1 mm of overlap including the clearance: contact ends at 0.4 + 0.05 + 0.2 m.
    near, clear = (crowded.drive(scene((x, 0.0)), Stand(), 1) for x in (0.649, 0.651))
    assert near.slack == pytest.approx(1e-3, rel=0.02) and clear.slack == 0.0
    assert near.cost > clear.cost + 1.0


def test_drives_of_both_solvers_cost_the_same_without_obstacles(free, peers):
    drawn = draw_scene(4, 0, free.model.half)
    ours = free.drive(drawn, RealTime(free.solver), 12)
    theirs = free.drive(drawn, ConvergedController(peers["ipopt", 0], dual=True), 12)
    assert ours.failures == theirs.failures == 0
    assert ours.cost == pytest.approx(theirs.cost, rel=0.01)
    assert not np.array_equal(ours.poses, theirs.poses)
