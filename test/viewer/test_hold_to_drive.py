import math

import pytest

from omniman_ros.viewer.events import ButtonHeld, ButtonReleased, ClientDisconnected
from omniman_ros.viewer.hold_to_drive import DEAD_MAN_TIMEOUT, MOTIONS, HoldToDrive

SPEEDS = (0.4, 0.8)


@pytest.fixture
def hold():
    return HoldToDrive()


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_held_button_requests_its_motion(hold, motion):
    hold.update(ButtonHeld(1, motion), 10.0)
    x, y, turn = MOTIONS[motion]
    assert hold.twist(10.1, *SPEEDS) == (0.4 * x, 0.4 * y, 0.8 * turn)


def test_no_motion_is_requested_before_and_after_holding(hold):
    assert hold.twist(10.0, *SPEEDS) is None
    hold.update(ButtonHeld(1, "forward"), 10.0)
    hold.update(ButtonReleased(1, "forward"), 10.05)
    assert hold.twist(10.05, *SPEEDS) is None


def test_a_silent_page_releases_its_buttons(hold):
    for i in range(10):
        hold.update(ButtonHeld(1, "forward"), 10.0 + 0.05 * i)
    assert hold.twist(10.45 + 0.9 * DEAD_MAN_TIMEOUT, *SPEEDS) is not None
    assert hold.twist(10.45 + 1.01 * DEAD_MAN_TIMEOUT, *SPEEDS) is None
    assert hold.twist(10.45, *SPEEDS) is None, "and stays released"


def test_a_disconnected_page_releases_all_its_buttons(hold):
    hold.update(ButtonHeld(2, "back"), 10.0)
    hold.update(ButtonHeld(1, "forward"), 10.0)
    hold.update(ButtonHeld(1, "turn_left"), 10.0)
    hold.update(ClientDisconnected(1), 10.0)
    assert hold.twist(10.0, *SPEEDS) == (-0.4, 0.0, 0.0)


def test_two_buttons_of_one_page_add_up_and_a_diagonal_is_no_faster(hold):
    hold.update(ButtonHeld(1, "forward"), 10.0)
    hold.update(ButtonHeld(1, "left"), 10.0)
    hold.update(ButtonHeld(1, "turn_right"), 10.0)
    x, y, turn = hold.twist(10.0, *SPEEDS)
    assert x == y
    assert math.hypot(x, y) == pytest.approx(0.4)
    assert turn == -0.8


def test_only_the_page_that_pressed_last_drives(hold):
    for now in (10.0, 10.05):
        hold.update(ButtonHeld(1, "forward"), now)
    hold.update(ButtonHeld(2, "turn_left"), 10.1)
    hold.update(ButtonHeld(1, "forward"), 10.1)
    assert hold.twist(10.1, *SPEEDS) == (0.0, 0.0, 0.8)


def test_an_unknown_motion_moves_nothing(hold):
    hold.update(ButtonHeld(1, "up"), 10.0)
    assert hold.twist(10.0, *SPEEDS) is None


def test_release_all_includes_every_page(hold):
    hold.update(ButtonHeld(1, "forward"), 10.0)
    hold.update(ButtonHeld(2, "forward"), 10.0)
    hold.release_all()
    assert hold.twist(10.0, *SPEEDS) is None
