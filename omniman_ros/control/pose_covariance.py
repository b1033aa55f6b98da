"""Covariance of a planar pose and of a yaw rate's bias: the matrix of an extended Kalman filter.

Source of the equations: the prediction F P F' + Q of an extended Kalman filter, and its update by
a zero angular rate (P. D. Groves, Principles of GNSS, Inertial, and Multisensor Integrated
Navigation Systems, 2nd ed., sections 3.2 and 15.3). They are written out for the entries, which
takes a fraction of the time of small matrices.
"""

import numpy as np

from omniman_ros.core.arrays import Array


class PoseCovariance:
    """Covariance of (x, y, theta, bias) in odom [m, m, rad, rad/s]."""

    def __init__(self) -> None:
        self._pose = [0.0] * 6
        self._bias: list[float] | None = None

    def set_pose(self, covariance: Array) -> None:
        """Set the covariance (3, 3) of the pose, which is then independent of the bias."""
        rows, columns = (0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)
        self._pose = covariance[rows, columns].tolist()
        if self._bias is not None:
            self._bias[:3] = 0.0, 0.0, 0.0

    def set_bias(self, variance: float) -> None:
        """Set the variance of the bias [rad^2/s^2], which is then independent of the pose."""
        self._bias = [0.0, 0.0, 0.0, variance]

    @property
    def has_bias(self) -> bool:
        """Whether a bias is estimated."""
        return self._bias is not None

    @property
    def pose(self) -> Array:
        """Covariance (3, 3) of (x, y, theta) in odom [m^2, m rad, rad^2]."""
        xx, xy, yy, xt, yt, tt = self._pose
        return np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])

    @property
    def matrix(self) -> Array:
        """Covariance (4, 4) of all four; the bias has zeros before it is estimated."""
        result = np.zeros((4, 4))
        result[:3, :3] = self.pose
        if self._bias is not None:
            result[:, 3] = result[3, :] = self._bias
        return result

    def propagate(self, east: float, north: float, variance: float, yaw_variance: float) -> None:
        """Process a step of the pose, whose rotation does not depend on the bias.

        Args:
            east: Travel along odom's x [m].
            north: Travel along odom's y [m].
            variance: Variance of the position that the step adds [m^2].
            yaw_variance: Variance of the heading that it adds [rad^2].
        """
        xx, xy, yy, xt, yt, tt = self._pose
        a, b = -north, east
        self._pose = [
            xx + 2 * a * xt + a * a * tt + variance,
            xy + a * yt + b * xt + a * b * tt,
            yy + 2 * b * yt + b * b * tt + variance,
            xt + a * tt,
            yt + b * tt,
            tt + yaw_variance,
        ]
        if self._bias is not None:
            xb, yb, tb, _ = self._bias
            self._bias[:2] = xb + a * tb, yb + b * tb

    def rotate_by_rate(self, dt: float) -> None:
        """Process a rotation measured as a rate: it lost dt times the error of the bias."""
        assert self._bias is not None
        xb, yb, tb, bb = self._bias
        self._pose[3] -= dt * xb
        self._pose[4] -= dt * yb
        self._pose[5] += dt * (dt * bb - 2.0 * tb)
        self._bias[2] = tb - dt * bb

    def drift(self, variance: float) -> None:
        """Add a variance to that of the bias [rad^2/s^2]."""
        assert self._bias is not None
        self._bias[3] += variance

    def measure_bias(
        self, innovation: float, variance: float
    ) -> tuple[float, float, float, float]:
        """Process a measurement of the bias.

        Args:
            innovation: Measured less estimated bias [rad/s].
            variance: Variance of the measurement [rad^2/s^2], above 0.

        Returns:
            Corrections of x, y, theta and bias [m, m, rad, rad/s].
        """
        assert self._bias is not None
        xb, yb, tb, bb = self._bias
        total = bb + variance
        kx, ky, kt, kb = xb / total, yb / total, tb / total, bb / total
        xx, xy, yy, xt, yt, tt = self._pose
        self._pose = [
            xx - kx * xb,
            xy - kx * yb,
            yy - ky * yb,
            xt - kx * tb,
            yt - ky * tb,
            tt - kt * tb,
        ]
        rest = 1.0 - kb
        self._bias = [rest * xb, rest * yb, rest * tb, rest * bb]
        return kx * innovation, ky * innovation, kt * innovation, kb * innovation
