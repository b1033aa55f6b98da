"""A simulated inertial measurement unit: what a gyroscope and accelerometers on the robot tell."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.imu_mount import ImuMount
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated


@dataclass(frozen=True, kw_only=True)
class ImuSensorParameters(Validated):
    """Errors and faults of the sensor; those of a small MEMS unit by default."""

    gyro_noise: float = parameter(
        0.002, "Standard deviation of a measured rate.", unit="rad/s", low=0, high=10
    )
    gyro_bias: float = parameter(
        0.005, "Bias of the rate about the vertical.", unit="rad/s", low=-1, high=1
    )
    gyro_drift: float = parameter(
        1e-5, "Random walk of that bias.", unit="rad/s/sqrt(s)", low=0, high=1
    )
    acceleration_noise: float = parameter(
        0.02, "Standard deviation of a measured acceleration.", unit="m/s^2", low=0, high=100
    )
    acceleration_bias: float = parameter(
        0.05, "Bias of the accelerations along x and y.", unit="m/s^2", low=-10, high=10
    )
    silent: bool = parameter(False, "Fault: nothing is measured.")
    frozen: bool = parameter(False, "Fault: the last measurement is repeated.")


@dataclass(frozen=True)
class BaseMotion(Validated):
    """Motion of base_link in one instant."""

    rotation: Annotated[Array, Shape(3, 3)]  #: Rotation (3, 3) of base_link in the world
    velocity: Annotated[Array, Shape(3)]  #: Velocity (3,) of its origin, in its own axes [m/s]
    rate: Annotated[Array, Shape(3)]  #: Angular velocity (3,), in its own axes [rad/s]


def planar_motion(twist: Array) -> BaseMotion:
    """Return the motion of a robot on a level floor from its twist (3,) in base_link."""
    vx, vy, w = twist.tolist()
    return BaseMotion(np.eye(3), np.array([vx, vy, 0.0]), np.array([0.0, 0.0, w]))


class SimulatedImu:
    """Measures the present rate, and the mean acceleration since the last measurement.

    Args:
        gravity: Gravity [m/s^2].
    """

    def __init__(
        self, mount: ImuMount, parameters: ImuSensorParameters, gravity: float, seed: int = 0
    ) -> None:
        self._random = np.random.default_rng(seed)
        self._time: float | None = None
        self._motion = BaseMotion(np.eye(3), np.zeros(3), np.zeros(3))
        self._walk = 0.0
        self._measured: tuple[Array, Array] | None = None
        self.configure(mount, parameters, gravity)

    def configure(self, mount: ImuMount, parameters: ImuSensorParameters, gravity: float) -> None:
        """Set new parameters; the drift of the bias is kept."""
        self._parameters = parameters
        self._place = np.array([mount.x, mount.y, mount.z])
        c, s = math.cos(mount.yaw), math.sin(mount.yaw)
        self._to_sensor = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        self._gravity = np.array([0.0, 0.0, gravity])

    def measure(self, time: float, motion: BaseMotion) -> tuple[Array, Array] | None:
        """Return what the sensor measures at `time`.

        Returns:
            Angular velocity (3,) [rad/s], and acceleration (3,) with gravity, upward at rest
            [m/s^2], in the sensor's frame; None if it tells nothing.
        """
        p, before, last = self._parameters, self._motion, self._time
        if last is not None and time <= last:
            return None
        self._time, self._motion = time, motion
        dt = 0.0 if last is None else time - last
        self._walk += p.gyro_drift * math.sqrt(dt) * float(self._random.standard_normal())
        if p.silent or last is None:
            return None
        if p.frozen and self._measured is not None:
            return self._measured
        former, present = (m.velocity + _cross(m.rate, self._place) for m in (before, motion))
        mean_rate, mean_velocity = 0.5 * (before.rate + motion.rate), 0.5 * (former + present)
        acceleration = (present - former) / dt + _cross(mean_rate, mean_velocity)
        force = acceleration + motion.rotation.T @ self._gravity
        rate = motion.rate + self._random.normal(0.0, p.gyro_noise, 3)
        rate[2] += p.gyro_bias + self._walk
        force = self._to_sensor @ force + self._random.normal(0.0, p.acceleration_noise, 3)
        force[:2] += p.acceleration_bias
        self._measured = self._to_sensor @ rate, force
        return self._measured


def _cross(left: Array, right: Array) -> Array:
    """Return the cross product (3,) of two vectors, for which numpy's takes ten times as long."""
    a, b, c = left.tolist()
    x, y, z = right.tolist()
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])
