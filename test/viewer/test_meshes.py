import math

import numpy as np
import pytest

from omniman_ros.core.polygon import signed_area
from omniman_ros.viewer import meshes
from omniman_ros.viewer.floor_shapes import marker, narrowed
from omniman_ros.viewer.meshes import rotation, wheel_rotations
from test import robots
from test.outlines import FORKS, OCTAGON, outlined

ANGLES = [-0.7854, 0.7854, 0.5, 0.0]


def signed_volume(mesh):
    """Return the volume inside a closed surface [m^3], negative if its triangles face inwards."""
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def is_closed(mesh):
    """Return whether each edge occurs once in both directions, with coincident vertices merged."""
    _, same = np.unique(mesh.vertices.round(9), axis=0, return_inverse=True)
    triangles = same.reshape(-1)[mesh.triangles]
    edges = [(t[i], t[(i + 1) % 3]) for t in triangles.tolist() for i in range(3)]
    return len(set(edges)) == len(edges) and all((b, a) in set(edges) for a, b in edges)


def quaternion_matrix(q):
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_a_cylinder_is_closed_faces_outwards_and_has_its_volume():
    mesh = meshes.revolved(np.array([-0.5, 0.0, 0.5]), np.full(3, 0.2), 200)
    assert is_closed(mesh)
    assert signed_volume(mesh) == pytest.approx(math.pi * 0.2**2, rel=1e-3)


def test_a_prism_is_closed_faces_outwards_and_has_its_volume():
    mesh = meshes.prism(meshes.rounded(2.0, 1.0, 0.0), 0.5, 1.5)
    assert signed_volume(mesh) == pytest.approx(2.0)
    round_one = meshes.prism(meshes.rounded(2.0, 1.0, 0.1), 0.5, 1.5)
    assert is_closed(round_one)
    assert signed_volume(round_one) == pytest.approx(2.0 - (4 - math.pi) * 0.01, rel=1e-3)


@pytest.mark.parametrize("gamma", ANGLES)
def test_the_rollers_form_a_wheel_of_its_radius(gamma):
    shape = meshes.wheel(0.1, gamma)
    distances = np.hypot(shape.rollers.vertices[:, 0], shape.rollers.vertices[:, 2])
    assert distances.max() == pytest.approx(0.1, rel=0.02)
    assert distances.max() <= 0.1 * 1.02
    for part in (shape.plates, shape.mark):
        assert np.hypot(part.vertices[:, 0], part.vertices[:, 2]).max() < 0.1
    assert signed_volume(shape.rollers) > 0.0 and signed_volume(shape.plates) > 0.0


@pytest.mark.parametrize("gamma", ANGLES)
def test_the_roller_on_the_floor_lies_along_gamma(gamma):
    rollers = meshes.wheel(0.1, gamma).rollers.vertices
    lowest = rollers.reshape(meshes.ROLLERS, -1, 3)[0]
    centred = lowest - lowest.mean(axis=0)
    assert lowest.mean(axis=0)[:2] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert lowest[:, 2].min() == pytest.approx(-0.1, rel=1e-3)
    _, _, axes = np.linalg.svd(centred)
    along = np.array([math.cos(gamma), math.sin(gamma), 0.0])
    assert abs(axes[0] @ along) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("gamma", ANGLES)
def test_the_rollers_leave_no_gap(gamma):
    """At every angle of the wheel some roller is near the floor."""
    shape = meshes.wheel(0.1, gamma)
    for step in np.linspace(0.0, 2.0 * math.pi / meshes.ROLLERS, 9):
        lowest = shape.rollers.rotated(meshes.about_y(step)).vertices[:, 2].min()
        assert -lowest == pytest.approx(0.1, rel=0.03)


@pytest.mark.parametrize("name", robots.ALL)
def test_every_robot_has_a_body_above_the_floor_and_within_its_box(name):
    robot = robots.robot(name)
    shape = meshes.body(robot)
    for mesh in (shape.chassis, shape.deck, shape.arrow):
        assert signed_volume(mesh) > 0.0
        assert mesh.vertices[:, 2].min() > 0.0
        assert np.abs(mesh.vertices[:, 0]).max() <= 0.5 * robot.body.length + 1e-9
        assert np.abs(mesh.vertices[:, 1]).max() <= 0.5 * robot.body.width + 1e-9
    tip = shape.arrow.vertices[np.argmax(shape.arrow.vertices[:, 0])]
    assert tip[0] > 0.0 and tip[1] == pytest.approx(0.0), "it points forward"


def test_a_wheel_rolls_forward_about_its_own_axle():
    """Positive angles move the top of the wheel in its rolling direction."""
    heading, angle = 0.3, 0.4
    (q,) = wheel_rotations(np.array([heading]), np.array([angle]))
    turn = quaternion_matrix(q)
    top = turn @ np.array([0.0, 0.0, 1.0])
    forward = np.array([math.cos(heading), math.sin(heading), 0.0])
    assert top @ forward == pytest.approx(math.sin(angle))
    axle = np.array([-math.sin(heading), math.cos(heading), 0.0])
    assert turn @ np.array([0.0, 1.0, 0.0]) == pytest.approx(axle)


def test_a_heading_turns_to_the_left():
    assert quaternion_matrix(rotation(0.5)) @ [1.0, 0.0, 0.0] == pytest.approx(
        [math.cos(0.5), math.sin(0.5), 0.0]
    )


@pytest.mark.parametrize("outline", [OCTAGON, FORKS])
def test_a_platform_with_an_outline_is_shown_with_it(outline):
    robot, area = outlined(outline).robot, signed_area(np.array(outline))
    shape = meshes.body(robot)
    height = np.ptp(shape.deck.vertices[:, 2])
    assert signed_volume(shape.deck) == pytest.approx(area * height)
    plate = marker(robot.body).plate
    assert signed_volume(plate) == pytest.approx(area * np.ptp(plate.vertices[:, 2]))


def test_the_border_of_a_marker_has_one_width():
    outline = np.array(OCTAGON)
    inner = narrowed(outline, 0.03)
    side = np.roll(outline, -1, axis=0) - outline
    offset = inner - outline
    depth = (side[:, 0] * offset[:, 1] - side[:, 1] * offset[:, 0]) / np.hypot(*side.T)
    np.testing.assert_allclose(depth, 0.03)
