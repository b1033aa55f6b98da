"""Goal and start, the cases, and the restart."""

from collections import deque

import numpy as np
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped

from omniman_ros import conversions
from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.core.robot import Body
from omniman_ros.nodes.runtime import OmnimanNode
from omniman_ros.nodes.viewing.calls import CallPort
from omniman_ros.nodes.viewing.crowd_port import CrowdPort
from omniman_ros.nodes.viewing.ears import Ears
from omniman_ros.nodes.viewing.placing import Placing, Step
from omniman_ros.nodes.viewing.planner_senses import PlannerSenses
from omniman_ros.nodes.viewing.robot_senses import RobotSenses
from omniman_ros.planning.cases import CASES
from omniman_ros.viewer.events import CaseChosen, GoalDragged, StartDragged
from omniman_ros.viewer.state import Picture, Pose

DRAGGING = 0.2
"""Shortest time between two goals while one is dragged [s]."""
AT_REST = 0.02
"""Speed below which the robot stands [m/s, rad/s]."""
STANDING = ("", "none", "stop")
"""What `active_source` says while nothing drives."""
OURS = 20
"""Goals of ours that are known again when they are heard."""


class Places:
    """Outputs `goal_pose`, `initialpose` and `set_pose`.

    Args:
        node: Whose.
        picture: Shows goal and start.
        ears: The node's subscriptions.
        frames: Which are taken for odom; that of the goals first.
        robot, planner: What is heard.
        crowd: The obstacles of the page.
        calls: Cancels.
        body: What the cases are to fit.
    """

    def __init__(
        self, node: OmnimanNode, picture: Picture, ears: Ears, frames: tuple[str, ...],
        robot: RobotSenses, planner: PlannerSenses, crowd: CrowdPort, calls: CallPort, body: Body,
    ) -> None:  # fmt: skip
        self._node = node
        self._body = body
        self._picture = picture
        self._frames = frames
        self._robot, self._planner, self._crowd, self._calls = robot, planner, crowd, calls
        self._goals = node.create_publisher(PoseStamped, "goal_pose", 10)
        self._plant = node.create_publisher(PoseWithCovarianceStamped, "initialpose", 10)
        self._odometry = node.create_publisher(PoseWithCovarianceStamped, "set_pose", 10)
        self._ours: deque[tuple[float, ...]] = deque(maxlen=OURS)
        self._sent_at = -np.inf
        self._unsent = False
        self._start_stays = False
        self._placing: Placing | None = None
        self._goes = False
        ears.hear(PoseStamped, "goal_pose", self._on_goal, 10)

    # ---- goal ---------------------------------------------------------------------------------

    def drag_goal(self, event: GoalDragged, now: float) -> None:
        """Put the goal there; send it, unless all is held.

        Raises:
            InputError: It cannot be.
        """
        pose = _checked(event.pose, "goal")
        self._picture.goal = pose
        if self._crowd.crowd.held:
            self._unsent = True
            if event.done:
                self._picture.note = "the goal is placed; Go sends it"
        elif self._placing is not None:
            self._goes = self._goes or event.done
        elif event.done or (self._planner.driving and now - self._sent_at >= DRAGGING):
            self._send(pose, now)

    def go(self, now: float) -> None:
        """Send the goal as it lies, and let the obstacles go.

        Raises:
            InputError: There is none.
        """
        if self._picture.goal is None:
            raise InputError("there is no goal yet: drag one")
        if self._placing is not None:
            self._goes = True
            self._picture.note = "go: as soon as the robot is at the start"
            return
        self._crowd.crowd.go(now)
        self._send(self._picture.goal, now)

    def resume(self, now: float) -> None:
        """Let planner, path and obstacles go on; to another goal, if it was put elsewhere."""
        self._crowd.crowd.go(now)
        if self._unsent and self._planner.paused and self._picture.goal is not None:
            self._calls.ask("resume", now, of=("path_interpolator",), tell=False)
            self._send(self._picture.goal, now)
        else:
            self._calls.ask("resume", now)

    def pause(self, now: float) -> None:
        """Hold planner, path and obstacles."""
        self.give_up()
        self._crowd.crowd.hold(now)
        self._calls.ask("pause", now)

    def cancel(self, now: float) -> None:
        """Cancel path and planner, and what waits here."""
        self.give_up()
        self._calls.ask("cancel", now)

    def _send(self, pose: Pose, now: float) -> None:
        picture = self._picture
        if not (self._start_stays or self._planner.driving) and picture.odom is not None:
            picture.start = picture.odom
        self._start_stays = self._unsent = False
        message = PoseStamped()
        message.header.stamp, message.header.frame_id = self._node.stamp(), self._frames[0]
        message.pose.position.x, message.pose.position.y = pose[:2]
        message.pose.orientation = conversions.quaternion(pose[2])
        self._ours.append(_key(message))
        self._goals.publish(message)
        self._sent_at = now
        heard = picture.is_fresh("planner", now)
        picture.note = "goal sent" if heard else "goal sent; no mpc_planner is heard"

    def _on_goal(self, message: PoseStamped) -> None:
        """Show a goal of others; one of ours may come back while the next is dragged."""
        if _key(message) in self._ours:
            return
        x, y, theta = conversions.goal_pose(message, self._frames).tolist()
        picture = self._picture
        if not (self._start_stays or self._planner.driving) and picture.odom is not None:
            picture.start = picture.odom
        self._start_stays = self._unsent = False
        picture.goal = x, y, theta

    # ---- start --------------------------------------------------------------------------------

    def drag_start(self, event: StartDragged, now: float) -> None:
        """Put the start there when it is let go, and a simulated robot that stands.

        Raises:
            InputError: It cannot be, or the robot cannot be put there.
        """
        pose = _checked(event.pose, "start")
        if not event.done:
            return
        why = self._no_simulation(now) or self._unrest(now)
        if why:
            raise InputError(f"the start stays: {why}")
        self._picture.start, self._start_stays = pose, True
        self._placing = Placing(pose, now)
        self.step(now)

    def load(self, event: CaseChosen, now: float) -> None:
        """Have a case: start, goal, obstacles, and a simulated robot at the start; all held.

        Raises:
            InputError: There is none of that name.
        """
        case = CASES.get(event.name)
        if case is None:
            raise InputError(f"there is no case '{event.name[:40]}': {', '.join(CASES)}")
        case = case.fitting(self._body.length, self._body.width)
        self._crowd.load(case, now)
        self._picture.start, self._picture.goal = case.start, case.goal
        self._picture.case = case.name
        self._begin_again(f"case {case.name}", now)

    def restart(self, now: float) -> None:
        """Cancel, bring the obstacles to their beginnings and a simulated robot to the start."""
        self._crowd.crowd.hold(now)
        self._crowd.crowd.restart(now)
        self._begin_again("restart", now)

    def _begin_again(self, what: str, now: float) -> None:
        self._unsent = self._start_stays = True
        self._placing, self._goes = None, False
        self._calls.ask("cancel", now, tell=False)
        self._clear_trails()
        why = "there is no start yet" if self._picture.start is None else self._no_simulation(now)
        if not why and self._picture.start is not None:
            self._placing = Placing(self._picture.start, now)
        stays = f"; the robot stays: {why}" if why else ""
        self._picture.note = f"{what}: held until Go{stays}"

    def step(self, now: float) -> None:
        """Go on with placing the robot; call it once a period."""
        if self._placing is None:
            return
        standing = self._calls.answered and not self._unrest(now)
        odom = self._picture.odom if self._picture.is_fresh("odom", now) else None
        step = self._placing.step(standing, odom, now)
        if step is Step.PLACE:
            self._place(self._placing.pose)
        elif step is not Step.WAIT:
            goes = self._goes
            self.give_up()
            self._clear_trails()
            if step is not Step.DONE:
                self._picture.note = f"the robot is not at the start: {step.value}"
            elif goes:
                self.go(now)

    def start_over(self) -> None:
        """Time went back: what waits is given up, and a goal may be sent at once."""
        self.give_up()
        self._sent_at = -np.inf

    def give_up(self) -> None:
        """Place nothing, and send nothing, that waits."""
        self._placing, self._goes = None, False

    def _place(self, pose: Pose) -> None:
        message = PoseWithCovarianceStamped()
        message.pose.pose.position.x, message.pose.pose.position.y = pose[:2]
        message.pose.pose.orientation = conversions.quaternion(pose[2])
        message.header.stamp = self._node.stamp()
        message.header.frame_id = self._robot.truth_frame
        self._plant.publish(message)
        message.header.frame_id = self._frames[0]
        self._odometry.publish(message)

    def _no_simulation(self, now: float) -> str:
        """Why the robot cannot be put elsewhere, or an empty string."""
        simulated = self._picture.is_fresh("truth", now) and self._plant.get_subscription_count()
        return "" if simulated else "only a simulated robot can be put elsewhere"

    def _unrest(self, now: float) -> str:
        """Why the robot is not at rest, or an empty string."""
        source = self._picture.active_source
        if source not in STANDING:
            return f"{source} drives"
        speeds = [
            speed
            for name, speed in self._robot.speeds.items()
            if self._picture.is_fresh(name, now)
        ]
        return "the robot moves" if max(speeds, default=0.0) > AT_REST else ""

    def _clear_trails(self) -> None:
        self._picture.odom_trail.clear()
        self._picture.truth_trail.clear()


def _key(message: PoseStamped) -> tuple[float, ...]:
    place, turn = message.pose.position, message.pose.orientation
    return place.x, place.y, turn.z, turn.w


def _checked(pose: Pose, what: str) -> Pose:
    plausible.demand(np.array(pose[:2]), plausible.LENGTH, f"{what}: position")
    plausible.demand(np.array(pose[2:]), plausible.ANGLE, f"{what}: heading")
    x, y, theta = (float(value) for value in pose)
    return x, y, theta
