import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.control.odometry import Odometry, OdometryParameters
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.identification.odometry.campaign import Accuracy, CalibrationRun, Campaign
from omniman_ros.identification.odometry.least_squares import (
    PoseChain,
    jacobian,
    solve,
    twist_model,
    validated,
    wheel_model,
)
from omniman_ros.identification.odometry.wheel_integration import (
    between,
    compose,
    forward_matrix,
    integrate,
)
from test.identification.odometry.campaigns import ALL_WAYS, TAPE, campaign, random_factors, runs
from test.robots import ALL, kinematics, robot

PRESENT = OdometryParameters()


def fit(model, made):
    chain = PoseChain(made)
    slope = jacobian(made, chain, model, model.values)
    return solve(made, chain, model, range(len(model.factors)), slope)


@pytest.mark.parametrize("name", ALL)
def test_integration_agrees_with_the_odometry_of_the_controller(name):
    rng = np.random.default_rng(1)
    wheels = robot(name).wheels
    n = len(wheels.names)
    parameters = replace(
        random_factors(rng, 0.1), wheel_scale=tuple(rng.uniform(0.9, 1.1, n).tolist())
    )
    radius = tuple((np.array(wheels.radius) * parameters.wheel_scale).tolist())
    odometry = Odometry(kinematics(name, {"wheels.radius": radius}), parameters)
    odometry.reset((1.0, -2.0, 3.0))
    steps = rng.normal(0, 0.1, (200, n))
    steps[50] = 0.0
    expected = [odometry.pose]
    for step in steps:
        odometry.update(step, step / 0.005, 0.005)
        expected.append(odometry.pose)
    positions = 7.0 + np.vstack([np.zeros(n), np.cumsum(steps, axis=0)])
    forward = forward_matrix(wheels, parameters)
    assert forward.shape == (3, n)
    poses = integrate(forward, positions, (1.0, -2.0, 3.0))
    assert poses.shape == (201, 3)
    np.testing.assert_allclose(poses, expected, atol=1e-9)


def test_a_recording_of_one_row_is_no_displacement():
    forward = forward_matrix(robot().wheels, PRESENT)
    np.testing.assert_array_equal(integrate(forward, np.ones((1, 4)), (1, 2, 3)), [[1, 2, 3]])


def test_between_undoes_compose():
    rng = np.random.default_rng(2)
    for _ in range(20):
        a, b = rng.uniform(-3, 3, (2, 3))
        np.testing.assert_allclose(between(a, compose(a, b)), b, atol=1e-12)
    np.testing.assert_allclose(
        compose(np.array([1.0, 2.0, math.pi / 2]), np.array([1.0, 0.0, 0.5])),
        [1.0, 3.0, math.pi / 2 + 0.5],
        atol=1e-12,
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", ALL)
def test_nine_factors_are_recovered_exactly(name, seed):
    true = random_factors(np.random.default_rng(seed), 0.05)
    made = campaign(true, name)
    found = fit(twist_model(made.wheels, PRESENT), made)
    assert found.cost < 1e-12
    model = twist_model(made.wheels, PRESENT)
    np.testing.assert_allclose(
        model.apply(found.values.tolist()).correction, true.correction, atol=1e-8
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["omniman", "ig42", "skewed4", "omni3"])
def test_radii_and_rollers_are_recovered_exactly(name, seed):
    rng = np.random.default_rng(seed)
    n = len(robot(name).wheels.names)
    true = OdometryParameters(
        wheel_scale=tuple(rng.uniform(0.96, 1.04, n).tolist()), scale_y=0.98, scale_yaw=1.015
    )
    made = campaign(true, name)
    model = wheel_model(made.wheels, PRESENT)
    found = model.apply(fit(model, made).values.tolist())
    np.testing.assert_allclose(found.wheel_scale, true.wheel_scale, atol=1e-8)
    assert (found.scale_y, found.scale_yaw) == pytest.approx((0.98, 1.015), abs=1e-8)
    assert found.scale_x == 1.0


def test_a_calibration_in_force_is_the_start_of_the_fit_and_not_applied_twice():
    """The wheels' positions are raw: what was in force while driving does not affect them."""
    true = random_factors(np.random.default_rng(3), 0.05)
    present = replace(random_factors(np.random.default_rng(4), 0.05), wheel_scale=(1.0,))
    made = campaign(true)
    model = twist_model(made.wheels, present)
    np.testing.assert_allclose(
        model.apply(fit(model, made).values.tolist()).correction, true.correction, atol=1e-8
    )
    scaled = replace(present, wheel_scale=(1.02, 0.99, 1.0, 1.01))
    model = twist_model(made.wheels, scaled)
    found = model.apply(fit(model, made).values.tolist())
    assert found.wheel_scale == scaled.wheel_scale
    np.testing.assert_allclose(
        forward_matrix(made.wheels, found) @ kinematics().J,
        forward_matrix(made.wheels, true) @ kinematics().J,
        atol=1e-7,
    )


@pytest.mark.parametrize("skip", [(3,), (0,), (2, 3, 4, 9), (len(ALL_WAYS),)])
def test_a_missing_pose_joins_the_runs_beside_it(skip):
    true = random_factors(np.random.default_rng(5))
    made = campaign(true, skip=skip)
    assert len(made.stations) == len(ALL_WAYS) + 1 - len(skip)
    model = twist_model(made.wheels, PRESENT)
    np.testing.assert_allclose(
        model.apply(fit(model, made).values.tolist()).correction, true.correction, atol=1e-8
    )


def test_wheel_positions_may_jump_between_runs():
    true = random_factors(np.random.default_rng(6))
    made = campaign(true, skip=(2,))
    moved = [replace(run, positions=run.positions + 5.0 * i) for i, run in enumerate(made.runs)]
    made = replace(made, runs=tuple(moved))
    model = twist_model(made.wheels, PRESENT)
    assert fit(model, made).cost < 1e-12


def test_whitened_residuals_have_unit_covariance():
    """1500 draws of the poses' errors: correlated neighbours, headings that turn what follows."""
    true = random_factors(np.random.default_rng(7))
    noise = Accuracy(0.004, 0.002)
    rng = np.random.default_rng(8)
    forward = forward_matrix(robot().wheels, true)
    ways = {key: ALL_WAYS[key] for key in ("ahead", "half turn left", "diagonal", "arc")}
    made = campaign(true, ways=ways, accuracy=noise, skip=(2,))
    drawn = []
    for _ in range(1500):
        errors = rng.normal(size=(5, 3)) * [noise.position, noise.position, noise.heading]
        poses = tuple(
            None if pose is None else tuple(np.add(pose, error).tolist())
            for pose, error in zip(made.poses, errors, strict=True)
        )
        drawn.append(PoseChain(replace(made, poses=poses)).residuals(forward))
    drawn = np.array(drawn)
    assert drawn.shape == (1500, 9)
    assert np.abs(drawn.mean(axis=0)).max() < 0.1
    np.testing.assert_allclose(np.cov(drawn.T), np.eye(9), atol=0.16)


def test_shifts_are_the_effect_of_a_pose_error_on_the_residuals():
    forward = forward_matrix(robot().wheels, PRESENT)
    clean = PoseChain(campaign(skip=(1,)))
    for k, index in ((0, 0), (1, 2), (5, 6)):
        error = np.array([2e-5, -1e-5, 3e-5])
        moved = PoseChain(campaign(skip=(1,), off={index: error})).residuals(forward)
        expected = clean.shifts[:, 3 * k : 3 * k + 3] @ error
        change = moved - clean.residuals(forward)
        np.testing.assert_allclose(change, expected, atol=3e-3 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"poses": ((0.0, 0.0, 0.0),)}, "1 poses for 14 runs"),
        ({"poses": (None,) * 14 + ((0.0, 0.0, 0.0),)}, "fewer than two"),
        ({"poses": ((0.0, math.nan, 0.0),) + ((0.0, 0.0, 0.0),) * 14}, "not finite"),
        ({"runs": (CalibrationRun("odd", np.zeros((5, 3))),) * 14}, "run 'odd'.*4 wheels"),
        ({"runs": (CalibrationRun("none", np.zeros((0, 4))),) * 14}, "run 'none'"),
        ({"runs": (CalibrationRun("bad", np.full((2, 4), math.inf)),) * 14}, "run 'bad'"),
    ],
)
def test_an_inconsistent_campaign_is_refused(change, why):
    with pytest.raises(InputError, match=why):
        replace(campaign(), **change)


@pytest.mark.parametrize("numbers", [(0.0, 0.1), (0.1, 0.0), (math.nan, 0.1), (0.1, math.inf)])
def test_an_accuracy_must_be_positive(numbers):
    with pytest.raises(InputError, match="accuracy"):
        Accuracy(*numbers)


def test_poses_of_another_drive_are_refused():
    made = campaign()
    poses = tuple((10.0 * i, 0.0, 1.0 * i) for i in range(len(made.poses)))
    with pytest.raises(InputError, match="not those of these runs"):
        fit(twist_model(made.wheels, PRESENT), replace(made, poses=poses))


def test_factors_out_of_their_range_are_refused():
    with pytest.raises(ParameterError, match=r"x_per_y"):
        validated(OdometryParameters(x_per_y=0.6))


def test_stations_have_names():
    made = Campaign(
        robot().wheels, runs("omniman", {"ahead": [(1, 0, 0)]}), ((0, 0, 0),) * 2, TAPE
    )
    assert [made.station_name(i) for i in made.stations] == ["at the start", "after 'ahead'"]
