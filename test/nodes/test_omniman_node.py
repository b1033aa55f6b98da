"""The base of all nodes: times of messages, whose stamps are of another clock than the node."""

import math
from types import SimpleNamespace

import pytest
from builtin_interfaces.msg import Time as TimeMsg
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.event_handler import QoSSubscriptionEventType
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String

from omniman_ros.nodes.odometry import OdometryNode
from omniman_ros.nodes.simulated_drive import SimulatedDriveNode
from omniman_ros.nodes.stop_interface import LATCHED, MISSED, RELAY
from test.nodes.harness import World

ROS_TIME_LEAD = 1_000_000_000  #: By how much ROS time is ahead of the steady clock [ns]


class HeldUp:
    """Two clocks of a process that is held up for 8 ms in every seventh reading of either."""

    def __init__(self):
        self.time, self.readings = 5_000_000_000, 0

    def _read(self, lead):
        self.readings += 1
        self.time += 8_000_000 if self.readings % 7 == 0 else 2_000
        return self.time + lead

    def of(self, lead):
        return lambda: self._read(lead)


@pytest.fixture
def node():
    with World(OdometryNode, parameters={"use_sim_time": False}) as world:
        (node,) = world.nodes
        node.clocks = HeldUp()
        node._read_clock, node._read_ros_time = map(node.clocks.of, (0, ROS_TIME_LEAD))
        yield node


def test_wheel_states_keep_their_order_when_the_node_is_held_up_between_two_clocks(node):
    (subscription,) = (s for s in node.subscriptions if s.topic_name == "/wheel_states")
    names = list(node.settings.value.core.robot.wheels.names)
    due = node.clocks.time
    for k in range(1, 60):
        due += 5_000_000
        node.clocks.time = max(node.clocks.time, due)
        message = JointState(name=names, position=[0.001 * k] * 4, velocity=[0.2] * 4)
        message.header.stamp = Time(nanoseconds=due + ROS_TIME_LEAD).to_msg()
        subscription.callback(serialize_message(message))
        feedback = node.core.feedback
        assert feedback.time == pytest.approx(1e-9 * due, abs=1e-4)
    assert not node.warning_counts


def test_a_stamp_before_1970_is_stale(node):
    assert node.age(TimeMsg(sec=-1)) > 1.0


def test_a_message_that_was_repaired_is_used_and_that_is_said_once():
    with World(OdometryNode) as world:
        (node,) = world.nodes
        publisher = world.publisher(PoseWithCovarianceStamped, "set_pose")
        message = PoseWithCovarianceStamped()
        message.header.frame_id = "odom"
        message.pose.pose.orientation.z = message.pose.pose.orientation.w = 0.7
        for _ in range(3):
            publisher.publish(message)
            world.run(1.5)
        assert node.core.odometry.pose == pytest.approx((0.0, 0.0, 0.5 * math.pi))
        assert node.warning_counts == {"set_pose repaired": 1}


@pytest.mark.parametrize("qos", [LATCHED, QoSProfile(depth=10)], ids=["latched", "volatile"])
def test_an_emergency_stop_is_received_from_any_publisher(qos):
    with World(SimulatedDriveNode) as world:
        (node,) = world.nodes
        world.publisher(Bool, "emergency_stop", qos).publish(Bool(data=True))
        world.run_until(lambda: not node.latch.released, 1.0, "the stop")


def test_a_press_whose_message_may_be_lost_stops():
    with World(SimulatedDriveNode) as world:
        (node,) = world.nodes
        world.probe.destroy_publisher(world.publisher(Bool, "emergency_stop"))

        def is_stopped():
            world.run(0.01)
            return not node.latch.released

        world._await(is_stopped, "the stop")  # the middleware tells of publishers in real time
        assert node.latch.status.reason == MISSED


def test_a_press_that_another_node_has_heard_stops():
    with World(SimulatedDriveNode) as world:
        (node,) = world.nodes
        world.publisher(String, RELAY).publish(String(data="emergency_stop"))
        world.run_until(lambda: not node.latch.released, 1.0, "the stop")
        assert node.latch.status.reason == "emergency_stop"


def test_a_volatile_publisher_of_emergency_stop_is_no_reason_to_warn(capfd):
    # The harness serves no events of the middleware: what they would call is called here.
    incompatible = QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS
    event = SimpleNamespace(last_policy_kind=QoSPolicyKind.DURABILITY)
    with World(SimulatedDriveNode) as world:
        (node,) = world.nodes
        handlers = {
            subscription.qos_profile.durability: handler
            for subscription in node.subscriptions
            if subscription.topic_name == "/emergency_stop"
            for handler in subscription.event_handlers
            if handler.event_type == incompatible
        }
        capfd.readouterr()
        handlers[DurabilityPolicy.TRANSIENT_LOCAL].callback(event)
        assert not capfd.readouterr().err
        node.report()
        assert not capfd.readouterr().err


def test_a_publisher_that_a_subscription_cannot_receive_is_named():
    incompatible = QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS
    with World(SimulatedDriveNode) as world:
        (node,) = world.nodes
        (subscription,) = (s for s in node.subscriptions if s.topic_name == "/wheel_commands")
        offered = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        world.probe.create_publisher(JointState, "wheel_commands", offered)
        world._await(lambda: node.count_publishers("wheel_commands") > 0, "the publisher")
        warnings = []
        node.warn = lambda subject, text: warnings.append(text)
        (handler,) = (h for h in subscription.event_handlers if h.event_type == incompatible)
        handler.callback(SimpleNamespace(last_policy_kind=QoSPolicyKind.RELIABILITY))
        world.run(1.1)
        assert warnings == [
            "wheel_commands of /probe cannot be received: its quality of service is best effort, "
            "expected reliable"
        ]
