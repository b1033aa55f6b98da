"""Queue of the page's events."""

from collections import Counter

import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.viewer.events import MAX_EVENTS, STOP, ButtonPressed, EventQueue, GoalDragged

DRAGGED, PRESSED = GoalDragged((1.0, 2.0, 0.0), done=False), ButtonPressed(STOP)


class Handlers(dict):
    """Handlers that note what they get, and may post more."""

    def __init__(self, during=lambda event: None):
        super().__init__(dict.fromkeys((GoalDragged, ButtonPressed), self.handle))
        self.got, self._during = [], during

    def handle(self, event, now):
        self.got.append(event)
        self._during(event)


def processed(queue, during=lambda event: None):
    handlers = Handlers(during)
    assert list(queue.process(handlers, 0.0)) == []
    return handlers.got


def test_events_are_processed_in_their_order():
    queue = EventQueue()
    events = [ButtonPressed("go"), DRAGGED, ButtonPressed("reset")]
    for event in events:
        queue.post(event)
    assert processed(queue) == events and processed(queue) == []


def test_a_stop_is_next_and_what_was_requested_before_it_is_discarded():
    queue = EventQueue()
    for _ in range(3):
        queue.post(ButtonPressed("go"))
    queue.post(PRESSED)
    queue.post(DRAGGED)
    assert processed(queue) == [PRESSED, DRAGGED]


def test_a_stop_waits_for_one_handler_however_many_events_there_are():
    queue = EventQueue()
    for _ in range(2 * MAX_EVENTS):
        queue.post(DRAGGED)

    def flood(event):  # of one page, while another presses Stop
        for _ in range(3):
            queue.post(DRAGGED)
        if event is not PRESSED and len(got) == 5:
            queue.post(PRESSED)

    handlers = Handlers(flood)
    got = handlers.got
    list(queue.process(handlers, 0.0))
    assert got.index(PRESSED) == 5 and len(got) == MAX_EVENTS


def test_too_many_events_are_discarded_but_never_a_stop():
    queue = EventQueue()
    for _ in range(2 * MAX_EVENTS):
        queue.post(DRAGGED)
    assert Counter(processed(queue)) == {DRAGGED: MAX_EVENTS} and processed(queue) == []
    for _ in range(MAX_EVENTS):
        queue.post(DRAGGED)
    queue.post(PRESSED)
    assert processed(queue) == [PRESSED]


def test_a_refused_event_is_reported_and_the_next_one_is_processed():
    queue = EventQueue()
    queue.post(DRAGGED)
    queue.post(ButtonPressed("go"))

    def refuse(event):
        if event is DRAGGED:
            raise InputError("no")

    handlers = Handlers(refuse)
    assert [str(error) for error in queue.process(handlers, 0.0)] == ["no"]
    assert handlers.got == [DRAGGED, ButtonPressed("go")]


@pytest.mark.parametrize("event", [DRAGGED, PRESSED])
def test_a_closed_queue_takes_nothing(event):
    queue = EventQueue()
    queue.post(event)
    queue.close()
    queue.post(event)
    assert processed(queue) == []
