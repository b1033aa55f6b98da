"""Estimate of the force and torque that act on the platform besides those of its motors.

Source: the generalized-momentum observer of A. De Luca and R. Mattone, "Sensorless robot
collision detection and hybrid force/motion control", ICRA 2005, with the platform's dynamics of
CCTA 2017 (19) to (23) as corrected in :mod:`omniman_ros.control.dynamics`. It needs the torques
and speeds of the wheels, but no accelerations.
"""

import numpy as np

from omniman_ros.control.dynamics import PlatformDynamics, smooth_sign
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.arrays import Array

#: Time constant T of the observer [s]: short against the second in which a held robot must be
#: noticed, long against the ripple of rollers and of the drives' loops.
OBSERVER_TIME = 0.1


class ExternalForceObserver:
    """Estimates the external wrench (fx, fy, torque about z) on base_link's origin.

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
