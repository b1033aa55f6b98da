"""What the controller's ports say, and to whom; still without sockets."""

from typing import Protocol

from omniman_ros.simulated_ur import kinematics, script_port
from omniman_ros.simulated_ur.controller import Controller
from omniman_ros.simulated_ur.dashboard import GREETING, Dashboard
from omniman_ros.simulated_ur.modes import MOVING, Runtime
from omniman_ros.simulated_ur.outbox import Outbox
from omniman_ros.simulated_ur.outputs import currents
from omniman_ros.simulated_ur.rtde import URCONTROL, Oddities, Session

SECONDARY_PERIOD = 12
"""Cycles between two robot states: 10 Hz."""


class Client(Protocol):
    """What a port says to one client."""

    patient: bool
    """Whether the client may be slow; then what it does not take is left out."""

    @property
    def closed(self) -> bool:
        """Whether the connection is to be closed once all is sent."""
        ...

    def greeting(self) -> bytes:
        """What it hears first."""
        ...

    def receive(self, data: bytes) -> bytes:
        """Take what it says and return the answer; raises InputError or Broken."""
        ...

    def cycle(self) -> bytes:
        """What it hears in this cycle, asked or not."""
        ...

    def close(self) -> None:
        """It has gone."""
        ...


class RtdeClient:
    """A client of RTDE; one that does not read is dropped."""

    patient = False

    def __init__(self, controller: Controller, owners: dict[str, Session]) -> None:
        self._controller = controller
        self._session = Session(controller, owners)
        self._outbox = Outbox()

    @property
    def closed(self) -> bool:
        """Never: clients of this port just go."""
        return False

    def greeting(self) -> bytes:
        """Nothing: the client begins."""
        return b""

    def receive(self, data: bytes) -> bytes:
        """Answers come before data."""
        faults = self._controller.faults
        self._session.oddities = Oddities(
            faults.refuse_rtde_version, faults.outputs_not_found, faults.inputs_in_use
        )
        return self._session.receive(data)

    def cycle(self) -> bytes:
        """The data of this cycle, cut as the faults ask for."""
        faults = self._controller.faults
        self._outbox.split_at, self._outbox.coalesce = faults.split_at, faults.coalesce
        self._outbox.put(self._session.data())
        return self._outbox.take()

    def close(self) -> None:
        """Its inputs are free again."""
        self._session.close()


class ScriptClient:
    """A client that sends programs; two of the three ports tell the robot's state."""

    patient = True

    def __init__(self, controller: Controller, tells: bool) -> None:
        self._controller, self._tells = controller, tells
        self._reader = script_port.ProgramReader()
        self._cycles = 0

    @property
    def closed(self) -> bool:
        """Never: clients of this port just go."""
        return False

    def greeting(self) -> bytes:
        """The version message."""
        return script_port.version_message(URCONTROL) if self._tells else b""

    def receive(self, data: bytes) -> bytes:
        """Run what has come as a whole."""
        for program in self._reader.receive(data):
            self._controller.start(program)
        return b""

    def cycle(self) -> bytes:
        """The robot state, ten times a second."""
        self._cycles += 1
        if not self._tells or self._cycles % SECONDARY_PERIOD:
            return b""
        return script_port.robot_state(state_of(self._controller))

    def close(self) -> None:
        """Nothing is left."""


class DashboardClient:
    """A client of the dashboard."""

    patient = False

    def __init__(self, controller: Controller) -> None:
        self._dashboard = Dashboard(controller)

    @property
    def closed(self) -> bool:
        """Whether it has said `quit`."""
        return self._dashboard.closed

    def greeting(self) -> bytes:
        """The server's name."""
        return f"{GREETING}\n".encode()

    def receive(self, data: bytes) -> bytes:
        """A line for a line."""
        return self._dashboard.receive(data)

    def cycle(self) -> bytes:
        """Nothing that was not asked for."""
        return b""

    def close(self) -> None:
        """Nothing is left."""


def state_of(c: Controller) -> script_port.RobotState:
    """What the robot state message tells."""
    return script_port.RobotState(
        time=c.time,
        powered=c.modes.powered,
        emergency_stopped=c.modes.safety_bits >> 7 & 1 == 1,
        protective_stopped=c.modes.safety_bits >> 2 & 1 == 1,
        playing=c.runtime in MOVING,
        paused=c.runtime is Runtime.PAUSED,
        robot_mode=int(c.modes.robot),
        slider=c.slider,
        scaling=c.pace,
        actual_q=tuple(c.arm.q.tolist()),
        target_q=tuple(c.target.q.tolist()),
        actual_qd=tuple(c.arm.qd.tolist()),
        current=tuple(currents(c).tolist()),
        joint_mode=c.modes.joint_mode,
        pose=tuple(kinematics.pose(c.arm.q).tolist()),
    )
