"""What is recorded of the motions of an interface, and motions that wait."""

from types import SimpleNamespace

import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.pending_start import WAIT_TIMEOUT
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.trajectory_interfaces.motion_log import MotionEvent, MotionLog
from omniman_ros.nodes.trajectory_interfaces.pending_motion import PendingMotion


class Node:
    """Time, and the lines of a log."""

    def __init__(self) -> None:
        self.time = 0.0
        self.lines: list[str] = []
        self.info = self.lines.append

    def now(self) -> float:
        return self.time

    def get_logger(self) -> "Node":
        return self

    def warn(self, subject: str, text: str) -> None:
        self.lines.append(text)


@pytest.fixture
def node() -> Node:
    return Node()


@pytest.fixture
def log(node: Node) -> MotionLog:
    return MotionLog(node, "path")


@pytest.mark.parametrize(
    ("cancelled", "event", "outcome"),
    [(False, MotionEvent.ARRIVED, ""), (True, MotionEvent.CANCELLED, "cancelled")],
)
def test_the_end_of_a_motion_is_its_outcome(node, log, cancelled, event, outcome):
    log.accept(replaces_pending=False)
    log.start(replaces_driven=False)
    log.announce("2 poses")
    assert (log.status.event, log.status.text) == (MotionEvent.STARTED, "2 poses")
    log.end(cancelled=cancelled)
    assert log.status.event is event and log.ledger.outcome(1) == outcome
    assert node.lines == ["path: 2 poses", f"path: {event.value}"]


def test_a_motion_that_is_given_up_says_so_everywhere(node, log):
    log.accept(replaces_pending=False)
    log.start(replaces_driven=False)
    log.give_up("no odom")
    text = "the path was given up: no odom"
    assert (log.status.event, log.status.text) == (MotionEvent.GIVEN_UP, text)
    assert log.ledger.outcome(1) == text and node.lines == [text]


def test_a_new_motion_replaces_the_one_under_way_and_the_one_that_waits(log):
    for _ in range(2):
        log.accept(replaces_pending=False)
        log.start(replaces_driven=log.ledger.started > 0)
    log.accept(replaces_pending=False)
    log.accept(replaces_pending=True)
    assert [log.ledger.outcome(k) for k in (1, 3)] == ["replaced by a new path"] * 2


class Waiting:
    """A motion that may wait, and what keeps it from its start."""

    def __init__(self, node: Node, log: MotionLog) -> None:
        self.conflict = self.reason = ""
        self.started: list[str] = []
        monitor = StreamMonitor(0.5)
        monitor.update_source("none")
        context = SimpleNamespace(node=node, stream_monitor=monitor)
        self.pending = PendingMotion(context, log, lambda: self.conflict, lambda: self.reason)

    def accept(self, name: str) -> str:
        return self.pending.accept(lambda: self.started.append(name))


@pytest.fixture
def waiting(node: Node, log: MotionLog) -> Waiting:
    return Waiting(node, log)


def test_a_motion_waits_for_the_robot_and_starts_once(node, log, waiting):
    waiting.reason = "no odom"
    assert waiting.accept("first") == "" and waiting.pending
    assert log.status.event is MotionEvent.WAITING and "no odom" in log.status.text
    waiting.reason = ""
    assert waiting.pending.start() == waiting.pending.start() == ""
    assert waiting.started == ["first"] and not waiting.pending


def test_a_motion_that_has_waited_for_too_long_is_refused(node, log, waiting):
    waiting.reason = "no odom"
    waiting.accept("first")
    node.time = WAIT_TIMEOUT + 0.1
    assert waiting.pending.start() == "no odom" and not waiting.pending
    assert log.status.event is MotionEvent.REFUSED and log.ledger.outcome(1) == "no odom"


def test_a_conflict_refuses_at_once(log, waiting):
    waiting.conflict = "a path is under way"
    assert waiting.accept("first") == "a path is under way"
    assert waiting.started == [] and log.ledger.outcome(1) == "a path is under way"


def test_a_motion_that_cannot_be_driven_is_refused(log, waiting):
    def start() -> None:
        raise InputError("too far")

    assert waiting.pending.accept(start) == "too far"
    assert log.ledger.outcome(1) == "too far"


def test_a_discarded_motion_is_cancelled_and_a_later_one_replaces_it(log, waiting):
    waiting.reason = "no odom"
    waiting.accept("first")
    waiting.accept("second")
    assert log.ledger.outcome(1) == "replaced by a new path"
    assert waiting.pending.discard() and not waiting.pending.discard()
    assert log.ledger.outcome(2) == "cancelled" and waiting.started == []
