import math
import re

import numpy as np
import pytest

from omniman_ros.control.odometry import Odometry, OdometryParameters
from omniman_ros.control.wheel_cascade import DriveMode, WheelCommand
from omniman_ros.core import rigid
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.core.transform_tree import Placement
from omniman_ros.motion.path.interpolator import Window
from omniman_ros.perception.track import TrackedObstacle
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.surroundings.obstacles import Observation, ObstacleParameters, ObstacleSet
from test.robots import kinematics
from test.work import calls

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import (
    Point,
    PoseStamped,
    PoseWithCovarianceStamped,
    Quaternion,
    Transform,
    Twist,
    TwistStamped,
)
from nav_msgs.msg import Odometry as OdometryMsg
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import (
    MultiDOFJointTrajectory,
    MultiDOFJointTrajectoryPoint,
)
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.conversions.geometry import (
    quaternion_from_yaw,
    stamped_twist_array,
    twist_array,
    yaw_from_quaternion,
)
from omniman_ros.conversions.headers import check_frame, is_stamped, time_seconds, within
from omniman_ros.conversions.joints import joint_arrays, require_array
from omniman_ros.conversions.obstacles import MarkerDeletion, ellipse_markers, marker_changes
from omniman_ros.conversions.odometry import (
    fill_odometry,
    initialize_odometry,
    odometry_transform,
)
from omniman_ros.conversions.poses import (
    goal_pose_from_message,
    goal_state_from_message,
    path_message,
    path_poses,
    planar_pose,
)
from omniman_ros.conversions.tracks import track_markers
from omniman_ros.conversions.trajectories import (
    PLATFORM_JOINT,
    fill_reference,
    preview_from_message,
    preview_message,
    reference_message,
)
from omniman_ros.conversions.wheels import (
    electrical_arrays,
    electrical_message,
    restarts_message,
    restarts_of_message,
    wheel_command_from_message,
)

NAMES = ("fl", "fr", "rl", "rr")
NAN, INF = math.nan, math.inf


def twist(x=0.0, y=0.0, z=0.0, rx=0.0, ry=0.0, rz=0.0):
    message = Twist()
    message.linear.x, message.linear.y, message.linear.z = x, y, z
    message.angular.x, message.angular.y, message.angular.z = rx, ry, rz
    return message


# ---- time, headings, frames -------------------------------------------------------------------


def test_stamps_and_durations_convert_to_seconds():
    assert time_seconds(Time(sec=3, nanosec=250_000_000)) == 3.25
    assert time_seconds(Duration(sec=-1, nanosec=500_000_000)) == -0.5
    assert time_seconds(Time()) == 0.0


def test_only_a_zero_stamp_states_no_time():
    assert not is_stamped(Time())
    assert is_stamped(Time(sec=0, nanosec=1)) and is_stamped(Time(sec=-1, nanosec=0))


@pytest.mark.parametrize("theta", [0, 0.1, -0.1, 1.5, 3.1, -3.1, math.pi, -math.pi, 4, -5, 40])
def test_yaw_of_a_quaternion_is_the_heading(theta):
    q = quaternion_from_yaw(theta)
    assert q.x == q.y == 0
    assert math.cos(yaw_from_quaternion(q)) == pytest.approx(math.cos(theta), abs=1e-12)
    assert math.sin(yaw_from_quaternion(q)) == pytest.approx(math.sin(theta), abs=1e-12)
    opposite = Quaternion(x=0.0, y=0.0, z=-q.z, w=-q.w)  # the same rotation
    assert math.cos(yaw_from_quaternion(opposite)) == pytest.approx(math.cos(theta), abs=1e-12)


def test_yaw_tolerates_rounding_errors():
    q = quaternion_from_yaw(1.0)
    rounded = Quaternion(x=0.0, y=0.0, z=round(q.z, 2), w=round(q.w, 2))
    assert yaw_from_quaternion(rounded) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("xyzw", "why"),
    [
        ((0, 0, 0, 0), "length 0,"),
        ((0, 0, 0, 2), "length 2,"),
        ((0, 0, 0, 1.051), "length 1.051,"),
        ((0, 0, 0, NAN), "length nan"),
        ((0, 0, INF, 1), "length inf"),
        ((NAN, 0, 0, 1), "length nan"),
        ((0.05, 0, 0, 1), "not about the vertical"),
        ((0, 1, 0, 0), "not about the vertical"),
    ],
)
def test_invalid_quaternion_is_rejected(xyzw, why):
    x, y, z, w = map(float, xyzw)
    with pytest.raises(InputError, match=why):
        yaw_from_quaternion(Quaternion(x=x, y=y, z=z, w=w))


def test_unexpected_frames_are_rejected():
    check_frame("odom", "odom")
    check_frame("/odom", "map", "odom")
    with pytest.raises(InputError, match="frame 'map', expected 'odom'"):
        check_frame("map", "odom")
    with pytest.raises(InputError, match="frame '', expected 'odom' or 'map'"):
        check_frame("", "odom", "map")


# ---- twists -----------------------------------------------------------------------------------


def test_twist_array_takes_the_planar_part():
    array = twist_array(twist(1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    assert array.shape == (3,)
    np.testing.assert_array_equal(array, [1, 2, 6])


@pytest.mark.parametrize("part", ["x", "y", "z", "rx", "ry", "rz"])
@pytest.mark.parametrize("value", [NAN, INF, -INF, 1e300])
def test_twist_with_any_non_finite_component_is_rejected(part, value):
    with pytest.raises(InputError, match="not finite"):
        twist_array(twist(**{part: value}))


@pytest.mark.parametrize(("frame", "fine"), [("base_link", True), ("", True), ("odom", False)])
def test_stamped_twist_must_be_in_the_base_frame(frame, fine):
    message = TwistStamped(twist=twist(0.5))
    message.header.frame_id = frame
    if fine:
        np.testing.assert_array_equal(stamped_twist_array(message, "base_link"), [0.5, 0, 0])
    else:
        with pytest.raises(InputError, match="frame 'odom'"):
            stamped_twist_array(message, "base_link")


# ---- joint states -----------------------------------------------------------------------------


def test_joints_are_returned_in_the_requested_order():
    message = JointState(
        name=["rr", "arm", "fl", "rl", "fr"],
        position=[4.0, 99.0, 1.0, 3.0, 2.0],
        effort=[0.4, 9.0, 0.1, 0.3, 0.2],
    )
    position, velocity, effort = joint_arrays(message, NAMES)
    np.testing.assert_array_equal(position, [1, 2, 3, 4])
    np.testing.assert_array_equal(effort, [0.1, 0.2, 0.3, 0.4])
    assert velocity is None


def test_joints_in_the_requested_order_are_passed_on():
    message = JointState(name=list(NAMES), velocity=[1.0, 2.0, 3.0, 4.0])
    position, velocity, effort = joint_arrays(message, NAMES)
    assert position is None
    assert effort is None
    assert velocity.dtype == float
    np.testing.assert_array_equal(velocity, [1, 2, 3, 4])


@pytest.mark.parametrize(
    ("names", "values", "why"),
    [
        (["fl", "fr", "rl"], [1.0] * 3, "no rr among the names fl, fr, rl"),
        ([], [], "no fl, fr, rl, rr"),
        ([], [1.0] * 4, "4 position values for 0 names"),
        (["fl", "fr", "rl", "rr"], [1.0] * 3, "3 position values for 4 names"),
        (["fl", "fr", "rl", "rr", "fl"], [1.0] * 5, "repeated"),
    ],
)
def test_inconsistent_joint_states_are_rejected(names, values, why):
    with pytest.raises(InputError, match=why):
        joint_arrays(JointState(name=names, position=values), NAMES)


def test_present_requires_plausible_content():
    np.testing.assert_array_equal(require_array(np.ones(2), 1.0, "x"), [1, 1])
    with pytest.raises(InputError, match="no volts"):
        require_array(None, 10.0, "volts")
    for bad in (NAN, INF, -11.0):
        with pytest.raises(InputError, match=r"volts .* not finite or beyond"):
            require_array(np.array([1.0, bad]), 10.0, "volts")


# ---- previews ---------------------------------------------------------------------------------


def trajectory(count=3, accelerations=True, frame="odom", joint="platform"):
    message = MultiDOFJointTrajectory(joint_names=[joint])
    message.header.frame_id = frame
    for i in range(count):
        transform = Transform(rotation=quaternion_from_yaw(0.1 * i))
        transform.translation.x = 0.5 * i
        point = MultiDOFJointTrajectoryPoint(
            transforms=[transform],
            velocities=[twist(0.5 + i, rz=0.1)],
            accelerations=[twist(y=1.0 * i)] if accelerations else [],
            time_from_start=Duration(sec=i, nanosec=500_000_000),
        )
        message.points.append(point)
    return message


def test_preview_times_are_the_stamp_plus_time_from_start():
    made = preview_from_message(trajectory(), 100.0, ["odom"])
    assert (made.start, made.end) == (100.5, 102.5)
    setpoint = made.sample(101.5)
    np.testing.assert_allclose(setpoint.pose, [0.5, 0, 0.1])
    np.testing.assert_allclose(setpoint.velocity, [1.5, 0, 0.1])
    np.testing.assert_allclose(setpoint.acceleration, [0, 1, 0], atol=1e-12)


def test_preview_may_lack_accelerations_and_use_another_allowed_frame():
    made = preview_from_message(trajectory(accelerations=False, frame="map"), 0, ["odom", "map"])
    np.testing.assert_allclose(made.sample(1.5).velocity, [1.5, 0, 0.1])


def spoiled(change):
    message = trajectory()
    change(message)
    return message


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda m: setattr(m.header, "frame_id", "map"), "frame 'map'"),
        (lambda m: setattr(m, "joint_names", ["base"]), "expected 'platform' alone"),
        (lambda m: setattr(m, "joint_names", []), "expected 'platform' alone"),
        (lambda m: setattr(m, "joint_names", ["platform", "arm"]), "expected 'platform' alone"),
        (lambda m: setattr(m, "points", []), "got 0"),
        (lambda m: setattr(m, "points", m.points * 2000), "at most 5000 are accepted"),
        (lambda m: setattr(m.points[1], "transforms", []), "point 1: expected one transform"),
        (lambda m: setattr(m.points[1], "velocities", []), "point 1: expected one transform"),
        (lambda m: setattr(m.points[1], "velocities", [Twist()] * 2), "point 1: expected"),
        (lambda m: setattr(m.points[1], "accelerations", []), "some points have an accel"),
        (lambda m: setattr(m.points[1], "accelerations", [Twist()] * 2), "2 accelerations"),
        (lambda m: setattr(m.points[1], "time_from_start", Duration()), "do not increase"),
        (lambda m: setattr(m.points[2].transforms[0].translation, "x", NAN), "position"),
        (lambda m: setattr(m.points[2].transforms[0].rotation, "w", 0.0), "quaternion"),
        (lambda m: setattr(m.points[2].transforms[0].rotation, "x", 0.1), "vertical"),
        (lambda m: setattr(m.points[2].velocities[0].linear, "y", INF), "not finite"),
        (lambda m: setattr(m.points[2].accelerations[0].angular, "z", NAN), "not finite"),
    ],
)
def test_invalid_preview_is_rejected(change, why):
    with pytest.raises(InputError, match=why):
        preview_from_message(spoiled(change), 0.0, ["odom"])


# ---- paths and the stream ---------------------------------------------------------------------


PATH = np.array([[1.0, 2.0, 0.5], [3.0, -4.0, -3.0], [3.0, -4.0, 3.0]])


def spoiled_path(change):
    message = path_message(PATH, "odom")
    change(message, message.poses[1])
    return message


@pytest.mark.parametrize("frame", ["odom", "/odom", "map"])
def test_path_poses_survive_a_round_trip(frame):
    message = path_message(PATH, frame)
    message.poses[2].header.frame_id = frame
    poses = path_poses(message, ("odom", "map"), headings=True)
    assert poses.shape == (3, 3) and poses == pytest.approx(PATH)


def test_empty_path_has_no_poses():
    assert path_poses(path_message(PATH[:0], "odom"), ("odom",), True).shape == (0, 3)


def test_unused_headings_are_not_checked():
    def spoil(path, stamped):
        stamped.pose.orientation = Quaternion(x=NAN, y=3.0, z=0.0, w=0.0)

    poses = path_poses(spoiled_path(spoil), ("odom",), headings=False)
    assert poses[:, :2] == pytest.approx(PATH[:, :2]) and not poses[:, 2].any()


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda p, s: setattr(p.header, "frame_id", "map"), "frame 'map', expected 'odom'"),
        (lambda p, s: setattr(p.header, "frame_id", ""), "frame '', expected 'odom'"),
        (lambda p, s: setattr(s.header, "frame_id", "base_link"), "frame 'base_link'"),
        (lambda p, s: setattr(s.pose.position, "x", NAN), "positions .*nan.* not finite"),
        (lambda p, s: setattr(s.pose.position, "y", -INF), "positions .*-inf.* not finite"),
        (lambda p, s: setattr(s.pose.position, "y", 2e6), "positions .*beyond"),
        (lambda p, s: setattr(s.pose.orientation, "w", 5.0), "pose 1: .*quaternion of length"),
        (lambda p, s: setattr(s.pose.orientation, "z", NAN), "pose 1: .*quaternion of length nan"),
        (
            lambda p, s: setattr(s.pose, "orientation", Quaternion(x=1.0, y=0.0, z=0.0, w=0.0)),
            "pose 1: .*a rotation that is not about the vertical",
        ),
    ],
)
def test_invalid_path_is_rejected(change, why):
    with pytest.raises(InputError, match=why):
        path_poses(spoiled_path(change), ("odom",), headings=True)


def test_reference_message_converts_back_to_the_preview_of_the_window():
    rng = np.random.default_rng(5)
    ticks = 0.008 * np.arange(6)
    window = Window(10.0 + ticks, *(rng.normal(size=(6, 3)) for _ in range(3)))
    message = reference_message("odom", 6, 0.008)
    fill_reference(message, Time(sec=10), window)
    preview = preview_from_message(message, 10.0, ("odom",))
    assert (preview.start, preview.end) == pytest.approx((10.0, 10.04))
    for i, now in enumerate(window.times[:-1]):
        setpoint = preview.sample(now + 1e-12)
        away = setpoint.pose - window.positions[i]
        away[2] = math.remainder(away[2], 2 * math.pi)
        assert away == pytest.approx([0, 0, 0], abs=1e-9)
        assert setpoint.velocity == pytest.approx(window.velocities[i], abs=1e-6)
        assert setpoint.acceleration == pytest.approx(window.accelerations[i], abs=1e-3)


def test_long_reference_has_exact_times():
    message = reference_message("odom", 300, 0.008)
    times = [time_seconds(point.time_from_start) for point in message.points]
    assert times == pytest.approx((0.008 * np.arange(300)).tolist(), abs=1e-12)


def test_reference_message_can_be_filled_repeatedly():
    message = reference_message("odom", 2, 0.008)
    for value in (1.0, 2.0):
        rows = np.full((2, 3), value)
        fill_reference(message, Time(sec=1), Window(np.zeros(2), rows, rows, rows))
    point = message.points[1]
    assert point.transforms[0].translation.x == point.velocities[0].angular.z == 2.0
    assert point.accelerations[0].linear.y == 2.0
    assert yaw_from_quaternion(point.transforms[0].rotation) == pytest.approx(2.0)


# ---- poses and odometry -----------------------------------------------------------------------


def pose_message():
    message = PoseWithCovarianceStamped()
    message.header.frame_id = "odom"
    message.pose.pose.position.x = 1.0
    message.pose.pose.position.y = -2.0
    message.pose.pose.orientation = quaternion_from_yaw(0.5)
    message.pose.covariance[:] = np.arange(36.0)
    return message


def test_planar_pose_consists_of_x_y_and_yaw():
    pose, spread = planar_pose(pose_message(), ["odom"])
    assert pose == pytest.approx((1, -2, 0.5))
    np.testing.assert_array_equal(spread, [[0, 1, 5], [6, 7, 11], [30, 31, 35]])


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda m: setattr(m.header, "frame_id", "map"), "frame 'map'"),
        (lambda m: setattr(m.pose.pose.position, "x", NAN), "not finite"),
        (lambda m: setattr(m.pose.pose.orientation, "z", INF), "quaternion"),
    ],
)
def test_invalid_pose_is_rejected(change, why):
    message = pose_message()
    change(message)
    with pytest.raises(InputError, match=why):
        planar_pose(message, ["odom"])


def moved_odometry():
    model = kinematics()
    odometry = Odometry(model, OdometryParameters())
    speeds = model.J @ np.array([0.5, 0.2, 0.3])
    for _ in range(5):
        odometry.update(speeds * 0.1, speeds, 0.1)
    return odometry


def write(message, odometry, stamp):
    fill_odometry(message, odometry.pose, odometry.twist, odometry.covariance, stamp)


def test_odometry_is_written_with_pose_twist_and_covariance():
    odometry, message = moved_odometry(), OdometryMsg(child_frame_id="base_link")
    message.header.frame_id = "odom"
    stamp = Time(sec=7, nanosec=9)
    initialize_odometry(message, 0.01)
    write(message, odometry, stamp)
    position = message.pose.pose.position
    assert (position.x, position.y, position.z) == (*odometry.pose[:2], 0.0)
    assert yaw_from_quaternion(message.pose.pose.orientation) == pytest.approx(odometry.pose[2])
    v, w = message.twist.twist.linear, message.twist.twist.angular
    assert (v.x, v.y, v.z, w.x, w.y) == pytest.approx((0.5, 0.2, 0, 0, 0))
    assert w.z == pytest.approx(0.3)
    assert message.header.stamp == stamp
    spread = np.array(message.pose.covariance).reshape(6, 6)
    np.testing.assert_array_equal(spread[np.ix_((0, 1, 5), (0, 1, 5))], odometry.covariance)
    unmeasured = np.diag([1e6] * 3)
    np.testing.assert_array_equal(spread[2:5, 2:5], unmeasured)
    assert not spread[[0, 1, 5], 2:5].any() and not spread[2:5, [0, 1, 5]].any()
    variances = [0.01, 0.01, 1e6, 1e6, 1e6, 0.01]
    assert list(message.twist.covariance) == np.diag(variances).ravel().tolist()


def test_odometry_pose_survives_a_round_trip():
    odometry, message = moved_odometry(), OdometryMsg()
    write(message, odometry, Time())
    back = PoseWithCovarianceStamped(pose=message.pose)
    back.header.frame_id = "odom"
    pose, spread = planar_pose(back, ["odom"])
    assert pose == pytest.approx(odometry.pose)
    np.testing.assert_array_equal(spread, odometry.covariance)


def test_transform_equals_the_odometry_pose():
    message = OdometryMsg(child_frame_id="base_link")
    message.header.frame_id = "odom"
    write(message, moved_odometry(), Time(sec=1))
    result = odometry_transform(message)
    assert (result.header, result.child_frame_id) == (message.header, "base_link")
    assert result.transform.translation.x == message.pose.pose.position.x
    assert result.transform.translation.y == message.pose.pose.position.y
    assert result.transform.rotation == message.pose.pose.orientation


# ---- commands ---------------------------------------------------------------------------------

COMMANDS = [
    WheelCommand(DriveMode.VELOCITY, np.arange(4.0), np.arange(4.0) + 10),
    WheelCommand(DriveMode.TORQUE, np.arange(4.0)),
    WheelCommand(DriveMode.VOLTAGE, np.arange(4.0)),
]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.mode.value)
def test_command_is_read_from_its_message(command):
    message = JointState(name=list(NAMES), effort=command.effort.tolist())
    if command.velocity is not None:
        message.velocity = command.velocity.tolist()
    back = wheel_command_from_message(message, NAMES, command.mode is DriveMode.VOLTAGE)
    assert back.mode is command.mode
    np.testing.assert_array_equal(back.effort, command.effort)
    if command.velocity is None:
        assert back.velocity is None
    else:
        np.testing.assert_array_equal(back.velocity, command.velocity)


def test_command_with_speeds_alone_has_no_feed_forward():
    message = JointState(name=list(NAMES), velocity=[1.0] * 4)
    command = wheel_command_from_message(message, NAMES, voltage=False)
    assert command.mode is DriveMode.VELOCITY
    np.testing.assert_array_equal(command.effort, np.zeros(4))


@pytest.mark.parametrize(
    ("content", "voltage", "why"),
    [
        ({}, False, "no velocity or effort"),
        ({"position": [1.0] * 4}, False, "no velocity or effort"),
        ({"velocity": [1.0] * 4}, True, "no effort"),
        ({"velocity": [NAN] * 4}, False, "velocity .* not finite"),
        ({"velocity": [1.0] * 4, "effort": [0.0, INF, 0.0, 0.0]}, False, "effort .* not finite"),
        ({"effort": [NAN] * 4}, True, "not finite"),
        ({"velocity": [1.0] * 3}, False, "3 velocity values"),
    ],
)
def test_invalid_command_is_rejected(content, voltage, why):
    with pytest.raises(InputError, match=why):
        wheel_command_from_message(JointState(name=list(NAMES), **content), NAMES, voltage)


def test_electrical_message_labels_its_dimensions():
    message = electrical_message(np.arange(12.0).reshape(4, 3))
    assert list(message.data) == list(range(12))
    wheel, value = message.layout.dim
    assert (wheel.label, wheel.size, wheel.stride) == ("wheel", 4, 12)
    assert (value.label, value.size, value.stride) == ("voltage,current,energy", 3, 3)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda m: setattr(m.layout.dim[0], "size", 3), r"sizes \[3, 3\]"),
        (lambda m: setattr(m.layout.dim[1], "size", 4), r"sizes \[4, 4\]"),
        (lambda m: setattr(m.layout, "data_offset", 1), "from number 1 on"),
        (lambda m: m.data.append(0.0), "13 numbers, expected 12"),
        (lambda m: setattr(m.layout.dim[1], "label", "current,voltage"), "columns"),
    ],
)
def test_electrical_state_that_contradicts_itself_is_refused(change, why):
    message = electrical_message(np.arange(12.0).reshape(4, 3))
    np.testing.assert_array_equal(electrical_arrays(message, 4)[0], [0.0, 3.0, 6.0, 9.0])
    change(message)
    with pytest.raises(InputError, match=why):
        electrical_arrays(message, 4)


def test_restarts_of_another_number_of_drives_are_refused():
    message = restarts_message([1, 2, 3, 4])
    assert restarts_of_message(message, 4) == (1, 2, 3, 4)
    message.layout.dim[0].size = 3
    with pytest.raises(InputError, match=r"4 values, sizes \[3\], 4 wheels"):
        restarts_of_message(message, 4)


# ---- obstacles --------------------------------------------------------------------------------

NOW = 50.0


def clock(stamp):
    """Return the seconds of a stamp, or now if zero; reject the future and ages over 60 s."""
    seconds = time_seconds(stamp)
    if seconds > 60.0:
        raise InputError(f"the stamp is {seconds - NOW:.3f} s ahead")
    return seconds or NOW


def marker(number=0, ns="people", action=Marker.ADD, **changes):
    made = Marker(ns=ns, id=number, action=action, type=Marker.CYLINDER)
    made.header.frame_id = "odom"
    made.pose.position.x, made.pose.position.y = 1.0 + number, -2.0
    made.pose.orientation = quaternion_from_yaw(0.4)
    made.scale.x, made.scale.y, made.scale.z = 1.0, 0.5, 1.8
    for name, value in changes.items():
        owner, _, field = name.rpartition("__")
        target = made
        for part in owner.split("__") if owner else ():
            target = getattr(target, part)
        setattr(target, field, value)
    return made


def changed(*markers, frames=("odom",)):
    return marker_changes(MarkerArray(markers=markers), within(*frames), clock)


def test_marker_converts_to_an_observation():
    (made,), complaints = changed(
        marker(
            7,
            header__stamp=Time(sec=49, nanosec=500_000_000),
            lifetime=Duration(sec=1, nanosec=250_000_000),
        )
    )
    assert complaints == []
    assert isinstance(made, Observation)
    assert (made.key, made.time, made.x, made.y) == (("people", 7), 49.5, 8.0, -2.0)
    assert made.angle == pytest.approx(0.4)
    assert (made.semi_axes, made.lifetime) == ((0.5, 0.25), 1.25)


def test_heights_of_a_marker_end_half_its_scale_from_its_position():
    (made,), _ = changed(marker(pose__position__z=1.2, scale__z=0.5))
    assert made.heights == pytest.approx((0.95, 1.45))
    (made,), _ = changed(marker(pose__position__z=1.2, scale__z=0.0))
    assert made.heights == (-INF, INF)


def test_velocity_of_a_marker_turns_with_its_frame():
    points = [Point(x=1.0, y=-0.5), Point(x=0.01, y=0.005, z=0.04)]
    (made,), complaints = changed(marker(points=points))
    assert complaints == []
    assert (made.velocity, made.velocity_deviation) == ((1.0, -0.5), pytest.approx(0.2))
    turned = Placement("map", rigid.Transform.of_planar((3.0, 0.0, math.pi / 2)))
    (made,), _ = marker_changes(
        MarkerArray(markers=[marker(points=points[:1])]), lambda header: turned, clock
    )
    assert (made.velocity, made.velocity_deviation) == (pytest.approx((0.5, 1.0)), 0.0)


def test_track_survives_a_round_trip_through_a_marker():
    track = TrackedObstacle(7, NOW, (1.0, 2.0), (0.4, -0.3), 0.25, (1e-3, 2e-3, 0.09), 3.0, 0.0)
    message = track_markers([track], [3], "odom", Time(sec=49), lifetime=0.5, height=1.8)
    (gone, back), complaints = changed(*message.markers)
    assert complaints == [] and gone == MarkerDeletion("tracked", 3)
    assert (back.x, back.y, *back.semi_axes) == (1.0, 2.0, 0.25, 0.25)
    assert (back.velocity, back.velocity_deviation) == ((0.4, -0.3), pytest.approx(0.3))


def test_spheres_other_allowed_frames_and_zero_stamps_are_accepted():
    made, complaints = changed(
        marker(type=Marker.SPHERE), marker(1, header__frame_id="/map"), frames=("odom", "map")
    )
    assert complaints == []
    assert [change.time for change in made] == [NOW, NOW]


def test_changes_keep_their_order():
    made, complaints = changed(
        marker(1),
        marker(2, action=Marker.DELETE),
        marker(action=Marker.DELETEALL, ns=""),
        marker(action=Marker.DELETEALL, ns="boxes"),
        marker(1, action=Marker.MODIFY),
    )
    assert complaints == []
    assert [change.key for change in (made[0], made[4])] == [("people", 1)] * 2
    assert made[1:4] == [
        MarkerDeletion("people", 2),
        MarkerDeletion("", None),
        MarkerDeletion("boxes", None),
    ]


def test_frame_shape_and_pose_of_a_deletion_are_ignored():
    bare = Marker(ns="people", id=3, action=Marker.DELETE, type=Marker.ARROW)
    bare.pose.position.x = NAN
    everything = Marker(action=Marker.DELETEALL)
    made, complaints = changed(bare, everything)
    assert complaints == []
    assert made == [MarkerDeletion("people", 3), MarkerDeletion("")]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"scale__x": 0.0}, r"scale \(0.0, 0.5\) m"),
        ({"scale__y": -0.5}, r"scale \(1.0, -0.5\) m"),
        ({"scale__x": NAN}, r"scale \(nan, 0.5\) m"),
        ({"scale__x": INF}, r"semi-axes \(inf, 0.25\) m"),
        ({"scale__x": 1e-3}, "semi-axes .*above 0.001"),
        ({"scale__x": 200.0}, "semi-axes .*below 100"),
        ({"header__frame_id": "map"}, "frame 'map', expected 'odom'"),
        ({"header__frame_id": ""}, "frame '', expected 'odom'"),
        ({"type": Marker.CUBE}, "type 1, expected CYLINDER or SPHERE"),
        ({"action": 1}, "action 1, expected ADD"),
        ({"action": -7}, "action -7"),
        ({"pose__position__x": NAN}, r"position \(nan"),
        ({"pose__position__y": -INF}, "position .*-inf"),
        ({"pose__position__z": NAN}, "position .*nan"),
        ({"pose__position__x": 1e300}, "position .*beyond"),
        ({"pose__orientation__z": NAN}, "quaternion of length nan"),
        ({"pose__orientation": Quaternion(x=0.0, y=0.0, z=0.0, w=0.0)}, "quaternion of length 0"),
        ({"pose__orientation": Quaternion(x=1.0, y=0.0, z=0.0, w=0.0)}, "about the vertical"),
        ({"scale__z": -0.1}, r"scale\.z -0.1 m must be a height"),
        ({"scale__z": NAN}, r"scale\.z nan m"),
        ({"scale__z": INF}, r"scale\.z inf m"),
        ({"lifetime": Duration(sec=-1)}, "lifetime -1.0 s"),
        ({"points": [Point(x=NAN)]}, "velocity .*nan"),
        ({"points": [Point(), Point(z=-1.0)]}, "variance of its velocity -1.0"),
        ({"points": [Point(), Point(z=NAN)]}, "variance of its velocity nan"),
        ({"points": [Point()] * 3}, "3 points"),
        ({"header__stamp": Time(sec=100)}, "stamp is 50.000 s ahead"),
    ],
)
def test_invalid_marker_is_reported_and_the_others_are_kept(change, why):
    made, complaints = changed(marker(1), marker(13, **change), marker(2))
    assert [observation.key for observation in made] == [("people", 1), ("people", 2)]
    (complaint,) = complaints
    assert complaint.startswith("marker 'people' 13: ")
    assert re.search(why, complaint)


def test_hundred_markers_take_few_calls_each():
    found = ObstacleSet(build(ObstacleParameters, {}))
    message = MarkerArray(markers=[marker(i) for i in range(100)])

    def add(now):
        changes, _ = marker_changes(message, within("odom"), lambda stamp: now)
        for change in changes:
            found.add(change, now)

    for now in (NOW, NOW + 0.05, NOW + 0.1):
        assert calls(lambda now=now: add(now)) < 100 * 80
    assert len(found) == 100


def test_predicted_obstacles_are_shown_over_time():
    ellipses = Ellipses(
        10.0,
        np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]),
        np.array([[1.0, 0.0], [0.0, 0.0], [0.0, -1.0]]),
        np.array([[0.5, 0.25]] * 3),
        np.array([0.0, 0.7, -0.4]),
        np.array([0.0, 0.1, 0.0]),
    )
    times = np.array([10.0, 10.5, 11.0, 12.0])
    stamp = Time(sec=3)
    message = ellipse_markers(ellipses, times, "odom", stamp, margin=0.1, height=0.2)
    first, *rest = message.markers
    assert (first.action, first.ns) == (Marker.DELETEALL, "")
    assert len(rest) == 12
    assert len({(one.ns, one.id) for one in rest}) == 12
    for one in message.markers:
        assert (one.header.frame_id, one.header.stamp) == ("odom", stamp)
    assert all(one.action == Marker.ADD and one.type == Marker.CYLINDER for one in rest)
    shown = {(one.ns, one.id): one for one in rest}
    axes = ellipses.axes_at(times, 0.1)
    for i in range(3):
        alphas = [shown[f"predicted_{i}", k].color.a for k in range(4)]
        assert 1.0 > alphas[0] > alphas[1] > alphas[2] > alphas[3] > 0.0
        for k in range(4):
            one = shown[f"predicted_{i}", k]
            place = ellipses.centers[i] + (times[k] - 10.0) * ellipses.velocities[i]
            assert (one.pose.position.x, one.pose.position.y) == pytest.approx(tuple(place))
            assert (one.scale.x, one.scale.y) == pytest.approx(tuple(2.0 * axes[k, i]))
            assert one.scale.z == 0.2
            assert yaw_from_quaternion(one.pose.orientation) == pytest.approx(ellipses.angles[i])


def test_ellipses_survive_a_round_trip_through_markers():
    ellipses = Ellipses(
        0.0,
        np.array([[1.0, 2.0]]),
        np.zeros((1, 2)),
        np.array([[0.5, 0.25]]),
        np.array([0.3]),
        np.zeros(1),
    )
    message = ellipse_markers(ellipses, np.zeros(1), "odom", Time())
    (gone, back), complaints = changed(*message.markers)
    assert complaints == [] and gone == MarkerDeletion("")
    assert (back.x, back.y, *back.semi_axes) == pytest.approx((1.0, 2.0, 0.5, 0.25))
    assert back.angle == pytest.approx(0.3)


def test_old_markers_are_deleted_even_without_obstacles():
    for ellipses, times in ((Ellipses.none(), np.arange(3.0)), (Ellipses.none(), np.zeros(0))):
        message = ellipse_markers(ellipses, times, "odom", Time())
        assert [one.action for one in message.markers] == [Marker.DELETEALL]


# ---- goals and plans --------------------------------------------------------------------------


def goal(x=1.0, y=-2.0, theta=0.5, frame="odom", **orientation):
    message = PoseStamped()
    message.header.frame_id = frame
    message.pose.position.x, message.pose.position.y = float(x), float(y)
    message.pose.orientation = quaternion_from_yaw(theta)
    for name, value in orientation.items():
        setattr(message.pose.orientation, name, value)
    return message


def goal_state(pose, velocity, child="base_link", frame="odom"):
    message = OdometryMsg(child_frame_id=child)
    message.header.frame_id = frame
    message.pose.pose = goal(*pose).pose
    x, y, turn = map(float, velocity)
    message.twist.twist = twist(x, y, rz=turn)
    return message


@pytest.mark.parametrize("frame", ["odom", "/odom", "map"])
def test_goal_is_a_pose_on_the_floor(frame):
    message = goal(1.5, -2.5, 3.0, frame)
    message.pose.position.z = 0.7  # RViz may select a point on an object: the height is ignored
    pose = goal_pose_from_message(message, ("odom", "map"))
    assert pose.shape == (3,)
    assert pose == pytest.approx([1.5, -2.5, 3.0], abs=1e-12)


BAD_GOALS = [
    ({"frame": "map"}, "frame 'map', expected 'odom'"),
    ({"frame": ""}, "frame '', expected 'odom'"),
    ({"x": NAN}, "goal: position .*nan.* not finite"),
    ({"y": -INF}, "goal: position .*inf.* not finite"),
    ({"x": 1e9}, "goal: position .*beyond"),
    ({"z": 0.0, "w": 0.0}, "quaternion of length 0"),
    ({"w": NAN}, "quaternion of length nan"),
    ({"x": 1.0, "y": 0.0, "theta": 0.0, "w": 2.0}, "quaternion of length 2"),
]


@pytest.mark.parametrize(("change", "why"), BAD_GOALS)
def test_invalid_goal_is_rejected(change, why):
    with pytest.raises(InputError, match=why):
        goal_pose_from_message(goal(**change), ("odom",))
    message = OdometryMsg(child_frame_id="base_link")
    bad = goal(**change)
    message.header, message.pose.pose = bad.header, bad.pose
    with pytest.raises(InputError, match=why):
        goal_state_from_message(message, ("odom",))


def test_tilted_goal_is_rejected():
    message = goal()
    message.pose.orientation = Quaternion(x=0.6, y=0.0, z=0.0, w=0.8)
    with pytest.raises(InputError, match="not about the vertical"):
        goal_pose_from_message(message, ("odom",))


@pytest.mark.parametrize("theta", [0.0, 0.5, math.pi / 2, -2.5])
def test_goal_velocity_is_in_the_robot_frame_or_in_odom(theta):
    body = np.array([0.3, -0.1, 0.2])
    pose, velocity = goal_state_from_message(goal_state((1, 2, theta), body), ("odom",))
    assert pose.shape == velocity.shape == (3,)
    assert pose == pytest.approx([1.0, 2.0, theta])
    c, s = math.cos(theta), math.sin(theta)
    world = [c * 0.3 + s * 0.1, s * 0.3 - c * 0.1, 0.2]
    assert velocity == pytest.approx(world, abs=1e-12)
    for child in ("odom", "map"):
        message = goal_state((1, 2, theta), world, child=child)
        _, same = goal_state_from_message(message, ("odom", "map"))
        assert same == pytest.approx(world, abs=1e-12)


@pytest.mark.parametrize("value", [NAN, INF, 1e300])
@pytest.mark.parametrize("part", [0, 1, 2])
def test_non_finite_goal_velocity_is_rejected(part, value):
    velocity = [0.1, 0.1, 0.1]
    velocity[part] = value
    with pytest.raises(InputError, match="not finite"):
        goal_state_from_message(goal_state((1, 2, 0), velocity), ("odom",))


def test_motion_survives_a_round_trip_also_between_its_points():
    rng = np.random.default_rng(5)
    for _ in range(20):
        k = int(rng.integers(2, 15))
        times = 7.0 + np.cumsum(rng.uniform(1e-3, 0.3, k))
        poses = np.cumsum(rng.normal(0.0, 0.2, (k, 3)), axis=0) + [0.0, 0.0, 3.0]
        motion = HermiteTrajectory(
            times, poses, rng.normal(0.0, 0.5, (k, 3)), np.zeros((k - 1, 4))
        )
        stamp = Time(sec=100, nanosec=250_000_000)
        message = preview_message("odom", stamp, motion.times, motion.poses, motion.velocities)
        assert (message.header.frame_id, message.header.stamp) == ("odom", stamp)
        assert list(message.joint_names) == [PLATFORM_JOINT]
        assert not any(len(point.accelerations) for point in message.points)
        back = preview_from_message(message, float(times[0]), ("odom",))
        assert (back.start, back.end) == pytest.approx((times[0], times[-1]), abs=1e-8)
        for now in np.linspace(times[0] + 1e-6, times[-1] - 1e-6, 50):
            pose, velocity = motion.sample(now)
            point = back.sample(now)
            turns = round((point.pose[2] - pose[2]) / (2.0 * math.pi)) * 2.0 * math.pi
            assert point.pose - [0.0, 0.0, turns] == pytest.approx(pose, abs=1e-6)
            assert point.velocity == pytest.approx(velocity, abs=1e-5)


def test_preview_times_are_relative_to_the_stamp_to_the_nanosecond():
    times = np.array([1e6, 1e6 + 0.1, 1e6 + 1.2, 1e6 + 3.999_999_999_9])
    message = preview_message("odom", Time(), times, np.zeros((4, 3)), np.zeros((4, 3)))
    after = [(p.time_from_start.sec, p.time_from_start.nanosec) for p in message.points]
    assert after[0] == (0, 0) and after[3] == (4, 0)
    assert [seconds for seconds, _ in after[1:3]] == [0, 1]
    assert [part for _, part in after[1:3]] == pytest.approx([1e8, 2e8], abs=2)


def test_preview_message_needs_arrays_of_equal_length():
    with pytest.raises(ValueError, match="zip"):
        preview_message("odom", Time(), np.arange(3.0), np.zeros((2, 3)), np.zeros((3, 3)))
