import math
import struct

import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.ur.reverse_interface import MESSAGE, ProgramMode, pack

JOINTS = [0.0, -1.5, 1.25, -0.000001, 2 * math.pi, -2 * math.pi]


def test_message_is_eight_big_endian_integers():
    message = pack(JOINTS, ProgramMode.SERVO, 0.02)
    assert message == struct.pack(">iiiiiiii", 20, 0, -1500000, 1250000, -1, 6283185, -6283185, 1)
    assert len(message) == MESSAGE.size == 32


@pytest.mark.parametrize(("mode", "number"), [(ProgramMode.SERVO, 1), (ProgramMode.STOPPED, -2)])
def test_mode_is_the_last_number(mode, number):
    assert struct.unpack(">i", pack(JOINTS, mode, 0.04)[-4:]) == (number,)


@pytest.mark.parametrize("angle", [math.nan, math.inf, -math.inf, 2148.0])
@pytest.mark.parametrize("joint", range(6))
def test_non_finite_angle_is_rejected(angle, joint):
    joints = list(JOINTS)
    joints[joint] = angle
    with pytest.raises(InputError, match="joint angle"):
        pack(joints, ProgramMode.SERVO, 0.02)


@pytest.mark.parametrize("count", [0, 5, 7])
def test_message_needs_six_angles(count):
    with pytest.raises(InputError, match=f"got {count}"):
        pack([0.0] * count, ProgramMode.SERVO, 0.02)


@pytest.mark.parametrize("timeout", [0.0, -1.0, 0.007, 0.3, math.nan])
def test_read_timeout_out_of_range_is_rejected(timeout):
    with pytest.raises(InputError, match="read timeout"):
        pack(JOINTS, ProgramMode.SERVO, timeout)
