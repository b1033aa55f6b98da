import math

import numpy as np
import pytest

from omniman_ros.description.transforms import transform


def test_rotations_are_about_fixed_axes_in_the_order_x_y_z():
    pose = transform((1.0, 2.0, 3.0), (0.5 * math.pi, 0.0, 0.5 * math.pi))
    # y turns to z about x, and stays there about z; x turns to y about z.
    assert pose @ (0.0, 1.0, 0.0, 1.0) == pytest.approx((1.0, 2.0, 4.0, 1.0))
    assert pose @ (1.0, 0.0, 0.0, 1.0) == pytest.approx((1.0, 3.0, 3.0, 1.0))
    assert transform((0.0, 0.0, 0.0), (0.0, 0.5 * math.pi, 0.0)) @ (1.0, 0.0, 0.0, 1.0) == (
        pytest.approx((0.0, 0.0, -1.0, 1.0))
    )


def test_a_rotation_keeps_lengths_and_handedness():
    rotation = transform((0.0, 0.0, 0.0), (0.3, -1.1, 2.2))[:3, :3]
    assert rotation @ rotation.T == pytest.approx(np.eye(3))
    assert np.linalg.det(rotation) == pytest.approx(1.0)
