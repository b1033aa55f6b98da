import math

import pytest

from omniman_ros.viewer.events import Gone, Held, Released
from omniman_ros.viewer.hold import DEAD_MAN, MOTIONS, HoldToDrive

SPEEDS = (0.4, 0.8)


@pytest.fixture
def hold():
    return HoldToDrive()


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_held_button_asks_for_its_motion(hold, motion):
    hold.hear(Held(1, motion), 10.0)
    x, y, turn = MOTIONS[motion]
    assert hold.twist(10.1, *SPEEDS) == (0.4 * x, 0.4 * y, 0.8 * turn)


def test_every_motion_has_its_opposite():
    assert {tuple(-axis + 0.0 for axis in motion) for motion in MOTIONS.values()} == set(
        MOTIONS.values()
    )


def test_nothing_is_asked_for_before_and_after(hold):
    assert hold.twist(10.0, *SPEEDS) is None
    hold.hear(Held(1, "forward"), 10.0)
    hold.hear(Released(1, "forward"), 10.05)
    assert hold.twist(10.05, *SPEEDS) is None


def test_a_page_that_falls_silent_has_released(hold):
    for i in range(10):
        hold.hear(Held(1, "forward"), 10.0 + 0.05 * i)
    assert hold.twist(10.45 + 0.9 * DEAD_MAN, *SPEEDS) is not None
    assert hold.twist(10.45 + 1.01 * DEAD_MAN, *SPEEDS) is None
    assert hold.twist(10.45, *SPEEDS) is None, "and stays released"


def test_the_dead_man_acts_soon_enough_for_a_person():
    """0.3 s, of which one period of the node and one of its look-out are not the switch's."""
    assert DEAD_MAN + 2 * 0.05 <= 0.3 + 1e-9


def test_a_page_that_is_gone_has_released_all_that_it_held(hold):
    hold.hear(Held(2, "back"), 10.0)
    hold.hear(Held(1, "forward"), 10.0)
    hold.hear(Held(1, "turn_left"), 10.0)
    hold.hear(Gone(1), 10.0)
    assert hold.twist(10.0, *SPEEDS) == (-0.4, 0.0, 0.0)


def test_two_buttons_of_one_page_add_up_and_a_diagonal_is_no_faster(hold):
    hold.hear(Held(1, "forward"), 10.0)
    hold.hear(Held(1, "left"), 10.0)
    hold.hear(Held(1, "turn_right"), 10.0)
    x, y, turn = hold.twist(10.0, *SPEEDS)
    assert x == y
    assert math.hypot(x, y) == pytest.approx(0.4)
    assert turn == -0.8


def test_of_two_pages_the_one_that_pressed_last_drives_alone(hold):
    for now in (10.0, 10.05):
        hold.hear(Held(1, "forward"), now)
    hold.hear(Held(2, "turn_left"), 10.1)
    hold.hear(Held(1, "forward"), 10.1)
    assert hold.twist(10.1, *SPEEDS) == (0.0, 0.0, 0.8)


def test_a_motion_that_nobody_knows_moves_nothing(hold):
    hold.hear(Held(1, "up"), 10.0)
    assert hold.twist(10.0, *SPEEDS) is None


def test_release_forgets_every_page(hold):
    hold.hear(Held(1, "forward"), 10.0)
    hold.hear(Held(2, "forward"), 10.0)
    hold.release()
    assert hold.twist(10.0, *SPEEDS) is None
