"""`omniman up`: run the nodes of a robot as processes, until Ctrl-C or until one of them ends."""

import argparse
import os
import signal
import sys
from collections.abc import Mapping

from omniman_ros.console import terminal
from omniman_ros.console.terminal import paint, say
from omniman_ros.processes.node_output import PrefixedPrinter
from omniman_ros.processes.process_group import ProcessExit, ProcessGroup, redirect_signals
from omniman_ros.processes.robot_setup import RobotSetup, robot_processes


def run(args: argparse.Namespace) -> int:
    """Run `omniman up`; return the exit code of :func:`supervise`, or raise CommandError."""
    setup = RobotSetup(
        robot=args.robot,
        only=args.only or (),
        sim_time=is_simulated(args) if args.sim_time is None else args.sim_time,
        namespace=args.namespace,
        params=args.param,
        params_file=args.params_file,
        drive=args.drive,
        installation=args.installation,
        arm=args.arm,
        controller=args.controller,
        world=args.world,
        collision_monitor=args.collision_monitor,
        obstacle_tracker=args.obstacle_tracker,
        whole_body_planner=args.whole_body_planner,
    )
    specs = robot_processes(setup)
    names = [spec.name for spec in specs]
    environment = node_environment(os.environ, setup)
    nodes = ProcessGroup(
        specs, environment=environment, on_line=PrefixedPrinter(names), report=report_failure
    )
    with redirect_signals(nodes.interrupt), nodes:
        domain = environment.get("ROS_DOMAIN_ID", "0")
        started = ", ".join(f"{name} (pid {nodes.pid(name)})" for name in names)
        say(f"omniman up: {started}; robot {setup.robot}, ROS_DOMAIN_ID {domain}; Ctrl-C stops")
        return supervise(nodes)


def node_environment(given: Mapping[str, str], setup: RobotSetup) -> dict[str, str]:
    """Return the environment variables of the nodes.

    On real time, Fast DDS gets no shared memory unless the user has chosen the transports: a
    process that is killed while it holds a lock there would block those who publish to it.
    """
    environment = dict(given)
    if terminal.is_terminal(sys.stdout):
        environment.setdefault("RCUTILS_COLORIZED_OUTPUT", "1")
    if not setup.sim_time:
        environment.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    return environment


def is_simulated(args: argparse.Namespace) -> bool:
    """Return whether all of the robot is simulated, and it may be the only one of its domain.

    A domain has one `/clock`, and the robots in namespaces share it.
    """
    clocks = {"simulated_drive", "simulated_world"}
    has_clock = args.drive == "simulated" and (not args.only or not clocks.isdisjoint(args.only))
    return has_clock and args.arm != "ur" and not args.namespace


def supervise(nodes: ProcessGroup) -> int:
    """Wait for a signal or for the end of an essential node, then stop all nodes in order.

    The exit code is 0 after a signal, if all nodes came to rest; 1 if a node ended by itself, did
    not come to rest, or was killed.
    """
    event = nodes.next_event()
    if isinstance(event, ProcessExit):
        report_failure(f"{event}: stopping the robot")
        nodes.stop()
        return 1
    assert event is not None
    say("\nomniman up: stopping; repeat to kill the nodes")
    # Nodes handle SIGINT and SIGTERM only, so that SIGHUP of a closed terminal becomes SIGTERM.
    number = signal.SIGINT if event.number == signal.SIGINT else signal.SIGTERM
    return 0 if nodes.stop(number) else 1


def report_failure(text: str) -> None:
    """Write a line about a failure to stderr."""
    say(paint(f"omniman up: {text}", terminal.RED, sys.stderr), sys.stderr)
