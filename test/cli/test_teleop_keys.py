import math

import pytest

from omniman_ros.cli.teleop_keys import (
    MAX_SCALE,
    MIN_SCALE,
    MOTIONS,
    PRESS_HOLD_TIME,
    REPEAT_HOLD_TIME,
    SCALE_STEP,
    KeyTeleop,
    split_keys,
)


@pytest.fixture
def keys():
    return KeyTeleop(linear=0.3, angular=0.6)


def hold(keys, key, start, delay, rate, until):
    """Press a key as a terminal repeats it while it is held; return the time of the last press."""
    keys.press(key, start)
    now = start + delay
    last = start
    while now <= until:
        last = now
        keys.press(key, now)
        now += 1.0 / rate
    return last


@pytest.mark.parametrize("delay", [0.2, 0.25, 0.4, 0.55])
@pytest.mark.parametrize("rate", [10.0, 25.0, 40.0])
def test_a_held_key_drives_without_a_gap(keys, delay, rate):
    events = [0.0] + [delay + i / rate for i in range(round(2 * rate))]
    now = 0.0
    while now < events[-1]:
        while events and events[0] <= now:
            keys.press("w", events.pop(0))
        assert keys.twist(now) == (0.3, 0.0, 0.0), now
        now += 0.01
        if not events:
            break


def test_a_released_key_stops_soon(keys):
    last = hold(keys, "w", 10.0, 0.5, 30.0, 12.0)
    assert keys.twist(last + REPEAT_HOLD_TIME - 0.01) == (0.3, 0.0, 0.0)
    assert keys.twist(last + REPEAT_HOLD_TIME) is None


def test_a_tap_ends_after_the_time_that_bridges_the_repeat_delay(keys):
    keys.press("w", 5.0)
    assert keys.twist(5.0 + PRESS_HOLD_TIME - 0.01) is not None
    assert keys.twist(5.0 + PRESS_HOLD_TIME) is None


def test_a_second_tap_bridges_the_repeat_delay_again(keys):
    keys.press("w", 0.0)
    keys.press("w", 0.3)
    assert keys.twist(0.3 + PRESS_HOLD_TIME - 0.01) is not None


def test_there_is_no_twist_before_the_first_key(keys):
    assert keys.twist(0.0) is None
    assert keys.twist(1e6) is None


@pytest.mark.parametrize("key", MOTIONS)
def test_every_key_drives_its_direction_at_the_set_speed(keys, key):
    keys.press(key, 0.0)
    x, y, turn = keys.twist(0.1)
    direction = MOTIONS[key]
    assert [math.copysign(1, v) if v else 0 for v in (x, y, turn)] == list(direction)
    assert math.hypot(x, y) == pytest.approx(0.3 if direction[0] or direction[1] else 0.0)
    assert abs(turn) == pytest.approx(0.6 if direction[2] else 0.0)


@pytest.mark.parametrize(
    ("first", "second", "sum_of_both"),
    [
        ("w", "a", (0.3 * 0.5**0.5, 0.3 * 0.5**0.5, 0.0)),
        ("w", "e", (0.3, 0.0, -0.6)),
        ("up", "left", (0.3, 0.0, 0.6)),
        ("w", "s", (0.0, 0.0, 0.0)),
        ("w", "up", (0.3, 0.0, 0.0)),
    ],
)
def test_keys_pressed_at_once_add_up_while_the_last_one_repeats(keys, first, second, sum_of_both):
    keys.press(first, 0.0)
    last = hold(keys, second, 0.05, 0.5, 30.0, 3.0)
    assert keys.twist(last) == pytest.approx(sum_of_both)
    assert keys.twist(last + REPEAT_HOLD_TIME) is None


def test_a_key_pressed_later_replaces_the_one_whose_release_nobody_sees(keys):
    last = hold(keys, "w", 0.0, 0.5, 30.0, 2.0)
    keys.press("e", last + 0.03)
    assert keys.twist(last + 0.04) == (0.0, 0.0, -0.6)


def test_what_was_held_before_a_pause_does_not_come_back(keys):
    keys.press("w", 0.0)
    assert keys.twist(1.0) is None
    keys.press("a", 1.1)
    assert keys.twist(1.1) == (0.0, 0.3, 0.0)


def test_a_late_tick_does_not_let_an_old_key_live_on(keys):
    keys.press("w", 0.0)
    keys.press("a", 5.0)  # no tick in between
    assert keys.twist(5.0) == (0.0, 0.3, 0.0)


def test_a_key_pressed_again_after_a_pause_adds_up_with_others_anew(keys):
    keys.press("w", 0.0)
    keys.press("w", 5.0)
    keys.press("e", 5.1)
    assert keys.twist(5.1) == pytest.approx((0.3, 0.0, -0.6))


def test_release_stops_at_once(keys):
    keys.press("w", 0.0)
    keys.release()
    assert keys.twist(0.01) is None


@pytest.mark.parametrize("key", ["x", " ", "r", "+", "z", "\n", "é", ""])
def test_other_keys_move_nothing(keys, key):
    assert not keys.press(key, 0.0)
    assert keys.twist(0.01) is None


def test_the_scale_changes_both_speeds_within_bounds(keys):
    keys.change_speed(SCALE_STEP)
    keys.press("w", 0.0)
    assert keys.twist(0.0) == pytest.approx((0.33, 0.0, 0.0))
    for _ in range(100):
        keys.change_speed(SCALE_STEP)
    assert keys.speeds == pytest.approx((0.3 * MAX_SCALE, 0.6 * MAX_SCALE))
    for _ in range(200):
        keys.change_speed(1 / SCALE_STEP)
    assert keys.speeds == pytest.approx((0.3 * MIN_SCALE, 0.6 * MIN_SCALE))


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("w", ["w"]),
        ("W", ["w"]),
        ("wa ", ["w", "a", " "]),
        ("\x1b[A\x1b[B\x1b[C\x1b[D", ["up", "down", "right", "left"]),
        ("\x1bOAw", ["up", "w"]),
        ("\x1b[1;5Aq", ["q"]),
        ("\x1b[3~q", ["q"]),
        ("\x1b[15~", []),
        ("\x1b", []),
        ("\x1b[", []),
        ("", []),
    ],
)
def test_keys_are_split_from_what_the_terminal_sends(text, names):
    assert list(split_keys(text)) == names
