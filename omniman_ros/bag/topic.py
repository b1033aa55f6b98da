"""What is known of a topic that is recorded; free of the library of recordings."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Offer:
    """What a publisher offers.

    Attributes:
        reliable: Whether it repeats what was lost.
        latched: Whether who comes late gets the last ones: transient local.
        depth: How many it keeps; 0: unknown.
    """

    reliable: bool = True
    latched: bool = False
    depth: int = 10


@dataclass(frozen=True)
class Topic:
    """A topic to be recorded.

    Attributes:
        name: Whole name.
        kind: Type, PACKAGE/msg/NAME.
        definition, digest: See `Definitions.of`.
        offers: Of its publishers.
    """

    name: str
    kind: str
    definition: str
    digest: str
    offers: Sequence[Offer] = ()
