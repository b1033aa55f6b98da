"""Program text from a stream of bytes, and the messages sent on the same ports."""

import struct
import time

import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.simulation.ur import script_protocol
from omniman_ros.simulation.ur.script_protocol import ProgramReader, RobotState

PROGRAM = """def f():
  # an end in a comment: end
  textmsg("while if end")
  while True:
    if 1 == 2:
      sync()
    elif False:
      sync()
    else:
      sync()
    end
  end
  thread t():
    ended = 1
  end
end
"""


def test_program_is_complete_with_its_outermost_end():
    reader = ProgramReader()
    for line in PROGRAM.splitlines()[:-1]:
        assert reader.receive(line.encode() + b"\n") == []
    assert reader.receive(b"end\n") == [PROGRAM]


@pytest.mark.parametrize("size", [1, 2, 5, 64])
def test_bytes_may_arrive_in_any_pieces(size):
    data = (PROGRAM + "stopj(2)\n" + PROGRAM.replace("\n", "\r\n")).encode()
    reader, found = ProgramReader(), []
    for k in range(0, len(data), size):
        found += reader.receive(data[k : k + size])
    assert found == [PROGRAM, "stopj(2)\n", PROGRAM]


def test_single_line_is_a_program_unless_blank_or_a_comment():
    assert ProgramReader().receive(b"\n  \n# nothing\n  movej(q) # there\nx") == [
        "movej(q) # there\n"
    ]


def test_definition_in_one_line_is_complete():
    assert ProgramReader().receive(b"def f(): stopj(2) end\n") == ["def f(): stopj(2) end\n"]


@pytest.mark.parametrize("quote", ['"', "'"])
def test_string_that_does_not_end_is_read_once(quote):
    line = f"def f(): x = {quote}" + f"\\{quote}" * 20_000
    begin = time.process_time()
    assert script_protocol.depth(line) == 1
    assert time.process_time() - begin < 1.0


def test_string_ends_at_the_quote_where_the_grammar_ends_it():
    assert ProgramReader().receive(b'def f(): textmsg("\\") end\n') != []


@pytest.mark.parametrize("begin", [b"", b"def f():\n"])
def test_program_without_end_is_rejected(begin):
    reader = ProgramReader()
    reader.receive(begin)
    with pytest.raises(InputError):
        for _ in range(20):
            reader.receive(b"x" * 65536)


def test_version_message_is_framed_as_in_a_public_log():
    # Universal_Robots_Client_Library, tests/test_primary_parser.cpp, VERSION_MESSAGE.
    logged = bytes.fromhex(
        "00000037 14 0000000000000000 fe 03 09 5552436f6e74726f6c 05 18 00000000 00000000"
    )
    message = script_protocol.version_message((5, 24, 0, 0))
    size = struct.unpack(">i", message[:4])[0]
    assert size == len(message) == 0x37
    assert message[: len(logged)] == logged


STATE = RobotState(
    time=100.171031,
    powered=True,
    emergency_stopped=False,
    protective_stopped=False,
    playing=False,
    paused=False,
    robot_mode=7,
    slider=1.0,
    scaling=0.0,
    actual_q=(-1.6007, 1, 2, 3, 4, 5),
    target_q=(-1.6007, 1, 2, 3, 4, 5),
    actual_qd=(0,) * 6,
    current=(0,) * 6,
    joint_mode=253,
    pose=(1, 2, 3, 4, 5, 6),
)


def test_robot_state_is_framed_as_in_a_public_log():
    # ibid., ROBOT_STATE: sizes and types of its first packages.
    message = script_protocol.robot_state(STATE)
    assert struct.unpack(">iB", message[:5]) == (len(message), 16)
    found, at = [], 5
    while at < len(message):
        size, kind = struct.unpack(">iB", message[at : at + 5])
        found.append((kind, size))
        at += size
    assert found == [(0, 47), (1, 0xFB), (4, 0x65)]
    assert at == len(message)


def test_robot_state_has_the_modes_at_the_offsets_of_a_public_log():
    message = script_protocol.robot_state(STATE)
    # ibid.: time 100.171031 s of a UR5e; connected, enabled, on; nothing stopped or running.
    assert message[10:25] == bytes.fromhex("00 00 00 00 05 f8 7d 17 01 01 01 00 00 00 00")
    assert message[25:27] == bytes.fromhex("07 01")
