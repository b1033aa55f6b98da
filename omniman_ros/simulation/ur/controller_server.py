"""Controller with its ports, run by a thread on absolute deadlines."""

import math
import re
import threading
from dataclasses import dataclass

from omniman_ros.core.arrays import Array
from omniman_ros.simulation.arm_link.client import ArmLinkClient
from omniman_ros.simulation.ur.arm import CYCLE, SimulatedArm, UrArmParameters
from omniman_ros.simulation.ur.arm_body import ArmBody
from omniman_ros.simulation.ur.controller import Cb3Controller, Launch, RunningProgram
from omniman_ros.simulation.ur.controller_clock import MAX_WAIT, ControllerClock, MonotonicClock
from omniman_ros.simulation.ur.modes import Cb3RobotMode
from omniman_ros.simulation.ur.port_parameters import UrPortParameters
from omniman_ros.simulation.ur.program_host import ProgramHost
from omniman_ros.simulation.ur.program_sockets import ProgramSockets
from omniman_ros.simulation.ur.tcp_ports import ControllerPorts
from omniman_ros.simulation.ur.urscript.compiler import Program as Text
from omniman_ros.simulation.ur.urscript.machine import Machine
from omniman_ros.simulation.ur.world_arm import WorldArm

MAX_DELAY = 1.0  #: Delay above which missed cycles are skipped: the time stops [s]
#: Matches a number on the line after its "=", before anything else on that line
NEXT_LINE = re.compile(r"=[ \t]*(?:#[^\n]*)?\n[ \t]*(-?[0-9.]+)[ \t]*")


def launcher(network: ProgramSockets) -> Launch:
    """Return a function that parses programs and starts them.

    A controller reads the end of a line as a blank. The program of ur_rtde relies on that where
    it inserts the numbers of its registers.
    """

    def launch(text: str, controller: Cb3Controller) -> RunningProgram:
        return Machine(Text(NEXT_LINE.sub(r"= \1\n", text)), ProgramHost(controller, network))

    return launch


def make_arm(parameters: UrArmParameters, is_lockstep: bool) -> ArmBody:
    """Return joints of the controller's own, or those of a world."""
    if not parameters.world_port:
        return SimulatedArm(parameters)
    return WorldArm(parameters, ArmLinkClient(parameters.world_port), is_lockstep)


@dataclass(frozen=True)
class MeasuredMotion:
    """Motion of the joints at one instant."""

    at: float  #: The instant, on the clock of the controller's thread [s]
    q: Array  #: Angles (6,) [rad]
    qd: Array  #: Speeds (6,) [rad/s]


class ControllerServer:
    """A simulated UR controller on TCP.

    Attributes:
        late: Number of cycles that began more than a cycle late.
        lost: Total time of the skipped cycles [s].
        done: Time up to which all cycles have been run [s].
        measured: Motion of the joints at the beginning of the last cycle; None before the first.
            It is replaced as a whole, so that other threads may read it.

    Raises:
        ParameterError: A port is not available.
    """

    def __init__(
        self, arm: UrArmParameters, ports: UrPortParameters, pace: ControllerClock | None = None
    ) -> None:
        self.network = ProgramSockets()  #: Connections of the program
        body = make_arm(arm, is_lockstep=pace is not None)
        #: The controller; other threads may set its `faults` and `slider`, and read the rest
        self.controller = Cb3Controller(arm, body, launcher(self.network))
        #: Ports of the controller
        self.ports = ControllerPorts(self.controller, self.network, ports)
        self.late, self.lost, self.done = 0, 0.0, 0.0
        self.measured: MeasuredMotion | None = None
        self._pace = pace or MonotonicClock()
        self._has_run = threading.Condition()
        self.error: Exception | None = None  #: Exception that ended the thread, or None
        self._closing, self._power_off = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulated_ur", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def cycle(self, now: float, due_cycles: int = 1) -> None:
        """Run one cycle of those that are due; tests call it instead of starting the thread."""
        arm = self.controller.arm
        arm.measure(now)
        self.measured = MeasuredMotion(now, arm.q.copy(), arm.qd.copy())
        self.network.admit(due_cycles)
        if self._power_off.is_set():
            self._power_off.clear()
            self.controller.power(Cb3RobotMode.POWER_OFF)
        self.ports.cycle(now - self.lost)

    def _run(self) -> None:
        pace = self._pace
        # Cycles before the first known time would have to catch up with it, and be late.
        while math.isinf(pace.now()) and not self._closing.is_set():
            pace.wait(0.0)
        self.done = due = pace.now()
        while not self._closing.is_set():
            skipped = pace.now() - due
            if abs(skipped) > MAX_DELAY:  # held up, or simulated time has begun (anew)
                self.lost += skipped
                self.done = due = due + skipped
            if pace.now() < due:
                pace.wait(due)
                continue
            missed_cycles = int((pace.now() - due) / CYCLE)
            try:
                self.cycle(due, 1 + missed_cycles)
            except Exception as error:
                self.error = error
                return
            due += CYCLE
            with self._has_run:
                self.done = due
                self._has_run.notify_all()
            if pace.now() - due > CYCLE:
                self.late += 1
                pace.give_way()

    def wait_for_cycles(self) -> None:
        """Wait until all cycles that are due by now have been run, up to `MAX_WAIT`."""
        with self._has_run:
            self._has_run.wait_for(lambda: self.done > self._pace.now(), MAX_WAIT)

    def shut_down(self) -> None:
        """Switch the power off in the next cycle: the arm brakes, and the program ends."""
        self._power_off.set()

    def close(self) -> None:
        """End the thread, and close all ports."""
        self._closing.set()
        self.controller.arm.close()
        if self._thread.is_alive():
            self._thread.join()
        self.ports.close()
