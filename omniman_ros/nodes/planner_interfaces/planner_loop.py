"""Drives of the node, from the request of a goal until the robot is at rest."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from omniman_ros.core.errors import InputError
from omniman_ros.core.stamps import TIME_JUMP
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.motion_log import (
    LoggedMotion,
    MotionEvent,
    MotionEvents,
    MotionInput,
    PendingMotion,
)
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.planner_interfaces.goal_anchor import GoalAnchor, PlacedGoal
from omniman_ros.nodes.planner_interfaces.motion_publisher import MotionPublisher, PlanPublisher
from omniman_ros.nodes.planner_interfaces.sensor_interface import (
    ArmConfigurationInterface,
    SensorInterface,
)
from omniman_ros.planning.cycle import MeasuredState, PlannerState

if TYPE_CHECKING:  # needs casadi, which is optional
    from omniman_ros.planning.planner import Planner


class PlannerLoop:
    """Serves requests, supervises the drive, and runs one planning cycle per tick.

    Attributes:
        goals: Log of the goals.
        silence: Why the surroundings, the arm's posture or the goal's place in odom are not known,
            while the robot waits for them, or empty.
        solve_time: Duration of the last planning [s]; NaN before the first.
    """

    def __init__(
        self,
        node: OmnimanNode,
        planner: "Planner",
        anchor: GoalAnchor,
        sensors: SensorInterface,
        posture: ArmConfigurationInterface,
        publisher: MotionPublisher,
        plans: PlanPublisher,
        monitor: StreamMonitor,
    ) -> None:
        self._node, self._planner, self._anchor = node, planner, anchor
        self._sensors, self._posture, self._monitor = sensors, posture, monitor
        self._publisher, self._plans = publisher, plans
        self.goals, self._is_closed = MotionEvents(node).log(MotionInput.GOAL), False
        self._pending = PendingMotion(
            node, monitor, self.goals, self._blocking_reason, conflict=lambda: ""
        )
        self._end: MotionEvent | None = None  # of the goal whose motion is coming to rest
        self.silence, self.solve_time = "", math.nan
        self._last_tick = node.now()

    @property
    def is_moving(self) -> bool:
        """Whether there is a goal to drive to, or the motion is not over."""
        return self._planner.active or self._planner.motion.end > self._node.now()

    def submit(self, motion: LoggedMotion, make_goal: Callable[[], PlacedGoal]) -> str:
        """Drive to a goal as soon as possible; return or raise why it is refused."""
        try:
            if self._is_closed:
                raise InputError("the node is shutting down")
            goal = make_goal()
        except InputError as error:
            self.goals.refuse(motion, str(error))
            raise
        self._sensors.obstacles.dismiss_silent_source()
        return self._pending.accept(motion, lambda: self._start(motion, goal))

    def _blocking_reason(self) -> str:
        """Return why no goal can be driven to yet, or an empty string."""
        now = self._node.now()
        fault = self._sensors.odom_fault(now)
        if fault:
            return fault
        if self._monitor.waiting_time(now) > 0.0:
            return "control was lost a moment ago"
        return self._silence_reason(now)

    def _start(self, motion: LoggedMotion, goal: PlacedGoal) -> None:
        measured = self._sensors.measured
        assert measured is not None
        self._planner.footprint = self._posture.footprint(self._node.now())
        self._anchor.drive(goal, measured, self._sensors.obstacles.ellipses())
        self.goals.start(motion)
        self.silence, self._end = "", None

    def pause(self) -> str:
        """Bring the robot to rest and keep the goal; return any reason for refusal, or ""."""
        if not self._planner.active:
            return f"nothing to pause: {self._planner.state.value}"
        self.silence = ""
        now = self._node.now()
        self._planner.pause(now)
        self.goals.note(MotionEvent.PAUSED)
        self._publisher.send(now)
        return ""

    def resume(self) -> str:
        """Drive on after a pause; return any reason for refusal, or ""."""
        measured = self._sensors.measured
        if measured is None or not self._planner.resume(measured):
            return f"nothing to resume: {self._planner.state.value}"
        self.goals.note(MotionEvent.RESUMED)
        return ""

    def cancel(self) -> str:
        """Bring the robot to rest and discard the goal; return any reason for refusal, or ""."""
        if not self._pending and self._planner.goal is None:
            return f"nothing to cancel: {self._planner.state.value}"
        self._pending.discard()
        self._brake_for_good(MotionEvent.CANCELLED)
        return ""

    def begin_shutdown(self) -> None:
        """Bring the robot to rest, and accept no other goal."""
        self._is_closed = True
        self._pending.discard()
        if self._planner.goal is not None:
            self._brake_for_good(MotionEvent.CANCELLED)

    def give_up_if_lost(self) -> None:
        """Give the goal up if the robot does not follow this planner any more."""
        reason = self._monitor.loss_reason(self._node.now())
        if not reason and self._planner.goal is not None:  # without a goal nothing is followed
            reason = self._monitor.blocking_reason
        if reason:
            self._give_up(reason)

    def _give_up(self, reason: str) -> None:
        """Discard goal and motion: nothing more is sent."""
        self._log_given_up(reason)
        self._planner.abort(self._node.now() - 1.0, self._sensors.measured)  # ended 1 s ago
        self._publisher.stop()
        self._monitor.end(lost=True)

    def _log_given_up(self, reason: str) -> None:
        self.silence = ""
        if self._planner.goal is not None:
            self.goals.note(MotionEvent.GIVEN_UP, reason)

    def _brake_for_good(self, end: MotionEvent | None = None) -> None:
        """Bring the robot to rest without a goal, which ends so if it has not ended."""
        self.silence, self._end = "", end
        now = self._node.now()
        self._planner.cancel(now)
        self._publisher.send(now)
        self._tell_end()

    def _tell_end(self) -> None:
        """Record the end of a goal once the robot is at rest."""
        if self._end is not None and not self.is_moving:
            self.goals.note(self._end)
            self._end = None

    def tick(self) -> None:
        """Supervise the drive, start the goal that waits, and run one planning cycle."""
        now = self._node.now()
        elapsed, self._last_tick = now - self._last_tick, now
        if elapsed < -TIME_JUMP:
            self._restart(now)
        self.give_up_if_lost()
        self._planner.footprint = self._posture.footprint(now)
        self._sensors.update_map()
        refusal = self._pending.start()
        if refusal:
            self._node.warn("goal refused", f"goal not used: {refusal}")
        measured, fault = self._sensors.measured, self._sensors.odom_fault(now)
        if not self._planner.active or measured is None:
            self._coast(now)
        elif fault:
            self._log_given_up(fault)
            self._brake_for_good()
        else:
            self._plan(now, measured)
        self._tell_end()

    def _silence_reason(self, now: float) -> str:
        """Return why the surroundings or the arm's posture are not known, or an empty string."""
        posture = self._posture.silence_reason(now)
        return self._sensors.blind_reason() or posture

    def _plan(self, now: float, measured: MeasuredState) -> None:
        """Plan towards the goal, check the plan and send it; brake while something is unknown."""
        planner = self._planner
        silence = self._silence_reason(now) or self._anchor.silence_reason()
        obstacles = self._sensors.obstacles.ellipses()
        if silence:
            if not self.silence:
                planner.brake(now)
            self.silence = silence
            self.goals.note(MotionEvent.PAUSED, silence)
            self._node.warn("silent", f"the robot stops: {silence}")
            self._publisher.send(now)
            return
        self.silence = ""
        self.goals.note(MotionEvent.RESUMED)
        self._anchor.update(now, obstacles)
        proposal = planner.propose(now, measured, obstacles)
        done = self._node.now()
        self.solve_time = done - now
        planner.take(proposal, done, measured, obstacles)
        if planner.report.reason:
            self._node.warn("plan", f"last plan not used: {planner.report.reason}")
        if planner.state is PlannerState.ARRIVED:
            self._end = MotionEvent.ARRIVED
        self._publisher.send(done)
        self._plans.publish(done, obstacles)
        planner.update_route(done, obstacles)

    def _coast(self, now: float) -> None:
        """Finish a motion without a goal, still watching the obstacles."""
        measured = self._sensors.measured
        if self._planner.motion.end > now and measured is not None:
            if self._silence_reason(now):
                self._planner.brake(now)
            else:
                self._planner.coast(now, measured, self._sensors.obstacles.ellipses())
        self._publisher.send(now)

    def _restart(self, now: float) -> None:
        """Discard everything that was received, because time went back."""
        self._give_up("time went back")
        self._monitor.restart(now)
        self._sensors.measured = None
        self._posture.forget()
        self._pending.restart_timeout()
