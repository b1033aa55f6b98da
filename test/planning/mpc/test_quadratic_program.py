"""Programs that HPIPM must never see."""

import math

import numpy as np
import pytest

from omniman_ros.planning.mpc import quadratic_program
from omniman_ros.planning.mpc.quadratic_program import MODES, QuadraticProgram, SolverError

#: Unknowns x_0, u_0, x_1: rows x_0 + u_0 - x_1 = 0 and u_0 within bounds
SIZES = {"N": 1, "nx": [1, 1], "nu": [1, 0], "ng": [1, 0]}
A = np.array([[1.0, 1.0, -1.0], [0.0, 1.0, 0.0]])
PARTS = ("h", "g", "a", "low", "high", "lower", "upper")


@pytest.fixture(scope="module")
def program():
    return QuadraticProgram.of_masks(np.eye(3) != 0, A != 0, SIZES)


def entries(**changes):
    """Return a program that moves x_1 towards 2 from x_0 = 1, with some entries changed."""
    values = {
        "h": [1.0, 1.0, 1.0],
        "g": [0.0, 0.0, -2.0],
        "a": A.T[A.T != 0],
        "low": [0.0, -0.5],
        "high": [0.0, 0.5],
        "lower": [1.0, -math.inf, -math.inf],
        "upper": [1.0, math.inf, math.inf],
    }
    values |= changes
    h, g, a, *bounds = (np.array(values[name], dtype=float) for name in PARTS)
    return h, g, a, tuple(bounds)


def test_a_program_within_its_bounds_is_solved(program):
    assert program.solve_entries(*entries()) == pytest.approx([1.0, 0.5, 1.5], abs=0.02)


def test_each_program_has_its_own_solution(program):
    first = program.solve_entries(*entries())
    second = program.solve_entries(*entries(high=[0.0, 0.1]))
    assert first[1] == pytest.approx(0.5, abs=0.02)
    assert second == pytest.approx([1.0, 0.1, 1.1], abs=0.02)


@pytest.mark.parametrize(
    ("part", "values", "message"),
    [
        ("h", [1.0, math.nan, 1.0], "matrix H"),
        ("g", [0.0, math.inf, 0.0], "gradient"),
        ("a", [1.0, math.nan, 1.0, -1.0], "matrix A"),
        ("low", [0.0, math.nan], "row 1 .* nan and 0.5"),
        ("low", [0.0, 0.6], "row 1 .* 0.6 and 0.5"),
        ("high", [0.0, -math.inf], "row 1 .* -0.5 and -inf"),
        ("lower", [1.0, math.inf, 0.0], "unknown 1 .* inf and inf"),
        ("upper", [0.5, 1.0, 1.0], "unknown 0 .* 1 and 0.5"),
    ],
)
def test_what_is_not_finite_or_contradictory_is_refused(program, part, values, message):
    with pytest.raises(SolverError, match=message):
        program.solve_entries(*entries(**{part: values}))


def test_entries_that_are_written_in_place_are_solved(program):
    h, g, a, bounds = entries(high=[0.0, 0.25])
    for own, values in zip(program.entries, (h, g, a, *bounds), strict=True):
        own[:] = values
    assert program.solve() == pytest.approx([1.0, 0.25, 1.25], abs=0.02)


@pytest.mark.parametrize("limited", ["speed", "balance"])
def test_the_limit_of_iterations_is_a_failure_unless_the_other_mode_solves_it(
    monkeypatch, limited
):
    few = {**MODES, limited: {**MODES[limited], "iter_max": 1}}
    monkeypatch.setattr(quadratic_program, "MODES", few)
    made = QuadraticProgram.of_masks(np.eye(3) != 0, A != 0, SIZES)
    assert made.solve_entries(*entries()) == pytest.approx([1.0, 0.5, 1.5], abs=0.02)
    few = {mode: {**options, "iter_max": 1} for mode, options in MODES.items()}
    monkeypatch.setattr(quadratic_program, "MODES", few)
    made = QuadraticProgram.of_masks(np.eye(3) != 0, A != 0, SIZES)
    with pytest.raises(SolverError, match="not solved"):
        made.solve_entries(*entries())
