"""The posture of the arm in the footprint of the planner."""

import math

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes.mpc_planner.inputs import (
    ArmConfigurationInterface,
    ArmConfigurationSource,
)
from omniman_ros.nodes.mpc_planner.parameters import MpcPlannerParameters
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from test.nodes.harness import World

STRETCHED = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
REST = (0.0, -math.pi / 2, math.pi / 2, -math.pi / 2, -math.pi / 2, 0.0)
AHEAD = np.zeros(1)


class Listener(OmnimanNode):
    """A node with nothing but the posture."""

    def __init__(self, **options):
        super().__init__("mpc_planner", **options)
        self.settings = ParameterSet(self, MpcPlannerParameters)
        self.posture = ArmConfigurationInterface(self, self.settings)
        self.settings.on_change(self.posture.configure)


class PostureWorld(World):
    def __init__(self, **parameters):
        super().__init__(Listener, parameters=parameters)
        self.node = self.nodes[0]
        self.states = self.publisher(JointState, "arm/joint_states")
        self.reference = self.publisher(JointTrajectory, "arm/joint_reference")
        self.warnings = []
        warn = self.node.warn
        self.node.warn = lambda subject, text: (self.warnings.append(text), warn(subject, text))

    def send(self, q=STRETCHED, names=UR_JOINTS, stamp=None):
        message = JointState(name=list(names), position=list(q))
        message.header.stamp = self.stamp() if stamp is None else stamp
        self.states.publish(message)
        self.run(0.01)

    def stream(self, q, seconds):
        message = JointTrajectory(joint_names=list(UR_JOINTS))
        message.header.stamp = self.stamp()
        for k, position in enumerate(q):
            point = JointTrajectoryPoint(positions=list(position), velocities=[0.0] * 6)
            point.time_from_start.nanosec = round(1e9 * k * seconds / max(len(q) - 1, 1))
            message.points.append(point)
        self.reference.publish(message)
        self.run(0.01)

    @property
    def footprint(self):
        return self.node.posture.footprint(self.node.now())

    @property
    def ahead(self):
        """Distance of the farthest point ahead of base_link [m]."""
        return self.footprint.whole.support(AHEAD).item()

    @property
    def source(self):
        self.footprint  # noqa: B018 - reads what was received
        return self.node.posture.source(self.node.now())


@pytest.fixture
def world():
    with PostureWorld(robot="omniman") as made:
        yield made


def test_the_posture_is_assumed_until_it_is_measured_and_kept_when_the_arm_falls_silent(world):
    assert world.source is ArmConfigurationSource.ASSUMED
    assert world.ahead == pytest.approx(0.5)
    world.send(STRETCHED)
    assert world.source is ArmConfigurationSource.MEASURED
    assert world.ahead > 1.0
    assert not world.warnings
    world.run(0.6)
    assert world.source is ArmConfigurationSource.LAST_MEASURED
    assert world.ahead > 1.0
    assert "no arm/joint_states" in world.warnings[-1]


def test_the_names_of_the_joints_may_be_in_any_order(world):
    order = [3, 1, 5, 0, 2, 4]
    q = np.array(REST)
    q[0] = math.pi  # behind
    world.send(q[order], [UR_JOINTS[k] for k in order])
    assert world.source is ArmConfigurationSource.MEASURED
    assert world.ahead == pytest.approx(0.5, abs=0.01)


def test_states_out_of_order_or_from_the_future_are_ignored(world):
    early = world.stamp()
    world.run(0.1)
    world.send(REST)
    before = world.ahead
    world.send(STRETCHED, stamp=early)
    assert world.ahead == before
    assert "out of order" in world.warnings[-1]
    late = world.stamp()
    late.sec += 5
    world.send(STRETCHED, stamp=late)
    assert world.ahead == before
    assert "ahead" in world.warnings[-1]


def test_the_footprint_holds_where_the_arm_is_and_where_it_is_going(world):
    world.send(STRETCHED)
    turned = [(angle, *STRETCHED[1:]) for angle in (0.0, 0.4, 0.8)]
    left = np.array([0.8])
    alone = world.footprint.whole.support(left).item()
    world.stream(turned, 0.4)
    assert world.ahead > 1.0
    assert world.footprint.whole.support(left).item() > alone + 0.1
    for _ in range(6):  # the arm did not move, and the preview is over
        world.run(0.1)
        world.send(STRETCHED)
    assert world.footprint.whole.support(left).item() == pytest.approx(alone)


def test_a_reference_that_cannot_be_used_changes_nothing(world):
    world.send(STRETCHED)
    before = world.footprint.whole.support(np.array([0.8])).item()
    world.stream([(math.nan, *STRETCHED[1:])], 0.0)
    assert world.footprint.whole.support(np.array([0.8])).item() == before
    assert "arm/joint_reference ignored" in world.warnings[-1]


def test_a_robot_that_must_know_its_arm_waits_for_it():
    with PostureWorld(robot="omniman", **{"footprint.required": True}) as world:
        posture, now = world.node.posture, world.node.now
        assert world.source is ArmConfigurationSource.ASSUMED
        assert posture.silence_reason(now()) == "no arm/joint_states yet"
        world.send()
        assert world.source is ArmConfigurationSource.MEASURED
        assert not posture.silence_reason(now())
        world.run(0.7)
        assert "are 0.7 s old" in posture.silence_reason(now())


def test_a_robot_without_an_arm_waits_for_none():
    with PostureWorld(robot="ig42", **{"footprint.required": True}) as world:
        world.send()
        assert world.source is ArmConfigurationSource.NO_ARM
        assert not world.node.posture.silence_reason(world.node.now())
        assert world.footprint.is_symmetric


def test_a_tool_and_a_load_are_part_of_the_footprint():
    shapes = {"tool.length": 0.2, "load.length": 0.4, "load.width": 0.3, "load.height": 0.1}
    with PostureWorld(robot="omniman") as bare, PostureWorld(robot="omniman", **shapes) as world:
        bare.send()
        world.send()
        sideways = np.array([0.5 * math.pi])
        assert world.footprint.whole.support(sideways) > bare.footprint.whole.support(sideways)


def test_a_posture_of_five_angles_is_refused():
    with pytest.raises(ParameterError, match=r"footprint\.posture"):
        PostureWorld(robot="omniman", **{"footprint.posture": [0.0] * 5})
