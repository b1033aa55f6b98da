"""Signed gaps against the distances of the solids, finite differences, and the way out."""

from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.collision.body_spheres import BodySpheres
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.collision.signed_gaps import (
    point_gaps,
    rectangle_gap_derivative,
    rectangle_gaps,
)
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.motion.whole_body.model import Mount

HALF, HEIGHTS = np.array([0.5, 0.35]), (0.0, 0.5)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.fixture
def obstacles():
    """Return a post, a table top, a wall with round ends, and a hanging cylinder."""
    wall = UprightObstacles(
        np.array([[1.0], [1.2]]),
        np.array([0.7]),
        np.array([[0.8], [0.0]]),
        np.array([0.1]),
        np.array([0.0]),
        np.array([2.0]),
    )
    return UprightObstacles.join(
        [
            UprightObstacles.cylinder(0.9, 0.2, 0.15, (0.0, 1.2)),
            UprightObstacles.box((-0.8, 0.4, 0.3), 1.2, 0.7, (0.7, 0.75)),
            wall,
            UprightObstacles.cylinder(-1.0, -0.5, 0.2, (0.8, 1.5)),
        ]
    )


def test_gaps_outside_are_the_distances(rng, obstacles):
    points = rng.uniform(-2.0, 2.0, (3, 300))
    gaps, _ = point_gaps(obstacles, points)
    distances = obstacles.point_distances(points[..., None])
    assert gaps.shape == (300, 4)
    assert np.allclose(np.maximum(gaps, 0.0), distances, atol=1e-12)
    poses = rng.uniform(-2.0, 2.0, (300, 3))
    gaps = rectangle_gaps(obstacles, poses, HALF, HEIGHTS)
    assert np.allclose(
        np.maximum(gaps, 0.0), obstacles.box_distances(poses, HALF, HEIGHTS), atol=1e-12
    )
    assert (gaps < 0.0).any()


def test_a_gap_inside_is_the_way_out():
    box = UprightObstacles.box((0.0, 0.0, 0.0), 2.0, 1.0, (0.0, 3.0))
    gap, normal = point_gaps(box, np.array([0.2, 0.3, 1.0]))
    assert gap[0] == pytest.approx(-0.2)
    assert normal[:, 0] == pytest.approx([0.0, 1.0, 0.0])
    post = UprightObstacles.cylinder(0.4, 0.0, 0.2, (0.0, 1.0))
    assert rectangle_gaps(post, np.zeros(3), HALF, HEIGHTS)[0] == pytest.approx(-0.3)


def test_derivatives_are_those_of_finite_differences(rng, obstacles):
    points, step = rng.uniform(-1.5, 1.5, (3, 200)), 1e-6
    gaps, normal = point_gaps(obstacles, points)
    for axis in range(3):
        moved = points.copy()
        moved[axis] += step
        slope = (point_gaps(obstacles, moved)[0] - gaps) / step
        assert np.median(np.abs(slope - normal[axis])) < 1e-5
        assert np.mean(np.abs(slope - normal[axis]) < 1e-3) > 0.99
    poses = rng.uniform(-1.5, 1.5, (50, 3))
    gaps, slopes = rectangle_gap_derivative(obstacles, poses, HALF, HEIGHTS)
    assert slopes.shape == (50, 4, 3)
    assert gaps == pytest.approx(rectangle_gaps(obstacles, poses, HALF, HEIGHTS))


def test_spheres_contain_the_capsules_axes_and_move_with_the_joints(rng):
    load = LoadShape(length=0.3, width=0.2, height=0.1)
    spheres = BodySpheres(Mount(), ToolShape(length=0.15), load, 0.08)
    q = rng.uniform(-3.0, 3.0, 6)
    placed = spheres.place(q)
    assert placed.centre.shape == (len(spheres.radius), 3)
    tip = placed.frames[-1] @ [0.0, 0.0, 0.15, 1.0]
    inside = np.linalg.norm(placed.centre - tip[:3], axis=1) <= spheres.radius
    assert inside.any()
    corner = placed.frames[-1] @ [0.15, 0.1, 0.1, 1.0]
    assert (np.linalg.norm(placed.centre - corner[:3], axis=1) <= spheres.radius + 1e-9).any()
    slopes, step = spheres.joint_derivative(placed), 1e-6
    for joint in range(6):
        moved = spheres.place(q + step * np.eye(6)[joint]).centre
        assert (moved - placed.centre) / step == pytest.approx(slopes[..., joint], abs=1e-5)


def test_solids_elsewhere_for_each_pose_have_the_gaps_of_solids_there(rng, obstacles):
    poses, points = rng.uniform(-1.5, 1.5, (5, 3)), rng.uniform(-1.5, 1.5, (3, 5, 2))
    places = obstacles.centre[:, None] + rng.uniform(-0.5, 0.5, (2, 5, 4))
    gaps, slopes = rectangle_gap_derivative(
        replace(obstacles, centre=places), poses, HALF, HEIGHTS
    )
    of_points, _ = point_gaps(replace(obstacles, centre=places[:, :, None]), points)
    for k in range(5):
        there = replace(obstacles, centre=places[:, k])
        gap, slope = rectangle_gap_derivative(there, poses[k], HALF, HEIGHTS)
        assert gaps[k] == pytest.approx(gap) and slopes[k] == pytest.approx(slope)
        assert of_points[k] == pytest.approx(point_gaps(there, points[:, k])[0])
