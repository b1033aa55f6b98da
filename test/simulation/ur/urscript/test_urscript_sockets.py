import math
import struct

import pytest

from test.simulation.ur.urscript.scripted_host import Bench, fault_of, ran

OPEN = 'socket_open("10.0.0.2", 50001, "s")\n'
PAIR = struct.pack(">2i", -5, 2**31 - 1)


def reading(function, timeout=0.04, count="2, "):
    return Bench(f'{OPEN}sync()\na = {function}({count}"s", {timeout})\ntextmsg("read")')


def test_numbers_are_signed_32_bit_big_endian_behind_their_count():
    bench = reading("socket_read_binary_integer").step()
    bench.host.received["s"] = PAIR + b"\0"
    bench.step()
    assert bench.machine.variables["a"] == (2, -5, 2**31 - 1) and bench.end == "completed"


def test_bytes_are_read_as_a_list():
    bench = reading("socket_read_byte_list").step()
    bench.host.received["s"] = b"\xff\x01"
    assert bench.step().machine.variables["a"] == (2, 255, 1)


def test_a_read_of_what_has_come_takes_no_time():
    bench = Bench(OPEN + 'sync()\nwhile socket_read_byte_list(1, "s")[0] == 1:\n  textmsg(1)\nend')
    bench.step()
    bench.host.received["s"] = b"abc"
    assert bench.step().log == ["1", "1", "1"]


@pytest.mark.parametrize("cut", range(8))
def test_a_split_read_waits_for_its_last_byte(cut):
    bench = reading("socket_read_binary_integer").step()
    bench.host.received["s"] = PAIR[:cut]
    assert not bench.step(3).log
    bench.host.received["s"] += PAIR[cut:]
    bench.step()
    assert bench.machine.variables["a"] == (2, -5, 2**31 - 1)


@pytest.mark.parametrize("timeout, cycles", [(0.02, 3), (0.04, 5), (2, 250)])
def test_a_read_times_out_and_gives_no_numbers(timeout, cycles):
    bench = reading("socket_read_binary_integer", timeout).step()
    assert not bench.step(cycles).log
    assert bench.step().log == ["read"]
    assert bench.machine.variables["a"] == (0, -1, -1)


@pytest.mark.parametrize("start", range(30, 60))
def test_a_read_times_out_in_the_same_cycle_at_any_time(start):
    bench = reading("socket_read_binary_integer", 0.024)
    bench.host.ticks = start
    assert not bench.step(4).log
    assert bench.step().log == ["read"]


def test_a_read_times_out_after_2_s_unless_told():
    bench = Bench(OPEN + 'a = socket_read_binary_integer(1, "s")').step(250)
    assert bench.machine.running
    assert not bench.step().machine.running


@pytest.mark.parametrize("timeout", [0, -1, 0.0])
def test_a_time_out_of_zero_waits_for_ever(timeout):
    bench = reading("socket_read_binary_integer", timeout).step(2000)
    assert bench.machine.running and not bench.log
    bench.host.received["s"] = PAIR
    assert bench.step().log == ["read"]


def test_what_comes_in_the_cycle_of_the_time_out_is_read():
    bench = reading("socket_read_binary_integer", 0.04).step(6)
    bench.host.received["s"] = PAIR
    bench.step()
    assert bench.machine.variables["a"][0] == 2


def test_a_read_that_timed_out_loses_no_bytes():
    text = (
        OPEN
        + 'a = socket_read_binary_integer(2, "s", 0.016)\nb = socket_read_binary_integer(2, "s")'
    )
    bench = Bench(text).step()
    bench.host.received["s"] = PAIR[:5]
    bench.step(3)
    bench.host.received["s"] += PAIR[5:]
    bench.step()
    assert bench.machine.variables["a"] == (0, -1, -1)
    assert bench.machine.variables["b"] == (2, -5, 2**31 - 1)


@pytest.mark.parametrize(
    "function, failed",
    [
        ("socket_read_binary_integer", "[0, -1, -1]"),
        ("socket_read_byte_list", "[0, -1, -1]"),
        ("socket_read_ascii_float", "[0, nan, nan]"),
    ],
)
def test_a_read_of_a_closed_socket_fails_at_once(function, failed):
    assert ran(f'textmsg({function}(2, "none", 0))').log == [failed]
    bench = Bench(f'{OPEN}textmsg({function}(2, "s", 0))').step(3)
    del bench.host.received["s"]
    assert bench.step().log == [failed]


def test_reading_a_closed_socket_in_a_loop_is_an_endless_loop():
    assert ran('while True:\n  socket_read_byte_list(1, "s", 0)\nend').end.endswith(
        "infinite loop"
    )


def test_a_waiting_read_holds_only_its_thread():
    bench = Bench(
        f'thread t():\n  a = socket_read_byte_list(1, "s", 0)\nend\n{OPEN}run t()\n'
        "while True:\n  textmsg(1)\n  sync()\nend"
    )
    assert [bench.step().log for _ in range(3)] == [["1"]] * 3


def test_ascii_numbers_stand_in_brackets():
    bench = reading("socket_read_ascii_float").step()
    bench.host.received["s"] = b"(1.5, "
    assert not bench.step(2).log
    bench.host.received["s"] += b"-2e3)(7,8)"
    bench.step()
    assert bench.machine.variables["a"] == (2, 1.5, -2000.0)


@pytest.mark.parametrize("data", [b"(1)", b"(1,2,3)", b"(a,b)", b")", b"1,"])
def test_other_ascii_numbers_are_a_failed_read(data):
    bench = reading("socket_read_ascii_float").step()
    bench.host.received["s"] = data
    bench.step(6)
    count, *rest = bench.machine.variables["a"]
    assert count == 0 and all(map(math.isnan, rest)) and len(rest) == 2


def test_lines_are_read_whole_and_kept_over_a_time_out():
    text = OPEN + "\n".join(
        f'{name} = socket_read_line("s", {timeout})'
        for name, timeout in zip("abcd", (0.016, 1, 1, 1), strict=True)
    )
    bench = Bench(text).step()
    bench.host.received["s"] = b"on"
    bench.step(3)
    bench.host.received["s"] = b"e\r\ntwo\nthree"
    bench.step()
    found = bench.machine.variables
    assert (found["a"], found["b"], found["c"]) == ("", "one", "two")
    bench.host.received["s"] = b"\n"
    assert bench.step().machine.variables["d"] == "three"


def test_bytes_behind_a_line_go_to_the_next_read_of_any_kind():
    text = OPEN + 'a = socket_read_line("s", 0.016)\nb = socket_read_binary_integer(2, "s")'
    bench = Bench(text).step()
    bench.host.received["s"] = PAIR[:3]
    bench.step(3)
    bench.host.received["s"] = PAIR[3:]
    assert bench.step().machine.variables["b"] == (2, -5, 2**31 - 1)


def test_a_string_is_what_has_come():
    bench = reading("socket_read_string", count="").step()
    assert not bench.step(2).log
    bench.host.received["s"] = b"ab\n\xe9"
    assert bench.step().machine.variables["a"] == "ab\n\xe9"


def test_sends_go_out_in_their_encoding_and_tell_whether_they_did():
    text = (
        OPEN
        + """
a = [socket_send_int(-2, "s"), socket_send_byte(255, "s"), socket_send_string("x", "s")]
b = [socket_send_line([1, 0.5], "s"), socket_send_line(1, "none")]
while True:
  sync()
end
"""
    )
    bench = ran(text)
    assert bench.host.sent["s"] == b"\xff\xff\xff\xfe\xffx[1, 0.5]\n"
    assert bench.machine.variables["a"] == (True, True, True)
    assert bench.machine.variables["b"] == (True, False)


def test_a_socket_has_a_default_name():
    bench = ran('socket_open("h", 1)\nsocket_send_byte(1)\nsocket_close()')
    assert bench.host.calls == [("open", "h", 1, "socket_0"), ("close", "socket_0")]


def test_a_refused_connection_is_false():
    bench = Bench('a = socket_open("h", 1)')
    bench.host.refused = True
    assert bench.step().machine.variables["a"] is False
    assert bench.host.calls == [("open", "h", 1, "socket_0")]


@pytest.mark.parametrize("end", ["", "halt", "a = 1 / 0"])
def test_the_end_of_a_program_closes_its_sockets(end):
    bench = ran(
        f'socket_open("h", 1, "b")\nsocket_open("h", 2, "a")\nsocket_open("h", 3, "c")\n'
        f'socket_close("c")\n{end}'
    )
    assert bench.host.calls[-3:] == [("close", "c"), ("close", "a"), ("close", "b")]


def test_a_socket_that_is_opened_again_starts_empty():
    text = OPEN + 'a = socket_read_line("s", 0.016)\n' + OPEN + 'b = socket_read_line("s")'
    bench = Bench(text).step()
    bench.host.received["s"] = b"old"
    bench.step(3)
    bench.host.received["s"] = b"new\n"
    assert bench.step().machine.variables["b"] == "new"


@pytest.mark.parametrize(
    "call, reason",
    [
        ("socket_read_binary_integer(31)", "31 numbers cannot be read at once, only 1 to 30"),
        ("socket_read_binary_integer(0)", "0 numbers cannot be read at once, only 1 to 30"),
        ("socket_send_byte(256)", "256 is no byte"),
        ("socket_send_int(0.5)", "value is no whole number but 0.5"),
        ('socket_open("h", "p")', "port is no number but string p"),
        ("socket_open(1, 2)", "address is no string but int 1"),
    ],
)
def test_arguments_that_cannot_be_are_runtime_errors(call, reason):
    assert fault_of(call) == (1, reason)
