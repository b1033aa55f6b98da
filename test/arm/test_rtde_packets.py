"""RTDE packets: known bytes, and streams cut everywhere."""

import random
import struct

import pytest

from omniman_ros.arm.errors import ProtocolError
from omniman_ros.arm.rtde_packets import (
    HEADER,
    LARGEST,
    Packet,
    PacketReader,
    PacketType,
    Recipe,
    accepted,
    pack,
    request_version,
    setup_outputs,
    start,
    text_message,
)

NAMES = ("timestamp", "actual_q", "robot_mode", "safety_status_bits")
TYPES = b"DOUBLE,VECTOR6D,INT32,UINT32"


def data(recipe, *values):
    return pack(PacketType.DATA, bytes([recipe]) + struct.pack(">d6diI", *values))


def test_requests_are_those_of_the_guide():
    assert request_version() == bytes.fromhex("0005560002")
    assert start() == bytes.fromhex("000353")
    asked = setup_outputs(125.0, ["timestamp", "actual_q"])
    assert asked[:3] == struct.pack(">HB", 11 + 18, ord("O"))
    assert asked[3:11] == bytes.fromhex("405f400000000000")  # 125.0
    assert asked[11:] == b"timestamp,actual_q"


@pytest.mark.parametrize(("payload", "good"), [(b"\x01", True), (b"\x00", False)])
def test_an_answer_is_yes_or_no(payload, good):
    assert accepted(payload) is good


@pytest.mark.parametrize("payload", [b"", b"\x01\x00"])
def test_anything_else_is_no_answer(payload):
    with pytest.raises(ProtocolError, match="expected 1"):
        accepted(payload)


STREAM = [
    Packet(PacketType.PROTOCOL_VERSION, b"\x01"),
    Packet(PacketType.SETUP_OUTPUTS, b"\x01" + TYPES),
    Packet(PacketType.START, b"\x01"),
    Packet(PacketType.DATA, b"\x01" + bytes(64)),
    Packet(PacketType.DATA, b"\x01" + bytes(range(64))),
    Packet(200, b""),
]
BYTES = b"".join(HEADER.pack(3 + len(p.payload), p.kind) + p.payload for p in STREAM)


@pytest.mark.parametrize("cut", range(len(BYTES) + 1))
def test_a_stream_cut_at_any_byte_gives_the_same_packets(cut):
    reader = PacketReader()
    assert [*reader.feed(BYTES[:cut]), *reader.feed(BYTES[cut:])] == STREAM


def test_a_stream_of_single_bytes_and_one_of_everything_at_once_give_the_same():
    slowly, at_once = PacketReader(), PacketReader()
    assert [p for byte in BYTES for p in slowly.feed(bytes([byte]))] == STREAM
    assert list(at_once.feed(BYTES)) == STREAM


@pytest.mark.parametrize("size", [0, 1, 2, LARGEST + 1, 65535])
def test_a_size_that_cannot_be_is_an_error(size):
    reader = PacketReader()
    with pytest.raises(ProtocolError, match=f"{size} bytes"):
        list(reader.feed(struct.pack(">HB", size, 85)))


def test_random_bytes_end_in_packets_or_an_error_and_nothing_else():
    chance = random.Random(1)
    errors = 0
    for _ in range(2000):
        reader = PacketReader()
        try:
            for _ in range(5):
                for packet in reader.feed(chance.randbytes(chance.randrange(40))):
                    assert isinstance(packet.payload, bytes)
        except ProtocolError:
            errors += 1
    assert 1000 < errors <= 2000


def test_a_recipe_reads_the_values_by_name():
    recipe = Recipe.confirmed(NAMES, b"\x07" + TYPES)
    values = recipe.values(data(7, 12.5, 0, 1, 2, 3, 4, 5, 7, 2**31)[3:])
    assert values == {
        "timestamp": (12.5,),
        "actual_q": (0.0, 1.0, 2.0, 3.0, 4.0, 5.0),
        "robot_mode": (7,),
        "safety_status_bits": (2**31,),
    }


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (b"", "empty"),
        (b"\x01DOUBLE,NOT_FOUND,INT32,UINT32", "'actual_q': NOT_FOUND"),
        (b"\x00DOUBLE,VECTOR6D,IN_USE,UINT32", "'robot_mode': IN_USE"),
        (b"\x01DOUBLE", "1 types for 4 outputs"),
        (b"\x01" + TYPES + b",INT32", "5 types for 4 outputs"),
        (b"\x01\xff\xfe", "'timestamp'"),
    ],
)
def test_a_recipe_that_is_refused_names_the_output(answer, reason):
    with pytest.raises(ProtocolError, match=reason):
        Recipe.confirmed(NAMES, answer)


@pytest.mark.parametrize("change", ["short", "long", "other recipe", "empty"])
def test_data_of_another_shape_are_an_error(change):
    recipe = Recipe.confirmed(NAMES, b"\x07" + TYPES)
    payload = data(7, 12.5, 0, 1, 2, 3, 4, 5, 7, 0)[3:]
    payload = {
        "short": payload[:-1],
        "long": payload + b"\x00",
        "other recipe": b"\x08" + payload[1:],
        "empty": b"",
    }[change]
    with pytest.raises(ProtocolError, match="expected 65 for 7"):
        recipe.values(payload)


def test_a_text_message_is_read_as_far_as_it_goes():
    whole = b"\x05hello\x04RTDE\x02"
    assert text_message(whole) == "RTDE: hello"
    for cut in range(len(whole)):
        assert isinstance(text_message(whole[:cut]), str)
