"""`omniman goal` and `omniman tool`: send a motion, show its progress, cancel on Ctrl-C."""

import argparse
import math
import sys
import time

from omniman_ros.client.handle import MotionHandle
from omniman_ros.client.robot import READY_TIMEOUT, Robot
from omniman_ros.client.state import RobotError, RobotTimeoutError
from omniman_ros.console.errors import CommandError
from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import say
from omniman_ros.core.errors import OmnimanError
from omniman_ros.processes.process_group import interrupt_on_signals

FAR = 50.0  #: Distance of a goal above which the command says how far it is [m]
LOOK_PERIOD = 0.1  #: Time between two looks at the progress [s]


def run(args: argparse.Namespace) -> int:
    """Run `omniman goal` or `omniman tool`.

    Returns 0, or raises an OmnimanError or CommandError if the robot does not arrive, or
    KeyboardInterrupt once the motion is cancelled.
    """
    progress = Progress()
    with interrupt_on_signals(), Robot(args.namespace) as robot:
        handle = None
        try:
            need = args.command
            if need == "tool" and args.around:
                need = "tool_goal"
            elif need == "goal" and args.joints:
                need = "joint_goal"
            robot.wait_until_ready(READY_TIMEOUT, needs=(need,))
            progress.begin(args.command)
            handle = send_goal(robot, args) if args.command == "goal" else send_tool(robot, args)
            follow(handle, args.timeout, progress)
        except KeyboardInterrupt:
            progress.abandon()
            say(cancel(handle), sys.stderr)
            raise
        except (CommandError, OmnimanError):
            progress.abandon()
            raise
    return 0


def send_goal(robot: Robot, args: argparse.Namespace) -> MotionHandle:
    """Send the goal of a command line; say so if it is far away."""
    x, y, heading = args.x, args.y, math.radians(args.heading)
    here = robot.pose.value
    if args.relative:
        c, s = math.cos(here.heading), math.sin(here.heading)
        x, y, heading = here.x + c * x - s * y, here.y + s * x + c * y, here.heading + heading
    distance = math.hypot(x - here.x, y - here.y)
    if distance > FAR:
        say(f"note: the goal is {distance:.0f} m away; it is cancelled after {args.timeout:g} s")
    if args.joints:
        return robot.move_body(x, y, heading, [math.radians(angle) for angle in args.joints])
    return robot.go_to(x, y, heading)


def send_tool(robot: Robot, args: argparse.Namespace) -> MotionHandle:
    """Send the path of the tool of a command line, or its goal."""
    if args.around:
        goal = args.x, args.y, args.z
        if args.relative:
            from omniman_ros.client.messages import relative_position

            goal = relative_position(robot.tool.value, robot.pose.value.heading, goal)
        return robot.reach(*goal)
    return robot.move_tool(args.x, args.y, args.z, relative=args.relative)


def follow(handle: MotionHandle, timeout: float, progress: Progress) -> None:
    """Show the progress of a motion until it has arrived; cancel it after a time [s].

    Raises:
        MotionError: It ended in another way.
        CommandError: It was cancelled because it took too long.
    """
    start = time.monotonic()
    while time.monotonic() < start + timeout:
        try:
            handle.wait(LOOK_PERIOD)
        except RobotTimeoutError:
            now = handle.feedback
            parts = [now.state.replace("_", " "), now.reason]
            if now.remaining is not None:
                parts.append(f"{now.remaining:.2f} m left")
            progress.update(now.progress or 0.0, ", ".join(filter(None, parts)))
            continue
        progress.end(f"arrived after {time.monotonic() - start:.1f} s")
        return
    state = handle.feedback.state
    handle.cancel()
    raise CommandError(f"it has not arrived within {timeout:g} s ({state}); cancelled")


def cancel(handle: MotionHandle | None) -> str:
    """Cancel a motion, if any was sent, and return what the robot does."""
    if handle is None:
        return "Nothing was sent to the robot."
    try:
        handle.cancel()
    except RobotError as error:
        return f"{error}; so does `omniman stop`."
    return "The motion is cancelled: the robot brakes and stands."
