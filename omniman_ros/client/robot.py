"""A running robot as a Python object.

This module needs neither ROS nor numpy; a `Robot` does.
"""

import weakref
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Self

from omniman_ros.client.handle import MotionHandle
from omniman_ros.client.state import (
    BodyTwist,
    NodeAnswer,
    NodesRefusedError,
    PlanarPose,
    Reading,
    RobotError,
)
from omniman_ros.core.errors import ParameterError
from omniman_ros.extras import ROS

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from rclpy.node import Node

    from omniman_ros.client.link import RobotLink

#: What a robot is asked to be able to do unless something else is: `drive` by twists, `goal` for
#: `go_to`, `path` for `follow`, `arm` for `move_joints`, `tool` for `move_tool`, `tool_goal` for
#: `reach`, `joint_goal` for `move_body`
USUAL_ABILITIES = ("drive", "goal", "path")
READY_TIMEOUT = 15.0  #: Time within which a robot must be found [s]; it usually takes 0.2 s


class Robot:
    """A robot that runs: `omniman up`, launch files, or real hardware.

    ::

        with om.Robot() as robot:
            robot.wait_until_ready()
            robot.go_to(2.0, 1.0, 1.57).wait()
            print(robot.pose.value, robot.pose.age)

    The end of the `with` block, an exception or Ctrl-C in it, and `close` stop the robot: motions
    of this object that still go on are cancelled, a twist that is streamed becomes zero, and the
    call returns when platform and arm stand, or after a few seconds. Such a stop is not latched:
    the next command moves the robot again. A robot that this object does not move is left alone.
    A forgotten object does the same when it is collected, or when the interpreter ends.

    State and motions may be used from any thread. Positions are in odom [m], angles in rad.

    Args:
        namespace: Namespace of the robot; with a node and no namespace, that of the node.
        node: Your node, which you spin: the object then starts no thread. Without one it has a
            context, a node and a thread of its own.
        serve: For a node that is spun by the thread that also waits: spins it for a time [s], as
            `lambda t: rclpy.spin_once(node, timeout_sec=t)` does. Waiting calls call it.
        domain: ROS domain of an own node; None: that of the environment.

    Raises:
        RobotError: ROS is not installed.
    """

    def __init__(
        self,
        namespace: str = "",
        node: "Node | None" = None,
        *,
        serve: Callable[[float], object] | None = None,
        domain: int | None = None,
    ) -> None:
        if not ROS.is_available:
            raise RobotError(ROS.hint)
        from omniman_ros.client.connection import OwnConnection, SharedConnection

        connection: OwnConnection | SharedConnection
        if node is None:
            connection = OwnConnection(namespace, domain)
        else:
            connection = SharedConnection(node, namespace, serve)
        self._open_link = connection.link
        self._finalizer = weakref.finalize(self, connection.close)

    @property
    def _link(self) -> "RobotLink":
        if not self._finalizer.alive:
            raise RobotError("this client is closed: make another one")
        return self._open_link

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop what this object moves, as the class describes, and leave the robot."""
        self._finalizer()

    @property
    def is_open(self) -> bool:
        """Whether this object may be used: it is not closed, nor being closed."""
        return self._finalizer.alive

    def wait_until_ready(
        self, timeout: float = READY_TIMEOUT, needs: Sequence[str] = USUAL_ABILITIES
    ) -> None:
        """Wait until the robot reports its state, and the nodes that take its motions are there.

        Args:
            timeout: Longest time to wait [s].
            needs: What the robot must be able to do: `drive`, `goal`, `path`, `arm`, `tool`,
                `tool_goal`, `joint_goal`.

        Raises:
            RobotTimeoutError: Something is still missing; the message names it.
            ParameterError: One of `needs` is unknown.
        """
        from omniman_ros.client.link import ABILITIES

        for ability in needs:
            if ability not in ABILITIES:
                raise ParameterError("needs", ability, f"must be of {', '.join(ABILITIES)}")
        self._link.require(needs, timeout)

    @property
    def domain(self) -> int:
        """ROS domain: commands in other terminals need it as ROS_DOMAIN_ID."""
        return self._link.domain

    # ---- state ----------------------------------------------------------------------------------

    @property
    def pose(self) -> Reading[PlanarPose]:
        """Pose of the platform in odom."""
        return self._link.reading("odom")

    @property
    def twist(self) -> Reading[BodyTwist]:
        """Measured twist of the platform, in its own frame."""
        return self._link.reading("twist")

    @property
    def joints(self) -> Reading[dict[str, float]]:
        """Angles of the arm's joints by name [rad]; never known of a robot without an arm."""
        return self._link.reading("arm/joint_states")

    @property
    def tool(self) -> Reading[tuple[float, float, float]]:
        """Position of the tool in odom [m]; never known of a robot without an arm."""
        return self._link.reading("tool_pose")

    @property
    def active_source(self) -> Reading[str]:
        """Who drives the platform: `none`, `stop`, `cmd_vel`, `mpc`, `path` or another source.

        The age is the time since it changed, or since this object has heard it.
        """
        return self._link.reading("active_source")

    @property
    def stop_reason(self) -> Reading[str]:
        """Which nodes are stopped, and why; empty if none is. The age is that of the last change.

        Nodes that hold because another one is stopped are not named.
        """
        return self._link.reading("stop_state")

    # ---- motions --------------------------------------------------------------------------------

    def drive(self, vx: float, vy: float, wz: float) -> None:
        """Drive with a twist [m/s, m/s, rad/s] until it is changed; three zeros end it.

        It is sent 20 times a second, and at once when it changes, and takes the platform over from
        any goal or path. At the end the platform brakes, and other sources may drive again.

        Raises:
            ParameterError: A number is not finite, or far beyond any robot.
            RobotError: Nobody takes twists, or is known to do so yet.
        """
        from omniman_ros.client import messages

        twist = messages.body_twist(vx, vy, wz)
        if not any(twist):
            self.halt()
            return
        if not self._link.can_drive:
            raise RobotError(
                "nobody takes twists on cmd_vel; `wait_until_ready` waits for a robot"
            )
        self._link.drive(twist)

    def halt(self) -> None:
        """End `drive`: the platform brakes. Motions that were sent go on."""
        self._link.drive(None)

    def go_to(
        self, x: float, y: float, heading: float | None = None, *, frame: str = "odom"
    ) -> MotionHandle:
        """Drive to a pose among obstacles [m, m, rad], and return the handle of the motion.

        Args:
            heading: None keeps the present heading.
            frame: A frame that the planner knows, such as `map`.

        Raises:
            ParameterError: A number is not finite, or there is no heading in another frame.
            RobotTimeoutError: No planner is there.
        """
        from omniman_ros.client import messages

        if heading is None:
            if frame != messages.FRAME:
                raise ParameterError("heading", heading, f"must be given in frame '{frame}'")
            self._link.require(("goal",))
            heading = self.pose.value.heading
        message = messages.goal(x, y, heading, frame)
        return self._link.send("goal", f"goal ({x:g}, {y:g}, {heading:g})", message)

    def follow(self, poses: "ArrayLike", *, frame: str = "odom") -> MotionHandle:
        """Drive along a path, poses (k, 3) [m, m, rad]; the first is reached on a straight line.

        Raises:
            InputError: The poses are not finite, or no such array.
            RobotTimeoutError: Nobody is there who takes paths.
        """
        from omniman_ros.client import messages

        message = messages.path(poses, frame)
        return self._link.send("path", f"path of {len(message.poses)} poses", message)

    def move_joints(
        self,
        angles: "Mapping[str, float] | Sequence[float]",
        duration: float | None = None,
    ) -> MotionHandle:
        """Move the arm to joint angles [rad].

        Args:
            angles: By name, where the other joints stay as they are; or of all joints, from base
                to tool.
            duration: Duration of the motion, at least 0.6 s; None: as short as the limits allow.

        Raises:
            InputError: A joint is unknown, or one is missing.
            ParameterError: A number is not finite.
            RobotTimeoutError: No arm is there.
        """
        from omniman_ros.client import messages

        self._link.require(("arm",))
        message = messages.joint_motion(angles, tuple(self.joints.value), duration)
        return self._link.send("arm", "motion of the arm", message)

    def move_tool(self, x: float, y: float, z: float, *, relative: bool = False) -> MotionHandle:
        """Move the tool along a straight line to a position [m], with platform and arm in step.

        The tool keeps its orientation.

        Args:
            relative: Whether the position is given from the tool, with x ahead of the robot and y
                to its left, rather than in odom.

        Raises:
            ParameterError: A number is not finite.
            RobotTimeoutError: Nobody is there who moves the tool.
        """
        from omniman_ros.client import messages

        goal = messages.position(x, y, z)
        self._link.require(("tool",))
        start = self.tool.value
        if relative:
            goal = messages.relative_position(start, self.pose.value.heading, goal)
        return self.follow_tool([start, goal])

    def reach(
        self,
        x: float,
        y: float,
        z: float,
        orientation: Sequence[float] | None = None,
        *,
        frame: str = "odom",
    ) -> MotionHandle:
        """Move the tool to a position [m], driving as far as needed, around what is in the way.

        It needs `whole_body_planner`: `omniman up --whole-body-planner`. A goal in place of
        another one, or of another motion of the tool, begins when the robot has come to rest.

        Args:
            orientation: Unit quaternion x, y, z, w of the tool in the frame; None keeps the tool's
                present orientation in odom, however the robot turns.

        Raises:
            InputError: The orientation has not four finite numbers.
            ParameterError: A number is not finite.
            RobotTimeoutError: No `whole_body_planner` is there.
        """
        from omniman_ros.client import messages

        message = messages.tool_goal(x, y, z, orientation, frame)
        return self._link.send("tool_goal", f"goal of the tool ({x:g}, {y:g}, {z:g})", message)

    def move_body(
        self,
        x: float,
        y: float,
        heading: float,
        angles: "Mapping[str, float] | Sequence[float]",
        *,
        frame: str = "odom",
    ) -> MotionHandle:
        """Move the platform to a pose [m, m, rad] and the arm to joint angles [rad], together.

        They go around what is in the way. It needs `whole_body_planner`, and begins as
        :meth:`reach` does.

        Args:
            angles: As those of :meth:`move_joints`.

        Raises:
            InputError: A joint is unknown, or one is missing.
            ParameterError: A number is not finite.
            RobotTimeoutError: No `whole_body_planner` or no arm is there.
        """
        from omniman_ros.client import messages

        self._link.require(("joint_goal",))
        message = messages.joint_goal(x, y, heading, angles, tuple(self.joints.value), frame)
        name = f"goal of platform and arm ({x:g}, {y:g}, {heading:g})"
        return self._link.send("joint_goal", name, message)

    def follow_tool(self, poses: "ArrayLike", *, frame: str = "odom") -> MotionHandle:
        """Move the tool along a path that begins near it, with platform and arm in step.

        Args:
            poses: Positions (k, 3) [m] on which the tool keeps its orientation, or poses (k, 7):
                positions and unit quaternions x, y, z, w.

        Raises:
            InputError: The poses are not finite, or no such array.
            RobotTimeoutError: Nobody is there who moves the tool.
        """
        from omniman_ros.client import messages

        message = messages.tool_path(poses, frame)
        return self._link.send("tool", f"tool path of {len(message.poses)} poses", message)

    # ---- stops ----------------------------------------------------------------------------------

    def stop(
        self,
        timeout: float = READY_TIMEOUT,
        report: Callable[[NodeAnswer], None] = lambda answer: None,
    ) -> tuple[NodeAnswer, ...]:
        """Stop every node in or below the namespace that moves something, until `reset`.

        Nothing moves until then, whatever is sent. As nodes are called when they are found, an
        object that was made a moment ago goes on looking for others until none has been found
        for 3.5 s.

        Args:
            timeout: Time within which the first node must be found [s].
            report: Called with each answer when it arrives, in another thread.

        Returns:
            The answer of each node.

        Raises:
            NodesRefusedError: A node has not confirmed it; the error has all answers.
            RobotTimeoutError: No node was found.
        """
        return self._call_all("stop", timeout, report)

    def reset(
        self,
        timeout: float = READY_TIMEOUT,
        report: Callable[[NodeAnswer], None] = lambda answer: None,
    ) -> tuple[NodeAnswer, ...]:
        """Release all nodes that are stopped; moves nothing by itself. See :meth:`stop`.

        A node refuses while what it moves has not come to rest, or an emergency stop is pressed.
        """
        return self._call_all("reset", timeout, report)

    def _call_all(
        self, action: str, timeout: float, report: Callable[[NodeAnswer], None]
    ) -> tuple[NodeAnswer, ...]:
        answers = self._link.call_all(action, timeout, report)
        if not all(answer.success for answer in answers):
            raise NodesRefusedError(action, answers)
        return answers

    # ---- obstacles ------------------------------------------------------------------------------

    def add_obstacle(
        self,
        name: str,
        x: float,
        y: float,
        radius: float,
        velocity: Sequence[float] = (0.0, 0.0),
    ) -> None:
        """Tell the robot of a round obstacle, or of its new place if the name is known.

        It is published 10 times a second, moves at its velocity from now on, and is removed when
        this object ends. Once it has been told of obstacles, a robot that hears nothing more of
        them slows down or waits: see the guide on inputs.

        Args:
            x, y: Position in odom [m].
            radius: Radius [m].
            velocity: Velocity (2,) in odom [m/s].

        Raises:
            ParameterError: A number is not finite, or the radius not above 0.
        """
        from omniman_ros.client import messages

        self._link.place(messages.RoundObstacle(name, x, y, radius, velocity))

    def remove_obstacle(self, name: str) -> None:
        """Remove an obstacle of this object; RobotError if there is none of that name."""
        self._link.remove(name)
