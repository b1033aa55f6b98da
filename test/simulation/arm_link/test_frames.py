"""Frames of the link between an arm's controller and a world."""

import math
import random
import struct

import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.simulation.arm_link.frames import (
    MAX_SEQUENCE,
    SETPOINT_SIZE,
    STATE_SIZE,
    ArmSetpoint,
    ArmState,
    SetpointReader,
    StateReader,
    encode_setpoint,
    encode_state,
)


def six(rng):
    return tuple(rng.choice((rng.uniform(-7, 7), 0.0, -0.0, 5e-324)) for _ in range(6))


def setpoint(rng):
    flags = {"begins_anew": rng.random() < 0.5, "braked": rng.random() < 0.5}
    sequence = rng.choice((1, rng.randrange(MAX_SEQUENCE), MAX_SEQUENCE))
    return ArmSetpoint(sequence, rng.uniform(-1e9, 1e9), six(rng), six(rng), **flags)


def state(rng):
    return ArmState(rng.randrange(MAX_SEQUENCE), six(rng), six(rng), six(rng))


KINDS = pytest.mark.parametrize(
    ("make", "encode", "reader", "size"),
    [
        (setpoint, encode_setpoint, SetpointReader, SETPOINT_SIZE),
        (state, encode_state, StateReader, STATE_SIZE),
    ],
)


@KINDS
@pytest.mark.parametrize("seed", range(20))
def test_what_is_encoded_is_read_again_however_the_stream_is_cut(make, encode, reader, size, seed):
    rng = random.Random(seed)
    sent = [make(rng) for _ in range(10)]
    stream = b"".join(map(encode, sent))
    assert len(stream) == 10 * size
    cuts = sorted(rng.randrange(len(stream)) for _ in range(15))
    pieces = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    receiving = reader()
    assert [frame for piece in pieces for frame in receiving.receive(piece)] == sent


@KINDS
def test_a_frame_of_the_other_kind_is_refused(make, encode, reader, size):
    other = encode_state if encode is encode_setpoint else encode_setpoint
    rng = random.Random(1)
    frame = other(state(rng) if other is encode_state else setpoint(rng))
    with pytest.raises(InputError, match="no such frame: kind"):
        reader().receive(frame * 2)


@KINDS
@pytest.mark.parametrize("garbage", [b"GET / HTTP/1.1\r\n", b"\0", b"OAL2", b"OAM"])
def test_garbage_is_refused_at_its_first_wrong_byte(make, encode, reader, size, garbage):
    receiving = reader()
    assert len(receiving.receive(encode(make(random.Random(2))))) == 1
    with pytest.raises(InputError, match="a frame begins with b'OAL1'"):
        receiving.receive(garbage)


@KINDS
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e5, -1e300])
def test_values_that_no_joint_has_are_refused(make, encode, reader, size, value):
    frame = encode(make(random.Random(3)))
    bad = frame[:-8] + struct.pack(">d", value)
    with pytest.raises(InputError, match=r"must be finite|is above 10000"):
        reader().receive(bad)


@KINDS
def test_no_bytes_make_a_reader_fail_otherwise(make, encode, reader, size):
    rng = random.Random(4)
    for _ in range(300):
        frame = bytearray(encode(make(rng)))
        for _ in range(rng.randrange(1, 4)):
            frame[rng.randrange(len(frame))] = rng.randrange(256)
        try:
            assert len(reader().receive(bytes(frame))) == 1
        except InputError:
            continue
