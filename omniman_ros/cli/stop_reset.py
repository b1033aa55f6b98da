"""`omniman stop` and `omniman reset`: call `~/stop` or `~/reset` of all stoppable nodes."""

import argparse

from omniman_ros.client.robot import Robot
from omniman_ros.client.state import NodeAnswer, NodesRefusedError
from omniman_ros.console.terminal import say


def run(args: argparse.Namespace) -> int:
    """Run `omniman stop` or `omniman reset`, with a line about each answer.

    The exit code is 0 if the call succeeded on every node; RobotTimeoutError if there is none.
    """

    def report(answer: NodeAnswer) -> None:
        verdict = "done" if answer.success else "REFUSED"
        note = f" ({answer.message})" if answer.message else ""
        say(f"{answer.node}: {args.command} {verdict}{note}")

    with Robot(args.namespace) as robot:
        call = robot.stop if args.command == "stop" else robot.reset
        try:
            call(report=report)
        except NodesRefusedError:
            return 1
    return 0
