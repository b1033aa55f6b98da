"""What a client makes of messages that make no sense, or that are out of order."""

import math

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState

from omniman_ros.client.robot import Robot
from omniman_ros.client.shared_node import SharedNode
from omniman_ros.client.telemetry import Telemetry
from omniman_ros.nodes.odometry import OdometryNode
from test.nodes.harness import PERIOD, World

NAN = math.nan


@pytest.fixture(scope="module")
def world():
    with World(OdometryNode) as world:
        yield world


def odom(x=0.0, vx=0.0, sec=1000, w=1.0):
    message = Odometry()
    message.header.stamp = Time(sec=sec)
    message.pose.pose.position.x, message.pose.pose.orientation.w = x, w
    message.twist.twist.linear.x = vx
    return message


def tool(x=0.0):
    message = PoseStamped()
    message.pose.position.x = x
    return message


def status(distance):
    return DiagnosticStatus(values=[KeyValue(key="distance_m", value=distance)])


NONSENSE = [
    ("odom", odom(x=NAN)),
    ("odom", odom(x=1e12)),
    ("odom", odom(vx=math.inf)),
    ("odom", odom(sec=-5)),
    ("odom", odom(w=0.0)),
    ("tool_pose", tool(x=NAN)),
    ("arm/joint_states", JointState(name=["a"], position=[NAN], velocity=[0.0])),
    ("arm/joint_states", JointState(name=["a"], position=[0.0], velocity=[math.inf])),
]


@pytest.mark.parametrize(("topic", "message"), NONSENSE)
def test_nonsense_is_as_no_message(world, topic, message):
    with Robot("elsewhere", world.probe, serve=lambda t: world.run(max(t, PERIOD))) as robot:
        publisher = world.probe.create_publisher(type(message), f"/elsewhere/{topic}", 10)
        world._await(lambda: publisher.get_subscription_count() == 1, "the client")
        publisher.publish(message)
        world.run(0.1)
        readings = (robot.pose, robot.twist, robot.tool, robot.joints)
        assert not any(reading.is_known for reading in readings)
        if topic == "odom":
            publisher.publish(odom(x=1.5))
            world.run(0.1)
            assert robot.pose.value == (1.5, 0.0, 0.0)
        world.probe.destroy_publisher(publisher)


def nanoseconds(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


def test_stamps_are_those_of_the_robot_each_of_its_own_though_time_stands_or_goes_back(world):
    shared = SharedNode(world.probe, "/elsewhere")
    telemetry = Telemetry(shared)
    publisher = world.probe.create_publisher(Odometry, "/elsewhere/odom", 10)
    world._await(lambda: publisher.get_subscription_count() == 1, "the telemetry")
    for sec, expected in ((1000, (0, 1)), (4_000_000, (0, 1)), (1001, (0, 1))):
        publisher.publish(odom(sec=sec))
        world.run(0.1)
        stamps = [nanoseconds(telemetry.next_stamp()) - sec * 10**9 for _ in expected]
        assert stamps == list(expected)
    world.probe.destroy_publisher(publisher)
    shared.detach()
