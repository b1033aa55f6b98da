"""Non-blocking client of expedited SDOs, which exchanges one request and answer at a time."""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Generic, TypeVar

from omniman_ros.can_drives.cia402.canopen import (
    Entry,
    SdoAnswer,
    abort_text,
    download,
    parse_sdo,
    upload,
)
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.core.errors import OmnimanError

TIMEOUT = 0.2  #: Time without an answer after which a request is repeated or given up [s]
ATTEMPTS = 3  #: Number of times that a request is sent before the dialogue fails

#: SDO abort codes for an entry that does not exist: no such object, no such sub-index
ABSENT_CODES = (0x06020000, 0x06090011)

T = TypeVar("T")  #: Type of the result of a dialogue


class SdoError(OmnimanError):
    """A dialogue failed; the message states the entry and the reason."""


@dataclass(frozen=True, slots=True)
class Request:
    """Request to read or write one entry of a drive's object dictionary."""

    entry: Entry  #: Entry to read or write
    value: int | None = None  #: Value to write; None to read


#: Steps of a dialogue: a generator that yields requests, receives each answer as the value of its
#: `yield`, and returns the result of type T.
Steps = Generator[Request, SdoAnswer, T]


def read(entry: Entry) -> Steps[int]:
    """Read an entry and return its value; raise SdoError if the server aborts that."""
    return answer_value(entry, (yield Request(entry)))


def answer_value(entry: Entry, answer: SdoAnswer) -> int:
    """Return the value in the answer to a read; raise SdoError if that was aborted."""
    if answer.data is None:
        raise SdoError(f"SDO {entry}: abort {abort_text(answer.abort)}")
    return entry.unpack(answer.data)


def write(entry: Entry, value: int, tolerated: tuple[int, ...] = ()) -> Steps[bool]:
    """Write an entry; return whether the server accepted it.

    Args:
        tolerated: Abort codes on which False is returned and no error is raised.

    Raises:
        SdoError: The server aborted the request with another code.
    """
    abort = yield from try_write(entry, value)
    if abort and abort not in tolerated:
        raise SdoError(f"SDO {entry} = {value}: abort {abort_text(abort)}")
    return not abort


def try_write(entry: Entry, value: int) -> Steps[int]:
    """Write an entry; return the abort code, or 0 if the server accepted the write."""
    answer = yield Request(entry, value)
    return answer.abort


class SdoDialogue(Generic[T]):
    """Exchanges the requests and answers of a dialogue with a node.

    At most one request is pending; the next one is sent by the first :meth:`tick` after its
    answer.
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
        """Whether the dialogue has a result or has failed."""
        return self._request is None

    def tick(self, now: float) -> list[CanFrame]:
        """Return the frames to send at `now` [s]: the request if it is due, else none.

        The dialogue fails if the last attempt has had no answer in time.
        """
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
        """Process the data of a received SDO; return whether it answers the pending request."""
        answer, request = parse_sdo(data), self._request
        if answer is None or request is None or not self._attempts:
            return False
        if (answer.index, answer.sub) != (request.entry.index, request.entry.sub):
            return False
        if not answer.abort and (answer.data is None) == (request.value is None):
            return False  # the answer to a read although a write was sent, or vice versa
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
