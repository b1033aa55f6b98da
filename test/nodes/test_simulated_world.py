"""The simulated world's node over real topics, on simulated time."""

import math

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import Bool, Float64MultiArray
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros import extras
from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes import simulated_world
from omniman_ros.nodes.simulated_world import SimulatedWorldNode
from test.nodes.harness import World, last

pytest.importorskip("mujoco")

NAMES = ["front_left", "front_right", "rear_left", "rear_right"]
RADIUS = 0.127  # of omniman's wheels
FRONT = 0.5  # where omniman ends
SCENE = """
start: [0.0, 0.0, 0.0]
walls:
  - {name: wall, x: [3, 3], y: [-9, 9], thickness: 0.2}
posts:
  - {name: post, x: 1.1, y: 0.0, radius: 0.1, height: 0.3}
crates:
  - {name: crate, x: -3.0, y: 2.0, yaw: 0.5, length: 0.6, width: 0.4, height: 0.32}
persons:
  - {name: anna, x: [-2.0], y: [1.0], radius: 0.3, height: 1.7}
"""


class Robot(World):
    """The node on its own in `SCENE`, commanded by the test."""

    def __init__(self, scene: str, parameters: dict | None = None) -> None:
        given = {"scene": scene, "world.wheels": "ideal"} | (parameters or {})
        super().__init__(SimulatedWorldNode, parameters=given)
        self.node: SimulatedWorldNode = self.nodes[0]
        self.truth = self.listen(Odometry, "ground_truth/odom")
        self._commands = self.publisher(JointState, "wheel_commands")

    def drive(self, seconds: float, speed: float) -> None:
        """Command all wheels to a speed of their rims [m/s]."""
        message = JointState(name=NAMES, velocity=[speed / RADIUS] * 4)

        def command() -> None:
            message.header.stamp = self.stamp()
            self._commands.publish(message)

        self.run(seconds, command)

    def put(self, x: float, y: float) -> None:
        message = PoseWithCovarianceStamped()
        message.header.frame_id = "map"
        message.pose.pose.position.x, message.pose.pose.position.y = x, y
        message.pose.pose.orientation.w = 1.0
        self.publisher(PoseWithCovarianceStamped, "initialpose").publish(message)
        self.run(0.1)

    def set(self, name: str, value: object) -> object:
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        return self.call(SetParameters, "simulated_world/set_parameters", request).results[0]

    @property
    def x(self) -> float:
        return last(self.truth).pose.pose.position.x


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE)
    return str(path)


@pytest.fixture
def robot(scene):
    with Robot(scene) as robot:
        yield robot


@pytest.mark.parametrize("wheels", ["ideal", "rollers"])
def test_commands_turn_the_wheels_and_move_the_robot(scene, wheels):
    with Robot(scene, {"world.wheels": wheels}) as robot:
        states = robot.listen(JointState, "wheel_states")
        robot.drive(1.0, -0.3)
        assert list(last(states).velocity) == pytest.approx([-0.3 / RADIUS] * 4, abs=0.1)
        assert last(robot.truth).twist.twist.linear.x == pytest.approx(-0.3, abs=0.02)
        assert last(robot.truth).header.frame_id == "map"
        robot.run(1.0)
        assert last(robot.truth).twist.twist.linear.x == pytest.approx(0.0, abs=0.01), "watchdog"


def test_an_emergency_stop_stops_the_robot_and_commands_do_not_move_it(robot):
    robot.drive(0.5, -0.3)
    robot.publisher(Bool, "emergency_stop").publish(Bool(data=True))
    robot.drive(1.0, -0.3)
    assert last(robot.truth).twist.twist.linear.x == pytest.approx(0.0, abs=0.01)


def test_topics_have_their_rates(robot):
    topics = {
        "wheel_states": (JointState, 200),
        "ground_truth/odom": (Odometry, 100),
        "ground_truth/obstacles": (MarkerArray, 20),
        "wheel_electrical": (Float64MultiArray, 50),
        "wheel_loads": (Float64MultiArray, 50),
        "scan": (LaserScan, 20),
    }
    heard = {topic: robot.listen(kind, topic) for topic, (kind, _) in topics.items()}
    robot.run(0.1)
    before = {topic: len(messages) for topic, messages in heard.items()}
    robot.run(1.0)
    for topic, (_, rate) in topics.items():
        assert len(heard[topic]) - before[topic] == pytest.approx(rate, abs=1), topic


def test_the_scanner_changes_at_runtime(robot):
    scans = robot.listen(LaserScan, "scan")
    robot.run(0.1)
    (before,) = last(scans).ranges[360:361]
    assert before == pytest.approx(1.0 - 0.55, abs=0.01), "the near side of the post"
    assert robot.set("scanners.x", [0.65]).successful
    robot.run(0.1)
    assert last(scans).ranges[360] == pytest.approx(before - 0.1, abs=1e-3)
    assert robot.set("scanners.dropouts", [1.0]).successful
    robot.run(0.1)
    assert all(map(math.isinf, last(scans).ranges))


def test_several_scanners_have_their_topics_frames_poses_and_rates(scene):
    """The wall's near side is 2.9 m ahead; behind there is nothing."""
    given = {
        "scanners.name": ["front", "rear"],
        "scanners.x": [0.55, -0.55],
        "scanners.yaw": [0.0, math.pi],
        "scanners.z": [0.4],
        "scanners.field_of_view": [0.2],
        "scanners.beams": [11, 21],
        "scanners.rate": [40.0, 10.0],
    }
    with Robot(scene, given) as robot:
        front, rear = (robot.listen(LaserScan, f"{name}/scan") for name in ("front", "rear"))
        robot.run(1.0)
        assert (len(front), len(rear)) == (pytest.approx(40, abs=1), pytest.approx(10, abs=1))
        assert last(front).header.frame_id == "front"
        assert last(rear).header.frame_id == "rear"
        assert last(front).ranges[5] == pytest.approx(2.9 - 0.55, abs=0.01)
        assert len(last(rear).ranges) == 21
        assert all(map(math.isinf, last(rear).ranges))


def test_a_fault_of_one_scanner_leaves_the_other_alone(scene):
    given = {"scanners.name": ["left", "right"], "scanners.z": [0.4], "scanners.noise": [0.01]}
    with Robot(scene, given) as robot:
        left, right = (robot.listen(LaserScan, f"{name}/scan") for name in ("left", "right"))
        robot.run(0.5)
        assert robot.set("scanners.fault", ["none", "frozen"]).successful
        robot.run(0.5)
        assert last(right).ranges == right[-5].ranges
        assert last(right).header.stamp != right[-5].header.stamp
        assert last(left).ranges != left[-5].ranges
        assert robot.set("scanners.fault", ["none", "silent"]).successful
        robot.run(0.1)
        count = len(right)
        robot.run(0.5)
        assert len(right) == count
        assert not robot.set("scanners.fault", ["none", "none", "none"]).successful


def test_a_contact_is_told_within_10_ms_and_its_end_too(robot):
    contacts = robot.listen(DiagnosticArray, "contacts")
    reached = None
    for _ in range(600):
        robot.drive(0.005, 0.3)
        if reached is None and robot.node.world.pose[0] + FRONT >= 1.0:
            reached = robot.time
        if contacts:
            break
        assert reached is None or robot.time - reached < 0.010
    first = contacts[0]
    assert reached is not None
    assert first.header.stamp.sec + 1e-9 * first.header.stamp.nanosec - reached <= 0.010
    (status,) = first.status
    values = {item.key: item.value for item in status.values}
    assert (values["part"], values["thing"]) == ("base_link", "post")
    assert status.level == DiagnosticStatus.WARN
    assert (float(values["x"]), float(values["y"])) == pytest.approx((1.0, 0.0), abs=0.02)
    assert float(values["force_x"]) < 0.0
    robot.drive(1.5, -0.3)
    assert not last(contacts).status
    count = len(contacts)
    robot.run(0.1)
    assert len(contacts) == count


def test_obstacles_are_shown_where_they_are(robot):
    messages = robot.listen(MarkerArray, "ground_truth/obstacles")
    robot.run(0.1)
    anna, crate = last(messages).markers
    assert (anna.ns, anna.type, anna.header.frame_id) == ("anna", Marker.CYLINDER, "map")
    assert (anna.scale.x, anna.scale.y, anna.scale.z) == (0.6, 0.6, 1.7)
    assert (anna.pose.position.x, anna.pose.position.y) == pytest.approx((-2.0, 1.0), abs=1e-3)
    assert (crate.ns, crate.type) == ("crate", Marker.CUBE)
    assert (crate.scale.x, crate.scale.y, crate.scale.z) == (0.6, 0.4, 0.32)
    assert crate.pose.position.x == pytest.approx(-3.0, abs=1e-3)
    assert 2.0 * math.atan2(crate.pose.orientation.z, crate.pose.orientation.w) == pytest.approx(
        0.5, abs=1e-3
    )


def test_initialpose_puts_the_robot_where_there_is_room_only(robot):
    robot.put(-0.5, -2.0)
    assert robot.x == pytest.approx(-0.5, abs=1e-3)
    assert "initialpose" not in robot.node.warning_counts
    robot.put(3.0, 0.0)
    assert robot.x == pytest.approx(-0.5, abs=1e-3)
    assert robot.node.warning_counts["initialpose"] == 1


def test_faults_change_at_runtime(robot):
    states = robot.listen(JointState, "wheel_states")
    robot.drive(0.5, -0.3)
    assert robot.set("faults.dead_motor", ["rear_left"]).successful
    robot.drive(0.2, -0.3)
    assert abs(last(states).effort[2]) < 1e-6
    assert not robot.set("faults.dead_motor", ["no_such_wheel"]).successful


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("scene", "nowhere"),
        ("world.wheels", "square"),
        ("world.posture", [0.0, 1.0]),
        ("scanners.range_max", [0.2]),
        ("scanners.beams", [1]),
        ("arm.joints", ["a"] * 6),
        ("scanners.rate", [0.0]),
        ("scanners.name", ["front", "front"]),
        ("scanners.yaw", [0.0, 1.0]),
    ],
)
def test_a_bad_parameter_is_refused_by_name(scene, name, value):
    given = {"scanners.range_min": [0.3], name: value}
    with pytest.raises(ParameterError) as refused:
        Robot(scene, given)
    assert refused.value.name == name


def test_a_start_in_something_is_refused(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text("posts: [{name: post, x: 0.3, y: 0.0}]")
    with pytest.raises(ParameterError, match="post"):
        Robot(str(path))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("scanners.noise", [-1.0]),
        ("scanners.range_max", [0.01]),
        ("scanners.beams", [10]),
        ("mismatch.friction", [1.0, 2.0]),
        ("scene", "empty"),
    ],
)
def test_a_bad_change_is_refused_and_changes_nothing(robot, name, value):
    before = robot.node.settings.value
    assert not robot.set(name, value).successful
    assert robot.node.settings.value == before


def test_without_the_engine_the_node_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    assert simulated_world.main() == 1
    assert "pip install 'mujoco-core==4.*'" in capsys.readouterr().err
