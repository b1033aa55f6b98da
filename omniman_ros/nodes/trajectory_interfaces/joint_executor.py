"""Goals of the actions `follow_joint_trajectory`, which arm and whole body serve."""

from trajectory_msgs.msg import JointTrajectory

from omniman_ros.core.arrays import Array
from omniman_ros.nodes.trajectory_interfaces.joint_interface import JointInterface
from omniman_ros.nodes.trajectory_interfaces.motion_context import MotionContext


class JointExecutor:
    """Hands goals of an action to an interface of trajectories; see `TrajectoryExecutor`."""

    def __init__(self, context: MotionContext, interface: JointInterface) -> None:
        self._context, self._interface = context, interface

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes."""
        return self._interface.names

    def send(self, message: JointTrajectory) -> int:
        """Accept a trajectory, and return the number of its motion; see `TrajectoryExecutor`."""
        if self._context.is_ending():
            raise self._interface.log.refuse("the node is shutting down")
        why = self._interface.trajectory(message)
        if why:
            raise self._interface.log.refuse(why)
        return self._interface.log.ledger.accepted

    def outcome(self, motion: int) -> str | None:
        """Return why a motion ended: empty if it arrived; None while it waits or goes on."""
        interface = self._interface
        return interface.log.ledger.outcome_so_far(
            motion, is_driven=not interface.idle, is_pending=interface.is_pending
        )

    def cancel(self, motion: int) -> None:
        """Discard a motion that waits, or bring the one under way to rest on its path."""
        interface, ledger = self._interface, self._interface.log.ledger
        if motion == ledger.accepted and interface.discard_pending():
            return
        if motion == ledger.started and not interface.idle:
            interface.stop()
            self._context.on_started()

    def desired(self) -> tuple[Array, Array, Array] | None:
        """Return the references of the instant at which :meth:`actual` was measured."""
        return self._interface.desired()

    def actual(self) -> tuple[Array, Array] | None:
        """Return measured positions and velocities of the axes; None if they are unknown."""
        return self._interface.actual()
