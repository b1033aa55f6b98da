"""`omniman up`: the nodes of a robot as processes, until Ctrl-C or until one of them dies."""

import argparse
import os
import signal
import sys

from omniman_ros.cli import terminal
from omniman_ros.cli.children import Children, Exit, signals_to
from omniman_ros.cli.fleet import Setup, tasks
from omniman_ros.cli.output import PrefixedLines
from omniman_ros.cli.terminal import paint, say


def run(args: argparse.Namespace) -> int:
    """Run `omniman up`; returns the exit code."""
    setup = Setup(
        args.robot, args.only or (), args.sim_time, args.namespace, args.param, args.params_file,
        args.drive, args.installation, args.arm, args.controller,
    )  # fmt: skip
    chosen = tasks(setup)
    names = [task.name for task in chosen]
    environment = dict(os.environ)
    if terminal.is_terminal(sys.stdout):
        environment.setdefault("RCUTILS_COLORIZED_OUTPUT", "1")
    children = Children(
        chosen, environment=environment, on_line=PrefixedLines(names), report=complain
    )
    with signals_to(children.interrupt), children:
        domain = environment.get("ROS_DOMAIN_ID", "0")
        started = ", ".join(f"{name} (pid {children.pid(name)})" for name in names)
        say(f"omniman up: {started}; robot {setup.robot}, ROS_DOMAIN_ID {domain}; Ctrl-C stops")
        return supervise(children)


def supervise(children: Children) -> int:
    """Wait for a signal or a death, then stop all in order; returns the exit code.

    0 after a signal, if all came to rest; 1 if a child died, failed to come to rest, or was
    killed.
    """
    event = children.next_event()
    if isinstance(event, Exit):
        complain(f"{event}: stopping the robot")
        children.stop()
        return 1
    assert event is not None
    say("\nomniman up: stopping, once more kills")
    # Nodes know these two; a terminal that was closed is SIGTERM to them.
    number = signal.SIGINT if event.number == signal.SIGINT else signal.SIGTERM
    return 0 if children.stop(number) else 1


def complain(text: str) -> None:
    """Say what went wrong, on stderr."""
    say(paint(f"omniman up: {text}", terminal.RED, sys.stderr), sys.stderr)
