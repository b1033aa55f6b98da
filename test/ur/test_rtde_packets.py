"""RTDE packets: known bytes, and streams split at any byte."""

import random
import struct

import pytest

from omniman_ros.ur.rtde_packets import (
    HEADER,
    MAX_PACKET_SIZE,
    PacketReader,
    PacketType,
    ProtocolError,
    Recipe,
    RtdePacket,
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


def test_requests_have_the_bytes_of_the_rtde_guide():
    assert request_version() == bytes.fromhex("0005560002")
    assert start() == bytes.fromhex("000353")
    asked = setup_outputs(125.0, ["timestamp", "actual_q"])
    assert asked[:3] == struct.pack(">HB", 11 + 18, ord("O"))
    assert asked[3:11] == bytes.fromhex("405f400000000000")  # 125.0
    assert asked[11:] == b"timestamp,actual_q"


@pytest.mark.parametrize(("payload", "good"), [(b"\x01", True), (b"\x00", False)])
def test_answer_is_accepted_or_refused(payload, good):
    assert accepted(payload) is good


@pytest.mark.parametrize("payload", [b"", b"\x01\x00"])
def test_other_answers_are_rejected(payload):
    with pytest.raises(ProtocolError, match="must have 1 byte"):
        accepted(payload)


STREAM = [
    RtdePacket(PacketType.PROTOCOL_VERSION, b"\x01"),
    RtdePacket(PacketType.SETUP_OUTPUTS, b"\x01" + TYPES),
    RtdePacket(PacketType.START, b"\x01"),
    RtdePacket(PacketType.DATA, b"\x01" + bytes(64)),
    RtdePacket(PacketType.DATA, b"\x01" + bytes(range(64))),
    RtdePacket(200, b""),
]
BYTES = b"".join(HEADER.pack(3 + len(p.payload), p.kind) + p.payload for p in STREAM)


@pytest.mark.parametrize("cut", range(len(BYTES) + 1))
def test_stream_split_at_any_byte_gives_the_same_packets(cut):
    reader = PacketReader()
    assert [*reader.feed(BYTES[:cut]), *reader.feed(BYTES[cut:])] == STREAM


def test_stream_in_single_bytes_gives_the_same_packets_as_in_one_piece():
    slowly, at_once = PacketReader(), PacketReader()
    assert [p for byte in BYTES for p in slowly.feed(bytes([byte]))] == STREAM
    assert list(at_once.feed(BYTES)) == STREAM


@pytest.mark.parametrize("size", [0, 1, 2, MAX_PACKET_SIZE + 1, 65535])
def test_impossible_packet_size_is_an_error(size):
    reader = PacketReader()
    with pytest.raises(ProtocolError, match=f"{size} bytes"):
        list(reader.feed(struct.pack(">HB", size, 85)))


def test_random_bytes_give_only_packets_or_a_protocol_error():
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


def test_recipe_reads_the_values_by_name():
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
        (b"\x01DOUBLE", "must be 4 types of outputs, got 1"),
        (b"\x01" + TYPES + b",INT32", "must be 4 types of outputs, got 5"),
        (b"\x01\xff\xfe", "'timestamp'"),
    ],
)
def test_refused_recipe_names_the_output(answer, reason):
    with pytest.raises(ProtocolError, match=reason):
        Recipe.confirmed(NAMES, answer)


@pytest.mark.parametrize("change", ["short", "long", "other recipe", "empty"])
def test_data_of_wrong_size_are_an_error(change):
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


def test_truncated_text_message_is_read_as_far_as_possible():
    whole = b"\x05hello\x04RTDE\x02"
    assert text_message(whole) == "RTDE: hello"
    for cut in range(len(whole)):
        assert isinstance(text_message(whole[:cut]), str)
