"""What trajectories of the arm and of the whole body have in common."""

from collections.abc import Callable

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory

from omniman_ros import arm_conversions
from omniman_ros.core.errors import InputError
from omniman_ros.core.path.axis_limits import AxisLimits
from omniman_ros.core.path.interpolator import PathState, Window
from omniman_ros.core.path.joint_interpolator import JointInterpolator, JointProposal
from omniman_ros.core.path.joint_points import JointPoints
from omniman_ros.nodes.motions.host import ATTEMPTS, PLANNING_LEAST, Host
from omniman_ros.nodes.motions.teller import Teller

Array = NDArray[np.float64]

PLANNING = 1e-3
"""Planning is expected to take less for each point [s]."""
LATE = 0.5
"""A stamp may be so old: the trajectory begins now [s]."""
REMEMBERED = 20
"""Ends of so many motions are remembered."""


class JointPort(Teller):
    """Message plumbing around `core.path.joint_interpolator.JointInterpolator`.

    Motions have numbers: an action, whose client waits for the end of one, asks by them.

    Args:
        host: The node.
        limits: Of the axes.

    Attributes:
        core: The interpolator.
    """

    def __init__(self, host: Host, limits: AxisLimits) -> None:
        self._host, self._node = host, host.node
        self.core = JointInterpolator(limits, host.options.joint_trajectory)
        self._last = "no trajectory yet"
        self._claimed = self._motion = 0
        self._outcomes: dict[int, str] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Of the axes."""
        return self.core.planner.limits.names

    @property
    def idle(self) -> bool:
        """Whether nothing is under way."""
        return self.core.state is PathState.IDLE

    # ---- what axes there are ------------------------------------------------------------------

    def here(self) -> Array:
        """Where (d,) the axes are at rest."""
        raise NotImplementedError

    def _send(self, window: Window) -> None:
        """Send a part of the stream."""
        raise NotImplementedError

    def _began(self, *, from_rest: bool) -> None:
        """A motion has begun."""
        raise NotImplementedError

    def _came_to_rest(self) -> None:
        """A motion has ended by itself."""
        raise NotImplementedError

    # ---- trajectories -------------------------------------------------------------------------

    def points(self, message: JointTrajectory) -> JointPoints:
        """Points of a trajectory of these axes.

        Raises:
            InputError: They cannot be used.
        """
        most = self._host.options.joint_trajectory.max_points
        return arm_conversions.joint_points(message, self.names, most)

    def refused(self, why: str, what: str = "trajectory") -> InputError:
        """Note that something was refused; returns the error."""
        self.last = f"a {what} was refused: {why}"
        return InputError(why)

    # ---- for actions --------------------------------------------------------------------------

    def send(self, message: JointTrajectory) -> int:
        """Begin a motion; returns its number.

        Raises:
            InputError: It is refused; what was under way goes on.
        """
        if self._host.ending:
            raise self.refused("the node ends")
        why = self.trajectory(message)
        if why:
            raise self.refused(why)
        return self._claimed

    def outcome(self, motion: int) -> str | None:
        """Why a motion has ended: empty where it arrived; None while it waits or goes on."""
        waits = motion == self._claimed != self._motion
        if (motion == self._motion and not self.idle) or (waits and self._waits()):
            return None
        return self._outcomes.get(motion, "refused")

    def cancel(self, motion: int) -> None:
        """Bring a motion to rest on its path; one that has ended is left alone."""
        if motion == self._motion and not self.idle:
            self.stop()
            self._host.begun()

    def desired(self) -> tuple[Array, Array, Array] | None:
        """Positions, velocities and accelerations (d,) of the motion under way.

        They are those of the instant at which :meth:`actual` was measured.
        """
        return None if self.idle else self._desired_at(self._host.arm_feed.time)

    def _desired_at(self, time: float) -> tuple[Array, Array, Array]:
        """The same at a time [s]."""
        paced = self._host.together.pace.sample(np.array([time]))
        x, v, a = paced.apply(*self.core.sample(paced.motion))
        return x[0], v[0], a[0]

    def actual(self) -> tuple[Array, Array] | None:
        """Measured positions and velocities (d,), if they are known."""
        raise NotImplementedError

    def _waits(self) -> bool:
        """Whether the motion that was sent last waits."""
        return False

    def _claim(self) -> None:
        """A trajectory that was understood gets its number."""
        self._claimed += 1

    def _over(self, outcome: str, motion: int | None = None) -> None:
        self._outcomes[self._motion if motion is None else motion] = outcome
        while len(self._outcomes) > REMEMBERED:
            del self._outcomes[min(self._outcomes)]

    # ---- requests -----------------------------------------------------------------------------

    def trajectory(self, message: JointTrajectory) -> str:
        """Begin a trajectory; returns why it cannot begin now.

        Raises:
            InputError: It cannot be used.
        """
        raise NotImplementedError

    def stop(self) -> None:
        """Obey a trajectory without points: it ends the one under way."""
        if not self.idle:
            self.core.cancel(self._host.together.now())

    def delay(self, stamp: Time) -> float | None:
        """Time until a stamp [s]; None: now.

        Raises:
            InputError: It is too old, or too far ahead.
        """
        if stamp.sec == 0 and stamp.nanosec == 0:
            return None
        now = self._node.get_clock().now().nanoseconds
        delay = float((stamp.sec * 1_000_000_000 + stamp.nanosec - now) * 1e-9)
        most = self._host.options.joint_trajectory.max_delay
        if delay < -LATE:
            raise InputError(f"the stamp is {-delay:.2f} s old")
        if delay > most:
            raise InputError(f"the stamp is {delay:.2f} s ahead, at most {most:g} s")
        return max(delay, 0.0)

    def begin(self, points: JointPoints, delay: float | None) -> None:
        """Plan a trajectory and begin it.

        Raises:
            InputError: It cannot be driven from here.
        """
        begun, together = self._node.now(), self._host.together

        def propose(lead: float) -> JointProposal:
            now = together.now()
            start = None if delay is None else max(together.pace.motion(begun + delay), now)
            return self.core.propose(points, self.here(), now, lead, start)

        proposal = self._take(propose, PLANNING_LEAST + PLANNING * len(points.positions))
        times = "its own" if points.times is not None else "computed"
        count, duration = len(points.positions), proposal.curve.duration
        self._announce(f"{count} points in {duration:.2f} s, times {times}")

    def _take(self, propose: Callable[[float], JointProposal], lead: float) -> JointProposal:
        """Take a proposal that is made in so much time [s], or in more."""
        from_rest = self.idle
        for _ in range(ATTEMPTS):
            self._host.cover(2.0 * lead + self._host.options.horizon)  # what covers the planning
            proposal = propose(lead)
            if self.core.take(proposal, self._host.together.now()):
                break
            lead *= 2.0
        else:
            raise InputError("it could not be planned in time; pause first")
        if not from_rest:
            self._over("replaced")
        self._motion = self._claimed
        self._began(from_rest=from_rest)
        return proposal

    def _announce(self, text: str) -> None:
        self.last = text
        self._node.get_logger().info(f"trajectory: {text}")
        self._host.begun()

    def give_up(self, why: str, *, brake: bool) -> None:
        """End the motion; the axes come to rest.

        Args:
            why: In words.
            brake: Whether a last preview leads them to rest on their path; the receivers do by
                themselves where they are stopped.
        """
        if self.idle:
            return
        self.last = f"the trajectory was given up: {why}"
        self._node.warn("trajectory given up", self.last)
        window = self._paced_stop(self._node.now()) if brake else None
        self.core.abort()
        self._over(self.last)
        self._host.arm_feed.held = None
        if window is not None:
            self._send(window)

    def _paced_stop(self, now: float) -> Window | None:
        pace = self._host.together.pace
        if pace.plain:
            return self.core.stop_window(now)
        # Slowed down already: the stop takes the same time in motion time, on the same path.
        window = self.core.stop_window(pace.motion(now))
        if window is None or pace.rate(now) <= 0.0:
            return None
        rate = pace.rate(now)
        times = now + (window.times - window.times[0]) / rate
        return Window(
            times, window.positions, window.velocities * rate, window.accelerations * rate**2
        )

    def look_at_arm(self) -> None:
        """Give up what cannot be followed by the arm."""
        if self.idle:
            return
        host, silent = self._host, self._host.arm_feed.silent
        if host.watch.stop:
            self.give_up(host.watch.stop, brake=False)
        elif self._node.now() > host.arm_previews.covered:
            self.give_up("no preview in time", brake=False)
        elif silent > host.options.joint_trajectory.states_timeout:
            self.give_up(f"no arm/joint_states for {silent:.2f} s", brake=True)

    def compare(self) -> None:
        """Give up where the arm is not where it was to be."""
        if not self.idle:
            off = self._host.arm_feed.off(self._host.options.joint_trajectory.following_error)
            if off:
                self.give_up(off, brake=True)

    # ---- output -------------------------------------------------------------------------------

    def tick(self) -> None:
        """Publish the next preview, and notice an end."""
        before, together = self.core.state, self._host.together
        if before is PathState.IDLE:
            return
        self.publish(self._host.options.horizon)
        if self.idle:
            return  # given up: that has been told
        motion = together.now()
        self.core.update(motion)
        if self.core.state is PathState.CANCELLING and together.pace.stands(self._node.now()):
            self.core.finish(motion)
        if self.idle:
            cancelled = before is PathState.CANCELLING
            self.last = "cancelled" if cancelled else "arrived"
            self._over("cancelled" if cancelled else "")
            self._came_to_rest()
            self._node.get_logger().info(f"trajectory: {self.last}")

    def publish(self, horizon: float) -> None:
        """Publish a preview that reaches so far [s]."""
        if not self.idle:
            times = self._host.together.sample_times(horizon)
            paced = self._host.together.pace.sample(times)
            self._send(Window(times, *paced.apply(*self.core.sample(paced.motion))))
