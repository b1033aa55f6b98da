"""Wheel loads and tip-over margin, and the limits that they leave."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.control.dynamics import GRAVITY, PlatformDynamics
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.limits import ratio
from omniman_ros.control.stability import (
    LIMIT_SCALE_STEPS,
    MIN_LIMIT_SCALE,
    StabilityLimiter,
    StabilityParameters,
    SupportModel,
    slowed_limits,
    support_edges,
)
from omniman_ros.core.arbiter import Source
from omniman_ros.core.platform import Arm
from test.control.rig import DT, Rig
from test.robots import parameters, robot

ARMED = ("omniman", "mecanum6", "mecanum8", "skewed4")
HIGH = {"body.com_z": 0.5, "arm.com_z": 1.2}


def support(name="omniman", **changes):
    made = robot(name, HIGH | {key.replace("__", "."): v for key, v in changes.items()})
    kinematics = PlatformKinematics(made.wheels)
    return made, SupportModel(made, kinematics, PlatformDynamics(made, kinematics).mass_matrix)


def far_arm(height=1.2, mass=60.0):
    """An arm that holds a heavy load far to the left."""
    return Arm(mass=mass, inertia=2.0, com_x=0.1, com_y=0.35, com_z=height)


@pytest.mark.parametrize("name", ARMED)
def test_loads_balance_weight_moments_and_the_inertia_of_each_mass(name):
    """Newton and Euler about base_link's origin, mass by mass."""
    made, model = support(name)
    rng = np.random.default_rng(3)
    for _ in range(20):
        a, yaw_rate = rng.uniform(-0.4, 0.4, 3), rng.uniform(-0.4, 0.4)
        weight, moments = 0.0, np.zeros(3)
        for part in (made.body, made.arm):
            place = np.array([part.com_x, part.com_y, part.com_z])
            spin = np.array([0.0, 0.0, yaw_rate])
            own = np.array([a[0], a[1], 0.0]) + np.cross([0.0, 0.0, a[2]], place)
            own += np.cross(spin, np.cross(spin, place))
            weight += part.mass * GRAVITY
            moments += np.cross(place, part.mass * (np.array([0.0, 0.0, GRAVITY]) + own))
        loads = model.loads(a, yaw_rate)
        assert loads.min() > 0.0
        assert loads.sum() == pytest.approx(weight)
        assert loads @ np.array(made.wheels.y) == pytest.approx(moments[0])
        assert -loads @ np.array(made.wheels.x) == pytest.approx(moments[1])
        point = model.zero_moment_point(a, yaw_rate)
        np.testing.assert_allclose(point, [-moments[1] / weight, moments[0] / weight], atol=1e-12)


def test_the_margin_is_the_distance_from_the_border_of_the_contacts():
    made, model = support(body__com_x=0.02, arm__mass=0.0)
    assert model.rest_margin == pytest.approx(0.27)  # half the track
    tips = GRAVITY * 0.27 / 0.5  # the moment of a over half the track is that of g over the height
    assert model.margin(np.array([0.0, tips, 0.0])) == pytest.approx(0.0, abs=1e-12)
    assert model.margin(np.array([0.0, -2.0 * tips, 0.0])) == pytest.approx(-0.27)
    ahead = GRAVITY * (made.wheels.x[0] - 0.02) / 0.5
    assert model.margin(np.array([-ahead, 0.0, 0.0])) == pytest.approx(0.0, abs=1e-12)


def test_edges_are_those_of_the_smallest_convex_polygon():
    corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    inner = np.array([[0.2, 0.3], [1.0, 0.0], [1.0, 1.0]])  # inside, on an edge, repeated
    rng = np.random.default_rng(1)
    for points in (corners, np.vstack([corners, inner])):
        normals, offsets = support_edges(rng.permutation(points))
        for point, distance in (((0.0, 0.0), 1.0), ((0.7, 0.1), 0.3), ((1.5, 0.0), -0.5)):
            assert (normals @ point + offsets).min() == pytest.approx(distance)
    triangle = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 3.0]])
    normals, offsets = support_edges(triangle)
    np.testing.assert_allclose(normals @ [1.0, 1.0] + offsets, [1.0, 1.0, 1.0])  # its incircle


@pytest.mark.parametrize("name", ARMED)
def test_no_motion_within_the_limits_left_uses_up_margin_or_grip(name):
    made, model = support(name, arm__com_y=0.2, arm__mass=40.0)
    limits = replace(parameters(name).limits, linear_acceleration=5.0, linear_deceleration=6.0)
    margin = 0.05
    fraction = model.fraction(limits, margin)
    assert MIN_LIMIT_SCALE < fraction < 1.0
    left = slowed_limits(limits, fraction)
    linear, yaw = map(max, left.acceleration, left.deceleration)
    centripetal = left.linear_velocity * left.angular_velocity
    kinematics = PlatformKinematics(made.wheels)
    mass = PlatformDynamics(made, kinematics).mass_matrix
    lever_arm = np.array(made.wheels.radius) * np.cos(made.wheels.roller_angle)
    least_margin, least_grip = math.inf, math.inf
    for k, side in itertools.product(range(360), (-1.0, 1.0)):
        way = np.array([math.cos(math.radians(k)), math.sin(math.radians(k)), 0.0])
        turn = np.array([0.0, 0.0, side * yaw])
        point = (linear + centripetal) * way + turn
        least_margin = min(least_margin, model.margin(point, left.angular_velocity))
        asked = linear * way + turn
        force = np.abs(kinematics.J_pinv.T @ mass @ asked / lever_arm)
        grip = made.friction.mu * model.loads(asked) - force
        least_grip = min(least_grip, float(grip.min()))
    assert least_margin >= margin - 1e-9 and least_grip >= -1e-6
    # No more is taken than needed: one of the two is used up in the worst direction.
    assert least_margin < margin + 1e-3 or least_grip < 0.5


def test_lowered_limits_keep_the_way_of_a_stop():
    limits = parameters().limits
    for fraction in (0.1, 0.5, 0.95, 1.0):
        left = slowed_limits(limits, fraction)
        for v, a, full_v, full_a in zip(
            left.velocity, left.deceleration, limits.velocity, limits.deceleration, strict=True
        ):
            assert v**2 / (2 * a) == pytest.approx(full_v**2 / (2 * full_a))
            assert a == pytest.approx(fraction * full_a)


def test_the_share_changes_in_steps_and_does_not_chatter():
    class Given(SupportModel):
        """A support that leaves a given share."""

        def __init__(self):
            self.left = 1.0

        def fraction(self, limits, margin):
            return self.left

    limiter, given, limits = StabilityLimiter(), Given(), parameters().limits
    fractions = []
    for k in range(400):
        given.left = 0.6 + 0.02 * math.sin(0.3 * k)  # across a step
        limiter.configure(StabilityParameters(), given, limits)
        assert limiter.fraction <= given.left
        fractions.append(limiter.fraction)
    assert set(fractions[25:]) == {0.55}
    for left, fraction in (
        (0.63, 0.6),
        (0.67, 0.6),
        (0.68, 0.65),
        (1.4, 1.0),
        (-3.0, MIN_LIMIT_SCALE),
    ):
        given.left = left
        limiter.configure(StabilityParameters(), given, limits)
        assert limiter.fraction == pytest.approx(fraction)
    assert (0.65 * LIMIT_SCALE_STEPS).is_integer()


@pytest.mark.parametrize("name", ["ig42", "omni3", *ARMED])
def test_shipped_robots_keep_their_limits(name):
    rig = Rig(name)
    assert rig.core.stability.fraction == 1.0
    assert rig.core.limits == rig.core.parameters.limits


def test_a_robot_without_an_arm_is_never_limited():
    rig = Rig("omniman", {"arm.mass": 0.0, "body.com_z": 3.0})
    assert rig.core.stability.support is None
    assert rig.core.limits == rig.core.parameters.limits


@pytest.mark.parametrize("preview", [False, True])
def test_every_source_accelerates_as_the_posture_allows(preview):
    rig = Rig().run(0.1)
    rig.core.set_arm(far_arm())
    fraction = rig.core.stability.fraction
    assert MIN_LIMIT_SCALE < fraction < 0.8
    if preview:
        rig.core.set_preview(Source.PATH, rig.move((0.0, 0.6, 0.0), 1.4), rig.now)
        rig.run(1.5)
    else:
        rig.cruise(0.0, 0.9, 0.0, seconds=1.5)
    twists = np.array(rig.setpoints)
    rates = np.diff(twists, axis=0) / DT
    full = parameters().limits
    fastest = max(ratio(row, full.acceleration) for row in rates if row @ row > 0)
    assert 0.9 * fraction < fastest
    bound = tuple(fraction * each for each in map(max, full.acceleration, full.deceleration))
    assert max(ratio(row, bound) for row in rates) <= 1 + 1e-6
    margins = [rig.core.stability.support.margin(row) for row in rates]
    assert min(margins) >= rig.core.parameters.stability.margin


def test_a_stop_in_a_bad_posture_keeps_the_margin_and_the_way_of_a_stop():
    rig = Rig().run(0.1)
    rig.core.set_arm(far_arm())
    rig.cruise(0.0, 1.0, 0.0, seconds=4.0)
    since, begin = len(rig.setpoints), rig.core.odometry.pose
    rig.core.latch.stop("button")
    rig.run(3.0)
    assert rig.still
    twists = np.array(rig.setpoints[since - 1 :])
    rates = np.diff(twists, axis=0) / DT
    assert min(rig.core.stability.support.margin(row) for row in rates) >= 0.05
    full = rig.core.parameters.limits
    way = math.dist(rig.core.odometry.pose[:2], begin[:2])
    assert way <= full.linear_velocity**2 / (2 * full.linear_deceleration) + 2 * DT


def test_an_arm_that_stretches_in_motion_slows_the_robot_down_within_the_limits():
    rig = Rig().cruise(0.0, 1.0, 0.0)
    np.testing.assert_allclose(rig.core.setpoint, (0.0, 1.0, 0.0))
    since = len(rig.setpoints)
    for k in range(50):
        rig.core.set_arm(replace(far_arm(), com_y=0.35 * (k + 1) / 50))
        rig.cruise(0.0, 1.0, 0.0, seconds=0.04)
    rig.cruise(0.0, 1.0, 0.0, seconds=2.0)
    assert rig.core.setpoint[1] == pytest.approx(math.sqrt(rig.core.stability.fraction))
    rates = np.diff(np.array(rig.setpoints[since - 1 :]), axis=0) / DT
    full = rig.core.parameters.limits
    assert max(ratio(row, full.deceleration) for row in rates) <= 1 + 1e-6
    assert rig.core.latch.released


def test_the_posture_moves_the_feed_forward():
    """Accelerating sideways with the mass ahead, the front wheels push more."""
    rig = Rig("omniman")
    before = rig.core.cascade.dynamics.platform_torque(np.zeros(3), np.array([0.0, 1.0, 0.0]))
    rig.core.set_arm(replace(rig.core.cascade.robot.arm, com_x=0.6))
    after = rig.core.cascade.dynamics.platform_torque(np.zeros(3), np.array([0.0, 1.0, 0.0]))
    ratio_before, ratio_after = (abs(t[:2]).sum() / abs(t[2:]).sum() for t in (before, after))
    assert ratio_after > ratio_before + 0.1
    rig.core.configure(rig.core.parameters)  # a parameter changed: the posture stays
    assert rig.core.cascade.robot.arm.com_x == 0.6


def test_without_the_limit_only_the_margin_is_shown():
    rig = Rig("omniman", {"stability.limit": False})
    rig.core.set_arm(far_arm())
    assert rig.core.limits == rig.core.parameters.limits
    assert rig.core.stability.support.rest_margin < 0.2
