"""Simulated arm: joints that follow their target within the limits of their drives."""

from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated
from omniman_ros.simulation.ur.dynamics import ArmDynamics

JOINTS = 6  #: Number of joints
CYCLE = 0.008  #: Cycle time of a CB3 controller [s]

REST_SPEED = 1e-3  #: Joint speed below which the arm counts as at rest [rad/s]


@dataclass(frozen=True, kw_only=True)
class UrArmParameters(Validated):
    """Limits of the simulated arm, and of its safety system.

    Position, speed and acceleration limits are those that a controller reports as its own
    configuration (Universal_Robots_Client_Library, test_primary_parser.cpp, CONFIGURATION_DATA):
    363 deg, 191.5 deg/s, 40 rad/s^2; a little more than the data sheet's pi rad/s and 360 deg.

    A joint that deviates from its path, or whose torque deviates from the model of arm and
    payload, causes a protective stop (Universal Robots, "Protective Stop Service Note": C153,
    "position deviates from path", and C157, "collision detected by joint"). The thresholds are
    not public: those here are assumed.
    """

    initial: tuple[float, ...] = parameter(
        (-1.6007, -1.7271, -2.203, -0.808, 1.5951, -0.031),
        "Initial joint angles, unless the joints are in a world.",
        unit="rad",
        low=-6.3,
        high=6.3,
        read_only=True,
    )
    range: float = parameter(
        6.3355,
        "Magnitude of a joint angle above which there is a protective stop.",
        unit="rad",
        low=0.1,
        high=6.3355,
        read_only=True,
    )
    speed: float = parameter(
        3.3415,
        "Joint speed above which there is a protective stop.",
        unit="rad/s",
        low=0.1,
        high=3.3415,
        read_only=True,
    )
    acceleration: float = parameter(
        40.0, "Largest joint acceleration.", unit="rad/s^2", low=1, high=100, read_only=True
    )
    lag: float = parameter(
        0.01,
        "Lag of a joint behind its target.",
        unit="s",
        low=0.001,
        high=0.1,
        read_only=True,
    )
    deviation: float = parameter(
        0.1,
        "Distance of a joint from its target above which there is a protective stop.",
        unit="rad",
        low=0.01,
        high=1,
        read_only=True,
    )
    protective_deceleration: float = parameter(
        15.0,
        "Deceleration of the fastest joint in protective and emergency stops.",
        unit="rad/s^2",
        low=1,
        high=40,
        read_only=True,
    )
    payload: float = parameter(
        0.0,
        "Mass of tool and load that the controller assumes.",
        unit="kg",
        low=0,
        high=10,
        read_only=True,
    )
    collision_torque: tuple[float, ...] = parameter(
        (40.0, 40.0, 40.0, 15.0, 15.0, 15.0),
        "Difference of each joint's torque from the controller's model above which there is a "
        "protective stop.",
        unit="N m",
        low=0.1,
        high=1000,
        read_only=True,
    )
    collision_time: float = parameter(
        0.024,
        "Time for which a joint's torque must differ for a protective stop.",
        unit="s",
        low=0.008,
        high=1,
        read_only=True,
    )
    world_port: int = parameter(
        0,
        "Port on this machine of the simulated world that moves the joints; if 0, the arm moves "
        "them itself.",
        low=0,
        high=65535,
        read_only=True,
    )

    def __post_init__(self) -> None:
        """Compare the parameters with each other.

        Raises:
            ParameterError: There are not six angles or torques, an angle is out of range, or the
                deceleration of stops is above the largest acceleration.
        """
        super().__post_init__()
        if len(self.initial) != JOINTS or any(abs(q) > self.range for q in self.initial):
            reason = f"must be {JOINTS} angles within +-{self.range} rad"
            raise self._refusal("initial", reason)
        if len(self.collision_torque) != JOINTS:
            reason = f"must be {JOINTS} torques"
            raise self._refusal("collision_torque", reason)
        if self.protective_deceleration > self.acceleration:
            reason = f"must be at most simulated_arm.acceleration = {self.acceleration} rad/s^2"
            raise self._refusal("protective_deceleration", reason)


class SimulatedArm:
    """Six independent joints, each of second order with limited acceleration; an `ArmBody`.

    Nothing loads or obstructs the joints. They are therefore their own reference, and the
    deviations from a reference are zero.
    """

    is_connected = True
    failure = ""

    def __init__(self, parameters: UrArmParameters) -> None:
        self.parameters = parameters
        self.q: Array = np.array(parameters.initial)  #: Angles [rad]
        self.qd: Array = np.zeros(JOINTS)  #: Speeds [rad/s]
        self.qdd: Array = np.zeros(JOINTS)  #: Accelerations in the last cycle [rad/s^2]
        self.dynamics = ArmDynamics(parameters.payload)  #: Model of the torques
        self.lost_motion: Array = np.zeros(JOINTS)  #: Zero (6,) [rad]
        self.unexpected_torque: Array = np.zeros(JOINTS)  #: Zero (6,) [N m]
        self._is_locked = False

    @property
    def reference(self) -> "SimulatedArm":
        """The joints themselves."""
        return self

    @property
    def torque(self) -> Array:
        """Torques of the joints by the model (6,) [N m]; zero with the brakes on."""
        if self._is_locked:
            return np.zeros(JOINTS)
        return self.dynamics.torque(self.q, self.qd, self.qdd)

    def place(self, q: Array, qd: Array) -> None:
        """Go on from angles (6,) [rad] at speeds (6,) [rad/s]."""
        self.q, self.qd, self.qdd = q.copy(), qd.copy(), np.zeros(JOINTS)

    def measure(self, time: float) -> None:
        """Do nothing: angles and speeds are up to date after each step."""

    def lock(self) -> None:
        """Hold the joints by their brakes for a cycle."""
        self._is_locked = True
        self.qd, self.qdd = np.zeros(JOINTS), np.zeros(JOINTS)

    def give_way(self) -> None:
        """Do nothing: the joints are their own reference."""

    def close(self) -> None:
        """Do nothing: there is no connection."""

    def follow(self, target: Array, dt: float) -> None:
        """Follow target angles (6,) [rad] for a time dt [s].

        A joint is critically damped, and lags by `lag` in steady motion. The step is implicit,
        and therefore stable for any cycle time.
        """
        lag = self.parameters.lag
        stiffness = 4.0 / lag**2
        unlimited_qd = (self.qd + dt * stiffness * (target - self.q)) / (
            1.0 + dt * stiffness * (dt + lag)
        )
        limit = self.parameters.acceleration
        self._move(np.clip((unlimited_qd - self.qd) / dt, -limit, limit), dt)

    def brake(self, dt: float) -> None:
        """Decelerate for a time [s], all joints in proportion: the arm keeps its path."""
        fastest = float(np.max(np.abs(self.qd)))
        if fastest == 0.0:
            self._move(np.zeros(JOINTS), dt)
            return
        remaining_fraction = max(0.0, 1.0 - self.parameters.protective_deceleration * dt / fastest)
        self._move(self.qd * (remaining_fraction - 1.0) / dt, dt)
        if remaining_fraction == 0.0:
            self.qd = np.zeros(JOINTS)

    def _move(self, acceleration: Array, dt: float) -> None:
        self._is_locked = False
        self.qdd = acceleration
        self.qd = self.qd + acceleration * dt
        self.q = self.q + self.qd * dt

    @property
    def still(self) -> bool:
        """Whether the arm counts as at rest."""
        return bool(np.max(np.abs(self.qd)) < REST_SPEED)
