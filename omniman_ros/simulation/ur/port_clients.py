"""Clients of the controller's ports, without their sockets."""

from omniman_ros.simulation.ur import kinematics, script_protocol
from omniman_ros.simulation.ur.controller import Cb3Controller
from omniman_ros.simulation.ur.dashboard import GREETING, DashboardSession
from omniman_ros.simulation.ur.modes import MOVING, Cb3RuntimeState
from omniman_ros.simulation.ur.rtde_outputs import currents
from omniman_ros.simulation.ur.rtde_server import URCONTROL, RtdeFaults, RtdeServerSession

SECONDARY_PERIOD = 12  #: Number of cycles between two robot state messages: 10 Hz


class PortClient:
    """A client of one port, to which nothing is sent, and which closes the connection itself."""

    patient = False  #: Whether a slow client misses messages and is not disconnected

    @property
    def closed(self) -> bool:
        """Whether the connection is to be closed once everything is sent."""
        return False

    def greeting(self) -> bytes:
        """Return the first bytes to send."""
        return b""

    def receive(self, data: bytes) -> bytes:
        """Process received bytes, and return the answer.

        Raises:
            InputError: The bytes are too long for a message.
            RtdeError: The bytes violate the RTDE protocol.
        """
        raise NotImplementedError

    def cycle(self) -> bytes:
        """Return the bytes to send in this cycle; called once per cycle."""
        return b""

    def close(self) -> None:
        """Release the resources of the client, which has disconnected."""


class PackageQueue:
    """Queues packages for one client, and returns them as they are, split, or several at once.

    Attributes:
        split_at: Number of bytes of the last package that are sent at once; the rest follows in
            the next cycle. All of it is sent if 0.
        coalesce: Number of packages that are collected and then sent together.
    """

    def __init__(self) -> None:
        self.split_at, self.coalesce = 0, 1
        self._collected: list[bytes] = []
        self._rest = b""

    def put(self, package: bytes) -> None:
        """Queue a package; an empty one is ignored."""
        if package:
            self._collected.append(package)

    def take(self) -> bytes:
        """Return the bytes to send now; called once per cycle."""
        head, self._rest = self._rest, b""
        if not self._collected or len(self._collected) < self.coalesce:
            return head
        packages, self._collected = self._collected, []
        last = packages.pop()
        cut = self.split_at or len(last)
        self._rest = last[cut:]
        return head + b"".join(packages) + last[:cut]


class RtdeClient(PortClient):
    """Client of RTDE; one that does not read is disconnected."""

    def __init__(self, controller: Cb3Controller, owners: dict[str, RtdeServerSession]) -> None:
        self._controller = controller
        self._session = RtdeServerSession(controller, owners)
        self._queue = PackageQueue()

    def receive(self, data: bytes) -> bytes:
        """Process received bytes, and return the answers."""
        faults = self._controller.faults
        self._session.faults = RtdeFaults(
            faults.refuse_rtde_version, faults.outputs_not_found, faults.inputs_in_use
        )
        return self._session.receive(data)

    def cycle(self) -> bytes:
        """Return the data of this cycle, split or coalesced as the faults require."""
        faults = self._controller.faults
        self._queue.split_at, self._queue.coalesce = faults.split_at, faults.coalesce
        self._queue.put(self._session.data())
        return self._queue.take()

    def close(self) -> None:
        """Release the inputs of the client."""
        self._session.close()


class ScriptClient(PortClient):
    """Client that sends programs; two of the three ports also send the robot state."""

    patient = True

    def __init__(self, controller: Cb3Controller, sends_state: bool) -> None:
        self._controller, self._sends_state = controller, sends_state
        self._reader = script_protocol.ProgramReader()
        self._cycles = 0

    def greeting(self) -> bytes:
        """Return the version message."""
        return script_protocol.version_message(URCONTROL) if self._sends_state else b""

    def receive(self, data: bytes) -> bytes:
        """Run the programs that these bytes complete."""
        for program in self._reader.receive(data):
            self._controller.start(program)
        return b""

    def cycle(self) -> bytes:
        """Return the robot state, ten times a second."""
        self._cycles += 1
        if not self._sends_state or self._cycles % SECONDARY_PERIOD:
            return b""
        return script_protocol.robot_state(state_of(self._controller))


class DashboardClient(PortClient):
    """Client of the dashboard."""

    def __init__(self, controller: Cb3Controller) -> None:
        self._dashboard = DashboardSession(controller)

    @property
    def closed(self) -> bool:
        """Whether the client has sent `quit`."""
        return self._dashboard.closed

    def greeting(self) -> bytes:
        """Return the name of the server."""
        return f"{GREETING}\n".encode()

    def receive(self, data: bytes) -> bytes:
        """Process received bytes, and return one line of reply for each line."""
        return self._dashboard.receive(data)


def state_of(c: Cb3Controller) -> script_protocol.RobotState:
    """Return the content of the robot state message of a controller."""
    return script_protocol.RobotState(
        time=c.time,
        powered=c.modes.powered,
        emergency_stopped=c.modes.safety_bits >> 7 & 1 == 1,
        protective_stopped=c.modes.safety_bits >> 2 & 1 == 1,
        playing=c.runtime in MOVING,
        paused=c.runtime is Cb3RuntimeState.PAUSED,
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
