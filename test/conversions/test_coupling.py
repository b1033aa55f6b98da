import numpy as np
from sensor_msgs.msg import JointState

from omniman_ros.conversions.coupling import (
    coupling_error_numbers,
    coupling_names,
    total_coupling_error,
)


def test_message_has_controlled_errors_first_then_totals_and_one_rate_for_both():
    controlled, total, rate = np.array([0.1, 0.2]), np.array([3.0, 4.0]), np.array([5.0, 6.0])
    numbers = coupling_error_numbers(controlled, total, rate)
    message = JointState(name=coupling_names(2), position=numbers[:4], velocity=numbers[4:])
    assert list(message.name) == [
        "constraint_1",
        "constraint_2",
        "constraint_1_total",
        "constraint_2_total",
    ]
    assert list(message.position) == [0.1, 0.2, 3.0, 4.0]
    assert list(message.velocity) == [5.0, 6.0, 5.0, 6.0]
    assert total_coupling_error(message) == [3.0, 4.0]


def test_message_of_one_kind_is_read_as_it_is():
    message = JointState(name=["constraint_1"], position=[0.5])
    assert total_coupling_error(message) == [0.5]
    assert total_coupling_error(JointState(position=[0.5])) == [0.5]
    assert total_coupling_error(JointState(name=coupling_names(0))) == []
