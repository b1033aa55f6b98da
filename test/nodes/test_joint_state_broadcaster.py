from xml.etree import ElementTree as xml

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes.joint_state_broadcaster import JointStateBroadcasterNode
from omniman_ros.nodes.stopping import LATCHED
from test import robots

from .harness import PERIOD, World, last

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
BOTH = [*WHEELS, *UR_JOINTS]
TIMEOUT = 0.5


class Robot:
    """Wheels and arm of the probe's, heard by the node, and what it makes of them."""

    def __init__(self, world):
        self.world = world
        self.wheels = world.publisher(JointState, "wheel_states")
        self.arm = world.publisher(JointState, "arm/joint_states")
        self.joint_states = world.listen(JointState, "joint_states")

    def say(self, publisher, names, ahead=0.0, **parts):
        message = JointState(name=list(names), **parts)
        message.header.stamp = self.world.stamp(ahead)
        publisher.publish(message)
        return message

    def say_wheels(self, value=1.0, ahead=0.0, **parts):
        parts = {"position": [value] * 4, "velocity": [0.1] * 4, "effort": [0.2] * 4} | parts
        return self.say(self.wheels, WHEELS, ahead, **parts)

    def say_arm(self, value=2.0, ahead=0.0, **parts):
        parts = {"position": [value] * 6, "velocity": [0.3] * 6, "effort": [0.4] * 6} | parts
        return self.say(self.arm, UR_JOINTS, ahead, **parts)

    def next(self, seconds=0.05):
        """The last message after a while, or None if none came."""
        self.joint_states.clear()
        self.world.run(seconds)
        return self.joint_states[-1] if self.joint_states else None


@pytest.fixture
def world():
    with World(JointStateBroadcasterNode) as world:
        yield world


@pytest.fixture
def robot(world):
    return Robot(world)


@pytest.fixture
def warnings(world, monkeypatch):
    said = []
    monkeypatch.setattr(world.nodes[0], "warn", lambda subject, text: said.append(text))
    return said


# ---- both together ------------------------------------------------------------------------------


def test_wheels_and_arm_are_one_message_with_every_name_once(robot):
    robot.say_wheels()
    robot.say_arm()
    message = robot.next()
    assert message.name == BOTH
    assert list(message.position) == [1.0] * 4 + [2.0] * 6
    assert list(message.velocity) == [0.1] * 4 + [0.3] * 6
    assert list(message.effort) == [0.2] * 4 + [0.4] * 6


@pytest.mark.parametrize(("wheels", "arm"), [(0.0, -0.02), (-0.02, 0.0)])
def test_the_stamp_is_that_of_the_newer_part(robot, wheels, arm):
    said = [robot.say_wheels(ahead=wheels), robot.say_arm(ahead=arm)]
    assert robot.next().header.stamp == said[wheels < arm].header.stamp


def test_without_a_stamp_it_is_now(robot):
    message = JointState(name=list(WHEELS), position=[1.0] * 4)
    robot.wheels.publish(message)
    stamp = robot.next().header.stamp
    assert robot.world.time - 0.05 <= stamp.sec + stamp.nanosec * 1e-9 <= robot.world.time


@pytest.mark.parametrize("label", ["velocity", "effort"])
def test_what_one_part_does_not_tell_is_told_of_none(robot, label):
    robot.say_wheels()
    robot.say_arm(**{label: []})
    message = robot.next()
    assert not getattr(message, label)
    assert len(message.position) == 10
    other = "effort" if label == "velocity" else "velocity"
    assert len(getattr(message, other)) == 10


def test_joints_come_in_the_order_of_the_parameters(robot):
    robot.say(robot.wheels, WHEELS[::-1], position=[4.0, 3.0, 2.0, 1.0])
    assert list(robot.next().position) == [1.0, 2.0, 3.0, 4.0]


def test_joints_of_others_are_left_out(robot):
    robot.say(robot.arm, [*UR_JOINTS, "gripper"], position=[1.0] * 7)
    assert robot.next().name == list(UR_JOINTS)


# ---- what is known now --------------------------------------------------------------------------


def test_nothing_is_published_before_anything_is_heard(robot):
    assert robot.next(1.0) is None


@pytest.mark.parametrize("part", ["wheels", "arm"])
def test_one_part_alone_is_published(robot, part):
    getattr(robot, f"say_{part}")()
    assert robot.next().name == list(WHEELS if part == "wheels" else UR_JOINTS)


@pytest.mark.parametrize(
    ("dead", "left"), [("arm", list(WHEELS)), ("wheels", list(UR_JOINTS))]
)  # fmt: skip
def test_a_part_that_is_silent_is_left_out_after_the_timeout_and_no_sooner(robot, dead, left):
    living = robot.say_wheels if dead == "arm" else robot.say_arm
    getattr(robot, f"say_{dead}")()
    robot.joint_states.clear()
    begin = robot.world.time
    robot.world.run(1.0, each=living)
    without = [message.header.stamp for message in robot.joint_states if message.name == left]
    whole = [message.header.stamp for message in robot.joint_states if message.name == BOTH]
    assert len(without) + len(whole) == len(robot.joint_states)
    first, final = ((s.sec + s.nanosec * 1e-9 - begin) for s in (without[0], whole[-1]))
    assert first == pytest.approx(TIMEOUT, abs=0.02 + 2 * PERIOD)
    assert final == pytest.approx(TIMEOUT, abs=0.02 + 2 * PERIOD)
    assert first > final


def test_what_is_old_when_it_comes_is_not_shown_as_living(robot):
    robot.say_arm(ahead=-TIMEOUT - 0.1)
    assert robot.next() is None


def test_a_part_that_comes_back_is_there_again(robot):
    robot.say_arm()
    robot.world.run(1.0)
    robot.say_arm(value=7.0)
    assert list(robot.next().position) == [7.0] * 6


def test_no_stamp_is_published_twice(robot):
    """tf2 complains of a transform that it has had."""
    robot.say_wheels()
    robot.world.run(0.3)
    assert len(robot.joint_states) == 1


def test_the_rate_is_that_of_the_parameter(robot):
    robot.world.run(0.1, each=robot.say_wheels)
    robot.joint_states.clear()
    robot.world.run(1.0, each=robot.say_wheels)
    assert len(robot.joint_states) == pytest.approx(50, abs=1)


def test_another_rate_and_timeout_can_be_set():
    given = {"rate": 100.0, "timeout": 0.1}
    with World(JointStateBroadcasterNode, parameters=given) as world:
        robot = Robot(world)
        robot.say_arm()
        robot.world.run(0.2, each=robot.say_wheels)
        assert last(robot.joint_states).name == list(WHEELS)
        robot.joint_states.clear()
        robot.world.run(1.0, each=robot.say_wheels)
        assert len(robot.joint_states) == pytest.approx(100, abs=1)


def test_after_simulated_time_went_back_it_goes_on_with_what_is_new(robot):
    robot.say_wheels()
    robot.say_arm()
    assert robot.next().name == BOTH
    robot.world.time -= 100.0
    robot.world.run(0.05)
    robot.say_wheels(value=5.0)
    message = robot.next()
    assert message.name == list(WHEELS)
    assert list(message.position) == [5.0] * 4


# ---- bad input ----------------------------------------------------------------------------------

NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"position": [1.0, NAN, 1.0, 1.0]}, "position"),
        ({"position": [1.0, INF, 1.0, 1.0]}, "position"),
        ({"position": [1.0, 1e13, 1.0, 1.0]}, "position"),
        ({"velocity": [NAN] * 4}, "velocity"),
        ({"effort": [0.0, 0.0, 0.0, -INF]}, "effort"),
        ({"position": []}, "no position"),
        ({"position": [1.0] * 3}, "3 position values for 4 names"),
        ({"velocity": [1.0] * 5}, "5 velocity values for 4 names"),
        ({"ahead": 0.2}, "ahead"),
        ({"ahead": -0.1}, "out of order"),
    ],
)
def test_bad_states_are_ignored_with_a_warning_and_the_last_good_ones_stay(
    robot, warnings, parts, message
):
    robot.say_wheels()
    assert robot.next() is not None
    robot.say_wheels(value=9.0, **parts)
    robot.say_arm()
    assert list(robot.next().position) == [1.0] * 4 + [2.0] * 6
    (warning,) = warnings
    assert warning.startswith("wheel_states ignored: ")
    assert message in warning


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["front_left"] * 4, "twice"),
        (["front_left", "front_right", "rear_left", "rear_middle"], "no rear_right"),
        (UR_JOINTS[:4], "no front_left"),
    ],
)
def test_states_with_other_names_are_ignored_with_a_warning(robot, warnings, names, message):
    robot.say(robot.wheels, names, position=[1.0] * 4)
    assert robot.next() is None
    (warning,) = warnings
    assert message in warning


def test_a_joint_of_the_arm_named_like_a_wheel_is_refused_at_the_start():
    names = [*UR_JOINTS[:5], "rear_left"]
    with pytest.raises(ParameterError, match="'rear_left' is also a wheel"):
        World(JointStateBroadcasterNode, parameters={"arm.joints": names})


# ---- URDF ---------------------------------------------------------------------------------------


def test_the_urdf_is_latched_and_has_the_joints_that_are_published(world, robot):
    (message,) = world.listen(String, "robot_description", LATCHED)
    root = xml.fromstring(message.data)
    moving = [j.get("name") for j in root.findall("joint") if j.get("type") != "fixed"]
    robot.say_wheels()
    robot.say_arm()
    assert sorted(robot.next().name) == sorted(moving)


def test_the_urdf_is_of_the_robot_and_the_parameters_that_were_given():
    given = {"robot": robots.path("omni3"), "arm.mass": 20.0, "mount.z": 0.8, "mount.x": 0.05}
    with World(JointStateBroadcasterNode, parameters=given) as world:
        (message,) = world.listen(String, "robot_description", LATCHED)
    root = xml.fromstring(message.data)
    wheels = {j.get("name") for j in root.findall("joint") if j.get("type") == "continuous"}
    assert wheels == {"front_left", "rear", "front_right"}
    mounted = root.find("joint[@name='base_link-arm_base_link']/origin")
    assert mounted.get("xyz") == "0.05 0.0 0.8"


def test_the_urdf_is_published_again_where_a_parameter_changed_it(world):
    told = world.listen(String, "robot_description", LATCHED)
    (node,) = world.nodes
    assert node.set_parameters([Parameter("timeout", value=0.7)])[0].successful
    world.run(0.05)
    assert len(told) == 1
    assert node.set_parameters([Parameter("body.mass", value=150.0)])[0].successful
    world.run(0.05)
    assert len(told) == 2
    assert told[0].data != told[1].data


def test_the_urdf_can_be_left_to_robot_state_publisher():
    with World(JointStateBroadcasterNode, parameters={"publish_description": False}) as world:
        topics = {name for name, _ in world.nodes[0].get_topic_names_and_types()}
        robot = Robot(world)
        robot.say_wheels()
        assert robot.next() is not None
    assert "/robot_description" not in topics
    assert "/joint_states" in topics


# ---- diagnostics --------------------------------------------------------------------------------


def test_the_diagnostics_tell_who_is_silent(world, robot):
    reports = world.listen(DiagnosticArray, "/diagnostics")

    def status():
        (found,) = last(reports).status
        return found

    world.run(1.1)
    assert status().level == DiagnosticStatus.WARN
    assert "waiting for wheel_states" in status().message
    robot.say_arm()
    world.run(0.3)
    assert status().level == DiagnosticStatus.OK, "a platform or an arm alone is a robot too"
    world.run(1.0)
    assert status().level == DiagnosticStatus.WARN
    assert "no arm/joint_states any more" in status().message
    values = {value.key: value.value for value in status().values}
    assert values["arm/joint_states"] == values["wheel_states"] == "silent"
