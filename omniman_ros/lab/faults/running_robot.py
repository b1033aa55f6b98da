"""The running robot of the faults: its processes, its ground truth, and what it reports."""

import math
from collections.abc import Callable, Sequence

from diagnostic_msgs.msg import DiagnosticStatus

from omniman_ros.console.session import Session
from omniman_ros.lab.faults.injections import ARM, BRIDGE, CONTROLLER, STREAMER
from omniman_ros.lab.faults.observed_robot import ObservedRobot
from omniman_ros.lab.faults.robot_processes import RobotProcesses
from omniman_ros.lab.faults.robot_services import send_to_dashboard
from omniman_ros.nodes.clock_follower import ClockFollower
from omniman_ros.processes.robot_setup import RobotSetup, robot_processes

#: Nodes whose stop states tell whether the robot can be driven
MOVERS = (CONTROLLER, BRIDGE, STREAMER)
LOOKAHEAD = 0.01  #: how far simulated time may be ahead of this process, which injects faults [s]
RESET_PERIOD = 0.3  #: time between two attempts to reset the robot [s]
NANOSECOND = 1e-9  #: seconds in a nanosecond
#: Longest time after an instant until its ground truth is received from a busy machine [s]
LATEST_TRUTH = 5.0
#: Beginning of the argument that gives the port of the dashboard
DASHBOARD_PORT = "ports.dashboard:="


class RunningRobot(ObservedRobot):
    """Robot of processes, its services, and what it reports.

    Durations are of the session's clock. In simulated time, the robot waits for this process.
    """

    processes: RobotProcesses

    def __init__(
        self,
        session: Session,
        setup: RobotSetup,
        left_out: Sequence[str],
        on_line: Callable[[str, str], None],
    ) -> None:
        specs = [spec for spec in robot_processes(setup) if spec.name not in left_out]
        super().__init__(session, RobotProcesses(specs, self._forget, on_line))

    def _forget(self, name: str) -> None:
        self.stop_states.pop(name, None)

    def follow_clock(self) -> None:
        """Take part in simulated time, once all timers were created; do nothing on real time."""
        if self.session.is_simulated:
            session = self.session
            self._follower = ClockFollower(session.node, LOOKAHEAD, lambda: None, session.now)

    @property
    def now(self) -> float:
        """The time of stamps [s]."""
        return self.session.node.get_clock().now().nanoseconds * NANOSECOND

    def restart(self) -> None:
        """Kill all processes, and start them anew."""
        self.processes.restart()
        self.truth.forget()

    def observe(self, until: float) -> None:
        """Serve callbacks until the ground truth up to a time [s] is known.

        The robot, not this process, tells how late it is: what a busy machine delivers late is
        waited for, up to `LATEST_TRUTH`. An arm's controller that is gone reports nothing.
        """
        self.pause(until - self.now)
        arm = self.processes.is_alive(ARM)
        self.wait(lambda: self.truth.covers(until, arm), LATEST_TRUTH)

    @property
    def is_released(self) -> bool:
        """Whether all nodes that move something are running and not held."""
        return all(self.stop_states.get(name) == DiagnosticStatus.OK for name in MOVERS)

    def release(self, timeout: float) -> bool:
        """Reset all stopped nodes until all are running; return whether they are."""
        for _ in range(math.ceil(timeout / RESET_PERIOD)):
            if self.is_released:
                break
            for name in self.stopped:
                self.services.trigger(name, "reset")
            self.wait(lambda: self.is_released, RESET_PERIOD)
        return self.is_released

    def send_to_dashboard(self, command: str) -> None:
        """Send a command to the dashboard of the simulated arm's controller."""
        send_to_dashboard(int(self.processes.argument(ARM, DASHBOARD_PORT)), command)
