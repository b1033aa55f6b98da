import math
from dataclasses import dataclass

import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.arrays import Array
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.mpc.problem import Problem
from omniman_ros.planning.mpc.solver import Solution
from omniman_ros.planning.obstacles.walls import Walls
from omniman_ros.planning.plan_optimizer import LAG, PlanOptimizer, PlanRequest
from test.planning.support import ellipses, model, parameters, solver_pool

#: A wall across the way, open on the left (y above 1)
WALL = Walls(np.column_stack([np.full(120, 1.2), np.linspace(-5.0, 1.0, 120)]), 0.036)


@dataclass(frozen=True)
class RoundTheEnd:
    """Targets that pass the wall on its left, at 0.8 m/s."""

    moves: bool = False
    until: float = -math.inf

    def targets(self, times: Array) -> tuple[Array, Array]:
        way = 0.8 * np.asarray(times)
        knots = np.array([[0.0, 0.0], [0.6, 1.2], [0.8, 1.6], [3.0, 1.6]])
        along = np.append(0.0, np.cumsum(np.hypot(*np.diff(knots, axis=0).T)))
        poses = np.column_stack([np.interp(way, along, knots[:, k]) for k in (0, 1)])
        return np.column_stack([poses, 0.0 * way]), np.zeros((len(way), 3))


@pytest.fixture
def problem():
    return Problem(model("ig42"), EffectiveLimits(parameters("ig42")))


def an_optimizer():
    return PlanOptimizer(model("ig42"), EffectiveLimits(parameters("ig42")), solver_pool("ig42"))


def a_request(walls=WALL):
    return PlanRequest(
        np.zeros(6),
        0.0,
        RoundTheEnd(),
        Footprint(Rectangles.centred(model("ig42").half)),
        ellipses(),
        walls,
    )


def keep(optimizer, currents):
    """Have an optimizer begin with currents (N, n) [A]."""
    states, slack = np.zeros((len(currents) + 1, 6)), np.zeros(len(currents))
    optimizer.keep(0.0, Solution(currents, states, 0.0, slack, 0.0, 1))


def lag(plan):
    target = RoundTheEnd().targets(np.array([2.0]))[0][0]
    return math.dist(plan.states[-1, :2], target[:2])


def test_a_plan_that_is_caught_behind_an_obstacle_is_replaced(problem):
    """The last plan goes to the right of the wall's end: an improvement stays there."""
    stale = problem.evasion(np.zeros(6), -0.4 * math.pi)
    optimizer = an_optimizer()
    keep(optimizer, stale)
    best, improved = optimizer.solve(a_request(), evade=False)
    assert lag(improved) > LAG > lag(best)
    assert best.cost < improved.cost and best.slack.max() < 1e-3
    (following,) = optimizer.solve(a_request(), evade=False)
    assert lag(following) < LAG, "the next plan improves the better one"


def test_a_plan_that_reaches_its_target_stays_alone(problem):
    optimizer = an_optimizer()
    targets = RoundTheEnd().targets(0.1 * np.arange(1.0, 21.0))[0]
    keep(optimizer, problem.along(np.zeros(6), targets))
    assert len(optimizer.solve(a_request(), evade=False)) == 1


def test_without_obstacles_nothing_holds_a_plan_up(problem):
    optimizer = an_optimizer()
    keep(optimizer, problem.evasion(np.zeros(6), -0.4 * math.pi))
    assert len(optimizer.solve(a_request(walls=Walls.none()), evade=True)) == 1


def test_another_plan_and_an_evasion_take_turns(problem, monkeypatch):
    """With both cores busy a cycle has no time for both."""
    optimizer, calls = an_optimizer(), []
    for name in ("along", "evasion"):
        made = getattr(Problem, name)
        monkeypatch.setattr(Problem, name, lambda *a, n=name, f=made: (calls.append(n), f(*a))[1])
    stale = problem.evasion(np.zeros(6), -0.4 * math.pi)
    calls.clear()
    for _ in range(4):
        keep(optimizer, stale)
        assert len(optimizer.solve(a_request(), evade=True)) == 2
    turns = [name for k, name in enumerate(calls) if not k or calls[k - 1] != name]
    assert turns == ["along", "evasion", "along", "evasion"]
