"""The show of the demo: twists, paths of platform and tool, a goal, faults and a stop."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Path
from numpy.typing import NDArray
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.duration import Duration
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import MarkerArray

from omniman_ros import conversions
from omniman_ros.cli import stop_leg, tool_leg
from omniman_ros.cli.crossing import GOAL, Crossing
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.figures import Pace, Triple, TwistPhase, twist_phases
from omniman_ros.cli.previews import twist_message
from omniman_ros.cli.progress import Progress
from omniman_ros.cli.recorder import LATCHED, Recorder
from omniman_ros.cli.score import (
    ArmMove,
    DrivenGoal,
    DrivenLeg,
    DrivenTwist,
    DrivenWithoutWheel,
    excuse,
)
from omniman_ros.cli.session import DISCOVERY, Session
from omniman_ros.cli.stop_leg import DrivenStop
from omniman_ros.cli.tool_leg import DrivenTool
from omniman_ros.core import se2
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.body.model import BodyModel
from omniman_ros.nodes.movers import Calls
from omniman_ros.studies.figure7 import Movement, movements

Array = NDArray[np.float64]

PLANTS = {
    "simulated": ("simulated_drive", "simulated_drive"),
    "can": ("simulated_can_drives", "can_bridge"),
}
"""Nodes that play faults, and that hear wheel commands, by what turns the wheels."""

TWIST_PERIOD = 0.02
PAUSE = 0.7
"""Rest between two parts [s]."""
SPACING = 0.02
"""Of the poses of a path [m]."""
LIMP, LOST_AT = 0.5, 0.15
"""Straights that are driven without a wheel [m], and where on the way it is lost."""
DRIVES = "driving"
"""What `wheel_health` says of a good wheel."""
ANSWER = 5.0
"""How long to wait for the answer of a service [s]."""
GOAL_PATIENCE = 30.0
"""How long the way to the goal may take [s]."""
RESET_PATIENCE = 10.0
"""How long a reset of all nodes may take [s]: the arm's controller powers its brakes."""
OBSERVED = 0.05
"""Period of the obstacles' observations [s]."""
ARM_POSES = (
    (0.6, -0.5, 0.9, -0.4, 0.4, 0.8),
    (-0.5, -0.2, 0.4, -0.8, -0.6, -0.7),
    (0.3, -0.7, 0.2, 0.5, 0.7, 0.4),
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
)
"""Where the arm goes on the path's movements, from where it was in the beginning [rad]."""
ARM_PATIENCE, ARM_THERE = 10.0, 0.005
"""How long the arm may take to be where it was sent [s], and how near is there [rad]."""
LATE, SLOWEST = 20.0, 0.1
"""A movement slower than this on the whole [s, m/s] will never be at its end."""


def pose_text(pose: Triple) -> str:
    """A pose for people; no minus sign on a zero."""
    x, y = (round(value, 2) + 0.0 for value in pose[:2])
    degrees = round(math.degrees(math.remainder(pose[2], math.tau)))
    return f"x {x:+.2f} m  y {y:+.2f} m  heading {degrees:+4d} deg"


def placed(poses: Array, origin: Triple) -> Array:
    """Poses (k, 3) that are seen from `origin`, in odom [m, m, rad]."""
    result: Array = poses @ se2.rotation(origin[2]) + np.array(origin)
    return result


def poses_along(movement: Movement, origin: Triple) -> Array:
    """Poses (k, 3) of a movement whose frame is at `origin` in odom [m, m, rad]."""
    steps = max(2, math.ceil(movement.length / SPACING))
    return placed(movement.at(np.linspace(0.0, movement.length, steps + 1))[0], origin)


@dataclass
class Driven:
    """What was driven, for the judgement."""

    twists: list[DrivenTwist] = field(default_factory=list)
    legs: list[DrivenLeg] = field(default_factory=list)
    arm: list[ArmMove] = field(default_factory=list)
    tool: DrivenTool | None = None
    goal: DrivenGoal | None = None
    without_wheel: DrivenWithoutWheel | None = None
    stop: DrivenStop | None = None


class Show:
    """Drives the robot and shows how far it is.

    Args:
        session: The ROS node.
        pace: How fast.
        progress: Where progress is shown.
        poll: Called many times a second; raises to end the show early.
        drive: What turns the wheels: "simulated", or "can" where that is behind a bus.
        arm: Whether there is an arm.
    """

    def __init__(
        self, session: Session, pace: Pace, progress: Progress, poll: Callable[[], None],
        drive: str = "simulated", arm: bool = True,
    ) -> None:  # fmt: skip
        plant, commanded = PLANTS[drive]
        self._session = session
        self._pace = pace
        self._progress = progress
        self._poll = poll
        self._twists = session.node.create_publisher(Twist, "cmd_vel", 1)
        self._paths = session.node.create_publisher(Path, "path", 10)
        self._with_arm = arm
        self._joints = session.node.create_publisher(JointTrajectory, "joint_trajectory", 10)
        self._tool_paths = session.node.create_publisher(Path, "tool_path", 10)
        self._goals = session.node.create_publisher(PoseStamped, "goal_pose", 10)
        self._obstacles = session.node.create_publisher(MarkerArray, "obstacles", 50)
        self._emergency = session.node.create_publisher(Bool, "emergency_stop", LATCHED)
        self._faults = session.node.create_client(SetParameters, f"{plant}/set_parameters")
        self._resets = [
            session.node.create_client(Trigger, f"{node}/reset")
            for node in (commanded, "platform_controller")
        ]
        self.recorder = Recorder(session.node)
        self.driven = Driven()
        self._stopping = False
        self._checked = time.monotonic()

    # ---- parts ------------------------------------------------------------------------------

    def meet(self) -> None:
        """Wait until everything that is published and listened to is there.

        Raises:
            CommandError: It is not in time.
        """
        self._progress.begin("starting")
        before = time.monotonic()
        if not self.wait(lambda: not self._absent(), DISCOVERY):
            raise CommandError(f"nothing heard within {DISCOVERY:g} s of {self._absent()}")
        self._progress.end(f"nodes up and talking after {time.monotonic() - before:.1f} s")

    def drive_twists(self) -> None:
        """Drive all parts that are twists; from here on it counts if the machine stands still."""
        self._checked, self.recorder.recording.stall = time.monotonic(), 0.0
        for phase in twist_phases(self._pace):
            self._drive_twist(phase)

    def follow_path(self) -> None:
        """Drive the path of CCTA 2017 Fig. 7 from where the robot is, movement by movement."""
        if not self.wait(lambda: self.recorder.active_source == "none", 5.0):
            raise CommandError(f"'{self.recorder.active_source}' still drives, expected none")
        origin = self._pose()
        home = np.array(self.recorder.recording.arm[-1][1:]) if self._with_arm else None
        for i, movement in enumerate(movements()):
            if home is not None:
                self._move_arm(home + np.array(ARM_POSES[i % len(ARM_POSES)]))
            self._follow(movement, poses_along(movement, origin))

    def _send_arm(self, goal: Array, duration: float = 0.0) -> None:
        """Send the arm somewhere, in a given time [s] or as fast as it may."""
        point = JointTrajectoryPoint(positions=goal.tolist())
        if duration:
            point.time_from_start = Duration(seconds=duration).to_msg()
        self._joints.publish(JointTrajectory(joint_names=list(UR_JOINTS), points=[point]))

    def _move_arm(self, goal: Array) -> None:
        """Send the arm somewhere; it moves while the platform does."""
        self._send_arm(goal)
        self.driven.arm.append(ArmMove(tuple(goal.tolist()), self._now()))

    def lead_tool(self, model: BodyModel) -> None:
        """Lead the tool along a path of several metres, platform and arm in step.

        Raises:
            CommandError: It was not taken, or given up.
        """
        self._progress.begin("arm made ready")
        self._move_arm(np.array(tool_leg.READY))
        if not self.wait(self._arm_is_ready, ARM_PATIENCE):
            raise CommandError("the arm does not get ready for the path of the tool")
        self._rest()
        self.driven.arm[-1] = replace(self.driven.arm[-1], end=self._now())
        self._progress.end(self._note())
        joints = self.recorder.recording.arm[-1][1:]
        here = self._pose()
        poses = tool_leg.way(model.forward(np.array([*here, *joints])), here[2])
        length = float(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum())
        path = tool_leg.message(poses, "odom")
        leg = self._publish("tool path", lambda: self._tool_paths.publish(path), length)
        self.driven.tool = DrivenTool(leg.start, leg.end)

    def _arm_is_ready(self) -> bool:
        away = np.array(self.recorder.recording.arm[-1][1:]) - tool_leg.READY
        return float(np.abs(away).max()) < ARM_THERE

    def reach_goal(self) -> None:
        """Drive to a goal among obstacles that cross the way.

        Raises:
            CommandError: The robot did not arrive.
        """
        self._progress.begin("goal, obstacles")
        self.wait(lambda: self.recorder.active_source == "none", 5.0)
        begin, robot = self._now(), self._pose()
        crossing = Crossing.before(robot, begin)
        goal = placed(np.array([GOAL]), robot)[0]
        self._observe(crossing)
        message = conversions.path_message(goal[None], "odom").poses[0]
        message.header.frame_id = "odom"
        self._goals.publish(message)
        self.recorder.planner.clear()
        distance, driving = math.hypot(*GOAL[:2]), False
        for _ in self._ticks(GOAL_PATIENCE, OBSERVED):
            self._observe(crossing)
            x, y, _ = self._pose()
            left = math.hypot(goal[0] - x, goal[1] - y)
            self._progress.update(1.0 - left / distance, self._note())
            driving = driving or self.recorder.planner.get("state") == "driving"
            if driving and self.recorder.planner.get("state") == "arrived":
                break
        else:
            said = self.recorder.planner.get("last", "nothing")
            raise CommandError(
                f"the goal is not reached, {left:.2f} m are left; mpc_planner says: {said}"
                f"{excuse(self.recorder.recording)}"
            )
        x, y, theta = (float(value) for value in goal)
        self.driven.goal = DrivenGoal((x, y, theta), crossing, begin, self._now())
        self._obstacles.publish(crossing.gone())
        self._rest()
        self._progress.end(self._note())

    def _observe(self, crossing: Crossing) -> None:
        clock = self._session.node.get_clock().now()
        self._obstacles.publish(crossing.message(self._now(), clock.to_msg()))

    def drive_without_a_wheel(self, wheel: str) -> None:
        """Lose a motor on a path of two straights, go on with the other wheels, and repair it.

        Raises:
            CommandError: The controller did not notice, or the robot did not arrive.
        """
        origin = self._pose()
        poses = np.array([[0.0, 0.0, 0.0], [LIMP, 0.0, 0.0], [LIMP, LIMP, 0.0]])
        lost = noticed = math.inf

        def lose() -> None:
            nonlocal lost, noticed
            if not math.isfinite(lost) and self.recorder.progress > LOST_AT:
                lost = self._now()
                self._set_fault([wheel])
            elif lost < math.inf == noticed and self.recorder.health.get(wheel) not in (
                "",
                DRIVES,
            ):
                noticed = self._now()

        leg = self._send("dead wheel", placed(poses, origin), 2.0 * LIMP, lose)
        if not math.isfinite(noticed):
            raise CommandError(f"the controller did not notice that '{wheel}' has no torque")
        self.driven.without_wheel = DrivenWithoutWheel(wheel, lost, noticed, leg)
        self._set_fault([])
        for client in self._resets:
            self._call(client, Trigger.Request())
        if not self.wait(lambda: not self._is_known(wheel), ANSWER):
            raise CommandError(f"the reset did not bring '{wheel}' back")

    def stop_in_an_emergency(self) -> None:
        """Press the emergency stop while platform and arm move, keep on asking, and reset.

        Raises:
            CommandError: The robot did not stop, or cannot be reset.
        """
        name = "emergency stop"
        self._progress.begin(name)
        self.wait(lambda: self.recorder.active_source == "none", 5.0)
        forwards = twist_message((self._pace.twist, 0.0, 0.0))
        if self._with_arm:
            there = np.array(self.recorder.recording.arm[-1][1:]) + stop_leg.SWING
            self._send_arm(there, stop_leg.SWINGING)
        for _ in self._ticks(stop_leg.DRIVEN, TWIST_PERIOD):
            self._twists.publish(forwards)
        pressed, self._stopping = self._now(), True
        self._emergency.publish(Bool(data=True))
        for _ in self._ticks(stop_leg.HELD, TWIST_PERIOD):
            self._twists.publish(forwards)
        if not self.recorder.stopped:
            raise CommandError("the emergency stop did not stop the robot")
        self._progress.update(0.5, self._note())
        self._emergency.publish(Bool(data=False))
        self.wait(lambda: False, PAUSE)
        self._reset_all()
        self._stopping, reset = False, self._now()
        self.wait(lambda: False, stop_leg.WATCHED)
        self.driven.stop = DrivenStop(pressed, reset, self._now())
        self._progress.end(self._note())

    def _reset_all(self) -> None:
        calls = Calls(self._session.node, "reset", self._session.node.get_namespace())
        try:
            calls.look()
            self.wait(lambda: calls.look() and not self.recorder.stopped, RESET_PATIENCE)
        finally:
            calls.close()
        if self.recorder.stopped:
            refused = [said[1] for said in calls.answers.values() if said and not said[0]]
            raise CommandError(f"the reset failed: {', '.join(refused) or self.recorder.stopped}")

    def _follow(self, movement: Movement, poses: Array) -> None:
        leg = self._send(f"path: {movement.name}", poses, movement.length)
        self.driven.legs.append(replace(leg, name=movement.name))
        if self._with_arm:
            self.driven.arm[-1] = replace(self.driven.arm[-1], end=leg.end)

    def _send(
        self, name: str, poses: Array, length: float, each: Callable[[], None] = lambda: None
    ) -> DrivenLeg:
        """Send a path and wait for its end; `each` is called all the while."""
        path = conversions.path_message(poses, "odom")
        return self._publish(name, lambda: self._paths.publish(path), length, each)

    def _publish(
        self, name: str, publish: Callable[[], None], length: float,
        each: Callable[[], None] = lambda: None,
    ) -> DrivenLeg:  # fmt: skip
        """Send a motion and wait for its end.

        Raises:
            CommandError: It was not taken, or given up.
        """
        self._progress.begin(name)
        self.recorder.begin()
        begin = self._now()
        publish()
        patience = LATE + length / SLOWEST
        for _ in self._ticks(patience, TWIST_PERIOD):
            self._progress.update(self.recorder.progress, self._note())
            each()
            if self.recorder.arrived:
                break
        else:
            raise CommandError(
                f"{name} is not at its end, but at {self.recorder.progress:.0%}"
                f"{excuse(self.recorder.recording)}"
            )
        leg = DrivenLeg(name, begin, self._now())
        self._rest()
        self._progress.end(self._note())
        return leg

    def _is_known(self, wheel: str) -> bool:
        return self.recorder.health.get(wheel, DRIVES) != DRIVES

    def _set_fault(self, wheels: list[str]) -> None:
        """Take the torque of these wheels' motors away, and give all others theirs."""
        value = ParameterValue(
            type=ParameterType.PARAMETER_STRING_ARRAY, string_array_value=wheels
        )
        request = SetParameters.Request(
            parameters=[ParameterMessage(name="faults.dead_motor", value=value)]
        )
        self._call(self._faults, request)

    def _call(self, client: Client, request: Any) -> None:
        """Call a service and wait for its answer.

        Raises:
            CommandError: None came.
        """
        future = client.call_async(request)
        if not self.wait(future.done, ANSWER):
            raise CommandError(f"{client.srv_name} does not answer")

    def _drive_twist(self, phase: TwistPhase) -> None:
        self._progress.begin(phase.name)
        start = self._now()
        self.driven.twists.append(DrivenTwist(phase, start))
        for elapsed in self._ticks(phase.duration, TWIST_PERIOD):
            self._twists.publish(twist_message(phase.twist(elapsed)))
            self._progress.update(elapsed / phase.duration, self._note())
        for _ in self._ticks(PAUSE, TWIST_PERIOD):
            self.halt()
        self._progress.end(self._note())

    def halt(self) -> None:
        """Ask for rest."""
        self._twists.publish(Twist())

    def _rest(self) -> None:
        """Wait until the controller says that nobody drives."""
        for _ in self._ticks(PAUSE, TWIST_PERIOD):
            pass
        self.wait(lambda: self.recorder.active_source == "none", 5.0)

    # ---- helpers ----------------------------------------------------------------------------

    def _ticks(self, duration: float, period: float) -> "Ticks":
        return Ticks(self._session, duration, period, self._check)

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Serve ROS and look after the robot until a condition holds; False if it is late."""

        def checked() -> bool:
            self._check()
            return condition()

        return self._session.wait(checked, timeout)

    def _check(self) -> None:
        """Called at least every SLICE seconds while the show goes on."""
        now = time.monotonic()
        recording = self.recorder.recording
        recording.stall = max(recording.stall, now - self._checked)
        self._checked = now
        self._poll()
        for name, why in self.recorder.stopped.items() if not self._stopping else ():
            raise CommandError(f"the robot stopped: {name} is {why}{excuse(recording)}")

    def _absent(self) -> str:
        unheard = [
            f"a listener to {publisher.topic_name}"
            for publisher in (
                self._twists,
                self._paths,
                self._tool_paths,
                self._goals,
                self._obstacles,
            )  # fmt: skip
            if not publisher.get_subscription_count()
        ]
        arm = ["arm/joint_states"] if self._with_arm and not self.recorder.has_arm else []
        return ", ".join(self.recorder.missing + arm + unheard)

    def _pose(self) -> Triple:
        x, y, theta = self.recorder.recording.odom[-1][1:4]
        return x, y, theta

    def _now(self) -> float:
        """ROS time [s]."""
        return float(self._session.node.get_clock().now().nanoseconds * 1e-9)

    def _note(self) -> str:
        return pose_text(self._pose())


class Ticks:
    """Iterates over the time elapsed, at a fixed period, for a duration; serves ROS meanwhile."""

    def __init__(
        self, session: Session, duration: float, period: float, check: Callable[[], None]
    ) -> None:
        self._session = session
        self._period = period
        self._check = check
        self._start = time.monotonic()
        self._end = self._start + duration
        self._next = self._start

    def __iter__(self) -> "Ticks":
        return self

    def __next__(self) -> float:
        self._session.spin(self._next - time.monotonic())
        self._check()
        now = time.monotonic()
        if now >= self._end:
            raise StopIteration
        self._next = max(self._next + self._period, now)
        return now - self._start
