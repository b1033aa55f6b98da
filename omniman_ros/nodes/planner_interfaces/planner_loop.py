"""Drives of the node, from the request of a goal until the robot is at rest."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from omniman_ros.core.errors import InputError
from omniman_ros.core.pending_start import PendingStart, StartState
from omniman_ros.core.stamps import TIME_JUMP
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.motion_ledger import MotionLedger
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.planner_interfaces.goal_anchor import GoalAnchor, PlacedGoal
from omniman_ros.nodes.planner_interfaces.motion_publisher import MotionPublisher, PlanPublisher
from omniman_ros.nodes.planner_interfaces.sensor_interface import (
    ArmConfigurationInterface,
    SensorInterface,
)
from omniman_ros.planning.cycle import GoalOutcome, MeasuredState, PlannerState

if TYPE_CHECKING:  # needs casadi, which is optional
    from omniman_ros.planning.planner import Planner

#: Outcomes of which the status warns
_TROUBLE = (GoalOutcome.WAITING, GoalOutcome.REFUSED, GoalOutcome.GIVEN_UP)


class GoalLog:
    """Outcome of the latest goal, the outcomes of goals by their numbers, and counts of goals."""

    def __init__(self) -> None:
        self.outcome, self.text = GoalOutcome.NONE, "no goal yet"
        self.accepted = self.refused = 0
        self._ledger = MotionLedger()
        self._waiting = self._driven = 0

    @property
    def is_trouble(self) -> bool:
        """Whether the status warns of the outcome while there is no goal."""
        return self.outcome in _TROUBLE

    @property
    def latest(self) -> int:
        """Number of the latest goal that could be used; 0 before the first."""
        return self._ledger.accepted

    @property
    def has_goal(self) -> bool:
        """Whether a goal waits or is driven to."""
        return bool(self._waiting or self._driven)

    def outcome_of(self, goal: int) -> str | None:
        """Return why a goal ended: empty if it was reached; None while it has not ended."""
        return None if goal in (self._waiting, self._driven) else self._ledger.outcome(goal)

    def receive(self) -> None:
        """Number a goal that can be used; it waits from now on."""
        self._ledger.accept()
        self._waiting = self._close(self._waiting, "replaced by a new goal") or self.latest

    def wait(self, reason: str) -> None:
        """Record that the goal waits."""
        self.outcome, self.text = GoalOutcome.WAITING, f"a goal waits: {reason}"

    def accept(self) -> None:
        """Record that the goal that waited is driven to from now on."""
        self.outcome, self.text = GoalOutcome.ACCEPTED, ""
        self.accepted += 1
        self._close(self._driven, "replaced by a new goal")
        self._driven, self._waiting = self._waiting, 0

    def reject(self, reason: str) -> None:
        """Record that a goal could not be used; the others stay as they are."""
        self.outcome, self.text = GoalOutcome.REFUSED, f"a goal was refused: {reason}"
        self.refused += 1

    def refuse(self, reason: str) -> None:
        """Record that the goal that waited was refused."""
        self.reject(reason)
        self._waiting = self._close(self._waiting, reason)

    def give_up(self, reason: str) -> None:
        """Record that the goal was given up."""
        self.outcome, self.text = GoalOutcome.GIVEN_UP, f"the goal was given up: {reason}"
        self._driven = self._close(self._driven, reason)

    def cancel(self) -> None:
        """Record that the goal was cancelled, and any that waited."""
        self.outcome, self.text = GoalOutcome.CANCELLED, "cancelled"
        self._waiting = self._close(self._waiting, self.text)
        self._driven = self._close(self._driven, self.text)

    def arrive(self) -> None:
        """Record that the goal was reached."""
        self.outcome, self.text = GoalOutcome.ARRIVED, "arrived"
        self._driven = self._close(self._driven, "")

    def reject_plan(self, reason: str) -> None:
        """Record that the last plan to the accepted goal was not used."""
        self.outcome, self.text = GoalOutcome.ACCEPTED, f"last plan not used: {reason}"

    def _close(self, goal: int, outcome: str) -> int:
        """Record how a goal ended, if there is one; return 0, the number of no goal."""
        if goal:
            self._ledger.close(outcome, goal)
        return 0


class PlannerLoop:
    """Serves requests, supervises the drive, and runs one planning cycle per tick.

    Attributes:
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
        self._publisher, self._plans, self.goals = publisher, plans, GoalLog()
        self._pending, self._is_closed = PendingStart(node.now, monitor), False
        self.silence, self.solve_time = "", math.nan
        self._last_tick = node.now()

    @property
    def is_moving(self) -> bool:
        """Whether there is a goal to drive to, or the motion is not over."""
        return self._planner.active or self._planner.motion.end > self._node.now()

    def submit(self, make_goal: Callable[[], PlacedGoal]) -> str:
        """Drive to a goal as soon as possible; return or raise why it is refused."""
        try:
            if self._is_closed:
                raise InputError("the node is shutting down")
            goal = make_goal()
        except InputError as error:
            self.goals.reject(str(error))
            raise
        self._sensors.obstacles.dismiss_silent_source()
        self.goals.receive()
        self._pending.put(lambda: self._start(goal))
        return self._attempt()

    def _attempt(self) -> str:
        """Start the goal that waits if the robot is ready; return why it is refused, or ""."""
        attempt = self._pending.attempt(self._monitor.blocking_reason, self._blocking_reason)
        if attempt.state is StartState.WAITING:
            self.goals.wait(attempt.reason)
        elif attempt.state is StartState.REFUSED:
            self.goals.refuse(attempt.reason)
        elif attempt.state is StartState.STARTED:
            self.goals.accept()
            self._node.get_logger().info("goal accepted")
            self.silence = ""
        return attempt.refusal

    def _blocking_reason(self) -> str:
        """Return why no goal can be driven to yet, or an empty string."""
        now = self._node.now()
        fault = self._sensors.odom_fault(now)
        if fault:
            return fault
        if self._monitor.waiting_time(now) > 0.0:
            return "control was lost a moment ago"
        return self._silence_reason(now)

    def _start(self, goal: PlacedGoal) -> None:
        measured = self._sensors.measured
        assert measured is not None
        self._planner.footprint = self._posture.footprint(self._node.now())
        self._anchor.drive(goal, measured, self._sensors.obstacles.ellipses())

    def pause(self) -> str:
        """Bring the robot to rest and keep the goal; return any reason for refusal, or ""."""
        if not self._planner.active:
            return f"nothing to pause: {self._planner.state.value}"
        self.silence = ""
        now = self._node.now()
        self._planner.pause(now)
        self._publisher.send(now)
        return ""

    def resume(self) -> str:
        """Drive on after a pause; return any reason for refusal, or ""."""
        measured = self._sensors.measured
        if measured is None or not self._planner.resume(measured):
            return f"nothing to resume: {self._planner.state.value}"
        return ""

    def cancel(self) -> str:
        """Bring the robot to rest and discard the goal; return any reason for refusal, or ""."""
        if not self._pending and self._planner.goal is None:
            return f"nothing to cancel: {self._planner.state.value}"
        self._pending.discard()
        self._brake_for_good()
        self.goals.cancel()
        return ""

    def begin_shutdown(self) -> None:
        """Bring the robot to rest, and accept no other goal."""
        self._is_closed = True
        self._pending.discard()
        if self._planner.goal is not None:
            self._brake_for_good()
        if self.goals.has_goal:
            self.goals.cancel()

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
            self.goals.give_up(reason)
            self._node.warn("given up", self.goals.text)

    def _brake_for_good(self) -> None:
        self.silence = ""
        now = self._node.now()
        self._planner.cancel(now)
        self._publisher.send(now)

    def tick(self) -> None:
        """Supervise the drive, start the goal that waits, and run one planning cycle."""
        now = self._node.now()
        elapsed, self._last_tick = now - self._last_tick, now
        if elapsed < -TIME_JUMP:
            self._restart(now)
        self.give_up_if_lost()
        self._planner.footprint = self._posture.footprint(now)
        self._sensors.update_map()
        refusal = self._attempt()
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
            self._node.warn("silent", f"the robot stops: {silence}")
            self._publisher.send(now)
            return
        self.silence = ""
        self._anchor.update(now, obstacles)
        proposal = planner.propose(now, measured, obstacles)
        done = self._node.now()
        self.solve_time = done - now
        planner.take(proposal, done, measured, obstacles)
        if planner.report.reason:
            self.goals.reject_plan(planner.report.reason)
            self._node.warn("plan", self.goals.text)
        if planner.state is PlannerState.ARRIVED:
            self.goals.arrive()
            self._node.get_logger().info("goal reached")
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
