"""The ports on real sockets with stepped cycles: no test waits for time to pass."""

import select
import socket
import struct
from itertools import pairwise

import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.ur.arm import CYCLE, UrArmParameters
from omniman_ros.simulation.ur.controller_server import ControllerServer
from omniman_ros.simulation.ur.faults import UrFaultParameters
from omniman_ros.simulation.ur.modes import Cb3RuntimeState
from omniman_ros.simulation.ur.port_parameters import UrPortParameters

ANSWER = 5.0  #: Time limit for the kernel to deliver data over the loopback [s]
FREE = dict.fromkeys(("dashboard", "primary", "secondary", "realtime", "rtde"), 0)
HELLO = b"\x00\x05V\x00\x02"
SETUP = struct.pack(">HBd", 11 + 9, ord("O"), 125.0) + b"timestamp"
START = b"\x00\x03S"
DATA = 3 + 1 + 8
STATE = 5 + 47 + 0xFB + 0x65  #: Sizes of a data package and of a robot state [bytes]


class Rig:
    def __init__(self):
        self.server = ControllerServer(UrArmParameters(), UrPortParameters(**FREE))
        self.controller, self.ports = self.server.controller, self.server.ports
        self.cycles, self.open = 0, []

    def close(self):
        for each in self.open:
            each.close()
        self.server.close()

    def faults(self, **faults):
        self.controller.faults = UrFaultParameters(**faults)

    def cycle(self, count=1):
        for _ in range(count):
            self.cycles += 1
            self.ports.cycle(50.0 + self.cycles * CYCLE)

    def connect(self, name):
        client = socket.create_connection(("127.0.0.1", self.ports.numbers[name]), ANSWER)
        self.open.append(client)
        self.cycle()
        return client

    def say(self, client, data):
        """Send data and run a cycle once the kernel has delivered them."""
        client.sendall(data)
        self.cycle()

    def hear(self, client, count):
        """Return `size` bytes, running cycles until they have arrived."""
        found = b""
        for _ in range(2000):
            if len(found) >= count:
                return found
            if select.select([client], [], [], 0.001)[0]:
                more = client.recv(count - len(found))
                assert more, f"closed after {found!r}"
                found += more
            else:
                self.cycle()
        raise AssertionError(f"only {found!r}")

    def stream(self):
        """Return an RTDE client that receives data, and a first package."""
        client = self.connect("rtde")
        self.say(client, HELLO + SETUP + START)
        self.hear(client, 4 + 10 + 4)
        return client

    def waits(self, client):
        """Return the bytes received without running a cycle."""
        client.setblocking(False)
        try:
            return client.recv(65536)
        except BlockingIOError:
            return None
        finally:
            client.settimeout(ANSWER)

    def ends(self, client):
        """Return how the connection ends: "FIN" or "RST"."""
        try:
            while client.recv(65536):
                pass
        except ConnectionResetError:
            return "RST"
        return "FIN"


@pytest.fixture
def rig():
    made = Rig()
    yield made
    made.close()


def timestamps(data):
    assert len(data) % DATA == 0
    return [struct.unpack(">d", data[k + 4 : k + DATA])[0] for k in range(0, len(data), DATA)]


def test_data_arrive_once_per_cycle(rig):
    client = rig.stream()
    rig.waits(client)
    rig.cycle(5)
    times = timestamps(rig.hear(client, 5 * DATA))
    assert [b - a for a, b in pairwise(times)] == pytest.approx([CYCLE] * 4)


def test_several_clients_are_served(rig):
    clients = [rig.stream() for _ in range(3)]
    for each in clients:
        assert rig.hear(each, DATA)
    assert rig.ports.clients["rtde"] == 3
    clients.pop().close()
    for _ in range(200):
        rig.cycle()
    assert rig.ports.clients["rtde"] == 2


def test_client_that_sends_garbage_is_closed_and_others_stay(rig):
    good, bad = rig.stream(), rig.connect("rtde")
    bad.sendall(b"GET / HTTP/1.1\r\n\r\n")
    for _ in range(100):
        rig.cycle()
    assert rig.ends(bad) in ("FIN", "RST")
    assert rig.hear(good, DATA)


def test_slow_rtde_reader_is_dropped_without_delaying_a_cycle(rig):
    client = socket.socket()
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    client.connect(("127.0.0.1", rig.ports.numbers["rtde"]))
    rig.open.append(client)
    names = b",".join(b"output_double_register_%d" % k for k in range(48))
    setup = struct.pack(">HBd", 11 + len(names), ord("O"), 125.0) + names
    client.sendall(HELLO + setup + START)
    for _ in range(60000):
        rig.cycle()
        if rig.cycles > 100 and rig.ports.clients["rtde"] == 0:
            break
    assert rig.ports.clients["rtde"] == 0


def test_program_arrives_and_its_end_is_reported(rig):
    client = rig.connect("secondary")
    assert rig.hear(client, 0x37)[4] == 20
    client.sendall(b"def f():\n  write_output_integer_register(3, 7)\n  sync()\n  sync()\nend\n")
    seen = set()
    for _ in range(200):
        rig.cycle()
        seen.add(rig.controller.runtime)
    assert seen == {Cb3RuntimeState.STOPPED, Cb3RuntimeState.PLAYING}
    assert rig.controller.end_reason == "completed"
    assert rig.controller.output("output_int_register_3") == 7


def test_script_client_that_does_not_read_is_kept_and_misses_messages(rig):
    client = rig.connect("primary")
    (connection,) = rig.ports._ports["primary"].connections
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
    rig.cycle(5000)
    assert rig.ports.clients["primary"] == 1
    assert 0 < len(connection._pending) <= STATE


def test_robot_state_is_sent_ten_times_per_second(rig):
    client = rig.connect("primary")
    rig.hear(client, 0x37)
    rig.waits(client)
    rig.cycle(125)
    data = rig.waits(client)
    assert len(data) in (10 * STATE, 11 * STATE)
    assert data[:5] == struct.pack(">iB", STATE, 16)


def test_dashboard_answers(rig):
    client = rig.connect("dashboard")
    greeting = b"Connected: Universal Robots Dashboard Server\n"
    assert rig.hear(client, len(greeting)) == greeting
    client.sendall(b"robotmode\nquit\n")
    reply = b"Robotmode: RUNNING\nDisconnected\n"
    assert rig.hear(client, len(reply)) == reply
    rig.cycle(2)
    assert rig.ends(client) == "FIN"


PROGRAM = """def f():
  if socket_open("127.0.0.1", {port}, "s"):
    while True:
      x = socket_read_binary_integer(2, "s", 0.02)
      if x[0] == 0:
        halt
      end
      write_output_integer_register(0, x[1])
      sync()
    end
  end
end
"""


@pytest.fixture
def reverse(rig):
    """Return a program that has connected back, and the test's end of its connection."""
    listening = socket.create_server(("127.0.0.1", 0))
    client = rig.connect("secondary")
    client.sendall(PROGRAM.format(port=listening.getsockname()[1]).encode())
    for _ in range(200):
        rig.cycle()
        if select.select([listening], [], [], 0)[0]:
            break
    ours, _ = listening.accept()
    ours.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    rig.open += [listening, ours]
    return ours


def test_program_reads_one_message_per_step_and_the_rest_stays_in_the_kernel(rig, reverse):
    reverse.sendall(b"".join(struct.pack(">ii", k, 0) for k in range(1, 11)))
    seen = []
    for _ in range(12):
        rig.cycle()
        seen.append(rig.controller.output("output_int_register_0"))
        assert not any(rig.server.network._buffered.values())
    assert seen[-1] == 10 or seen == sorted(seen)
    assert all(b - a <= 1 for a, b in pairwise(seen))
    rig.cycle(5)
    assert rig.controller.runtime is Cb3RuntimeState.STOPPED  # the read timed out in the end


# ---- faults -----------------------------------------------------------------------------------


@pytest.mark.parametrize("fault", ["freeze_rtde", "freeze_all"])
def test_frozen_stream_is_half_open(rig, fault):
    client = rig.stream()
    rig.faults(**{fault: True})
    rig.cycle()
    rig.waits(client)
    rig.cycle(50)
    assert rig.waits(client) is None
    assert rig.ports.clients["rtde"] == 1
    rig.faults()
    assert rig.hear(client, DATA)


@pytest.mark.parametrize(("fault", "how"), [("drop_rtde", "FIN"), ("reset_connections", "RST")])
def test_connections_are_ended_once_and_can_be_reopened(rig, fault, how):
    client = rig.stream()
    rig.faults(**{fault: True})
    rig.cycle()
    assert rig.ends(client) == how
    assert rig.hear(rig.stream(), DATA)


def test_connection_reset_includes_the_connection_of_the_program(rig, reverse):
    rig.faults(reset_connections=True)
    rig.cycle(5)
    assert rig.ends(reverse) == "RST"
    assert rig.controller.runtime is Cb3RuntimeState.STOPPED


def test_connections_are_refused_and_then_accepted_at_the_same_port(rig):
    client, numbers = rig.stream(), rig.ports.numbers
    rig.faults(refuse_connections=True)
    rig.cycle()
    with pytest.raises(ConnectionRefusedError):
        rig.connect("rtde")
    assert rig.hear(client, DATA)
    rig.faults()
    rig.cycle()
    assert rig.ports.numbers == numbers
    assert rig.hear(rig.stream(), DATA)


@pytest.mark.parametrize("cut", range(1, DATA))
def test_packages_are_split_at_any_byte(rig, cut):
    client = rig.stream()
    rig.waits(client)
    rig.faults(split_at=cut)
    rig.cycle()
    assert len(rig.hear(client, cut)) == cut
    assert rig.waits(client) is None
    rig.cycle()
    assert len(rig.hear(client, DATA)) == DATA


def test_occupied_port_is_reported():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        with pytest.raises(ParameterError, match=rf"ports.rtde.*{number}"):
            ControllerServer(UrArmParameters(), UrPortParameters(**(FREE | {"rtde": number})))
