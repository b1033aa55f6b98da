"""Load of a classic CAN bus, from the frames on it.

Source: Bosch, CAN Specification 2.0 (1991), parts A and B, sections 3 and 5.
"""

from collections.abc import Iterable

from omniman_ros.can_drive.frame import Frame
from omniman_ros.core.errors import InputError

POLYNOMIAL = 0x4599
"""Of the CRC, x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1, without x^15."""
TAIL = 13
"""Bits that are not stuffed: CRC delimiter, 2 of the acknowledgement, 7 end of frame, 3 between
frames."""


def crc15(bits: str) -> int:
    """Return the CRC-15 of a sequence of "0" and "1"."""
    crc = 0
    for bit in bits:
        odd = (crc >> 14 & 1) ^ (bit == "1")
        crc = (crc << 1 & 0x7FFF) ^ (POLYNOMIAL if odd else 0)
    return crc


def stuff_bits(bits: str) -> int:
    """Return how many bits are stuffed in: one after five equal ones, which counts as well."""
    count, run, last = 0, 0, ""
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            count, run = count + 1, 1
            last = "0" if bit == "1" else "1"
    return count


def frame_bits(frame: Frame) -> int:
    """Return the length of a frame on the bus [bit], with stuff bits and the gap after it.

    Raises:
        InputError: Its id has more than 11 or 29 bits, or it has more than 8 bytes.
    """
    width = 29 if frame.extended else 11
    if not 0 <= frame.id < 1 << width or len(frame.data) > 8:
        raise InputError(f"not a classic CAN frame: {frame}")
    id = f"{frame.id:0{width}b}"
    id = f"{id[:11]}11{id[11:]}" if frame.extended else id
    data = "".join(f"{byte:08b}" for byte in frame.data)
    bits = f"0{id}{frame.remote:b}00{len(frame.data):04b}{data}"
    bits += f"{crc15(bits):015b}"
    return len(bits) + stuff_bits(bits) + TAIL


def load(frames: Iterable[Frame], duration: float, bitrate: float) -> float:
    """Return the share of the time that the bus is busy; above 1 they do not fit.

    Args:
        frames: All that was sent, by whomever.
        duration: In what time, s.
        bitrate: bit/s.

    Raises:
        InputError: Duration or bit rate is not above zero, or a frame is none of classic CAN.
    """
    if not (duration > 0.0 and bitrate > 0.0):
        raise InputError(f"a load of {duration} s at {bitrate} bit/s")
    return sum(map(frame_bits, frames)) / (duration * bitrate)
