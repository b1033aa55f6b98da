"""Validation of the measurements of an inertial measurement unit, and what the platform uses."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.imu_mount import ImuMount
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.validated import Validated

#: Wheel speed from which measurements cannot stay the same to the last digit [rad/s]
MIN_TURNING_SPEED = 0.1
#: Time for which no digit changes while the wheels turn, from which the sensor counts as frozen
#: [s].
FROZEN_TIME = 0.25
NONE_YET = "no imu yet"  #: Fault before the first measurement


@dataclass(frozen=True, kw_only=True)
class ImuParameters(Validated):
    """Use, mounting and noise of an inertial measurement unit."""

    use: bool = parameter(
        False,
        "Whether `imu` is fused into the odometry and compared with the wheels.",
        read_only=True,
    )
    mount: ImuMount = inline()
    timeout: float = parameter(
        0.1,
        "Age from which measurements are stale: the odometry goes on with the wheels alone.",
        unit="s",
        low=0.005,
        high=10,
    )
    gyro_noise: float = parameter(
        3e-4, "Noise density of the yaw rate.", unit="rad/s/sqrt(Hz)", low=1e-7, high=1
    )
    gyro_drift: float = parameter(
        2e-5,
        "Random walk of the yaw rate's bias.",
        unit="rad/s/sqrt(s)",
        low=0,
        high=1,
    )
    gyro_bias: float = parameter(
        0.02,
        "Standard deviation of the yaw rate's bias when the node starts.",
        unit="rad/s",
        low=0,
        high=1,
    )
    noise_rotation: float = parameter(
        1e-5,
        "Variance of the heading gained per radian, by the scale of the yaw rate.",
        unit="rad^2/rad",
        low=0,
        high=10,
    )


@dataclass(frozen=True)
class InertialStep(Validated):
    """What the sensor measured between two reports of the wheels."""

    rotation: float  #: Rotation about the vertical, bias included [rad]
    noise: float  #: Variance of the rotation by noise [rad^2]
    #: Variance of the rotation by the scale of the rate [rad^2]. It grows with the measured
    #: rotation: to weight measurements of the bias by it would favour small ones.
    scale_error: float
    bias_drift: float  #: Variance that the bias has gained [rad^2/s^2]
    initial_bias_variance: float  #: Variance of a bias of which nothing is known yet [rad^2/s^2]
    #: Acceleration (2,) of base_link's origin along base_link's x and y, bias included [m/s^2]
    acceleration: Annotated[Array, Shape(2)]


class ImuFeedback:
    """Integrates the yaw rate, and keeps the acceleration, from measurement to measurement.

    Between two measurements the last one is held; the next one corrects the integral, so that
    nothing is lost or counted twice.

    Attributes:
        fault: Why no measurements were used at the last :meth:`take`; empty if they were.
    """

    def __init__(self, parameters: ImuParameters) -> None:
        self.received = False
        self.fault = NONE_YET
        self._time = self._arrival = -math.inf
        self._raw: Array = np.zeros(6)
        self._same_since = -math.inf
        self._rate = self._angle = self._taken = self._taken_time = 0.0
        self._is_continued = False
        self._acceleration: Array = np.zeros(2)
        self.configure(parameters)

    def configure(self, parameters: ImuParameters) -> None:
        """Set new parameters; what was measured is kept."""
        self.parameters = parameters
        c, s = math.cos(parameters.mount.yaw), math.sin(parameters.mount.yaw)
        self._to_base = np.array([[c, -s], [s, c]])
        self._offset = np.array([parameters.mount.x, parameters.mount.y])

    def forget(self) -> None:
        """Discard all measurements: the next one counts as the first."""
        self.received = self._is_continued = False
        self.fault = NONE_YET
        self._time = self._arrival = self._same_since = -math.inf

    def update(self, time: float, now: float, rate: Array, acceleration: Array) -> None:
        """Process a measurement.

        Args:
            time: Time of the measurement [s]; at most `now` counts.
            rate: Angular velocity (3,) in the sensor's frame [rad/s].
            acceleration: Specific force (3,) in the sensor's frame, at rest g upward [m/s^2].

        Raises:
            InputError: A number is not finite or implausibly large, or the measurement is not
                newer than the last one.
        """
        time = min(time, now)
        plausible.demand(rate, plausible.YAW_RATE, "angular velocity")
        plausible.demand(acceleration, plausible.SPECIFIC_FORCE, "linear acceleration")
        if self.received and time <= self._time:
            raise InputError(f"out of order, {self._time - time:.4f} s before the last one")
        raw = np.concatenate([rate, acceleration])
        if not self.received or not np.array_equal(raw, self._raw):
            self._same_since = time
        turn = float(rate[2])
        if self.received and time - self._time <= self.parameters.timeout:
            dt = time - self._time
            self._angle += 0.5 * (self._rate + turn) * dt
            swing = (turn - self._rate) / dt
        else:
            self._is_continued = False
            swing = 0.0
        # The origin of base_link accelerates otherwise than the sensor, which is beside it.
        x, y = self._offset.tolist()
        lever_arm = np.array([swing * y + turn * turn * x, turn * turn * y - swing * x])
        self._acceleration = self._to_base @ acceleration[:2] + lever_arm
        self._raw, self._rate, self._time, self._arrival = raw, turn, time, now
        self.received = True

    def take(self, time: float, now: float, speeds: Array) -> InertialStep | None:
        """Return what was measured since the last call; None if there is a fault, or was one.

        Args:
            time: Time up to which the motion is wanted [s].
            speeds: Wheel speeds (n,), by which a sensor shows that it is frozen [rad/s].
        """
        self.fault = self._present_fault(now, speeds)
        if self.fault:
            self._is_continued = False
            return None
        angle = self._angle + self._rate * (time - self._time)
        rotation, dt = angle - self._taken, time - self._taken_time
        self._taken, self._taken_time = angle, time
        was_continued, self._is_continued = self._is_continued, True
        if not was_continued:
            return None
        p = self.parameters
        return InertialStep(
            rotation,
            p.gyro_noise**2 * dt,
            p.noise_rotation * abs(rotation),
            p.gyro_drift**2 * dt,
            p.gyro_bias**2,
            self._acceleration,
        )

    def _present_fault(self, now: float, speeds: Array) -> str:
        if not self.received:
            return NONE_YET
        age = now - min(self._arrival, self._time)
        if age > self.parameters.timeout:
            return f"imu silent for {age:.2f} s"
        same_for = self._time - self._same_since
        if same_for > FROZEN_TIME and max(map(abs, speeds.tolist())) > MIN_TURNING_SPEED:
            return "imu frozen: it measures the same although the wheels turn"
        return ""
