import math
import struct

import pytest

from omniman_ros.arm.reverse import MESSAGE, Mode, pack
from omniman_ros.core.errors import InputError

JOINTS = [0.0, -1.5, 1.25, -0.000001, 2 * math.pi, -2 * math.pi]


def test_a_message_is_eight_big_endian_integers():
    message = pack(JOINTS, Mode.SERVO, 0.02)
    assert message == struct.pack(
        ">iiiiiiii", 20, 0, -1500000, 1250000, -1, 6283185, -6283185, 1
    )  # fmt: skip
    assert len(message) == MESSAGE.size == 32


@pytest.mark.parametrize(("mode", "number"), [(Mode.SERVO, 1), (Mode.STOPPED, -2)])
def test_the_mode_is_the_last_number(mode, number):
    assert struct.unpack(">i", pack(JOINTS, mode, 0.04)[-4:]) == (number,)


@pytest.mark.parametrize("angle", [math.nan, math.inf, -math.inf, 2148.0])
@pytest.mark.parametrize("joint", range(6))
def test_an_angle_that_is_none_is_refused(angle, joint):
    joints = list(JOINTS)
    joints[joint] = angle
    with pytest.raises(InputError, match="joint angle"):
        pack(joints, Mode.SERVO, 0.02)


@pytest.mark.parametrize("count", [0, 5, 7])
def test_six_angles_are_needed(count):
    with pytest.raises(InputError, match=f"{count} joint angles"):
        pack([0.0] * count, Mode.SERVO, 0.02)


@pytest.mark.parametrize("timeout", [0.0, -1.0, 0.007, 0.3, math.nan])
def test_a_read_timeout_out_of_range_is_refused(timeout):
    with pytest.raises(InputError, match="read time-out"):
        pack(JOINTS, Mode.SERVO, timeout)
