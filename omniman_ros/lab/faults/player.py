"""Carries out and removes the injections of the table."""

from collections.abc import Sequence
from signal import SIGCONT, SIGSTOP
from typing import Generic, TypeVar, assert_never

from rclpy.publisher import Publisher
from std_msgs.msg import Bool

from omniman_ros.lab.faults.driver import Driver
from omniman_ros.lab.faults.injections import (
    EmergencyStop,
    Injection,
    Publication,
    Restart,
    Second,
    ServiceStop,
    Setting,
    Signal,
    TwistFault,
)
from omniman_ros.lab.faults.invalid_messages import InvalidMessages
from omniman_ros.lab.faults.observed_robot import ObservedRobot
from omniman_ros.nodes.stop_interface import LATCHED

R = TypeVar("R", bound=ObservedRobot)

#: Time for which the arm's controller carries a command of its dashboard out [s]
DASHBOARD_PAUSE = 1.0
RELEASE_PERIOD = 0.01  #: period at which a second button says that it is not pressed [s]


class Player(Generic[R]):
    """Injects faults into a robot that it can move, and removes them."""

    def __init__(self, robot: R) -> None:
        node = robot.session.node
        self.robot, self.driver = robot, Driver(node, robot.truth)
        self._invalid = InvalidMessages(node)
        self._buttons: list[Publisher] = []
        self._releasing = False
        node.create_timer(RELEASE_PERIOD, self._release)

    def _release(self) -> None:
        if self._releasing:
            self._buttons[1].publish(Bool(data=False))

    def _connect_buttons(self, count: int) -> None:
        """Become publishers of the emergency stop; one that never speaks counts as lost."""
        node = self.robot.session.node
        while len(self._buttons) < count:
            self._buttons.append(node.create_publisher(Bool, "emergency_stop", LATCHED))

    def prepare(self, injection: Injection) -> None:
        """Connect to what the injection needs, so that it comes without delay."""
        match injection:
            case Setting(node, parameter, _, cleared, _):
                self.robot.services.set_parameter(node, parameter, cleared)
            case ServiceStop(node):
                self.robot.services.connect(node, "stop")
            case Publication(topic, _):
                self._invalid.connect(topic)
            case EmergencyStop(others_release):
                self._connect_buttons(2 if others_release else 1)

    def inject(self, injection: Injection) -> None:
        """Inject a fault."""
        processes, services = self.robot.processes, self.robot.services
        match injection:
            case Signal(process, number, resume):
                processes.signal(process, number)
                if resume is not None:
                    self.robot.pause(resume)
                    processes.signal(process, SIGCONT)
            case Restart(process):
                processes.kill(process)
                processes.start(process)
            case Second(process):
                processes.start(process, copy=_copy_of(process))
            case Setting(node, parameter, value, _, _):
                services.set_parameter(node, parameter, value)
            case TwistFault():
                self.driver.fault = injection
            case Publication():
                self._invalid.publication = injection
            case EmergencyStop(others_release):
                self._buttons[0].publish(Bool(data=True))
                self._releasing = others_release
            case ServiceStop(node):
                services.trigger(node, "stop")
            case _:
                assert_never(injection)

    def remove(self, injection: Injection) -> None:
        """Remove a fault; what was killed stays away until :meth:`repair`."""
        self.driver.fault = self._invalid.publication = None
        self._releasing = False
        match injection:
            case Signal(process, number, _) if number is SIGSTOP:
                self.robot.processes.signal(process, SIGCONT)
            case Second(process):
                self.robot.processes.kill(_copy_of(process))
            case Setting(node, parameter, _, cleared, commands):
                self.robot.services.set_parameter(node, parameter, cleared)
                for command in commands:
                    self.robot.send_to_dashboard(command)
                    self.robot.pause(DASHBOARD_PAUSE)
            case EmergencyStop():
                self._buttons[0].publish(Bool(data=False))

    def repair(self) -> Sequence[str]:
        """Start every process that has ended; return their names."""
        processes, ended = self.robot.processes, self.robot.processes.ended
        for name in ended:
            processes.kill(name)
            processes.start(name)
        return ended


def _copy_of(process: str) -> str:
    return f"{process} (second)"
