"""What a stamp may say: how far ahead of now it may be, and when a clock has gone back.

A stamp that is far ahead would count as the newest one for all that time: it would hold back every
later message of its source, and hide the silence of that source.
"""

import math

from omniman_ros.core.errors import InputError

#: Largest time that the stamp of a setpoint or a measurement may be ahead [s]: by it they age
MAX_LEAD = 0.05
#: Largest time that the stamp of a goal, a path, a pose or a map may be ahead [s].
#:
#: It says at which time their frame counts, and nothing of their age: clocks may differ more.
REQUEST_LEAD = 1.0
#: Largest time that a transform may be ahead [s]: localisations date theirs ahead, AMCL by 1 s
TRANSFORM_LEAD = 2.0
#: Jump of a clock into the past above which what was received before counts no more [s]
TIME_JUMP = 0.1


def demand_not_ahead(lead: float, most: float) -> None:
    """Raise InputError for a stamp further ahead of the receiver's clock [s] than `most` [s]."""
    if lead > most:
        raise InputError(f"the stamp is {lead:.3f} s ahead, at most {most:g} s are accepted")


def comparable(time: float | None, now: float) -> float | None:
    """Return the time of something that is kept, if later stamps can be compared with it.

    It is None without a stamp, or if it is ahead, as after the clock went back.
    """
    return time if time is not None and time <= now + MAX_LEAD else None


class ClockWatch:
    """Notices when a clock goes back: a recording that begins anew, or a clock that is set."""

    def __init__(self) -> None:
        self._latest = -math.inf

    def went_back(self, now: float) -> bool:
        """Return whether the clock went back by more than `TIME_JUMP` since the last call."""
        latest, self._latest = self._latest, now
        return now < latest - TIME_JUMP
