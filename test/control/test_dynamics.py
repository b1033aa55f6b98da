import math

import numpy as np
import pytest

from omniman_ros.control.dynamics import GRAVITY, SIGN_WIDTH, PlatformDynamics, smooth_sign
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.limits import ratio
from omniman_ros.core import se2
from test.robots import ALL, kinematics, random_robot, robot

COUNTS = range(3, 9)
NO_FRICTION = {"friction.viscous": [0.0], "friction.coulomb": [0.0], "friction.roller": [0.0]}


def make(name="omniman", changes=None):
    made = robot(name, changes)
    return made, PlatformKinematics(made.wheels), PlatformDynamics(made, kinematics(name, changes))


def make_random(n, seed=0):
    made = random_robot(np.random.default_rng([n, seed]), n)
    model = PlatformKinematics(made.wheels)
    return made, model, PlatformDynamics(made, model)


def motion(seed, count=5):
    rng = np.random.default_rng(seed)
    return zip(rng.uniform(-1, 1, (count, 3)), rng.uniform(-2, 2, (count, 3)), strict=True)


def kinetic_energy(made, model, pose, velocity):
    """Return the energy of platform, arm and wheels, each body by its own centre of mass."""
    theta, (vx, vy, w) = pose[2], velocity
    energy = 0.5 * np.array(made.wheels.inertia) @ (model.J @ se2.to_robot(theta, velocity)) ** 2
    c, s = math.cos(theta), math.sin(theta)
    for body in (made.body, made.arm):
        rx, ry = c * body.com_x - s * body.com_y, s * body.com_x + c * body.com_y
        energy += 0.5 * body.mass * ((vx - w * ry) ** 2 + (vy + w * rx) ** 2)
        energy += 0.5 * body.inertia * w * w
    return energy


@pytest.mark.parametrize("n", COUNTS)
def test_power_at_the_wheels_is_the_rate_of_kinetic_energy(n):
    made, model, dynamics = make_random(n)
    pose = np.array([0.3, -0.2, 0.7])
    for velocity, acceleration in motion(n):  # in the world frame

        def energy(t, v=velocity, a=acceleration):
            return kinetic_energy(made, model, pose + v * t + a * t * t / 2, v + a * t)

        h = 1e-5
        power = (energy(h) - energy(-h)) / (2 * h)
        twist = se2.to_robot(pose[2], velocity)
        vx, vy, w = twist
        rate = se2.to_robot(pose[2], acceleration) + [w * vy, -w * vx, 0]  # CCTA (20)
        torque = dynamics.platform_torque(twist, rate)
        assert torque.shape == (n,)
        assert torque @ (model.J @ twist) == pytest.approx(power, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("n", COUNTS)
def test_wheel_torques_and_platform_force_have_equal_power(n):
    made, model, dynamics = make_random(n, 1)
    inertia = np.array(made.wheels.inertia)
    for twist, rate in motion(n + 20):
        vx, vy, w = twist
        space = rate + [-w * vy, w * vx, 0]
        force = np.zeros(3)
        for body in (made.body, made.arm):  # Newton and Euler at each centre of mass
            x, y = body.com_x, body.com_y
            fx = body.mass * (space[0] - space[2] * y - w * w * x)
            fy = body.mass * (space[1] + space[2] * x - w * w * y)
            force += [fx, fy, x * fy - y * fx + body.inertia * space[2]]
        torque = dynamics.platform_torque(twist, rate) - inertia * (model.J @ rate)
        np.testing.assert_allclose(model.J.T @ torque, force, rtol=1e-9, atol=1e-9)
        for other in (twist, rate):
            assert torque @ (model.J @ other) == pytest.approx(force @ other)


def test_circle_at_constant_speed_needs_the_centripetal_force_of_all_masses():
    made, model, dynamics = make(changes={**NO_FRICTION, "arm.com_x": 0.0})
    speed, turn = 0.8, 0.5
    torque = dynamics.platform_torque(np.array([speed, 0, turn]), np.zeros(3))
    mass = made.body.mass + made.arm.mass
    assert mass == pytest.approx(160.4)
    np.testing.assert_allclose(model.J.T @ torque, [0, mass * speed * turn, 0], atol=1e-9)


def test_arm_ahead_of_the_centre_is_pulled_inwards_when_turning_on_the_spot():
    made, model, dynamics = make(changes=NO_FRICTION)
    torque = dynamics.platform_torque(np.array([0, 0, 2.0]), np.zeros(3))
    force = made.arm.mass * made.arm.com_x * 2.0**2
    np.testing.assert_allclose(model.J.T @ torque, [-force, 0, 0], atol=1e-9)


def test_symmetric_case_equals_mpc_2021_equations_13_to_17():
    # The paper's model in its own notation: world frame, L + l = k, equal wheels.
    changes = {**NO_FRICTION, "arm.mass": 0.0, "body.com_x": 0.0, "body.com_y": 0.0}
    made, _model, dynamics = make("ig42", changes)
    m, i_z, i_w = made.body.mass, made.body.inertia, made.wheels.inertia[0]
    k, r = made.wheels.x[0] + made.wheels.y[0], made.wheels.radius[0]
    for velocity, acceleration in motion(3, 20):
        psi, turn = 0.9, velocity[2]
        h = np.diag([m + 4 * i_w / r**2, m + 4 * i_w / r**2, i_z + 4 * i_w * k**2 / r**2])  # (16)
        c = 4 * i_w * turn / r**2
        coriolis = np.array([[0, c, 0], [-c, 0, 0], [0, 0, 0]])  # (17)
        left = h @ acceleration + coriolis @ velocity
        matrix = np.array([[1, -1, -k], [1, 1, k], [1, 1, -k], [1, -1, k]]) / r
        twist = se2.to_robot(psi, velocity)
        vx, vy, w = twist
        rate = se2.to_robot(psi, acceleration) + [w * vy, -w * vx, 0]
        torque = dynamics.platform_torque(twist, rate)
        right = se2.rotation(psi).T @ matrix.T @ torque  # (13)
        np.testing.assert_allclose(right, left, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("n", COUNTS)
def test_wheel_inertia_maps_consistent_accelerations_to_torques_from_rest(n):
    made, model, dynamics = make_random(n, 2)
    assert dynamics.wheel_inertia.shape == (n, n)
    np.testing.assert_allclose(dynamics.wheel_inertia, dynamics.wheel_inertia.T)
    assert np.linalg.eigvalsh(dynamics.wheel_inertia).min() > 0
    for rate, _ in motion(n + 40):
        torque = dynamics.platform_torque(np.zeros(3), rate)
        np.testing.assert_allclose(dynamics.wheel_inertia @ model.J @ rate, torque)
    if n > 3:  # motion against the constraints accelerates the wheels alone
        against = model.T_pinv[:, 0]
        np.testing.assert_allclose(
            dynamics.wheel_inertia @ against, np.array(made.wheels.inertia) * against, atol=1e-9
        )


@pytest.mark.parametrize("name", ALL)
def test_wheel_loads_carry_the_weight_and_balance_the_moments(name):
    made, _, dynamics = make(name)
    bodies = (made.body, made.arm)
    weight = GRAVITY * sum(body.mass for body in bodies)
    assert dynamics.loads.shape == (made.wheel_count,)
    assert (dynamics.loads > 0).all()
    assert dynamics.loads.sum() == pytest.approx(weight)
    for axis, along in (("com_x", made.wheels.x), ("com_y", made.wheels.y)):
        moment = GRAVITY * sum(body.mass * getattr(body, axis) for body in bodies)
        assert dynamics.loads @ along == pytest.approx(moment, abs=1e-6)


def test_wheel_load_is_never_negative():
    _, _, dynamics = make(changes={"arm.com_x": 5.0, "arm.mass": 100.0})
    assert (dynamics.loads >= 0).all()


def test_mass_matrix_of_one_body_and_an_arm():
    _, _, dynamics = make(changes={"body.com_x": 0.1, "body.com_y": -0.2})
    mass, mx, my = 140 + 20.4, 140 * 0.1 + 20.4 * 0.2, -140 * 0.2
    turn = 15 + 140 * 0.05 + 1.2 + 20.4 * 0.04
    np.testing.assert_allclose(
        dynamics.mass_matrix, [[mass, 0, -my], [0, mass, mx], [-my, mx, turn]]
    )


# ---- friction ---------------------------------------------------------------------------------


@pytest.mark.parametrize("n", COUNTS)
def test_friction_dissipates_power_in_every_motion_and_none_at_rest(n):
    _, model, dynamics = make_random(n, 3)
    for twist, _ in motion(n + 60, 20):
        speeds = model.J @ twist
        torque = dynamics.friction_torque(twist, speeds)
        assert torque.shape == (n,)
        assert torque @ speeds > 0
        np.testing.assert_allclose(dynamics.friction_torque(-twist, -speeds), -torque)
    assert not dynamics.friction_torque(np.zeros(3), np.zeros(n)).any()


def test_shaft_friction_equals_mpc_2021_equation_24():
    made, _, dynamics = make("skewed4", {"friction.roller": [0.0]})
    speeds = np.array([5.0, -3.0, 0.01, 0.0])
    torque = dynamics.friction_torque(np.zeros(3), speeds)
    smooth = speeds / np.sqrt(speeds**2 + SIGN_WIDTH**2)
    expected = np.array(made.friction.viscous) * speeds + made.friction.coulomb * smooth
    np.testing.assert_allclose(torque, expected)


@pytest.mark.parametrize("n", COUNTS)
def test_power_of_roller_drag_is_its_force_times_the_roller_speed(n):
    made, model, dynamics = make_random(n, 4)
    drag = np.array(made.friction.roller) * dynamics.loads
    wheels = made.wheels
    for twist, _ in motion(n + 80):
        vx, vy, w = twist
        speeds = model.J @ twist
        rolling = []
        for x, y, d, g, r, speed in zip(
            wheels.x,
            wheels.y,
            wheels.heading,
            wheels.roller_angle,
            wheels.radius,
            speeds,
            strict=True,
        ):
            # Surface velocity over the floor at the contact, along the roller's free direction.
            sx, sy = vx - w * y - r * speed * math.cos(d), vy + w * x - r * speed * math.sin(d)
            rolling.append(-sx * math.sin(d + g) + sy * math.cos(d + g))
        shaft = np.array(made.friction.viscous) * speeds
        shaft = shaft + np.array(made.friction.coulomb) * smooth_sign(speeds)
        power = (dynamics.friction_torque(twist, speeds) - shaft) @ speeds
        expected = drag @ (smooth_sign(np.array(rolling)) * rolling)
        assert power == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_mecanum_wheels_need_more_power_sideways_than_ahead():
    _, model, dynamics = make()

    def power(twist):
        return dynamics.friction_torque(twist, model.J @ twist) @ (model.J @ twist)

    assert power(np.array([0, 0.5, 0])) > power(np.array([0.5, 0, 0])) * 1.05


# ---- motors -----------------------------------------------------------------------------------


def test_current_of_a_driving_and_a_driven_motor():
    made, _, dynamics = make()
    motor = made.motor
    gain, eta = motor.gear_ratio * motor.torque_constant, motor.gear_efficiency
    torque, speeds = np.array([4.0, 4, -4, -4]), np.array([1.0, -1, -1, 1])
    expected = np.array([4 / eta, 4 * eta, -4 / eta, -4 * eta]) / gain
    np.testing.assert_allclose(dynamics.current(torque, speeds), expected)
    # At rest the motor has to deliver the torque through the gear.
    np.testing.assert_allclose(dynamics.current(torque, np.zeros(4)), torque / eta / gain)


def test_voltage_is_ohmic_drop_plus_back_emf_through_the_gear_and_clipped():
    made, _, dynamics = make()
    motor = made.motor
    torque, speeds = np.array([4.0, 4, 4, 4]), np.array([0.0, 1, -1, 10])
    gain = motor.gear_ratio * motor.torque_constant
    expected = motor.resistance * dynamics.current(torque, speeds) + gain * speeds
    np.testing.assert_allclose(dynamics.voltage(torque, speeds), expected)
    clipped = dynamics.voltage(np.full(4, 1e4), np.array([1.0, 1, -1, 10]))
    np.testing.assert_array_equal(clipped, motor.max_voltage)
    np.testing.assert_array_equal(dynamics.voltage(np.full(4, -1e4), -speeds), -motor.max_voltage)


def test_torque_limit_follows_from_the_current_limit():
    made, _, dynamics = make("ig42")
    motor = made.motor
    np.testing.assert_allclose(dynamics.torque_limit, 0.66 * 24 * 0.0325 * 13)
    drawn = dynamics.current(dynamics.torque_limit, np.ones(4))
    np.testing.assert_allclose(drawn, motor.max_current)


def test_smooth_sign_is_odd_bounded_and_equals_the_sign_far_from_zero():
    speed = np.linspace(-3, 3, 301)
    sign = smooth_sign(speed)
    np.testing.assert_allclose(sign, -sign[::-1])
    assert (abs(sign) < 1).all()
    assert (np.diff(sign) > 0).all()
    assert sign[-1] == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("name", ["omniman", "ig42"])
def test_torque_limits_follow_from_the_voltage_limit(name):
    """At a torque limit the voltage or the current is at its limit, whichever comes first."""
    robot_ = robot(name)
    dynamics = PlatformDynamics(robot_, PlatformKinematics(robot_.wheels))
    motor = robot_.motor
    for speed in np.linspace(-motor.max_speed, motor.max_speed, 21):
        speeds = np.full(4, speed)
        low, high = dynamics.voltage_torques(speeds)
        assert (low < high).all()
        for torque in (low, high):
            amps = dynamics.current(torque, speeds)
            volts = motor.resistance * amps + motor.gear_ratio * motor.torque_constant * speed
            at_voltage = np.isclose(np.abs(volts), motor.max_voltage)
            at_current = np.isclose(np.abs(amps), motor.max_current)
            assert (at_voltage | at_current).all()
            assert (np.abs(amps) <= motor.max_current * (1 + 1e-9)).all()


@pytest.mark.parametrize("name", ALL)
def test_limited_voltages_accelerate_at_the_limit_in_the_same_direction(name):
    """The acceleration is checked by the inverse dynamics, CCTA (19)."""
    _, model, dynamics = make(name)
    rng, limit = np.random.default_rng(3), (0.2, 0.3)
    forward = dynamics.momentum_map() @ model.J

    def rate(volts, twist, speeds):
        torque = dynamics.torque_of(volts, speeds) - dynamics.friction_torque(twist, speeds)
        residual = torque - dynamics.platform_torque(twist, np.zeros(3))
        result = np.linalg.solve(forward, model.J.T @ residual)
        at_rate = dynamics.platform_torque(twist, result)
        assert model.J.T @ at_rate == pytest.approx(model.J.T @ torque, abs=1e-6)
        return result

    for _ in range(20):
        twist = rng.uniform(-0.3, 0.3, 3)
        speeds = model.J @ twist
        direction = rng.uniform(-1.0, 1.0, 3)
        torque = dynamics.platform_torque(twist, 2.0 * direction)
        volts = dynamics.voltage(torque + dynamics.friction_torque(twist, speeds), speeds)
        free, kept = rate(volts, twist, speeds), ratio(rate(volts, twist, speeds), limit)
        limited = dynamics.limited_voltage(volts, twist, speeds, limit)
        if kept <= 1.0:
            np.testing.assert_array_equal(limited, volts)
        else:
            np.testing.assert_allclose(rate(limited, twist, speeds), free / kept, atol=1e-6)
