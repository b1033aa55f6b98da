import math
import sqlite3

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (extra 'record')")

from rosbags.rosbag2 import StoragePlugin, Writer

from omniman_ros.core.errors import InputError
from omniman_ros.recording.reader import BagReader
from omniman_ros.recording.robot_log import read_robot_log, reference_errors, robot_namespaces
from test.recording import support as s

WHEELS = ("a", "b", "c")


def log_of(folder, messages, namespace=""):
    with BagReader(s.write(folder / "bag", messages)) as bag:
        return read_robot_log(bag, namespace)


def test_each_topic_becomes_its_table(tmp_path):
    log = log_of(
        tmp_path,
        [
            (10.0, "/odom", s.odometry(10.0, (1.0, 2.0, 0.5), (0.1, 0.2, 0.3))),
            (10.0, "/ground_truth/odom", s.odometry(10.0, (1.1, 2.1, -3.0))),
            (10.1, "/cmd_vel", s.twist(0.4, -0.1, 0.2)),
            (10.2, "/wheel_states", s.joints(10.19, WHEELS, (1, 2, 3), (4, 5, 6), (0, 0, 0))),
            (10.3, "/wheel_commands", s.joints(10.29, WHEELS, velocity=(7, 8, 9))),
            (10.4, "/wheel_electrical", s.numbers(3, 3, data=range(9))),
            (10.5, "/coupling_error", s.joints(10.5, ["constraint_1"], position=(0.01,))),
            (
                10.6,
                "/goal_pose",
                s.T["geometry_msgs/msg/PoseStamped"](s.header(0), s.pose(3, 4, 1)),
            ),
            (10.7, "/arm/joint_states", s.joints(10.7, ["j1", "j2"], (0.1, 0.2))),
            (10.8, "/arm/timing", s.numbers(2, 1, data=(0.008, 0.009, 0.02))),
            (10.9, "/active_source", s.text("cmd_vel")),
        ],
    )
    assert log.odom == pytest.approx(np.array([[10.0, 1.0, 2.0, 0.5, 0.1, 0.2, 0.3]]))
    assert log.truth[0, :4] == pytest.approx([10.0, 1.1, 2.1, -3.0])
    assert log.twist == pytest.approx(np.array([[10.1, 0.4, -0.1, 0.2]]))
    assert log.wheel_names == WHEELS
    assert log.measured == pytest.approx(np.array([[10.19, 4, 5, 6]]))
    assert log.commanded == pytest.approx(np.array([[10.29, 7, 8, 9]]))
    assert log.electrical == pytest.approx(np.array([[10.4, *range(9)]]))
    assert log.coupling == pytest.approx(np.array([[10.5, 0.01]]))
    assert log.goals == pytest.approx(np.array([[10.6, 3, 4, 1]]))
    assert log.joint_names == ("j1", "j2")
    assert log.arm == pytest.approx(np.array([[10.7, 0.1, 0.2]]))
    assert log.arm_intervals == pytest.approx(np.array([[10.8, 0.008], [10.8, 0.009]]))
    assert log.sources == [(pytest.approx(10.9), "cmd_vel")]
    assert log.span == pytest.approx((10.0, 10.8))


def test_in_simulated_time_messages_without_a_stamp_get_the_time_of_odometry(tmp_path):
    # Simulated time runs twice as fast and has begun later.
    rows = [(100.0 + k, "/odom", s.odometry(2.0 * k, (0, 0, 0))) for k in range(5)]
    log = log_of(tmp_path, [*rows, (102.5, "/cmd_vel", s.twist(1, 0, 0))])
    assert log.twist[0, 0] == pytest.approx(5.0)


def test_commands_without_speeds_leave_a_gap(tmp_path):
    log = log_of(
        tmp_path,
        [
            (1.0, "/wheel_commands", s.joints(1.0, WHEELS, effort=(1, 2, 3))),
            (2.0, "/wheel_commands", s.joints(2.0, WHEELS, velocity=(1, 2, 3))),
        ],
    )
    assert np.isnan(log.commanded[0, 1:]).all()
    assert np.isfinite(log.commanded[1]).all()


def straight(stamp, speed, count=11, step=0.05):
    """A preview of half a second of a straight motion that began at 0 at the given speed [m/s]."""
    return s.preview(
        stamp, [(k * step, (speed * (stamp + k * step), 0.0, 0.0)) for k in range(count)]
    )


def test_of_overlapping_previews_the_newer_one_counts(tmp_path):
    log = log_of(
        tmp_path,
        [
            (1.0, "/path/reference", straight(1.0, 1.0)),
            (1.2, "/path/reference", straight(1.2, 2.0)),
        ],
    )
    reference = log.references["path"]
    assert (np.diff(reference[:, 0]) > 0.0).all()
    old = reference[:, 0] < 1.2 - 1e-6
    assert reference[old, 1] == pytest.approx(reference[old, 0])
    assert reference[~old, 1] == pytest.approx(2.0 * reference[~old, 0])
    assert reference[-1, 0] == pytest.approx(1.7)


def test_there_is_no_reference_between_two_movements(tmp_path):
    log = log_of(
        tmp_path,
        [
            (1.0, "/path/reference", straight(1.0, 1.0)),
            (5.0, "/path/reference", straight(5.0, 1.0)),
        ],
    )
    times = np.array([0.5, 1.2, 3.0, 5.2, 9.0])
    poses = np.column_stack([times, times + 0.003, np.zeros(5), np.full(5, 2 * math.pi - 0.01)])
    errors = reference_errors(poses, log.references["path"])
    assert np.isnan(errors[[0, 2, 4], 1:]).all()
    assert errors[[1, 3], 1] == pytest.approx(0.003)
    assert errors[[1, 3], 2] == pytest.approx(-0.01)


def test_the_planners_figures_count_only_while_it_plans(tmp_path):
    values = {"solve_ms": 9.5, "slack_m": 0.002, "distance_m": 1.5, "energy_j": 20}
    log = log_of(
        tmp_path,
        [
            (1.0, "/mpc/status", s.status(state="driving", **values)),
            (2.0, "/mpc/status", s.status(state="arrived", **values)),
            (3.0, "/mpc/status", s.status(state="blocked", solve_ms="none")),
        ],
    )
    assert log.planner[0, 1:] == pytest.approx([9.5, 0.002, 1.5, 20])
    assert np.isnan(log.planner[1:, 1:]).all()


def test_one_of_several_robots_is_read(tmp_path):
    messages = [
        (1.0, "/robot1/odom", s.odometry(1.0, (1, 0, 0))),
        (1.0, "/robot2/odom", s.odometry(1.0, (2, 0, 0))),
        (1.0, "/robot2/ground_truth/odom", s.odometry(1.0, (2, 0, 0))),
    ]
    assert log_of(tmp_path, messages, "robot2").odom[0, 1] == 2.0
    assert robot_namespaces(topic for _, topic, _ in messages) == ["robot1", "robot2"]
    assert robot_namespaces(["/wheel_states", "/rosout"]) == [""]
    assert robot_namespaces(["/cmd_vel"]) == []


def test_a_recording_in_sqlite_without_definitions_is_read_too(tmp_path):
    message = s.odometry(3.0, (1.0, 2.0, 0.5))
    message_type = message.__msgtype__
    with Writer(tmp_path / "bag", version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/odom", message_type, typestore=s.STORE)
        writer.write(connection, 3 * 10**9, s.STORE.serialize_cdr(message, message_type))
    # Releases before Iron did not write definitions.
    with sqlite3.connect(next((tmp_path / "bag").glob("*.db3"))) as database:
        assert database.execute("DELETE FROM message_definitions").rowcount > 0
    with BagReader(tmp_path / "bag") as bag:
        assert read_robot_log(bag).odom[0, :4] == pytest.approx([3.0, 1.0, 2.0, 0.5])


def test_a_recording_without_a_robot_has_no_span(tmp_path):
    log = log_of(tmp_path, [(1.0, "/rosout", s.text("hello"))])
    with pytest.raises(InputError, match="no data of a robot"):
        _ = log.span


def test_a_topic_of_another_type_is_left_out(tmp_path):
    log = log_of(
        tmp_path,
        [
            (1.0, "/odom", s.odometry(1.0, (1, 2, 0))),
            (2.0, "/path", s.text("not a path")),
            (2.0, "/wheel_states", s.twist(1, 0, 0)),
        ],
    )
    assert len(log.odom) == 1
    assert not log.paths and not len(log.measured)


def test_messages_of_another_size_than_the_first_are_left_out(tmp_path):
    sizes = (9, 12, 2, 0)
    log = log_of(
        tmp_path,
        [
            *(
                (k, "/wheel_electrical", s.numbers(n, data=[0.0] * n))
                for k, n in enumerate(sizes, 1)
            ),
            *((k, "/coupling_error", s.joints(k, "ab"[:k], [0.0] * k)) for k in (1, 2)),
        ],
    )
    assert log.electrical.shape == (1, 10)
    assert log.coupling.shape == (1, 2)


def test_coupling_error_without_resets_is_the_one_that_is_read(tmp_path):
    names = ["constraint_1", "constraint_1_total"]
    log = log_of(tmp_path, [(1.0, "/coupling_error", s.joints(1.0, names, (0.1, 0.7)))])
    assert log.coupling.tolist() == [[1.0, 0.7]]


def test_commanded_and_measured_speeds_are_of_the_same_wheels(tmp_path):
    log = log_of(
        tmp_path,
        [
            (1.0, "/wheel_states", s.joints(1.0, WHEELS, velocity=(1, 2, 3))),
            (1.0, "/wheel_commands", s.joints(1.0, WHEELS[::-1], velocity=(6, 5, 4))),
            (2.0, "/wheel_commands", s.joints(2.0, WHEELS[:2], velocity=(7, 8))),
        ],
    )
    assert log.measured[:, 1:].tolist() == [[1, 2, 3]]
    assert log.commanded[:, 1:].tolist() == [[4, 5, 6]]


def test_previews_without_poses_are_no_reference(tmp_path):
    empty = s.preview(1.0, [(0.0, (1, 2, 0))])
    empty.points[0].transforms = []
    log = log_of(tmp_path, [(1.0, "/path/reference", empty)])
    assert log.references["path"].shape == (0, 4)


@pytest.mark.parametrize(
    "message_type", [b"nav_msgs/msg/Odom\xff\xffry", b"nav_msgs/msg/Odo\xff\xffry"]
)
def test_a_damaged_recording_is_refused(tmp_path, message_type):
    folder = s.write(tmp_path / "bag", [(1.0, "/odom", s.odometry(1.0, (1, 2, 0)))])
    (file,) = folder.glob("*.mcap")
    file.write_bytes(file.read_bytes().replace(b"nav_msgs/msg/Odometry", message_type))
    with pytest.raises(InputError, match="bag"), BagReader(folder) as bag:
        read_robot_log(bag)
