"""Convert coupling errors to messages and back.

A message has each constraint twice, which its names tell apart: `constraint_1` to `constraint_m`
are the errors that the coupling controller corrects, `constraint_1_total` to `constraint_m_total`
are (24) of CCTA 2017, the curve of its Fig. 7, integrated without resets. The first m entries come
first, so that they can also be read by index.
"""

from collections.abc import Sequence
from typing import Any

from omniman_ros.core.arrays import Array

TOTAL_SUFFIX = "_total"  #: End of the names of errors that are integrated without resets


def coupling_names(count: int) -> list[str]:
    """Return the 2 m names in a message of m constraints, in their order."""
    names = [f"constraint_{i + 1}" for i in range(count)]
    return names + [name + TOTAL_SUFFIX for name in names]


def coupling_error_numbers(controlled: Array, total: Array, rate: Array) -> list[float]:
    """Return the positions and then the velocities of a message with :func:`coupling_names`.

    Args:
        controlled: Errors (m,) that the coupling controller corrects [rad].
        total: Errors (m,) by CCTA 2017 (24), without resets [rad].
        rate: Rates (m,) of the errors, which both have in common [rad/s].
    """
    rates = rate.tolist()
    return [*controlled.tolist(), *total.tolist(), *rates, *rates]


def total_coupling_error(message: Any) -> Sequence[float]:
    """Return the errors (m,) without resets in a message of `coupling_error` [rad].

    A message without any, from a sender that knows no others or an older recording, has one kind
    only, which is returned.
    """
    pairs = zip(message.name, message.position, strict=False)
    totals = [value for name, value in pairs if name.endswith(TOTAL_SUFFIX)]
    return totals or list(message.position)
