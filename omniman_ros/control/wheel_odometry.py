"""The odometry without a controller: from reports of the wheels to pose and coupling error."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.control.imu import ImuFeedback, ImuParameters
from omniman_ros.control.kinematics import MIN_REMAINING_FRACTION, PlatformKinematics
from omniman_ros.control.odometry import REST_TIME, Odometry, OdometryParameters
from omniman_ros.control.wheel_feedback import MAX_GAP, WheelFeedback
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import inline
from omniman_ros.core.platform import Platform
from omniman_ros.core.validated import Validated


@dataclass(frozen=True, kw_only=True)
class WheelOdometryParameters(Validated):
    """Parameters of the odometry, including those of the robot.

    Raises:
        ParameterError: The number of wheel scales is neither one nor that of the wheels.
    """

    robot: Platform = inline()
    odometry: OdometryParameters
    imu: ImuParameters

    def __post_init__(self) -> None:
        super().__post_init__()
        self.odometry.require_wheel_count(self.robot.wheel_count)


class WheelOdometry:
    """Integrates the reports of the wheels; nobody tells it what drives them.

    Time is an argument, on one clock of the caller's. Where it begins anew (a recording is played
    again, a clock is set back), the pose continues from where it is.

    Attributes:
        imu: Measurements of an inertial sensor; unused as long as there are none.
        coupling_error: Coupling error epsilon (m,), CCTA 2017 (24), since the wheels were last at
            rest for `REST_TIME` [rad].

    Raises:
        GeometryError: The wheels do not make a platform.
    """

    def __init__(self, parameters: WheelOdometryParameters) -> None:
        robot = parameters.robot
        self._parameters = parameters
        self.idle: tuple[int, ...] = ()
        kinematics = self._kinematics()
        self.odometry = Odometry(kinematics, parameters.odometry)
        self.feedback = WheelFeedback(
            robot.wheel_count, parameters.odometry.encoder_span, robot.motor.max_speed
        )
        self.imu = ImuFeedback(parameters.imu)
        self.coupling_error: Array = np.zeros(kinematics.constraint_count)
        self._arrival = -math.inf

    def configure(self, parameters: WheelOdometryParameters) -> None:
        """Set a new calibration and new noise while running; the pose is kept."""
        self._parameters = parameters
        self.feedback.max_speed = parameters.robot.motor.max_speed
        self.imu.configure(parameters.imu)
        self.odometry.configure(self._kinematics(), parameters.odometry)

    def leave_out(self, idle: tuple[int, ...]) -> None:
        """Go on without the wheels that only the floor rotates; the pose is kept.

        Args:
            idle: Indices of these wheels; all others count again.

        Raises:
            InputError: The other wheels do not determine the twist; nothing is changed.
        """
        if idle == self.idle:
            return
        robot = self._parameters.odometry.calibrated(self._parameters.robot)
        if (
            idle
            and PlatformKinematics(robot.wheels).remaining_fraction(idle) < MIN_REMAINING_FRACTION
        ):
            names = ", ".join(robot.wheels.names[i] for i in idle)
            raise InputError(f"without {names} the wheels do not determine the twist")
        self.idle = idle
        self.odometry.configure(self._kinematics(), self._parameters.odometry)
        self._restart_coupling()  # Its errors belong to other constraints.

    def _kinematics(self) -> PlatformKinematics:
        robot = self._parameters.odometry.calibrated(self._parameters.robot)
        return PlatformKinematics(robot.wheels, self.idle)

    def update_wheels(
        self,
        time: float,
        now: float,
        position: Array | None,
        velocity: Array | None,
        effort: Array | None = None,
    ) -> str:
        """Process positions or velocities of the wheels; return a warning to log, if any.

        Args:
            position: Positions (n,) [rad], or None.
            velocity: Speeds (n,) [rad/s], or None.
            effort: Torques (n,) [N m], or None; the odometry does not need them.

        Raises:
            InputError: A size is wrong, a number is not finite, there is no content, or the state
                is not newer than the last one although that is at most `MAX_GAP` ago.
        """
        restarted = self._restart_reason(time, now)
        if restarted:
            self.feedback.forget()
            self.imu.forget()
        step = self.feedback.update(time, now, position, velocity)
        self._arrival = now
        if step is None:
            self._restart_coupling()
            return restarted
        self.coupling_error = self.coupling_error + self.odometry.update(
            step.moved,
            step.speeds,
            step.dt,
            self.imu.take(self.feedback.time, now, step.speeds),
            step.unknown,
        )
        if self.odometry.rest >= REST_TIME:
            self._restart_coupling()
        return step.warning

    def _restart_reason(self, time: float, now: float) -> str:
        """Return why time begins anew with a report; empty if it does not.

        A single report from the past is out of order. Time begins anew if the clock went back, or
        if there was no newer report for `MAX_GAP`.
        """
        lag = self.feedback.time - time
        if not self.feedback.received or lag < 0.0 or 0.0 <= now - self._arrival <= MAX_GAP:
            return ""
        return f"time went back by {lag:.2f} s: the pose continues from where it is"

    def _restart_coupling(self) -> None:
        self.coupling_error = np.zeros_like(self.coupling_error)

    def set_pose(self, pose: tuple[float, float, float], covariance: Array | None = None) -> None:
        """Set the pose.

        Args:
            pose: Pose x, y, theta in odom [m, m, rad].
            covariance: Covariance (3, 3) of the pose; None means zero.

        Raises:
            InputError: See Odometry.reset.
        """
        self.odometry.reset(pose, covariance)

    def reset_odometry(self) -> None:
        """Set the pose to the origin, and the coupling error without resets to zero."""
        self.set_pose((0.0, 0.0, 0.0))
        self.odometry.reset_coupling_error()
