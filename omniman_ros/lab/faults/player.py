"""Carries out and removes the injections of the table."""

from functools import singledispatchmethod
from signal import SIGCONT, SIGKILL, SIGSTOP

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
from omniman_ros.lab.faults.running_robot import RunningRobot
from omniman_ros.nodes.stop_interface import LATCHED

DASHBOARD_PAUSE = 1.0
"""Time for which the arm's controller carries a command of its dashboard out [s]."""
RELEASE_PERIOD = 0.01  # period at which a second button says that it is not pressed [s]


class Player:
    """Injects faults into a robot that it can move, and removes them."""

    def __init__(self, robot: RunningRobot) -> None:
        node = robot.session.node
        self.robot, self.driver = robot, Driver(node, robot.truth)
        self._invalid = InvalidMessages(node)
        self._button = node.create_publisher(Bool, "emergency_stop", LATCHED)
        self._other_button = node.create_publisher(Bool, "emergency_stop", LATCHED)
        self._releasing = False
        node.create_timer(RELEASE_PERIOD, self._release)

    def _release(self) -> None:
        if self._releasing:
            self._other_button.publish(Bool(data=False))

    def prepare(self, injection: Injection) -> None:
        """Connect to what the injection needs, so that it comes without delay."""
        match injection:
            case Setting(node, parameter, _, cleared, _):
                self.robot.services.set_parameter(node, parameter, cleared)
            case ServiceStop(node):
                self.robot.services.connect(node, "stop")

    @singledispatchmethod
    def inject(self, injection: Injection) -> None:
        """Inject a fault."""
        raise TypeError(f"no way to inject {injection}")

    @inject.register
    def _(self, injection: Signal) -> None:
        if injection.number is SIGKILL:
            self.robot.processes.signal(injection.process, SIGKILL)
            return
        self.robot.processes.signal(injection.process, injection.number)
        if injection.resume is not None:
            self.robot.pause(injection.resume)
            self.robot.processes.signal(injection.process, SIGCONT)

    @inject.register
    def _(self, injection: Restart) -> None:
        self.robot.processes.kill(injection.process)
        self.robot.processes.start(injection.process)

    @inject.register
    def _(self, injection: Second) -> None:
        self.robot.processes.start(injection.process, copy=_copy_of(injection.process))

    @inject.register
    def _(self, injection: Setting) -> None:
        self.robot.services.set_parameter(injection.node, injection.parameter, injection.value)

    @inject.register
    def _(self, injection: TwistFault) -> None:
        self.driver.fault = injection

    @inject.register
    def _(self, injection: Publication) -> None:
        self._invalid.publication = injection

    @inject.register
    def _(self, injection: EmergencyStop) -> None:
        self._button.publish(Bool(data=True))
        self._releasing = injection.others_release

    @inject.register
    def _(self, injection: ServiceStop) -> None:
        self.robot.services.trigger(injection.node, "stop")

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
                self._button.publish(Bool(data=False))

    def repair(self) -> list[str]:
        """Start every process that has ended; return their names."""
        processes, ended = self.robot.processes, self.robot.processes.ended
        for name in ended:
            processes.kill(name)
            processes.start(name)
        return ended


def _copy_of(process: str) -> str:
    """Return the name of a second copy of a process."""
    return f"{process} (second)"
