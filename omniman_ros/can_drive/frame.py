"""A frame of a classic CAN bus."""

from typing import NamedTuple


class Frame(NamedTuple):
    """One data frame.

    Attributes:
        id: Arbitration id, 11 bits, or 29 where `extended`.
        data: 0 to 8 bytes.
        extended: Whether the id has 29 bits.
        remote: Whether it asks for data and carries none.
    """

    id: int
    data: bytes
    extended: bool = False
    remote: bool = False

    def __str__(self) -> str:
        width = 8 if self.extended else 3
        return f"{self.id:0{width}X}#{'R' if self.remote else self.data.hex().upper()}"
