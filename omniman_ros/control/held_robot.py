"""Detection of a robot that is held: it pushes against something, and may not move at all.

Wheels that slip together, or that their drives hold at speed, turn as commanded: neither their
speeds nor the coupling residual show that the robot stands. Its motors do: they give a force that
the motion, as the wheels report it, does not explain.
"""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.control.dynamics import PlatformDynamics, smooth_sign
from omniman_ros.control.imu import InertialStep
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.odometry import REST_TIME, Odometry
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated

MAX_REPORT_GAP = 0.1  #: Longest time between two reports of torques that the estimate bridges [s]
#: Time for which a speed must be lost that the wheels still have [s]: rollers that slip while the
#: robot reverses lose as much for a few milliseconds, a robot that meets something for 0.1 s and
#: longer.
IMPACT_TIME = 0.012
#: Time constant T of the observer [s]: short against the second in which a held robot must be
#: noticed, long against the ripple of rollers and of the drives' loops.
OBSERVER_TIME = 0.1
RATE_FILTER_TIME = 0.1  #: Time constant of the filter of the difference of yaw rates [s]
#: Time constant with which a difference of velocities is forgotten [s]: a collision takes a tenth
#: of it, and a constant error of the acceleration leaves no more than its product with this.
MEMORY = 0.5
#: Time constant with which the acceleration at rest, by bias and tilt, is learned [s]
BIAS_TIME = 1.0


@dataclass(frozen=True)
class HeldRobotParameters(Validated):
    """Thresholds from which a robot counts as held."""

    stop: bool = parameter(
        True,
        "Whether a held robot is stopped; else forces are reported, and nothing else is done.",
    )
    force: float = parameter(
        100.0,
        "Force against the motors that the motion does not explain, from which the robot counts "
        "as held: above what wrong masses, friction and slopes make of it.",
        unit="N",
        low=0.1,
        high=1e6,
    )
    torque: float = parameter(
        50.0,
        "Torque about the vertical from which the robot counts as held, like held.force.",
        unit="N m",
        low=0.01,
        high=1e6,
    )
    yaw_rate: float = parameter(
        0.15,
        "Difference of the yaw rates of wheels and `imu` from which the robot counts as held.",
        unit="rad/s",
        low=0.001,
        high=100,
    )
    speed: float = parameter(
        0.2,
        "Speed from which the robot counts as held, if the platform has lost it by the "
        "accelerations of `imu`, and its wheels have it still, for more than 12 ms.",
        unit="m/s",
        low=0.001,
        high=100,
    )
    time: float = parameter(
        0.3,
        "Time for which a sign that the robot is held must last.",
        unit="s",
        low=0.02,
        high=10,
    )


class Persistence:
    """Time for which a condition has been true; while it is false, the time runs backwards."""

    def __init__(self) -> None:
        self._duration = 0.0

    def clear(self) -> None:
        """Begin anew."""
        self._duration = 0.0

    def update(self, condition: bool, dt: float) -> float:
        """Return the time for which the condition has been true, less that since it was [s]."""
        self._duration = max(0.0, self._duration + (dt if condition else -dt))
        return self._duration


class ExternalForceObserver:
    """Estimates the external wrench (fx, fy, torque about z) on base_link's origin.

    Source: the generalized-momentum observer of A. De Luca and R. Mattone, "Sensorless robot
    collision detection and hybrid force/motion control", ICRA 2005, with the platform's dynamics
    of CCTA 2017 (19) to (23) as corrected in :mod:`omniman_ros.control.dynamics`.

    With the momentum p = M v + J' I phi', the motors' wrench J' tau, the wrench f that friction
    takes and the inertial wrench c of a rotating platform,

        r = (p - p0 - integral of (J' tau - f - c + r)) / T,    so that    T r' = F_ext - r.

    The twist v is what the wheels report. Where they slip, M v' is not the change of the
    platform's momentum, but what a wheel does not need for itself still acts on the floor: for
    wheels that slip at a steady speed the estimate holds.

    Attributes:
        external: Estimated external wrench r (3,) in base_link [N, N, N m].
        motors: Wrench (3,) of the motors, through the same filter [N, N, N m].
    """

    def __init__(self, kinematics: PlatformKinematics, dynamics: PlatformDynamics) -> None:
        self.external: Array = np.zeros(3)
        self.motors: Array = np.zeros(3)
        self._time: float | None = None
        self._momentum: Array = np.zeros(3)
        self.configure(kinematics, dynamics)

    def configure(self, kinematics: PlatformKinematics, dynamics: PlatformDynamics) -> None:
        """Set new models, and begin anew."""
        self.set_dynamics(kinematics, dynamics)
        self.restart()

    def set_dynamics(self, kinematics: PlatformKinematics, dynamics: PlatformDynamics) -> None:
        """Set models with masses that have moved on the platform, and go on.

        Their momentum has changed with them, as that of the robot has.
        """
        self._dynamics = dynamics
        forward, twist = kinematics.J.T, kinematics.J_pinv
        self._forward = forward
        viscous, self._dry = dynamics.friction_wrenches()
        wheels, rollers = np.eye(kinematics.wheel_count), dynamics.rolling @ twist
        # One product with the wheel speeds gives all that is linear in them.
        self._of_speeds = np.vstack([twist, dynamics.momentum_map(), viscous, wheels, rollers])

    def restart(self) -> None:
        """Begin anew, as after a gap in the torques."""
        self._time = None
        self.external, self.motors = np.zeros(3), np.zeros(3)

    def update(self, time: float, speeds: Array, torque: Array) -> None:
        """Process newer speeds (n,) [rad/s] and torques (n,) [N m] of the wheels."""
        linear = self._of_speeds @ speeds
        momentum = linear[3:6]
        if self._time is not None:
            dt = time - self._time
            friction = linear[6:9] + self._dry @ smooth_sign(linear[9:])
            motors = self._forward @ torque
            inertial = self._dynamics.body_wrench(linear[:3], np.zeros(3))
            gain = dt / (OBSERVER_TIME + dt)
            change = (momentum - self._momentum) / dt
            self.external = self.external + gain * (
                change - (motors - friction - inertial) - self.external
            )
            self.motors = self.motors + gain * (motors - self.motors)
        self._time, self._momentum = time, momentum


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
            fraction = dt / (BIAS_TIME + dt)
            self._bias = self._bias + fraction * (inertial.acceleration - self._bias)
        rate = w - (inertial.rotation / dt - odometry.yaw_bias)
        self.yaw_rate += (rate - self.yaw_rate) * dt / (RATE_FILTER_TIME + dt)
        if self._before is not None:
            turning = np.array([-w * vy, w * vx])
            gained = velocity - self._before + turning * dt
            measured = (inertial.acceleration - self._bias) * dt
            self.velocity = self.velocity * math.exp(-dt / MEMORY) + gained - measured
        self._before = velocity


class HeldRobotDetector:
    """Compares the force and the torque of the motors with those that the motion explains.

    The robot counts as held if the motors push or turn it with more than the threshold, and the
    external force or torque against them is above the threshold as well. A robot whose wheels
    brake, on blocks or in a skid, is thus not held: its motors give less than its motion needs.

    Attributes:
        torque_reported: Whether the last report had torques; without them there is no estimate.
    """

    def __init__(
        self,
        parameters: HeldRobotParameters,
        kinematics: PlatformKinematics,
        dynamics: PlatformDynamics,
    ) -> None:
        self.observer = ExternalForceObserver(kinematics, dynamics)
        self.comparison = MotionComparison()
        self.torque_reported = False
        self.held = False
        self._parameters = parameters
        self._pushed, self._turned, self._misled, self._lost = (Persistence() for _ in range(4))
        self._time = -math.inf

    def configure(
        self,
        parameters: HeldRobotParameters,
        kinematics: PlatformKinematics,
        dynamics: PlatformDynamics,
    ) -> None:
        """Set new thresholds and models; the estimate begins anew."""
        self._parameters = parameters
        self.observer.configure(kinematics, dynamics)
        self.clear()

    def reset(self) -> None:
        """Forget that the robot was held."""
        self.held = False

    def clear(self) -> None:
        """Let all signs begin to last anew, as nothing is demanded of the robot."""
        self._pushed.clear()
        self._turned.clear()
        self._misled.clear()
        self._lost.clear()

    def update_wheels(self, time: float, speeds: Array, effort: Array | None) -> None:
        """Process a report of the drives.

        Args:
            speeds: Wheel speeds (n,) [rad/s].
            effort: Wheel torques (n,) [N m]. None, or numbers that are not finite or implausible,
                mean that the drives do not report them: the estimate then begins anew.
        """
        self.torque_reported = (
            effort is not None and max(map(abs, effort.tolist())) <= plausible.EFFORT
        )
        if effort is None or not self.torque_reported or time - self._time > MAX_REPORT_GAP:
            self.observer.restart()
        if effort is not None and self.torque_reported:
            self.observer.update(time, speeds, effort)
        self._time = time

    def update_motion(self, dt: float, odometry: Odometry, inertial: InertialStep | None) -> None:
        """Process a step between two reports of the wheels."""
        self.comparison.update(dt, odometry, inertial)

    def check(self, dt: float) -> str:
        """Return why the robot counts as held, if it does; call this once a tick of a motion."""
        reason = self._forced(dt) or self._contradicted(dt)
        self.held = bool(reason)
        return reason

    def _forced(self, dt: float) -> str:
        p = self._parameters
        push_x, push_y, turn = self.observer.motors.tolist()
        external_x, external_y, external_turn = self.observer.external.tolist()
        push = math.hypot(push_x, push_y)
        held = -(external_x * push_x + external_y * push_y) / push if push > 0.0 else 0.0
        if self._pushed.update(min(push, held) > p.force, dt) > p.time:
            return (
                f"the robot is held: its motors push with {push:.0f} N, "
                f"its motion explains {push - held:.0f} N"
            )
        held_turn = -math.copysign(external_turn, external_turn * turn)
        if self._turned.update(min(abs(turn), held_turn) > p.torque, dt) > p.time:
            return (
                f"the robot is held: its motors turn it with {abs(turn):.0f} N m, "
                f"its motion explains {abs(turn) - held_turn:.0f} N m"
            )
        return ""

    def _contradicted(self, dt: float) -> str:
        p, comparison = self._parameters, self.comparison
        lost = math.hypot(*comparison.velocity.tolist())
        if self._lost.update(lost > p.speed, dt) > IMPACT_TIME:
            return (
                f"the robot is held: it has lost {lost:.2f} m/s that its wheels still have, as "
                "imu shows"
            )
        difference = abs(comparison.yaw_rate)
        if self._misled.update(difference > p.yaw_rate, dt) > p.time:
            return (
                f"the robot is held: its wheels turn it by {difference:.2f} rad/s that imu does "
                "not show"
            )
        return ""
