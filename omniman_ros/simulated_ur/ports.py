"""The controller's ports: sockets that never block, served once a cycle."""

import socket
from collections.abc import Callable
from dataclasses import dataclass

from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.parameters import parameter
from omniman_ros.simulated_ur.clients import Client, DashboardClient, RtdeClient, ScriptClient
from omniman_ros.simulated_ur.controller import Controller
from omniman_ros.simulated_ur.network import CHUNK, ProgramNetwork, abort, prepare
from omniman_ros.simulated_ur.rtde import Broken, Session

MOST = 20
"""Number of clients of a port."""


class Connection:
    """One client's socket."""

    def __init__(self, connection: socket.socket, client: Client) -> None:
        prepare(connection)
        self._socket, self.client = connection, client
        self._pending = client.greeting()
        self.open = True

    def read(self) -> None:
        """Take what has come."""
        try:
            data = self._socket.recv(CHUNK)
            if not data:
                self.close()
                return
            self._pending += self.client.receive(data)
        except BlockingIOError:
            pass
        except (OSError, InputError, Broken):
            self.close()

    def write(self) -> None:
        """Send what is due; one who does not take it is dropped, or misses it."""
        fresh = self.client.cycle()
        # A patient client's packages are whole: the next one waits until the last has gone.
        if fresh and not (self.client.patient and self._pending):
            self._pending += fresh
        if not self._pending:
            if self.client.closed:
                self.close()
            return
        try:
            sent = self._socket.send(self._pending)
        except BlockingIOError:
            sent = 0
        except OSError:
            self.close()
            return
        self._pending = self._pending[sent:]
        if self._pending and not self.client.patient:
            self.abort()
        elif self.client.closed and not self._pending:
            self.close()

    def close(self) -> None:
        """Close by FIN; what is not sent is lost."""
        self._end(lambda: self._socket.close())

    def abort(self) -> None:
        """Close by RST."""
        self._end(lambda: abort(self._socket))

    def _end(self, how: Callable[[], None]) -> None:
        if self.open:
            self.open = False
            how()
            self.client.close()


class Port:
    """One listening port and its clients.

    Args:
        address: Where it listens.
        number: Of the port; 0: any that is free.
        make: Makes what speaks to one client.

    Attributes:
        number: Of the port.

    Raises:
        OSError: It cannot listen.
    """

    def __init__(self, address: str, number: int, make: Callable[[], Client]) -> None:
        self._address, self._make = address, make
        self._listening: socket.socket | None = None
        self.number = number
        self.connections: list[Connection] = []
        self.listen()

    def listen(self) -> None:
        """Listen, again after :meth:`refuse`."""
        if self._listening is not None:
            return
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind((self._address, self.number))
            listening.listen(MOST)
            listening.setblocking(False)
        except OSError:
            listening.close()
            raise
        self.number = int(listening.getsockname()[1])
        self._listening = listening

    def refuse(self) -> None:
        """Listen no longer; connections stay."""
        if self._listening is not None:
            self._listening.close()
            self._listening = None

    def read(self) -> None:
        """Accept who has come, and take what has come."""
        while self._listening is not None and len(self.connections) < MOST:
            try:
                connection, _ = self._listening.accept()
            except OSError:
                break
            self.connections.append(Connection(connection, self._make()))
        for each in self.connections:
            each.read()
        self._forget()

    def write(self) -> None:
        """Send what is due."""
        for each in self.connections:
            if each.open:
                each.write()
        self._forget()

    def end(self, abortively: bool) -> None:
        """Close all connections, by RST or by FIN."""
        for each in self.connections:
            each.abort() if abortively else each.close()
        self._forget()

    def _forget(self) -> None:
        self.connections = [each for each in self.connections if each.open]


@dataclass(frozen=True, kw_only=True)
class UrPortParameters:
    """Where the controller's ports are."""

    address: str = parameter(
        "127.0.0.1", "Address at which the ports listen; 0.0.0.0 for all.", read_only=True
    )
    dashboard: int = parameter(
        29999, "Dashboard; 0, here and below: any free port.", low=0, high=65535, read_only=True
    )
    primary: int = parameter(30001, "Programs.", low=0, high=65535, read_only=True)
    secondary: int = parameter(30002, "Programs.", low=0, high=65535, read_only=True)
    realtime: int = parameter(30003, "Programs.", low=0, high=65535, read_only=True)
    rtde: int = parameter(30004, "RTDE.", low=0, high=65535, read_only=True)


class Ports:
    """All ports of a controller.

    Args:
        controller: Whose.
        network: Connections of its program.
        parameters: Where they are.

    Raises:
        ParameterError: One of them cannot be opened.
    """

    def __init__(
        self, controller: Controller, network: ProgramNetwork, parameters: UrPortParameters
    ) -> None:
        self._controller, self._network = controller, network
        self._played = controller.faults
        owners: dict[str, Session] = {}
        makers: dict[str, Callable[[], Client]] = {
            "dashboard": lambda: DashboardClient(controller),
            "primary": lambda: ScriptClient(controller, tells=True),
            "secondary": lambda: ScriptClient(controller, tells=True),
            "realtime": lambda: ScriptClient(controller, tells=False),
            "rtde": lambda: RtdeClient(controller, owners),
        }
        self._ports: dict[str, Port] = {}
        for name, make in makers.items():
            number = getattr(parameters, name)
            try:
                self._ports[name] = Port(parameters.address, number, make)
            except (OSError, UnicodeError) as error:
                self.close()
                raise ParameterError(f"ports.{name}", number, str(error)) from error

    @property
    def numbers(self) -> dict[str, int]:
        """Number of each port."""
        return {name: port.number for name, port in self._ports.items()}

    @property
    def clients(self) -> dict[str, int]:
        """Number of clients of each port."""
        return {name: len(port.connections) for name, port in self._ports.items()}

    def cycle(self, now: float) -> None:
        """Read, run the controller for a cycle at a time [s], and send."""
        faults = self._controller.faults
        self._play_faults()
        silent = set(self._ports) if faults.freeze_all else {"rtde"} if faults.freeze_rtde else ()
        served = [port for name, port in self._ports.items() if name not in silent]
        for port in served:
            port.read()
        self._controller.cycle(now)
        for port in served:
            port.write()

    def _play_faults(self) -> None:
        before, new = self._played, self._controller.faults
        self._played = new
        if new.drop_rtde and not before.drop_rtde:
            self._ports["rtde"].end(abortively=False)
        if new.reset_connections and not before.reset_connections:
            self._network.abort_all()
            for port in self._ports.values():
                port.end(abortively=True)
        for port in self._ports.values():
            if new.refuse_connections:
                port.refuse()
            elif before.refuse_connections:
                port.listen()

    def close(self) -> None:
        """Close all."""
        self._network.close_all()
        for port in self._ports.values():
            port.refuse()
            port.end(abortively=False)
