"""Comparison of the motion that an inertial sensor measures with that of the wheels."""

import math

import numpy as np

from omniman_ros.control.imu import InertialStep
from omniman_ros.control.odometry import REST_TIME, Odometry
from omniman_ros.core.arrays import Array

RATE_FILTER_TIME = 0.1  #: Time constant of the filter of the difference of yaw rates [s]
#: Time constant with which a difference of velocities is forgotten [s]: a collision takes a tenth
#: of it, and a constant error of the acceleration leaves no more than its product with this.
MEMORY = 0.5
#: Time constant with which the acceleration at rest, by bias and tilt, is learned [s]
BIAS_TIME = 1.0


class MotionComparison:
    """Differences between the motion of the wheels and the one of an inertial sensor.

    Attributes:
        yaw_rate: Yaw rate by the wheels less the measured one, filtered [rad/s].
        velocity: Velocity (2,) in base_link that the wheels have gained lately, less the one that
            the accelerations explain [m/s]: what the platform has lost and the wheels still have.
    """

    def __init__(self) -> None:
        self._bias: Array = np.zeros(2)
        self.restart()

    def restart(self) -> None:
        """Begin anew, as after a gap; the learned bias of the accelerations is kept."""
        self.yaw_rate = 0.0
        self.velocity: Array = np.zeros(2)
        self._before: Array | None = None

    def update(self, dt: float, odometry: Odometry, inertial: InertialStep | None) -> None:
        """Process a step between two reports of the wheels."""
        if inertial is None:
            if self._before is not None:
                self.restart()
            return
        vx, vy, w = odometry.wheel_twist.tolist()
        velocity = odometry.wheel_twist[:2]
        if odometry.rest >= REST_TIME:
            share = dt / (BIAS_TIME + dt)
            self._bias = self._bias + share * (inertial.acceleration - self._bias)
        rate = w - (inertial.rotation / dt - odometry.yaw_bias)
        self.yaw_rate += (rate - self.yaw_rate) * dt / (RATE_FILTER_TIME + dt)
        if self._before is not None:
            turning = np.array([-w * vy, w * vx])
            gained = velocity - self._before + turning * dt
            measured = (inertial.acceleration - self._bias) * dt
            self.velocity = self.velocity * math.exp(-dt / MEMORY) + gained - measured
        self._before = velocity
