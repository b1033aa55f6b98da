"""The records of the stream between simulated drives and their host."""

import random

import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.simulation.can_link.records import (
    RECORD_SIZE,
    BusFrame,
    Instant,
    RecordReader,
    encode,
)

RECORDS = [
    BusFrame(0x181, b"\x01\x02\x03"),
    BusFrame(0x7FF, b""),
    Instant(1.005),
    BusFrame(2**29 - 1, bytes(range(8)), extended=True),
    BusFrame(0x701, b"", remote=True),
    Instant(1.010),
]


def test_records_arrive_in_their_order_however_the_stream_is_cut():
    stream = b"".join(map(encode, RECORDS))
    assert len(stream) == len(RECORDS) * RECORD_SIZE
    rng = random.Random(3)
    for _ in range(50):
        reader, found, rest = RecordReader(), [], stream
        while rest:
            size = rng.randint(1, 2 * RECORD_SIZE)
            found += reader.receive(rest[:size])
            rest = rest[size:]
        assert found == RECORDS


@pytest.mark.parametrize(
    "change",
    [
        {0: b"X"},  # magic
        {4: b"\x03"},  # kind
        {6: b"\x09"},  # length
        {8: b"\xff"},  # an id beyond 11 bits
    ],
    ids=str,
)
def test_what_is_no_record_is_refused(change):
    record = bytearray(encode(BusFrame(0x123, b"\x01")))
    for place, value in change.items():
        record[place : place + 1] = value
    with pytest.raises(InputError):
        RecordReader().receive(bytes(record))


def test_an_instant_that_is_not_finite_is_refused():
    with pytest.raises(InputError, match="instant"):
        RecordReader().receive(encode(Instant(float("nan"))))
