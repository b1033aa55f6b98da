import numpy as np
import pytest

from omniman_ros.lab.studies.tool_courses import corner, course_poses, start
from omniman_ros.motion.whole_body.model import Mount, WholeBodyModel


def test_an_l_goes_straight_and_then_to_the_left_for_as_long():
    model = WholeBodyModel(Mount())
    poses = course_poses(model, corner, 2.0, 21)
    moved = poses[:, :3, 3] - model.forward(start())[:3, 3]
    assert moved[[10, 20]] == pytest.approx(np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]))
    assert np.linalg.norm(np.diff(moved, axis=0), axis=1) == pytest.approx(np.full(20, 0.1))
