"""Workarounds for rclpy, against the executors that the nodes use."""

import time

import pytest
import rclpy
from geometry_msgs.msg import Twist
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from omniman_ros.core.errors import InputError
from omniman_ros.nodes.rclpy_compat import deserialized, spin_for, subscribe_with_source_time
from test.nodes.harness import free_domain

TIMEOUT = 20.0
"""Time for discovery and delivery [s]."""


@pytest.mark.processes
@pytest.mark.parametrize("make_executor", [EventsExecutor, SingleThreadedExecutor])
def test_each_executor_passes_the_source_time_of_a_message(make_executor, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init(domain_id=free_domain())
    try:
        node = Node("node")
        received = []
        subscribe_with_source_time(
            node, Twist, "cmd_vel", lambda *taken: received.append(taken), QoSProfile(depth=1)
        )
        publisher = node.create_publisher(Twist, "cmd_vel", 1)
        executor = make_executor()
        executor.add_node(node)
        deadline = time.monotonic() + TIMEOUT
        sent = []
        while not received and time.monotonic() < deadline:
            message = Twist()
            message.linear.x = float(len(sent))
            sent.append(time.time_ns())
            publisher.publish(message)
            spin_for(executor, 0.05)
        message, source_time = received[0]
        index = int(message.linear.x)
        bounds = [*sent, time.time_ns()]
        assert bounds[index] <= source_time <= bounds[index + 1]
        executor.remove_node(node)
        node.destroy_node()
        executor.shutdown()
    finally:
        rclpy.try_shutdown()


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
