"""Monitor, controller and simulated drive as nodes that share only their topics.

Contacts are judged by the true pose of the drive and the corners of the body, not by the geometry
that the monitor uses.
"""

import itertools
import math

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist, Vector3
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.conversions.headers import time_seconds
from omniman_ros.conversions.motion_limits import motion_limit_message
from omniman_ros.conversions.poses import path_message
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.nodes.collision_monitor import CollisionMonitorNode
from omniman_ros.nodes.path_interpolator.node import PathInterpolatorNode
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.simulated_drive import SimulatedDriveNode
from omniman_ros.nodes.stop_interface import LATCHED
from test.nodes.harness import PERIOD, World, last
from test.nodes.rig import twist
from test.nodes.transforms import Transforms, tf_installed

GAP = 0.02
USED = {"collision_monitor.use": True}
HALF = np.array([0.5, 0.35])


class Robot(World):
    """Monitor, controller and drive; posts are reported ten times a second."""

    def __init__(self, *others, posts=()):
        super().__init__(
            SimulatedDriveNode,
            PlatformControllerNode,
            CollisionMonitorNode,
            *others,
            parameters=USED,
        )
        self.drive, self.controller, self.monitor = self.nodes[:3]
        self.core = self.controller.core
        self.cmd_vel = self.publisher(Twist, "cmd_vel")
        self.markers = self.publisher(MarkerArray, "obstacles")
        self.states = self.listen(DiagnosticStatus, "collision_state", LATCHED)
        self.posts, self.velocities = np.array(posts, dtype=float).reshape(-1, 3), None
        self.gaps, self.twists = [], []
        self._ticks = itertools.count()
        self.hooks.append(self._each_period)
        self.run(0.3)

    def _each_period(self):
        if self.velocities is not None:
            self.posts[:, :2] += PERIOD * self.velocities
        if next(self._ticks) % 20 == 0:
            self.markers.publish(MarkerArray(markers=[self.marker(i) for i in range(self.count)]))
        self.gaps.append(self.gap())
        self.twists.append(self.core.setpoint)

    @property
    def count(self):
        return len(self.posts)

    def marker(self, i):
        x, y, radius = self.posts[i].tolist()
        marker = Marker(ns="post", id=i, type=Marker.CYLINDER, action=Marker.ADD)
        marker.header.frame_id, marker.header.stamp = "odom", self.stamp()
        marker.pose.position.x, marker.pose.position.y = x, y
        marker.scale.x = marker.scale.y = 2.0 * radius
        marker.lifetime = Duration(sec=1)
        return marker

    def true_pose(self):
        return self.drive.drives.ground_truth()[0]

    def gap(self):
        """Return the distance of the true body from the nearest post [m]."""
        if not self.count:
            return math.inf
        x, y, theta = self.true_pose()
        c, s = math.cos(theta), math.sin(theta)
        offset = self.posts[:, :2] - (x, y)
        local = np.abs(offset @ np.array([[c, -s], [s, c]]))
        return float(
            (np.linalg.norm(np.maximum(local - HALF, 0), axis=1) - self.posts[:, 2]).min()
        )

    def go(self, x, y=0.0, turn=0.0, seconds=1.0):
        self.run(seconds, lambda: self.cmd_vel.publish(twist(x, y, turn)))

    def speed(self):
        return float(np.linalg.norm(self.core.setpoint))

    def state(self):
        return {item.key: item.value for item in last(self.states).values}

    def assert_decelerates_within_limits(self):
        limits = self.core.parameters.limits
        for before, after in itertools.pairwise(self.twists):
            fall = np.linalg.norm(before[:2]) - np.linalg.norm(after[:2])
            assert fall <= limits.linear_deceleration * PERIOD + 1e-9
            assert abs(before[2]) - abs(after[2]) <= limits.angular_deceleration * PERIOD + 1e-9


def test_teleop_stops_before_a_post_and_drives_away_from_it():
    with Robot(posts=[(0.95, 0.1, 0.2)]) as world:
        world.go(0.5, seconds=1.2)
        assert world.state()["part"] == "platform"
        assert world.state()["obstacle"] == "obstacle post 0"
        assert GAP <= min(world.gaps) <= world.gaps[-1] < 0.15
        assert world.speed() < 0.1
        world.assert_decelerates_within_limits()
        start = world.true_pose()
        world.go(-0.5, seconds=0.5)
        assert world.true_pose()[0] < start[0] - 0.05
        assert world.state()["state"] == "free"


def test_wheels_slow_down_within_35_ms_of_an_observation_at_every_phase_of_the_monitor():
    """What a limit takes to compute comes on top: up to 24 ms, together below 60 ms."""
    with Robot() as world:
        commands = world.listen(JointState, "wheel_commands")
        limit_periods = round(1.0 / (world.monitor.settings.value.rate * PERIOD))
        delays = []
        for phase in range(limit_periods):
            while world.core.setpoint[0] < 0.3:
                world.go(0.3, seconds=PERIOD)
            world.go(0.3, seconds=0.05 + phase * PERIOD)
            assert world.core.setpoint[0] == 0.3
            x, y, _ = world.true_pose()
            world.posts = np.array([(x + HALF[0] + 0.35, y, 0.1)])
            world.markers.publish(MarkerArray(markers=[world.marker(0)]))
            observed = world.time
            while world.core.setpoint[0] == 0.3:
                world.go(0.3, seconds=PERIOD)
            delays.append(round(time_seconds(last(commands).header.stamp) - observed, 6))
            world.posts = np.zeros((0, 3))
            world.markers.publish(
                MarkerArray(markers=[Marker(ns="post", id=0, action=Marker.DELETE)])
            )
        assert len(set(delays)) > 1, "the phase matters"
        assert max(delays) <= 0.035, delays


def test_a_silent_monitor_stops_the_robot_and_a_returning_one_lets_it_go_on():
    with Robot() as world:
        world.go(0.5, seconds=0.8)
        assert world.speed() > 0.3
        world.monitor._limits.publish = lambda message: None
        world.twists.clear()
        world.go(0.5, seconds=0.9)
        assert world.speed() == 0.0
        assert world.core.latch.released
        assert "motion_limit" in world.controller.status()[1]
        world.assert_decelerates_within_limits()
        del world.monitor._limits.publish
        world.go(0.5, seconds=0.3)
        assert world.speed() > 0.05


def test_a_second_publisher_cannot_loosen_the_limit():
    with Robot(PathInterpolatorNode, posts=[(0.95, 0.1, 0.2)]) as world:
        other = world.publisher(JointState, "motion_limit")
        world.run(0.1)

        def loosen():
            other.publish(motion_limit_message(1.0, 1.0, world.stamp()))
            world.cmd_vel.publish(twist(0.5, 0.0, 0.0))

        world.run(1.2, loosen)
        assert min(world.gaps) >= GAP
        assert world.nodes[3].motions.limits.fractions[0] < 0.5
        assert "motion_limit has more than one publisher" in world.controller.status()[1]


class Watcher(World):
    """A monitor without a robot, which the test reports to."""

    def __init__(self):
        super().__init__(CollisionMonitorNode)
        self.limits = self.listen(JointState, "motion_limit")
        self.arm = self.publisher(JointState, "arm/joint_states")
        self.odom = self.publisher(Odometry, "odom")
        self.joints = JointState(name=list(UR_JOINTS), position=[0.0] * 6, velocity=[0.0] * 6)

    def measure_odom(self):
        message = Odometry()
        message.header.frame_id, message.header.stamp = "odom", self.stamp()
        message.pose.pose.orientation.w = 1.0
        self.odom.publish(message)

    def measure(self):
        self.measure_odom()
        self.joints.header.stamp = self.stamp()
        self.arm.publish(self.joints)

    @property
    def fractions(self):
        """Shares of platform and arm."""
        return list(last(self.limits).velocity)


def test_without_odometry_or_with_a_silent_arm_the_monitor_is_blind():
    with Watcher() as world:
        world.run(0.1)
        assert world.fractions == [0.1, 0.1]
        assert world.nodes[0].state.reason == "no odom"
        world.run(0.1, world.measure_odom)
        assert world.fractions == [1.0, 1.0]
        assert ("watches", "platform") in world.nodes[0].status()[2]
        world.run(0.1, world.measure)
        assert ("watches", "platform and arm") in world.nodes[0].status()[2]
        world.run(0.3, world.measure_odom)
        assert world.nodes[0].state.name == "blind"
        assert "arm/joint_states" in world.nodes[0].state.reason


def test_inputs_that_end_as_time_goes_back_leave_the_monitor_blind():
    with Watcher() as world:
        world.run(0.1, world.measure)
        assert world.fractions == [1.0, 1.0]
        world.time -= 60.0
        world.run(0.1)
        assert world.nodes[0].state.reason == "odom is inf s old; arm/joint_states are inf s old"
        world.run(0.1, world.measure)
        assert world.fractions == [1.0, 1.0]


UNUSABLE = {
    "a source that never sends": (MarkerArray, "obstacles", 10, None, "no obstacles yet from"),
    "obstacles in a frame that nothing relates to odom": (
        MarkerArray,
        "obstacles",
        10,
        MarkerArray(markers=[Marker(type=Marker.CYLINDER, scale=Vector3(x=1.0, y=1.0))]),
        "obstacles cannot be used: marker '' 0: it has frame ''",
    ),
    "a map in a frame that nothing relates to odom": (
        OccupancyGrid,
        "map",
        LATCHED,
        OccupancyGrid(),
        "map cannot be used: it has frame ''",
    ),
    "a volatile map": (
        OccupancyGrid,
        "map",
        10,
        None,
        "map of /probe cannot be received: its quality of service is volatile",
    ),
}


@pytest.mark.parametrize("case", UNUSABLE)
def test_what_is_published_and_not_got_in_usable_form_makes_the_monitor_blind(case):
    kind, topic, qos, message, reason = UNUSABLE[case]
    with Watcher() as world:
        logged = []
        world.nodes[0].warn = lambda subject, text: logged.append(text)
        world.run(1.2, world.measure)
        assert world.fractions == [1.0, 1.0], "nobody publishes: it has no sensors"
        publisher = world.probe.create_publisher(kind, topic, qos)
        if message is not None:
            world._await(lambda: publisher.get_subscription_count() > 0, "the monitor")
            publisher.publish(message)
        world.run(2.6, world.measure)
        assert world.fractions == [0.1, 0.1]
        assert world.nodes[0].state.name == "blind" and reason in world.nodes[0].state.reason
        assert any(f"the robot is blind: {topic}" in text or reason in text for text in logged)


def test_a_latched_map_is_used_once_its_transform_has_come():
    with tf_installed(), Watcher() as world:
        grid = strip_of_cells(100)
        grid.header.frame_id = "map"
        world.publisher(OccupancyGrid, "map", LATCHED).publish(grid)
        world.run(2.0, world.measure)
        assert "map cannot be used: " in world.nodes[0].state.reason
        Transforms(world).send("map", "odom", 0.0, 0.0, static=True)
        world.run(1.0, world.measure)
        assert world.nodes[0].state.name != "blind"
        assert len(world.nodes[0].inputs.surroundings()) == 1


def strip_of_cells(value: int) -> OccupancyGrid:
    """Return a map of 0.1 x 2 m ahead of the robot, from x = 0.7 m on, of cells with one value."""
    grid = OccupancyGrid(data=[value] * 80)
    grid.header.frame_id, grid.info.resolution = "odom", 0.05
    grid.info.width, grid.info.height, grid.info.origin.orientation.w = 2, 40, 1.0
    grid.info.origin.position.x, grid.info.origin.position.y = 0.7, -1.0
    return grid


def test_unknown_cells_of_the_kept_map_stop_the_robot_once_they_are_not_free():
    with Robot() as world:
        world.publisher(OccupancyGrid, "map", LATCHED).publish(strip_of_cells(-1))
        world.run(0.1)
        [result] = world.monitor.set_parameters([Parameter("map_unknown_is_free", value=False)])
        assert result.successful, result.reason
        world.go(1.0, seconds=1.0)
        assert world.state()["obstacle"] == "map"
        assert GAP < 0.7 - 0.5 - world.true_pose()[0] < 0.12


def test_a_map_stops_the_robot_and_unusable_messages_do_not_move_or_stop_it():
    with Robot() as world:
        world.publisher(OccupancyGrid, "map", LATCHED).publish(strip_of_cells(100))
        world.run(0.1)
        world.go(1.0, seconds=1.0)
        assert world.state()["obstacle"] == "map"
        assert GAP < 0.7 - 0.5 - world.true_pose()[0] < 0.12
        world.go(-1.0, seconds=0.2)
        limits = world.publisher(JointState, "motion_limit")
        demands = world.publisher(JointState, "motion_demand")
        for value in (math.nan, math.inf, -1.0, 2.0):
            limits.publish(JointState(name=["platform", "arm"], velocity=[value, 1.0]))
            demands.publish(JointState(name=["base_x"], velocity=[value]))
            limits.publish(JointState(name=["platform"], velocity=[0.0]))
            world.go(-1.0, seconds=0.02)
        assert world.core.motion_limit.fraction(world.time) == 1.0
        assert world.controller.warning_counts["motion_limit"] >= 4
        assert world.monitor.warning_counts["motion_demand"] >= 1


def test_a_path_waits_before_a_post_without_losing_its_reference_and_goes_on():
    with Robot(PathInterpolatorNode, posts=[(0.85, 0.1, 0.2)]) as world:
        interpolator = world.nodes[3].motions
        poses = np.array([(0.0, 0.0, 0.0), (0.3, 0.0, 0.0)])
        world.publisher(Path, "path").publish(path_message(poses, "odom"))
        world.run(1.5)
        assert min(world.gaps) >= GAP
        assert world.speed() < 0.05
        assert interpolator.path.core.state is PathState.FOLLOWING
        assert interpolator.time_base.pace.rate(world.time) < 0.3
        errors = np.linalg.norm(world.core.tracking_error[:2])
        assert errors < 0.02
        world.posts[:, 0] = 9.0
        world.run_until(lambda: interpolator.path.core.state is PathState.IDLE, 2.5, "arrival")
        assert world.true_pose()[0] == pytest.approx(0.3, abs=0.01)
        world.assert_decelerates_within_limits()
