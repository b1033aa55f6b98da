"""Drives of the node, from the request of a goal until the robot is at rest."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from nav_msgs.msg import Path
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from omniman_ros.conversions.obstacles import ellipse_markers
from omniman_ros.conversions.poses import path_message
from omniman_ros.conversions.trajectories import preview_message
from omniman_ros.core import se2
from omniman_ros.core.errors import InputError
from omniman_ros.core.rigid import PlanarPose
from omniman_ros.core.stamps import TIME_JUMP
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.motion_log import (
    LoggedMotion,
    MotionEvent,
    MotionEvents,
    MotionInput,
    PendingMotion,
)
from omniman_ros.nodes.mpc_planner.inputs import (
    ArmConfigurationInterface,
    PlannerInputs,
)
from omniman_ros.nodes.mpc_planner.parameters import MpcPlannerParameters
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.planning.cycle import MeasuredState, PlannerState
from omniman_ros.planning.goals import Goal
from omniman_ros.surroundings.ellipses import Ellipses

if TYPE_CHECKING:  # needs casadi, which is optional
    from omniman_ros.planning.planner import Planner


LEAST_SHIFT = 5e-4  #: Distance by which a goal must have moved to be moved for the planner [m]
MIN_ROTATION = 5e-4  #: Angle by which a goal must have turned to be turned for the planner [rad]


@dataclass(frozen=True)
class PlacedGoal:
    """A goal in a frame that does not move with the robot."""

    frame: str  #: The frame; empty for odom
    goal: Goal  #: Goal in that frame


class GoalAnchor:
    """Gives the planner goals in odom, and moves them when their frame moves against odom."""

    def __init__(self, planner: "Planner", frames: FrameTransforms) -> None:
        self._planner, self._frames = planner, frames
        self._frame = ""
        self._anchor: PlanarPose = (0.0, 0.0, 0.0)

    def drive(self, placed: PlacedGoal, measured: MeasuredState, obstacles: Ellipses) -> None:
        """Drive to a goal; raise InputError if it is occupied, or unknown in odom."""
        silence = self._frames.silence_reason(placed.frame)
        if silence:
            raise InputError(silence)
        anchor = self._frames.anchor(placed.frame).planar()
        self._planner.drive(placed.goal.displaced(anchor), measured, obstacles)
        self._frame, self._anchor = placed.frame, anchor

    def silence_reason(self) -> str:
        """Return why it is not known where the goal is in odom, or an empty string."""
        return "" if self._planner.goal is None else self._frames.silence_reason(self._frame)

    def update(self, now: float, obstacles: Ellipses) -> None:
        """Move the goal if its frame has moved against odom."""
        goal = self._planner.goal
        if goal is None or not self._frame:
            return
        anchor = self._frames.anchor(self._frame).planar()
        if anchor == self._anchor:
            return
        x, y, theta = goal.targets(np.array([now]))[0][0].tolist()
        dx, dy, turn = se2.displacement(self._anchor, anchor, (x, y, theta))
        if math.hypot(dx, dy) > LEAST_SHIFT or abs(turn) > MIN_ROTATION:
            change = se2.compose(anchor, se2.inverse(self._anchor))
            self._anchor = anchor
            self._planner.displace_goal(change, now, obstacles)


PREDICTION_TIMES = (0.5, 1.0, 1.5)  #: Times ahead at which predicted obstacles are shown [s]


class PlanPublisher:
    """Publishes `mpc/plan`, `mpc/route` and `mpc/predicted_obstacles`."""

    def __init__(self, node: OmnimanNode, frame: str, planner: "Planner") -> None:
        self._node, self._frame, self._planner = node, frame, planner
        self._plan = node.create_publisher(Path, "mpc/plan", 10)
        self._route = node.create_publisher(Path, "mpc/route", 10)
        self._predicted = node.create_publisher(MarkerArray, "mpc/predicted_obstacles", 10)

    def publish(self, now: float, obstacles: Ellipses) -> None:
        """Publish the plan, the route and the predicted obstacles from the time `now` [s] on."""
        stamp, motion = self._node.stamp(now), self._planner.motion
        if self._plan.get_subscription_count():
            part = motion.between(now, max(motion.end, now + 0.01))
            plan = path_message(part.poses, self._frame)
            plan.header.stamp = stamp
            self._plan.publish(plan)
        route_planner = self._planner.route_planner
        route = None if route_planner is None else route_planner.route
        if route is not None and self._route.get_subscription_count():
            message = path_message(route.poses, self._frame)
            message.header.stamp = stamp
            self._route.publish(message)
        if self._predicted.get_subscription_count():
            times = now + np.array(PREDICTION_TIMES)
            self._predicted.publish(ellipse_markers(obstacles, times, self._frame, stamp))


class MotionPublisher:
    """Publishes the motion of the planner as references or as motor voltages."""

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[MpcPlannerParameters],
        planner: "Planner",
        monitor: StreamMonitor,
    ) -> None:
        self._node, self._settings = node, settings
        self._planner, self._monitor = planner, monitor
        qos = QoSProfile(depth=1)
        self.reference = node.create_publisher(MultiDOFJointTrajectory, "mpc/reference", qos)
        self._voltages = node.create_publisher(JointState, "mpc/voltages", qos)
        self._sends_voltages = False

    def send(self, now: float) -> None:
        """Send the motion from now on, unless it is driven by voltages.

        The stream ends with its motion: it is no loss of control that the controller then releases
        the robot, which is at rest.
        """
        planner, motion = self._planner, self._planner.motion
        with_voltages = self._settings.value.output == "voltages"
        self._sends_voltages = (
            with_voltages and planner.active and planner.voltages(now) is not None
        )
        if motion.end <= now:
            self._monitor.end(lost=False)
            return
        if not self._sends_voltages:
            self._send_reference(now)

    def stop(self) -> None:
        """Send no more voltages until the next `send`."""
        self._sends_voltages = False

    def _send_reference(self, now: float) -> None:
        p, preview = self._settings.value, self._planner.preview
        # The preview lasts at least one period: one that ends in transit arrives stale.
        part = preview.between(now, max(preview.end, now + p.period))
        message = preview_message(
            p.frames.odom.odom_frame,
            self._node.stamp(now),
            part.times,
            part.poses,
            part.velocities,
        )
        self.reference.publish(message)
        self._note_sent(now)

    def send_voltages(self) -> None:
        """Send the present voltages if the motion is driven by voltages."""
        if not self._sends_voltages:
            return
        now, p = self._node.now(), self._settings.value
        volts = self._planner.voltages(now + 0.5 * p.voltages_period)
        if volts is None:
            self.send(now)
            return
        message = JointState(name=list(p.core.robot.wheels.names))
        message.header.stamp = self._node.stamp(now)
        message.effort = volts.tolist()
        self._voltages.publish(message)
        self._note_sent(now)

    def _note_sent(self, now: float) -> None:
        self._monitor.begin(now)
        self._monitor.sent(now)


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
        inputs: PlannerInputs,
        posture: ArmConfigurationInterface,
        publisher: MotionPublisher,
        plans: PlanPublisher,
        monitor: StreamMonitor,
    ) -> None:
        self._node, self._planner, self._anchor = node, planner, anchor
        self._inputs, self._posture, self._monitor = inputs, posture, monitor
        self._publisher, self._plans = publisher, plans
        self._events, self._is_closed = MotionEvents(node), False
        self.goals = self._events.log(MotionInput.GOAL)
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
        if motion.outcome is not None:  # cancelled while it waited for its frame
            return ""
        for other in (self._pending.motion, self.goals.driven):
            if other is not None and other.number > motion.number:
                raise self.goals.refuse(motion, "a newer goal came")
        try:
            if self._is_closed:
                raise InputError("the node is shutting down")
            goal = make_goal()
        except InputError as error:
            self.goals.refuse(motion, str(error))
            raise
        self._inputs.surroundings.obstacles.dismiss_silent_source()
        return self._pending.accept(motion, lambda: self._start(motion, goal))

    def _blocking_reason(self) -> str:
        """Return why no goal can be driven to yet, or an empty string."""
        now = self._node.now()
        fault = self._inputs.odom_fault(now)
        if fault:
            return fault
        if self._monitor.waiting_time(now) > 0.0:
            return "control was lost a moment ago"
        return self._silence_reason(now)

    def _start(self, motion: LoggedMotion, goal: PlacedGoal) -> None:
        measured = self._inputs.measured
        assert measured is not None
        self._planner.footprint = self._posture.footprint(self._node.now())
        self._anchor.drive(goal, measured, self._inputs.surroundings.obstacles.ellipses())
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
        measured = self._inputs.measured
        if measured is None or not self._planner.resume(measured):
            return f"nothing to resume: {self._planner.state.value}"
        self.goals.note(MotionEvent.RESUMED)
        return ""

    def cancel(self) -> str:
        """Bring the robot to rest and discard the goal; return any reason for refusal, or ""."""
        was_waiting = self._events.cancel_received()
        if not self._pending and self._planner.goal is None:
            return "" if was_waiting else f"nothing to cancel: {self._planner.state.value}"
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
        self._planner.abort(self._node.now() - 1.0, self._inputs.measured)  # ended 1 s ago
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
        self._inputs.update_map()
        refusal = self._pending.start()
        if refusal:
            self._node.warn("goal refused", f"goal not used: {refusal}")
        measured, fault = self._inputs.measured, self._inputs.odom_fault(now)
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
        return self._inputs.surroundings.blind_reason() or posture

    def _plan(self, now: float, measured: MeasuredState) -> None:
        """Plan towards the goal, check the plan and send it; brake while something is unknown."""
        planner = self._planner
        silence = self._silence_reason(now) or self._anchor.silence_reason()
        obstacles = self._inputs.surroundings.obstacles.ellipses()
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
        measured = self._inputs.measured
        if self._planner.motion.end > now and measured is not None:
            if self._silence_reason(now):
                self._planner.brake(now)
            else:
                self._planner.coast(now, measured, self._inputs.surroundings.obstacles.ellipses())
        self._publisher.send(now)

    def _restart(self, now: float) -> None:
        """Discard everything that was received, because time went back."""
        self._give_up("time went back")
        self._monitor.restart(now)
        self._inputs.measured = None
        self._posture.forget()
        self._pending.restart_timeout()
