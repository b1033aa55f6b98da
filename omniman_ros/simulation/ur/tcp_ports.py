"""TCP ports of the controller: non-blocking sockets that are served once per cycle."""

import socket
from collections.abc import Callable

from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.simulation.ur.controller import Cb3Controller
from omniman_ros.simulation.ur.port_clients import (
    DashboardClient,
    PortClient,
    RtdeClient,
    ScriptClient,
)
from omniman_ros.simulation.ur.port_parameters import UrPortParameters
from omniman_ros.simulation.ur.program_sockets import CHUNK, ProgramSockets, abort, prepare
from omniman_ros.simulation.ur.rtde_server import RtdeError, RtdeServerSession

MAX_CLIENTS = 20  #: Largest number of clients of a port


class Connection:
    """Connection of one client."""

    def __init__(self, connection: socket.socket, client: PortClient) -> None:
        prepare(connection)
        self._socket, self.client = connection, client
        self._pending = client.greeting()
        self.open = True  #: Whether the connection is open

    def read(self) -> None:
        """Pass received bytes to the client."""
        try:
            data = self._socket.recv(CHUNK)
            if not data:
                self.close()
                return
            self._pending += self.client.receive(data)
        except BlockingIOError:
            pass
        except (OSError, InputError, RtdeError):
            self.close()

    def write(self) -> None:
        """Send the bytes of this cycle; a client that does not read misses them or is dropped."""
        new_bytes = self.client.cycle()
        # A patient client receives whole packages: new ones are dropped until the last is sent.
        if new_bytes and not (self.client.patient and self._pending):
            self._pending += new_bytes
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
        """Close with FIN; unsent bytes are lost."""
        self._end(lambda: self._socket.close())

    def abort(self) -> None:
        """Close with RST."""
        self._end(lambda: abort(self._socket))

    def _end(self, how: Callable[[], None]) -> None:
        if self.open:
            self.open = False
            how()
            self.client.close()


class TcpPort:
    """One listening port and its clients; an OSError says that it is not available."""

    def __init__(self, address: str, number: int, make: Callable[[], PortClient]) -> None:
        self._address, self._make = address, make
        self._listening: socket.socket | None = None
        self.number = number  #: Number of the port
        self.connections: list[Connection] = []  #: Connections of the clients
        self.listen()

    def listen(self) -> None:
        """Listen; do nothing if the port listens already."""
        if self._listening is not None:
            return
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind((self._address, self.number))
            listening.listen(MAX_CLIENTS)
            listening.setblocking(False)
        except OSError:
            listening.close()
            raise
        self.number = int(listening.getsockname()[1])
        self._listening = listening

    def refuse(self) -> None:
        """Stop listening; connections stay."""
        if self._listening is not None:
            self._listening.close()
            self._listening = None

    def read(self) -> None:
        """Accept waiting clients, and process received bytes."""
        while self._listening is not None and len(self.connections) < MAX_CLIENTS:
            try:
                accepted, _ = self._listening.accept()
            except OSError:
                break
            self.connections.append(Connection(accepted, self._make()))
        for connection in self.connections:
            connection.read()
        self._drop_closed()

    def write(self) -> None:
        """Send the bytes of this cycle to all clients."""
        for connection in self.connections:
            if connection.open:
                connection.write()
        self._drop_closed()

    def end(self, abortively: bool) -> None:
        """Close all connections, with RST or with FIN."""
        for connection in self.connections:
            connection.abort() if abortively else connection.close()
        self._drop_closed()

    def _drop_closed(self) -> None:
        self.connections = [connection for connection in self.connections if connection.open]


class ControllerPorts:
    """All ports of a controller; a ParameterError names one that is not available."""

    def __init__(
        self, controller: Cb3Controller, network: ProgramSockets, parameters: UrPortParameters
    ) -> None:
        self._controller, self._network = controller, network
        self._last_faults = controller.faults
        owners: dict[str, RtdeServerSession] = {}
        makers: dict[str, Callable[[], PortClient]] = {
            "dashboard": lambda: DashboardClient(controller),
            "primary": lambda: ScriptClient(controller, sends_state=True),
            "secondary": lambda: ScriptClient(controller, sends_state=True),
            "realtime": lambda: ScriptClient(controller, sends_state=False),
            "rtde": lambda: RtdeClient(controller, owners),
        }
        self._ports: dict[str, TcpPort] = {}
        for name, make in makers.items():
            number = getattr(parameters, name)
            try:
                self._ports[name] = TcpPort(parameters.address, number, make)
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
        """Read, run the controller for one cycle at time `now` [s], and send.

        While the controller boots, nobody is served.
        """
        if self._controller.is_booting:
            self._controller.cycle(now)
            return
        faults = self._controller.faults
        self._apply_faults()
        silent = set(self._ports) if faults.freeze_all else {"rtde"} if faults.freeze_rtde else ()
        served = [port for name, port in self._ports.items() if name not in silent]
        for port in served:
            port.read()
        self._controller.cycle(now)
        for port in served:
            port.write()

    def _apply_faults(self) -> None:
        last, new = self._last_faults, self._controller.faults
        self._last_faults = new
        if new.drop_rtde and not last.drop_rtde:
            self._ports["rtde"].end(abortively=False)
        if new.reset_connections and not last.reset_connections:
            self._network.abort_all()
            for port in self._ports.values():
                port.end(abortively=True)
        for port in self._ports.values():
            if new.refuse_connections:
                port.refuse()
            elif last.refuse_connections:
                port.listen()

    def close(self) -> None:
        """Close all ports and connections."""
        self._network.close_all()
        for port in self._ports.values():
            port.refuse()
            port.end(abortively=False)
