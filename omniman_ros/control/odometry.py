"""Odometry: wheel motion to pose on SE(2), with a covariance that grows with the wheels' slip.

Source: CCTA 2017 (13) and (17) for the displacement; the pose is composed on SE(2) exactly, so a
constant twist gives the same pose for any step.

Where a yaw rate is measured, the heading follows it and not the wheels. Its bias is a fourth
state of an extended Kalman filter, which a robot at rest measures (zero angular rate update:
P. D. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed.,
section 15.3).
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from omniman_ros.control.imu import InertialStep
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core import plausible, se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.parameters import parameter
from omniman_ros.core.platform import Platform
from omniman_ros.core.validated import Validated

#: Largest wheel speed at which a platform without a setpoint counts as at rest [rad/s]
REST_SPEED = 0.02
#: Time for which all wheels are at rest before the coupling error starts from zero again, and the
#: bias of a yaw rate is measured [s].
#:
#: A platform that reverses passes through rest faster.
REST_TIME = 0.2
#: Yaw rate, less its bias, above which a robot rotates although its wheels are at rest [rad/s]
MAX_REST_RATE = 0.1
#: Smallest determinant of the calibration matrix; below it, directions would be mixed up
MIN_DETERMINANT = 0.05


@dataclass(frozen=True, kw_only=True)
class OdometryParameters(Validated):
    """Calibration and noise of the odometry.

    The calibration is a matrix that multiplies the measured twist: scales are on its diagonal,
    cross terms from one direction to another beside it. Wheels mounted at a small offset or angle
    need all nine entries; wrong radii alone are better corrected by `wheel_scale`, which the
    kinematics follow, too.

    Raises:
        ParameterError: The calibration matrix is (nearly) singular.
    """

    scale_x: float = parameter(1.0, "True over measured travel, forward.", low=0.5, high=2)
    scale_y: float = parameter(1.0, "True over measured travel, sideways.", low=0.5, high=2)
    scale_yaw: float = parameter(1.0, "True over measured rotation.", low=0.5, high=2)
    x_per_y: float = parameter(
        0.0, "True travel forward per measured travel sideways.", low=-0.5, high=0.5
    )
    x_per_yaw: float = parameter(
        0.0, "True travel forward per measured rotation.", unit="m/rad", low=-0.5, high=0.5
    )
    y_per_x: float = parameter(
        0.0, "True travel sideways per measured travel forward.", low=-0.5, high=0.5
    )
    y_per_yaw: float = parameter(
        0.0, "True travel sideways per measured rotation.", unit="m/rad", low=-0.5, high=0.5
    )
    yaw_per_x: float = parameter(
        0.0, "True rotation per measured travel forward.", unit="rad/m", low=-0.5, high=0.5
    )
    yaw_per_y: float = parameter(
        0.0, "True rotation per measured travel sideways.", unit="rad/m", low=-0.5, high=0.5
    )
    wheel_scale: tuple[float, ...] = parameter(
        (1.0,),
        "True over configured radius of each wheel; one value or one per wheel.",
        low=0.5,
        high=2,
    )
    encoder_span: float = parameter(
        0.0,
        "Range after which wheel_states positions wrap; 0 if they do not.",
        unit="rad",
        low=0,
        read_only=True,
    )
    noise_translation: float = parameter(
        1e-4, "Variance of the position gained per metre.", unit="m^2/m", low=0, high=10
    )
    noise_rotation: float = parameter(
        1e-3, "Variance of the heading gained per radian.", unit="rad^2/rad", low=0, high=10
    )
    noise_drift: float = parameter(
        1e-4, "Variance of the heading gained per metre.", unit="rad^2/m", low=0, high=10
    )
    noise_slip: float = parameter(
        0.1,
        "Variance of position [m^2] and heading [rad^2] gained per metre of coupling "
        "residual at the rim.",
        unit="m^2/m",
        low=0,
        high=100,
    )
    slip_threshold: float = parameter(
        0.05,
        "Coupling residual at the rim above which the wheels count as slipping.",
        unit="m/s",
        low=1e-4,
        high=10,
    )
    slip_filter: float = parameter(
        0.1, "Time constant of the coupling residual's filter.", unit="s", low=0.005, high=10
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        determinant = float(np.linalg.det(self.correction))
        if determinant < MIN_DETERMINANT:
            raise self._refusal(
                "scale_x",
                f"with the other scales and cross terms the calibration matrix has the "
                f"determinant {determinant:.3g}, below {MIN_DETERMINANT:g}",
            )

    @property
    def correction(self) -> Array:
        """Calibration matrix (3, 3): measured to true twist in base_link [m, m, rad]."""
        return np.array(
            [
                [self.scale_x, self.x_per_y, self.x_per_yaw],
                [self.y_per_x, self.scale_y, self.y_per_yaw],
                [self.yaw_per_x, self.yaw_per_y, self.scale_yaw],
            ]
        )

    def require_wheel_count(self, count: int) -> None:
        """Raise ParameterError unless `wheel_scale` has one value, or one for each wheel."""
        scale = self.wheel_scale
        if len(scale) not in (1, count):
            reason = f"{len(scale)} values, {count} wheels"
            raise ParameterError("odometry.wheel_scale", scale, reason)

    def calibrated(self, robot: Platform) -> Platform:
        """Return the robot with its wheel radii multiplied by `wheel_scale`."""
        radius = tuple((np.array(robot.wheels.radius) * self.wheel_scale).tolist())
        return replace(robot, wheels=replace(robot.wheels, radius=radius))


class PoseCovariance:
    """Covariance of (x, y, theta, bias) in odom [m, m, rad, rad/s].

    The prediction F P F' + Q of an extended Kalman filter and its update by a zero angular rate
    (Groves, sections 3.2 and 15.3) are written out for the entries, which takes a fraction of the
    time of small matrices.
    """

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


class Odometry:
    """Integrates the motion of the wheels to the pose of base_link in odom.

    The augmented forward kinematics give the rate of the coupling error as well, CCTA 2017 (13);
    its integral from 0 to t, (24), is therefore kept here, beside the pose.

    Attributes:
        pose: Pose (x, y, theta) in odom [m, m, rad]; theta is not wrapped.
        twist: Twist (3,) in base_link [m/s, m/s, rad/s]; its rotation is the measured yaw rate,
            less its bias, where there is one.
        wheel_twist: Twist (3,) by the wheels alone [m/s, m/s, rad/s].
        yaw_bias: Estimated bias of the yaw rate [rad/s].
        rest: Time for which all wheels have been at rest [s].
        constraint_rate: Rate (m,) of the coupling error, epsilon' of CCTA 2017 (12) [rad/s].
        coupling_error: Its integral (m,), epsilon of CCTA 2017 (24), since the start or the last
            :meth:`reset_coupling_error`; rests do not reset it [rad].
        slipping: Whether the filtered coupling residual is above its threshold. It does not show
            the slip of unconstrained wheels of the kinematics.
    """

    def __init__(self, kinematics: PlatformKinematics, parameters: OdometryParameters) -> None:
        self.pose = (0.0, 0.0, 0.0)
        self.twist: Array = np.zeros(3)
        self.wheel_twist: Array = np.zeros(3)
        self.yaw_bias = self.rest = 0.0
        self.slipping = False
        self.coupling_error: Array = np.zeros(kinematics.constraint_count)
        self._covariance = PoseCovariance()
        self._idle = kinematics.idle
        self.configure(kinematics, parameters)

    def configure(self, kinematics: PlatformKinematics, parameters: OdometryParameters) -> None:
        """Set new kinematics of the same wheels and new parameters; the pose is kept.

        The coupling error is kept as well, unless other wheels are idle: with them, the
        constraints are others.
        """
        m = kinematics.constraint_count
        if kinematics.idle != self._idle:
            self.reset_coupling_error()
        self._idle = kinematics.idle
        self._forward = np.vstack([parameters.correction @ kinematics.J_pinv, kinematics.T])
        # Travel at the rim per radian of each constraint.
        self._rim = 1.0 / np.linalg.norm(kinematics.J[:, :2], axis=1).max()
        self._parameters = parameters
        self.constraint_rate: Array = np.zeros(m)
        self._residual = np.zeros(m)

    def reset(
        self,
        pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
        covariance: Array | None = None,
    ) -> None:
        """Set the pose; the twist is kept.

        Args:
            pose: Pose x, y, theta in odom [m, m, rad].
            covariance: Covariance (3, 3) of the pose; None means zero.

        Raises:
            InputError: A number is not finite, or the covariance is not (3, 3).
        """
        plausible.demand(np.array(pose[:2]), plausible.LENGTH, "position")
        plausible.demand(np.array(pose[2:]), plausible.ANGLE, "heading")
        if covariance is None:
            covariance = np.zeros((3, 3))
        if covariance.shape != (3, 3):
            raise InputError(f"covariance has shape {covariance.shape}, expected (3, 3)")
        plausible.demand(covariance, plausible.COVARIANCE, "covariance")
        covariance = (covariance + covariance.T) / 2
        if np.linalg.eigvalsh(covariance).min() < -1e-9:
            raise InputError("the pose's covariance has a negative variance")
        self.pose = (float(pose[0]), float(pose[1]), float(pose[2]))
        self._covariance.set_pose(covariance)

    def reset_coupling_error(self) -> None:
        """Let the coupling error count from zero again."""
        self.coupling_error = np.zeros_like(self.coupling_error)

    @property
    def covariance(self) -> Array:
        """Covariance (3, 3) of (x, y, theta) in odom [m^2, m rad, rad^2]."""
        return self._covariance.pose

    def update(
        self,
        wheel_steps: Array,
        wheel_speeds: Array,
        dt: float,
        inertial: InertialStep | None = None,
        unknown: Array | None = None,
    ) -> Array:
        """Add the motion of the wheels during `dt`.

        Args:
            wheel_steps: Rotation (n,) of each wheel since the last update [rad].
            wheel_speeds: Speed (n,) of each wheel now [rad/s], for the twist.
            dt: Time since the last update [s], above 0.
            unknown: Rotation (n,) of each wheel that may be missing [rad], if the way of the
                motion from the last update to this one is not known; else None.

        Returns:
            Step (m,) of the coupling error epsilon [rad], CCTA 2017 (12).
        """
        steps = self._forward @ wheel_steps
        rates = self._forward @ wheel_speeds
        self.twist = self.wheel_twist = rates[:3]
        self.constraint_rate = rates[3:]
        resting = max(map(abs, wheel_speeds.tolist())) <= REST_SPEED
        self.rest = self.rest + dt if resting else 0.0
        motion = steps[:3]
        measured = inertial is not None and self._measured_rotation(inertial, dt)
        if inertial is not None and measured:
            motion = np.array([motion[0], motion[1], inertial.rotation - self.yaw_bias * dt])
            self.twist = np.array([rates[0], rates[1], motion[2] / dt])
        x, y, theta = self.pose
        dx, dy, dtheta = se2.arc(motion)
        c, s = math.cos(theta), math.sin(theta)
        east, north = c * dx - s * dy, s * dx + c * dy
        self.pose = (x + east, y + north, theta + dtheta)
        step = steps[3:]
        self.coupling_error = self.coupling_error + step
        slip = 0.0
        if step.size:
            gain = 1.0 - math.exp(-dt / self._parameters.slip_filter)
            self._residual += gain * (step / dt - self._residual)
            slip = self._rim * float(np.abs(self._residual).max())
            self.slipping = slip > self._parameters.slip_threshold
        p, slipped = self._parameters, slip * dt
        displacement = math.hypot(east, north)
        variance = p.noise_translation * displacement + p.noise_slip * slipped
        yaw_variance = 0.0
        if unknown is not None:
            way, yaw_variance = self._unknown_way(unknown, displacement, dtheta)
            variance += way
        if inertial is not None and measured:
            yaw_variance = inertial.noise + inertial.scale_error
            self._covariance.propagate(east, north, variance, yaw_variance)
            self._covariance.rotate_by_rate(dt)
        else:
            yaw_variance += p.noise_rotation * abs(dtheta) + p.noise_drift * displacement
            yaw_variance += p.noise_slip * slipped
            self._covariance.propagate(east, north, variance, yaw_variance)
        return step

    def _unknown_way(
        self, unknown: Array, displacement: float, turn: float
    ) -> tuple[float, float]:
        """Return the variances of position [m^2] and heading [rad^2] by a way that is not known.

        The ends of an arc and of a straight way with the turn before or after it are half of
        travel times turn apart.
        """
        x, y, theta = (np.abs(self._forward[:3]) @ unknown).tolist()
        bend = 0.5 * displacement * min(abs(turn), math.pi)
        return x * x + y * y + bend * bend, theta * theta

    def _measured_rotation(self, inertial: InertialStep, dt: float) -> bool:
        """Return whether a measured rotation counts; else the robot rests: it shows the bias."""
        if not self._covariance.has_bias:
            self._covariance.set_bias(inertial.initial_bias_variance)
        self._covariance.drift(inertial.bias_drift)
        innovation = inertial.rotation / dt - self.yaw_bias
        if self.rest < REST_TIME or abs(innovation) > MAX_REST_RATE:
            return True
        corrections = self._covariance.measure_bias(innovation, inertial.noise / (dt * dt))
        x, y, theta = self.pose
        self.pose = (x + corrections[0], y + corrections[1], theta + corrections[2])
        self.yaw_bias += corrections[3]
        return False
