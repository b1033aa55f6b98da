"""Decide whether what a robot was told to look at is known in usable form."""

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class SourcePublisher:
    """Somebody who publishes on a topic."""

    name: str  #: Full name of the node
    mismatch: str = ""  #: Why nothing can be received from it, or empty


@dataclass(frozen=True)
class SourceTerms:
    """What is expected of a source."""

    #: Age of the last usable message at which the source is silent [s]; 0: never
    timeout: float = 0.0
    #: Time that a publisher has until its first usable message [s]; 0: for ever
    patience: float = 1.0
    is_required: bool = False  #: Whether the source is awaited although nobody publishes it


class SourceMonitor:
    """Tracks whether a robot has in usable form what one topic tells of its surroundings.

    Who publishes the topic tells the robot to use it. From then on, what was never usable is as
    bad as what fell silent. Where nobody publishes and nothing has come, there is nothing to wait
    for, unless the source is required.
    """

    def __init__(self, topic: str, terms: SourceTerms) -> None:
        self.topic, self.terms = topic, terms
        self._used = -math.inf
        self._refusal = ""
        self._publishers: tuple[SourcePublisher, ...] = ()
        self._appeared = math.inf

    @property
    def publishers(self) -> tuple[SourcePublisher, ...]:
        """Who publishes, as last surveyed."""
        return self._publishers

    @property
    def is_known(self) -> bool:
        """Whether anything usable has come, and was not dismissed."""
        return self._used > -math.inf

    def use(self, now: float) -> None:
        """Record that a whole message was used at a time [s], which may say: nothing is there."""
        self._used, self._refusal = now, ""

    def refuse(self, reason: str) -> None:
        """Record that a message could not be used, or not all of it; it does not count as one."""
        self._refusal = reason or "no reason given"

    def survey(self, publishers: Sequence[SourcePublisher], now: float) -> None:
        """Record who publishes at a time [s]."""
        self._publishers = tuple(publishers)
        if not publishers:
            self._appeared = math.inf
        elif not self._appeared <= now:  # also after time went back
            self._appeared = now

    def dismiss(self) -> bool:
        """Expect a source no more that nobody publishes; return whether it was dismissed.

        What could not be used is not dismissed: it told of something that is not known.
        """
        if self._publishers or self._refusal:
            return False
        self._used = -math.inf
        return not self.terms.is_required

    def blind_reason(self, now: float) -> str:
        """Return why the robot does not know at a time [s] what it should, or an empty string."""
        self._used = min(self._used, now)  # time may have gone back
        topic, terms, age = self.topic, self.terms, now - self._used
        for publisher in self._publishers:
            if publisher.mismatch:
                return f"{topic} of {publisher.name} cannot be received: {publisher.mismatch}"
        if self._refusal and not (terms.timeout and age <= terms.timeout):
            return f"{topic} cannot be used: {self._refusal}"
        if self.is_known:
            return f"no {topic} received for {age:.1f} s" if 0.0 < terms.timeout < age else ""
        names = " and ".join(sorted({publisher.name for publisher in self._publishers}))
        is_late = 0.0 < terms.patience < now - self._appeared
        if is_late or terms.is_required:
            return f"no {topic} yet from {names}" if names else f"no {topic} yet: nobody sends it"
        return ""
