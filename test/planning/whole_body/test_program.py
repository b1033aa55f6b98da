"""Dynamics, derivatives of gaps, and braking along a plan."""

import numpy as np
import pytest

from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.whole_body.body_gaps import BodyGaps
from omniman_ros.planning.whole_body.program import (
    CRITICAL,
    Quadratic,
    ReducedProgram,
    RedundancyProgram,
    StageRows,
    transition,
)
from omniman_ros.planning.whole_body.task import WholeBodyTask
from test.planning.whole_body.support import START, posts, setup, straight

SETUP = setup()


@pytest.fixture(scope="module")
def task():
    return WholeBodyTask(SETUP, straight(0.6), START, 0.0, posts())


@pytest.mark.parametrize("d", [4, 7])
def test_the_steps_of_a_program_obey_the_dynamics_exactly_and_its_rows(d):
    n, rng, states = 6, np.random.default_rng(1), 2 * d
    program = RedundancyProgram(n, 0.1, 1, np.full(3, 1e3), np.full(3, 1e3), d)
    by_x = np.zeros((n, 1, states))
    by_x[:, 0, 0] = -1.0
    slack = np.zeros((n, 1), dtype=np.intp)
    rows = StageRows(np.full((n, 1), 0.02), by_x, np.zeros((n, 1, d)), slack)
    wide = np.stack([np.full((n, d), -5.0), np.full((n, d), 5.0)])
    cost = Quadratic(
        np.tile(np.eye(states), (n, 1, 1)),
        np.tile([-1.0, *rng.normal(size=states - 1)], (n, 1)),
        np.full(d, 1e-3),
        np.zeros((n, d)),
        wide,
        np.stack([np.full((n, states), -9.0), np.full((n, states), 9.0)]),
    )
    step = program.solve(rows, cost)
    a, b = transition(0.1, d)
    before = np.vstack([np.zeros(states), step.states[:-1]])
    assert step.states == pytest.approx(before @ a.T + step.controls @ b.T, abs=1e-6)
    assert step.states[:, 0].max() == pytest.approx(0.02, abs=1e-3)
    assert np.abs(step.controls).max() <= 5.0 + 1e-6


@pytest.mark.parametrize("binding", [3, 20], ids=["few rows bind", "more bind than are chosen"])
# The solver leaves larger errors where the program has more unknowns.
@pytest.mark.parametrize(("d", "error"), [(4, (2e-4, 2e-3)), (7, (5e-4, 6e-3))])
def test_a_reduced_program_has_the_solution_of_all_rows(d, error, binding, monkeypatch):
    n, count, rng, states = 5, 40, np.random.default_rng(3), 2 * d
    weights = 0.1, count, np.full(3, 1e3), np.full(3, 1e3), d
    by_x = rng.normal(size=(n, count, states))
    value = np.full((n, count), 200.0)  # out of reach
    value[:, :binding] = rng.uniform(0.0, 0.01, (n, binding))
    order = rng.permuted(np.tile(np.arange(count), (n, 1)), axis=1)
    rows = StageRows(
        value, by_x, rng.normal(size=(n, count, d)), rng.integers(0, 3, (n, count))
    ).selected(order)
    cost = Quadratic(
        np.tile(np.eye(states), (n, 1, 1)),
        rng.normal(size=(n, states)),
        np.full(d, 1e-2),
        rng.normal(size=(n, d)),
        np.stack([np.full((n, d), -5.0), np.full((n, d), 5.0)]),
        np.stack([np.full((n, states), -9.0), np.full((n, states), 9.0)]),
    )
    reduced, whole = ReducedProgram(n, *weights), RedundancyProgram(n, *weights)
    calls, solve = [], reduced._all.solve
    monkeypatch.setattr(reduced._all, "solve", lambda *it: calls.append(it) or solve(*it))
    found, expected = reduced.solve(rows, cost), whole.solve(rows, cost)
    assert found.states == pytest.approx(expected.states, abs=error[0])
    assert found.controls == pytest.approx(expected.controls, abs=error[1])
    assert len(calls) == (binding > CRITICAL)


def test_rates_and_accelerations_of_the_joints_are_those_of_differences(task):
    r, step = task.redundancy, 1e-4
    z = np.array([[0.1, 0.02, -0.05, 0.2], [0.3, -0.03, 0.1, 0.37]])
    v = np.array([[0.2, 0.1, 0.1, 0.15], [0.1, 0.2, -0.2, 0.2]])
    at = r.configurations(z)
    before, after = r.axes(z - step * v)[:, 3:], r.axes(z + step * v)[:, 3:]
    rates = (at.rates @ v[:, :, None])[:, :, 0]
    assert (after - before) / (2 * step) == pytest.approx(rates, abs=1e-6)
    assert (after - 2 * at.arm + before) / step**2 == pytest.approx(r.drift(at, v), abs=1e-4)


def test_derivatives_of_gaps_are_those_of_differences(task):
    r, around = task.redundancy, posts((0.9, -0.3), (0.7, 0.9))
    gaps = BodyGaps(SETUP.description, SETUP.tool, None, 0.1)
    z, step = np.array([[0.1, 0.02, -0.05, 0.2]]), 1e-6

    def rows(at):
        found = gaps.rows(r.configurations(at), around, np.zeros(1), 5.0, 12)
        order = found.gap[0].argsort()
        return found.gap[0][order], found.slope[0][order]

    gap, slope = rows(z)
    for k in range(4):
        moved = rows(z + step * np.eye(4)[k])[0]
        assert (moved - gap) / step == pytest.approx(slope[:, k], abs=1e-4)


def test_braking_follows_the_same_way_to_rest_within_the_limits(task):
    nodes = np.arange(0.0, 2.01, 0.1)
    v = np.array([0.3, 0.1, 0.1, 0.2])
    motion = HermiteTrajectory(nodes, nodes[:, None] * v, np.tile(v, (21, 1)), np.zeros((20, 0)))
    braked = task.controller.braked(motion, 0.5)
    times = np.linspace(0.0, braked.end, 400)
    z, rates = braked.at(times)
    assert z / v == pytest.approx(np.tile(z[:, :1] / v[0], (1, 4)), abs=1e-6)
    assert rates[-1] == pytest.approx(np.zeros(4), abs=1e-9)
    slowing = np.abs(np.diff(rates, axis=0) / np.diff(times)[:, None]).max(axis=0)
    assert (slowing[:3] <= SETUP.limits.acceleration[:3]).all()
    again = task.controller.braked(braked.between(0.1, braked.end), 0.55)
    assert again.at(times[100:])[0] == pytest.approx(z[100:], abs=1e-9), "it brakes already"
    earlier = task.controller.braked(braked, 0.3)
    assert earlier.end < braked.end
