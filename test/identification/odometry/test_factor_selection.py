import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.control.odometry import OdometryParameters
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.identification.odometry.campaign import Accuracy
from omniman_ros.identification.odometry.factor_selection import identify
from omniman_ros.identification.odometry.least_squares import CROSS_TERMS, SCALES
from omniman_ros.identification.odometry.wheel_integration import forward_matrix
from test.identification.odometry.campaigns import (
    ALL_WAYS,
    HALF_TURN,
    TAPE,
    campaign,
    random_factors,
)
from test.robots import ALL, kinematics, robot

PRESENT = OdometryParameters()
RADII = OdometryParameters(wheel_scale=(1.02, 0.985, 1.01, 0.99), scale_y=0.985, scale_yaw=0.99)


def left(found):
    return {factor.name for factor in found.factors if factor.half_width is None}


def corrected(parameters):
    """The matrix (3, 3) of the parameters on the twist of the omniman robot as configured."""
    return forward_matrix(robot().wheels, parameters) @ kinematics().J


def test_wrong_radii_are_found_wheel_by_wheel():
    found = identify(campaign(RADII), PRESENT)
    assert found.model == "wheels"
    np.testing.assert_allclose(found.parameters.wheel_scale, RADII.wheel_scale, atol=1e-8)
    assert found.parameters.scale_y == pytest.approx(0.985, abs=1e-8)
    assert found.factors[0].name == "wheel_scale.front_left"
    assert not found.undetermined and not found.outliers
    assert found.freedom == 3 * len(ALL_WAYS) - 6


def test_factors_per_wheel_replace_a_calibration_in_force():
    before = replace(PRESENT, scale_x=1.03, x_per_y=0.01, wheel_scale=(0.98,))
    found = identify(campaign(RADII), before)
    assert found.model == "wheels"
    assert found.parameters.scale_x == 1.0 and found.parameters.x_per_y == 0.0
    np.testing.assert_allclose(found.parameters.wheel_scale, RADII.wheel_scale, atol=1e-8)
    assert found.factors[0].before == 0.98


def test_a_misaligned_wheel_is_not_taken_for_a_wrong_radius():
    """The robot drifts sideways and turns, which no radii can cause together."""
    true = replace(PRESENT, y_per_x=0.01, x_per_y=-0.01, yaw_per_x=0.02)
    found = identify(campaign(true), PRESENT)
    assert found.model == "twist"
    assert found.parameters.wheel_scale == (1.0,)
    np.testing.assert_allclose(found.parameters.correction, true.correction, atol=1e-8)
    assert found.wheels_chi_square > found.wheels_limit == pytest.approx(4.642, rel=0.01)


@pytest.mark.parametrize("name", ALL)
def test_any_platform_is_calibrated(name):
    true = random_factors(np.random.default_rng(1))
    found = identify(campaign(true, name), PRESENT)
    assert found.model == "twist"
    np.testing.assert_allclose(found.parameters.correction, true.correction, atol=1e-8)
    assert {factor.name for factor in found.factors} == {*SCALES, *CROSS_TERMS}


def test_factors_per_wheel_are_not_fitted_to_too_many_wheels():
    found = identify(campaign(replace(PRESENT, scale_x=1.01), "mecanum8"), PRESENT)
    assert found.model == "twist" and found.wheels_chi_square is None


def test_driving_ahead_alone_determines_the_factors_of_x_only():
    true = random_factors(np.random.default_rng(2))
    ways = {f"{i}": [((-1) ** i * 1.5, 0, 0)] for i in range(6)}
    present = replace(PRESENT, scale_y=0.97, yaw_per_y=0.001)
    found = identify(campaign(true, ways=ways), present)
    determined = {"scale_x": true.scale_x, "y_per_x": true.y_per_x, "yaw_per_x": true.yaw_per_x}
    for factor in found.factors:
        if factor.name in determined:
            assert factor.value == pytest.approx(determined[factor.name], abs=1e-7)
            assert 0 < factor.half_width < 0.01
        else:
            assert factor.half_width is None
            assert factor.value == factor.before == getattr(present, factor.name)
    assert left(found) == {*SCALES, *CROSS_TERMS} - set(determined)
    assert {name for factors in found.undetermined for name in factors.left} == left(found)


def test_half_turns_determine_their_centre_and_whole_turns_do_not():
    ways = dict(ALL_WAYS)
    for name in list(ways):
        if "turn" in name or name == "arc":
            ways[name] = [(0, 0, math.copysign(2 * HALF_TURN, 1 if "left" in name else -1))]
    assert {"x_per_yaw", "y_per_yaw"} <= left(identify(campaign(ways=ways), PRESENT))
    assert not left(identify(campaign(), PRESENT))


def test_scales_are_fitted_before_cross_terms_that_cannot_be_distinguished():
    ways = {f"diagonal {i}": [(s, s, 0)] for i, s in enumerate((1.2, -1.2, 1.2, -1.2))}
    ways["turn"] = [(0, 0, 3 * HALF_TURN)]
    found = identify(campaign(replace(PRESENT, scale_x=1.02, scale_y=0.98), ways=ways), PRESENT)
    together = [set(factors.together) for factors in found.undetermined]
    assert {"scale_x", "x_per_y"} in together and {"scale_y", "y_per_x"} in together
    assert {"x_per_y", "y_per_x"} <= left(found)
    assert found.parameters.scale_x == pytest.approx(1.02, abs=1e-4)
    assert found.parameters.scale_y == pytest.approx(0.98, abs=1e-4)


def test_runs_that_go_nowhere_are_refused():
    with pytest.raises(InputError, match="do not determine any factor"):
        identify(campaign(ways={"a": [(0.001, 0, 0)], "b": [(0, 0.001, 0)]}), PRESENT)


def test_a_factor_out_of_its_range_is_refused():
    with pytest.raises(ParameterError, match="scale_x"):
        identify(campaign(replace(PRESENT, scale_x=0.4)), PRESENT)


@pytest.mark.parametrize(
    "true",
    [
        RADII,
        pytest.param(random_factors(np.random.default_rng(9)), marks=pytest.mark.exhaustive),
    ],
)
def test_confidence_intervals_cover_the_truth(true):
    rng = np.random.default_rng(10)
    hits, widths = [], []
    for _ in range(40):
        found = identify(campaign(true, noise=TAPE, rng=rng), PRESENT)
        if true is RADII and found.model == "twist":
            continue  # in 20 % of the draws, by the level of the test
        for factor in found.factors:
            wheel = factor.name.removeprefix("wheel_scale.")
            index = ["front_left", "front_right", "rear_left", "rear_right"]
            value = (
                true.wheel_scale[index.index(wheel)]
                if wheel != factor.name
                else getattr(true, factor.name)
            )
            hits.append(abs(factor.value - value) <= factor.half_width)
            widths.append(factor.half_width)
    assert len(hits) > 150
    assert 0.91 <= np.mean(hits) <= 0.99
    assert max(widths) < 0.02


def test_the_inflation_is_the_variance_of_the_poses_over_the_stated_one():
    true = random_factors(np.random.default_rng(5))
    worse = Accuracy(3 * TAPE.position, 3 * TAPE.heading)
    found, right = (
        identify(
            campaign(true, noise=worse, rng=np.random.default_rng(6), accuracy=stated), PRESENT
        )
        for stated in (TAPE, worse)
    )
    assert found.inflation == pytest.approx(9 * right.chi_square / right.freedom, rel=0.01)
    for factor, same in zip(found.factors, right.factors, strict=True):
        assert factor.half_width == pytest.approx(same.half_width, rel=0.3)


def test_one_bad_pose_is_named_and_left_out():
    rng = np.random.default_rng(12)
    true = random_factors(rng)
    off = np.array([0.0, 0.1, 0.0])
    for index in (1, 4, 9, 14):
        found = identify(campaign(true, noise=TAPE, rng=rng, off={index: off}), PRESENT)
        (outlier,) = found.outliers
        assert outlier.index == index
        assert outlier.name == f"after '{list(ALL_WAYS)[index - 1]}'"
        np.testing.assert_allclose(outlier.off, off, atol=0.03)
        error = corrected(found.parameters) - true.correction
        assert np.abs(error).max() < 0.012


def test_a_heading_of_the_wrong_sign_and_a_digit_too_few_are_both_found():
    rng = np.random.default_rng(13)
    off = {3: np.array([0.0, 0.0, 0.3]), 8: np.array([-0.9, 0.0, 0.0])}
    found = identify(campaign(random_factors(rng), noise=TAPE, rng=rng, off=off), PRESENT)
    assert {outlier.index for outlier in found.outliers} == {3, 8}
    assert found.outliers[0].index == 8, "the worst first"


def test_good_poses_are_hardly_ever_left_out():
    rng = np.random.default_rng(14)
    campaigns = [campaign(RADII, noise=TAPE, rng=rng) for _ in range(25)]
    assert sum(len(identify(made, PRESENT).outliers) for made in campaigns) <= 1
