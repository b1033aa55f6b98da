"""Random messages of any type: extreme numbers, names that are known and names that are not."""

import array
import math
import random
import re
from typing import Any

from rosidl_parser.definition import (
    AbstractNestedType,
    AbstractString,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
)

FLOATS = (0.0, 1.0, -1.0, 0.1, 1e-12, 1e6, 1e300, math.nan, math.inf, -math.inf)
LONGEST = 7  #: Largest number of items in a sequence


class RandomMessages:
    """Makes messages by a seed.

    Args:
        words: Texts that the node under test knows, such as names of joints and frames.
        stamp: Returns a stamp that is fresh.
    """

    def __init__(self, seed: int, words: list[str], stamp: Any) -> None:
        self._draw = random.Random(seed)
        self._words, self._stamp = words, stamp

    def make(self, kind: type) -> Any:
        """Return a message of a type."""
        if kind.__name__ == "Time" and self._draw.random() < 0.7:
            return self._stamp()
        message = kind()
        names = list(kind.get_fields_and_field_types())
        size = self._draw.choice((0, 1, 2, 3, 4, 6, LONGEST))
        for name, slot in zip(names, kind.SLOT_TYPES, strict=True):
            if self._draw.random() < 0.9:
                setattr(message, name, self._value(slot, size, getattr(message, name)))
        return message

    def damaged(self, data: bytes) -> bytes:
        """Return serialized data, in one of four cases cut off or with a byte changed."""
        chance = self._draw.random()
        place = self._draw.randrange(len(data))
        if chance < 0.125:
            return data[:place]
        if chance < 0.25:
            return data[:place] + bytes([self._draw.randrange(256)]) + data[place + 1 :]
        return data

    def _value(self, slot: Any, size: int, present: Any) -> Any:
        if isinstance(slot, AbstractNestedType):
            return self._values(slot, size, present)
        if isinstance(slot, NamespacedType):
            return self.make(type(present))
        return self._plain(slot)

    def _values(self, slot: Any, size: int, present: Any) -> Any:
        if isinstance(slot, Array):
            size = slot.size
        elif isinstance(slot, BoundedSequence):
            size = min(size, slot.maximum_size)
        if self._draw.random() < 0.1 and not isinstance(slot, Array):
            size = 0
        if isinstance(slot.value_type, NamespacedType):
            kind = _message_type(slot.value_type)
            return [self.make(kind) for _ in range(size)]
        if isinstance(slot.value_type, AbstractString) and self._draw.random() < 0.5:
            return self._words[:size]
        values = [self._plain(slot.value_type) for _ in range(size)]
        return (
            array.array(present.typecode, values) if isinstance(present, array.array) else values
        )

    def _plain(self, slot: Any) -> Any:
        if isinstance(slot, AbstractString):
            return self._draw.choice([*self._words, "", "x" * 300, "\0", "ä"])
        assert isinstance(slot, BasicType)
        if slot.typename == "boolean":
            return self._draw.random() < 0.5
        if slot.typename == "octet":
            return bytes([self._draw.randrange(256)])
        if slot.typename in ("float", "double"):
            value = self._draw.choice([*FLOATS, self._draw.gauss(0.0, 1.0)])
            return min(max(value, -3e38), 3e38) if slot.typename == "float" else value
        bits = int(re.sub(r"\D", "", slot.typename))
        low, high = (
            (0, 2**bits - 1)
            if slot.typename[0] == "u"
            else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        )
        return self._draw.choice((0, 1, low, high, self._draw.randint(low, high)))


def _message_type(slot: NamespacedType) -> type:
    module = __import__(".".join(slot.namespaces), fromlist=[slot.name])
    found: type = getattr(module, slot.name)
    return found
