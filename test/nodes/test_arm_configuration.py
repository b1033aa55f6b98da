"""The arm's posture on topics: wheel loads, limits and feed-forward of the platform controller."""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from omniman_ros.conversions.wheels import reported_limit_scales
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.nodes.stop_interface import LATCHED
from test.nodes.rig import Rig

LEFT = [math.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0]
AHEAD = [0.0] * 6
HEAVY = {"robot": "omniman", "arm.mass": 50.0}


class ArmRig(Rig):
    """A controller whose probe publishes the joint states of an arm."""

    def __init__(self, parameters=None):
        super().__init__(parameters or HEAVY)
        self.arm = self.publisher(JointState, "arm/joint_states")
        self.margins = self.listen(Float64, "tip_over_margin")
        self.warnings: list[tuple[str, str]] = []
        self.node.warn = lambda subject, text: self.warnings.append((subject, text))
        self.health = self.listen(DiagnosticStatus, "wheel_health", LATCHED)

    def states(self, posture, age=0.0):
        message = JointState(name=list(UR_JOINTS), position=list(map(float, posture)))
        message.header.stamp = self.stamp(-age)
        return message

    def hold(self, posture, seconds=0.1):
        self.run(seconds, lambda: self.arm.publish(self.states(posture)))

    @property
    def centre(self):
        arm = self.core.cascade.robot.arm
        return arm.com_x, arm.com_y, arm.com_z


@pytest.fixture(scope="module")
def rig():
    with ArmRig() as made:
        yield made


BAD_STATES = (
    ("finite", {"position": [math.nan, *AHEAD[1:]]}),
    ("finite", {"position": [math.inf, *AHEAD[1:]]}),
    ("finite", {"position": [1e9, *AHEAD[1:]]}),
    ("6 names", {"position": AHEAD[1:]}),
    ("no position", {"position": []}),
    ("wrist_3_joint", {"name": [*UR_JOINTS[:5], "other"]}),
    ("repeated", {"name": [*UR_JOINTS[:5], UR_JOINTS[0]]}),
    ("stale", {"age": 0.6}),
    ("out of order", {"age": 0.2}),
    ("ahead", {"age": -0.2}),
)


def test_the_arms_mass_is_where_its_joints_are(rig):
    rig.hold(AHEAD)
    x, y, _ = rig.centre
    assert x > 0.7 and abs(y) < 0.2
    rig.hold(LEFT)
    assert rig.centre[:2] == pytest.approx((0.2 - y, x - 0.2), abs=1e-9)  # a quarter turn at 0.2
    loads = rig.core.stability.support.loads(np.zeros(3))
    assert loads[0] + loads[2] > 2.0 * (loads[1] + loads[3])  # the left wheels carry it
    joints, position = list(UR_JOINTS), list(AHEAD)
    message = JointState(name=["gripper", *joints[::-1]], position=[9.0, *position[::-1]])
    message.header.stamp = rig.stamp()
    rig.arm.publish(message)
    rig.run(0.1)
    assert rig.centre[:2] == pytest.approx((x, y), abs=1e-9)


def test_what_is_no_posture_is_refused_and_moves_no_mass(rig):
    rig.hold(AHEAD)
    before = rig.centre
    for reason, bad in BAD_STATES:
        rig.hold(AHEAD)
        rig.warnings.clear()
        message = rig.states(LEFT, bad.get("age", 0.0))
        for field in ("name", "position"):
            setattr(message, field, bad.get(field, getattr(message, field)))
        rig.arm.publish(message)
        rig.run(0.1)
        assert rig.centre == before
        ((subject, text),) = rig.warnings
        assert subject == "arm/joint_states" and reason in text


def test_margin_and_share_of_the_limits_are_published(rig):
    rig.hold(AHEAD, 0.3)
    ahead = rig.margins[-1].data
    assert ahead == pytest.approx(rig.core.stability.support.rest_margin)
    rig.hold(LEFT, 0.3)
    assert rig.margins[-1].data < ahead - 0.03
    fraction = rig.core.stability.fraction
    assert 0.1 <= fraction < 0.8
    assert reported_limit_scales(rig.health[-1]).posture == pytest.approx(fraction)
    assert reported_limit_scales(rig.health[-1]).wheels == 1.0
    still = rig.margins[-1].data
    rig.drive(0.0, -0.5, 0.0, seconds=0.3)  # away from the arm: the point moves to its side
    assert rig.margins[-1].data < still - 0.005
    rig.drive(0.0, 0.0, 0.0, seconds=1.6)
    values = dict(rig.node.status()[2])
    assert values["arm_posture"].startswith("silent")
    assert values["tip_over_margin_at_rest_m"] == pytest.approx(still, abs=1e-3)
    assert sum(values["wheel_loads_N"]) == pytest.approx(190.0 * 9.80665, abs=3.0)


def set_mass(rig, mass):
    request = SetParameters.Request(
        parameters=[Parameter("arm.mass", value=mass).to_parameter_msg()]
    )
    assert (
        rig.call(SetParameters, "platform_controller/set_parameters", request)
        .results[0]
        .successful
    )


def test_a_new_load_counts_at_once_where_the_arm_is(rig):
    rig.hold(LEFT)
    before = rig.core.stability.support.rest_margin
    set_mass(rig, 40.0)
    assert rig.core.cascade.robot.arm.mass == 40.0
    assert rig.core.stability.support.rest_margin > before + 0.02
    set_mass(rig, 50.0)
    assert rig.core.stability.support.rest_margin == pytest.approx(before)
