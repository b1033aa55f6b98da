"""A client of expedited SDOs that never waits: a dialogue of requests, one at a time."""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Generic, TypeVar

from omniman_ros.can_drive.canopen import Entry, SdoAnswer, abort_text, download, parse_sdo, upload
from omniman_ros.can_drive.frame import Frame
from omniman_ros.core.errors import OmnimanError

TIMEOUT = 0.2
"""How long an answer may take, s."""
ATTEMPTS = 3
"""How often a request is sent before it is given up."""

ABSENT = (0x06020000, 0x06090011)
"""Abort codes: there is no such object, no such sub-index."""

T = TypeVar("T")


class SdoError(OmnimanError):
    """A dialogue has come to an end before its aim; the message says why."""


@dataclass(frozen=True, slots=True)
class Request:
    """One request.

    Attributes:
        entry: To read or to write.
        value: To write; None to read.
    """

    entry: Entry
    value: int | None = None


Steps = Generator[Request, SdoAnswer, T]
"""A dialogue as a generator: it yields requests, is sent their answers, and returns a result."""


def read(entry: Entry) -> Steps[int]:
    """Read an entry.

    Raises:
        SdoError: The server aborts it.
    """
    return got(entry, (yield Request(entry)))


def got(entry: Entry, answer: SdoAnswer) -> int:
    """Value in the answer to a read.

    Raises:
        SdoError: The server aborted it.
    """
    if answer.data is None:
        raise SdoError(f"SDO {entry}: abort {abort_text(answer.abort)}")
    return entry.unpack(answer.data)


def write(entry: Entry, value: int, tolerated: tuple[int, ...] = ()) -> Steps[bool]:
    """Write an entry; return whether it was done.

    Args:
        entry: To write.
        value: What.
        tolerated: Abort codes that are not an error.

    Raises:
        SdoError: The server aborts it with another code.
    """
    abort = yield from attempt(entry, value)
    if abort and abort not in tolerated:
        raise SdoError(f"SDO {entry} = {value}: abort {abort_text(abort)}")
    return not abort


def attempt(entry: Entry, value: int) -> Steps[int]:
    """Write an entry; return the abort code, or 0."""
    answer = yield Request(entry, value)
    return answer.abort


class SdoDialogue(Generic[T]):
    """Carries the requests of a dialogue to a node and the answers back.

    At most one request is in flight; the next one goes with the tick after its answer.

    Args:
        node: Server's id.
        steps: What to ask.

    Attributes:
        result: What the steps return; None before.
        failure: Why they came to an end without a result, or empty.
    """

    def __init__(self, node: int, steps: Steps[T]) -> None:
        self._node, self._steps = node, steps
        self.result: T | None = None
        self.failure = ""
        self._request: Request | None = None
        self._attempts, self._deadline = 0, 0.0
        self._advance(None)

    @property
    def ended(self) -> bool:
        """Whether there is nothing more to ask."""
        return self._request is None

    def tick(self, now: float) -> list[Frame]:
        """Return the frame that is to be sent now, if any."""
        request = self._request
        if request is None or (self._attempts and now < self._deadline):
            return []
        if self._attempts == ATTEMPTS:
            self._end(f"no answer to SDO {request.entry}")
            return []
        self._attempts, self._deadline = self._attempts + 1, now + TIMEOUT
        if request.value is None:
            return [upload(self._node, request.entry)]
        return [download(self._node, request.entry, request.value)]

    def receive(self, data: bytes) -> bool:
        """Take an answer; return whether it is one to the request in flight."""
        answer, request = parse_sdo(data), self._request
        if answer is None or request is None or not self._attempts:
            return False
        if (answer.index, answer.sub) != (request.entry.index, request.entry.sub):
            return False
        if not answer.abort and (answer.data is None) == (request.value is None):
            return False  # an answer to a read where a write was sent, or the reverse
        self._advance(answer)
        return True

    def _advance(self, answer: SdoAnswer | None) -> None:
        self._attempts = 0
        try:
            self._request = next(self._steps) if answer is None else self._steps.send(answer)
        except StopIteration as end:
            self._request, self.result = None, end.value
        except SdoError as error:
            self._end(str(error))

    def _end(self, failure: str) -> None:
        self._request, self.failure = None, failure
