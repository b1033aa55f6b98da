"""The tracker as a node: scans, odometry and TF in; obstacles, tracks and a map out."""

import math
from array import array

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.parameter import Parameter
from sensor_msgs.msg import LaserScan, PointCloud2, PointField
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.nodes.collision_monitor import CollisionMonitorNode
from omniman_ros.nodes.obstacle_tracker import ObstacleTrackerNode
from omniman_ros.nodes.stop_interface import LATCHED
from test.nodes.harness import World, last
from test.nodes.transforms import Transforms, tf_installed

BEAMS = 721
ANGLES = np.linspace(-math.pi / 2, math.pi / 2, BEAMS)
MOUNT = (0.55, 0.0)
GIVEN = {"scanners_by_tf": False}


def ranges_of(discs, pose=(0.0, 0.0, 0.0), mount=MOUNT, wall=4.0):
    """Distances along ANGLES to discs (x, y, radius) and to a wall at x, in odom."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    ox = pose[0] + c * mount[0] - s * mount[1]
    oy = pose[1] + s * mount[0] + c * mount[1]
    ux, uy = np.cos(ANGLES + pose[2]), np.sin(ANGLES + pose[2])
    with np.errstate(divide="ignore"):
        found = np.where(ux > 0.0, (wall - ox) / ux, math.inf)
    for x, y, radius in discs:
        along, aside = (x - ox) * ux + (y - oy) * uy, (x - ox) * uy - (y - oy) * ux
        inside = radius**2 - aside**2
        hit = np.where(inside > 0.0, along - np.sqrt(np.maximum(inside, 0.0)), math.inf)
        found = np.where((hit > 0.0) & (hit < found), hit, found)
    return np.where(found < 20.0, found, math.inf)


class Room(World):
    """A tracker, and a probe that sends scans 20 times and odometry 100 times a second."""

    def __init__(self, *others, parameters=GIVEN):
        super().__init__(ObstacleTrackerNode, *others, parameters=parameters)
        self.tracker = self.nodes[0]
        self.scans = self.publisher(LaserScan, "scan")
        self.odometry = self.publisher(Odometry, "odom")
        self.markers = self.listen(MarkerArray, "obstacles")
        self.clouds = self.listen(PointCloud2, "obstacle_tracks")
        self.maps = []
        self.probe.create_subscription(OccupancyGrid, "map", self.maps.append, LATCHED)
        self.pose, self.twist = [0.0, 0.0, 0.0], (0.0, 0.0, 0.0)
        self.rng, self.noise = np.random.default_rng(0), 0.005

    def scan(self, measured, **changes):
        noisy = measured + self.rng.normal(0.0, self.noise, BEAMS)
        message = LaserScan(
            angle_min=-math.pi / 2,
            angle_max=math.pi / 2,
            angle_increment=math.pi / (BEAMS - 1),
            range_min=0.05,
            range_max=20.0,
            ranges=array("f", noisy.astype(np.float32).tobytes()),
        )
        message.header.frame_id, message.header.stamp = "scanner", self.stamp()
        for name, value in changes.items():
            setattr(message, name, value)
        self.scans.publish(message)

    def send_odom(self):
        message = Odometry(child_frame_id="base_link")
        message.header.frame_id, message.header.stamp = "odom", self.stamp()
        message.pose.pose.position.x, message.pose.pose.position.y = self.pose[:2]
        message.pose.pose.orientation.z = math.sin(0.5 * self.pose[2])
        message.pose.pose.orientation.w = math.cos(0.5 * self.pose[2])
        twist = message.twist.twist
        twist.linear.x, twist.linear.y, twist.angular.z = self.twist
        self.odometry.publish(message)

    def watch(self, seconds, ranges):
        """Run; `ranges` maps time and pose to a scan's ranges, or to None."""
        begin = self.time
        for tick in range(round(seconds / 0.01)):
            self.send_odom()
            if tick % 5 == 0:
                seen = ranges(self.time - begin, self.pose)
                if seen is not None:
                    self.scan(seen)
            self.run(0.01)
            x, y, theta = self.pose
            vx, vy, rate = self.twist
            c, s = math.cos(theta), math.sin(theta)
            self.pose = [x + 0.01 * (c * vx - s * vy), y + 0.01 * (s * vx + c * vy)]
            self.pose.append(theta + 0.01 * rate)

    def placed(self):
        return [m for m in last(self.markers).markers if m.action == Marker.ADD]

    def cell(self, x, y):
        """Return the occupancy at a place in odom."""
        grid = last(self.maps)
        info = grid.info
        column = math.floor((x - info.origin.position.x) / info.resolution)
        row = math.floor((y - info.origin.position.y) / info.resolution)
        return grid.data[row * info.width + column]

    def status(self):
        return self.tracker.status()


def walker(t, pose):
    """A post, and somebody who walks to the left."""
    return ranges_of([(2.0, -1.0, 0.1), (2.5, -0.8 + 1.0 * t, 0.25)], pose)


def fields(cloud, k=0):
    values = np.frombuffer(cloud.data, dtype="<f4").reshape(cloud.width, -1)[k]
    return dict(zip([field.name for field in cloud.fields], values.tolist(), strict=True))


def test_somebody_who_walks_is_an_obstacle_and_what_stands_is_in_the_map():
    with Room() as room:
        room.watch(1.5, walker)
        (marker,) = room.placed()
        assert (marker.header.frame_id, marker.ns, marker.type) == (
            "odom",
            "tracked",
            Marker.CYLINDER,
        )
        assert marker.pose.position.x == pytest.approx(2.5, abs=0.03)
        assert marker.pose.position.y == pytest.approx(0.65, abs=0.03)
        assert marker.scale.x == pytest.approx(0.5, abs=0.06)
        assert marker.pose.position.z + 0.5 * marker.scale.z == pytest.approx(2.0)
        seen = fields(last(room.clouds))
        assert (seen["vx"], seen["vy"]) == pytest.approx((0.0, 1.0), abs=0.08)
        assert 0.0 < seen["velocity_variance"] < 0.05
        assert seen["id"] == marker.id
        assert last(room.maps).header.frame_id == "odom"
        assert room.cell(2.0 - 0.1, -1.0) > 65, "the post"
        assert room.cell(4.01, 2.0) > 65, "the wall"
        assert room.cell(1.5, 0.0) == 0 or room.cell(1.5, 0.0) < 20, "free space"
        assert room.cell(4.4, 2.0) == -1, "behind the wall"
        assert all(room.cell(2.5 - 0.25, y) < 50 for y in (0.0, 0.3, 0.65)), "who walks"
        assert room.status()[0] == DiagnosticStatus.OK


def test_the_mounting_comes_from_tf():
    with tf_installed(), Room(parameters={}) as room:
        room.watch(0.3, walker)
        assert not room.markers, "nobody says where the scanner is"
        transforms = Transforms(room)
        transforms.send("base_link", "scanner", *MOUNT, static=True)
        room.watch(1.5, walker)
        (marker,) = room.placed()
        assert marker.pose.position.x == pytest.approx(2.5, abs=0.03)


def test_a_scanner_that_hangs_upside_down_sees_the_same():
    with Room(parameters=GIVEN | {"scanners.upside_down": [True]}) as room:
        room.watch(1.5, lambda t, pose: walker(t, pose)[::-1])
        (marker,) = room.placed()
        assert marker.pose.position.x == pytest.approx(2.5, abs=0.03)
        assert marker.pose.position.y == pytest.approx(0.65, abs=0.03)
        assert room.cell(2.0 - 0.1, -1.0) > 65, "the post"
        assert room.cell(1.5, 0.0) < 20, "free space"
        assert room.cell(4.4, 2.0) == -1, "behind the wall"
        assert room.status()[0] == DiagnosticStatus.OK


def open_hall(t, pose):
    """One post in a hall in which most beams meet nothing, for which the scanner sends 0."""
    found = ranges_of([(2.0, -1.0, 0.4)], pose, wall=25.0)
    return np.where(np.isinf(found), 0.0, found)


def test_the_value_of_no_return_is_named_and_makes_an_open_hall_free():
    with Room() as room:
        room.noise = 0.0
        room.watch(0.6, open_hall)
        assert not room.markers
        assert "set scanners.no_return to zero" in room.status()[1]
        room.tracker.set_parameters([Parameter("scanners.no_return", value=["zero"])])
        room.watch(1.0, open_hall)
        assert room.status()[0] == DiagnosticStatus.OK
        assert room.cell(2.0, 1.0) < 20, "the hall"


STILL = ranges_of([(2.0, 0.0, 0.2)])
FAULTS = {
    "covered": lambda t, pose: np.full(BEAMS, 0.01),
    "frozen": lambda t, pose: STILL,
    "dirty": lambda t, pose: np.where(np.arange(BEAMS) % 3 == 0, math.inf, walker(t, pose)),
    "old": lambda t, pose: None,
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_scanner_that_does_not_see_silences_the_obstacles_and_says_why(fault):
    with Room() as room:
        room.noise = 0.0
        room.twist = (0.1, 0.0, 0.0)
        room.watch(0.6, walker)
        room.watch(0.5, FAULTS[fault])
        count = len(room.markers)
        room.watch(0.3, FAULTS[fault])
        assert len(room.markers) == count
        level, text, _ = room.status()
        assert level == DiagnosticStatus.WARN
        assert fault in text
        room.watch(0.2, walker)
        assert len(room.markers) > count
        assert room.status()[0] == DiagnosticStatus.OK


def test_the_collision_monitor_slows_down_by_the_tracker_alone():
    with Room(CollisionMonitorNode) as room:
        monitor = room.nodes[1]
        room.twist = (0.3, 0.0, 0.0)
        room.watch(1.0, lambda t, pose: ranges_of([], pose, wall=6.0))
        assert monitor.state.name == "free"
        room.watch(0.8, lambda t, pose: ranges_of([], pose, wall=1.3))
        assert monitor.state.name == "slowing", monitor.state
        assert "map" in monitor.state.reason


def test_odometry_that_jumps_begins_all_anew():
    with Room() as room:
        room.watch(1.0, walker)
        room.pose = [5.0, 0.0, 0.0]
        room.watch(0.05, lambda t, pose: None)
        assert room.tracker.core.count == 0
        assert not room.tracker.core.map.log_odds.any()


def cloud_of(room, heights, ranges):
    points = np.concatenate(
        [
            np.column_stack((ranges * np.cos(ANGLES), ranges * np.sin(ANGLES), np.full(BEAMS, z)))
            for z in heights
        ]
    )
    points = points[np.isfinite(points).all(axis=1)].astype("<f4")
    message = PointCloud2(height=1, width=len(points), point_step=12, is_dense=True)
    message.row_step = 12 * len(points)
    message.fields = [
        PointField(name=name, offset=4 * k, datatype=PointField.FLOAT32, count=1)
        for k, name in enumerate("xyz")
    ]
    message.data = array("B", points.tobytes())
    message.header.frame_id, message.header.stamp = "scanner", room.stamp()
    return message


def test_a_cloud_counts_between_two_heights():
    given = GIVEN | {"scanners.topic": ["points"], "scanners.kind": ["cloud"]}
    with World(ObstacleTrackerNode, parameters=given) as world:
        clouds = world.publisher(PointCloud2, "points")
        odometry = world.publisher(Odometry, "odom")
        markers = world.listen(MarkerArray, "obstacles")
        begin = world.time
        for tick in range(150):
            message = Odometry(child_frame_id="base_link")
            message.header.frame_id, message.header.stamp = "odom", world.stamp()
            odometry.publish(message)
            if tick % 5 == 0:
                ranges = walker(world.time - begin, (0.0, 0.0, 0.0))
                message = cloud_of(world, (0.2, 0.8), ranges)
                floor = cloud_of(world, (-0.2,), np.full(BEAMS, 1.0))
                message.data = message.data + floor.data
                message.width += floor.width
                message.row_step += floor.row_step
                clouds.publish(message)
            world.run(0.01)
        (marker,) = [m for m in last(markers).markers if m.action == Marker.ADD]
        assert marker.pose.position.y == pytest.approx(0.65, abs=0.04)


CORNER = 2.6  #: Edge of a wall along the way, behind which somebody may be [m]


def beside_a_corner(t, pose):
    """A hall 8 m deep with a wall of 1 m to the left of the way, which ends at a corner."""
    ox, oy = pose[0] + MOUNT[0], pose[1]
    far = ranges_of([], pose, wall=8.0)
    ux, uy = np.cos(ANGLES), np.sin(ANGLES)
    with np.errstate(divide="ignore", invalid="ignore"):
        side = np.where(np.abs(uy) > 0.0, (np.sign(uy) * 1.0 - oy) / uy, math.inf)
        x = ox + side * ux
    hidden = (uy < 0.0) | (x < CORNER)
    found = np.where(hidden & (side > 0.0), np.minimum(side, far), far)
    with np.errstate(divide="ignore", invalid="ignore"):
        end = np.where(uy > 0.0, (4.0 - oy) / uy, math.inf)
    return np.minimum(found, end)


def test_the_monitor_slows_down_before_a_corner_behind_which_nobody_is_seen():
    given = GIVEN | {"unseen.speed": 1.2, "unseen.use": True}
    with Room(CollisionMonitorNode, parameters=given) as room:
        monitor, states = room.nodes[1], []
        room.watch(0.4, beside_a_corner)
        room.hooks.append(lambda: states.append(monitor.state))
        room.twist = (0.5, 0.0, 0.0)
        room.watch(2.0, beside_a_corner)
        assert {state.name for state in states} == {"free", "slowing"}
        slowing = [state for state in states if state.reason]
        assert all("may step out at" in state.reason for state in slowing)
        assert min(state.limit.platform for state in slowing) < 0.7
        assert all(state.limit.arm == 1.0 for state in slowing)
        assert not monitor.warning_counts
        monitor.set_parameters([Parameter("unseen.use", value=False)])
        room.watch(0.1, beside_a_corner)
        assert monitor.state.name == "free"


def test_a_monitor_that_hears_nothing_of_the_unseen_is_blind():
    with Room(CollisionMonitorNode, parameters=GIVEN | {"unseen.use": True}) as room:
        room.watch(0.5, walker)
        state = room.nodes[1].state
        assert (state.name, state.reason) == ("blind", "no unseen")
        room.tracker.set_parameters([Parameter("unseen.speed", value=1.2)])
        room.watch(0.5, walker)
        assert room.nodes[1].state.name != "blind"
        room.watch(0.7, FAULTS["covered"])
        assert "unseen is" in room.nodes[1].state.reason
