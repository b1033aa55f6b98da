"""Workarounds for rclpy, against the executors that the nodes use."""

import time

import pytest
import rclpy
from geometry_msgs.msg import Twist
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile

from omniman_ros.nodes.rclpy_compat import spin_for, subscribe_with_source_time
from test.nodes.harness import free_domain

TIMEOUT = 20.0  #: Time for discovery and delivery [s]


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
