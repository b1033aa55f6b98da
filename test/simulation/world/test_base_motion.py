"""What an inertial sensor is told of a robot in the physics world."""

import numpy as np
import pytest

from test.simulation.world.support import ideal


def test_the_motion_of_the_base_is_that_of_its_pose():
    bench = ideal()
    bench.wait(0.2)
    bench.drive((0.3, 0.2, 0.5), 1.0)
    before, motion = bench.world.base_frame[0].copy(), bench.world.base_motion
    heading, twist = bench.world.pose[2], bench.world.twist
    bench.drive((0.3, 0.2, 0.5), 0.01)
    moved = (bench.world.base_frame[0] - before) / 0.01
    np.testing.assert_allclose(motion.rotation @ motion.velocity, moved, atol=5e-3)
    assert motion.rate[2] == pytest.approx((bench.world.pose[2] - heading) / 0.01, abs=5e-3)
    np.testing.assert_allclose(motion.velocity[:2], twist[:2])
    np.testing.assert_allclose(motion.rotation @ motion.rotation.T, np.eye(3), atol=1e-9)
    assert motion.rotation[2, 2] > 0.999
