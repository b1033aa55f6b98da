"""Rigid transforms, against homogeneous matrices that were computed by Rodrigues' formula."""

import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.repairs import noted_repairs
from omniman_ros.core.rigid import Transform, heading

SAMPLES = 50


def random_transform(rng: np.random.Generator) -> tuple[Transform, np.ndarray]:
    """Return a transform and its matrix."""
    axis, angle = rng.normal(size=3), rng.uniform(-math.pi, math.pi)
    axis /= np.linalg.norm(axis)
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    matrix[:3, 3] = rng.uniform(-3, 3, 3)
    rotation = (*(math.sin(angle / 2) * axis).tolist(), math.cos(angle / 2))
    return Transform(tuple(matrix[:3, 3].tolist()), rotation), matrix


@pytest.mark.parametrize(("typed", "is_noted"), [(0.7, True), (0.71, False), (0.74, True)])
def test_a_quaternion_that_was_typed_is_normalised_and_noted_if_it_is_not_just_rounded(
    typed, is_noted
):
    with noted_repairs() as notes:
        assert heading((0.0, 0.0, typed, typed)) == pytest.approx(0.5 * math.pi)
    length = f"{math.sqrt(2.0) * typed:.4g}"
    assert notes == ([f"a quaternion of length {length} was normalised"] if is_noted else [])
    assert heading((0.0, 0.0, typed, typed)) == pytest.approx(0.5 * math.pi)
    assert len(notes) == is_noted, "nobody asks"


def test_composition_inverse_and_matrix_are_those_of_homogeneous_matrices():
    rng = np.random.default_rng(1)
    for _ in range(SAMPLES):
        (a, a_matrix), (b, b_matrix) = random_transform(rng), random_transform(rng)
        assert a.matrix() == pytest.approx(a_matrix, abs=1e-12)
        assert (a @ b).matrix() == pytest.approx(a_matrix @ b_matrix, abs=1e-12)
        assert a.inverse.matrix() == pytest.approx(np.linalg.inv(a_matrix), abs=1e-12)


def test_interpolated_transforms_turn_at_a_constant_rate_on_the_shorter_way():
    rng = np.random.default_rng(2)
    for _ in range(SAMPLES):
        a, _ = random_transform(rng)
        b, _ = random_transform(rng)
        if rng.random() < 0.5:  # the same rotation
            b = Transform(b.translation, tuple(-value for value in b.rotation))
        fraction = float(rng.uniform())
        between = a.interpolated(b, fraction)
        relative = a.matrix()[:3, :3].T @ b.matrix()[:3, :3]
        part = a.matrix()[:3, :3].T @ between.matrix()[:3, :3]
        whole = math.acos((np.trace(relative) - 1) / 2)
        # acos loses digits near 0 and pi
        assert math.acos((np.trace(part) - 1) / 2) == pytest.approx(fraction * whole, abs=1e-6)
        line = (1 - fraction) * np.array(a.translation) + fraction * np.array(b.translation)
        assert between.translation == pytest.approx(line)


def test_the_ends_of_an_interpolation_are_its_transforms():
    rng = np.random.default_rng(3)
    a, _ = random_transform(rng)
    nearly = Transform(a.translation, a.interpolated(Transform(), 1e-9).rotation)
    for b in (Transform((1.0, 2.0, 3.0)), nearly):
        assert a.interpolated(b, 0.0).matrix() == pytest.approx(a.matrix())
        assert a.interpolated(b, 1.0).matrix() == pytest.approx(b.matrix())


def test_planar_poses_come_back_and_tilted_ones_are_refused():
    pose = (1.0, -2.0, 3.0)
    assert Transform.of_planar(pose).planar() == pytest.approx(pose)
    with pytest.raises(InputError, match="not about the vertical"):
        Transform(rotation=(math.sin(0.1), 0.0, 0.0, math.cos(0.1))).planar()
