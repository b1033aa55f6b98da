"""Rows of obstacles: edges that face them, and the margin for the motion between two nodes."""

import casadi as ca
import numpy as np
import pytest

from omniman_ros.planning.mpc.gap_rows import OBSTACLE, SMOOTH_RATE, ellipse_axes, gap_rows
from omniman_ros.surroundings.ellipses import inflated

STEP = 0.1


def widened(node, row):
    """Return the semi-axes (2,) for a state at a node and an obstacle."""
    y, p = ca.SX.sym("y", 6), ca.SX.sym("p", OBSTACLE)
    axes = ca.Function("axes", [y, p], [ellipse_axes(y, p, STEP).value])
    return np.asarray(axes(np.asarray(node, float), row)).ravel()


def an_obstacle(a, b, velocity=(0.0, 0.0), radius=0.5):
    return np.array([1.0, 0.6, 1.0, 0.0, a, b, *velocity, 0, 0, 1, 0, 0.4, 0.25, radius])


def test_an_ellipse_that_nothing_passes_is_not_widened():
    moving = np.array([0.0, 0.0, 0.7, 0.3, 0.1, 0.0])
    c, s = np.cos(0.7), np.sin(0.7)
    along = 0.3 * c - 0.1 * s, 0.3 * s + 0.1 * c
    assert widened(moving, an_obstacle(0.3, 0.2, along)) == pytest.approx([0.3, 0.2], abs=1e-4)


def test_a_small_obstacle_is_widened_where_steps_are_long():
    # By half of the 0.4 m travelled in a step: nothing slips between two nodes.
    assert widened(np.zeros(6), an_obstacle(0.03, 0.03, (0.0, -4.0))).min() > 0.19


def test_no_chord_between_two_nodes_on_the_widened_ellipse_enters_the_obstacle():
    random = np.random.default_rng(1)
    for _ in range(200):
        a, b = random.uniform(0.05, 0.6, 2)
        node = np.append(np.zeros(3), random.uniform(-1, 1, 3))
        row = an_obstacle(a, b, random.uniform(-1, 1, 2))
        axes = widened(node, row)
        spin = np.hypot(node[5], SMOOTH_RATE)
        travel = STEP * (np.hypot(*(node[3:5] - row[6:8])) + 0.5 * spin)
        bend = min(a, b) ** 2 / max(a, b)
        margin = np.hypot(bend, 0.5 * travel) - bend
        assert axes == pytest.approx(inflated(np.array([a, b]), margin))
        # A chord of this length, with both ends on the ellipse, beside every point of it.
        angle = np.linspace(0, 2 * np.pi, 2001)
        around = np.column_stack([axes[0] * np.cos(angle), axes[1] * np.sin(angle)])
        length = np.hypot(*(around[:, None] - around[None, ::50]).transpose(2, 0, 1))
        ends = np.abs(length - travel).argmin(axis=0)
        middle = 0.5 * (around[::50] + around[ends])
        assert (((middle / [a, b]) ** 2).sum(axis=1) > 1.0 - 1e-3).all()


@pytest.mark.parametrize("seed", range(60))
def test_derivatives_of_the_gaps_match_finite_differences(seed):
    random = np.random.default_rng(seed)
    y, p = ca.SX.sym("y", 6), ca.SX.sym("p", OBSTACLE)
    rows = ca.Function("rows", [y, p], gap_rows(y, p, STEP))
    row = an_obstacle(*random.uniform(0.1, 0.5, 2), random.uniform(-1, 1, 2))
    row[2:4] = np.cos(seed), np.sin(seed)
    row[8:10], row[10:12] = random.uniform(-0.3, 0.3, 2), (np.cos(2 * seed), np.sin(2 * seed))
    state = random.uniform(-1, 1, 6)  # also inside
    _, slope = (np.asarray(part) for part in rows(state, row))
    for k in range(6):
        tiny = 1e-6 * np.eye(6)[k]
        ahead, behind = (np.asarray(rows(state + way * tiny, row)[0]).ravel() for way in (1, -1))
        np.testing.assert_allclose(slope[:, k], (ahead - behind) / 2e-6, rtol=1e-4, atol=1e-6)
