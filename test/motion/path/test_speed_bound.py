import numpy as np
import pytest

from omniman_ros.motion.path.pace import HEADROOM, SpeedBound

BOUND = SpeedBound(1.0, 2.0, np.full(6, 3.0))


def velocities(x=0.0, y=0.0, turn=0.0, joint=0.0):
    return np.array([[0.0] * 9, [x, y, turn, 0.0, 0.0, joint, 0.0, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("moving", "use"),
    [
        (velocities(x=0.3, y=-0.4), 0.5),
        (velocities(x=0.1, turn=-1.6), 0.8),
    ],
)
def test_the_fastest_part_of_the_platform_keeps_to_its_share(moving, use):
    assert BOUND.pace(moving, 0.2, 1.0) == pytest.approx(HEADROOM * 0.2 / use)
    assert BOUND.pace(moving, 0.0, 1.0) == 0.0
    assert BOUND.pace(moving, 1.0, 0.0) == 1.0


def test_the_arm_keeps_to_its_share_and_rest_has_full_pace():
    assert BOUND.pace(velocities(joint=1.5), 1.0, 0.1) == pytest.approx(HEADROOM * 0.2)
    assert BOUND.pace(velocities(), 0.0, 0.0) == 1.0


def test_what_is_slower_than_its_share_is_not_slowed_down():
    assert BOUND.pace(velocities(x=0.1), 0.2, 1.0) == 1.0
