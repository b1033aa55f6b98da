"""The controller link over real local sockets, on a clock that the test sets."""

import contextlib
import os
import socket
from dataclasses import replace

import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.ur.controller_link import ControllerLink
from omniman_ros.ur.program_link import MAX_UNACKNOWLEDGED, ProgramState
from omniman_ros.ur.rtde_link import RECONNECT_DELAY
from omniman_ros.ur.sockets import LinkError
from test.ur import peer
from test.ur.peer import HOST, Clock, Peer, read, reset, turns

DIALOGUE = [
    (peer.ASK_VERSION, peer.VERSION),
    (peer.ASK_OUTPUTS, peer.OUTPUTS),
    (peer.ASK_START, peer.START),
]
ANSWERS = b"".join(answer for _, answer in DIALOGUE)
PROGRAM = "def p():\n  sleep(1)\nend\n"
SETPOINT = bytes(range(32))
SEVERAL = 20  #: Number of turns that suffice for any pending event to happen


@pytest.fixture
def controller():
    result = Peer()
    yield result
    result.close()


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def link(controller, clock):
    result = ControllerLink(controller.parameters(), clock)
    yield result
    result.close()


def talk(link, clock, controller, steps=3):
    """Connect and answer `steps` requests; return the controller's end."""
    link.tick(clock.now)
    turns(link, clock, lambda: link.address[0])
    end = controller.take(controller.rtde)
    for asked, answer in DIALOGUE[:steps]:
        assert received_bytes(link, clock, end, len(asked)) == asked
        end.sendall(answer)
    return end


def received_bytes(link, clock, end, size):
    """Serve the link and return the bytes that the controller receives from it."""
    got = bytearray()
    end.setblocking(False)

    def more():
        with contextlib.suppress(BlockingIOError):
            got.extend(end.recv(size - len(got)))
        return len(got) == size

    turns(link, clock, more)
    end.settimeout(10)
    return bytes(got)


def connect(link, clock, controller, timestamp=1.0):
    """Connect the link up to the first sample."""
    end = talk(link, clock, controller)
    end.sendall(peer.data(timestamp))
    turns(link, clock, lambda: link.connected)
    return end


def idle(link, clock):
    for _ in range(SEVERAL):
        link.tick(clock.now)
        link.wait(clock.now)


def run(link, clock, controller, receive_buffer=None):
    """Start a program and connect back; return the script port's and the program's end."""
    link.start_program(PROGRAM, clock.now)
    script = controller.take(controller.script)
    assert received_bytes(link, clock, script, len(PROGRAM)) == PROGRAM.encode()
    program = controller.call(link.address[1], receive_buffer=receive_buffer)
    turns(link, clock, lambda: link.program is ProgramState.RUNNING)
    return script, program


def ended(sock):
    """Return whether the other side has closed the connection with FIN."""
    return sock.recv(1) == b""


# ---- real-time data: connecting ---------------------------------------------------------------


def test_link_connects_by_itself_and_returns_each_sample_once(link, clock, controller):
    assert not link.connected
    assert link.blocking_reason == "not connected yet"
    assert link.sample is None
    end = connect(link, clock, controller)
    assert link.blocking_reason == ""
    assert link.sample.at == clock.now
    assert link.address[0] == HOST
    end.sendall(peer.data(1.008) + peer.data(1.016, read=3))
    turns(link, clock, lambda: link.sample.read == 3)
    assert [s.timestamp for s in link.take_samples()] == [1.0, 1.008, 1.016]
    assert link.take_samples() == []
    assert link.sample.timestamp == 1.016


def test_sockets_do_not_delay_small_packets(link, clock, controller):
    connect(link, clock, controller)
    run(link, clock, controller)
    for sock in (link._rtde._socket, link._program._reverse):
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        assert not sock.getblocking()


def test_dialogue_byte_by_byte_has_the_same_result(link, clock, controller):
    end = talk(link, clock, controller, 0)
    for asked, answer in DIALOGUE:
        assert received_bytes(link, clock, end, len(asked)) == asked
        for k in range(len(answer)):
            end.sendall(answer[k : k + 1])
            link.wait(clock.now)
    packet = peer.data(1.0)
    for k in range(len(packet)):
        assert not link.connected
        end.sendall(packet[k : k + 1])
        link.wait(clock.now)
    turns(link, clock, lambda: link.connected)


def test_data_received_with_the_start_answer_are_not_lost(link, clock, controller):
    end = talk(link, clock, controller, 2)
    end.sendall(peer.START + peer.data(1.0) + peer.data(1.008)[:100])
    turns(link, clock, lambda: link.connected)
    assert len(link.take_samples()) == 1


def test_text_messages_of_the_controller_are_kept(link, clock, controller):
    end = connect(link, clock, controller)
    end.sendall(peer.text(b"hello") + peer.data(1.008))
    turns(link, clock, lambda: link.sample.timestamp == 1.008)
    assert link.take_texts() == ["RTDE: hello"]
    assert link.take_texts() == []


# ---- real-time data: loss and reconnection ----------------------------------------------------


def back(link, clock, controller):
    """Assert that the link reconnects after a loss, and not before the reconnect delay."""
    since = clock.now
    clock.now = since + 0.99 * RECONNECT_DELAY
    idle(link, clock)
    assert link._rtde._socket is None
    clock.now = since + 1.01 * RECONNECT_DELAY
    connect(link, clock, controller, 0.5)
    assert link.sample.at == clock.now


def test_refused_connection_is_reported_and_retried(link, clock, controller):
    port = controller.rtde.getsockname()[1]
    controller.rtde.close()
    link.tick(clock.now)
    turns(link, clock, lambda: link.blocking_reason == "connection refused")
    controller.rtde = socket.socket()
    controller.rtde.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    controller.rtde.bind((HOST, port))
    controller.rtde.listen()
    controller.open.append(controller.rtde)
    back(link, clock, controller)


@pytest.mark.parametrize("steps", range(5))
@pytest.mark.parametrize("how", ["fin", "rst"])
def test_connection_closed_in_any_state_is_reported_and_reopened(
    link, clock, controller, steps, how
):
    end = talk(link, clock, controller, min(steps, 3))
    if steps < 3:
        received_bytes(
            link, clock, end, len(DIALOGUE[steps][0])
        )  # unread data would cause a reset
    if steps == 4:
        end.sendall(peer.data(1.0))
        turns(link, clock, lambda: link.connected)
    else:
        idle(link, clock)
    if how == "rst":
        reset(end)
    else:
        end.close()
    reason = {"fin": "closed by the controller", "rst": "reset"}[how]
    turns(link, clock, lambda: link.blocking_reason == reason)
    assert not link.connected
    back(link, clock, controller)


@pytest.mark.parametrize("steps", range(4))
def test_half_open_connection_is_dropped_in_any_state_and_retried(link, clock, controller, steps):
    end = talk(link, clock, controller, steps)
    idle(link, clock)
    end.sendall(peer.text(b"words are no answer"))
    clock.now += 1.99
    idle(link, clock)
    assert link._rtde._socket is not None
    clock.now += 0.02
    link.tick(clock.now)
    what = "no usable data" if steps == 3 else "no answer"
    assert link.blocking_reason == f"{what} for 2 s"
    back(link, clock, controller)


def test_connection_to_a_full_listener_times_out(controller, clock):
    with socket.socket() as full:
        full.bind((HOST, 0))
        full.listen(0)
        port = full.getsockname()[1]
        with socket.create_connection((HOST, port)):  # the only place in the queue
            link = ControllerLink(controller.parameters(rtde_port=port), clock)
            for step, blocking_reason in (
                (0.0, "not connected yet"),
                (1.99, "not connected yet"),
                (0.02, "no answer for 2 s"),
            ):
                clock.now += step
                idle(link, clock)
                assert link.blocking_reason == blocking_reason
            link.close()


def test_interrupted_data_are_detected_by_their_age_and_stay_old(link, clock, controller):
    connect(link, clock, controller)
    sample = link.sample
    clock.now += 0.079
    idle(link, clock)
    assert link.connected
    clock.now += 0.002
    assert not link.connected
    assert link.blocking_reason == "no data for 0.081 s"
    clock.now += 1.9
    idle(link, clock)
    assert link.blocking_reason == "no data for 1.981 s"
    clock.now += 0.03
    idle(link, clock)
    assert link.blocking_reason == "no usable data for 2 s"
    assert link.sample is sample
    back(link, clock, controller)


def test_data_that_resume_in_time_need_no_new_connection(link, clock, controller):
    end = connect(link, clock, controller)
    for k in range(4):
        clock.now += 1.5
        link.tick(clock.now)
        end.sendall(peer.data(2.5 + k))
        turns(link, clock, lambda: link.connected)
    assert link.counts["skipped"] == 4


@pytest.mark.parametrize("kind", ["repeated", "backward", "implausible"])
def test_unusable_data_do_not_keep_a_connection_alive(link, clock, controller, kind):
    end = connect(link, clock, controller)
    sample = link.sample
    useless = {
        "repeated": peer.data(1.0),
        "backward": peer.data(0.9),
        "implausible": peer.data(1.1, q=(7.0,) * 6),
    }[kind]
    for k in range(24):
        clock.now += 0.08
        end.sendall(useless)
        turns(link, clock, lambda k=k: link.counts[kind] == k + 1)
        link.tick(clock.now)
    assert not link.connected
    assert link.sample is sample
    assert link.take_samples() == [sample]
    clock.now += 0.1
    link.tick(clock.now)
    assert link.blocking_reason == "no usable data for 2 s"
    back(link, clock, controller)
    assert link.counts[kind] == 24


@pytest.mark.parametrize(
    ("steps", "answer", "reason"),
    [
        (0, peer.NO_VERSION, "version 2 of the protocol is refused"),
        (1, peer.outputs(peer.TYPES.replace(b"UINT32", b"NOT_FOUND")), "'runtime_state': NOT_F"),
        (1, peer.outputs(peer.TYPES.replace(b"UINT32", b"IN_USE")), "'runtime_state': IN_USE"),
        (2, peer.NO_START, "start of the data is refused"),
        (3, peer.data(1.0, number=9), "recipe 9"),
        (3, b"\x00\x01U", "a packet of 1 bytes"),
        (3, peer.VERSION, "is unexpected"),
    ],
)
def test_refusing_controller_is_reported_and_retried(
    link, clock, controller, steps, answer, reason
):
    end = talk(link, clock, controller, steps)
    if steps < 3:
        received_bytes(link, clock, end, len(DIALOGUE[steps][0]))
    end.sendall(answer)
    turns(link, clock, lambda: reason in link.blocking_reason)
    assert ended(end)
    back(link, clock, controller)


def test_set_up_is_repeated_at_once_without_a_missing_speed_slider(link, clock, controller):
    end = talk(link, clock, controller, 1)
    received_bytes(link, clock, end, len(peer.ASK_OUTPUTS))
    end.sendall(peer.outputs(peer.TYPES[:-12] + b"NOT_FOUND,INT32", 0))
    turns(link, clock, lambda: "target_speed_fraction" in link.blocking_reason)
    link.tick(clock.now)
    turns(link, clock, lambda: link._rtde.readers())
    end = controller.take(controller.rtde)
    assert received_bytes(link, clock, end, 5) == peer.ASK_VERSION
    end.sendall(peer.VERSION)
    asked = received_bytes(link, clock, end, len(peer.ASK_OUTPUTS) - len(",target_speed_fraction"))
    assert asked.endswith(b"speed_scaling,output_int_register_24")
    end.sendall(peer.outputs(peer.TYPES[:-12] + b"INT32") + peer.START)
    assert received_bytes(link, clock, end, 3) == peer.ASK_START
    old = peer.data(1.0, scaling=0.5)
    end.sendall(b"\x00\xe4" + old[2:-12] + old[-4:])
    turns(link, clock, lambda: link.connected)
    assert link.sample.speed_scaling == 0.5


def test_restarted_controller_causes_a_new_connection(link, clock, controller):
    end = connect(link, clock, controller, 500.0)
    end.sendall(peer.data(3.0))
    turns(link, clock, lambda: "went back" in link.blocking_reason)
    assert link.sample.timestamp == 500.0
    back(link, clock, controller)
    assert link.sample.timestamp == 0.5


def test_delayed_second_of_data_is_returned_up_to_the_newest_sample(link, clock, controller):
    end = connect(link, clock, controller)
    end.sendall(b"".join(peer.data(1.0 + 0.008 * k) for k in range(1, 126)))
    link.wait(clock.now)
    assert link.sample.timestamp == 2.0


# ---- waiting ----------------------------------------------------------------------------------


def hurried(link, clock, others):
    """Return a wait with a long timeout, on a clock that would still end the wait."""
    looks = iter(range(10))
    link._clock = lambda: clock.now + next(looks)
    return link.wait(clock.now + 5.0, others)


def test_expired_wait_polls_once_and_returns(link, clock, controller):
    end = connect(link, clock, controller)
    end.sendall(peer.data(1.008))
    assert link.wait(clock.now - 5.0) == []
    assert link.sample.timestamp == 1.008


def test_wait_ends_when_another_descriptor_is_readable(link, clock, controller):
    connect(link, clock, controller)
    pipes = [os.pipe() for _ in range(3)]
    fds = [out for out, _ in pipes]
    assert link.wait(clock.now, fds) == []
    os.write(pipes[2][1], b"x")
    os.write(pipes[0][1], b"x")
    assert hurried(link, clock, fds) == [fds[0], fds[2]]
    for pipe in pipes:
        for fd in pipe:
            os.close(fd)


def test_wait_serves_the_sockets_before_another_descriptor_ends_the_wait(link, clock, controller):
    end = connect(link, clock, controller)
    out, into = os.pipe()
    os.write(into, b"x")
    end.sendall(peer.data(1.008))
    assert hurried(link, clock, [out]) == [out]
    assert link.sample.timestamp == 1.008
    os.close(out)
    os.close(into)


def test_flood_of_data_does_not_prevent_a_wait_from_ending(link, clock, controller):
    end = connect(link, clock, controller)
    sent = 0
    ticks = iter(range(10**6))

    def time():
        nonlocal sent
        end.sendall(peer.data(1.0) * 50)
        sent += 1
        assert sent <= 105
        return clock.now + 0.001 * next(ticks)

    link._clock = time
    assert link.wait(clock.now + 0.1) == []


# ---- the program ------------------------------------------------------------------------------


def test_program_is_sent_and_connects_back(link, clock, controller):
    assert link.program is ProgramState.NONE
    assert not link.send(SETPOINT)
    script, program = run(link, clock, controller)
    assert link.program_loss_reason == ""
    assert ended(script)
    assert link.send(SETPOINT)
    assert read(program, 32) == SETPOINT


def test_running_program_does_not_time_out(link, clock, controller):
    run(link, clock, controller)
    clock.now += 1000.0
    idle(link, clock)
    assert link.program is ProgramState.RUNNING


def test_long_program_is_sent_as_fast_as_the_controller_reads(link, clock, controller):
    text = "x" * 10_000_000 + "\n"
    link.start_program(text, clock.now)
    script = controller.take(controller.script)
    for _ in range(SEVERAL):
        link.wait(clock.now)
    early = controller.call(link.address[1])
    turns(
        link, clock, lambda: link.refused_connections["unawaited"] == 1
    )  # the controller cannot have received the whole program
    assert ended(early)
    size = 0
    script.setblocking(False)
    while size < len(text):
        link.wait(clock.now)
        with contextlib.suppress(BlockingIOError):
            size += len(script.recv(1 << 20))
    controller.call(link.address[1])
    turns(link, clock, lambda: link.program is ProgramState.RUNNING)


def test_data_from_the_script_port_are_discarded(link, clock, controller):
    link.start_program(PROGRAM, clock.now)
    script = controller.take(controller.script)
    script.sendall(bytes(100_000))
    idle(link, clock)
    script.sendall(bytes(100_000))
    controller.call(link.address[1])
    turns(link, clock, lambda: link.program is ProgramState.RUNNING)


def test_missing_script_port_is_reported_at_once(controller, clock):
    link = ControllerLink(controller.parameters(script_port=peer.closed_port()), clock)
    link.start_program(PROGRAM, clock.now)
    turns(link, clock, lambda: link.program is ProgramState.LOST)
    assert link.program_loss_reason == "script port: connection refused"
    link.close()


def test_script_port_closed_during_the_upload_is_reported(link, clock, controller):
    link.start_program("x" * 10_000_000, clock.now)
    script = controller.take(controller.script)
    link.wait(clock.now)
    reset(script)
    turns(link, clock, lambda: link.program is ProgramState.LOST)
    assert link.program_loss_reason == "script port: reset"


@pytest.mark.parametrize("how", ["open", "fin", "rst"])
def test_program_that_does_not_connect_back_times_out(link, clock, controller, how):
    link.start_program(PROGRAM, clock.now)
    script = controller.take(controller.script)
    received_bytes(link, clock, script, len(PROGRAM))
    if how == "fin":
        script.close()
    if how == "rst":
        reset(script)
    idle(link, clock)
    clock.now += 1.99
    idle(link, clock)
    assert link.program is ProgramState.STARTING
    clock.now += 0.02
    idle(link, clock)
    assert link.program is ProgramState.LOST
    hint = {"open": "", "fin": "; script port: closed by the controller"}
    hint["rst"] = "; script port: reset"
    assert link.program_loss_reason == "the program has not connected within 2 s" + hint[how]
    late = controller.call(link.address[1])
    turns(link, clock, lambda: link.refused_connections["unawaited"] == 1)
    assert ended(late)
    assert link.program is ProgramState.LOST
    run(link, clock, controller)


def test_program_may_connect_back_after_the_script_port_closes(link, clock, controller):
    link.start_program(PROGRAM, clock.now)
    script = controller.take(controller.script)
    received_bytes(link, clock, script, len(PROGRAM))
    script.close()
    idle(link, clock)
    controller.call(link.address[1])
    turns(link, clock, lambda: link.program is ProgramState.RUNNING)


def test_half_open_script_port_times_out(link, clock, controller):
    link.start_program("x" * 10_000_000, clock.now)
    idle(link, clock)
    clock.now += 2.01
    idle(link, clock)
    assert link.program_loss_reason == "the program has not connected within 2 s"


def test_unexpected_connection_is_closed_and_counted(link, clock, controller):
    caller = controller.call(link.address[1])
    turns(link, clock, lambda: link.refused_connections["unawaited"] == 1)
    assert ended(caller)
    assert link.program is ProgramState.NONE


def test_connection_from_before_the_start_is_not_the_program(link, clock, controller):
    stale = controller.call(link.address[1])
    link.start_program(PROGRAM, clock.now)
    assert link.program is ProgramState.STARTING
    assert link.refused_connections["unawaited"] == 1
    assert ended(stale)


def test_connection_from_another_address_is_closed_counted_and_reported(link, clock, controller):
    link.start_program(PROGRAM, clock.now)
    script = controller.take(controller.script)
    received_bytes(link, clock, script, len(PROGRAM))
    stranger = controller.call(link.address[1], source="127.0.0.2")
    turns(link, clock, lambda: link.refused_connections["foreign"] == 1)
    assert ended(stranger)
    assert link.program is ProgramState.STARTING
    clock.now += 2.01
    link.tick(clock.now)
    assert link.program_loss_reason.endswith("; 127.0.0.2, which is not ur.host, tried to connect")
    link.start_program(PROGRAM, clock.now)
    clock.now += 2.01
    link.tick(clock.now)
    assert link.program_loss_reason == "the program has not connected within 2 s"


@pytest.mark.parametrize(("source", "kind"), [(HOST, "second"), ("127.0.0.2", "foreign")])
def test_second_connection_never_replaces_the_first(link, clock, controller, source, kind):
    _, program = run(link, clock, controller)
    other = controller.call(link.address[1], source=source)
    turns(link, clock, lambda: link.refused_connections[kind] == 1)
    assert ended(other)
    assert link.send(SETPOINT)
    assert read(program, 32) == SETPOINT


@pytest.mark.parametrize("how", ["fin", "rst"])
def test_end_of_the_program_is_detected(link, clock, controller, how):
    _, program = run(link, clock, controller)
    if how == "rst":
        reset(program)
    else:
        program.close()
    turns(link, clock, lambda: link.program is ProgramState.LOST)
    assert link.program_loss_reason == {"fin": "closed by the controller", "rst": "reset"}[how]
    assert not link.send(SETPOINT)
    run(link, clock, controller)
    assert link.program_loss_reason == ""


def test_lost_program_is_also_detected_by_sending(link, clock, controller):
    _, program = run(link, clock, controller)
    reset(program)
    while link.send(SETPOINT):
        os.sched_yield()
    assert link.program is ProgramState.LOST
    assert link.program_loss_reason == "reset"


def test_data_from_the_program_are_discarded(link, clock, controller):
    _, program = run(link, clock, controller)
    program.sendall(bytes(200_000))
    idle(link, clock)
    assert link.program is ProgramState.RUNNING


def test_unread_setpoints_do_not_block_and_end_the_program(link, clock, controller):
    """The receive buffer is minimal: only the controller's host can keep data to be read late."""
    _, program = run(link, clock, controller, receive_buffer=1)
    sent = 0
    while link.send(SETPOINT):
        sent += 1
        assert sent < 1000
    assert sent >= MAX_UNACKNOWLEDGED
    assert link.program is ProgramState.LOST
    assert link.program_loss_reason == "the controller accepts no more setpoints"
    assert not link.send(SETPOINT)
    got = b""
    with pytest.raises(
        ConnectionResetError
    ):  # data still queued here are discarded and not sent late
        while True:
            part = program.recv(1 << 20)
            assert part, "all setpoints were sent late"
            got += part


def test_partly_sent_message_is_the_last_one(link, clock, controller):
    run(link, clock, controller)
    assert not link.send(bytes(50_000_000))
    assert link.program is ProgramState.LOST
    assert not link.send(SETPOINT)


def test_ending_the_program_delivers_sent_data_and_then_closes(link, clock, controller):
    _, program = run(link, clock, controller)
    program.sendall(b"unread words")
    link.send(SETPOINT)
    link.end_program()
    assert link.program is ProgramState.NONE
    assert link.program_loss_reason == ""
    assert read(program, 32) == SETPOINT
    assert ended(program)
    assert not link.send(SETPOINT)
    run(link, clock, controller)


@pytest.mark.parametrize("state", ["starting", "running", "lost"])
def test_program_can_be_started_in_any_state(link, clock, controller, state):
    if state == "starting":
        link.start_program(PROGRAM, clock.now)
        controller.take(controller.script)
    else:
        _, program = run(link, clock, controller)
        if state == "lost":
            program.close()
            turns(link, clock, lambda: link.program is ProgramState.LOST)
    _, program = run(link, clock, controller)
    link.send(SETPOINT)
    assert read(program, 32) == SETPOINT


def test_empty_program_is_rejected(link, clock):
    with pytest.raises(InputError, match="program must not be empty"):
        link.start_program(" \n", clock.now)


def test_data_and_program_connections_are_lost_independently(link, clock, controller):
    end = connect(link, clock, controller)
    _, program = run(link, clock, controller)
    end.close()
    turns(link, clock, lambda: not link.connected)
    assert link.program is ProgramState.RUNNING
    assert link.send(SETPOINT)
    back(link, clock, controller)
    program.close()
    turns(link, clock, lambda: link.program is ProgramState.LOST)
    assert link.connected


# ---- addresses --------------------------------------------------------------------------------


def test_callback_address_is_the_configured_one_or_that_of_the_connection(link, clock, controller):
    assert link.address[0] == ""
    connect(link, clock, controller)
    host, port = link.address
    assert (host, port) == (HOST, link._program._listener.getsockname()[1])
    assert port > 0
    link.parameters = replace(link.parameters, reverse_host="10.1.2.3")
    assert link.address == ("10.1.2.3", port)


def test_occupied_port_is_reported(controller, clock):
    with peer.listener() as taken:
        port = taken.getsockname()[1]
        with pytest.raises(LinkError, match=rf"ur.reverse_port = {port} .*in use"):
            ControllerLink(controller.parameters(reverse_port=port), clock)


def test_port_is_free_after_closing_with_a_running_program(controller, clock):
    link = ControllerLink(controller.parameters(), clock)
    _, program = run(link, clock, controller)
    port = link.address[1]
    link.close()
    assert ended(program)
    program.close()
    link = ControllerLink(controller.parameters(reverse_port=port), clock)
    run(link, clock, controller)
    link.close()


def test_host_without_an_address_is_reported(controller, clock):
    with pytest.raises(LinkError, match=r"ur.host '300\.1\.1\.1' has no address"):
        ControllerLink(controller.parameters(host="300.1.1.1"), clock)


def test_close_closes_all_sockets_and_can_be_repeated(link, clock, controller):
    end = connect(link, clock, controller)
    _, program = run(link, clock, controller)
    link.close()
    link.close()
    assert ended(end)
    assert ended(program)
    with pytest.raises(ConnectionRefusedError):
        controller.call(link._program.port)
