"""What is recorded and told of motions, from the request of each to its end."""

from itertools import count

import pytest

from omniman_ros.conversions.headers import SerializedStamp
from omniman_ros.core.errors import InputError
from omniman_ros.core.pending_start import WAIT_TIMEOUT
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.motion_log import (
    LoggedMotion,
    MotionEvent,
    MotionInput,
    MotionLog,
    PendingMotion,
)

AT_ONCE = [MotionEvent.RECEIVED, MotionEvent.STARTED]


def stamp(request: str) -> SerializedStamp:
    """Return a stamp of the request that a letter names."""
    return SerializedStamp(ord(request), 5)


class Node:
    """Logs of a node, and what they have told, by the requests of motions."""

    def __init__(self) -> None:
        self.told: dict[str, list[MotionEvent]] = {}
        self.reasons: list[str] = []
        numbers = count(1)
        self.path = MotionLog(MotionInput.PATH, numbers, self._tell)
        self.tool = MotionLog(MotionInput.TOOL_PATH, numbers, self._tell)

    def _tell(self, motion: LoggedMotion, event: MotionEvent, reason: str, text: str) -> None:
        name = chr(int(motion.request.partition(".")[0]))
        self.told.setdefault(name, []).append(event)
        self.reasons.append(reason)

    def driven(self, request: str) -> LoggedMotion:
        motion = self.path.receive(stamp(request))
        self.path.start(motion, "2 poses")
        return motion


@pytest.fixture
def node() -> Node:
    return Node()


@pytest.mark.parametrize(
    ("event", "outcome"),
    [
        (MotionEvent.ARRIVED, ""),
        (MotionEvent.CANCELLED, "cancelled"),
        (MotionEvent.GIVEN_UP, "the path was given up: no odom"),
    ],
)
def test_a_motion_has_one_end_which_is_its_outcome(node, event, outcome):
    motion = node.driven("a")
    assert motion.outcome is None and node.path.text == "2 poses"
    reason = "no odom" if event is MotionEvent.GIVEN_UP else ""
    node.path.note(event, reason)
    node.path.note(MotionEvent.CANCELLED)
    node.path.report(motion, MotionEvent.ARRIVED)
    assert motion.outcome == outcome and node.path.text == (outcome or "arrived")
    assert node.told == {"a": [*AT_ONCE, event]} and node.path.driven is None


def test_a_request_is_named_by_its_stamp_with_nine_digits_of_nanoseconds(node):
    assert node.path.receive(SerializedStamp(97, 123)).request == "97.000000123"


def test_motions_of_all_interfaces_have_numbers_of_their_own(node):
    logs = node.path, node.tool, node.path
    assert [log.receive(stamp("a")).number for log in logs] == [1, 2, 3]


def test_a_new_motion_replaces_the_one_under_way(node):
    first, second = node.driven("a"), node.driven("b")
    assert first.outcome == "replaced by a new path" and second.outcome is None
    assert node.told == {"a": [*AT_ONCE, MotionEvent.REPLACED], "b": AT_ONCE}


def test_a_pause_is_told_once_and_only_of_a_motion_under_way(node):
    paused, resumed = MotionEvent.PAUSED, MotionEvent.RESUMED
    node.path.note(paused)
    node.driven("a")
    for event in (resumed, paused, paused, resumed, resumed):
        node.path.note(event)
    assert node.told == {"a": [*AT_ONCE, paused, resumed]}


@pytest.mark.parametrize(("reason", "is_trouble"), [("", False), ("no odom", True)])
def test_a_pause_is_trouble_if_the_node_has_a_reason_for_it(node, reason, is_trouble):
    node.driven("a")
    node.path.note(MotionEvent.PAUSED, reason)
    assert node.path.is_trouble is is_trouble


def test_a_reason_is_told_again_only_if_more_than_its_numbers_changes(node):
    motion = node.path.receive(stamp("a"))
    for reason in ("odom is 0.31 s old", "odom is 0.35 s old", "the robot moves"):
        node.path.report(motion, MotionEvent.WAITING, reason)
    assert node.reasons == ["", "odom is 0.31 s old", "the robot moves"]
    assert node.path.text == "a path is waiting: the robot moves"


def test_a_motion_that_another_interface_drives_is_shown_in_both_logs(node):
    motion = node.tool.receive(stamp("a"))
    node.path.start(motion, "1 m of the tool")
    node.path.note(MotionEvent.ARRIVED)
    assert node.tool.event is node.path.event is MotionEvent.ARRIVED
    assert node.told == {"a": [*AT_ONCE, MotionEvent.ARRIVED]}


def test_of_a_quiet_request_nothing_is_told_unless_it_is_used(node):
    node.path.refuse(node.path.receive(stamp("a"), quietly=True), "no odom")
    node.path.start(node.path.receive(stamp("b"), quietly=True))
    assert node.told == {"b": AT_ONCE}


class Waiting:
    """A motion that may wait, and what keeps it from its start."""

    def __init__(self, node: Node) -> None:
        self.refusal = self.reason = ""
        self.time = 100.0
        monitor = StreamMonitor(0.5)
        monitor.update_source("none")
        self.started: list[str] = []
        self.node = node
        self.pending = PendingMotion(
            self, monitor, node.path, lambda: self.reason, conflict=lambda: self.refusal
        )

    def now(self) -> float:
        return self.time

    def accept(self, name: str) -> str:
        motion = self.node.path.receive(stamp(name))
        return self.pending.accept(motion, lambda: self.started.append(name))


@pytest.fixture
def waiting(node: Node) -> Waiting:
    return Waiting(node)


def test_a_motion_waits_for_the_robot_and_starts_once(node, waiting):
    waiting.reason = "no odom"
    assert waiting.accept("a") == "" and waiting.pending
    waiting.reason = ""
    assert waiting.pending.start() == waiting.pending.start() == ""
    assert waiting.started == ["a"] and not waiting.pending
    assert node.told == {"a": [MotionEvent.RECEIVED, MotionEvent.WAITING]}


def test_a_motion_that_has_waited_for_too_long_is_refused(node, waiting):
    waiting.reason = "no odom"
    waiting.accept("a")
    waiting.time += WAIT_TIMEOUT + 0.1
    assert waiting.pending.start() == "no odom" and not waiting.pending
    assert node.told["a"][1:] == [MotionEvent.WAITING, MotionEvent.REFUSED]
    assert node.path.text == "a path was refused: no odom"


def test_a_refusal_needs_no_wait(node, waiting):
    waiting.refusal = "a path is under way"
    assert waiting.accept("a") == "a path is under way" and not waiting.started
    assert node.told == {"a": [MotionEvent.RECEIVED, MotionEvent.REFUSED]}


def test_a_motion_that_cannot_be_driven_is_refused(node, waiting):
    def start() -> None:
        raise InputError("too far")

    motion = node.path.receive(stamp("a"))
    assert waiting.pending.accept(motion, start) == motion.outcome == "too far"


def test_a_waiting_motion_is_replaced_by_a_later_one_and_cancelled_by_a_request(node, waiting):
    waiting.reason = "no odom"
    waiting.accept("a")
    waiting.accept("b")
    assert waiting.pending.discard() and not waiting.pending.discard()
    ends = [node.told[name][-1] for name in "ab"]
    assert ends == [MotionEvent.REPLACED, MotionEvent.CANCELLED] and waiting.started == []
