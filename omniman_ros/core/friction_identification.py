"""Friction of the wheels from steady runs without load: MPC 2021, (22) to (24).

A wheel off the floor that turns steadily has tau = 0 and no torque of inertia in (22), so its
motor's torque behind the gear is its friction:

    tau_fric = eta N K i = a phi' + b sign(phi')

Gear and friction are not told apart: a and b are as right as eta, N and K are. Without load the
motor always drives its gear, so eta stands on this side (a driven gear has 1 / eta).

The regression is robust: a start by least median of squares, a scale from what lies near it,
then iteratively reweighted least squares with Tukey's biweight (an MM-estimate). It has a line
for each direction; a and b are their means, and whether they differ is tested.

The 95 % intervals are those of the M-estimate (Huber 1981, (6.6)) with Student's t. They hold if
the torques' errors are independent from run to run, symmetric and of one size, and speeds are
exact; what all runs have in common (eta, K, the current sensor's gain) is not in them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.dynamics import SIGN_WIDTH
from omniman_ros.core.errors import InputError
from omniman_ros.core.robot import Robot

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Pair = tuple[float, float]

FULL = 0.999
"""Share of the Coulomb friction that the model must have at a speed for it to be used."""
LEAST_SPEED = SIGN_WIDTH * FULL / math.sqrt(1.0 - FULL**2)
"""Speed at which the model's smooth sign has that share [rad/s]; slower runs are left out."""
LEAST_RUNS = 3
"""Runs in each direction that a fit needs."""
LEAST_RANGE = 2.0
"""Fastest over slowest run in each direction: less does not tell a from b."""
TUKEY = 4.685
"""Where the biweight ends, over the scale: 95 % efficient where errors are normal."""
NEAR = 2.5
"""Distance over the first scale up to which runs are near the least median of squares."""
LEAST_SLOPE = 0.2
"""Mean slope of the biweight's psi that is relied on; 0.8 where errors are normal."""
OUTLIER = 3.5
"""Distance over the scale from which on a run is called an outlier."""
RESOLUTION = 0.002
"""Errors below this share of the torque are no errors: nothing is steadier than that."""
DIFFERENT = 0.01
"""Level of the test for a difference between the directions."""
NORMAL_95 = 1.95996
"""Quantile of the normal distribution: two-sided 95 %."""
MAD = 1.4826
"""Standard deviation of normal errors over their median magnitude."""


@dataclass(frozen=True, eq=False)
class SteadyRun:
    """Means over a time in which the wheels turned steadily; arrays (n,), made read-only.

    Attributes:
        voltage: At the motors [V].
        current: Of the motors [A].
        speed: Of the wheels [rad/s].
        error: Standard error of the current's mean [A].
        steady: Whether the wheel's speed was constant.
        samples: Currents in a mean.
        spikes: Currents among them that were too far off to count.

    Raises:
        InputError: The arrays differ in length, or are not finite.
    """

    voltage: Array
    current: Array
    speed: Array
    error: Array
    steady: Flags
    samples: int
    spikes: NDArray[np.int64]

    def __post_init__(self) -> None:
        for name, kind, bound in (
            ("voltage", np.float64, plausible.EFFORT), ("current", np.float64, plausible.EFFORT),
            ("speed", np.float64, plausible.WHEEL_SPEED), ("error", np.float64, plausible.EFFORT),
            ("steady", np.bool_, 1.0), ("spikes", np.int64, 1e12),
        ):  # fmt: skip
            array = np.array(getattr(self, name), dtype=kind)
            if array.ndim != 1 or array.shape != np.shape(self.voltage):
                raise InputError(
                    f"{name} of a run has shape {array.shape}, voltage {np.shape(self.voltage)}"
                )
            plausible.demand(array.astype(float), bound, f"{name} of a run")
            array.setflags(write=False)
            object.__setattr__(self, name, array)


@dataclass(frozen=True)
class Estimate:
    """A value and the half width of its 95 % confidence interval, in one unit."""

    value: float
    half_width: float


@dataclass(frozen=True, eq=False)
class WheelFriction:
    """What was found of one wheel.

    Attributes:
        name: Of the wheel.
        viscous, coulomb: a [N m s/rad] and b [N m], for both directions.
        forward, backward: a and b of each direction.
        difference: Probability of a difference between the directions at least as large, if
            there were none (F test on both together).
        noise: Standard deviation of the torque of a run about the fit [N m].
        freedom: Degrees of freedom.
        outliers: Indices of runs that were weighted down to nothing, or nearly.
        left_out: Indices of runs that were too slow or not steady.
        back_emf: N K from voltage, current and speed [V s/rad].
        nominal_back_emf: N K as configured [V s/rad].
        covariance: (4, 4) of (a, b, and half the differences of b and a between directions).
    """

    name: str
    viscous: Estimate
    coulomb: Estimate
    forward: Pair
    backward: Pair
    difference: float
    noise: float
    freedom: int
    outliers: tuple[int, ...]
    left_out: tuple[int, ...]
    back_emf: Estimate
    nominal_back_emf: float
    covariance: Array

    @property
    def differs(self) -> bool:
        """Whether the directions differ significantly."""
        return self.difference < DIFFERENT

    @property
    def back_emf_off(self) -> float:
        """N K found over N K configured, less 1."""
        return self.back_emf.value / self.nominal_back_emf - 1.0

    def torque(self, speeds: Array) -> Array:
        """Friction (k,) [N m] at speeds (k,) [rad/s] other than 0, with one a and b for both."""
        torque: Array = self.viscous.value * speeds + self.coulomb.value * np.sign(speeds)
        return torque

    def band(self, speeds: Array) -> Array:
        """Half width (k,) [N m] of the 95 % interval of :meth:`torque` at speeds (k,)."""
        rows = np.column_stack([speeds, np.sign(speeds)])
        variance = np.einsum("ki,ij,kj->k", rows, self.covariance[:2, :2], rows)
        width: Array = student_95(self.freedom) * np.sqrt(variance)
        return width


def friction_torque(run: SteadyRun, robot: Robot) -> Array:
    """Torques (n,) [N m] of friction in a steady run, MPC 2021 (22) with tau = 0."""
    motor = robot.motor
    gain = motor.gear_efficiency * motor.gear_ratio * motor.torque_constant
    torque: Array = gain * run.current
    return torque


def identify_friction(runs: Sequence[SteadyRun], robot: Robot) -> tuple[WheelFriction, ...]:
    """Fit the friction of each wheel.

    Args:
        runs: Steady runs in both directions.
        robot: As configured; its own friction is not used.

    Raises:
        InputError: A run has another number of wheels, or a wheel has too few runs to be fitted.
    """
    n = robot.wheel_count
    for index, run in enumerate(runs):
        if len(run.voltage) != n:
            raise InputError(f"run {index} has {len(run.voltage)} wheels, the robot {n}")
    return tuple(_identify_wheel(runs, robot, k) for k in range(n))


def _identify_wheel(runs: Sequence[SteadyRun], robot: Robot, k: int) -> WheelFriction:
    motor, name = robot.motor, robot.wheels.names[k]
    usable = [bool(run.steady[k]) and abs(run.speed[k]) >= LEAST_SPEED for run in runs]
    used = [index for index, good in enumerate(usable) if good]
    speeds = np.array([runs[index].speed[k] for index in used])
    _demand_enough(name, speeds, len(runs))
    currents = np.array([runs[index].current[k] for index in used])
    voltages = np.array([runs[index].voltage[k] for index in used])
    gain = motor.gear_efficiency * motor.gear_ratio * motor.torque_constant
    errors = gain * np.array([runs[index].error[k] for index in used])
    signs, ways = np.sign(speeds), np.abs(speeds)

    torques = gain * currents
    columns = np.column_stack([speeds, signs, np.ones(len(speeds)), ways])
    start = np.zeros(len(torques))
    for sign in (1.0, -1.0):
        part = signs == sign
        start[part] = _least_median(ways[part], torques[part])
    floor = max(float(np.median(errors)), RESOLUTION * float(np.median(np.abs(torques))))
    fit = _reweighted(columns, torques, start, floor)
    a, b, c, d = fit.values.tolist()
    width = student_95(fit.freedom) * np.sqrt(np.diag(fit.covariance))

    # The sign's column takes up brushes, and what a wrong R makes of the Coulomb friction.
    seen = voltages - motor.resistance * currents
    nominal = motor.gear_ratio * motor.torque_constant
    start = signs * _least_median(ways, signs * seen)
    floor = RESOLUTION * float(np.median(np.abs(seen)))
    emf = _reweighted(columns[:, :2], seen, start, floor)
    emf_width = student_95(emf.freedom) * math.sqrt(emf.covariance[0, 0])
    return WheelFriction(
        name=name,
        viscous=Estimate(a, float(width[0])),
        coulomb=Estimate(b, float(width[1])),
        forward=(a + d, b + c),
        backward=(a - d, b - c),
        difference=_chance(fit, (2, 3)),
        noise=fit.noise,
        freedom=fit.freedom,
        outliers=tuple(used[i] for i in np.flatnonzero(fit.outliers).tolist()),
        left_out=tuple(index for index, good in enumerate(usable) if not good),
        back_emf=Estimate(float(emf.values[0]), float(emf_width)),
        nominal_back_emf=nominal,
        covariance=fit.covariance,
    )


def _demand_enough(name: str, speeds: Array, whole: int) -> None:
    for sign, way in ((1.0, "forwards"), (-1.0, "backwards")):
        part = np.abs(speeds[np.sign(speeds) == sign])
        if len(part) < LEAST_RUNS:
            raise InputError(
                f"wheel '{name}': {len(part)} of {whole} runs were steady {way} at "
                f"{LEAST_SPEED:.2g} rad/s or more, {LEAST_RUNS} are needed"
            )
        if part.max() < LEAST_RANGE * part.min():
            raise InputError(
                f"wheel '{name}': speeds {way} from {part.min():.3g} to {part.max():.3g} rad/s "
                f"do not tell a from b: a factor of {LEAST_RANGE:g} is needed"
            )


@dataclass(frozen=True, eq=False)
class _Fit:
    values: Array
    covariance: Array
    noise: float
    freedom: int
    outliers: Flags


def _least_median(x: Array, y: Array) -> Array:
    """Values (k,) on the line through two of the points that has the least median residual.

    Of k residuals, number (k + 3) / 2 by size stands for the median: half of the points are near
    *any* line through two of a few (Rousseeuw and Leroy 1987).
    """
    i, j = np.triu_indices(len(x), 1)
    apart = np.abs(x[i] - x[j]) > 1e-3 * np.ptp(x)
    i, j = i[apart], j[apart]
    slope = (y[i] - y[j]) / (x[i] - x[j])
    lines = slope[:, None] * (x - x[i][:, None]) + y[i][:, None]
    middle = min((len(x) + 3) // 2, len(x)) - 1
    best: Array = lines[np.argmin(np.sort(np.abs(y - lines), axis=1)[:, middle])]
    return best


def _reweighted(columns: Array, values: Array, start: Array, floor: float) -> _Fit:
    """MM-estimate: least squares of the runs near the start, then Tukey's biweight.

    Args:
        columns: (k, p) of the regression.
        values: (k,).
        start: (k,) robust values of the fit.
        floor: Least scale.
    """
    rows, count = columns.shape
    residuals = values - start
    middle = min((rows + count + 1) // 2, rows) - 1
    off = float(np.sort(np.abs(residuals))[middle])
    first = MAD * (1.0 + 5.0 / max(rows - count, 1)) * off
    near = np.abs(residuals) <= NEAR * max(first, floor)
    if np.linalg.matrix_rank(columns[near]) < count:
        near[:] = True
    found = np.linalg.lstsq(columns[near], values[near], rcond=None)[0]
    residuals = values - columns @ found
    rest = max(int(near.sum()) - count, 1)
    scale = max(math.sqrt(float(np.sum(residuals[near] ** 2)) / rest), floor)
    # The first scale is that of runs which were chosen for being near: it grows to their noise.
    for _ in range(20):
        found = _biweight(columns, values, found, scale)
        relative = (values - columns @ found) / scale
        part = np.minimum(np.abs(relative) / TUKEY, 1.0)
        psi = relative * (1.0 - part**2) ** 2
        slope = (1.0 - part**2) * (1.0 - 5.0 * part**2)
        mean = max(float(slope.mean()), LEAST_SLOPE)
        noise = scale * math.sqrt(float(np.sum(psi**2)) / max(rows - count, 1)) / mean
        if noise < 1.01 * scale:
            break
        scale = noise
    outliers = np.abs(relative) > OUTLIER
    freedom = max(rows - int(outliers.sum()) - count, 1)
    correction = 1.0 + count / rows * float(slope.var()) / mean**2
    covariance = (correction * noise) ** 2 * np.linalg.inv(columns.T @ columns)
    covariance.setflags(write=False)
    return _Fit(found, covariance, noise, freedom, outliers)


def _biweight(columns: Array, values: Array, found: Array, scale: float) -> Array:
    """Least squares (p,), reweighted with Tukey's biweight at a scale, from a start (p,)."""
    for _ in range(50):
        residuals = values - columns @ found
        part = np.minimum(np.abs(residuals) / (TUKEY * scale), 1.0)
        weights = 1.0 - part * part  # the root of the biweight
        step = np.linalg.lstsq(columns * weights[:, None], residuals * weights, rcond=None)[0]
        found = found + step
        if np.abs(columns @ step).max() < 1e-6 * scale:
            break
    return found


def _chance(fit: _Fit, pair: tuple[int, int]) -> float:
    """Probability of two values as large as these if both are 0: F(2, f) in closed form."""
    index = list(pair)
    values = fit.values[index]
    inverse = np.linalg.pinv(fit.covariance[np.ix_(index, index)], hermitian=True)
    ratio = 0.5 * float(values @ inverse @ values)
    return float((1.0 + 2.0 * ratio / fit.freedom) ** (-0.5 * fit.freedom))


def student_95(freedom: int) -> float:
    """Two-sided 95 % quantile of Student's t, within 0.1 % from 4 degrees on (Cornish-Fisher)."""
    z = NORMAL_95
    first = (z**3 + z) / (4.0 * freedom)
    second = (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / (96.0 * freedom**2)
    third = (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / (384.0 * freedom**3)
    fourth = (
        79.0 * z**9 + 776.0 * z**7 + 1482.0 * z**5 - 1920.0 * z**3 - 945.0 * z
    ) / (92160.0 * freedom**4)  # fmt: skip
    return z + first + second + third + fourth


def robust_mean(samples: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Means of the columns of (k, n) samples with Huber's weights, k >= 1.

    Returns:
        Means (n,), their standard errors (n,), and how many samples were spikes (n,).
    """
    count = len(samples)
    centre = np.median(samples, axis=0)
    off = np.abs(samples - centre)
    # Coarse converters give the median itself most of the time: then the mean deviation.
    scale = np.maximum(MAD * np.median(off, axis=0), 1e-12 + 0.1 * off.mean(axis=0))
    limit = 1.5 * scale
    for _ in range(30):
        distance = np.maximum(np.abs(samples - centre), 1e-300)
        weights = np.minimum(limit / distance, 1.0)
        moved = (weights * samples).sum(axis=0) / weights.sum(axis=0)
        done = np.abs(moved - centre).max() < 1e-9 * scale.max()
        centre = moved
        if done:
            break
    spikes = (np.abs(samples - centre) > 5.0 * scale).sum(axis=0)
    inside = np.clip(samples - centre, -limit, limit)
    free = np.mean(np.abs(samples - centre) < limit, axis=0)
    spread = np.sqrt((inside**2).mean(axis=0)) / np.maximum(free, 0.1)
    return centre, spread / math.sqrt(count), spikes.astype(np.int64)
