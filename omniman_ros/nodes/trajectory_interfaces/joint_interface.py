"""Common part of the interfaces for trajectories of the arm and of the whole body."""

from abc import ABC, abstractmethod
from collections.abc import Callable

from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.core.arrays import Array
from omniman_ros.motion.path.joint_interpolator import JointInterpolator, JointProposal
from omniman_ros.motion.path.joint_points import JointPoints
from omniman_ros.nodes.trajectory_interfaces.motion_context import MIN_PLANNING_TIME, MotionContext
from omniman_ros.nodes.trajectory_interfaces.motion_interface import MotionInterface

#: Planning time that is expected for each point of a trajectory [s]
PLANNING_TIME_PER_POINT = 1e-3


class JointInterface(MotionInterface, ABC):
    """Connects a `JointInterpolator` to the messages of the node."""

    _context: MotionContext
    core: JointInterpolator

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes."""
        return self.core.planner.limits.names

    @abstractmethod
    def trajectory(self, message: JointTrajectory) -> str:
        """Start a trajectory, or let it wait; return or raise (InputError) why it is refused."""

    @abstractmethod
    def rest_position(self) -> Array:
        """Return the positions (d,) at which the axes are at rest."""

    @abstractmethod
    def actual(self) -> tuple[Array, Array] | None:
        """Return measured positions and velocities (d,) of the axes; None if they are unknown."""

    @property
    def is_pending(self) -> bool:
        """Whether the motion that was accepted last still waits to be started."""
        return False

    def discard_pending(self) -> bool:
        """Discard the motion that waits, and return whether there was one."""
        return False

    def desired(self) -> tuple[Array, Array, Array] | None:
        """Return references (d,) and their rates at the instant of :meth:`actual`, if any."""
        return None if self.idle else self._desired_at(self._context.arm_feed.time)

    def points(self, message: JointTrajectory) -> JointPoints:
        """Convert the points of a trajectory of these axes, or raise InputError."""
        max_points = self._context.options.joint_trajectory.max_points
        return arm_conversions.joint_points(message, self.names, max_points)

    def stop(self) -> None:
        """Bring the motion to rest on its path, as a trajectory without points asks for."""
        if not self.idle:
            self.core.cancel(self._context.time_base.now())

    def start(self, points: JointPoints, delay: float | None) -> None:
        """Plan a trajectory, or raise InputError; start it after a delay [s], None: at once."""
        begin, time_base = self._node.now(), self._context.time_base

        def propose(lead: float) -> JointProposal:
            now = time_base.now()
            start = None if delay is None else max(time_base.pace.motion(begin + delay), now)
            proposal = self.core.propose(points, self.rest_position(), now, lead, start)
            self._context.self_collision().require_clear(proposal.curve)
            return proposal

        count = len(points.positions)
        proposal = self._take(propose, MIN_PLANNING_TIME + PLANNING_TIME_PER_POINT * count)
        times = "given" if points.times is not None else "computed"
        self._announce(f"{count} points in {proposal.curve.duration:.2f} s, times {times}")

    def _take(
        self, propose: Callable[[float], JointProposal], planning_time: float
    ) -> JointProposal:
        from_rest = self.idle
        proposal = self._context.propose_in_time(propose, self.core.take, planning_time)
        self.log.start(replaces_driven=not from_rest)
        self.output.begin(from_rest=from_rest)
        return proposal

    def send(self, message: JointTrajectory) -> int:
        """Accept the trajectory of an action's goal; return the number of its motion.

        Raises:
            InputError: The trajectory is refused; the motion under way goes on.
        """
        if self._context.is_ending():
            raise self.log.refuse("the node is shutting down")
        why = self.trajectory(message)
        if why:
            raise self.log.refuse(why)
        return self.log.ledger.accepted

    def outcome(self, motion: int) -> str | None:
        """Return why a motion ended: empty if it arrived; None while it waits or goes on."""
        return self.log.ledger.outcome_so_far(
            motion, is_driven=not self.idle, is_pending=self.is_pending
        )

    def cancel(self, motion: int) -> None:
        """Discard a motion that waits, or bring the one under way to rest on its path."""
        if motion == self.log.ledger.accepted and self.discard_pending():
            return
        if motion == self.log.ledger.started and not self.idle:
            self.stop()
            self._context.on_started()
