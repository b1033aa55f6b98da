"""Robust regression and robust means, with standard errors.

The regression is an MM-estimate: it starts from a fit by least median of squares, computes the
scale of the residuals near it, and then iterates reweighted least squares with Tukey's biweight.
Its covariance is that of the M-estimate (Huber 1981, (6.6)); intervals use Student's t.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array

Flags = NDArray[np.bool_]  #: Array of flags, one per row or per wheel

TUKEY_CUTOFF = 4.685  #: Residual over the scale where the biweight is zero; 95 % efficient
START_CUTOFF = 2.5  #: Residual over the first scale up to which a row is fitted first
MIN_PSI_SLOPE = 0.2  #: Smallest mean slope of the biweight's psi; 0.8 for normal errors
OUTLIER_CUTOFF = 3.5  #: Residual over the scale from which a row counts as an outlier
NORMAL_95 = 1.95996  #: Two-sided 95 % quantile of the normal distribution
MAD_TO_SIGMA = 1.4826  #: Standard deviation of normal errors over their median magnitude
HUBER_CUTOFF = 1.5  #: Deviation over the scale from which Huber's weights decrease
SPIKE_CUTOFF = 5.0  #: Deviation over the scale from which a sample counts as a spike


@dataclass(frozen=True, eq=False)
class RobustFit:
    """Result of a robust linear regression."""

    values: Array  #: (p,) fitted coefficients
    covariance: Array  #: (p, p) covariance of the coefficients, read-only
    noise: float  #: Standard deviation of the errors, in the unit of the regressed values
    freedom: int  #: Degrees of freedom
    outliers: Flags  #: (k,) whether a row counts as an outlier


def least_median_line(x: Array, y: Array) -> Array:
    """Return the line through two of the points with the smallest median residual, at `x` (k,).

    Of k residuals, number (k + 3) / 2 by size represents the median: a line through two of only a
    few points is always near half of them (Rousseeuw and Leroy 1987).
    """
    i, j = np.triu_indices(len(x), 1)
    distinct = np.abs(x[i] - x[j]) > 1e-3 * np.ptp(x)
    i, j = i[distinct], j[distinct]
    slope = (y[i] - y[j]) / (x[i] - x[j])
    lines = slope[:, None] * (x - x[i][:, None]) + y[i][:, None]
    middle = min((len(x) + 3) // 2, len(x)) - 1
    best: Array = lines[np.argmin(np.sort(np.abs(y - lines), axis=1)[:, middle])]
    return best


def mm_estimate(columns: Array, values: Array, start: Array, min_scale: float) -> RobustFit:
    """Fit a linear model robustly.

    Args:
        columns: (k, p) regressors.
        values: (k,) values to fit.
        start: (k,) fitted values of a robust start.
        min_scale: Smallest scale of the residuals, in the unit of `values`.
    """
    rows, count = columns.shape
    coefficients, scale = _first_fit(columns, values, start, min_scale)
    # The rows of the first scale were chosen because they are near the start, which makes it too
    # small: it is increased until it agrees with the noise.
    for _ in range(20):
        coefficients = _biweight(columns, values, coefficients, scale)
        relative = (values - columns @ coefficients) / scale
        part = np.minimum(np.abs(relative) / TUKEY_CUTOFF, 1.0)
        psi = relative * (1.0 - part**2) ** 2
        slope = (1.0 - part**2) * (1.0 - 5.0 * part**2)
        mean = max(float(slope.mean()), MIN_PSI_SLOPE)
        noise = scale * math.sqrt(float(np.sum(psi**2)) / max(rows - count, 1)) / mean
        if noise < 1.01 * scale:
            break
        scale = noise
    outliers = np.abs(relative) > OUTLIER_CUTOFF
    freedom = max(rows - int(outliers.sum()) - count, 1)
    correction = 1.0 + count / rows * float(slope.var()) / mean**2
    covariance = (correction * noise) ** 2 * np.linalg.inv(columns.T @ columns)
    covariance.setflags(write=False)
    return RobustFit(coefficients, covariance, noise, freedom, outliers)


def _first_fit(
    columns: Array, values: Array, start: Array, min_scale: float
) -> tuple[Array, float]:
    """Fit the rows near the start by least squares; return coefficients (p,) and their scale."""
    rows, count = columns.shape
    residuals = values - start
    middle = min((rows + count + 1) // 2, rows) - 1
    median = float(np.sort(np.abs(residuals))[middle])
    first_scale = MAD_TO_SIGMA * (1.0 + 5.0 / max(rows - count, 1)) * median
    near = np.abs(residuals) <= START_CUTOFF * max(first_scale, min_scale)
    if np.linalg.matrix_rank(columns[near]) < count:
        near[:] = True
    coefficients = np.linalg.lstsq(columns[near], values[near], rcond=None)[0]
    residuals = values - columns @ coefficients
    freedom = max(int(near.sum()) - count, 1)
    scale = max(math.sqrt(float(np.sum(residuals[near] ** 2)) / freedom), min_scale)
    return coefficients, scale


def _biweight(columns: Array, values: Array, coefficients: Array, scale: float) -> Array:
    """Iterate least squares with Tukey's biweight at a fixed scale, from a start (p,)."""
    for _ in range(50):
        residuals = values - columns @ coefficients
        part = np.minimum(np.abs(residuals) / (TUKEY_CUTOFF * scale), 1.0)
        weights = 1.0 - part * part  # square root of the biweight
        step = np.linalg.lstsq(columns * weights[:, None], residuals * weights, rcond=None)[0]
        coefficients = coefficients + step
        if np.abs(columns @ step).max() < 1e-6 * scale:
            break
    return coefficients


def zero_probability(fit: RobustFit, pair: tuple[int, int]) -> float:
    """Return the p-value of the hypothesis that two coefficients are both 0.

    This is the tail of F(2, f), which has a closed form.
    """
    index = list(pair)
    values = fit.values[index]
    inverse = np.linalg.pinv(fit.covariance[np.ix_(index, index)], hermitian=True)
    ratio = 0.5 * float(values @ inverse @ values)
    return float((1.0 + 2.0 * ratio / fit.freedom) ** (-0.5 * fit.freedom))


def student_95(freedom: int) -> float:
    """Return the two-sided 95 % quantile of Student's t distribution.

    The Cornish-Fisher expansion is within 0.1 % of it from 4 degrees of freedom on.
    """
    z = NORMAL_95
    first = (z**3 + z) / (4.0 * freedom)
    second = (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / (96.0 * freedom**2)
    third = (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / (384.0 * freedom**3)
    fourth = (79.0 * z**9 + 776.0 * z**7 + 1482.0 * z**5 - 1920.0 * z**3 - 945.0 * z) / (
        92160.0 * freedom**4
    )
    return z + first + second + third + fourth


def robust_mean(samples: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return means, standard errors and numbers of spikes (n,) of (k, n) samples, k >= 1."""
    count = len(samples)
    centre = np.median(samples, axis=0)
    deviation = np.abs(samples - centre)
    # A coarse converter returns the median itself most of the time, so its median deviation is 0;
    # the mean deviation then gives the scale.
    scale = np.maximum(
        MAD_TO_SIGMA * np.median(deviation, axis=0), 1e-12 + 0.1 * deviation.mean(axis=0)
    )
    limit = HUBER_CUTOFF * scale
    for _ in range(30):
        distance = np.maximum(np.abs(samples - centre), 1e-300)
        weights = np.minimum(limit / distance, 1.0)
        new_centre = (weights * samples).sum(axis=0) / weights.sum(axis=0)
        converged = np.abs(new_centre - centre).max() < 1e-9 * scale.max()
        centre = new_centre
        if converged:
            break
    spikes = (np.abs(samples - centre) > SPIKE_CUTOFF * scale).sum(axis=0)
    clipped = np.clip(samples - centre, -limit, limit)
    inside = np.mean(np.abs(samples - centre) < limit, axis=0)
    spread = np.sqrt((clipped**2).mean(axis=0)) / np.maximum(inside, 0.1)
    return centre, spread / math.sqrt(count), spikes.astype(np.int64)


def line_slopes(times: list[float], values: list[Array]) -> tuple[Array, Array]:
    """Fit lines to samples (n,) at times [s]; return slopes and standard errors (n,) [1/s]."""
    at = np.array(times) - times[0]
    at = at - at.mean()
    table = np.array(values)
    table = table - table.mean(axis=0)
    spread = float(at @ at)
    slope = at @ table / spread
    residuals = table - np.outer(at, slope)
    error = np.sqrt((residuals * residuals).sum(axis=0) / max(len(at) - 2, 1) / spread)
    return slope, error
