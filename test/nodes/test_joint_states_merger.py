from xml.etree import ElementTree

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes.joint_states_merger import JointStatesMergerNode
from omniman_ros.nodes.stop_interface import LATCHED
from test import robots
from test.nodes.harness import PERIOD, World, last

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
ALL_JOINTS = [*(f"{wheel}_wheel_joint" for wheel in WHEELS), *UR_JOINTS]
TIMEOUT = 0.5


class JointStateSources:
    """Publishes the states of wheels and arm and receives the merged joint states."""

    def __init__(self, world):
        self.world = world
        self.wheels = world.publisher(JointState, "wheel_states")
        self.arm = world.publisher(JointState, "arm/joint_states")
        self.joint_states = world.listen(JointState, "joint_states")

    def publish_states(self, publisher, names, ahead=0.0, **parts):
        message = JointState(name=list(names), **parts)
        message.header.stamp = self.world.stamp(ahead)
        publisher.publish(message)
        return message

    def publish_wheels(self, value=1.0, ahead=0.0, **parts):
        parts = {"position": [value] * 4, "velocity": [0.1] * 4, "effort": [0.2] * 4} | parts
        return self.publish_states(self.wheels, WHEELS, ahead, **parts)

    def publish_arm(self, value=2.0, ahead=0.0, **parts):
        parts = {"position": [value] * 6, "velocity": [0.3] * 6, "effort": [0.4] * 6} | parts
        return self.publish_states(self.arm, UR_JOINTS, ahead, **parts)

    def latest(self, seconds=0.05):
        """Run for a while and return the latest message, or None if none arrived."""
        self.joint_states.clear()
        self.world.run(seconds)
        return self.joint_states[-1] if self.joint_states else None


@pytest.fixture
def world():
    with World(JointStatesMergerNode) as world:
        yield world


@pytest.fixture
def robot(world):
    return JointStateSources(world)


@pytest.fixture
def warnings(world, monkeypatch):
    texts = []
    monkeypatch.setattr(world.nodes[0], "warn", lambda subject, text: texts.append(text))
    return texts


# ---- merging ----------------------------------------------------------------------------------


def test_wheels_and_arm_are_merged_with_every_name_once(robot):
    robot.publish_wheels()
    robot.publish_arm()
    message = robot.latest()
    assert message.name == ALL_JOINTS
    assert list(message.position) == [1.0] * 4 + [2.0] * 6
    assert list(message.velocity) == [0.1] * 4 + [0.3] * 6
    assert list(message.effort) == [0.2] * 4 + [0.4] * 6


@pytest.mark.parametrize(("wheels", "arm"), [(0.0, -0.02), (-0.02, 0.0)])
def test_the_stamp_is_that_of_the_newer_part(robot, wheels, arm):
    published = [robot.publish_wheels(ahead=wheels), robot.publish_arm(ahead=arm)]
    assert robot.latest().header.stamp == published[wheels < arm].header.stamp


def test_a_missing_stamp_is_replaced_by_the_present_time(robot):
    message = JointState(name=list(WHEELS), position=[1.0] * 4)
    robot.wheels.publish(message)
    stamp = robot.latest().header.stamp
    assert robot.world.time - 0.05 <= stamp.sec + stamp.nanosec * 1e-9 <= robot.world.time


@pytest.mark.parametrize("label", ["velocity", "effort"])
def test_a_field_that_one_part_lacks_is_omitted_for_both(robot, label):
    robot.publish_wheels()
    robot.publish_arm(**{label: []})
    message = robot.latest()
    assert not getattr(message, label)
    assert len(message.position) == 10
    other = "effort" if label == "velocity" else "velocity"
    assert len(getattr(message, other)) == 10


def test_joints_are_published_in_the_order_of_the_parameters(robot):
    robot.publish_states(robot.wheels, WHEELS[::-1], position=[4.0, 3.0, 2.0, 1.0])
    assert list(robot.latest().position) == [1.0, 2.0, 3.0, 4.0]


def test_unknown_joints_are_omitted(robot):
    robot.publish_states(robot.arm, [*UR_JOINTS, "gripper"], position=[1.0] * 7)
    assert robot.latest().name == list(UR_JOINTS)


# ---- freshness --------------------------------------------------------------------------------


def test_nothing_is_published_before_the_first_message(robot):
    assert robot.latest(1.0) is None


@pytest.mark.parametrize("part", ["wheels", "arm"])
def test_a_single_part_is_published(robot, part):
    getattr(robot, f"publish_{part}")()
    assert robot.latest().name == (ALL_JOINTS[:4] if part == "wheels" else ALL_JOINTS[4:])


@pytest.mark.parametrize(("dead", "left"), [("arm", ALL_JOINTS[:4]), ("wheels", list(UR_JOINTS))])
def test_a_silent_part_is_omitted_exactly_after_the_timeout(robot, dead, left):
    living = robot.publish_wheels if dead == "arm" else robot.publish_arm
    getattr(robot, f"publish_{dead}")()
    robot.joint_states.clear()
    begin = robot.world.time
    robot.world.run(1.0, each=living)
    without = [message.header.stamp for message in robot.joint_states if message.name == left]
    complete = [
        message.header.stamp for message in robot.joint_states if message.name == ALL_JOINTS
    ]
    assert len(without) + len(complete) == len(robot.joint_states)
    first, final = ((s.sec + s.nanosec * 1e-9 - begin) for s in (without[0], complete[-1]))
    assert first == pytest.approx(TIMEOUT, abs=0.02 + 2 * PERIOD)
    assert final == pytest.approx(TIMEOUT, abs=0.02 + 2 * PERIOD)
    assert first > final


def test_states_that_arrive_outdated_are_not_published(robot):
    robot.publish_arm(ahead=-TIMEOUT - 0.1)
    assert robot.latest() is None


def test_a_part_that_reports_again_is_published_again(robot):
    robot.publish_arm()
    robot.world.run(1.0)
    robot.publish_arm(value=7.0)
    assert list(robot.latest().position) == [7.0] * 6


def test_no_stamp_is_published_twice(robot):
    """tf2 warns about a repeated transform."""
    robot.publish_wheels()
    robot.world.run(0.3)
    assert len(robot.joint_states) == 1


def test_the_rate_is_set_by_the_parameter(robot):
    robot.world.run(0.1, each=robot.publish_wheels)
    robot.joint_states.clear()
    robot.world.run(1.0, each=robot.publish_wheels)
    assert len(robot.joint_states) == pytest.approx(50, abs=1)


def test_rate_and_timeout_can_be_changed():
    given = {"rate": 100.0, "timeout": 0.1}
    with World(JointStatesMergerNode, parameters=given) as world:
        robot = JointStateSources(world)
        robot.publish_arm()
        robot.world.run(0.2, each=robot.publish_wheels)
        assert last(robot.joint_states).name == ALL_JOINTS[:4]
        robot.joint_states.clear()
        robot.world.run(1.0, each=robot.publish_wheels)
        assert len(robot.joint_states) == pytest.approx(100, abs=1)


def test_publishing_continues_with_new_states_after_a_jump_back_in_time(robot):
    robot.publish_wheels()
    robot.publish_arm()
    assert robot.latest().name == ALL_JOINTS
    robot.world.time -= 100.0
    robot.world.run(0.05)
    robot.publish_wheels(value=5.0)
    message = robot.latest()
    assert message.name == ALL_JOINTS[:4]
    assert list(message.position) == [5.0] * 4


# ---- invalid input ----------------------------------------------------------------------------

NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"position": [1.0, NAN, 1.0, 1.0]}, "position"),
        ({"velocity": [NAN] * 4}, "velocity"),
        ({"effort": [0.0, 0.0, 0.0, -INF]}, "effort"),
        ({"ahead": 0.2}, "ahead"),
        ({"ahead": -0.1}, "out of order"),
    ],
)
def test_invalid_states_are_ignored_with_a_warning_and_the_last_valid_ones_kept(
    robot, warnings, parts, message
):
    robot.publish_wheels()
    assert robot.latest() is not None
    robot.publish_wheels(value=9.0, **parts)
    robot.publish_arm()
    assert list(robot.latest().position) == [1.0] * 4 + [2.0] * 6
    (warning,) = warnings
    assert warning.startswith("wheel_states ignored: ")
    assert message in warning


def test_an_arm_joint_with_the_name_of_a_wheel_is_refused_at_startup():
    names = [*UR_JOINTS[:5], "rear_left"]
    with pytest.raises(ParameterError, match="'rear_left' is also a wheel"):
        World(JointStatesMergerNode, parameters={"arm.joints": names})


# ---- URDF -------------------------------------------------------------------------------------


def test_the_urdf_is_latched_and_contains_the_published_joints(world, robot):
    (message,) = world.listen(String, "robot_description", LATCHED)
    root = ElementTree.fromstring(message.data)
    moving = [j.get("name") for j in root.findall("joint") if j.get("type") != "fixed"]
    robot.publish_wheels()
    robot.publish_arm()
    assert sorted(robot.latest().name) == sorted(moving)


def test_the_urdf_describes_the_configured_robot():
    given = {"robot": robots.path("omni3"), "arm.mass": 20.0, "mount.z": 0.8, "mount.x": 0.05}
    with World(JointStatesMergerNode, parameters=given) as world:
        (message,) = world.listen(String, "robot_description", LATCHED)
    root = ElementTree.fromstring(message.data)
    wheels = {j.get("name") for j in root.findall("joint") if j.get("type") == "continuous"}
    assert wheels == {f"{wheel}_wheel_joint" for wheel in ("front_left", "rear", "front_right")}
    mounted = root.find("joint[@name='base_link-arm_base_link']/origin")
    assert mounted.get("xyz") == "0.05 0.0 0.8"


def test_the_urdf_is_published_again_when_a_parameter_changes_it(world):
    descriptions = world.listen(String, "robot_description", LATCHED)
    (node,) = world.nodes
    assert node.set_parameters([Parameter("timeout", value=0.7)])[0].successful
    world.run(0.05)
    assert len(descriptions) == 1
    assert node.set_parameters([Parameter("body.mass", value=150.0)])[0].successful
    world.run(0.05)
    assert len(descriptions) == 2
    assert descriptions[0].data != descriptions[1].data


def test_publishing_the_urdf_can_be_left_to_robot_state_publisher():
    with World(JointStatesMergerNode, parameters={"publish_description": False}) as world:
        topics = {name for name, _ in world.nodes[0].get_topic_names_and_types()}
        robot = JointStateSources(world)
        robot.publish_wheels()
        assert robot.latest() is not None
    assert "/robot_description" not in topics
    assert "/joint_states" in topics


# ---- diagnostics ------------------------------------------------------------------------------


def test_the_diagnostics_name_the_silent_part(world, robot):
    reports = world.listen(DiagnosticArray, "/diagnostics")

    def status():
        (found,) = last(reports).status
        return found

    world.run(1.1)
    assert status().level == DiagnosticStatus.WARN
    assert "waiting for wheel_states" in status().message
    robot.publish_arm()
    world.run(0.3)
    assert status().level == DiagnosticStatus.OK, "a platform or an arm alone is a robot too"
    assert status().hardware_id == "omniman", "the robot, by the name of its file"
    world.run(1.0)
    assert status().level == DiagnosticStatus.WARN
    assert "no arm/joint_states any more" in status().message
    values = {value.key: value.value for value in status().values}
    assert values["arm/joint_states"] == values["wheel_states"] == "silent"
