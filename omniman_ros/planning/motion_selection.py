"""Selection of the motion to follow: the new plan, the rest of the last motion, or braking."""

import math
from dataclasses import dataclass, replace

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.planning.cycle import AT_REST, CycleReport, MeasuredState
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.motion_choice import (
    HISTORY_TIME,
    PREVIEW_DURATION,
    MotionChoice,
    MotionChooser,
    rest_of,
)
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.mpc.solver import Solution
from omniman_ros.planning.safety import Surroundings

#: Distance from the motion above which plans begin at the measured pose of the robot [m]
REPLAN_POSITION_ERROR = 0.15
#: Heading error above which plans begin at the measured pose of the robot [rad]
REPLAN_HEADING_ERROR = 0.2
BRAKINGS = 5  #: Largest number of brakings of a motion that are checked in a cycle


@dataclass(frozen=True)
class PlanProposal:
    """Plans that may be used until they are due."""

    due: float  #: Time at which the plans begin [s]; if they are ready after that, they are late
    #: Solutions by preference: the improved last plan and, if that is unsatisfactory, another one
    solutions: tuple[Solution, ...] = ()
    fault: str = ""  #: Reason why there is no plan, or an empty string


class MotionSelector:
    """Holds the motion that the robot follows, and replaces it by the best one available.

    Attributes:
        limits: Limits in effect; may be replaced at any time.
        motion: Motion to follow: it ends at rest and was checked up to its end.
    """

    def __init__(self, model: PlanningModel, limits: EffectiveLimits) -> None:
        self.model, self.limits = model, limits
        long_ago = -HISTORY_TIME
        self.motion = HermiteTrajectory.rest(long_ago, np.zeros(3), model.wheel_count)
        self.report = CycleReport()
        self._choice: MotionChoice | None = None
        self._shortened: tuple[HermiteTrajectory, HermiteTrajectory] | None = None

    # ---- the present motion -----------------------------------------------------------------

    @property
    def preview(self) -> HermiteTrajectory:
        """Motion to send: the beginning of the motion, then braking if that is clear, too.

        If the sender dies, the motion is no longer checked, and the robot should not continue to
        the end of a plan.
        """
        if self._shortened is not None and self._shortened[0] is self.motion:
            return self._shortened[1]
        return self.motion

    @property
    def is_troubled(self) -> bool:
        """Whether the last plan was not used, not clear, or overlaps what it must avoid."""
        report = self.report
        overlaps = report.slack > self.limits.parameters.safety.slack
        return not (report.used and report.clear) or overlaps

    def continuous_pose(self, measured: MeasuredState) -> Array:
        """Return the measured pose (3,), its heading on the branch of the motion.

        Odometry may wrap the heading.
        """
        heading = float(self.motion.sample(measured.time)[0][2])
        difference = se2.wrap(float(measured.pose[2]) - heading)
        return np.append(measured.pose[:2], heading + difference)

    def deviation(self, measured: MeasuredState, radius: float) -> float:
        """Return the largest distance of a point within a radius from where it should be [m]."""
        pose, _ = self.motion.sample(measured.time)
        error = measured.pose - pose
        heading_error = abs(se2.wrap(float(error[2])))
        return math.hypot(error[0], error[1]) + heading_error * radius

    def state_at(self, due: float, measured: MeasuredState, anchored: bool) -> Array:
        """Predict the state (6,) at which a plan begins at a time [s].

        An anchored plan begins on the motion unless the robot is too far from it; otherwise it
        begins at the measured pose of the robot. The state is pose in odom [m, m, rad] and body
        twist [m/s, m/s, rad/s].
        """
        pose, velocity = self.motion.sample(due)
        planned_pose, planned_velocity = self.motion.sample(measured.time)
        error = measured.pose - planned_pose
        error[2] = se2.wrap(error[2])
        too_far = (
            math.hypot(error[0], error[1]) > REPLAN_POSITION_ERROR
            or abs(error[2]) > REPLAN_HEADING_ERROR
        )
        if too_far or not anchored:
            pose = pose + error
            change = velocity - planned_velocity
            velocity = se2.to_world(float(measured.pose[2]), measured.twist) + change
        twist = se2.to_robot(float(pose[2]), velocity)
        return np.concatenate([pose, twist])

    # ---- without a plan ---------------------------------------------------------------------

    def begin(self, measured: MeasuredState) -> None:
        """Begin a motion at the pose and the velocity of the robot; it brakes at once."""
        velocity = se2.to_world(float(measured.pose[2]), measured.twist)
        slow = float(np.abs(velocity).max()) < AT_REST
        moving = HermiteTrajectory.coasting(
            measured.time,
            self.continuous_pose(measured),
            velocity * (not slow),
            self.model.wheel_count,
        )
        self.motion = moving.braked(measured.time, self.limits.decelerations)

    def brake(self, now: float) -> None:
        """Brake along the motion from a time [s] on."""
        if self.motion.end > now:
            self.motion = self._braked(now)

    def discard(self, now: float, measured: MeasuredState | None) -> None:
        """Replace the motion by rest at the measured pose, or else at the motion's end."""
        pose = self.motion.poses[-1] if measured is None else measured.pose
        self.motion = HermiteTrajectory.rest(now, pose, self.model.wheel_count)

    def _braked(self, now: float) -> HermiteTrajectory:
        rest = rest_of(self.motion, now)
        return rest.braked(max(now, rest.start), self.limits.decelerations)

    # ---- selection --------------------------------------------------------------------------

    def select(
        self,
        proposal: PlanProposal,
        now: float,
        surroundings: Surroundings,
        *,
        active: bool,
        in_crowd: bool,
    ) -> Solution | None:
        """Set the motion to the best one available, and report on it.

        Plans are only used if there is a goal to drive to: `active`; see `MotionChooser`. In a
        crowd, no motion with a contact is preferred to braking.

        Returns:
            Solution to warm-start the next optimisation from; None if the warm start is kept.
        """
        report = CycleReport(lateness=now - proposal.due, reason=proposal.fault)
        if proposal.solutions:
            first = proposal.solutions[0]
            report = replace(report, slack=float(first.slack.max()), cost=first.cost)
        plans, refusal = self._plans(proposal, report.lateness, now, active)
        chooser = MotionChooser(
            surroundings,
            self._brake,
            now,
            now,
            attempts=BRAKINGS,
            evades_contact=not in_crowd,
        )
        earliest = proposal.due + 0.5 * self.limits.parameters.horizon.step
        self._choice = choice = chooser.choose(plans, earliest, self.motion, self._choice)
        self.motion = choice.motion
        used = choice.plan is not None
        self.report = replace(
            report,
            used=used,
            reason="" if used else proposal.fault or refusal,
            braking=choice.is_braking,
            clear=choice.is_clear,
            time_to_contact=math.inf if choice.is_clear else choice.contact - now,
        )
        self._shorten(now, surroundings)
        return None if choice.plan is None else proposal.solutions[choice.plan]

    def _brake(self, motion: HermiteTrajectory, time: float) -> HermiteTrajectory:
        return motion.braked(time, self.limits.decelerations)

    def _plans(
        self, proposal: PlanProposal, lateness: float, now: float, active: bool
    ) -> tuple[list[HermiteTrajectory], str]:
        """Return the plans that may be used, and the reason to report if none of them is clear."""
        if not active:
            return [], "there is no goal any more"
        if not proposal.solutions:
            return [], ""
        if lateness > 0.0:
            return [], f"the answer came {1e3 * lateness:.0f} ms late"
        plans = [self._joined(proposal.due, solution, now) for solution in proposal.solutions]
        return plans, "the plan is not clear of contact"

    def _joined(self, due: float, solution: Solution, now: float) -> HermiteTrajectory:
        """Join the plan to the last motion, which is followed until the plan is due [s]."""
        step = self.limits.parameters.horizon.step
        plan = HermiteTrajectory.of_states(due, step, solution.states, solution.currents)
        begins = max(min(now, due) - HISTORY_TIME, self.motion.start)
        if begins > due - 1e-3:
            return plan
        before = self.motion.between(begins, due)
        offset = plan.poses[0] - before.poses[-1]  # zero unless it begins at the measured pose
        return replace(before, poses=before.poses + offset).then(plan)

    def _shorten(self, now: float, surroundings: Surroundings) -> None:
        """Prepare a preview that brakes after PREVIEW_DURATION, if that is clear."""
        self._shortened, soon = None, now + PREVIEW_DURATION
        if self.motion.end > soon:
            begins = max(self.motion.start, now - HISTORY_TIME)
            whole = self.motion.between(begins, self.motion.end)
            short = whole.braked(soon, self.limits.decelerations)
            if surroundings.contact(short, now) == math.inf:
                self._shortened = self.motion, short
