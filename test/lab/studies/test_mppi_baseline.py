"""Parts of Nav2's MPPI, by hand."""

import math

import numpy as np
import pytest

from omniman_ros.lab.studies.crowds import RADIUS
from omniman_ros.lab.studies.mppi_baseline import (
    MODEL_DT,
    PATH_STEP,
    aligned,
    costmap,
    inflated_cost,
    integrated,
    planned_path,
)

INSCRIBED = 0.25


def test_costs_are_those_of_an_inflated_costmap():
    distances = np.array([-0.1, 0.0, 0.1, 0.25, 0.35, 0.7, 0.71])
    expected = [254.0, 254.0, 253.0, 253.0, 252.0 * math.exp(-0.3), 252.0 * math.exp(-1.35), 0.0]
    assert inflated_cost(distances, INSCRIBED) == pytest.approx(expected)
    disc = np.array([[1.0, 0.0]])
    assert costmap(np.array([1.0 + RADIUS + 0.35, 0.0]), disc, INSCRIBED) == pytest.approx(
        252.0 * math.exp(-0.3)
    )
    assert costmap(np.array([4.9, 0.0]), disc, INSCRIBED) == 253.0


def test_velocities_turn_with_the_robot():
    twists = np.tile([0.5, 0.0, 0.8], (1, 50, 1))
    (poses,) = integrated(np.array([1.0, 2.0, 0.3]), twists)
    radius, turned = 0.5 / 0.8, 0.3 + 0.8 * 50 * MODEL_DT
    assert poses[-1, 2] == pytest.approx(turned)
    there = (
        1.0 + radius * (math.sin(turned) - math.sin(0.3)),
        2.0 - radius * (math.cos(turned) - math.cos(0.3)),
    )
    assert poses[-1, :2] == pytest.approx(there, abs=0.03)  # of first order


def test_a_path_leads_around_what_stands_and_none_out_of_a_ring():
    start, goal = np.array([-3.0, 0.0]), np.array([3.0, 0.0])
    discs = np.column_stack([np.zeros(5), np.linspace(-1.0, 1.0, 5)])
    path = planned_path(start, goal, discs, INSCRIBED)
    assert path[0] == pytest.approx(start) and path[-1] == pytest.approx(goal)
    assert np.hypot(*np.diff(path, axis=0).T).max() < 1.01 * PATH_STEP
    gaps = np.hypot(*np.moveaxis(path[:, None] - discs, 2, 0)).min() - RADIUS
    assert gaps > INSCRIBED
    angles = np.linspace(0.0, math.tau, 12, endpoint=False)
    ring = 1.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    assert planned_path(np.zeros(2), goal, ring, INSCRIBED) is None


def test_alignment_is_the_distance_at_the_same_length():
    path = np.column_stack([PATH_STEP * np.arange(60), np.zeros(60)])
    beside = np.stack([path[:40:4] + [0.0, 0.3], path[:40:4]])
    assert aligned(beside, path, np.ones(60, dtype=bool)) == pytest.approx([0.3, 0.0], abs=1e-6)
