"""The running robot of the faults: its processes, its ground truth, and what it reports."""

import math
from collections.abc import Callable, Sequence

from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import String

from omniman_ros.console.session import Session
from omniman_ros.lab.faults.ground_truth import GroundTruth
from omniman_ros.lab.faults.injections import ARM, BRIDGE, CONTROLLER, STREAMER
from omniman_ros.lab.faults.robot_processes import RobotProcesses
from omniman_ros.lab.faults.robot_services import RobotServices, send_to_dashboard
from omniman_ros.nodes.clock_follower import ClockFollower
from omniman_ros.nodes.stop_interface import ALL_LATCHED, LATCHED
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


class RunningRobot:
    """Robot of processes, its services, and what it reports.

    Durations are of the session's clock. In simulated time, the robot waits for this process.
    """

    def __init__(
        self,
        session: Session,
        setup: RobotSetup,
        left_out: Sequence[str],
        on_line: Callable[[str, str], None],
    ) -> None:
        self.session, self.truth = session, GroundTruth(session)
        specs = [spec for spec in robot_processes(setup) if spec.name not in left_out]
        self.processes = RobotProcesses(specs, self._forget, on_line)
        self.services = RobotServices(session.node, self.wait)
        self._interrupted = False
        self.on_check: Callable[[], None] = lambda: None
        self.stop_states: dict[str, bytes] = {}
        self.reasons: dict[str, str] = {}
        self.source = ""
        node = session.node
        node.create_subscription(DiagnosticStatus, "stop_state", self._on_stop_state, ALL_LATCHED)
        node.create_subscription(String, "active_source", self._on_source, LATCHED)

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

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        name = message.name.rpartition("/")[2]
        self.stop_states[name], self.reasons[name] = message.level, message.message

    def _on_source(self, message: String) -> None:
        self.source = message.data

    def interrupt(self, number: int) -> None:
        """Have the next :meth:`check` raise an error; safe to call from a signal handler."""
        self._interrupted = True

    def check(self) -> None:
        """Raise an error after a signal."""
        if self._interrupted:
            raise KeyboardInterrupt
        self.on_check()

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Serve callbacks until a condition holds; return whether it did in time."""

        def checked() -> bool:
            self.check()
            return condition()

        return self.session.wait(checked, timeout)

    def pause(self, seconds: float) -> None:
        """Serve callbacks for some time [s]."""
        self.wait(lambda: False, seconds)

    def observe(self, until: float) -> None:
        """Serve callbacks until the ground truth up to a time [s] is known.

        The robot, not this process, tells how late it is: what a busy machine delivers late is
        waited for, up to `LATEST_TRUTH`. An arm's controller that is gone reports nothing.
        """
        self.pause(until - self.now)
        arm = self.processes.is_alive(ARM)
        self.wait(lambda: self.truth.covers(until, arm), LATEST_TRUTH)

    @property
    def stopped(self) -> set[str]:
        """Names of the nodes that are stopped."""
        return {
            name for name, level in self.stop_states.items() if level == DiagnosticStatus.ERROR
        }

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
