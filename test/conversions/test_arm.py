import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.repairs import noted_repairs
from omniman_ros.motion.path.interpolator import Window

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from omniman_ros.conversions import arm as arm_conversions

NAMES = ("a", "b", "c")


def point(seconds: int = 0, **arrays: list[float]) -> JointTrajectoryPoint:
    return JointTrajectoryPoint(time_from_start=Duration(sec=seconds), **arrays)


def message(names: list[str], *points: JointTrajectoryPoint) -> JointTrajectory:
    return JointTrajectory(joint_names=names, points=list(points))


def test_points_are_read_in_joint_order():
    given = message(["c", "a"], point(1, positions=[3.0, 1.0]), point(2, positions=[4.0, 2.0]))
    points = arm_conversions.joint_points(given, NAMES, 2)
    assert points.columns == (2, 0) and points.times.tolist() == [1.0, 2.0]
    assert points.positions.tolist() == [[3.0, 1.0], [4.0, 2.0]]
    assert points.velocities is None and points.accelerations is None


def test_all_zero_times_count_as_missing():
    given = message(["a"], point(positions=[1.0]), point(positions=[2.0]))
    assert arm_conversions.joint_points(given, NAMES, 2).times is None


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (message(["d"], point(positions=[1.0])), "no joint d; the joints are a, b, c"),
        (message(["a", "a"], point(positions=[1.0, 2.0])), "without repeats, got a, a"),
        (message([], point()), r"without repeats, got \(none\)"),
        (message(["a"], point()), "without positions"),
        (message(["a"], point(positions=[1.0, 2.0])), "point 0: 2 positions for 1 joints"),
        (message(["a"], point(positions=[1.0], effort=[0.0] * 6)), "point 0: 6 effort for 1"),
        (
            message(["a"], point(1, positions=[1.0], velocities=[0.0]), point(2, positions=[1.0])),
            "point 1: 0 velocities for 1 joints",
        ),
        (message(["a"], *[point(positions=[1.0])] * 3), "3 points, at most 2"),
        (message(["a"], point(2, positions=[1.0]), point(2, positions=[2.0])), "do not increase"),
        (message(["a"], point(-1, positions=[1.0])), "times"),
    ],
)
def test_invalid_trajectories_are_rejected_with_the_reason(given, words):
    with pytest.raises(InputError, match=words):
        arm_conversions.joint_points(given, NAMES, 2)


def test_joint_preview_message_contains_the_window():
    rows = np.arange(6.0).reshape(2, 3)
    sent = arm_conversions.joint_reference_message(NAMES, 2, 0.008)
    window = Window(np.array([1.0, 1.008]), rows, rows + 10, rows + 20)
    arm_conversions.fill_joint_reference(sent, Time(sec=7), window)
    assert list(sent.joint_names) == [*NAMES] and sent.header.stamp.sec == 7
    assert [p.time_from_start.nanosec for p in sent.points] == [0, 8_000_000]
    assert list(sent.points[1].positions) == [3.0, 4.0, 5.0]
    assert list(sent.points[1].velocities) == [13.0, 14.0, 15.0]
    assert list(sent.points[0].accelerations) == [20.0, 21.0, 22.0]


def test_preview_is_read_in_the_node_order_on_the_node_clock():
    given = message(
        ["c", "a", "b"],
        point(0, positions=[3.0, 1.0, 2.0], velocities=[0.3, 0.1, 0.2]),
        point(1, positions=[3.5, 1.5, 2.5], velocities=[0.0, 0.0, 0.0]),
    )
    times, positions, velocities, accelerations = arm_conversions.joint_preview(given, 7.0, NAMES)
    assert times.tolist() == [7.0, 8.0]
    assert positions.tolist() == [[1.0, 2.0, 3.0], [1.5, 2.5, 3.5]]
    assert velocities[0].tolist() == [0.1, 0.2, 0.3]
    assert accelerations is None


@pytest.mark.parametrize(
    ("names", "arrays", "why"),
    [
        (["a", "b"], {"positions": [0.0] * 2, "velocities": [0.0] * 2}, "joints a, b, expected"),
        (["a", "b", "b"], {"positions": [0.0] * 3, "velocities": [0.0] * 3}, "expected a, b, c"),
        (["a", "b", "c"], {"positions": [0.0] * 3}, "without velocities"),
        (["a", "b", "c"], {"velocities": [0.0] * 3}, "without positions"),
        (["a", "b", "c"], {"positions": [0.0] * 2, "velocities": [0.0] * 3}, "2 positions for 3"),
        (
            ["a", "b", "c"],
            {"positions": [0.0] * 3, "velocities": [0.0] * 3, "effort": [0.0]},
            "1 effort for 3",
        ),
    ],
)
def test_preview_with_other_joints_or_sizes_is_rejected(names, arrays, why):
    with pytest.raises(InputError, match=why):
        arm_conversions.joint_preview(message(names, point(**arrays)), 0.0, NAMES)


def test_preview_without_points_is_rejected():
    with pytest.raises(InputError, match="0 points"):
        arm_conversions.joint_preview(message(list(NAMES)), 0.0, NAMES)


def tool_message(quaternions, frame="odom", places=None):
    message = Path()
    message.header.frame_id = frame
    for i, (x, y, z, w) in enumerate(quaternions):
        stamped = PoseStamped()
        place, turn = stamped.pose.position, stamped.pose.orientation
        place.x, place.y, place.z = (0.1 * i, 0.2, 0.3) if places is None else places[i]
        turn.x, turn.y, turn.z, turn.w = float(x), float(y), float(z), float(w)
        message.poses.append(stamped)
    return message


def some_quaternions(count=500):
    rows = np.random.default_rng(3).normal(size=(500, 4))
    rows[:8, :2] = 0.0  # rotations about the vertical and half turns
    rows[8:16, 2:] = 0.0
    rows[16:24] = np.eye(4)[np.arange(8) % 4]
    return (rows / np.linalg.norm(rows, axis=1)[:, None])[:count]


def test_quaternions_survive_a_round_trip_through_rotation_matrices():
    given = some_quaternions()
    turned = arm_conversions.rotations(given)
    assert np.allclose(turned @ np.swapaxes(turned, 1, 2), np.eye(3), atol=1e-12)
    assert np.linalg.det(turned) == pytest.approx(1.0)
    for quaternion, rotation in zip(given, turned, strict=True):
        back = arm_conversions.unit_quaternion(rotation)
        assert abs(float(back @ quaternion)) == pytest.approx(1.0, abs=1e-12)


def test_quarter_turn_about_the_vertical_maps_x_to_y():
    half = math.sqrt(0.5)
    turned = arm_conversions.rotations(np.array([[0.0, 0.0, half, half]]))[0]
    assert turned @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 1.0, 0.0])


def test_tool_poses_are_read_and_a_zero_quaternion_keeps_the_orientation():
    given = some_quaternions(3)
    given[1] = 0.0
    here = arm_conversions.rotations(some_quaternions(5)[4:])[0]
    poses = arm_conversions.tool_poses(tool_message(given), ("odom",), here)
    assert poses[:, 0, 3] == pytest.approx([0.0, 0.1, 0.2])
    assert np.allclose(poses[:, 1:3, 3], [0.2, 0.3])
    assert poses[1, :3, :3] == pytest.approx(here)
    assert poses[0, :3, :3] == pytest.approx(arm_conversions.rotations(given[:1])[0])
    assert (poses[:, 3] == [0, 0, 0, 1]).all()


def test_tool_poses_with_typed_quaternions_are_normalised_and_noted():
    with noted_repairs() as notes:
        poses = arm_conversions.tool_poses(tool_message([(0, 0, 0.7, 0.7)]), ["odom"], np.eye(3))
    assert poses[0, :2, :2] == pytest.approx(np.array([[0.0, -1.0], [1.0, 0.0]]))
    assert notes == ["a quaternion of length 0.9899 was normalised"]


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (tool_message([]), "the path is empty"),
        (tool_message([(0, 0, 0, 1)], frame="map"), "frame 'map'"),
        (tool_message([(0, 0, 0, 1), (0, 0, 0.5, 1)]), "pose 1: quaternion of length 1.118"),
        (tool_message([(0, 0, 0, math.nan)]), "pose 0: quaternion of length nan"),
        (tool_message([(0, 0, 0, 1)], places=[(math.inf, 0.0, 0.0)]), "positions"),
        (tool_message([(0, 0, 0, 1)], places=[(0.0, 0.0, 1e9)]), "positions"),
    ],
)
def test_invalid_tool_poses_are_rejected_with_the_reason(message, words):
    with pytest.raises(InputError, match=words):
        arm_conversions.tool_poses(message, ("odom",), np.eye(3))


def test_pose_in_another_frame_within_the_path_is_rejected():
    message = tool_message([(0, 0, 0, 1), (0, 0, 0, 1)])
    message.poses[1].header.frame_id = "base_link"
    with pytest.raises(InputError, match="frame 'base_link'"):
        arm_conversions.tool_poses(message, ("odom",), np.eye(3))


def test_pose_survives_a_round_trip_through_a_message():
    given = some_quaternions(20)
    message = tool_message(given)
    poses = arm_conversions.tool_poses(message, ("odom",), np.eye(3))
    again = tool_message(np.zeros((20, 4)))
    for stamped, pose in zip(again.poses, poses, strict=True):
        arm_conversions.fill_pose(stamped.pose, pose)
    assert arm_conversions.tool_poses(again, ("odom",), np.eye(3)) == pytest.approx(poses)
