import itertools
import random

import pytest

from omniman_ros.core.emergency_buttons import EmergencyButtons


class Buttons:
    """Publishers that number their messages, each from a number of its own on."""

    def __init__(self, *first):
        self.core, self.present = EmergencyButtons(), len(first)
        self._numbers = [itertools.count(number) for number in first]
        self._time = itertools.count(1000)

    def send(self, publisher, pressed, deliveries=2):
        number, sent = next(self._numbers[publisher]), next(self._time)
        for _ in range(deliveries):  # each node has two subscriptions
            self.core.update(pressed, number, sent)
        return self.pressed

    @property
    def pressed(self):
        return self.core.is_pressed(self.present)


@pytest.mark.parametrize("first", [(1, 1), (1, 7), (7, 1)])
def test_a_false_of_another_publisher_releases_nothing(first):
    buttons = Buttons(*first)
    assert not buttons.send(1, False)
    assert buttons.send(0, True)
    for _ in range(20):
        assert buttons.send(1, False)
    assert buttons.send(0, True)
    assert not buttons.send(0, False)


def test_it_is_released_when_the_last_of_those_who_pressed_releases():
    buttons = Buttons(1, 20, 40)
    assert buttons.send(0, True)
    assert buttons.send(1, True)
    assert buttons.send(0, False)
    assert buttons.send(2, False)
    assert not buttons.send(1, False)


@pytest.mark.parametrize("seed", range(20))
def test_any_sequence_of_publishers_that_can_be_told_apart_is_their_or(seed):
    draw = random.Random(seed)
    buttons, state = Buttons(1, 1000, 2000, 3000), [False] * 4
    for _ in range(300):
        publisher, pressed = draw.randrange(4), draw.random() < 0.4
        state[publisher] = pressed
        assert buttons.send(publisher, pressed) == any(state)


@pytest.mark.parametrize("seed", range(20))
def test_it_is_never_released_while_one_presses_and_is_when_all_have_said_so_again(seed):
    draw = random.Random(seed)
    buttons, state = Buttons(*(draw.randrange(1, 4) for _ in range(3))), [False] * 3
    for publisher in range(3):
        buttons.send(publisher, False)
    for _ in range(100):
        publisher, pressed = draw.randrange(3), draw.random() < 0.4
        state[publisher] = pressed
        assert buttons.send(publisher, pressed) >= any(state)
    for publisher in [*range(3), *range(3), *range(3)]:
        buttons.send(publisher, False)
    assert not buttons.pressed


def test_the_last_message_counts_once_a_single_publisher_is_left():
    buttons = Buttons(1, 1)
    assert buttons.send(0, True)
    assert buttons.send(1, False)
    buttons.present = 1  # the one that has pressed is gone
    assert not buttons.pressed
    buttons.present = 2
    assert not buttons.pressed


def test_what_a_publisher_that_is_gone_has_said_last_stays():
    buttons = Buttons(1)
    buttons.send(0, True)
    buttons.present = 0
    assert buttons.pressed


def test_a_message_that_is_delivered_again_later_changes_nothing():
    core = EmergencyButtons()
    for pressed, number in ((True, 1), (False, 2), (True, 1), (False, 2)):
        core.update(pressed, number, 1000 + number)
    assert not core.is_pressed(1)
    assert not core.is_pressed(2)


def test_many_publishers_that_come_and_go_are_forgotten_but_not_one_that_presses():
    core = EmergencyButtons()
    core.update(True, 1, 0)
    for k in range(500):
        core.update(False, 10 * k + 5, k + 1)
    assert core.is_pressed(3)
    core.update(False, 2, 1000)
    assert not core.is_pressed(3)


def test_without_numbers_the_last_message_counts():
    core = EmergencyButtons()
    for pressed in (True, False, True):
        core.update(pressed, None, 1000)
        assert core.is_pressed(2) == pressed
