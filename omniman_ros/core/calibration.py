"""Calibration of the odometry: least squares on runs with measured poses between them.

A campaign is a chain: the robot drives runs one after the other, and where it stands between two
of them is measured. Each run's recorded wheel motion is integrated on SE(2) just as the odometry
does it; the factors are those whose poses fit the measured ones. A pose is the end of one run and
the start of the next, so the errors of two runs in a row are correlated: the weights are those of
the whole chain (generalised least squares, Gauss-Newton).

What wheels can tell: a platform without slip in its commands moves its n wheels in three
directions only, so all that an error of geometry does to the odometry is a matrix (3, 3) on the
twist, whatever its cause: the nine factors of `twist_model`. Radii alone make a part of those
matrices; `wheel_model` is for platforms that stay within it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible, se2
from omniman_ros.core.errors import InputError
from omniman_ros.core.kinematics import PlatformKinematics
from omniman_ros.core.odometry import OdometryParameters
from omniman_ros.core.parameters import build, flatten
from omniman_ros.core.robot import Wheels

Array = NDArray[np.float64]
Pose = tuple[float, float, float]

SCALES = ("scale_x", "scale_y", "scale_yaw")
CROSS_TERMS = ("x_per_y", "x_per_yaw", "y_per_x", "y_per_yaw", "yaw_per_x", "yaw_per_y")
STEP = 1e-6
"""Of the central differences, in relative units."""
ITERATIONS = 30
ALMOST = 1e-3
"""Step after which the slope is worked out anew, in relative units."""
CONVERGED = 1e-9
"""Largest step of the last iteration, in relative units."""


@dataclass(frozen=True)
class Run:
    """What the wheels did between two measured poses.

    Attributes:
        name: For people.
        positions: (k, n) wheel positions, not wrapped, k >= 1 [rad].
    """

    name: str
    positions: Array


@dataclass(frozen=True)
class Accuracy:
    """Standard deviations of a measured pose: of each coordinate [m] and the heading [rad]."""

    position: float = 0.003
    heading: float = math.radians(0.3)

    def __post_init__(self) -> None:
        if not (0.0 < self.position < math.inf and 0.0 < self.heading < math.inf):
            raise InputError(
                f"the accuracy of a measured pose must be above 0: {self.position} m, "
                f"{self.heading} rad"
            )


@dataclass(frozen=True)
class Campaign:
    """Runs in the order in which they were driven, and the poses between them.

    Attributes:
        wheels: The wheels as configured, without calibration.
        runs: N runs; the robot stands where it is between them.
        poses: N + 1 measured poses of base_link [m, m, rad] in one frame of the floor, before the
            first run, between the runs and after the last; None where it was not measured.
            Headings may be wrapped.
        accuracy: Of the poses.

    Raises:
        InputError: Sizes do not fit, something is not finite, or fewer than two poses.
    """

    wheels: Wheels
    runs: tuple[Run, ...]
    poses: tuple[Pose | None, ...]
    accuracy: Accuracy

    def __post_init__(self) -> None:
        n = len(self.wheels.names)
        if len(self.poses) != len(self.runs) + 1:
            raise InputError(
                f"{len(self.poses)} poses for {len(self.runs)} runs, expected one more"
            )
        for run in self.runs:
            shape = run.positions.shape
            if len(shape) != 2 or shape[0] < 1 or shape[1] != n:
                raise InputError(f"run '{run.name}': positions of shape {shape}, {n} wheels")
            plausible.demand(run.positions, plausible.WHEEL_ANGLE, f"run '{run.name}': positions")
        for pose in self.poses:
            if pose is not None:
                plausible.demand(np.array(pose), plausible.ANGLE, "measured pose")
        if len(self.stations) < 2:
            raise InputError("fewer than two measured poses: nothing to calibrate with")

    @property
    def stations(self) -> tuple[int, ...]:
        """Indices of the poses that were measured."""
        return tuple(i for i, pose in enumerate(self.poses) if pose is not None)

    def station_name(self, index: int) -> str:
        """A measured pose for people."""
        return f"after '{self.runs[index - 1].name}'" if index else "at the start"

    def without(self, index: int) -> "Campaign":
        """The campaign with one measured pose left out; the runs beside it become one."""
        poses = list(self.poses)
        poses[index] = None
        return replace(self, poses=tuple(poses))


@lru_cache(maxsize=64)
def _forward_jacobian(wheels: Wheels, scale: tuple[float, ...]) -> Array:
    """J+ (3, n) of CCTA 2017 (3) with calibrated radii."""
    radius = tuple((np.array(wheels.radius) * scale).tolist())
    return PlatformKinematics(replace(wheels, radius=radius)).J_pinv


def forward_matrix(wheels: Wheels, parameters: OdometryParameters) -> Array:
    """Calibrated forward Jacobian (3, n): wheel steps [rad] to body displacement [m, m, rad]."""
    forward: Array = parameters.correction @ _forward_jacobian(wheels, parameters.wheel_scale)
    return forward


def _arcs(moved: Array) -> tuple[Array, Array, Array]:
    """Displacement (k,) ahead and left [m] and turn [rad] of constant twists (k, 3)."""
    x, y, turn = moved.T
    small = np.abs(turn) < 1e-4
    divisor = np.where(small, 1.0, turn)
    sinc = np.where(small, 1.0 - turn**2 / 6.0, np.sin(turn) / divisor)
    cosc = np.where(small, turn * (0.5 - turn**2 / 24.0), (1.0 - np.cos(turn)) / divisor)
    return sinc * x - cosc * y, cosc * x + sinc * y, turn


def integrate(forward: Array, positions: Array, start: Pose = (0.0, 0.0, 0.0)) -> Array:
    """Poses (k, 3) [m, m, rad] along recorded wheel positions (k, n) [rad] from a start pose.

    The steps are composed on SE(2) with constant twist within each, as `Odometry.update` does.
    """
    dx, dy, turn = _arcs(np.diff(positions, axis=0) @ forward.T)
    poses = np.empty((len(positions), 3))
    poses[0] = start
    poses[1:, 2] = start[2] + np.cumsum(turn)
    c, s = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    poses[1:, 0] = start[0] + np.cumsum(c * dx - s * dy)
    poses[1:, 1] = start[1] + np.cumsum(s * dx + c * dy)
    return poses


def compose(first: Array, second: Array) -> Array:
    """Pose (3,) of `second`, given in the frame of `first`, in the frame that `first` is in."""
    c, s = math.cos(first[2]), math.sin(first[2])
    x, y, theta = second.tolist()
    pose: Array = first + np.array([c * x - s * y, s * x + c * y, theta])
    return pose


def between(first: Array, second: Array) -> Array:
    """Pose (3,) of `second` in the frame of `first`; the heading is not wrapped."""
    return se2.to_robot(float(first[2]), second - first)


@dataclass(frozen=True)
class Model:
    """Some factors of the odometry as unknowns, in relative units: 0.01 is 1 % everywhere.

    Attributes:
        name: For people.
        factors: Names of the unknowns, `wheel_scale.NAME` for one wheel's.
        base: Parameters that hold all others.
        units: (p,) one relative unit in the factor's own (a length for those in m/rad, ...).
        ranks: (p,) of factors that cannot be told apart, those of the highest rank are left out.
        apply: From values (p,) in the factors' own units to parameters.
    """

    name: str
    factors: tuple[str, ...]
    base: OdometryParameters
    units: Array
    ranks: tuple[int, ...]
    apply: Callable[[Sequence[float]], OdometryParameters]

    @property
    def values(self) -> Array:
        """Values (p,) of the factors in `base`."""
        found = flatten(self.base)
        wheels = [name for name in self.factors if name.startswith("wheel_scale.")]
        scale = dict(zip(wheels, self.base.wheel_scale, strict=True)) if wheels else {}
        return np.array([found[n] if n in found else scale[n] for n in self.factors])


def twist_model(wheels: Wheels, present: OdometryParameters) -> Model:
    """The nine factors on the twist; the wheels' own factors stay as they are."""
    size = max(map(math.hypot, wheels.x, wheels.y))
    length = {"x_per_yaw": size, "y_per_yaw": size, "yaw_per_x": 1 / size, "yaw_per_y": 1 / size}
    names = SCALES + CROSS_TERMS

    def apply(values: Sequence[float]) -> OdometryParameters:
        chosen: dict[str, Any] = dict(zip(names, map(float, values), strict=True))
        return replace(present, **chosen)

    units = np.array([length.get(name, 1.0) for name in names])
    return Model("twist", names, present, units, (0,) * 3 + (1,) * 6, apply)


def wheel_model(wheels: Wheels, present: OdometryParameters) -> Model:
    """A factor for each wheel, for y and for yaw: what wrong radii and rollers do.

    There is none for x: the rollers of a Mecanum wheel that drives ahead do not turn, so travel
    ahead measures the radii. Cross terms are zero.
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


class Chain:
    """The campaign's residuals and their weights.

    The measured pose of a station in the frame of the one before it, less the same from the
    odometry; a row of three a pair of stations. Errors e of the measured poses make the residuals
    G e, so their covariance is G S G', tridiagonal by blocks.

    Args:
        campaign: Runs and poses.
    """

    def __init__(self, campaign: Campaign) -> None:
        steps = [np.diff(run.positions, axis=0) for run in campaign.runs]
        lengths = [len(step) for step in steps]
        self._steps = np.vstack(steps)
        self._run_of = np.repeat(np.arange(len(steps)), lengths)
        self._first = np.cumsum([0, *lengths[:-1]])
        stations = campaign.stations
        self._pairs = list(zip(stations[:-1], stations[1:], strict=True))
        measured = [np.array(campaign.poses[i]) for i in stations]
        self._measured = [between(a, b) for a, b in zip(measured[:-1], measured[1:], strict=True)]
        rows = 3 * len(self._pairs)
        errors = np.zeros((rows, rows + 3))
        for k, (start, relative) in enumerate(zip(measured, self._measured, strict=False)):
            turned = se2.rotation(float(start[2]))
            block = slice(3 * k, 3 * k + 3)
            errors[block, 3 * k : 3 * k + 3] = -turned
            errors[block, 3 * k + 2] += [relative[1], -relative[0], 0.0]
            errors[block, 3 * k + 3 : 3 * k + 6] = turned
        accuracy = campaign.accuracy
        deviation = np.tile(
            [accuracy.position, accuracy.position, accuracy.heading], rows // 3 + 1
        )
        spread = errors * deviation
        self._whiten = np.linalg.inv(np.linalg.cholesky(spread @ spread.T))
        self.shifts = self._whiten @ errors
        """(r, r + 3): whitened residuals that an error of each measured pose would make."""

    def residuals(self, forward: Array) -> Array:
        """Whitened residuals (r,) for a forward Jacobian (3, n); of variance 1 each if it fits."""
        moved = self._moved(forward).tolist()
        rows = []
        for (start, end), measured in zip(self._pairs, self._measured, strict=True):
            x = y = theta = 0.0
            for dx, dy, turn in moved[start:end]:
                c, s = math.cos(theta), math.sin(theta)
                x, y, theta = x + c * dx - s * dy, y + s * dx + c * dy, theta + turn
            rows.append((measured[0] - x, measured[1] - y, se2.wrap(float(measured[2]) - theta)))
        return self._whiten @ np.ravel(rows)

    def _moved(self, forward: Array) -> Array:
        """Pose (N, 3) of the end of each run, seen from its start: all runs in one go."""
        dx, dy, turn = _arcs(self._steps @ forward.T)
        total = np.concatenate([[0.0], np.cumsum(turn)])
        heading = total[:-1] - total[self._first][self._run_of]
        c, s = np.cos(heading), np.sin(heading)
        count = len(self._first)
        return np.column_stack(
            [
                np.bincount(self._run_of, weights, count)
                for weights in (c * dx - s * dy, s * dx + c * dy, turn)
            ]
        )


@dataclass(frozen=True)
class Solution:
    """Least squares of a model with some of its factors.

    Attributes:
        free: Which of the model's factors were fitted.
        values: (p,) all of the model's factors, in their own units.
        residuals: (r,) whitened.
        jacobian: (r, f) of the whitened residuals by the free factors, in relative units.
    """

    free: tuple[int, ...]
    values: Array
    residuals: Array
    jacobian: Array

    @property
    def cost(self) -> float:
        """Sum of the squared whitened residuals; about the degrees of freedom if all is well."""
        return float(self.residuals @ self.residuals)

    @property
    def freedom(self) -> int:
        """Degrees of freedom."""
        return len(self.residuals) - len(self.free)

    @property
    def inflation(self) -> float:
        """Variance of the residuals over the stated one where it is larger, else 1."""
        return max(1.0, self.cost / self.freedom) if self.freedom > 0 else 1.0


def jacobian(campaign: Campaign, chain: Chain, model: Model, values: Array) -> Array:
    """Jacobian (r, p) of the whitened residuals by all factors of a model, in relative units.

    Args:
        campaign, chain: Runs and poses.
        model: The model.
        values: (p,) of its factors, in their own units.
    """

    def residuals(trial: Array) -> Array:
        return chain.residuals(forward_matrix(campaign.wheels, model.apply(trial.tolist())))

    return np.column_stack(
        [
            (residuals(values + change) - residuals(values - change)) / (2.0 * STEP)
            for change in STEP * np.diag(model.units)
        ]
    )


def solve(
    campaign: Campaign, chain: Chain, model: Model, free: Sequence[int], slope: Array
) -> Solution:
    """Fit some factors of a model; the others stay as they are in its base.

    The residuals are nearly linear in the factors: a slope serves until a step is longer than
    ALMOST.

    Args:
        campaign, chain: Runs and poses.
        model: The model.
        free: Indices of the factors to fit.
        slope: (r, p) :func:`jacobian` at the model's base.

    Raises:
        InputError: It does not converge: the measured poses are not those of these runs.
    """
    chosen = list(free)
    values, inverse = model.values, np.linalg.pinv(slope[:, chosen])
    for _ in range(ITERATIONS):
        rest = chain.residuals(forward_matrix(campaign.wheels, model.apply(values.tolist())))
        step = -inverse @ rest
        if np.abs(step).max() < CONVERGED:
            final = jacobian(campaign, chain, model, values)[:, chosen]
            return Solution(tuple(chosen), values, rest, final)
        values = values.copy()
        values[chosen] += model.units[chosen] * step
        if not np.abs((values - model.values) / model.units).max() < 1.0:
            break
        if np.abs(step).max() > ALMOST:
            inverse = np.linalg.pinv(jacobian(campaign, chain, model, values)[:, chosen])
    raise InputError(
        "no factors fit: the measured poses are not those of these runs (signs, units, order?)"
    )


def checked(parameters: OdometryParameters) -> OdometryParameters:
    """The parameters, if each is within its range.

    Raises:
        ParameterError: One is not.
    """
    return build(OdometryParameters, flatten(parameters))
