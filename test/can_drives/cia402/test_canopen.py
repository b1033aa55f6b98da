"""Frames of CANopen against bytes from public documents, and round trips."""

import struct

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from omniman_ros.can_drives.cia402 import canopen
from omniman_ros.can_drives.cia402.canopen import Emergency, Entry, NmtCommand, NmtState, SdoAnswer
from omniman_ros.can_drives.cia402.sdo import (
    ATTEMPTS,
    TIMEOUT,
    SdoDialogue,
    SdoError,
    read,
    try_write,
    write,
)
from omniman_ros.core.errors import InputError

fixed = hypothesis_settings(deadline=None, derandomize=True, max_examples=300)

RANGES = {
    "b": (-128, 127),
    "B": (0, 255),
    "h": (-32768, 32767),
    "H": (0, 65535),
    "i": (-(2**31), 2**31 - 1),
    "I": (0, 2**32 - 1),
}
entries = st.builds(
    Entry,
    st.integers(0, 0xFFFF),
    st.integers(0, 0xFF),
    st.sampled_from(sorted(RANGES)),
    st.just("an entry"),
)


@st.composite
def values(draw):
    entry = draw(entries)
    return entry, draw(st.integers(*RANGES[entry.format]))


def hexed(frame):
    return str(frame)


# Festo, "CANopen access procedure" of GDCP-CMMS/D-C-CO-EN 1404NH, page 20
MODE_DISPLAY = Entry(0x6061, 0, "b", "")
STATUSWORD = Entry(0x6041, 0, "H", "")
FESTO_6093 = Entry(0x6093, 1, "I", "")


@pytest.mark.parametrize(
    "entry, value, frame",
    [
        (Entry(0x1401, 2, "B", ""), 0xEF, "601#2F011402EF000000"),
        (Entry(0x6040, 0, "H", ""), 0x03E8, "601#2B406000E8030000"),
        (FESTO_6093, 0x12345678, "601#2393600178563412"),
        # ICP DAS, CAN-8x23 user's manual rev. 3.20, page 136: RPDO6 gets COB-id 0x202
        (Entry(0x1405, 1, "I", ""), 0x202, "601#2305140102020000"),
        # page 137: 6200:01, 8 bits, is mapped
        (Entry(0x1605, 1, "I", ""), 0x62000108, "601#2305160108010062"),
    ],
)
def test_writes_match_the_manuals(entry, value, frame):
    assert hexed(canopen.download(1, entry, value)) == frame


def test_consumer_heartbeat_is_written_as_by_codesys():
    # Frame of a CODESYS master to node 2: watch node 127, 300 ms (blog.csdn.net, "CANopen Object
    # 1016h: Consumer heartbeat time")
    entry = Entry(0x1016, 1, "I", "")
    assert hexed(canopen.download(2, entry, 127 << 16 | 300)) == "602#231610012C017F00"
    answer = canopen.parse_sdo(bytes.fromhex("6016100100000000"))
    assert answer == SdoAnswer(0x1016, 1)


@pytest.mark.parametrize(
    "entry, answer, value",
    [
        (MODE_DISPLAY, "4F61600001000000", 1),  # Festo
        (STATUSWORD, "4B41600034120000", 0x1234),
        (FESTO_6093, "4393600178563412", 0x12345678),
        # Blink Marine PKP2500SI CANopen user manual rev. 1.0, page 32
        (Entry(0x1601, 0, "B", ""), "4F01160003000000", 3),
        (Entry(0x1601, 1, "I", ""), "4301160110010220", 0x20020110),
        # CiA 301 7.2.4.3.6: s = 0, the length is not said
        (STATUSWORD, "424160003412FFFF", 0x1234),
        (STATUSWORD, "4E4160003412FFFF", 0x1234),  # n means nothing then
        (Entry(0x6060, 0, "b", ""), "4F606000FF000000", -1),
    ],
)
def test_reads_match_the_manuals(entry, answer, value):
    assert canopen.upload(1, entry).data[0] == 0x40
    parsed = canopen.parse_sdo(bytes.fromhex(answer))
    assert (parsed.index, parsed.sub, parsed.abort) == (entry.index, entry.sub, 0)
    assert entry.unpack(parsed.data) == value


def test_read_request_matches_the_manual():
    assert hexed(canopen.upload(0x15, Entry(0x1601, 2, "I", ""))) == "615#4001160200000000"


def test_abort_reports_its_code_by_name():
    # Frame quoted in issue 516 of christiansandberg/canopen; text of CiA 301 table 22
    answer = canopen.parse_sdo(bytes.fromhex("8000000000000405"))
    assert answer == SdoAnswer(0, 0, None, 0x05040000)
    assert canopen.abort_text(answer.abort) == (
        "05040000 (Timeout of transfer communication detected)"
    )
    assert canopen.abort_text(0x12345678) == "12345678"


def test_abort_without_a_code_is_accepted():
    assert canopen.parse_sdo(bytes.fromhex("8040600000000000")).abort


@pytest.mark.parametrize(
    "data",
    [
        "",
        "4F616000010000",  # 7 bytes
        "4161600010000000",  # segmented upload
        "0041600000000000",  # segment
        "A041600000000000",  # block
        "C041600000000000",
        "E041600000000000",
        "2041600000000000",
    ],
)
def test_data_outside_an_expedited_transfer_are_ignored(data):
    assert canopen.parse_sdo(bytes.fromhex(data)) is None


def test_nmt_sync_and_heartbeat_match_cia_301():
    assert hexed(canopen.nmt(NmtCommand.START, 5)) == "000#0105"
    assert hexed(canopen.nmt(NmtCommand.STOP, 5)) == "000#0205"
    assert hexed(canopen.nmt(NmtCommand.PRE_OPERATIONAL, 5)) == "000#8005"
    assert hexed(canopen.nmt(NmtCommand.RESET_NODE, 5)) == "000#8105"
    assert hexed(canopen.nmt(NmtCommand.RESET_COMMUNICATION, 5)) == "000#8205"
    assert hexed(canopen.sync()) == "080#"
    # example of docs.rs/hex-motor: node 0x10 is operational, pre-operational
    assert hexed(canopen.heartbeat(0x10, NmtState.OPERATIONAL)) == "710#05"
    assert hexed(canopen.heartbeat(0x10, NmtState.PRE_OPERATIONAL)) == "710#7F"


@pytest.mark.parametrize("node", [0, -1, 128])
def test_command_goes_to_one_node_only(node):
    for make in (
        lambda: canopen.nmt(NmtCommand.START, node),
        lambda: canopen.heartbeat(node, NmtState.OPERATIONAL),
        lambda: canopen.upload(node, STATUSWORD),
        lambda: canopen.download(node, STATUSWORD, 0),
    ):
        with pytest.raises(InputError, match=f"{node}"):
            make()


@pytest.mark.parametrize(
    "data, state",
    [
        ("00", 0),
        ("04", 4),
        ("05", 5),
        ("7F", 127),
        ("", None),
        ("0500", None),
        ("06", None),
        ("85", None),
    ],
)
def test_heartbeats_have_one_byte_with_a_known_state(data, state):
    assert canopen.parse_heartbeat(bytes.fromhex(data)) == state


def test_emergency_is_decoded_as_documented():
    # example of docs.rs/canopen-rs: voltage, error register generic and voltage
    message = canopen.parse_emergency(bytes.fromhex("0030050000000000"))
    assert message == Emergency(0x3000, 5, bytes(5))
    assert str(message) == "EMCY 3000 (Voltage), error register 05"
    assert canopen.parse_emergency(bytes(7)) is None


def test_error_codes_are_named_by_their_class():
    # CiA 301 table 26: 81xx monitoring (communication), 8130 life guard or heartbeat error
    assert canopen.error_text(0x8130) == "8130 (Monitoring)"
    assert canopen.error_text(0x2310) == "2310 (Current)"
    assert canopen.error_text(0xA000) == "A000"


@fixed
@given(values(), st.integers(1, 127))
def test_written_values_can_be_read_back(pair, node):
    entry, value = pair
    frame = canopen.download(node, entry, value)
    command, index, sub = struct.unpack_from("<BHB", frame.data)
    assert (frame.id, len(frame.data), index, sub) == (0x600 + node, 8, entry.index, entry.sub)
    # The answer to a read has the same bytes with the command 4x in the place of 2x.
    answer = canopen.parse_sdo(bytes((command + 0x20,)) + frame.data[1:])
    assert entry.unpack(answer.data) == value
    assert len(answer.data) == entry.size
    assert entry.mapping & 0xFF == 8 * entry.size


@fixed
@given(entries, st.integers(-(2**40), 2**40))
def test_value_that_does_not_fit_is_refused(entry, value):
    low, high = RANGES[entry.format]
    if low <= value <= high:
        assert entry.unpack(entry.pack(value)) == value
    else:
        with pytest.raises(InputError, match=f"{value}"):
            entry.pack(value)


@fixed
@given(st.binary(max_size=8))
def test_no_data_raises(data):
    answer = canopen.parse_sdo(data)
    assert answer is None or len(data) == 8
    assert canopen.parse_heartbeat(data) is None or len(data) == 1
    assert canopen.parse_emergency(data) is None or len(data) == 8
    if answer is not None and answer.data is not None:
        assert 1 <= len(answer.data) <= 4


# The dialogue

FIRST, SECOND = Entry(0x2000, 0, "H", "first"), Entry(0x2001, 1, "B", "second")


def two_steps():
    a = yield from read(FIRST)
    yield from write(SECOND, 3)
    return a


def test_one_request_is_in_flight_and_the_next_is_sent_at_the_next_tick():
    dialogue = SdoDialogue(5, two_steps())
    assert [str(f) for f in dialogue.tick(0.0)] == ["605#4000200000000000"]
    assert dialogue.tick(0.01) == []
    assert dialogue.receive(bytes.fromhex("4B00200034120000"))
    assert [str(f) for f in dialogue.tick(0.02)] == ["605#2F01200103000000"]
    assert not dialogue.ended
    assert dialogue.receive(bytes.fromhex("6001200100000000"))
    assert (dialogue.ended, dialogue.result, dialogue.failure) == (True, 0x1234, "")
    assert dialogue.tick(0.03) == []


@pytest.mark.parametrize(
    "wrong",
    [
        "6000200000000000",  # "written" to a read
        "4B01200034120000",  # another index
        "4B00200134120000",  # another sub-index
        "4B002000341200",  # short
        "8001200000000206",  # abort of another
    ],
)
def test_answer_to_another_request_is_ignored(wrong):
    dialogue = SdoDialogue(5, two_steps())
    dialogue.tick(0.0)
    assert not dialogue.receive(bytes.fromhex(wrong))
    assert (dialogue.ended, dialogue.tick(0.01)) == (False, [])
    assert dialogue.receive(bytes.fromhex("4B00200034120000"))


def test_late_duplicate_answer_is_not_taken_for_the_next_request():
    dialogue = SdoDialogue(5, two_steps())
    dialogue.tick(0.0)
    dialogue.tick(TIMEOUT)  # asked again
    answer = bytes.fromhex("4B00200034120000")
    assert dialogue.receive(answer)
    assert not dialogue.receive(answer)  # before the next one was sent
    dialogue.tick(TIMEOUT + 0.01)
    assert not dialogue.receive(answer)
    assert not dialogue.ended


def test_duplicate_answer_is_not_taken_for_an_unsent_request():
    def steps():
        return (yield from try_write(FIRST, 6)), (yield from try_write(FIRST, 2))

    dialogue, refusal = SdoDialogue(5, steps()), bytes.fromhex("8000200030000906")
    dialogue.tick(0.0)
    assert dialogue.receive(refusal)
    assert not dialogue.receive(refusal)
    dialogue.tick(0.01)
    assert dialogue.receive(bytes.fromhex("6000200000000000"))
    assert dialogue.result == (0x06090030, 0)


def test_request_is_repeated_and_then_aborted_with_its_name():
    dialogue = SdoDialogue(5, two_steps())
    asked = [now for now in (0.01 * k for k in range(100)) if dialogue.tick(now)]
    assert asked == pytest.approx([k * TIMEOUT for k in range(ATTEMPTS)])
    assert (dialogue.ended, dialogue.failure) == (True, "no answer to SDO 2000:00 (first)")


def test_abort_ends_the_dialogue_with_its_text():
    dialogue = SdoDialogue(5, two_steps())
    dialogue.tick(0.0)
    assert dialogue.receive(bytes.fromhex("8000200000000206"))
    assert dialogue.failure == ("SDO 2000:00 (first): abort 06020000 (Object does not exist)")
    assert dialogue.ended


def test_abort_may_be_tolerated_by_its_code_only():
    def steps():
        done = yield from write(FIRST, 1, (0x06020000,))
        code = yield from try_write(FIRST, 2)
        yield from write(FIRST, 1, (0x06020000,))
        return done, code

    dialogue = SdoDialogue(5, steps())
    for data in ("8000200000000206", "8000200030000906"):
        dialogue.tick(0.0)
        dialogue.receive(bytes.fromhex(data))
    assert dialogue.failure == ""
    dialogue.tick(0.0)
    dialogue.receive(bytes.fromhex("8000200030000906"))
    assert "06090030 (Value range of parameter exceeded)" in dialogue.failure


def test_steps_may_fail_before_they_ask():
    def steps():
        raise SdoError("no")
        yield

    assert SdoDialogue(5, steps()).failure == "no"
