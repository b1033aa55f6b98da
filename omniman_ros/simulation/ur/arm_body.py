"""What the controller needs to know of its arm, wherever the joints are."""

from typing import Protocol

from omniman_ros.core.arrays import Array
from omniman_ros.simulation.ur.dynamics import ArmDynamics


class JointMotionState(Protocol):
    """Angles and speeds of joints."""

    @property
    def q(self) -> Array:
        """Angles (6,) [rad]."""

    @property
    def qd(self) -> Array:
        """Speeds (6,) [rad/s]."""


class ArmBody(JointMotionState, Protocol):
    """Joints with drives and brakes; angles and speeds are measured.

    In each cycle, :meth:`measure` is called first, and then one of :meth:`follow`, :meth:`brake`
    and :meth:`lock`.
    """

    @property
    def reference(self) -> JointMotionState:
        """Motion that the drives are told to make, within the limits of the joints."""

    @property
    def dynamics(self) -> ArmDynamics:
        """The controller's model of the arm."""

    @property
    def torque(self) -> Array:
        """Torques of the joints (6,) [N m], without the friction of the motors."""

    @property
    def lost_motion(self) -> Array:
        """By how much the joints are behind their reference at the same instant (6,) [rad]."""

    @property
    def unexpected_torque(self) -> Array:
        """Torques beyond those that the reference takes by the controller's model (6,) [N m]."""

    @property
    def is_connected(self) -> bool:
        """Whether the joints answer."""

    @property
    def failure(self) -> str:
        """Why the joints do not answer, or an empty string."""

    @property
    def still(self) -> bool:
        """Whether the arm counts as at rest."""

    def measure(self, time: float) -> None:
        """Measure at the beginning of a cycle, an instant on the clock of its thread [s]."""

    def follow(self, target: Array, dt: float) -> None:
        """Follow target angles (6,) [rad] for a time dt [s]."""

    def brake(self, dt: float) -> None:
        """Decelerate by the drives for a time [s], all joints in proportion."""

    def lock(self) -> None:
        """Hold the joints by their brakes for a cycle."""

    def give_way(self) -> None:
        """Go on from where the joints are, instead of from their reference."""

    def close(self) -> None:
        """Release the connection to the joints."""
