import math

import numpy as np
import pytest

from omniman_ros.control.coupling_controller import CouplingController, CouplingParameters
from omniman_ros.control.kinematics import PlatformKinematics, wheel_row
from omniman_ros.core.parameters import build
from test.robots import ALL, kinematics, parameters, random_wheels

CONSTRAINED = [name for name in ALL if name != "omni3"]


def make(name="omniman", k=2.0, authority=0.2):
    model = kinematics(name)
    return CouplingController(model, CouplingParameters(k, authority)), model


@pytest.mark.parametrize("name", CONSTRAINED)
@pytest.mark.parametrize("k", [0.5, 2.0, 10.0])
def test_coupling_error_of_ideal_wheels_decays_at_the_gain(name, k):
    controller, model = make(name, k, authority=1.0)
    start = np.random.default_rng(1).normal(0, 0.05, model.constraint_count)
    controller.add(start)
    wheels, dt = model.J @ np.array([0.5, 0.2, 0.1]), 1e-4
    for _ in range(round(1.0 / k / dt)):
        turned = (wheels + controller.correction(wheels)) * dt
        controller.add(model.T @ turned)
    np.testing.assert_allclose(controller.error, start * math.exp(-1), rtol=1e-3)


@pytest.mark.parametrize("n", range(4, 9))
def test_correction_never_moves_the_platform(n):
    model = PlatformKinematics(random_wheels(np.random.default_rng(n), n))
    controller = CouplingController(model, CouplingParameters())
    rng = np.random.default_rng(2)
    for _ in range(20):
        controller.reset()
        controller.add(rng.normal(0, 1, n - 3))
        change = controller.correction(model.J @ rng.uniform(-1, 1, 3))
        assert change.shape == (n,)
        assert change.any()
        np.testing.assert_allclose(model.J_pinv @ change, 0, atol=1e-12)


@pytest.mark.parametrize("name", CONSTRAINED)
def test_correction_beyond_its_authority_is_scaled_by_one_factor_for_all_wheels(name):
    small, model = make(name)
    large, _ = make(name)
    error = np.random.default_rng(3).normal(0, 1, model.constraint_count)
    small.add(1e-4 * error)
    large.add(100 * error)
    wheels = model.J @ np.array([0.5, 0, 0])
    change = large.correction(wheels)
    assert abs(change).max() == pytest.approx(0.2 * abs(wheels).max())
    free = small.correction(wheels)
    np.testing.assert_allclose(change / abs(change).max(), free / abs(free).max(), rtol=1e-9)
    np.testing.assert_allclose(model.T @ free, -2.0 * 1e-4 * error)


@pytest.mark.parametrize("name", ALL)
def test_platform_at_rest_is_never_moved(name):
    controller, model = make(name)
    controller.add(np.full(model.constraint_count, 3.0))
    assert not controller.correction(np.zeros(model.wheel_count)).any()


def test_zero_gain_disables_the_correction_and_reset_clears_the_error():
    controller, model = make(k=0.0)
    controller.add(np.ones(1))
    assert not controller.correction(np.ones(4)).any()
    controller.configure(model, CouplingParameters())
    assert controller.error[0] == 1.0  # new gains keep the error
    assert controller.correction(np.ones(4)).any()
    controller.reset()
    assert controller.error.shape == (1,)
    assert not controller.error.any()
    assert not controller.correction(np.ones(4)).any()


def test_coupling_error_is_the_sum_of_its_steps():
    controller, _ = make("mecanum6")
    for i in range(5):
        controller.add(np.array([1.0, 2, 3]) * i)
    np.testing.assert_array_equal(controller.error, [10, 20, 30])


def test_one_count_of_a_coarse_encoder_causes_a_small_correction():
    """At the default gain, a count of the IG42 (480 per turn): 1.3 % of its speed at 0.4 m/s."""
    model = kinematics("ig42")
    controller = CouplingController(model, CouplingParameters())
    controller.add(model.T[:, 0] * 2 * math.pi / 480)
    wheels = model.J @ np.array([0.4, 0, 0])
    change = controller.correction(wheels)
    assert 0.0 < abs(change).max() <= 0.013 * abs(wheels).max()


def test_limited_correction_still_removes_the_coupling_error():
    controller, model = make()
    controller.add(np.array([5.0]))
    wheels, dt = model.J @ np.array([0.3, 0, 0]), 0.005
    for _ in range(4000):
        controller.add(model.T @ (wheels + controller.correction(wheels)) * dt)
    assert abs(controller.error[0]) < 1e-3


@pytest.mark.parametrize(("resets", "left"), [(True, 0.0), (False, 3.0)])
def test_rest_resets_the_error_unless_it_is_to_be_integrated_on(resets, left):
    parameters = CouplingParameters(reset_at_rest=resets)
    controller = CouplingController(kinematics("omniman"), parameters)
    controller.add(np.array([3.0]))
    controller.rest()
    assert controller.error[0] == left


@pytest.mark.parametrize("radius", [0.127, 0.02, 0.005])
def test_range_of_the_gain_covers_18_as_printed(radius):
    build(CouplingParameters, {"k_epsilon": 2 * 4 / radius})


def speeds_on_late_rollers(wheels, lag, twist):
    """Return the speeds of wheels that roll without slip on contacts off their middles."""
    rows = zip(wheels.x, wheels.y, wheels.heading, wheels.roller_angle, wheels.radius, strict=True)
    speeds = []
    for x, y, heading, angle, radius in rows:
        speed = 0.0
        for _ in range(30):
            right = lag * np.sign(angle) * radius * speed
            moved = x + right * math.sin(heading), y - right * math.cos(heading)
            speed = float(wheel_row(*moved, heading, angle, radius) @ twist)
        speeds.append(speed)
    return np.array(speeds)


@pytest.mark.parametrize("name", CONSTRAINED)
@pytest.mark.parametrize("twist", [(0.0, 0.0, -0.7), (0.4, -0.2, 0.9)])
def test_epsilon_of_wheels_that_roll_on_late_rollers_is_the_expected_one(name, twist):
    model, lag = kinematics(name), 0.01
    controller = CouplingController(model, CouplingParameters(roller_lag=lag))
    wheels = speeds_on_late_rollers(parameters(name).robot.wheels, lag, np.array(twist))
    expected = controller.expected_rate(wheels, twist[2])
    np.testing.assert_allclose(model.T @ wheels, expected, atol=1e-12)


def test_a_platform_that_does_not_rotate_expects_no_coupling_error():
    model = kinematics("omniman")
    controller = CouplingController(model, CouplingParameters(roller_lag=0.01))
    assert controller.expected_rate(model.J @ np.array([0.4, 0.2, 0.0]), 0.0)[0] == 0.0
    assert controller.expected_rate(model.J @ np.array([0.0, 0.0, 0.5]), 0.5)[0] > 0.01


def test_the_expected_change_of_epsilon_is_commanded_and_its_error_controlled():
    model = kinematics("omniman")
    controller = CouplingController(model, CouplingParameters(k_epsilon=2.0, roller_lag=0.01))
    wheels = model.J @ np.array([0.3, 0.0, 0.8])
    expected = controller.expected_rate(wheels, 0.8)
    np.testing.assert_allclose(model.T @ controller.correction(wheels, 0.8), expected)
    controller.add(np.array([0.02]))
    np.testing.assert_allclose(model.T @ controller.correction(wheels, 0.8), expected - 0.04)
    np.testing.assert_allclose(model.J_pinv @ controller.correction(wheels, 0.8), 0, atol=1e-12)
