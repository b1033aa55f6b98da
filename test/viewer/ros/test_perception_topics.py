"""Tests of what the viewer receives of scanners, tracker, collision monitor and physics world."""

import itertools
import math
from array import array
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import OccupancyGrid, Odometry
from sensor_msgs.msg import JointState, LaserScan, PointCloud2
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions.arm import joint_reference_message
from omniman_ros.conversions.maps import map_message
from omniman_ros.conversions.motion_limits import motion_limit_message
from omniman_ros.conversions.tracks import track_cloud
from omniman_ros.conversions.world import contacts_message
from omniman_ros.motion.axes import PLATFORM_AXES
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.perception.track import TrackedObstacle
from test.nodes.transforms import Transforms, tf_installed
from test.viewer.ros.fake_page import until, view

KNOWN = {"scanners.x": [0.5], "scanners.z": [0.2], "scanners_by_tf": False}


@pytest.fixture(scope="module")
def world():
    """Return a world whose robot is at (1, 2) and looks to the left."""
    with view(parameters=KNOWN) as made:
        made.run(0.1)
        odom = Odometry()
        odom.header.frame_id = "odom"
        odom.pose.pose.position.x, odom.pose.pose.position.y = 1.0, 2.0
        half = math.pi / 4
        odom.pose.pose.orientation.z, odom.pose.pose.orientation.w = math.sin(half), math.cos(half)
        made.publisher(Odometry, "odom").publish(odom)
        made.run_until(lambda: state(made).odom is not None, 1.0, "odom")
        yield made


def state(world):
    return world.nodes[-1].state


def seen(world):
    return state(world).perceived


def scan(ranges, frame="scanner"):
    message = LaserScan(
        angle_min=-1.0, angle_max=1.0, angle_increment=0.5, range_min=0.1, range_max=20.0
    )
    message.header.frame_id, message.ranges = frame, ranges
    return message


def test_a_scan_is_drawn_where_its_beams_ended(world):
    scans = world.publisher(LaserScan, "scan")
    scans.publish(scan([math.nan, math.inf, 3.0, 30.0, 0.01]))
    until(world, lambda: len(seen(world).scan.points) > 0, "the scan")
    assert seen(world).scan.points == pytest.approx(np.array([[1.0, 2.0 + 0.5 + 3.0, 0.2]]))


def grid(frame, cells=((0, 100, -1), (0, 0, 0))):
    occupancy = np.array(cells, dtype=np.int8)
    stamp = LaserScan().header.stamp
    return map_message(occupancy, 0.5, np.array([4.0, 5.0]), frame, stamp)


def test_a_map_follows_its_frame():
    with tf_installed(), view() as world:
        world.publisher(OccupancyGrid, "map", LATCHED).publish(grid("map"))
        world.run(0.3)
        assert seen(world).map is None, "nobody knows where the map is"
        transforms = Transforms(world)
        transforms.send("map", "odom", 1.0, 0.0)
        until(world, lambda: seen(world).map is not None, "its transform")
        drawn = seen(world).map
        assert drawn.middle == pytest.approx((4.0 + 0.75 - 1.0, 5.5, 0.0))
        transforms.send("map", "odom", 0.0, 0.0, math.pi / 2)
        until(world, lambda: seen(world).map.middle != drawn.middle, "the correction")
        assert seen(world).map.middle == pytest.approx((5.5, -4.75, -math.pi / 2))
        assert seen(world).map.pixels is drawn.pixels, "only its place is sent again"


def test_a_map_in_odom_grows_on_the_page(world):
    maps = world.publisher(OccupancyGrid, "map", LATCHED)
    maps.publish(grid("odom"))
    until(world, lambda: seen(world).map is not None, "the map")
    first = seen(world).map
    maps.publish(grid("odom", ((0, 100, 0), (0, 0, 0))))
    until(world, lambda: seen(world).map is not first, "more of it")
    assert seen(world).map.pixels[0, 2, 3] == 255 and first.pixels[0, 2, 3] == 0


def tracks():
    person = TrackedObstacle(7, 0.0, (3.0, 1.0), (0.5, -0.5), 0.3, (0.04, 0.0, 0.01), 2.0, 0.0)
    return track_cloud([person], "odom", LaserScan().header.stamp)


def test_tracked_obstacles_are_drawn_with_their_uncertainty(world):
    world.publisher(PointCloud2, "obstacle_tracks").publish(tracks())
    until(world, lambda: len(seen(world).tracks) > 0, "the tracks")
    drawn = seen(world).tracks
    assert drawn.centers[0] == pytest.approx((3.0, 1.0))
    assert drawn.velocities[0] == pytest.approx((0.5, -0.5))
    assert (drawn.radii[0], drawn.position_deviations[0]) == pytest.approx((0.3, 0.2))
    assert drawn.velocity_deviations[0] == pytest.approx(0.1)


def contact(touches=True):
    made = SimpleNamespace(
        part="platform",
        element="crate",
        position=np.array([1.0, 2.0, 0.1]),
        force=np.array([3.0, 4.0, 0.0]),
        impulse=np.zeros(3),
        part_speed=0.1,
        element_speed=0.0,
        touches=touches,
    )
    return contacts_message([made], "odom", LaserScan().header.stamp)


def test_contacts_are_shown_until_they_end(world):
    contacts = world.publisher(DiagnosticArray, "contacts")
    contacts.publish(contact())
    until(world, lambda: bool(seen(world).contacts), "the contact")
    (shown,) = seen(world).contacts.values()
    assert shown.position.tolist() == [1.0, 2.0, 0.1] and shown.force == pytest.approx(5.0)
    contacts.publish(contact(touches=False))
    until(world, lambda: not seen(world).contacts, "its end")


def test_limits_of_the_speed_and_the_tip_over_margin_are_shown(world):
    limits, margins = (
        world.publisher(JointState, "motion_limit"),
        world.publisher(Float64, "tip_over_margin"),
    )
    limits.publish(motion_limit_message(0.25, 1.0, LaserScan().header.stamp))
    margins.publish(Float64(data=0.2))
    until(world, lambda: seen(world).speed_fractions and seen(world).tip_over_margin, "both")
    assert seen(world).speed_fractions == (0.25, 1.0)
    assert seen(world).tip_over_margin == 0.2


def broken_map():
    message = grid("odom")
    message.info.width = 4_000_000_000
    return message


def far_tracks():
    message = tracks()
    rows = np.frombuffer(bytes(message.data), dtype="<f4").copy()
    rows[0] = np.nan
    message.data = array("B", rows.tobytes())
    return message


def torn_contact():
    message = contact()
    message.status[0].values.pop(2)
    return message


def plan_message(names, *points):
    message = joint_reference_message(names, len(points), 0.5)
    message.header.frame_id = "odom"
    for point, axes in zip(message.points, points, strict=True):
        point.positions = axes
    return message


@pytest.mark.parametrize(
    ("kind", "topic", "message"),
    [
        (LaserScan, "scan", scan([1.0])),
        (OccupancyGrid, "map", broken_map()),
        (PointCloud2, "obstacle_tracks", far_tracks()),
        (PointCloud2, "obstacle_tracks", PointCloud2(header=scan([]).header)),
        (DiagnosticArray, "contacts", torn_contact()),
        (JointState, "motion_limit", JointState(name=["platform", "arm"], velocity=[2.0, 0.0])),
        (Float64, "tip_over_margin", Float64(data=math.inf)),
        (JointTrajectory, "body/plan", plan_message(PLATFORM_AXES, [5.0, 0.0, 0.0])),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_cannot_be_used_is_refused_with_a_warning(world, kind, topic, message):
    shown = (seen(world).map, seen(world).scan.version, seen(world).tracks)
    world.publisher(kind, topic, LATCHED).publish(message)
    counts = world.nodes[-1]._throttle.counts
    counts.clear()
    until(world, lambda: topic in counts, "the warning")
    world.run(0.05)
    assert seen(world).map is shown[0] and not seen(world).contacts and not seen(world).plan
    assert not len(seen(world).scan.points) or seen(world).scan.version == shown[1]
    assert not len(seen(world).tracks) or seen(world).tracks is shown[2]


def test_the_robots_shapes_are_computed_only_while_they_are_shown(world):
    assert seen(world).body is None
    world.nodes[-1].page.layers = frozenset({"shapes for distances"})
    world.run(0.1)
    body = seen(world).body
    assert len(body.radius) == 0, "the arm has not reported its joints"
    state(world).update_arm(np.array([0.0, -1.2, 1.6, -0.4, 1.2, 0.0]), world.time)
    world.run(0.1)
    assert len(seen(world).body.radius) > 6
    assert len(seen(world).body.footprint) > len(body.footprint)
    world.nodes[-1].page.layers = frozenset()
    world.run(0.1)
    assert seen(world).body is None


def test_the_plan_of_the_whole_body_is_shown_with_what_it_avoids_until_it_falls_silent(world):
    viewer = world.nodes[-1]
    viewer.state.obstacles = replace(
        viewer.state.obstacles,
        numbers=np.array([1]),
        centers=np.array([[9.0, 0.0]]),
        semi_axes=np.full((1, 2), 0.25),
        angles=np.zeros(1),
        velocities=np.array([[-4.0, 0.0]]),
    )
    names = [*viewer.settings.value.arm.joints, *PLATFORM_AXES]
    axes = [0.3, -1.2, 1.9, -2.2, -1.57, 0.0, 5.0, 0.0, 0.0]
    plans = world.publisher(JointTrajectory, "body/plan")
    plans.publish(plan_message(names, axes, [*axes[:6], 5.0, 1.0, 0.0]))
    until(world, lambda: seen(world).plan is not None, "the plan")
    plan = seen(world).plan
    assert plan.ghosts[:4].mean(axis=(0, 1))[:2] == pytest.approx([5.0, 1.0])
    place = plan.nearest.line[1, :2]
    assert math.dist(place, (7.0, 0.0)) == pytest.approx(0.25, abs=1e-3), "0.5 s later"
    until(world, lambda: seen(world).plan is None, "its end")


def test_what_is_received_in_a_cycle_is_not_newer_than_the_cycle(world, monkeypatch):
    viewer = world.nodes[-1]
    times = itertools.count(viewer.now(), 1e-4)
    monkeypatch.setattr(viewer, "now", lambda: next(times))  # real time passes within a cycle
    world.publisher(Float64, "tip_over_margin").publish(Float64(data=0.25))
    until(world, lambda: seen(world).tip_over_margin == 0.25, "the margin")
