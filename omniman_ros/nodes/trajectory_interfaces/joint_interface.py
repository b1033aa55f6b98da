"""Common part of the interfaces for trajectories of the arm and of the whole body."""

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.core.arrays import Array
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.motion.path.joint_interpolator import JointInterpolator, JointProposal
from omniman_ros.motion.path.joint_points import JointPoints
from omniman_ros.motion.path.window import Window, paced_window
from omniman_ros.nodes.trajectory_interfaces.motion_context import MIN_PLANNING_TIME, MotionContext
from omniman_ros.nodes.trajectory_interfaces.motion_log import MotionLog
from omniman_ros.nodes.trajectory_interfaces.motion_outputs import ArmOutput

PLANNING_TIME_PER_POINT = 1e-3
"""Planning time that is expected for each point of a trajectory [s]."""


class JointInterface(ABC):
    """Connects a `JointInterpolator` to the messages of the node.

    Args:
        context: Services of the node.
        core: Interpolator of the axes.
        output: Where the motions are sent.

    Attributes:
        core: Interpolator of the axes.
        log: What happens to the motions.
        output: Where the motions are sent.
        status: Latest event.
    """

    def __init__(self, context: MotionContext, core: JointInterpolator, output: ArmOutput) -> None:
        self._context, self._node = context, context.node
        self.core, self.output = core, output
        self.log = MotionLog(self._node, "trajectory")
        self.status = self.log.status

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes."""
        return self.core.planner.limits.names

    @property
    def idle(self) -> bool:
        """Whether no motion is under way."""
        return self.core.state is PathState.IDLE

    # ---- to be implemented by each interface ---------------------------------------------------

    @abstractmethod
    def trajectory(self, message: JointTrajectory) -> str:
        """Start a trajectory, or let it wait; return why it is refused, or an empty string.

        Raises:
            InputError: The trajectory cannot be used.
        """

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
        """Return the references of the instant at which :meth:`actual` was measured.

        Returns:
            Positions, velocities and accelerations (d,); None while no motion is under way.
        """
        return None if self.idle else self._desired_at(self._context.arm_feed.time)

    def _desired_at(self, time: float) -> tuple[Array, Array, Array]:
        pace = self._context.time_base.pace
        window = paced_window(pace, self.core.sample, np.array([time]))
        return window.positions[0], window.velocities[0], window.accelerations[0]

    # ---- requests -----------------------------------------------------------------------------

    def points(self, message: JointTrajectory) -> JointPoints:
        """Convert the points of a trajectory of these axes.

        Raises:
            InputError: The points cannot be used.
        """
        max_points = self._context.options.joint_trajectory.max_points
        return arm_conversions.joint_points(message, self.names, max_points)

    def stop(self) -> None:
        """Bring the motion to rest on its path, as a trajectory without points asks for."""
        if not self.idle:
            self.core.cancel(self._context.time_base.now())

    def start(self, points: JointPoints, delay: float | None) -> None:
        """Plan a trajectory and start it after a delay [s], or at once if it is None.

        Raises:
            InputError: The trajectory cannot be driven from here.
        """
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

    def _announce(self, text: str) -> None:
        self.log.announce(text)
        self._context.on_started()

    # ---- supervision --------------------------------------------------------------------------

    def give_up(self, why: str, *, brake: bool) -> None:
        """End the motion under way; the axes come to rest.

        Args:
            why: Reason, in words.
            brake: Whether to send a last preview that leads to rest on the path. Receivers that
                are stopped come to rest by themselves, as do those that have run out of
                references, which would start again.
        """
        if self.idle:
            return
        now = self._node.now()
        window = self._stop_window(now) if brake and self.output.is_covered(now) else None
        self.core.abort()
        self.log.give_up(why)
        if window is not None:
            self.output.send(window)
        self.output.give_up()

    def _stop_window(self, now: float) -> Window | None:
        return self.core.paced_stop_window(now, self._context.time_base.pace)

    # ---- output -------------------------------------------------------------------------------

    def tick(self) -> None:
        """Publish the next preview, and report the end of the motion."""
        before, time_base = self.core.state, self._context.time_base
        if before is PathState.IDLE:
            return
        self.publish(self._context.options.horizon)
        if self.idle:
            return  # given up, which has been reported
        motion_time = time_base.now()
        self.core.update(motion_time)
        if self.core.state is PathState.CANCELLING and time_base.pace.stands(self._node.now()):
            self.core.abort()
        if self.idle:
            self.log.end(cancelled=before is PathState.CANCELLING)
            self.output.end()

    def publish(self, horizon: float) -> None:
        """Publish a preview of the motion under way that is `horizon` long [s]."""
        if not self.idle:
            time_base = self._context.time_base
            times = time_base.sample_times(horizon)
            self.output.send(paced_window(time_base.pace, self.core.sample, times))
