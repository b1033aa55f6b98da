"""Frames of a classic CAN bus, their length on the wire, and the bus load that they cause.

Source of the lengths: Bosch, CAN Specification 2.0 (1991), parts A and B, sections 3 and 5.
"""

from collections.abc import Iterable
from typing import NamedTuple

from omniman_ros.core.errors import InputError

#: Polynomial of the CRC, x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1, without x^15
CRC_POLYNOMIAL = 0x4599

#: Number of bits at the end of a frame that are never stuffed.
#: They are the CRC delimiter, 2 bits of the acknowledgement, 7 of the end of frame and 3 of the
#: interframe space.
UNSTUFFED_BITS = 13


class CanFrame(NamedTuple):
    """A data frame or remote frame."""

    id: int  #: Arbitration id of 11 bits, or of 29 bits if `extended`
    data: bytes  #: Payload of 0 to 8 bytes
    extended: bool = False  #: Whether the id has 29 bits
    remote: bool = False  #: Whether this is a remote frame, which requests data and carries none

    def __str__(self) -> str:
        width = 8 if self.extended else 3
        return f"{self.id:0{width}X}#{'R' if self.remote else self.data.hex().upper()}"


def crc15(bits: str) -> int:
    """Return the CRC-15 of a sequence of "0" and "1"."""
    crc = 0
    for bit in bits:
        feedback = (crc >> 14 & 1) ^ (bit == "1")
        crc = (crc << 1 & 0x7FFF) ^ (CRC_POLYNOMIAL if feedback else 0)
    return crc


def count_stuff_bits(bits: str) -> int:
    """Return the number of stuff bits that a sequence of "0" and "1" needs.

    After five equal bits a complementary one is inserted, which is the first of the next run.
    """
    count, run, last = 0, 0, ""
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            count, run = count + 1, 1
            last = "0" if bit == "1" else "1"
    return count


def frame_bits(frame: CanFrame) -> int:
    """Return the length of a frame on the wire [bit], with stuff bits and interframe space.

    Raises:
        InputError: The id has more than 11 or 29 bits, or there are more than 8 bytes of data.
    """
    width = 29 if frame.extended else 11
    if not 0 <= frame.id < 1 << width or len(frame.data) > 8:
        raise InputError(f"frame {frame} must be a classic CAN frame")
    id_bits = f"{frame.id:0{width}b}"
    if frame.extended:  # The SRR and IDE bits follow the first 11.
        id_bits = f"{id_bits[:11]}11{id_bits[11:]}"
    data = "".join(f"{byte:08b}" for byte in frame.data)
    bits = f"0{id_bits}{frame.remote:b}00{len(frame.data):04b}{data}"
    bits += f"{crc15(bits):015b}"
    return len(bits) + count_stuff_bits(bits) + UNSTUFFED_BITS


def bus_load(frames: Iterable[CanFrame], duration: float, bitrate: float) -> float:
    """Return the fraction of a time [s] in which frames occupy the bus; above 1 they don't fit.

    Args:
        frames: All frames on the bus, from the host and from all drives.
        bitrate: Bit rate of the bus [bit/s].

    Raises:
        InputError: The duration or the bit rate is not above zero, or a frame is not classic CAN.
    """
    if not (duration > 0.0 and bitrate > 0.0):
        raise InputError(
            f"bus load: duration {duration} s and bit rate {bitrate} bit/s must be above zero"
        )
    return sum(map(frame_bits, frames)) / (duration * bitrate)
