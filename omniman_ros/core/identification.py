"""Which factors calibrate the odometry: outliers, what cannot be told apart, and how sure it is.

The steps around the least squares of `calibration`:

* A measured pose that does not fit all the others is left out and named (Baarda's data snooping
  on the mean-shift model, one at a time, the worst first).
* A combination of factors that the runs do not determine is found in the singular values of the
  Jacobian. The factors in it are named and left as they are, cross terms before scales.
* Factors per wheel are taken where they explain the runs as well as any matrix on the twist does
  (chi-square test on the difference); a wheel mounted askew, or a pose measured at another point
  than base_link, is seen by that. The test leans to the matrix: where it is taken and radii would
  have done, all that is lost is a little accuracy, while the other way round there is a bias.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.calibration import (
    Campaign,
    Chain,
    Model,
    Pose,
    Solution,
    checked,
    jacobian,
    solve,
    twist_model,
    wheel_model,
)
from omniman_ros.core.errors import InputError
from omniman_ros.core.odometry import OdometryParameters

Array = NDArray[np.float64]

UNTOLD = 0.01
"""Standard deviation from which on a combination of factors counts as not determined."""
SHARE = 0.3
"""Share of a factor in such a combination, over the largest, from which on it belongs to it."""
OUTLIER = 8.0
"""Test value of a measured pose that is off: what its own error would explain of the squared
residuals, over its 3 degrees of freedom and the variance of the rest (or 1 if that is smaller).
99.9 % of F(3, 20), 99.997 % of chi-square."""
MOST_OUTLIERS = 0.25
"""Share of the measured poses that may be left out."""
NORMAL_95, NORMAL_80 = 1.95996, 0.84162
"""Quantiles of the normal distribution: two-sided 95 %, one-sided 80 %."""


@dataclass(frozen=True)
class Factor:
    """One factor.

    Attributes:
        name: `wheel_scale.NAME` for one wheel's.
        value, before: Fitted, and in force while the runs were driven.
        half_width: Of the 95 % confidence interval; None if the factor was left as it was.
    """

    name: str
    value: float
    before: float
    half_width: float | None


@dataclass(frozen=True)
class Untold:
    """Factors that the runs do not tell apart, and those of them that were left as they were."""

    together: tuple[str, ...]
    left: tuple[str, ...]


@dataclass(frozen=True)
class Outlier:
    """A measured pose that was left out.

    Attributes:
        index: Of the pose.
        name: For people.
        off: How far it is from where the others say that it is, in the floor's frame [m, m, rad].
    """

    index: int
    name: str
    off: Pose


@dataclass(frozen=True)
class Calibration:
    """The result.

    Attributes:
        model: "wheels" or "twist".
        parameters: To be put into force; `correction` and `wheel_scale` are what has changed.
        factors, untold, outliers: See there.
        chi_square, freedom: Sum of the squared residuals over their variances, and the degrees
            of freedom.
        inflation: Factor on all variances, because the poses scatter more than was stated; or 1.
        condition: Ratio of the Jacobian's singular values.
        wheels_chi_square, wheels_limit: How much worse factors per wheel explain the runs than
            the whole matrix does, over the inflation; up to the limit they are taken. None where
            they could not be told apart.
    """

    model: str
    parameters: OdometryParameters
    factors: tuple[Factor, ...]
    untold: tuple[Untold, ...]
    outliers: tuple[Outlier, ...]
    chi_square: float
    freedom: int
    inflation: float
    condition: float
    wheels_chi_square: float | None
    wheels_limit: float | None


def identify(campaign: Campaign, present: OdometryParameters) -> Calibration:
    """Fit the odometry's factors to a campaign.

    Args:
        campaign: Runs and measured poses.
        present: Parameters in force while they were driven; what is not determined stays so.

    Raises:
        InputError: The poses do not determine one factor, or have nothing to do with the runs.
        ParameterError: A factor would be out of its range.
    """
    model = twist_model(campaign.wheels, present)
    campaign, outliers = _without_outliers(campaign, model)
    chain = Chain(campaign)
    solution, untold = _fit(campaign, chain, model)
    chosen = _by_wheels(campaign, chain, present, solution)
    wheels_chi_square = wheels_limit = None
    if chosen is not None:
        wheels, by_wheel, wheels_chi_square, wheels_limit = chosen
        if wheels_chi_square <= wheels_limit:
            model, solution, untold = wheels, by_wheel, ()
    singular = np.linalg.svd(solution.jacobian, compute_uv=False)
    return Calibration(
        model=model.name,
        parameters=checked(model.apply(solution.values.tolist())),
        factors=_factors(model, solution, twist_model(campaign.wheels, present).base),
        untold=untold,
        outliers=outliers,
        chi_square=solution.cost,
        freedom=solution.freedom,
        inflation=solution.inflation,
        condition=float(singular[0] / singular[-1]),
        wheels_chi_square=wheels_chi_square,
        wheels_limit=wheels_limit,
    )


def _fit(campaign: Campaign, chain: Chain, model: Model) -> tuple[Solution, tuple[Untold, ...]]:
    """Fit what can be told of a model."""
    free = tuple(range(len(model.factors)))
    untold: list[Untold] = []
    slope = jacobian(campaign, chain, model, model.values)
    variance = 1.0
    while True:
        while (members := _undetermined(slope[:, free], variance)) is not None:
            together = [free[i] for i in members]
            rank = max(model.ranks[i] for i in together)
            left = [i for i in together if model.ranks[i] == rank]
            untold.append(Untold(_names(model, together), _names(model, left)))
            free = tuple(i for i in free if i not in left)
            if not free:
                raise InputError("the runs and their measured poses do not determine one factor")
        solution = solve(campaign, chain, model, free, slope)
        if _undetermined(solution.jacobian, solution.inflation) is None:
            return solution, tuple(untold)
        variance = solution.inflation


def _names(model: Model, indices: list[int]) -> tuple[str, ...]:
    return tuple(model.factors[i] for i in indices)


def _undetermined(slope: Array, variance: float) -> list[int] | None:
    """Columns that make up the least determined combination, if it is not determined."""
    rows, columns = slope.shape
    _, singular, combinations = np.linalg.svd(slope)
    least = singular[-1] if rows >= columns else 0.0
    if least * UNTOLD > math.sqrt(variance):
        return None
    part = np.abs(combinations[-1])
    return [int(i) for i in np.flatnonzero(part >= SHARE * part.max())]


def _without_outliers(campaign: Campaign, model: Model) -> tuple[Campaign, tuple[Outlier, ...]]:
    """Leave out measured poses that do not fit the others, the worst first."""
    outliers: list[Outlier] = []
    most = int(MOST_OUTLIERS * len(campaign.stations))
    while len(outliers) < most:
        chain = Chain(campaign)
        solution, _ = _fit(campaign, chain, model)
        worst = _worst(campaign, chain, solution)
        if worst is None:
            break
        outliers.append(worst)
        campaign = campaign.without(worst.index)
    return campaign, tuple(outliers)


def _worst(campaign: Campaign, chain: Chain, solution: Solution) -> Outlier | None:
    """The measured pose that fits least, if it is an outlier."""
    freedom = solution.freedom - 3
    if freedom < 3:
        return None
    basis = np.linalg.qr(solution.jacobian)[0]
    best: tuple[float, int, Any] | None = None
    for k, index in enumerate(campaign.stations):
        shift = chain.shifts[:, 3 * k : 3 * k + 3]
        shift = shift - basis @ (basis.T @ shift)
        off, _, rank, _ = np.linalg.lstsq(shift, solution.residuals, rcond=1e-6)
        explained = float(np.sum((shift @ off) ** 2))
        if rank == 3 and (best is None or explained > best[0]):
            best = explained, index, off
    if best is None:
        return None
    explained, index, off = best
    rest = max(1.0, (solution.cost - explained) / freedom)
    if explained / 3.0 <= OUTLIER * rest:
        return None
    x, y, angle = off.tolist()
    return Outlier(index, campaign.station_name(index), (x, y, angle))


def _by_wheels(
    campaign: Campaign, chain: Chain, present: OdometryParameters, twist: Solution
) -> tuple[Model, Solution, float, float] | None:
    """Fit factors per wheel, with the test value against the whole matrix and its limit."""
    wheels = wheel_model(campaign.wheels, present)
    if len(twist.free) < len(twist.values) or len(wheels.factors) >= len(twist.values):
        return None  # more wheels than the matrix has room for, or not even that is determined
    try:
        solution, untold = _fit(campaign, chain, wheels)
    except InputError:
        return None
    if untold:
        return None
    difference = (solution.cost - twist.cost) / twist.inflation
    return wheels, solution, difference, _chi_square_80(len(twist.free) - len(solution.free))


def _chi_square_80(freedom: int) -> float:
    """80 % of chi-square (Wilson and Hilferty 1931: within 1 % of it from 2 degrees on)."""
    part = 2.0 / (9.0 * freedom)
    return float(freedom * (1.0 - part + NORMAL_80 * math.sqrt(part)) ** 3)


def _factors(model: Model, solution: Solution, present: OdometryParameters) -> tuple[Factor, ...]:
    before = _values_in(model, present)
    widths: dict[int, float] = {}
    if solution.free:
        information = solution.jacobian.T @ solution.jacobian
        deviation = np.sqrt(np.diag(np.linalg.inv(information)) * solution.inflation)
        quantile = NORMAL_95
        if solution.inflation > 1.0:  # Student's t instead, by its first correction
            quantile += (NORMAL_95**3 + NORMAL_95) / (4.0 * solution.freedom)
        for i, sigma in zip(solution.free, deviation.tolist(), strict=True):
            widths[i] = quantile * sigma * float(model.units[i])
    return tuple(
        Factor(name, float(solution.values[i]), before[i], widths.get(i))
        for i, name in enumerate(model.factors)
    )


def _values_in(model: Model, present: OdometryParameters) -> list[float]:
    """The model's factors as they are in `present`, not in the model's own base."""
    wheels = [name for name in model.factors if name.startswith("wheel_scale.")]
    scale = present.wheel_scale
    if len(scale) == 1:
        scale = scale * len(wheels)
    return [
        float(scale[wheels.index(name)] if name in wheels else getattr(present, name))
        for name in model.factors
    ]
