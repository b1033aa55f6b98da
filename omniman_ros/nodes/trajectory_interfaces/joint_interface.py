"""Common part of the interfaces for trajectories of the arm and of the whole body."""

from abc import ABC, abstractmethod
from collections.abc import Callable

from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.path.joint_interpolator import JointInterpolator, JointProposal
from omniman_ros.motion.path.joint_points import JointPoints
from omniman_ros.nodes.motion_log import LoggedMotion
from omniman_ros.nodes.pending_motion import PendingMotion
from omniman_ros.nodes.trajectory_interfaces.motion_context import MIN_PLANNING_TIME, MotionContext
from omniman_ros.nodes.trajectory_interfaces.motion_interface import MotionInterface

#: Planning time that is expected for each point of a trajectory [s]
PLANNING_TIME_PER_POINT = 1e-3


class JointInterface(MotionInterface, ABC):
    """Connects a `JointInterpolator` to the messages of the node."""

    _context: MotionContext
    core: JointInterpolator
    pending: PendingMotion | None = None  #: Motion that waits, where one can

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes."""
        return self.core.planner.limits.names

    @abstractmethod
    def trajectory(self, motion: LoggedMotion, message: JointTrajectory) -> str:
        """Start a trajectory, or let it wait; return or raise (InputError) why it is refused."""

    @abstractmethod
    def rest_position(self) -> Array:
        """Return the positions (d,) at which the axes are at rest."""

    @abstractmethod
    def actual(self) -> tuple[Array, Array] | None:
        """Return measured positions and velocities (d,) of the axes; None if they are unknown."""

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

    def start(self, motion: LoggedMotion, points: JointPoints, delay: float | None) -> None:
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
        self._announce(motion, f"{count} points in {proposal.curve.duration:.2f} s, times {times}")

    def _take(
        self, propose: Callable[[float], JointProposal], planning_time: float
    ) -> JointProposal:
        from_rest = self.idle
        proposal = self._context.propose_in_time(propose, self.core.take, planning_time)
        self.output.begin(from_rest=from_rest)
        return proposal

    def submit(
        self,
        motion: LoggedMotion,
        message: JointTrajectory,
        start: Callable[[LoggedMotion, JointTrajectory], str],
        hint: str = "",
    ) -> str:
        """Start a motion; record and return or raise why it is refused, with a hint."""
        try:
            if self._context.is_ending():
                raise InputError("the node is shutting down")
            why = start(motion, message)
        except InputError as error:
            raise self.log.refuse(motion, f"{error}{hint}") from error
        if why:
            why += hint
            self.log.refuse(motion, why)
        return why

    def send(self, message: JointTrajectory) -> LoggedMotion:
        """Accept a trajectory, or raise InputError; then the motion under way goes on."""
        motion = self.log.receive(message.header.stamp)
        why = self.submit(motion, message, self.trajectory)
        if why:
            raise InputError(why)
        return motion

    def cancel(self, motion: LoggedMotion) -> None:
        """Discard a motion that waits, or bring the one under way to rest on its path."""
        if self.pending is not None and motion is self.pending.motion:
            self.pending.discard()
        elif motion is self.log.driven:
            self.stop()
            self._context.on_started()
