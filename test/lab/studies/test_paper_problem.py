"""The problem of MPC 2021 against an evaluation of the printed equations that shares no code."""

import math

import numpy as np
import pytest

from omniman_ros.lab.studies.paper_drive import paper_model
from omniman_ros.lab.studies.paper_problem import STAGE, STAGES, PaperProblem, PaperWeights
from omniman_ros.planning.mpc.model import SIGN_WIDTH
from test import robots

VALUES = robots.values("ig42")
WEIGHTS = PaperWeights(20.0, 5.0)
LENGTHS = 0.25 + 0.22  # L + l
RADIUS, INERTIA, MASS, YAW_INERTIA = 0.1016, 0.012, 25.0, 1.6
RESISTANCE, CONSTANT, RATIO, EFFICIENCY, VISCOUS, COULOMB = 1.85, 0.0325, 24.0, 0.66, 0.004, 0.25
R = (
    np.array([[1, -1, -LENGTHS], [1, 1, LENGTHS], [1, 1, -LENGTHS], [1, -1, LENGTHS]]) / RADIUS
)  # (1)
GOAL = np.array([6.0, 0.3, -1.0])
START = np.array([0.1, -0.2, -1.2, 0.4, 0.3, -0.2])  # pose, body twist


@pytest.fixture(scope="module")
def problem():
    return PaperProblem(paper_model(VALUES), WEIGHTS)


def rotation(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def printed_rate(x, volts):
    """(18) with (13) to (17) and (21) to (24), x = (q_r, q_r'), with the smooth sign."""
    psi, rates = x[2], x[3:]
    turn = rotation(psi)
    wheels = R @ turn.T @ rates
    current = (volts - CONSTANT * RATIO * wheels) / RESISTANCE
    sign = wheels / (SIGN_WIDTH + np.sqrt(wheels**2 + SIGN_WIDTH**2))
    torque = EFFICIENCY * RATIO * CONSTANT * current - VISCOUS * wheels - COULOMB * sign
    w = 4 * INERTIA / RADIUS**2
    h = np.diag([MASS + w, MASS + w, YAW_INERTIA + w * LENGTHS**2])
    k = np.array([[0, w * rates[2], 0], [-w * rates[2], 0, 0], [0, 0, 0]])
    return np.concatenate([rates, np.linalg.solve(h, turn @ R.T @ torque - k @ rates)])


def printed_cost(volts):
    """(25) with (31) and (32), the motion integrated in small steps."""
    x = np.concatenate([START[:3], rotation(START[2]) @ START[3:]])
    total = 0.0
    for stage in volts.T:
        wheels = R @ rotation(x[2]).T @ x[3:]
        total += STAGE * float(stage @ (stage - RATIO * CONSTANT * wheels) / RESISTANCE)
        h = STAGE / 50
        for _ in range(50):
            a = printed_rate(x, stage)
            b = printed_rate(x + 0.5 * h * a, stage)
            c = printed_rate(x + 0.5 * h * b, stage)
            d = printed_rate(x + h * c, stage)
            x = x + h / 6 * (a + 2 * b + 2 * c + d)
    error = GOAL - x[:3]
    return (
        total
        + WEIGHTS.position * (error[0] ** 2 + error[1] ** 2)
        + (WEIGHTS.heading * error[2] ** 2)
    )


def test_cost_is_31_and_32_on_the_printed_model(problem):
    random = np.random.default_rng(1)
    for _ in range(3):
        volts = random.uniform(-24.0, 24.0, (4, STAGES))
        assert float(problem.cost(volts, START, GOAL)) == pytest.approx(
            printed_cost(volts), rel=1e-3
        )


def test_horizon_is_the_papers():
    assert (STAGES, STAGE) == (10, 0.1)


def test_voltages_are_the_only_limit(problem):
    plan = problem.solve(np.zeros(6), np.array([60.0, 0.0, 0.0]))
    assert plan.solved
    assert np.abs(plan.voltages).max() == pytest.approx(24.0, abs=1e-4)
    goal = np.array([60.0, 0.0, 0.0])
    assert float(problem.cost(plan.voltages.T, np.zeros(6), goal)) == pytest.approx(plan.cost)
    speed = np.hypot(*plan.states[:, 3:5].T).max()
    # Beyond all limits of the robot's file: its speed, and its acceleration times one second.
    assert speed > 2.0 * max(
        VALUES["limits.linear_velocity"], VALUES["limits.linear_acceleration"]
    )


def test_solution_is_a_minimum_of_the_cost(problem):
    plan = problem.solve(START, GOAL)
    assert plan.solved
    volts = plan.voltages.T
    assert plan.cost == pytest.approx(float(problem.cost(volts, START, GOAL)), rel=1e-6)
    random = np.random.default_rng(2)
    for _ in range(20):
        other = np.clip(volts + random.normal(0.0, 0.5, volts.shape), -24.0, 24.0)
        assert float(problem.cost(other, START, GOAL)) > plan.cost


def test_warm_start_finds_the_same_plan(problem):
    cold = problem.solve(START, GOAL)
    warm = problem.solve(START, GOAL, cold)
    assert warm.voltages == pytest.approx(cold.voltages, abs=1e-2)


def test_integrated_energy_differs_from_the_printed_sum(problem):
    integrated = PaperProblem(paper_model(VALUES), WEIGHTS, integrated=True)
    volts = np.full((4, STAGES), 12.0)
    printed, exact = (float(p.cost(volts, np.zeros(6), GOAL)) for p in (problem, integrated))
    assert printed > exact + 1.0  # currents fall while the robot accelerates
