"""Friction of the wheels from steady runs without load: MPC 2021, (22) to (24).

A wheel off the floor that rotates steadily has tau = 0 and no torque of inertia in (22), so its
motor's torque behind the gear is its friction:

    tau_fric = eta N K i = a phi' + b sign(phi')

Gear and friction cannot be separated: a and b are only as accurate as eta, N and K are. Without
load the motor always drives its gear, so eta is a factor (of a driven gear it would be 1 / eta).

The regression is the MM-estimate of `robust_statistics`. It fits one line to each direction; a and
b are the means of the two, and a test decides whether the directions differ.

The 95 % intervals hold if the errors of the torques are independent from run to run, symmetric and
of the same size, and if the speeds are exact. They do not contain errors that all runs have in
common: those of eta, of K, and of the current sensor's gain.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.control.dynamics import SIGN_WIDTH
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.platform import Platform
from omniman_ros.identification.friction.robust_statistics import (
    Flags,
    RobustFit,
    least_median_line,
    mm_estimate,
    student_95,
    zero_probability,
)

Pair = tuple[float, float]  #: Viscous friction a [N m s/rad] and Coulomb friction b [N m]

#: Fraction of the Coulomb friction that the model must reach in a usable run
MIN_MODEL_FRACTION = 0.999
#: Speed at which the model's smooth sign reaches that share [rad/s]; slower runs are left out
MIN_SPEED = SIGN_WIDTH * MIN_MODEL_FRACTION / math.sqrt(1.0 - MIN_MODEL_FRACTION**2)
MIN_RUNS = 3  #: Number of runs in each direction that a fit needs
MIN_SPEED_RATIO = 2.0  #: Ratio of fastest to slowest run per direction that separates a from b
RESOLUTION = 0.002  #: Smallest relative error of a torque that is assumed
DIFFERENCE_LEVEL = 0.01  #: Significance level of the test for a difference between the directions
#: Relative difference of the directions that counts as round-off: runs without noise would show it
ROUND_OFF = 1e-9


@dataclass(frozen=True, eq=False)
class SteadyRun:
    """Means over a period in which the wheels rotated steadily; arrays (n,), made read-only.

    Raises:
        InputError: The arrays differ in length, or contain numbers that are not finite.
    """

    voltage: Array  #: Voltage at each motor [V]
    current: Array  #: Mean current of each motor [A]
    speed: Array  #: Mean speed of each wheel [rad/s]
    error: Array  #: Standard error of each mean current [A]
    steady: Flags  #: Whether each wheel's speed was constant
    samples: int  #: Number of current samples in a mean
    spikes: NDArray[np.int64]  #: Number of rejected current samples of each motor

    def __post_init__(self) -> None:
        for name, kind, bound in (
            ("voltage", np.float64, plausible.EFFORT),
            ("current", np.float64, plausible.EFFORT),
            ("speed", np.float64, plausible.WHEEL_SPEED),
            ("error", np.float64, plausible.EFFORT),
            ("steady", np.bool_, 1.0),
            ("spikes", np.int64, 1e12),
        ):
            array = np.array(getattr(self, name), dtype=kind)
            if array.ndim != 1 or array.shape != np.shape(self.voltage):
                raise InputError(
                    f"{name} of a run has shape {array.shape}, voltage {np.shape(self.voltage)}"
                )
            plausible.demand(array.astype(float), bound, f"{name} of a run")
            array.setflags(write=False)
            object.__setattr__(self, name, array)


@dataclass(frozen=True)
class ConfidenceInterval:
    """A value with the half width of its 95 % confidence interval, in the same unit."""

    value: float
    half_width: float


@dataclass(frozen=True, eq=False)
class WheelFriction:
    """The identified friction of one wheel."""

    name: str  #: Name of the wheel
    viscous: ConfidenceInterval  #: Viscous friction a, common to both directions [N m s/rad]
    coulomb: ConfidenceInterval  #: Coulomb friction b, common to both directions [N m]
    forward: Pair  #: a and b of the forward direction
    backward: Pair  #: a and b of the backward direction
    difference: float  #: p-value of the hypothesis of equal directions (F test on a and b)
    noise: float  #: Standard deviation of the torque of a run about the fit [N m]
    freedom: int  #: Degrees of freedom
    outliers: tuple[int, ...]  #: Indices of the runs whose weight is zero or nearly so
    left_out: tuple[int, ...]  #: Indices of the runs that were too slow or not steady
    back_emf: ConfidenceInterval  #: N K from voltage, current and speed [V s/rad]
    nominal_back_emf: float  #: N K as configured [V s/rad]
    covariance: Array  #: (4, 4) covariance of a, b, and half the differences of b and of a

    @property
    def differs(self) -> bool:
        """Whether the directions differ significantly."""
        is_equal = np.allclose(self.forward, self.backward, rtol=ROUND_OFF, atol=0.0)
        return self.difference < DIFFERENCE_LEVEL and not is_equal

    @property
    def back_emf_off(self) -> float:
        """Relative deviation of the identified N K from the configured one."""
        return self.back_emf.value / self.nominal_back_emf - 1.0

    def torque(self, speeds: Array) -> Array:
        """Return friction torques (k,) [N m] at speeds (k,) [rad/s] other than 0."""
        torque: Array = self.viscous.value * speeds + self.coulomb.value * np.sign(speeds)
        return torque

    def band(self, speeds: Array) -> Array:
        """Return the half widths (k,) of the 95 % interval of :meth:`torque` [N m].

        Args:
            speeds: (k,) speeds other than 0 [rad/s].
        """
        rows = np.column_stack([speeds, np.sign(speeds)])
        variance = np.einsum("ki,ij,kj->k", rows, self.covariance[:2, :2], rows)
        width: Array = student_95(self.freedom) * np.sqrt(variance)
        return width


def friction_torque(run: SteadyRun, robot: Platform) -> Array:
    """Return the friction torques (n,) [N m] in a steady run, MPC 2021 (22) with tau = 0."""
    motor = robot.motor
    gain = motor.gear_efficiency * motor.gear_ratio * motor.torque_constant
    torque: Array = gain * run.current
    return torque


def identify_friction(runs: Sequence[SteadyRun], robot: Platform) -> tuple[WheelFriction, ...]:
    """Fit the friction of each wheel, in the robot's order.

    Args:
        robot: The robot as configured; its configured friction is not used.

    Raises:
        InputError: A run has another number of wheels than the robot, or a wheel has too few
            usable runs.
    """
    n = robot.wheel_count
    for index, run in enumerate(runs):
        if len(run.voltage) != n:
            raise InputError(f"run {index} has {len(run.voltage)} wheels, the robot {n}")
    return tuple(_identify_wheel(runs, robot, k) for k in range(n))


def _identify_wheel(runs: Sequence[SteadyRun], robot: Platform, k: int) -> WheelFriction:
    motor, name = robot.motor, robot.wheels.names[k]
    is_usable = [bool(run.steady[k]) and abs(run.speed[k]) >= MIN_SPEED for run in runs]
    indices = [index for index, usable in enumerate(is_usable) if usable]
    speeds = np.array([runs[index].speed[k] for index in indices])
    _demand_enough_runs(name, speeds, len(runs))
    currents = np.array([runs[index].current[k] for index in indices])
    voltages = np.array([runs[index].voltage[k] for index in indices])
    nominal = motor.gear_ratio * motor.torque_constant
    gain = motor.gear_efficiency * motor.gear_ratio * motor.torque_constant
    errors = gain * np.array([runs[index].error[k] for index in indices])

    fit = _fit_torques(speeds, gain * currents, float(np.median(errors)))
    a, b, half_difference_b, half_difference_a = fit.values.tolist()
    width = student_95(fit.freedom) * np.sqrt(np.diag(fit.covariance))
    return WheelFriction(
        name=name,
        viscous=ConfidenceInterval(a, float(width[0])),
        coulomb=ConfidenceInterval(b, float(width[1])),
        forward=(a + half_difference_a, b + half_difference_b),
        backward=(a - half_difference_a, b - half_difference_b),
        difference=zero_probability(fit, (2, 3)),
        noise=fit.noise,
        freedom=fit.freedom,
        outliers=tuple(indices[i] for i in np.flatnonzero(fit.outliers).tolist()),
        left_out=tuple(index for index, usable in enumerate(is_usable) if not usable),
        back_emf=_fit_back_emf(speeds, voltages - motor.resistance * currents),
        nominal_back_emf=nominal,
        covariance=fit.covariance,
    )


def _fit_torques(speeds: Array, torques: Array, error: float) -> RobustFit:
    """Fit a line to each direction: a, b, and half the differences of b and of a."""
    signs, magnitudes = np.sign(speeds), np.abs(speeds)
    columns = np.column_stack([speeds, signs, np.ones(len(speeds)), magnitudes])
    start = np.zeros(len(torques))
    for sign in (1.0, -1.0):
        part = signs == sign
        start[part] = least_median_line(magnitudes[part], torques[part])
    min_scale = max(error, RESOLUTION * float(np.median(np.abs(torques))))
    return mm_estimate(columns, torques, start, min_scale)


def _fit_back_emf(speeds: Array, voltages: Array) -> ConfidenceInterval:
    """Fit N K [V s/rad] to the voltages (k,) [V] behind the resistance at speeds (k,) [rad/s].

    The column of the sign absorbs the voltage of the brushes, and the part of the Coulomb
    friction's voltage that a wrong resistance leaves.
    """
    signs = np.sign(speeds)
    start = signs * least_median_line(np.abs(speeds), signs * voltages)
    min_scale = RESOLUTION * float(np.median(np.abs(voltages)))
    fit = mm_estimate(np.column_stack([speeds, signs]), voltages, start, min_scale)
    width = student_95(fit.freedom) * math.sqrt(fit.covariance[0, 0])
    return ConfidenceInterval(float(fit.values[0]), float(width))


def _demand_enough_runs(name: str, speeds: Array, total: int) -> None:
    """Raise an InputError unless the usable speeds of a wheel determine its friction."""
    for sign, direction in ((1.0, "forwards"), (-1.0, "backwards")):
        part = np.abs(speeds[np.sign(speeds) == sign])
        if len(part) < MIN_RUNS:
            raise InputError(
                f"wheel '{name}': {len(part)} of {total} runs were steady {direction} at "
                f"{MIN_SPEED:.2g} rad/s or more, {MIN_RUNS} are needed"
            )
        if part.max() < MIN_SPEED_RATIO * part.min():
            raise InputError(
                f"wheel '{name}': speeds {direction} from {part.min():.3g} to {part.max():.3g} "
                f"rad/s do not separate a from b: a factor of {MIN_SPEED_RATIO:g} is needed"
            )
