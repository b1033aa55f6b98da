"""The dashboard client against a server in the same thread, driven by the client's clock."""

import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.stop import ResetRefusedError
from omniman_ros.ur.dashboard_client import MAX_LINE, call, unlock, unlock_for_reset
from omniman_ros.ur.parameters import UrParameters
from omniman_ros.ur.sockets import LinkError
from test.ur import peer
from test.ur.peer import HOST, reset

GREETING = b"Connected: Universal Robots Dashboard Server\n"
TOO_EARLY = (
    b"Cannot unlock protective stop until 5s after occurrence. "
    b"Always inspect cause of protective stop before unlocking"
)


class Server:
    """A clock that runs the server's next step each time the client reads the time.

    The client reads the time at its start, before connecting, and before each read and write.
    """

    def __init__(self, *steps, pace=1e-4):
        self.listener = peer.listener()
        self.port = self.listener.getsockname()[1]
        self.steps = list(steps)
        self.pace = pace
        self.looks = 0
        self.end = None
        self.asked = b""

    def __call__(self):
        self.looks += 1
        if self.looks > 2:
            if self.end is None:
                self.end, _ = self.listener.accept()
            step = self.steps[0] if len(self.steps) == 1 else self.steps.pop(0)
            step(self)
        return 100.0 + self.pace * self.looks

    def close(self):
        self.listener.close()
        if self.end is not None:
            self.end.close()


@pytest.fixture
def serve():
    servers = []

    def make(*steps, **options):
        servers.append(Server(*steps, **options))
        return servers[-1]

    yield make
    for server in servers:
        server.close()


def say(data):
    return lambda server: server.end.sendall(data)


def answer(data):
    """Return a step that reads a command to the end of its line and answers."""

    def step(server):
        line = b""
        server.end.settimeout(10)
        while not line.endswith(b"\n"):
            line += server.end.recv(1)
        server.asked += line
        server.end.sendall(data)

    return step


def nothing(server):
    pass


def fin(server):
    server.end.close()


def rst(server):
    reset(server.end)


def ask(server, *commands, timeout=10.0):
    return call(HOST, server.port, commands, timeout, server)


def test_each_command_and_each_reply_is_one_line(serve):
    server = serve(
        say(GREETING),
        nothing,
        answer(b"Robotmode: RUNNING\n"),
        nothing,
        answer(b"Safetymode: NORMAL\r\n"),
        nothing,
    )
    assert ask(server, "robotmode", "safetymode") == ["Robotmode: RUNNING", "Safetymode: NORMAL"]
    assert server.asked == b"robotmode\nsafetymode\n"
    assert server.end.recv(1) == b""  # closed


def test_lines_received_in_pieces_are_joined(serve):
    pieces = [say(GREETING[k : k + 1]) for k in range(len(GREETING))]
    server = serve(*pieces, nothing, answer(b"pl"), say(b"ay"), say(b"\n"), nothing)
    assert ask(server, "play") == ["play"]


def test_request_without_commands_checks_only_the_connection(serve):
    assert ask(serve(say(GREETING), nothing)) == []


@pytest.mark.parametrize(
    ("steps", "reason"),
    [
        ([nothing], "no answer within 0.05 s"),
        ([say(GREETING), nothing], "no answer within 0.05 s"),
        ([say(GREETING[:-1]), nothing], "no answer within 0.05 s"),
        ([fin], "closed by the controller"),
        ([rst], "reset"),
        ([say(GREETING), nothing, fin], "closed by the controller|reset"),
        ([say(GREETING), nothing, rst], "reset"),
        ([say(b"SSH-2.0\n"), nothing], "'SSH-2.0' is not the greeting"),
        ([say(b"\xff\x00\n"), nothing], "is not the greeting"),
        ([say(b"\n"), nothing], "'' is not the greeting"),
        ([say(GREETING + b"more\n"), nothing], "without a command"),
        ([say(b"x" * 200)], f"a line must be at most {MAX_LINE} bytes"),
        ([say(GREETING), nothing, answer(b"x" * 200), say(b"x" * 200)], "a line must be at most"),
    ],
)
def test_server_fault_raises_an_error_with_the_reason(serve, steps, reason):
    with pytest.raises(LinkError, match=reason):
        ask(serve(*steps), "play", timeout=0.05)


def test_dripping_bytes_do_not_extend_the_timeout(serve):
    server = serve(say(b"x"), pace=0.1)
    with pytest.raises(LinkError, match="no answer within 10 s"):
        ask(server, "play", timeout=10.0)
    assert 95 < server.looks < 105


def test_slow_replies_share_one_timeout(serve):
    steps = [say(GREETING), nothing] + [answer(b"ok\n"), nothing] * 9
    server = serve(*steps, pace=1.0)
    with pytest.raises(LinkError, match="no answer within 10 s"):
        ask(server, *["play"] * 9, timeout=10.0)


def test_missing_server_raises_an_error():
    with pytest.raises(LinkError, match="dashboard: connection refused"):
        call(HOST, peer.closed_port(), ["play"], 1.0)


@pytest.mark.parametrize("command", ["", " ", "play\n", "play\nstop", "\x00", "spiel ä"])
def test_command_must_be_a_single_line(command):
    with pytest.raises(InputError, match="must be one line"):
        call(HOST, 1, [command], 1.0)


@pytest.mark.parametrize("timeout", [0.0, -1.0, float("nan"), float("inf")])
def test_invalid_timeout_is_rejected(timeout):
    with pytest.raises(InputError, match="timeout"):
        call(HOST, 1, ["play"], timeout)


def unlocking(serve, reply):
    return serve(say(GREETING), nothing, answer(b"closing safety popup\n"), nothing, answer(reply))


@pytest.mark.parametrize(
    ("reply", "refusal"),
    [
        (b"Protective stop releasing\n", ""),
        (TOO_EARLY + b"\n", TOO_EARLY.decode()),
        (b"could not understand: 'unlock protective stop'\n", "could not understand: 'unlock"),
        (b"\n", "an empty reply"),
    ],
)
def test_unlocking_closes_the_popup_first_and_returns_a_refusal(serve, reply, refusal):
    server = unlocking(serve, reply)
    said = unlock(UrParameters(dashboard_port=server.port), server)
    assert said.startswith(refusal) if refusal else said == ""
    assert server.asked == b"close safety popup\nunlock protective stop\n"


def test_reset_unlocks_only_where_that_is_allowed():
    with pytest.raises(ResetRefusedError, match=r"unlock it on the pendant \(or set ur.unlock\)"):
        unlock_for_reset(UrParameters())


def test_reset_is_granted_if_the_controller_unlocks(serve):
    server = unlocking(serve, b"Protective stop releasing\n")
    unlock_for_reset(UrParameters(dashboard_port=server.port, unlock=True), server)
    assert server.asked.endswith(b"unlock protective stop\n")


def test_reset_is_refused_in_the_words_of_the_controller(serve):
    server = unlocking(serve, TOO_EARLY + b"\n")
    with pytest.raises(
        ResetRefusedError, match="the controller reports: Cannot unlock protective"
    ):
        unlock_for_reset(UrParameters(dashboard_port=server.port, unlock=True), server)


def test_reset_without_a_dashboard_server_is_refused():
    with peer.listener() as free:
        port = free.getsockname()[1]
    with pytest.raises(ResetRefusedError, match="the dashboard server: dashboard: connection ref"):
        unlock_for_reset(UrParameters(dashboard_port=port, unlock=True))
