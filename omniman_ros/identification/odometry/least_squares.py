"""Least squares of the odometry's factors on runs with measured poses between them.

A campaign is a chain: the robot drives runs one after the other, and its pose is measured between
them. The wheel motion of each run is integrated on SE(2) exactly as the odometry does it; the
fitted factors are those whose poses fit the measured ones best. A pose is the end of one run and
the start of the next, so the errors of two successive runs are correlated: the weights are those
of the whole chain (generalised least squares, Gauss-Newton).

A platform whose commands contain no slip moves its n wheels in three directions only. Any error of
the geometry therefore has the effect of a matrix (3, 3) on the twist: the nine factors of
`twist_model`. Wrong radii alone result in a subset of those matrices; `wheel_model` is for
platforms within that subset.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from omniman_ros.control.odometry import OdometryParameters
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build, flatten
from omniman_ros.core.platform import Wheels
from omniman_ros.identification.odometry.campaign import Campaign
from omniman_ros.identification.odometry.wheel_integration import arcs, between, forward_matrix

SCALES = ("scale_x", "scale_y", "scale_yaw")  #: Factors on the diagonal of the twist's matrix
#: Names of the factors beside the diagonal of that matrix
CROSS_TERMS = ("x_per_y", "x_per_yaw", "y_per_x", "y_per_yaw", "yaw_per_x", "yaw_per_y")
DIFFERENCE_STEP = 1e-6  #: Step of the central differences, in relative units
MAX_ITERATIONS = 30  #: Largest number of Gauss-Newton steps
JACOBIAN_UPDATE_STEP = 1e-3  #: Step above which the Jacobian is evaluated anew, in relative units
CONVERGED_STEP = 1e-9  #: Step below which the iteration has converged, in relative units


@dataclass(frozen=True)
class Model:
    """Some factors of the odometry as unknowns, in relative units: 0.01 is 1 % of each factor."""

    name: str  #: Name of the model, for messages
    factors: tuple[str, ...]  #: p names of the unknowns; `wheel_scale.NAME` is of one wheel
    base: OdometryParameters  #: Parameters that contain all other factors
    units: Array  #: (p,) one relative unit of each factor in the factor's own unit
    ranks: tuple[int, ...]  #: (p,) ranks: the highest is not fitted, if indistinguishable
    #: Maps values (p,) in the factors' own units to parameters
    apply: Callable[[Sequence[float]], OdometryParameters]

    @property
    def values(self) -> Array:
        """Values (p,) of the factors in `base`, in their own units."""
        base = flatten(self.base)
        wheels = [name for name in self.factors if name.startswith("wheel_scale.")]
        scale = dict(zip(wheels, self.base.wheel_scale, strict=True)) if wheels else {}
        return np.array([base[name] if name in base else scale[name] for name in self.factors])


def twist_model(wheels: Wheels, present: OdometryParameters) -> Model:
    """Return the model of the nine factors on the twist; the wheels' own factors do not change."""
    size = max(map(math.hypot, wheels.x, wheels.y))
    length = {"x_per_yaw": size, "y_per_yaw": size, "yaw_per_x": 1 / size, "yaw_per_y": 1 / size}
    names = SCALES + CROSS_TERMS

    def apply(values: Sequence[float]) -> OdometryParameters:
        factors: dict[str, Any] = dict(zip(names, map(float, values), strict=True))
        return replace(present, **factors)

    units = np.array([length.get(name, 1.0) for name in names])
    return Model("twist", names, present, units, (0,) * 3 + (1,) * 6, apply)


def wheel_model(wheels: Wheels, present: OdometryParameters) -> Model:
    """Return the model of a factor for each wheel, for y and for yaw.

    These are the effects of wrong radii and rollers. There is no factor for x: the rollers of a
    Mecanum wheel do not rotate while the robot drives ahead, so travel ahead measures the radii.
    The cross terms are zero.
    """
    n = len(wheels.names)
    scale = present.wheel_scale if len(present.wheel_scale) == n else present.wheel_scale * n
    zero: dict[str, Any] = dict.fromkeys(CROSS_TERMS, 0.0)
    base = replace(present, scale_x=1.0, wheel_scale=scale, **zero)
    names = (*(f"wheel_scale.{name}" for name in wheels.names), "scale_y", "scale_yaw")

    def apply(values: Sequence[float]) -> OdometryParameters:
        *radii, y, yaw = map(float, values)
        return replace(base, wheel_scale=tuple(radii), scale_y=y, scale_yaw=yaw)

    return Model("wheels", names, base, np.ones(n + 2), (1,) * n + (0, 0), apply)


class PoseChain:
    """The residuals of a campaign and their weights.

    A residual is the measured pose of a station in the frame of the station before it, less the
    same pose by the odometry: three rows for each pair of stations. Errors e of the measured poses
    result in the residuals G e, whose covariance is G S G', block tridiagonal.
    """

    def __init__(self, campaign: Campaign) -> None:
        steps = [np.diff(run.positions, axis=0) for run in campaign.runs]
        lengths = [len(step) for step in steps]
        self._steps = np.vstack(steps)
        self._run_of_step = np.repeat(np.arange(len(steps)), lengths)
        self._first_step = np.cumsum([0, *lengths[:-1]])
        stations = campaign.stations
        self._pairs = list(itertools.pairwise(stations))
        measured = [np.array(campaign.poses[i]) for i in stations]
        self._measured = [between(a, b) for a, b in itertools.pairwise(measured)]
        rows = 3 * len(self._pairs)
        errors = np.zeros((rows, rows + 3))
        for k, (start, relative) in enumerate(zip(measured, self._measured, strict=False)):
            rotation = se2.rotation(float(start[2]))
            block = slice(3 * k, 3 * k + 3)
            errors[block, 3 * k : 3 * k + 3] = -rotation
            errors[block, 3 * k + 2] += [relative[1], -relative[0], 0.0]
            errors[block, 3 * k + 3 : 3 * k + 6] = rotation
        accuracy = campaign.accuracy
        deviation = np.tile(
            [accuracy.position, accuracy.position, accuracy.heading], rows // 3 + 1
        )
        spread = errors * deviation
        self._whiten = np.linalg.inv(np.linalg.cholesky(spread @ spread.T))
        #: (r, r + 3) whitened residuals that a unit error of each measured pose would make
        self.shifts = self._whiten @ errors

    def residuals(self, forward: Array) -> Array:
        """Return the whitened residuals (r,) of a forward Jacobian (3, n)."""
        displacements = self._run_displacements(forward).tolist()
        rows = []
        for (start, end), measured in zip(self._pairs, self._measured, strict=True):
            x = y = theta = 0.0
            for dx, dy, dtheta in displacements[start:end]:
                c, s = math.cos(theta), math.sin(theta)
                x, y, theta = x + c * dx - s * dy, y + s * dx + c * dy, theta + dtheta
            rows.append((measured[0] - x, measured[1] - y, se2.wrap(float(measured[2]) - theta)))
        return self._whiten @ np.ravel(rows)

    def _run_displacements(self, forward: Array) -> Array:
        """Return the pose (N, 3) of the end of each run in the frame of its start.

        All runs are integrated together.
        """
        dx, dy, dtheta = arcs(self._steps @ forward.T)
        total = np.concatenate([[0.0], np.cumsum(dtheta)])
        heading = total[:-1] - total[self._first_step][self._run_of_step]
        c, s = np.cos(heading), np.sin(heading)
        count = len(self._first_step)
        return np.column_stack(
            [
                np.bincount(self._run_of_step, weights, count)
                for weights in (c * dx - s * dy, s * dx + c * dy, dtheta)
            ]
        )


@dataclass(frozen=True)
class LeastSquaresFit:
    """The least-squares fit of some of a model's factors."""

    free: tuple[int, ...]  #: Indices of the model's factors that were fitted
    values: Array  #: (p,) all of the model's factors, in their own units
    residuals: Array  #: (r,) whitened residuals
    jacobian: Array  #: (r, f) derivatives of the whitened residuals, in relative units

    @property
    def cost(self) -> float:
        """Sum of the squared whitened residuals; about `freedom` if the fit is good."""
        return float(self.residuals @ self.residuals)

    @property
    def freedom(self) -> int:
        """Degrees of freedom."""
        return len(self.residuals) - len(self.free)

    @property
    def inflation(self) -> float:
        """Variance of the residuals over the stated one where it is larger, otherwise 1."""
        return max(1.0, self.cost / self.freedom) if self.freedom > 0 else 1.0


def jacobian(campaign: Campaign, chain: PoseChain, model: Model, values: Array) -> Array:
    """Return the derivatives (r, p) of the residuals at values (p,), in relative units."""

    def residuals(trial: Array) -> Array:
        return chain.residuals(forward_matrix(campaign.wheels, model.apply(trial.tolist())))

    return np.column_stack(
        [
            (residuals(values + change) - residuals(values - change)) / (2.0 * DIFFERENCE_STEP)
            for change in DIFFERENCE_STEP * np.diag(model.units)
        ]
    )


def solve(
    campaign: Campaign,
    chain: PoseChain,
    model: Model,
    free: Sequence[int],
    base_jacobian: Array,
) -> LeastSquaresFit:
    """Fit some factors of a model; the others keep their values of the model's base.

    The residuals are nearly linear in the factors, so a Jacobian is used until a step is longer
    than `JACOBIAN_UPDATE_STEP`.

    Raises:
        InputError: The iteration does not converge: the measured poses are not those of the runs.
    """
    chosen = list(free)
    values, inverse = model.values, np.linalg.pinv(base_jacobian[:, chosen])
    for _ in range(MAX_ITERATIONS):
        residuals = chain.residuals(forward_matrix(campaign.wheels, model.apply(values.tolist())))
        step = -inverse @ residuals
        if np.abs(step).max() < CONVERGED_STEP:
            final = jacobian(campaign, chain, model, values)[:, chosen]
            return LeastSquaresFit(tuple(chosen), values, residuals, final)
        values = values.copy()
        values[chosen] += model.units[chosen] * step
        if not np.abs((values - model.values) / model.units).max() < 1.0:
            break
        if np.abs(step).max() > JACOBIAN_UPDATE_STEP:
            inverse = np.linalg.pinv(jacobian(campaign, chain, model, values)[:, chosen])
    raise InputError(
        "no factors fit: the measured poses are not those of these runs (signs, units, order?)"
    )


def validated(parameters: OdometryParameters) -> OdometryParameters:
    """Return the parameters; one that is out of range raises a ParameterError."""
    return build(OdometryParameters, flatten(parameters))
