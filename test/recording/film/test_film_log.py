import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (extra 'record')")

from omniman_ros.recording.film.film_log import FilmLog, read_film_log
from omniman_ros.recording.reader import BagReader
from omniman_ros.recording.robot_log import RobotLog
from test.recording import support as s
from test.recording.film.logs import series

CUBE, CYLINDER = 1, 3
ADD, DELETE, DELETE_ALL = 0, 2, 3


def marker(number, kind=CYLINDER, action=ADD, x=1.0, namespace="people", lifetime=0.0):
    nothing = np.zeros(0, np.uint8)
    pose = s.pose(x, 2.0, 0.5)
    pose.position.z = 0.85
    return s.T["visualization_msgs/msg/Marker"](
        header=s.header(0.0),
        ns=namespace,
        id=number,
        type=kind,
        action=action,
        pose=pose,
        scale=s.vector(0.5, 0.4, 1.7),
        color=s.T["std_msgs/msg/ColorRGBA"](0.0, 0.0, 0.0, 1.0),
        lifetime=s.duration(lifetime),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=s.T["sensor_msgs/msg/CompressedImage"](s.header(0.0), "", nothing),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=s.T["visualization_msgs/msg/MeshFile"]("", nothing),
        mesh_use_embedded_materials=False,
    )


def markers(*made):
    return s.T["visualization_msgs/msg/MarkerArray"](list(made))


def path(*points):
    poses = []
    for point in points:
        pose = s.pose(0.0, 0.0, 0.0)
        pose.position.x, pose.position.y, pose.position.z = point
        poses.append(s.T["geometry_msgs/msg/PoseStamped"](s.header(0.0), pose))
    return s.T["nav_msgs/msg/Path"](s.header(0.0), poses)


def log_of(folder, messages):
    # Simulated time begins at 0 and runs twice as fast as the clock of the recording.
    clock = [(100.0 + k, "/odom", s.odometry(2.0 * k, (0, 0, 0))) for k in range(6)]
    with BagReader(s.write(folder / "bag", [*clock, *messages])) as bag:
        return read_film_log(bag)


def test_paths_have_the_ros_time_of_their_arrival(tmp_path):
    log = log_of(
        tmp_path,
        [
            (101.5, "/tool_path", path((1, 2, 3), (4, 5, 6))),
            (102.5, "/path", path((1, 2, 0), (4, 5, 0))),
            (103.0, "/mpc/plan", path((7, 8, 0))),
            (104.0, "/tool_path", path((1, 2, float("nan")))),
        ],
    )
    assert log.tool_paths.times == [pytest.approx(3.0)]
    assert log.tool_paths.at(9.0).tolist() == [[1, 2, 3], [4, 5, 6]]
    assert log.tool_paths.at(2.9) is None
    assert log.paths.at(5.5).tolist() == [[1, 2], [4, 5]]
    assert log.plans.at(6.5, 0.4) is None
    assert log.plans.at(6.5, 0.6).tolist() == [[7, 8]]


def test_obstacles_appear_expire_and_are_deleted(tmp_path):
    log = log_of(
        tmp_path,
        [
            (101.0, "/obstacles", markers(marker(1), marker(2, lifetime=2.5, x=3.0))),
            (102.0, "/obstacles", markers(marker(3, namespace="other", x=5.0))),
            (103.0, "/obstacles", markers(marker(1, action=DELETE))),
            (104.0, "/obstacles", markers(marker(4, action=DELETE_ALL, namespace="people"))),
            (104.5, "/obstacles", markers(marker(4, action=DELETE_ALL, namespace=""))),
        ],
    )
    places = [[solid.place[0] for solid in log.obstacles.at(t)] for t in (2.1, 4.1, 6.1, 8.1, 9.1)]
    assert places == [[1.0, 3.0], [1.0, 3.0, 5.0], [5.0], [5.0], []]


def test_bodies_have_the_shape_of_their_markers(tmp_path):
    log = log_of(
        tmp_path,
        [(101.0, "/ground_truth/obstacles", markers(marker(1), marker(2, CUBE), marker(3, 9)))],
    )
    round_one, box = log.world.at(3.0)
    assert (round_one.is_round, box.is_round) == (True, False)
    assert box.place == pytest.approx((1.0, 2.0, 0.5))
    assert (*box.size, *box.heights) == pytest.approx((0.5, 0.4, 0.0, 1.7))


def test_scans_and_maps_that_cannot_be_read_are_left_out(tmp_path):
    def scan(stamp, first):
        ranges = np.array([2.0, 0.01, 3.0, np.inf], dtype=np.float32)
        numbers = (first, 0.1, 0.1, 0.0, 0.1, 0.05, 9.0)
        none = np.zeros(0, np.float32)
        return s.T["sensor_msgs/msg/LaserScan"](s.header(stamp), *numbers, ranges, none)

    origin, info = s.pose(1, 2, 0), s.T["nav_msgs/msg/MapMetaData"]
    grid = s.T["nav_msgs/msg/OccupancyGrid"]
    cells = np.array([0, 100, -1, 50, 0, 0], np.int8)
    log = log_of(
        tmp_path,
        [
            (
                101.0,
                "/scan",
                scan(2.0, -0.1),
            ),
            (
                102.0,
                "/scan",
                scan(4.0, float("nan")),
            ),
            (103.0, "/map", grid(s.header(6.0), info(s.time(0), 0.5, 3, 2, origin), cells)),
            (104.0, "/map", grid(s.header(8.0), info(s.time(0), 0.5, 9, 9, origin), cells)),
        ],
    )
    assert log.scans.times == [2.0]
    assert log.scans.at(2.0)[0] == pytest.approx([0.55 + 2.0 * np.cos(-0.1), 2.0 * np.sin(-0.1)])
    assert len(log.scans.at(2.0)) == 2
    assert log.maps.times == [pytest.approx(6.0)]
    assert log.maps.at(7.0).values.shape == (2, 3)


def test_wheels_without_torque_are_named(tmp_path):
    def health(**states):
        message = s.status(**states)
        message.name = "/platform_controller"
        return message

    log = log_of(
        tmp_path,
        [
            (101.0, "/wheel_health", health(a="driving", b="dead", c="idle", torque="measured")),
            (102.0, "/wheel_health", health(a="driving", b="driving", c="driving")),
        ],
    )
    assert [log.dead_wheels.at(time) for time in (1.9, 2.1, 4.1)] == [None, ("b", "c"), ()]


def test_the_first_reason_of_a_stop_is_the_one_that_counts(tmp_path):
    def stop(name, level, reason=""):
        message = s.status(reason=reason)
        message.name, message.level = name, level
        return message

    log = log_of(
        tmp_path,
        [
            (101.0, "/stop_state", stop("/a", 2, "emergency_stop")),
            (101.5, "/stop_state", stop("/b", 2, "peer /a")),
            (102.0, "/stop_state", stop("/a", 0)),
            (103.0, "/stop_state", stop("/b", 0)),
        ],
    )
    reasons = [log.stop_reason(time) for time in (1.9, 2.1, 3.1, 4.1, 6.1)]
    assert reasons == ["", "emergency_stop", "emergency_stop", "peer /a", ""]


def test_wheel_angles_are_in_the_order_of_the_first_message(tmp_path):
    log = log_of(
        tmp_path,
        [
            (101.0, "/wheel_states", s.joints(2.0, ("a", "b"), (1, 2), (0, 0), (0, 0))),
            (102.0, "/wheel_states", s.joints(4.0, ("b", "a"), (4, 3), (0, 0), (0, 0))),
            (103.0, "/wheel_states", s.joints(6.0, ("a", "x"), (5, 6), (0, 0), (0, 0))),
        ],
    )
    assert log.wheels.tolist() == [[2.0, 1.0, 2.0], [4.0, 3.0, 4.0]]


def test_a_value_holds_from_its_time_on_in_whatever_order_it_was_added():
    values = series((2.0, "b"), (1.0, "a"), (3.0, "c"))
    assert [values.at(time) for time in (0.5, 1.0, 2.5, 9.0)] == [None, "a", "b", "c"]
    assert FilmLog(RobotLog()).stop_reason(1.0) == ""
