"""Selection of the factors that calibrate the odometry, around the fit of `least_squares`.

* A measured pose that does not fit all the others is left out and named (Baarda's data snooping
  with the mean-shift model, one pose at a time, the worst first).
* A combination of factors that the runs do not determine is found in the singular values of the
  Jacobian. The factors in it are named and keep their values, cross terms before scales.
* Factors per wheel are chosen where they explain the runs as well as any matrix on the twist does
  (chi-square test of the difference). The test detects a misaligned wheel, or a pose that was
  measured at another point than base_link. It favours the matrix: where that is chosen although
  radii would have been enough, only a little accuracy is lost, while the opposite error would
  leave a bias.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniman_ros.control.odometry import OdometryParameters
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.identification.odometry.campaign import Campaign, Pose
from omniman_ros.identification.odometry.least_squares import (
    LeastSquaresFit,
    Model,
    PoseChain,
    jacobian,
    solve,
    twist_model,
    validated,
    wheel_model,
)

MAX_DEVIATION = 0.01  #: Relative deviation above which a combination is undetermined
MIN_FACTOR_FRACTION = 0.3  #: Share, over the largest, from which a factor belongs to a combination
#: Test value above which a measured pose is an outlier: the part of the squared residuals that an
#: error of this pose would explain, over its 3 degrees of freedom and the variance of the rest (or
#: 1 if that is smaller). It is 99.9 % of F(3, 20), 99.997 % of chi-square.
OUTLIER_LIMIT = 8.0
MAX_OUTLIER_FRACTION = 0.25  #: Largest fraction of the measured poses that may be left out
NORMAL_95 = 1.95996  #: Two-sided 95 % quantile of the normal distribution
NORMAL_80 = 0.84162  #: One-sided 80 % quantile of the normal distribution


@dataclass(frozen=True)
class Factor:
    """One factor of the odometry."""

    name: str  #: Name of the parameter; `wheel_scale.NAME` is the factor of one wheel
    value: float  #: Fitted value
    before: float  #: Value in force while the runs were driven
    half_width: float | None  #: Half width of the 95 % interval; None if it was not fitted


@dataclass(frozen=True)
class UndeterminedFactors:
    """Factors that the runs cannot distinguish."""

    together: tuple[str, ...]  #: Names of the factors
    left: tuple[str, ...]  #: Names of those of them that keep their values


@dataclass(frozen=True)
class Outlier:
    """A measured pose that was left out."""

    index: int  #: Index of the pose in the campaign
    name: str  #: Description of the pose in the campaign, for messages
    off: Pose  #: Deviation from the pose that the others imply, in the floor's frame [m, m, rad]


@dataclass(frozen=True)
class Calibration:
    """The result of a calibration."""

    model: str  #: "wheels" or "twist"
    parameters: OdometryParameters  #: Parameters with new `correction` and `wheel_scale`
    factors: tuple[Factor, ...]  #: All factors of the model
    undetermined: tuple[UndeterminedFactors, ...]  #: Factors that the runs cannot distinguish
    outliers: tuple[Outlier, ...]  #: Measured poses that were left out
    chi_square: float  #: Sum of the squared residuals over their variances
    freedom: int  #: Degrees of freedom
    inflation: float  #: Factor on all variances where the poses scatter more; else 1
    condition: float  #: Ratio of the Jacobian's singular values
    #: Increase of the cost with factors per wheel relative to the whole matrix, over the
    #: inflation; None if factors per wheel cannot be determined.
    wheels_chi_square: float | None
    wheels_limit: float | None  #: Largest increase at which they are chosen; None likewise


@dataclass(frozen=True)
class _WheelFit:
    """Factors per wheel, tested against the whole matrix on the twist."""

    model: Model  #: The model of factors per wheel
    solution: LeastSquaresFit  #: Its fit
    chi_square: float  #: Increase of the cost relative to the whole matrix, over the inflation
    limit: float  #: Largest value of `chi_square` at which it is chosen


def identify(campaign: Campaign, present: OdometryParameters) -> Calibration:
    """Fit the odometry's factors to a campaign.

    Args:
        present: Parameters in force while the runs were driven; undetermined factors keep them.

    Raises:
        InputError: The poses determine no factor, or do not belong to the runs.
        ParameterError: A fitted factor is out of its range.
    """
    model = twist_model(campaign.wheels, present)
    campaign, outliers = _without_outliers(campaign, model)
    chain = PoseChain(campaign)
    solution, undetermined = _fit_determined(campaign, chain, model)
    wheel_fit = _fit_wheels(campaign, chain, present, solution)
    if wheel_fit is not None and wheel_fit.chi_square <= wheel_fit.limit:
        model, solution, undetermined = wheel_fit.model, wheel_fit.solution, ()
    singular = np.linalg.svd(solution.jacobian, compute_uv=False)
    return Calibration(
        model=model.name,
        parameters=validated(model.apply(solution.values.tolist())),
        factors=_factors(model, solution, present),
        undetermined=undetermined,
        outliers=outliers,
        chi_square=solution.cost,
        freedom=solution.freedom,
        inflation=solution.inflation,
        condition=float(singular[0] / singular[-1]),
        wheels_chi_square=None if wheel_fit is None else wheel_fit.chi_square,
        wheels_limit=None if wheel_fit is None else wheel_fit.limit,
    )


def _fit_determined(
    campaign: Campaign, chain: PoseChain, model: Model
) -> tuple[LeastSquaresFit, tuple[UndeterminedFactors, ...]]:
    """Fit the factors of a model that the runs determine."""
    free = tuple(range(len(model.factors)))
    undetermined: list[UndeterminedFactors] = []
    slope = jacobian(campaign, chain, model, model.values)
    variance = 1.0
    while True:
        while (members := _undetermined_columns(slope[:, free], variance)) is not None:
            together = [free[i] for i in members]
            rank = max(model.ranks[i] for i in together)
            left = [i for i in together if model.ranks[i] == rank]
            undetermined.append(UndeterminedFactors(_names(model, together), _names(model, left)))
            free = tuple(i for i in free if i not in left)
            if not free:
                raise InputError("the runs and their measured poses do not determine any factor")
        solution = solve(campaign, chain, model, free, slope)
        if _undetermined_columns(solution.jacobian, solution.inflation) is None:
            return solution, tuple(undetermined)
        variance = solution.inflation


def _names(model: Model, indices: list[int]) -> tuple[str, ...]:
    return tuple(model.factors[i] for i in indices)


def _undetermined_columns(slope: Array, variance: float) -> list[int] | None:
    """Return the columns of the least determined combination, or None if it is determined."""
    rows, columns = slope.shape
    _, singular, combinations = np.linalg.svd(slope)
    smallest = singular[-1] if rows >= columns else 0.0
    if smallest * MAX_DEVIATION > math.sqrt(variance):
        return None
    fractions = np.abs(combinations[-1])
    return [int(i) for i in np.flatnonzero(fractions >= MIN_FACTOR_FRACTION * fractions.max())]


def _without_outliers(campaign: Campaign, model: Model) -> tuple[Campaign, tuple[Outlier, ...]]:
    """Leave out measured poses that do not fit the others, the worst first."""
    outliers: list[Outlier] = []
    max_count = int(MAX_OUTLIER_FRACTION * len(campaign.stations))
    while len(outliers) < max_count:
        chain = PoseChain(campaign)
        solution, _ = _fit_determined(campaign, chain, model)
        worst = _worst_outlier(campaign, chain, solution)
        if worst is None:
            break
        outliers.append(worst)
        campaign = campaign.without(worst.index)
    return campaign, tuple(outliers)


def _worst_outlier(
    campaign: Campaign, chain: PoseChain, solution: LeastSquaresFit
) -> Outlier | None:
    """Return the measured pose that fits worst if it is an outlier, otherwise None."""
    freedom = solution.freedom - 3
    if freedom < 3:
        return None
    basis = np.linalg.qr(solution.jacobian)[0]
    best: tuple[float, int, Any] | None = None
    for k, index in enumerate(campaign.stations):
        shift = chain.shifts[:, 3 * k : 3 * k + 3]
        shift = shift - basis @ (basis.T @ shift)
        deviation, _, rank, _ = np.linalg.lstsq(shift, solution.residuals, rcond=1e-6)
        explained = float(np.sum((shift @ deviation) ** 2))
        if rank == 3 and (best is None or explained > best[0]):
            best = explained, index, deviation
    if best is None:
        return None
    explained, index, deviation = best
    remaining_variance = max(1.0, (solution.cost - explained) / freedom)
    if explained / 3.0 <= OUTLIER_LIMIT * remaining_variance:
        return None
    x, y, angle = deviation.tolist()
    return Outlier(index, campaign.station_name(index), (x, y, angle))


def _fit_wheels(
    campaign: Campaign, chain: PoseChain, present: OdometryParameters, twist: LeastSquaresFit
) -> _WheelFit | None:
    """Fit factors per wheel; None where they cannot be determined.

    They cannot be determined with more wheels than the matrix has room for, or where the runs do
    not even determine the matrix.
    """
    model = wheel_model(campaign.wheels, present)
    if len(twist.free) < len(twist.values) or len(model.factors) >= len(twist.values):
        return None
    try:
        solution, undetermined = _fit_determined(campaign, chain, model)
    except InputError:
        return None
    if undetermined:
        return None
    difference = (solution.cost - twist.cost) / twist.inflation
    limit = _chi_square_80(len(twist.free) - len(solution.free))
    return _WheelFit(model, solution, difference, limit)


def _chi_square_80(freedom: int) -> float:
    """Return the 80 % quantile of chi-square.

    The approximation of Wilson and Hilferty (1931) is within 1 % of it from 2 degrees of freedom
    on.
    """
    part = 2.0 / (9.0 * freedom)
    return float(freedom * (1.0 - part + NORMAL_80 * math.sqrt(part)) ** 3)


def _factors(
    model: Model, solution: LeastSquaresFit, present: OdometryParameters
) -> tuple[Factor, ...]:
    before = _present_values(model, present)
    widths: dict[int, float] = {}
    if solution.free:
        information = solution.jacobian.T @ solution.jacobian
        deviation = np.sqrt(np.diag(np.linalg.inv(information)) * solution.inflation)
        quantile = NORMAL_95
        if solution.inflation > 1.0:  # Student's t instead, by the first term of its expansion
            quantile += (NORMAL_95**3 + NORMAL_95) / (4.0 * solution.freedom)
        for i, sigma in zip(solution.free, deviation.tolist(), strict=True):
            widths[i] = quantile * sigma * float(model.units[i])
    return tuple(
        Factor(name, float(solution.values[i]), before[i], widths.get(i))
        for i, name in enumerate(model.factors)
    )


def _present_values(model: Model, present: OdometryParameters) -> list[float]:
    """Return the model's factors as they are in `present`, not in the model's own base."""
    wheels = [name for name in model.factors if name.startswith("wheel_scale.")]
    scale = present.wheel_scale
    if len(scale) == 1:
        scale = scale * len(wheels)
    return [
        float(scale[wheels.index(name)] if name in wheels else getattr(present, name))
        for name in model.factors
    ]
