import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omniman_ros.can_drives.frame import CanFrame, bus_load, count_stuff_bits, crc15, frame_bits
from omniman_ros.core.errors import InputError


@st.composite
def any_frames(draw):
    extended, remote = draw(st.booleans()), draw(st.booleans())
    id = draw(st.integers(0, 2**29 - 1 if extended else 2**11 - 1))
    return CanFrame(id, b"" if remote else draw(st.binary(max_size=8)), extended, remote)


def written_out(frame):
    """Bits from the start of a frame to its data, field by field; Bosch, CAN 2.0 B, section 3."""
    sof, srr, ide, r1, r0 = "0", "1", "1" if frame.extended else "0", "0", "0"
    rtr, dlc = "1" if frame.remote else "0", f"{len(frame.data):04b}"
    if frame.extended:
        head = sof + f"{frame.id >> 18:011b}" + srr + ide + f"{frame.id & 0x3FFFF:018b}"
        return head + rtr + r1 + r0 + dlc + bits_of(frame.data)
    return sof + f"{frame.id:011b}" + rtr + ide + r0 + dlc + bits_of(frame.data)


def stuffed(bits):
    """The bits with those stuffed in."""
    text = ""
    for bit in bits:
        text += bit
        if re.search(r"(.)\1{4}$", text):
            text += "10"[int(text[-1])]
    return text


def bits_of(data):
    return "".join(f"{byte:08b}" for byte in data)


@pytest.mark.parametrize(
    "bits, crc",
    [
        # Check value of CRC-15/CAN in the catalogue of CRCs, reveng.sourceforge.io.
        (bits_of(b"123456789"), 0x059E),
        # Tests of github.com/Nik89/CanOverhead, by an independent calculator.
        ("0", 0),
        ("11110001", 0b110001011110110),
        ("100000110011", 0b000010001110100),
        ("11010011101100", 0b010001010101010),
    ],
)
def test_crc_of_published_sequences(bits, crc):
    assert crc15(bits) == crc


@pytest.mark.parametrize(
    "bits, count",
    [
        ("", 0),
        ("1", 0),
        ("1110101010", 0),
        ("11111", 1),  # CanOverhead, as above
        ("111110000", 2),  # the stuffed 0 and four more make five
        ("0000000000", 2),
        ("1" * 9, 1),
        ("1" * 10, 2),
    ],
)
def test_stuff_bit_follows_five_equal_bits_and_counts_itself(bits, count):
    assert count_stuff_bits(bits) == count


@pytest.mark.parametrize(
    "frame, length",
    [
        # Whole frames written out in the tests of CanOverhead, stuff bits marked.
        (CanFrame(0, b""), 47 + 6),
        (CanFrame(0, b"\0"), 55 + 4),
        (CanFrame(0x133, b"\xff\0\0\0\0\0\0\xff"), 111 + 12),  # the last one after the CRC
    ],
)
def test_length_of_published_frames(frame, length):
    assert frame_bits(frame) == length


@pytest.mark.parametrize("bits, worst", [(98, 24), (118, 29)])
def test_worst_pattern_of_eight_bytes_gives_135_and_160_bits(bits, worst):
    # Davis, Burns, Bril, Lukkien: CAN schedulability analysis refuted, revisited and revised,
    # Real-Time Systems 35 (2007), section 2.1: 135 and 160 bits with the gap between frames.
    pattern = ("11111" + "00001111" * 20)[:bits]
    assert count_stuff_bits(pattern) == worst
    assert bits + worst + 13 == {98: 135, 118: 160}[bits]


@settings(deadline=None, derandomize=True, max_examples=300)
@given(any_frames())
def test_no_frame_is_shorter_or_longer_than_the_bounds(frame):
    n = len(frame.data)
    head = 54 if frame.extended else 34
    least = head + 13 + 8 * n
    assert least <= frame_bits(frame) <= least + (head + 8 * n - 1) // 4


@settings(deadline=None, derandomize=True, max_examples=300)
@given(st.text("01", max_size=120))
def test_stuffing_agrees_with_a_replacement_by_text(bits):
    assert count_stuff_bits(bits) == len(stuffed(bits)) - len(bits)


@settings(deadline=None, derandomize=True, max_examples=300)
@given(any_frames())
def test_length_is_that_of_the_fields_written_out(frame):
    bits = written_out(frame)
    assert frame_bits(frame) == len(stuffed(bits + f"{crc15(bits):015b}")) + 13


@settings(deadline=None, derandomize=True, max_examples=200)
@given(st.text("01", max_size=120))
def test_crc_is_the_remainder_of_a_long_division(bits):
    number, divisor = int(bits + "0" * 15, 2), 0b1100010110011001
    while number.bit_length() > 15:
        number ^= divisor << (number.bit_length() - 16)
    assert crc15(bits) == number


def test_request_carries_no_data_bits():
    request = CanFrame(0x0B4, b"", remote=True)
    assert 47 <= frame_bits(request) <= 47 + 8


def test_load_is_the_share_of_busy_bits():
    frames = [CanFrame(0, b"")] * 100
    assert bus_load(frames, 1.0, 53_000) == pytest.approx(0.1)
    assert bus_load(frames, 0.5, 53_000) == pytest.approx(0.2)
    assert bus_load([], 1.0, 1e6) == 0.0


@pytest.mark.parametrize("duration, bitrate", [(0.0, 1e6), (1.0, 0.0), (float("nan"), 1e6)])
def test_load_in_no_time_is_refused(duration, bitrate):
    with pytest.raises(InputError, match="bus load"):
        bus_load([], duration, bitrate)


@pytest.mark.parametrize(
    "frame",
    [
        CanFrame(0x800, b""),
        CanFrame(-1, b""),
        CanFrame(1 << 29, b"", extended=True),
        CanFrame(1, bytes(9)),
    ],
)
def test_frame_that_is_not_classic_can_is_refused(frame):
    with pytest.raises(InputError, match="classic"):
        frame_bits(frame)
