"""Tests of the configuration of MoveIt against the robot that it is for."""

import itertools
import math
from xml.etree import ElementTree

import numpy as np
import pytest

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes.registry import node_specs
from omniman_ros.processes.moveit_setup import moveit_configuration

ROBOT = "omniman"


@pytest.fixture(scope="module")
def configuration():
    return moveit_configuration(ROBOT)


@pytest.fixture(scope="module")
def srdf(configuration):
    return ElementTree.fromstring(configuration.srdf)


@pytest.fixture(scope="module")
def urdf(configuration):
    return ElementTree.fromstring(configuration.description.urdf)


def names(root, tag):
    return {element.get("name") for element in root.findall(tag)}


def test_the_semantic_description_names_links_and_joints_of_the_urdf(srdf, urdf):
    links, joints = names(urdf, "link"), names(urdf, "joint")
    assert srdf.get("name") == urdf.get("name")
    (chain,) = srdf.iter("chain")
    assert {chain.get("base_link"), chain.get("tip_link")} <= links
    (planar,) = srdf.findall("virtual_joint")
    assert (planar.get("type"), planar.get("parent_frame")) == ("planar", "odom")
    assert planar.get("child_link") == "base_link"
    wheels = {e.get("name") for e in urdf.findall("joint") if e.get("type") == "continuous"}
    assert names(srdf, "passive_joint") == wheels <= joints
    groups = {group.get("name"): group for group in srdf.findall("group")}
    assert {group.get("name") for group in groups["whole_body"]} == {"arm", "base"} < set(groups)
    for pair in srdf.findall("disable_collisions"):
        assert {pair.get("link1"), pair.get("link2")} <= links


def test_neighbours_are_not_checked_and_reachable_pairs_are(srdf, urdf):
    pairs = [
        frozenset((pair.get("link1"), pair.get("link2")))
        for pair in srdf.findall("disable_collisions")
    ]
    assert len(pairs) == len(set(pairs))
    links = urdf.findall("link")
    solid = {link.get("name") for link in links if link.find("collision") is not None}
    for joint in urdf.findall("joint"):
        ends = frozenset((joint.find("parent").get("link"), joint.find("child").get("link")))
        assert ends in pairs or not ends <= solid
    for ends in (("base_link", "wrist_3_link"), ("shoulder_link", "wrist_1_link")):
        assert frozenset(ends) not in pairs


def test_all_axes_may_be_at_their_limits_at_once(configuration):
    """MoveIt knows neither the length of a velocity nor the wheels."""
    limits = configuration.joint_limits["joint_limits"]
    robot, path = configuration.description.robot, configuration.path
    platform = [limits[f"platform/{label}"] for label in ("x", "y", "theta")]
    corners = itertools.product((-1.0, 1.0), repeat=3)
    twists = np.array(list(corners)) * [limit["max_velocity"] for limit in platform]
    wheels = PlatformKinematics(robot.wheels).J @ twists.T
    assert np.abs(wheels).max() < robot.motor.max_speed
    assert np.hypot(*twists[0, :2]) < path.limits.linear_velocity
    assert math.hypot(*(limit["max_acceleration"] for limit in platform[:2])) < min(
        path.limits.linear_acceleration, path.limits.linear_deceleration
    )
    elbow = configuration.description.arm.each("velocity")[2]
    assert limits["elbow_joint"]["max_velocity"] == elbow


def test_controllers_are_the_actions_of_the_interpolator(configuration):
    controllers = configuration.controllers["moveit_simple_controller_manager"]
    actions = {
        f"{name}/{controllers[name]['action_ns']}" for name in controllers["controller_names"]
    }
    defaults = {spec.name: spec.default for spec in node_specs("path_interpolator")}
    assert actions == {defaults["arm_action"], defaults["body_action"]}
    limited = set(configuration.joint_limits["joint_limits"])
    assert limited == set(controllers["body_controller"]["joints"])


def test_a_robot_without_an_arm_has_no_configuration():
    with pytest.raises(ParameterError, match=r"arm\.mass"):
        moveit_configuration("ig42")


def test_parameters_go_before_those_of_the_robot(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("/**:\n  ros__parameters:\n    arm.velocity: [1.0]\n    mount.z: 0.7\n")
    made = moveit_configuration(ROBOT, str(file), {"mount.z": 0.8})
    assert made.joint_limits["joint_limits"]["elbow_joint"]["max_velocity"] == 1.0
    assert made.description.mount.z == 0.8
