"""A simulated robot that a command starts for itself and ends with it."""

import os
from collections.abc import Callable, Sequence
from typing import TypeVar

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.processes.node_output import NodeOutputLog
from omniman_ros.processes.other_robots import refuse_other_robots
from omniman_ros.processes.process_group import ProcessGroup, redirect_signals
from omniman_ros.processes.robot_setup import RobotSetup, robot_processes
from omniman_ros.processes.ros_domain import isolate_ros_domain

T = TypeVar("T")


def run_with_simulated_robot(
    setup: RobotSetup,
    headline: Sequence[str],
    verbose: bool,
    measure: Callable[[Callable[[], None]], T],
) -> T:
    """Start the nodes of a simulated robot, measure it, and stop them.

    Args:
        measure: Measures the robot; called with a function that it must call many times a second,
            which raises where a node has died or a signal was received.

    Returns:
        What `measure` returns.

    Raises:
        CommandError: The measurement failed; the nodes' log is shown.
        KeyboardInterrupt: A signal was received.
    """
    chosen = robot_processes(setup)
    is_private = "ROS_DOMAIN_ID" not in os.environ
    isolate_ros_domain(os.environ)
    log = NodeOutputLog(verbose)
    processes = ProcessGroup(chosen, on_line=log)
    for line in headline:
        say(line)
    with redirect_signals(processes.interrupt):
        try:
            if not is_private:
                refuse_other_robots(processes.check)
            with processes:
                result = measure(processes.check)
                processes.stop()
        except CommandError:
            log.show()
            raise
    return result
