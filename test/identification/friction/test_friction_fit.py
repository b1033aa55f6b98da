import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.identification.friction.friction_fit import (
    MIN_SPEED,
    SteadyRun,
    friction_torque,
    identify_friction,
)
from omniman_ros.identification.friction.robust_statistics import robust_mean, student_95
from test import robots

RNG_SEED = 11
TOP, LOW = 18.0, 2.0
SPEEDS = [*np.linspace(TOP, LOW, 6), *np.linspace(-TOP, -LOW, 6)] * 2
IG42 = robots.robot("ig42")


def torque_law(a, b):
    """Return the friction (n,) at speeds (n,) with a and b (n,)."""
    return lambda speed: a * speed + b * np.sign(speed)


def steady(robot, speed, torque, back_emf=1.0, drop=0.0):
    """Return a run with these torques by (21) and (22), with motors of another N K."""
    motor = robot.motor
    constant = motor.gear_ratio * motor.torque_constant
    current = torque / (motor.gear_efficiency * constant)
    voltage = motor.resistance * current + back_emf * constant * speed + drop * np.sign(speed)
    n = len(speed)
    return SteadyRun(
        voltage, current, speed, np.full(n, 1e-4), np.ones(n, bool), 100, np.zeros(n, int)
    )


def campaign(robot, law, speeds=SPEEDS, rng=None, noise=0.0, **motor):
    """Return runs at these speeds of all wheels, with Gaussian noise on the torques."""
    made = []
    for value in speeds:
        speed = np.full(robot.wheel_count, value)
        torque = law(speed)
        if rng is not None:
            torque = torque + rng.normal(0.0, noise, len(speed))
        made.append(steady(robot, speed, torque, **motor))
    return made


def changed(run, **fields):
    names = ("voltage", "current", "speed", "error", "steady", "samples", "spikes")
    return SteadyRun(**{name: fields.get(name, getattr(run, name)) for name in names})


@pytest.mark.parametrize("name", robots.ALL)
def test_exact_runs_give_back_each_wheel_s_friction_and_motor_constant(name):
    robot = robots.robot(name)
    rng = np.random.default_rng(RNG_SEED)
    a, b = rng.uniform(0.001, 0.1, robot.wheel_count), rng.uniform(0.05, 2.0, robot.wheel_count)
    runs = campaign(robot, torque_law(a, b), back_emf=1.02)
    found = identify_friction(runs, robot)
    assert tuple(wheel.name for wheel in found) == robot.wheels.names
    np.testing.assert_allclose([wheel.viscous.value for wheel in found], a, rtol=1e-9)
    np.testing.assert_allclose([wheel.coulomb.value for wheel in found], b, rtol=1e-9)
    np.testing.assert_allclose([wheel.back_emf_off for wheel in found], 0.02, rtol=1e-9)
    for wheel in found:
        assert not wheel.outliers and not wheel.left_out and not wheel.differs
        assert wheel.freedom == len(SPEEDS) - 4
        np.testing.assert_allclose(wheel.forward, wheel.backward, rtol=1e-9)


def test_the_torque_is_that_of_the_paper_with_the_gear():
    """(22) with tau = 0, by hand: 0.66 * 24 * 0.0325 * 1 A."""
    run = steady(IG42, np.full(4, 5.0), np.full(4, 0.66 * 24 * 0.0325))
    np.testing.assert_allclose(run.current, 1.0)
    np.testing.assert_allclose(friction_torque(run, IG42), 0.5148)


def test_intervals_contain_the_truth_in_95_percent_and_directions_rarely_differ():
    rng = np.random.default_rng(RNG_SEED)
    a, b = 0.004, 0.25
    inside, differ, noise = [], [], []
    for _ in range(60):
        for wheel in identify_friction(
            campaign(IG42, torque_law(a, b), rng=rng, noise=0.003), IG42
        ):
            inside.append(abs(wheel.viscous.value - a) <= wheel.viscous.half_width)
            inside.append(abs(wheel.coulomb.value - b) <= wheel.coulomb.half_width)
            differ.append(wheel.differs)
            noise.append(wheel.noise)
    assert 0.92 <= np.mean(inside) <= 0.98
    assert np.mean(differ) <= 0.04
    assert np.mean(noise) == pytest.approx(0.003, rel=0.1)


def test_a_sixth_of_the_runs_may_be_wrong():
    rng = np.random.default_rng(RNG_SEED)
    law = torque_law(0.004, 0.25)
    clean = campaign(IG42, law, rng=rng, noise=0.001)
    spoilt = list(clean)
    # both ends of a line, where they have the most leverage; the last by 10 standard deviations
    wrong = {0: 0.5, 5: 0.5, 11: 0.5, 14: 0.02}
    for index, off in wrong.items():
        spoilt[index] = changed(clean[index], current=clean[index].current + off)
    for wheel, before in zip(
        identify_friction(spoilt, IG42), identify_friction(clean, IG42), strict=True
    ):
        assert set(wrong) <= set(wheel.outliers) and len(wheel.outliers) <= 5
        assert wheel.viscous.value == pytest.approx(0.004, rel=0.05)
        assert wheel.coulomb.value == pytest.approx(0.25, rel=0.01)
        assert wheel.viscous.half_width < 2.5 * before.viscous.half_width
        assert wheel.back_emf_off == pytest.approx(0.0, abs=0.01)


def test_directions_that_differ_are_distinguished():
    rng = np.random.default_rng(RNG_SEED)

    def law(speed):
        return np.where(speed > 0, 0.005 * speed + 0.28, 0.003 * speed - 0.22)

    for wheel in identify_friction(campaign(IG42, law, rng=rng, noise=0.002), IG42):
        assert wheel.differs and not wheel.outliers
        np.testing.assert_allclose(wheel.forward, (0.005, 0.28), rtol=0.1)
        np.testing.assert_allclose(wheel.backward, (0.003, 0.22), rtol=0.1)
        assert wheel.viscous.value == pytest.approx(0.004, rel=0.05)
        assert wheel.coulomb.value == pytest.approx(0.25, rel=0.02)


def test_slow_and_unsteady_runs_are_left_out():
    good = campaign(IG42, torque_law(0.004, 0.25))
    slow = steady(IG42, np.full(4, 0.99 * MIN_SPEED), np.full(4, 0.1))
    wobbling = steady(IG42, np.full(4, 9.0), np.full(4, 3.0))
    wobbling = changed(wobbling, steady=[True, False, False, False])
    found = identify_friction([slow, *good, wobbling], IG42)
    last = len(good) + 1
    assert found[0].left_out == (0,) and found[0].outliers == (last,)
    for wheel in found[1:]:
        assert wheel.left_out == (0, last) and not wheel.outliers
        assert wheel.coulomb.value == pytest.approx(0.25, rel=1e-6)
    just = steady(IG42, np.full(4, 1.01 * MIN_SPEED), torque_law(0.004, 0.25)(np.full(4, 1.1)))
    assert not identify_friction([just, *good], IG42)[0].left_out


def test_the_model_has_all_but_a_thousandth_of_its_coulomb_friction_at_the_minimum_speed():
    from omniman_ros.control.dynamics import smooth_sign

    assert smooth_sign(np.array([MIN_SPEED]))[0] == pytest.approx(0.999, abs=1e-6)


def test_brushes_and_a_wrong_resistance_do_not_change_the_motor_constant():
    law = torque_law(0.004, 0.25)
    runs = campaign(IG42, law, drop=0.8)
    assert identify_friction(runs, IG42)[0].back_emf_off == pytest.approx(0.0, abs=1e-9)
    hot = robots.robot("ig42", {"motor.resistance": 1.85 * 1.15})
    off = identify_friction(campaign(hot, law), IG42)[0].back_emf_off
    assert abs(off) < 0.005


def test_wheels_without_friction_are_identified_as_such():
    rng = np.random.default_rng(RNG_SEED)
    runs = campaign(IG42, torque_law(0.0, 0.0), rng=rng, noise=0.002)
    for wheel in identify_friction(runs, IG42):
        assert abs(wheel.viscous.value) < 2.0 * wheel.viscous.half_width < 0.001
        assert abs(wheel.coulomb.value) < 2.0 * wheel.coulomb.half_width < 0.01


def test_the_band_is_the_interval_of_b_at_rest_and_grows_away_from_the_runs():
    rng = np.random.default_rng(RNG_SEED)
    runs = campaign(IG42, torque_law(0.004, 0.25), rng=rng, noise=0.002)
    wheel = identify_friction(runs, IG42)[0]
    rest, middle, far = wheel.band(np.array([1e-9, 10.0, 40.0]))
    assert rest == pytest.approx(wheel.coulomb.half_width)
    assert middle < rest < far
    np.testing.assert_allclose(
        wheel.torque(np.array([-10.0, 10.0])),
        np.array([-1, 1]) * (10 * wheel.viscous.value + wheel.coulomb.value),
    )


@pytest.mark.parametrize(
    ("speeds", "message"),
    [
        ([10, 5, 2, -10, -5], "'front_left': 2 of 5 runs were steady backwards"),
        ([10, 5, -2, -10, -5], "'front_left': 2 of 5 runs were steady forwards"),
        ([10, 9, 8, -10, -5, -2], "do not separate a from b"),
        ([], "0 of 0"),
    ],
)
def test_too_few_runs_are_refused_with_the_wheel(speeds, message):
    runs = campaign(IG42, torque_law(0.004, 0.25), speeds=[float(value) for value in speeds])
    with pytest.raises(InputError, match=message):
        identify_friction(runs, IG42)


def test_runs_of_another_robot_are_refused():
    runs = campaign(robots.robot("omni3"), torque_law(0.004, 0.25))
    with pytest.raises(InputError, match="run 0 has 3 wheels, the robot 4"):
        identify_friction(runs, IG42)


@pytest.mark.parametrize(
    "fields",
    [
        {"current": [1.0, 2.0]},
        {"speed": [math.nan] * 4},
        {"voltage": [[1.0] * 4]},
        {"error": [math.inf, 0, 0, 0]},
    ],
)
def test_an_invalid_run_is_refused(fields):
    run = steady(IG42, np.full(4, 5.0), np.full(4, 0.3))
    with pytest.raises(InputError, match=f"{next(iter(fields))}|voltage"):
        changed(run, **fields)


@pytest.mark.parametrize(("freedom", "value"), [(4, 2.776), (8, 2.306), (20, 2.086), (1e9, 1.96)])
def test_quantiles_of_student_s_t(freedom, value):
    assert student_95(freedom) == pytest.approx(value, rel=1e-3)


def test_a_mean_with_spikes_is_the_mean_without_them():
    rng = np.random.default_rng(RNG_SEED)
    means, errors = [], []
    for _ in range(200):
        samples = rng.normal([1.0, -2.0], [0.1, 0.3], (100, 2))
        samples[:3] += [5.0, -9.0]
        mean, error, spikes = robust_mean(samples)
        means.append(mean)
        errors.append(error)
        assert (spikes >= 3).all()
    means = np.array(means)
    np.testing.assert_allclose(means.mean(axis=0), [1.0, -2.0], atol=0.02)
    np.testing.assert_allclose(np.mean(errors, axis=0), means.std(axis=0), rtol=0.25)


def test_the_mean_of_a_coarse_converter_is_between_its_steps():
    rng = np.random.default_rng(RNG_SEED)
    samples = (rng.random((400, 1)) < 0.3).astype(float)  # 70 % of it are the same number
    mean, _, spikes = robust_mean(samples)
    assert 0.02 < mean[0] < 0.35
    assert spikes[0] < 400 * 0.35
    same, error, none = robust_mean(np.full((30, 2), 0.7))
    np.testing.assert_allclose(same, 0.7)
    np.testing.assert_allclose(error, 0.0, atol=1e-9)
    assert not none.any()
