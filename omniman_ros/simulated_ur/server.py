"""A controller with its ports, run by a thread on absolute deadlines."""

import re
import threading
import time

from omniman_ros.simulated_ur.arm import UrArmParameters
from omniman_ros.simulated_ur.controller import CYCLE, Controller, Program
from omniman_ros.simulated_ur.modes import RobotMode
from omniman_ros.simulated_ur.network import ProgramNetwork
from omniman_ros.simulated_ur.ports import Ports, UrPortParameters
from omniman_ros.simulated_ur.urscript.host import Host
from omniman_ros.simulated_ur.urscript.machine import Machine
from omniman_ros.simulated_ur.urscript.parser import Program as Text

CATCH_UP = 0.002
"""Period of cycles that are late [s]: a client that was held up with this process comes, too."""
LOST = 1.0
"""A delay that is not caught up [s]: the controller's time stood still."""


NEXT_LINE = re.compile(r"=[ \t]*(?:#[^\n]*)?\n[ \t]*(-?[0-9.]+)[ \t]*")
"""A number on the line after its "=", before whatever else stands there."""


def launch(text: str, host: Host) -> Program:
    """Read a program and begin to run it; raises ScriptError.

    To a controller the end of a line is a blank; ur_rtde's program relies on it where it puts the
    numbers of its registers in.
    """
    return Machine(Text(NEXT_LINE.sub(r"= \1\n", text)), host)


class Server:
    """A simulated UR controller on TCP.

    Args:
        arm: Of the arm.
        ports: Where it listens.

    Attributes:
        controller: What it does; to be read, but for its `faults` and `slider`, which anybody
            sets.
        network, ports: Its connections.
        late: Cycles that began more than a cycle late.
        lost: Time that was not caught up [s].
        error: What ended the thread, if anything has.

    Raises:
        ParameterError: A port cannot be opened.
    """

    def __init__(self, arm: UrArmParameters, ports: UrPortParameters) -> None:
        self.network = ProgramNetwork()
        self.controller = Controller(arm, launch, self.network)
        self.ports = Ports(self.controller, self.network, ports)
        self.late, self.lost = 0, 0.0
        self.error: Exception | None = None
        self._closing, self._ending = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulated_ur", daemon=True)

    def start(self) -> None:
        """Run from now on."""
        self._thread.start()

    def cycle(self, now: float) -> None:
        """Run one cycle at a time [s]; by hand where the thread is not started."""
        if self._ending.is_set():
            self._ending.clear()
            self.controller.power(RobotMode.POWER_OFF)
        self.ports.cycle(now)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._closing.is_set():
            try:
                self.cycle(due - self.lost)
            except Exception as error:
                self.error = error
                return
            due += CYCLE
            now = time.monotonic()
            if now - due > LOST:
                self.lost += now - due
                due = now
            self.late += now - due > CYCLE
            time.sleep(max(due - now, CATCH_UP if now > due + CYCLE else 0.0))

    def shut_down(self) -> None:
        """Take the power off in the next cycle: the arm brakes, and the program ends."""
        self._ending.set()

    def close(self) -> None:
        """End the thread and close all ports."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()
        self.ports.close()
