"""The simulated inertial sensor against motions whose accelerations are known."""

import math

import numpy as np
import pytest

from omniman_ros.core.imu_mount import ImuMount
from omniman_ros.core.parameters import build
from omniman_ros.simulation.plant.imu import (
    BaseMotion,
    ImuSensorParameters,
    SimulatedImu,
    planar_motion,
)

PERFECT = {
    "gyro_noise": 0.0,
    "gyro_bias": 0.0,
    "gyro_drift": 0.0,
    "acceleration_noise": 0.0,
    "acceleration_bias": 0.0,
}
DT = 0.01


def sensor(mount=None, seed=0, **errors):
    values = {f"imu.{name}": value for name, value in (mount or {}).items()}
    place = build(ImuMount, values, "imu.")
    given = {f"s.{name}": value for name, value in (PERFECT | errors).items()}
    return SimulatedImu(place, build(ImuSensorParameters, given, "s."), 9.81, seed)


def run(imu, motion, seconds):
    """Return rates (k, 3) and accelerations (k, 3) of a constant motion."""
    measured = [imu.measure(k * DT, motion) for k in range(round(seconds / DT) + 1)]
    rates, forces = zip(*(m for m in measured if m is not None), strict=True)
    return np.array(rates), np.array(forces)


def test_at_rest_there_is_gravity_upward_only():
    rates, forces = run(sensor(), planar_motion(np.zeros(3)), 0.1)
    np.testing.assert_allclose(rates, 0.0)
    np.testing.assert_allclose(forces, [[0.0, 0.0, 9.81]] * len(forces))


def test_a_tilted_robot_measures_a_part_of_gravity_along_x():
    c, s = math.cos(0.1), math.sin(0.1)  # nose down
    rotation = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    _, forces = run(sensor(), BaseMotion(rotation, np.zeros(3), np.zeros(3)), 0.1)
    np.testing.assert_allclose(forces[-1], [-9.81 * s, 0.0, 9.81 * c])


@pytest.mark.parametrize("yaw", [0.0, 0.5, -2.0])
def test_on_a_circle_it_measures_the_acceleration_of_its_own_place(yaw):
    """The sensor's distance to the middle of the circle makes its centripetal acceleration."""
    mount = {"x": 0.3, "y": -0.2, "yaw": yaw}
    rates, forces = run(sensor(mount), planar_motion(np.array([0.6, 0.0, 0.5])), 0.1)
    np.testing.assert_allclose(rates[:, 2], 0.5)
    to_middle = np.array([0.0, 0.6 / 0.5]) - [0.3, -0.2]
    expected = 0.5**2 * to_middle
    c, s = math.cos(yaw), math.sin(yaw)
    in_sensor = [c * expected[0] + s * expected[1], c * expected[1] - s * expected[0]]
    np.testing.assert_allclose(forces[-1, :2], in_sensor, atol=1e-12)


def test_accelerations_sum_up_to_the_change_of_velocity():
    imu, total = sensor(), np.zeros(2)
    rng = np.random.default_rng(3)
    velocity = np.zeros(2)
    for k in range(100):
        velocity = velocity + rng.normal(0.0, 0.1, 2)
        measured = imu.measure(k * DT, planar_motion(np.array([*velocity, 0.0])))
        if measured is not None:
            total += measured[1][:2] * DT
        else:
            start = velocity
    np.testing.assert_allclose(total, velocity - start, atol=1e-12)


def test_noise_bias_and_drift_are_as_large_as_they_say():
    rest = planar_motion(np.zeros(3))
    rates, forces = run(
        sensor(gyro_noise=0.01, gyro_bias=0.2, acceleration_noise=0.1, acceleration_bias=-0.3),
        rest,
        20.0,
    )
    assert rates[:, 2].std() == pytest.approx(0.01, rel=0.1)
    np.testing.assert_allclose(rates.mean(axis=0), [0.0, 0.0, 0.2], atol=1e-3)
    assert forces[:, 0].std() == pytest.approx(0.1, rel=0.1)
    np.testing.assert_allclose(forces.mean(axis=0), [-0.3, -0.3, 9.81], atol=0.01)
    ends = [run(sensor(seed=s, gyro_drift=0.01), rest, 1.0)[0][-1, 2] for s in range(40)]
    assert np.std(ends) == pytest.approx(0.01, rel=0.4)


def test_a_silent_sensor_tells_nothing_and_a_frozen_one_repeats_itself():
    imu = sensor(gyro_noise=0.01)
    rest = planar_motion(np.zeros(3))
    run(imu, rest, 0.1)
    imu.configure(ImuMount(), ImuSensorParameters(frozen=True), 9.81)
    first, second = (imu.measure(0.2 + k * DT, rest) for k in range(2))
    np.testing.assert_array_equal(first, second)
    imu.configure(ImuMount(), ImuSensorParameters(silent=True), 9.81)
    assert imu.measure(1.0, rest) is None


def test_the_same_seed_gives_the_same_measurements():
    motion = planar_motion(np.array([0.1, 0.2, 0.3]))
    one, other = (run(sensor(seed=4, gyro_noise=0.01), motion, 0.5) for _ in range(2))
    np.testing.assert_array_equal(one, other)
