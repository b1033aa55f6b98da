"""A robot into which faults are injected: its processes, its services, and what it reports."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Protocol

from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import String

from omniman_ros.console.session import Session
from omniman_ros.lab.faults.ground_truth import GroundTruth
from omniman_ros.lab.faults.robot_services import RobotServices
from omniman_ros.nodes.stop_interface import ALL_LATCHED, LATCHED


class Processes(Protocol):
    """Processes of a robot, by the names of their nodes."""

    @property
    def ended(self) -> Sequence[str]:
        """Names of the processes that do not run, and can be started."""

    def signal(self, name: str, number: int) -> None:
        """Send a process a signal, unless it has ended."""

    def start(self, name: str, copy: str = "") -> None:
        """Start a process, or a copy of it under another name."""

    def kill(self, name: str) -> None:
        """Kill a process."""


class ObservedRobot(ABC):
    """Services of a robot, its ground truth, and what it reports, on the session's clock."""

    def __init__(self, session: Session, processes: Processes) -> None:
        self.session, self.truth = session, GroundTruth(session)
        self.processes = processes
        self.services = RobotServices(session.node, self.wait)
        self._interrupted = False
        self.on_check: Callable[[], None] = lambda: None
        self.stop_states: dict[str, bytes] = {}
        self.reasons: dict[str, str] = {}
        self.source = ""
        node = session.node
        node.create_subscription(DiagnosticStatus, "stop_state", self._on_stop_state, ALL_LATCHED)
        node.create_subscription(String, "active_source", self._on_source, LATCHED)

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

    @property
    def stopped(self) -> set[str]:
        """Names of the nodes that are stopped."""
        return {
            name for name, level in self.stop_states.items() if level == DiagnosticStatus.ERROR
        }

    @abstractmethod
    def send_to_dashboard(self, command: str) -> None:
        """Send a command to the dashboard of the simulated arm's controller."""
