import math
import struct

import pytest
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from omniman_ros.conversions.odometry import ODOMETRY_NUMBERS, set_odometry_numbers
from omniman_ros.nodes import message_template
from omniman_ros.nodes.message_template import STAMP, MessageTemplate, marks


def joint_state(names, velocity, effort, stamp):
    message = JointState(name=names, velocity=velocity, effort=effort)
    message.header.stamp, message.header.frame_id = stamp, "somewhere"
    return message


@pytest.mark.parametrize("names", [["a"], ["ab", "c", "def"], [f"joint_{k}" for k in range(9)]])
def test_packed_message_is_the_serialized_one(names):
    n = len(names)
    template = MessageTemplate(joint_state(names, marks(n), marks(n, n), STAMP))
    for k in (0, 3):
        numbers = [k + 0.1 * i for i in range(2 * n - 1)] + [-math.inf]
        expected = joint_state(names, numbers[:n], numbers[n:], Time(sec=k, nanosec=999_999_999))
        packed = template.pack(k * 10**9 + 999_999_999, numbers)
        # Not byte by byte: what CDR leaves between strings and numbers is not specified.
        assert len(packed) == len(serialize_message(expected))
        assert deserialize_message(packed, JointState) == expected


def test_what_cdr_leaves_behind_an_empty_array_is_no_mark(monkeypatch):
    def serialize(message):
        """Serialize, with half a mark of an earlier message in the bytes that are left."""
        data = bytearray(serialize_message(message))
        assert len(data) % 8 == 4, "an empty array of doubles ends with four bytes of alignment"
        data[-4:] = struct.pack("=d", marks(1, 2)[0])[4:]
        return bytes(data)

    monkeypatch.setattr(message_template, "serialize_message", serialize)
    template = MessageTemplate(joint_state(["a", "b"], marks(2), [], STAMP))
    packed = template.pack(0, [1.0, 2.0])
    expected = joint_state(["a", "b"], [1.0, 2.0], [], Time())
    assert deserialize_message(packed, JointState) == expected


def test_scattered_numbers_are_packed_into_their_places():
    marked, expected = Odometry(child_frame_id="base"), Odometry(child_frame_id="base")
    marked.header.stamp = STAMP
    set_odometry_numbers(marked, marks(ODOMETRY_NUMBERS))
    numbers = [1.5 * k for k in range(ODOMETRY_NUMBERS)]
    expected.header.stamp.nanosec = 7
    set_odometry_numbers(expected, numbers)
    packed = MessageTemplate(marked).pack(7, numbers)
    assert deserialize_message(packed, Odometry) == expected


def test_too_few_numbers_are_refused():
    template = MessageTemplate(joint_state(["a", "b"], marks(2), marks(2, 2), STAMP))
    with pytest.raises(Exception, match="expected 2 items"):
        template.pack(0, [1.0, 2.0, 3.0])
