import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.path.interpolator import Window

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Duration, Time  # noqa: E402
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint  # noqa: E402

from omniman_ros import arm_conversions  # noqa: E402

NAMES = ("a", "b", "c")


def point(seconds: int = 0, **arrays: list[float]) -> JointTrajectoryPoint:
    return JointTrajectoryPoint(time_from_start=Duration(sec=seconds), **arrays)


def message(names: list[str], *points: JointTrajectoryPoint) -> JointTrajectory:
    return JointTrajectory(joint_names=names, points=list(points))


def test_points_are_read_in_the_order_of_the_joints():
    given = message(["c", "a"], point(1, positions=[3.0, 1.0]), point(2, positions=[4.0, 2.0]))
    points = arm_conversions.joint_points(given, NAMES, 2)
    assert points.columns == (2, 0) and points.times.tolist() == [1.0, 2.0]
    assert points.positions.tolist() == [[3.0, 1.0], [4.0, 2.0]]
    assert points.velocities is None and points.accelerations is None


def test_times_that_are_all_zero_are_none():
    given = message(["a"], point(positions=[1.0]), point(positions=[2.0]))
    assert arm_conversions.joint_points(given, NAMES, 2).times is None


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (message(["d"], point(positions=[1.0])), "no joint d; the joints are a, b, c"),
        (message(["a", "a"], point(positions=[1.0, 2.0])), "one twice"),
        (message([], point()), "no joint"),
        (message(["a"], point()), "without positions"),
        (message(["a"], point(positions=[1.0, 2.0])), "point 0: 2 positions for 1 joints"),
        (message(["a"], point(1, positions=[1.0], velocities=[0.0]), point(2, positions=[1.0])),
         "point 1: 0 velocities for 1 joints"),
        (message(["a"], *[point(positions=[1.0])] * 3), "3 points, at most 2"),
        (message(["a"], point(2, positions=[1.0]), point(2, positions=[2.0])), "do not increase"),
        (message(["a"], point(-1, positions=[1.0])), "times"),
    ],
)  # fmt: skip
def test_trajectories_that_cannot_be_are_refused_by_name(given, words):
    with pytest.raises(InputError, match=words):
        arm_conversions.joint_points(given, NAMES, 2)


def test_a_preview_of_joints_carries_the_window():
    rows = np.arange(6.0).reshape(2, 3)
    sent = arm_conversions.joint_reference_message(NAMES, 2, 0.008)
    window = Window(np.array([1.0, 1.008]), rows, rows + 10, rows + 20)
    arm_conversions.fill_joint_reference(sent, Time(sec=7), window)
    assert list(sent.joint_names) == [*NAMES] and sent.header.stamp.sec == 7
    assert [p.time_from_start.nanosec for p in sent.points] == [0, 8_000_000]
    assert list(sent.points[1].positions) == [3.0, 4.0, 5.0]
    assert list(sent.points[1].velocities) == [13.0, 14.0, 15.0]
    assert list(sent.points[0].accelerations) == [20.0, 21.0, 22.0]


def test_a_preview_is_read_in_our_order_on_our_clock():
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
    ],
)
def test_a_preview_of_other_joints_or_sizes_is_refused(names, arrays, why):
    with pytest.raises(InputError, match=why):
        arm_conversions.joint_preview(message(names, point(**arrays)), 0.0, NAMES)


def test_a_preview_without_points_is_refused():
    with pytest.raises(InputError, match="0 points"):
        arm_conversions.joint_preview(message(list(NAMES)), 0.0, NAMES)
