"""Tests of the tour on the page."""

import pytest

from omniman_ros.viewer.events import (
    ButtonHeld,
    ButtonPressed,
    GoalDragged,
    ObstacleVelocitySet,
)
from omniman_ros.viewer.tour import STEPS, Tour

EVENTS = (
    ButtonHeld(1, "forward"),
    ButtonPressed("stop"),
    GoalDragged((1.0, 0.0, 0.0), True),
    ButtonPressed("add"),
    ObstacleVelocitySet(0, (0.1, 0.0)),
    ButtonPressed("go"),
)


def test_each_step_is_ticked_off_by_what_it_asks_for():
    tour = Tour()
    for k, event in enumerate(EVENTS):
        assert tour.text == f"{k + 1} of 6: {STEPS[k].text}"
        for other in (*EVENTS[:k], ButtonPressed("reset"), GoalDragged((0.0, 0.0, 0.0), False)):
            tour.note(other)
            assert tour.text.startswith(f"{k + 1} of 6"), "done before, or another thing"
        tour.note(event)
    assert tour.text == ""


def test_steps_may_be_done_in_any_order():
    tour = Tour()
    for event in EVENTS[:0:-1]:
        tour.note(event)
        assert tour.text.startswith("1 of 6")
    tour.note(EVENTS[0])
    assert tour.text == ""


@pytest.mark.parametrize("done", [0, 3, 6])
def test_the_tour_can_be_ended_and_begun_anew(done):
    tour = Tour()
    for event in EVENTS[:done]:
        tour.note(event)
    tour.toggle()
    assert (tour.text == "") == (done < 6)
    if done < 6:
        tour.toggle()
    assert tour.text.startswith("1 of 6")
