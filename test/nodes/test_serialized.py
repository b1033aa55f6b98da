from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from omniman_ros.core.errors import InputError
from omniman_ros.nodes.serialized import deserialized


def test_data_that_are_no_message_are_refused_wherever_they_end():
    whole = serialize_message(JointState(name=["a", "b"], position=[1.0, 2.0]))
    assert deserialized(whole, JointState).position.tolist() == [1.0, 2.0]
    refused = 0
    for end in range(len(whole)):
        try:
            deserialized(whole[:end], JointState)
        except InputError as error:
            refused += 1
            assert "no JointState" in str(error)
    assert refused > len(whole) // 2
