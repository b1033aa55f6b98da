"""The node `odometry` over real topics, on simulated time."""

import math
from functools import partial

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import UInt32MultiArray
from std_srvs.srv import Trigger

from omniman_ros.control.wheel_feedback import MAX_GAP
from omniman_ros.conversions.odometry import odometry_transform
from omniman_ros.nodes import tf_messages
from omniman_ros.nodes.odometry import OdometryNode
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.simulated_drive import SimulatedDriveNode
from omniman_ros.nodes.stop_interface import LATCHED
from test.nodes.harness import PERIOD, World, last
from test.nodes.rig import twist
from test.nodes.transforms import tf_installed
from test.tiers import exhaustive

SPEEDS = np.array([2.0, 3.0, 1.0, 4.0])


class Wheels(World):
    """The node with wheels that turn at constant speeds."""

    def __init__(self, parameters=None):
        super().__init__(OdometryNode, parameters=parameters)
        (self.node,) = self.nodes
        self.core = self.node.core
        self.names = list(self.node.settings.value.core.robot.wheels.names)
        self.odom = self.listen(Odometry, "odom")
        self.states = self.publisher(JointState, "wheel_states")
        self.position = np.zeros(4)

    def report(self):
        self.position = self.position + PERIOD * SPEEDS
        message = JointState(
            name=self.names, position=self.position.tolist(), velocity=SPEEDS.tolist()
        )
        message.header.stamp = self.stamp()
        self.states.publish(message)

    def turn(self, seconds):
        self.run(seconds, self.report)

    @property
    def warnings(self):
        return self.node.warning_counts.get("wheel_states", 0)


@pytest.fixture
def wheels():
    with Wheels() as wheels:
        yield wheels


def values(message):
    """Return all numbers of an odometry or coupling error, and its frames."""
    if isinstance(message, JointState):
        return [*message.position, *message.velocity]
    p, t = message.pose.pose, message.twist.twist
    return [
        *(p.position.x, p.position.y, p.orientation.z, p.orientation.w),
        *(t.linear.x, t.linear.y, t.angular.z),
        *message.pose.covariance,
        *message.twist.covariance,
    ]


def instant(message):
    return message.header.stamp.sec, message.header.stamp.nanosec


# ---- beside the controller ----------------------------------------------------------------------


APART = ["--ros-args", "-r", "odom:=apart/odom", "-r", "coupling_error:=apart/coupling_error"]


@pytest.mark.parametrize("dead", [exhaustive(""), "rear_left"])
def test_odometry_of_a_simulated_drive_is_that_of_the_controller(dead):
    parameters = {"odom_rate": 200.0, "monitor_rate": 200.0}
    if dead:
        parameters |= {"drive.dead": [dead]}
    apart = partial(OdometryNode, cli_args=APART)
    with World(SimulatedDriveNode, PlatformControllerNode, apart, parameters=parameters) as world:
        pairs = [
            (world.listen(kind, topic), world.listen(kind, f"apart/{topic}"))
            for kind, topic in ((Odometry, "odom"), (JointState, "coupling_error"))
        ]
        cmd_vel = world.publisher(Twist, "cmd_vel")
        node = world.nodes[2]
        world.run_until(lambda: len(node.core.idle) == bool(dead), 1.0, "the health of the wheels")
        for command in ((0.3, 0.1, 0.2), (-0.2, 0.2, -0.3)):
            world.run(1.0, lambda command=command: cmd_vel.publish(twist(*command)))
        for of_controller, of_node in pairs:
            known = {instant(message): message for message in of_controller}
            common = [m for m in of_node if instant(m) in known]
            assert len(common) > 300
            for message in common:
                other = known[instant(message)]
                assert values(message) == pytest.approx(values(other), rel=1e-9, abs=1e-9)
                assert message.header.frame_id == other.header.frame_id
        assert math.hypot(last(pairs[0][1]).pose.pose.position.x) > 0.01


def test_controller_leaves_the_topics_to_the_node_by_parameter():
    with World(
        SimulatedDriveNode,
        PlatformControllerNode,
        OdometryNode,
        parameters={"publish_odom": False},
    ) as world:
        for topic in ("odom", "coupling_error"):
            assert world.probe.count_publishers(topic) == 1
        ours = {p.topic_name for p in world.nodes[1].publishers}
        assert not ours & {"/odom", "/tf", "/coupling_error"} and "/wheel_health" in ours
        cmd_vel = world.publisher(Twist, "cmd_vel")
        odom = world.listen(Odometry, "odom")
        world.run(1.0, lambda: cmd_vel.publish(twist(0.3)))
        own = world.nodes[1].core.odometry.pose
        assert last(odom).pose.pose.position.x == pytest.approx(own[0], abs=0.01)
        assert own[0] > 0.05


# ---- topics -------------------------------------------------------------------------------------


def test_topics_are_published_at_100_and_50_hz_with_the_stamps_of_the_reports(wheels):
    coupling = wheels.listen(JointState, "coupling_error")
    stamps = []

    def report():
        wheels.report()
        stamps.append(wheels.stamp())

    wheels.turn(0.1)
    before = len(wheels.odom), len(coupling)
    wheels.run(1.0, report)
    counts = len(wheels.odom) - before[0], len(coupling) - before[1]
    assert counts == pytest.approx((100, 50), abs=1)
    assert last(wheels.odom).header.stamp in stamps
    assert list(last(coupling).name) == ["constraint_1", "constraint_1_total"]


def test_nothing_is_published_without_reports(wheels):
    wheels.turn(0.2)
    wheels.run(2 * PERIOD)
    count = len(wheels.odom)
    wheels.run(1.0)
    assert len(wheels.odom) == count > 0
    level, message, _ = wheels.node.status()
    assert (level, message) == (DiagnosticStatus.WARN, "no wheel_states any more")


def test_set_pose_and_reset_odometry_set_the_pose(wheels):
    publisher = wheels.publisher(PoseWithCovarianceStamped, "set_pose")
    message = PoseWithCovarianceStamped()
    message.header.frame_id = "odom"
    message.pose.pose.position.x = 2.0
    message.pose.covariance[0] = message.pose.covariance[7] = 0.25
    publisher.publish(message)
    wheels.run(0.1)
    assert wheels.core.odometry.pose == (2.0, 0.0, 0.0)
    assert np.diag(wheels.core.odometry.covariance) == pytest.approx([0.25, 0.25, 0.0])
    message.header.frame_id, message.pose.pose.position.x = "map", 5.0
    publisher.publish(message)
    wheels.run(0.1)
    assert wheels.core.odometry.pose == (2.0, 0.0, 0.0), "map differs from odom here"
    message.header.frame_id, message.header.stamp = "odom", wheels.stamp(3600.0)
    publisher.publish(message)
    wheels.run(0.1)
    assert wheels.core.odometry.pose == (2.0, 0.0, 0.0), "the stamp is far ahead"
    assert wheels.call(Trigger, "odometry/reset_odometry").success
    assert wheels.core.odometry.pose == (0.0, 0.0, 0.0)


def test_idle_wheels_are_left_out_and_come_back(wheels):
    health = wheels.publisher(DiagnosticStatus, "wheel_health", LATCHED)
    for state, idle in (("idle", (2,)), ("dead", ()), ("idle", (2,)), ("driving", ())):
        value = KeyValue(key="rear_left", value=state)
        health.publish(DiagnosticStatus(values=[value]))
        wheels.run(PERIOD)
        assert wheels.core.idle == idle, state
    everything = [KeyValue(key=name, value="idle") for name in wheels.names]
    health.publish(DiagnosticStatus(values=everything))
    wheels.run(PERIOD)
    assert wheels.core.idle == () and wheels.node.warning_counts["wheel_health"] == 1


def test_after_a_restart_of_a_drive_a_gap_adds_to_the_covariance(wheels):
    """Over a gap, positions tell the motion, unless a drive has restarted meanwhile."""
    restarts = wheels.publisher(UInt32MultiArray, "wheel_restarts", LATCHED)
    grown = []
    for counts in ([0, 0, 0, 0], [0, 0, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0]):
        restarts.publish(UInt32MultiArray(data=counts))
        wheels.turn(0.3)
        before = wheels.core.odometry.covariance[0, 0]
        wheels.run(MAX_GAP + PERIOD)
        wheels.turn(PERIOD)
        grown.append(wheels.core.odometry.covariance[0, 0] - before > 1e-3)
    assert grown == [False, False, True, False]
    restarts.publish(UInt32MultiArray(data=[0, 1]))
    wheels.run(PERIOD)
    assert wheels.node.warning_counts["wheel_restarts"] == 1


# ---- invalid input and time ---------------------------------------------------------------------


def test_a_report_whose_positions_wrapped_is_used_and_not_said_to_be_unused(wheels):
    said = []
    wheels.node.warn = lambda subject, text: said.append(text)
    wheels.turn(0.3)
    wheels.position = wheels.position - 2.0 * math.pi
    wheels.turn(0.1)
    [warning] = said
    assert warning.startswith("wheel_states: positions jumped (encoder_span, if they wrap around)")


# ---- parameters ---------------------------------------------------------------------------------


@pytest.mark.parametrize("publish", [True, False])
def test_publish_tf_decides_on_the_transform(publish):
    with tf_installed(), Wheels() as wheels:
        wheels.listen(tf_messages.TFMessage, tf_messages.TOPIC)
        (result,) = wheels.node.set_parameters([Parameter("publish_tf", value=publish)])
        assert result.successful
        wheels.turn(0.2)
        sent, odom = wheels.received[tf_messages.TOPIC], last(wheels.odom)
    assert bool(sent) is publish
    if sent:
        (transform,) = last(sent).transforms
        assert transform == odometry_transform(odom)
        assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base_link")


@pytest.mark.parametrize(
    ("name", "value", "read", "expected"),
    [
        ("odom_rate", 20.0, lambda w: len(w.odom), 20),
        ("odom_frame", "world", lambda w: last(w.odom).header.frame_id, "world"),
        ("base_frame", "foot", lambda w: last(w.odom).child_frame_id, "foot"),
        ("twist_variance", 0.5, lambda w: last(w.odom).twist.covariance[0], 0.5),
        ("monitor_rate", 10.0, lambda w: len(w.received["coupling_error"]), 10),
    ],
)
def test_each_parameter_of_the_topics_has_an_effect(name, value, read, expected):
    for parameters, is_expected in (({name: value}, True), ({}, False)):
        with Wheels(parameters) as wheels:
            wheels.listen(JointState, "coupling_error")
            wheels.turn(1.0)
            found = read(wheels)
            if name.endswith("rate"):
                found = pytest.approx(found, abs=1)
            assert bool(found == expected) is is_expected


def test_map_counts_as_odom_by_parameter():
    with Wheels({"map_is_odom": True}) as wheels:
        publisher = wheels.publisher(PoseWithCovarianceStamped, "set_pose")
        message = PoseWithCovarianceStamped()
        message.header.frame_id = "map"
        message.pose.pose.position.y = 3.0
        publisher.publish(message)
        wheels.run(0.1)
        assert wheels.core.odometry.pose == (0.0, 3.0, 0.0)
