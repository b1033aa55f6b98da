"""Tip-over margins along a plan: against one posture at a time, and against differences."""

from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.stability import SupportModel
from omniman_ros.description.arm_mass import ArmMass
from omniman_ros.motion.whole_body.model import HALF_TURN
from omniman_ros.planning.whole_body.body_balance import BodyBalance
from omniman_ros.planning.whole_body.parameters import OrientationFreedom
from omniman_ros.planning.whole_body.task import WholeBodyTask, path_search
from test.planning.whole_body.support import START, posts, setup, straight

DESCRIPTION = setup().description
Z = np.array([[0.1, 0.02, -0.05, 0.2], [0.3, -0.03, 0.7, 0.37]])
RATES = np.array([[0.2, 0.1, 0.3, 0.15], [0.1, 0.2, -0.5, 0.2]])
ACCELERATIONS = np.array([[0.5, -0.3, 0.4, 0.1], [-0.4, 0.6, -0.8, 0.0]])


@pytest.fixture(scope="module")
def redundancy():
    return WholeBodyTask(setup(), straight(0.6), START, 0.0, posts()).redundancy


def frames(redundancy, q):
    return DESCRIPTION.mount.pose @ HALF_TURN @ redundancy.model.arm.frames(q[:, 3:])


def test_a_posture_has_the_margin_of_the_model_of_its_support(redundancy):
    balance, mass = BodyBalance(DESCRIPTION), ArmMass(DESCRIPTION.robot.arm, DESCRIPTION.mount)
    at = redundancy.configurations(Z)
    found = balance.rows(at, RATES, ACCELERATIONS)
    for k, q in enumerate(at.q):
        robot = replace(DESCRIPTION.robot, arm=mass.at(q[3:]))
        support = SupportModel(robot, PlatformKinematics(robot.wheels), np.eye(3))
        c, s = np.cos(q[2]), np.sin(q[2])
        x, y, yaw, _ = ACCELERATIONS[k]
        pushed = np.array([c * x + s * y, c * y - s * x, yaw])
        expected = support.margin(pushed, RATES[k, 2])
        assert found.margin[k].min() == pytest.approx(expected, abs=1e-9)
        at_rest = balance.rest_margin(balance.arm_centres(frames(redundancy, at.q))[k])
        assert at_rest == pytest.approx(support.rest_margin, abs=1e-9)


@pytest.mark.parametrize(
    ("freedom", "axis"),
    [
        (freedom, axis)
        for freedom, d in (
            (OrientationFreedom(), 4),
            (OrientationFreedom("x"), 5),
            (OrientationFreedom("x", 0.4, 0.1), 7),
        )
        for axis in range(d)
    ],
)
def test_derivatives_of_margins_are_those_of_differences(freedom, axis):
    search, begin = path_search(replace(setup(), freedom=freedom), straight(0.6), START)
    redundancy, balance, step = search.redundancy, BodyBalance(DESCRIPTION), 1e-6
    rng, count = np.random.default_rng(4), len(begin)
    own, own_rates, own_accelerations = rng.uniform(-0.3, 0.3, (3, 2, count))
    states = np.hstack([Z, own])
    speeds, pushes = np.hstack([RATES, own_rates]), np.hstack([ACCELERATIONS, own_accelerations])
    nudge = step * np.eye(4 + count)[axis]

    def margins(z=0.0, rate=0.0, acceleration=0.0):
        at = redundancy.configurations(states + z)
        return balance.rows(at, speeds + rate, pushes + acceleration).margin

    found = balance.rows(redundancy.configurations(states), speeds, pushes)
    if axis >= 4:
        assert np.abs(found.by_z[..., axis]).max() > 1e-3, "the arm moves with it"
    for derivative, moved in (
        (found.by_z, margins(z=nudge) - margins(z=-nudge)),
        (found.by_rate, margins(rate=nudge) - margins(rate=-nudge)),
        (found.by_acceleration, margins(acceleration=nudge) - margins(acceleration=-nudge)),
    ):
        assert moved / (2.0 * step) == pytest.approx(derivative[..., axis], abs=1e-7)


def test_along_a_motion_the_arm_counts_as_it_moves(redundancy):
    """A platform that accelerates alone is as the rows have it; an arm that is thrown is not."""
    balance = BodyBalance(DESCRIPTION)
    times = 0.01 * np.arange(3)
    poses = 0.5 * np.outer(times**2, [0.8, -0.4, 0.0])
    still = np.tile(START, (3, 1))
    carried = balance.margins(times, poses, balance.arm_centres(frames(redundancy, still)))[0]
    at = redundancy.configurations(np.zeros((1, 4)))
    pushed = np.array([[0.8, -0.4, 0.0, 0.0]])
    rows = balance.rows(at, np.zeros((1, 4)), pushed)
    assert carried == pytest.approx(rows.margin.min(), abs=1e-6)

    def thrown(acceleration):
        """Return the change of the margin while the shoulder accelerates [rad/s^2]."""
        arm = still.copy()
        arm[:, 4] += 0.5 * acceleration * times**2
        return (
            balance.margins(times, poses, balance.arm_centres(frames(redundancy, arm)))[0]
            - carried
        )

    up, down = thrown(-40.0), thrown(40.0)
    assert min(abs(up), abs(down)) > 0.02
    assert up * down < 0.0
