"""The node `station_keeper` over real topics, on simulated time."""

import math

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.motion.station.keeper import StationState
from omniman_ros.nodes.station_keeper import StationKeeperNode
from omniman_ros.nodes.stop_interface import LATCHED
from test.nodes.harness import PERIOD, World
from test.tiers import representative

OFFSET = (0.0, -1.3, 0.0)
SPEED = 0.3


def station(x, y, heading, frame="base_link"):
    message = PoseStamped()
    message.header.frame_id = frame
    message.pose.position.x, message.pose.position.y = x, y
    message.pose.orientation = quaternion_from_yaw(heading)
    return message


def stamped(message):
    message.header.stamp.sec = 2**31 - 1
    return message


def odometry(x, y, heading, forward=0.0):
    message = Odometry(child_frame_id="base_link")
    message.header.frame_id = "odom"
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    message.pose.pose.orientation = quaternion_from_yaw(heading)
    message.twist.twist.linear.x = forward
    return message


class Follower(World):
    """The node with a robot that follows its references exactly, and a leader.

    Attributes:
        node: The node.
        references: Previews that it has sent.
        is_led: Whether the leader's odometry is published.
    """

    def __init__(self, **parameters):
        super().__init__(StationKeeperNode, parameters=parameters)
        (self.node,) = self.nodes
        self.core = self.node.core
        self.references = self.listen(MultiDOFJointTrajectory, "station/reference")
        self.sources = self.publisher(String, "active_source", LATCHED)
        self.odom = self.publisher(Odometry, "odom")
        self.leader = self.publisher(Odometry, "leader/odom")
        self.stations = self.publisher(PoseStamped, "station")
        self.place, self.led_x, self.is_led, self.ticks = (-1.0, -2.0, 0.0), 0.0, True, 0
        self.hooks.append(self.report)
        self.drive("none")

    def drive(self, source):
        self.sources.publish(String(data=source))

    def report(self):
        """Publish both odometries at 100 Hz, the robot where its reference has it."""
        self.ticks += 1
        if self.ticks % 2:
            return
        if self.references and self.core.state is not StationState.IDLE:
            point = self.references[-1].points[0]
            t, r = point.transforms[0].translation, point.transforms[0].rotation
            self.place = (t.x, t.y, 2.0 * math.atan2(r.z, r.w))
        self.odom.publish(self.stamped(odometry(*self.place)))
        self.led_x += 2.0 * PERIOD * SPEED
        if self.is_led:
            self.leader.publish(self.stamped(odometry(self.led_x, 0.0, 0.0, SPEED)))

    def stamped(self, message):
        message.header.stamp = self.stamp()
        return message

    def keep(self):
        """Send a station, and wait until it is kept."""
        self.run(0.1)
        self.stations.publish(station(*OFFSET))
        self.run_until(lambda: bool(self.references), 0.5, "the first preview")
        self.drive("station")
        self.run_until(lambda: self.core.state is StationState.KEEPING, 10.0, "the station")
        return self

    def rest(self):
        """Wait until the node has brought the robot to rest, and return the number of previews."""
        self.run_until(lambda: self.core.state is StationState.IDLE, 2.0, "rest")
        assert velocity(self.references[-1].points[-1]) == (0.0, 0.0, 0.0)
        self.drive("none")
        return len(self.references)

    def assert_given_up(self, why):
        """Assert that nothing is sent any more, and that the diagnostics say why."""
        count = len(self.references)
        self.run(1.0)
        level, text, _ = self.node.status()
        assert len(self.references) == count and self.core.state is StationState.IDLE
        assert level == DiagnosticStatus.WARN and why in text


def velocity(point):
    twist = point.velocities[0]
    return twist.linear.x, twist.linear.y, twist.angular.z


@pytest.fixture
def follower():
    with Follower() as follower:
        yield follower


# ---- requests -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "message",
    [
        station(math.nan, 0.0, 0.0),
        station(0.0, math.inf, 0.0),
        station(0.0, -1.3, 0.0, "odom"),
        station(0.0, -1.3, 0.0, ""),
        station(20.0, 0.0, 0.0),
        stamped(station(*OFFSET)),
        PoseStamped(),
    ],
)
def test_a_station_that_cannot_be_used_moves_nothing_and_is_reported(follower, message):
    follower.run(0.1)
    follower.stations.publish(message)
    follower.run(0.5)
    assert not follower.references and follower.core.state is StationState.IDLE
    assert sum(follower.node.warning_counts.values()) == 1


@pytest.mark.parametrize("source", ["cmd_vel", "path", "mpc", "stop"])
def test_a_station_is_refused_while_something_else_drives(follower, source):
    follower.drive(source)
    follower.run(0.1)
    follower.stations.publish(station(*OFFSET))
    follower.run(1.1)  # a motion of another source may pass
    follower.drive("none")
    follower.run(0.5)
    assert not follower.references
    assert follower.node.warning_counts == {"station refused": 1}


def test_cancel_brings_the_robot_to_rest_beside_a_leader_that_drives_on(follower):
    follower.keep()
    assert follower.call(Trigger, "station_keeper/cancel").success
    count = follower.rest()
    follower.run(1.0)
    assert len(follower.references) == count
    assert follower.node.status()[0] == DiagnosticStatus.OK
    assert not follower.call(Trigger, "station_keeper/cancel").success


def test_shutdown_brings_the_robot_to_rest_and_refuses_stations(follower):
    follower.keep()
    follower.node.begin_shutdown("SIGINT")
    assert not follower.node.finished
    begin = follower.time
    follower.rest()
    assert follower.node.finished and follower.time - begin < follower.node.stop_timeout
    follower.stations.publish(station(*OFFSET))
    follower.run(0.5)
    assert follower.core.state is StationState.IDLE
    assert follower.node.warning_counts == {"station": 1}


# ---- leaders that fail --------------------------------------------------------------------------


def spoiled(world, field):
    message = world.stamped(odometry(world.led_x, 0.0, 0.0, SPEED))
    if field == "frame":
        message.header.frame_id = "map"
    elif field == "quaternion":
        message.pose.pose.orientation.w = 0.0
    elif field == "twist":
        message.twist.twist.linear.x = math.nan
    elif field == "ahead":
        message.header.stamp = world.stamp(1.0)
    else:
        message.pose.pose.position.x = math.inf
    return message


@pytest.mark.parametrize(
    "fault",
    representative(["silent", "frame", "quaternion", "twist", "position", "ahead"], every=4),
)
def test_a_leader_without_usable_odometry_lets_the_robot_brake_until_it_is_back(follower, fault):
    follower.keep().is_led = False

    def send():
        if fault != "silent":
            follower.leader.publish(spoiled(follower, fault))

    follower.run(1.5, send)
    assert follower.core.state is StationState.WAITING
    assert velocity(follower.references[-1].points[0]) == (0.0, 0.0, 0.0)
    assert follower.node.status()[0] == DiagnosticStatus.WARN
    follower.is_led = True
    follower.run_until(lambda: follower.core.state is StationState.KEEPING, 5.0, "the station")


# ---- the own robot ------------------------------------------------------------------------------


@pytest.mark.parametrize("source", ["none", "cmd_vel", "stop"])
def test_a_controller_that_no_longer_follows_ends_station_keeping(follower, source):
    follower.keep().drive(source)
    follower.run(0.02)
    follower.assert_given_up(
        {"none": "cancelled", "cmd_vel": "cmd_vel drives"}.get(source, "stop")
    )


def test_an_emergency_stop_ends_station_keeping_for_good(follower):
    follower.keep()
    emergency = follower.publisher(Bool, "emergency_stop")
    emergency.publish(Bool(data=True))
    follower.run(0.02)
    follower.assert_given_up("emergency_stop")
    emergency.publish(Bool(data=False))
    follower.assert_given_up("emergency_stop")


def test_silence_of_its_own_odometry_brings_the_robot_to_rest(follower):
    follower.keep().hooks.clear()

    def lead():
        follower.led_x += PERIOD * SPEED
        follower.leader.publish(follower.stamped(odometry(follower.led_x, 0.0, 0.0, SPEED)))

    follower.run(1.0, lead)
    assert velocity(follower.references[-1].points[-1]) == (0.0, 0.0, 0.0)
    follower.run(0.5, lead)
    follower.assert_given_up("no odom")


def test_time_that_goes_back_ends_station_keeping(follower):
    follower.keep().time -= 5.0
    follower.run(0.1)
    follower.assert_given_up("time went back")


def test_a_hold_up_of_the_node_longer_than_its_preview_ends_station_keeping(follower):
    follower.keep().time += 1.0
    follower.run(0.1)
    follower.assert_given_up("no preview was sent in time")


def test_limits_can_be_changed_while_the_robot_keeps_its_station(follower):
    follower.keep()
    change = [Parameter("station.linear_velocity", value=0.2)]
    assert follower.node.set_parameters(change)[0].successful
    follower.run(1.0)
    assert velocity(follower.references[-1].points[-1])[0] == pytest.approx(0.2, abs=1e-6)
    assert not follower.node.set_parameters([Parameter("station.gain", value=-1.0)])[0].successful


# ---- two robots ---------------------------------------------------------------------------------
