import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.odometry import Odometry, OdometryParameters
from omniman_ros.core.errors import InputError, ParameterError
from test.robots import ALL, kinematics, robot

QUIET = OdometryParameters(noise_translation=0, noise_rotation=0, noise_drift=0, noise_slip=0)


def make(name="omniman", **changes):
    model = kinematics(name)
    return Odometry(model, OdometryParameters(**changes)), model


def drive(odometry, model, twist, times):
    """Turn the wheels without slip along a constant twist in the given steps."""
    for dt in times:
        speeds = model.J @ twist
        odometry.update(speeds * dt, speeds, dt)


@pytest.mark.parametrize("name", ALL)
def test_half_circle_at_20_hz_is_integrated_exactly(name):
    odometry, model = make(name)
    radius, duration = 1.5, 3.0
    turn = math.pi / duration
    drive(odometry, model, np.array([radius * turn, 0, turn]), [0.05] * 60)
    assert odometry.pose == pytest.approx((0, 2 * radius, math.pi), abs=1e-9)
    np.testing.assert_allclose(odometry.twist, [radius * turn, 0, turn], atol=1e-12)
    assert not odometry.slipping


TWIST = st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3)).map(np.array)


@given(TWIST, st.lists(st.floats(1e-4, 0.5), min_size=1, max_size=30))
def test_pose_after_a_constant_twist_does_not_depend_on_the_steps(twist, times):
    (one, model), (many, _) = make(), make()
    one.reset((0.3, -0.2, 2.9))
    many.reset((0.3, -0.2, 2.9))
    drive(one, model, twist, [sum(times)])
    drive(many, model, twist, times)
    assert many.pose == pytest.approx(one.pose, abs=1e-9)


@given(TWIST, st.floats(0.01, 2))
def test_driving_back_returns_to_the_start(twist, time):
    odometry, model = make("skewed4")
    drive(odometry, model, twist, [time])
    drive(odometry, model, -twist, [time])
    assert odometry.pose == pytest.approx((0, 0, 0), abs=1e-12)


@pytest.mark.parametrize("name", ["mecanum6", "mecanum8"])
def test_odometry_without_any_two_wheels_is_exact_however_these_turn(name):
    """The half circle of above; two wheels turn at random, the others do not slip."""
    rng = np.random.default_rng(5)
    whole, twist = kinematics(name), np.array([math.pi / 2, 0.0, math.pi / 3])
    for pair in itertools.combinations(range(whole.wheel_count), 2):
        odometry = Odometry(PlatformKinematics(robot(name).wheels, pair), QUIET)
        for _ in range(60):
            speeds = whole.J @ twist
            speeds[list(pair)] = rng.normal(0.0, 5.0, 2)
            odometry.update(speeds * 0.05, speeds, 0.05)
        assert odometry.pose == pytest.approx((0, 3.0, math.pi), abs=1e-9)
        np.testing.assert_allclose(odometry.twist, twist, atol=1e-12)
        np.testing.assert_allclose(odometry.constraint_rate, 0.0, atol=1e-12)
        assert not odometry.slipping


def test_heading_is_not_wrapped():
    odometry, model = make()
    drive(odometry, model, np.array([0, 0, 1.0]), [0.1] * 100)
    assert odometry.pose[2] == pytest.approx(10.0)


def test_update_returns_the_coupling_error_step_and_its_rate():
    odometry, model = make("mecanum6")
    steps = np.random.default_rng(1).normal(0, 0.1, 6)
    step = odometry.update(steps, 10 * steps, 0.1)
    assert step.shape == odometry.constraint_rate.shape == (3,)
    np.testing.assert_allclose(step, model.T @ steps)
    np.testing.assert_allclose(odometry.constraint_rate, 10 * model.T @ steps)


@pytest.mark.parametrize("name", ["omniman", "mecanum6", "skewed4", "mecanum8"])
def test_coupling_error_is_the_integral_of_a_known_violation_and_has_its_own_reset(name):
    odometry, model = make(name)
    time = np.linspace(0, 5, 200)
    rng = np.random.default_rng(1)
    twist, away = rng.uniform(-1, 1, 3), rng.uniform(-1, 1, model.constraint_count)
    with_it = np.outer(np.sin(time) + 2 * time, model.J @ twist)
    against = np.outer(0.1 * time**2, model.T_pinv @ away)
    for step in np.diff(with_it + against, axis=0):
        odometry.update(step, step / 0.025, 0.025)
    np.testing.assert_allclose(odometry.coupling_error, 2.5 * away, atol=1e-12)
    odometry.reset((1.0, 2.0, 0.5))
    odometry.configure(model, QUIET)
    np.testing.assert_allclose(odometry.coupling_error, 2.5 * away, atol=1e-12)
    odometry.reset_coupling_error()
    assert not odometry.coupling_error.any()


def test_coupling_error_begins_anew_when_other_wheels_are_idle():
    odometry, _ = make("mecanum6")
    odometry.update(np.arange(6.0), np.zeros(6), 0.1)
    assert odometry.coupling_error.any()
    odometry.configure(PlatformKinematics(robot("mecanum6").wheels, (0,)), QUIET)
    assert not odometry.coupling_error.any()


def test_three_wheels_have_no_constraint_and_never_report_slip():
    odometry, _model = make("omni3")
    assert odometry.update(np.ones(3), np.ones(3), 0.1).shape == (0,)
    assert not odometry.slipping


# ---- covariance -------------------------------------------------------------------------------


def random_motions(seed, n=40):
    rng = np.random.default_rng(seed)
    return rng.uniform([-1, -1, -2], [1, 1, 2], (n, 3))


@pytest.mark.parametrize("name", ALL)
def test_covariance_is_symmetric_positive_and_increasing(name):
    odometry, model = make(name)
    last = 0.0
    for twist in random_motions(2, 200):
        speeds = model.J @ twist + np.random.default_rng(3).normal(0, 0.2, len(model.J))
        odometry.update(speeds * 0.05, speeds, 0.05)
        spread = odometry.covariance
        np.testing.assert_array_equal(spread, spread.T)
        assert np.linalg.eigvalsh(spread).min() >= -1e-12
        assert spread[2, 2] >= last
        last = spread[2, 2]
    assert odometry.covariance.shape == (3, 3)
    assert odometry.covariance[0, 0] > 0


def test_covariance_of_a_straight_drive_has_the_expected_values():
    odometry, model = make(noise_translation=2e-3, noise_rotation=0.5, noise_drift=0, noise_slip=0)
    drive(odometry, model, np.array([0.5, 0, 0]), [0.01] * 400)  # 2 m ahead
    np.testing.assert_allclose(odometry.covariance, np.diag([4e-3, 4e-3, 0]), atol=1e-12)
    odometry.reset()
    drive(odometry, model, np.array([0, 0, -1.0]), [0.01] * 300)  # 3 rad turned on the spot
    np.testing.assert_allclose(odometry.covariance, np.diag([0, 0, 1.5]), atol=1e-12)


def test_heading_drift_increases_the_lateral_variance_with_the_distance():
    odometry, model = make(noise_translation=0, noise_rotation=0, noise_drift=1e-3, noise_slip=0)
    drive(odometry, model, np.array([1.0, 0, 0]), [0.001] * 3000)
    spread = odometry.covariance
    q, length = 1e-3, 3.0  # heading rate as white noise over the path: q s, q s^2 / 2, q s^3 / 3
    assert spread[2, 2] == pytest.approx(q * length)
    assert spread[1, 2] == pytest.approx(q * length**2 / 2, rel=1e-2)
    assert spread[1, 1] == pytest.approx(q * length**3 / 3, rel=1e-2)
    assert spread[0, 0] == pytest.approx(0, abs=1e-12)


def test_covariance_is_propagated_by_the_linearised_composition():
    model = kinematics("skewed4")
    start = (0.4, -0.3, 0.7)
    spread = np.array([[0.04, 0.01, 0.002], [0.01, 0.03, -0.004], [0.002, -0.004, 0.02]])

    def end(offset):
        odometry = Odometry(model, QUIET)
        odometry.reset(tuple(np.array(start) + offset))
        for twist in random_motions(4):
            odometry.update(model.J @ twist * 0.1, model.J @ twist, 0.1)
        return np.array(odometry.pose)

    h = 1e-6
    jacobian = np.column_stack([(end(h * e) - end(-h * e)) / (2 * h) for e in np.eye(3)])
    odometry = Odometry(model, QUIET)
    odometry.reset(start, spread)
    for twist in random_motions(4):
        odometry.update(model.J @ twist * 0.1, model.J @ twist, 0.1)
    np.testing.assert_allclose(
        odometry.covariance, jacobian @ spread @ jacobian.T, rtol=1e-6, atol=1e-9
    )


def test_covariance_agrees_with_a_monte_carlo_simulation():
    q_xy, q_turn, q_drift = 4e-4, 2e-3, 1e-3
    odometry, model = make(
        noise_translation=q_xy, noise_rotation=q_turn, noise_drift=q_drift, noise_slip=0
    )
    rng, samples, dt = np.random.default_rng(7), 4000, 0.02
    poses = np.zeros((samples, 3))
    for i in range(150):
        twist = np.array([0.8, 0.3 * math.sin(0.05 * i), 0.6])
        drive(odometry, model, twist, [dt])
        vx, vy, w = twist
        displacement, heading = math.hypot(vx, vy) * dt, poses[:, 2] + 0.5 * w * dt
        c, s = np.cos(heading), np.sin(heading)
        poses += np.column_stack([c * vx - s * vy, s * vx + c * vy, np.full(samples, w)]) * dt
        poses[:, :2] += rng.normal(0, math.sqrt(q_xy * displacement), (samples, 2))
        poses[:, 2] += rng.normal(0, math.sqrt(q_turn * w * dt + q_drift * displacement), samples)
    sampled = np.cov(poses.T)
    scale = np.sqrt(np.diag(sampled))
    difference = (odometry.covariance - sampled) / np.outer(scale, scale)
    assert abs(difference).max() < 0.08


def test_covariance_increases_faster_where_the_wheels_disagree():
    def spread(skid):
        odometry, model = make()
        for _ in range(100):
            speeds = model.J @ np.array([0.5, 0, 0]) + skid * model.T[0]
            odometry.update(speeds * 0.01, speeds, 0.01)
        assert odometry.pose == pytest.approx((0.5, 0, 0), abs=1e-9)
        return odometry.covariance

    none, little, much = (np.diag(spread(skid)) for skid in (0, 0.2, 1.0))
    assert (none < little).all()
    assert (little < much).all()


# ---- slip -------------------------------------------------------------------------------------


def test_slip_is_reported_above_its_threshold_and_clears():
    odometry, model = make(slip_threshold=0.05, slip_filter=0.1)
    rim = 0.127 / math.sqrt(2)  # along the roller's axle, per radian of one wheel
    ahead = model.J @ np.array([0.5, 0, 0])

    def settle(residual):
        """Drive for a second with a constraint rate of `residual` m/s at the rim."""
        speeds = ahead + model.T_pinv[:, 0] * (residual / rim)
        for _ in range(100):
            odometry.update(speeds * 0.01, speeds, 0.01)
        return odometry.slipping

    assert not settle(0.049)
    assert settle(0.051)
    assert not settle(-0.049)
    assert settle(-0.051)
    assert not settle(0.0)


def test_slip_of_a_single_tick_is_filtered():
    odometry, model = make(slip_threshold=0.05, slip_filter=0.1)
    speeds = model.T_pinv[:, 0] * 1.0  # 0.09 m/s at the rim
    odometry.update(speeds * 0.005, speeds, 0.005)
    assert not odometry.slipping


# ---- calibration ------------------------------------------------------------------------------


@pytest.mark.parametrize(("key", "axis"), [("scale_x", 0), ("scale_y", 1), ("scale_yaw", 2)])
def test_calibration_factors_scale_only_their_own_direction(key, axis):
    twist = np.zeros(3)
    twist[axis] = 0.5
    odometry, model = make("skewed4", **{key: 1.25})
    drive(odometry, model, twist, [0.1] * 10)
    assert odometry.pose[axis] == pytest.approx(0.625)
    assert odometry.twist[axis] == pytest.approx(0.625)
    other, _ = make("skewed4", **{key: 1.25})
    rest = np.array([0.5, 0.5, 0.5])
    rest[axis] = 0
    drive(other, model, rest, [0.1])
    np.testing.assert_allclose(other.twist, rest, atol=1e-12)


@pytest.mark.parametrize(
    ("key", "of", "to"),
    [
        ("x_per_y", 1, 0),
        ("x_per_yaw", 2, 0),
        ("y_per_x", 0, 1),
        ("y_per_yaw", 2, 1),
        ("yaw_per_x", 0, 2),
        ("yaw_per_y", 1, 2),
    ],
)
def test_calibration_cross_terms_add_one_direction_to_another(key, of, to):
    odometry, model = make("skewed4", **{key: 0.2})
    measured = np.zeros(3)
    measured[of] = 0.5
    drive(odometry, model, measured, [0.1])
    expected = measured.copy()
    expected[to] = 0.1
    np.testing.assert_allclose(odometry.twist, expected, atol=1e-12)
    other, _ = make("skewed4", **{key: 0.2})
    rest = np.array([0.5, 0.5, 0.5])
    rest[of] = 0
    drive(other, model, rest, [0.1])
    np.testing.assert_allclose(other.twist, rest, atol=1e-12)


def test_calibration_corrects_only_the_twist():
    """The coupling error is a property of the wheels and stays uncorrected."""
    changes = {"scale_x": 1.2, "x_per_yaw": 0.3, "yaw_per_y": -0.2}
    (odometry, _), (plain, _) = make("mecanum6", **changes), make("mecanum6")
    steps = np.random.default_rng(5).normal(0, 0.1, 6)
    np.testing.assert_array_equal(
        odometry.update(steps, steps, 0.1), plain.update(steps, steps, 0.1)
    )
    correction = OdometryParameters(**changes).correction
    np.testing.assert_allclose(odometry.twist, correction @ plain.twist, atol=1e-12)


def test_calibration_with_large_cross_terms_is_rejected():
    with pytest.raises(ParameterError, match="determinant"):
        OdometryParameters(scale_x=0.5, scale_y=0.5, x_per_y=0.5, y_per_x=0.5)


def test_configure_keeps_the_pose_and_applies_the_factors():
    odometry, model = make()
    drive(odometry, model, np.array([1.0, 0, 0]), [1.0])
    odometry.configure(model, replace(OdometryParameters(), scale_x=2.0))
    assert odometry.pose == pytest.approx((1, 0, 0))
    drive(odometry, model, np.array([1.0, 0, 0]), [1.0])
    assert odometry.pose == pytest.approx((3, 0, 0))


# ---- reset ------------------------------------------------------------------------------------


def test_reset_sets_pose_and_covariance():
    odometry, model = make()
    drive(odometry, model, np.array([1.0, 0.2, 0.1]), [1.0])
    spread = np.diag([0.1, 0.2, 0.3])
    odometry.reset((1, 2, 3), spread)
    assert odometry.pose == (1.0, 2.0, 3.0)
    np.testing.assert_array_equal(odometry.covariance, spread)
    odometry.reset()
    assert odometry.pose == (0.0, 0.0, 0.0)
    assert not odometry.covariance.any()


@pytest.mark.parametrize(
    ("pose", "spread", "why"),
    [
        ((math.nan, 0, 0), None, "not finite"),
        ((0, math.inf, 0), None, "not finite"),
        ((0, 0, -math.inf), None, "not finite"),
        ((1e300, 0, 0), None, "beyond"),
        ((0, 0, 1e9), None, "beyond"),
        ((0, 0, 0), np.full((3, 3), math.nan), "covariance"),
        ((0, 0, 0), np.diag([2e12, 1, 1]), "covariance .* beyond"),
        ((0, 0, 0), np.zeros((2, 2)), "covariance"),
        ((0, 0, 0), np.zeros(9), "covariance"),
        ((0, 0, 0), np.diag([1.0, -1, 1]), "negative variance"),
        ((0, 0, 0), np.array([[1.0, 2, 0], [2, 1, 0], [0, 0, 1]]), "negative variance"),
    ],
)
def test_invalid_reset_is_rejected_and_changes_nothing(pose, spread, why):
    odometry, _ = make()
    odometry.reset((1, 2, 3), np.diag([0.1, 0.2, 0.3]))
    with pytest.raises(InputError, match=why):
        odometry.reset(pose, spread)
    assert odometry.pose == (1.0, 2.0, 3.0)
    np.testing.assert_array_equal(odometry.covariance, np.diag([0.1, 0.2, 0.3]))


def test_asymmetric_covariance_is_made_symmetric():
    odometry, _ = make()
    odometry.reset((0, 0, 0), np.array([[1.0, 5, 0], [-5, 1, 0], [0, 0, 1]]))
    assert np.linalg.eigvalsh(odometry.covariance).min() >= 0
