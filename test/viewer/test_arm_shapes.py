import math

import numpy as np
import pytest

from omniman_ros.description.ur5 import BASE, links
from omniman_ros.motion.whole_body.model import Mount, WholeBodyModel
from omniman_ros.viewer.arm_shapes import (
    CAP_RADIUS_RATIO,
    CAPS,
    END,
    ArmShape,
    product,
    quaternion,
    rotated,
)

MOUNT = Mount(x=0.2, y=-0.1, z=0.5, yaw=0.4)
ANGLES = np.random.default_rng(7).uniform(-math.pi, math.pi, (20, 6))
CHAIN = (BASE, *links())


def matrix(rotation):
    return np.stack([rotated(rotation, axis) for axis in np.eye(3)], axis=1)


def rpy_matrix(rpy):
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in rpy)
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return z @ y @ x


def test_a_quaternion_equals_the_rotation_of_its_angles():
    for rpy in np.random.default_rng(1).uniform(-3.0, 3.0, (10, 3)):
        assert np.allclose(matrix(quaternion(rpy)), rpy_matrix(rpy))


def test_a_product_of_quaternions_composes_their_rotations():
    first, second = quaternion((0.3, -0.8, 2.0)), quaternion((-1.0, 0.4, 0.5))
    assert np.allclose(matrix(product(first, second)), matrix(first) @ matrix(second))


@pytest.mark.parametrize("angles", ANGLES)
def test_the_last_link_agrees_with_the_tool_of_the_model(angles):
    positions, rotations = ArmShape(MOUNT).frames(angles)
    tool = WholeBodyModel(MOUNT).forward(np.concatenate([np.zeros(3), angles]))
    assert positions.shape == (7, 3) and rotations.shape == (7, 4)
    assert positions[-1] == pytest.approx(tool[:3, 3], abs=1e-9)
    assert np.allclose(matrix(rotations[-1]), tool[:3, :3], atol=1e-9)


def test_every_tube_of_the_description_is_drawn_from_its_start_to_its_end():
    shape = ArmShape(MOUNT)
    frames = shape.frames(ANGLES[0])
    positions, rotations = shape.placed(shape.tubes, frames)
    along = rotated(rotations, np.array([[0.0, 0.0, 0.5]]) * shape.tubes.scales)
    tubes = [(k, tube) for k, link in enumerate(CHAIN) for tube in link.tubes]
    assert len(positions) == len(tubes)
    for i, (k, tube) in enumerate(tubes):
        for end, sign in ((tube.start, -1.0), (tube.end, 1.0)):
            there = frames[0][k] + rotated(frames[1][k], np.array(end))
            assert positions[i] + sign * along[i] == pytest.approx(there, abs=1e-12)
        assert shape.tubes.scales[i, :2] == pytest.approx([tube.radius, tube.radius])


def test_caps_close_the_ends_of_their_tubes_and_face_outwards():
    shape = ArmShape(MOUNT)
    frames = shape.frames(ANGLES[1])
    positions, rotations = shape.placed(shape.caps, frames)
    outward = rotated(rotations, np.broadcast_to([0.0, 0.0, 1.0], (len(CAPS), 3)))
    for i, (k, index, which) in enumerate(CAPS):
        tube = CHAIN[k].tubes[index]
        far, near = (tube.end, tube.start) if which == END else (tube.start, tube.end)
        ends = [frames[0][k] + rotated(frames[1][k], np.array(end)) for end in (far, near)]
        assert positions[i] == pytest.approx(ends[0], abs=1e-12)
        away = (ends[0] - ends[1]) / tube.length
        assert outward[i] == pytest.approx(away, abs=1e-9)
        assert shape.caps.scales[i] == pytest.approx([CAP_RADIUS_RATIO * tube.radius] * 3)
