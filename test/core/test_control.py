"""Whether the stream is followed, and when one may begin."""

import pytest

from omniman_ros.core.control import TAKE_OVER, ControlWatch

SILENCE = 1.2


@pytest.fixture
def watch():
    watch = ControlWatch(SILENCE)
    watch.hear_source("none")
    return watch


def begin(watch: ControlWatch, now: float, taken: bool = True) -> None:
    watch.begin(now)
    watch.sent(now)
    if taken:
        watch.hear_source("path")


def test_without_a_controller_no_path_begins():
    assert "no platform_controller" in ControlWatch(SILENCE).obstacle


@pytest.mark.parametrize("source", ["none", "path"])
def test_nobody_else_is_no_obstacle(watch, source):
    watch.hear_source(source)
    assert watch.obstacle == ""


@pytest.mark.parametrize(
    ("source", "why"),
    [("cmd_vel", "cmd_vel drives"), ("mpc", "mpc drives"), ("stop", "the platform is stopped")],
)
def test_others_that_drive_are_an_obstacle_and_take_control(watch, source, why):
    begin(watch, 10.0)
    assert watch.lost(10.1) == ""
    watch.hear_source(source)
    assert watch.obstacle == watch.lost(10.1) == why


def test_emergency_stop_comes_first_and_false_ends_it(watch):
    begin(watch, 10.0)
    watch.hear_source("stop")
    watch.hear_emergency(True)
    assert watch.lost(10.1) == "emergency_stop is true"
    watch.hear_emergency(False)
    assert watch.obstacle == "the platform is stopped"


def test_a_stop_is_told_apart_from_others_that_drive(watch):
    watch.hear_source("cmd_vel")
    assert (watch.obstacle, watch.stop) == ("cmd_vel drives", "")
    watch.hear_stop("/arm_streamer", True, "~/stop")
    assert watch.stop == watch.obstacle == "/arm_streamer is ~/stop"
    watch.hear_emergency(True)
    assert watch.stop == "emergency_stop is true"


def test_stopped_nodes_are_named_until_each_runs_again(watch):
    begin(watch, 10.0)
    watch.hear_stop("/b", True, "stopped: ~/stop")
    watch.hear_stop("/a", True, "stopped: fault")
    assert watch.lost(10.1) == "/a is stopped: fault; /b is stopped: ~/stop"
    assert set(watch.stopped) == {"/a", "/b"}
    watch.hear_stop("/a", False, "running")
    watch.hear_stop("/c", False, "running")
    assert watch.obstacle == "/b is stopped: ~/stop"
    watch.hear_stop("/b", False, "running")
    assert watch.obstacle == "" and watch.stopped == ()


def test_the_controller_may_take_a_moment_to_take_it(watch):
    begin(watch, 10.0, taken=False)
    assert watch.lost(10.0 + TAKE_OVER - 1e-6) == ""
    assert "does not take it" in watch.lost(10.0 + TAKE_OVER + 1e-6)
    watch.hear_source("path")
    assert watch.lost(10.0 + TAKE_OVER + 1e-6) == ""


def test_what_was_taken_and_is_dropped_was_cancelled(watch):
    begin(watch, 10.0)
    watch.hear_source("none")
    assert "has cancelled it" in watch.lost(10.01)


def test_the_end_of_a_stream_that_is_still_held_says_nothing_of_the_next(watch):
    begin(watch, 10.0)
    watch.end(lost=False)
    begin(watch, 12.0, taken=False)  # `path` was said of the stream before
    watch.hear_source("none")
    assert watch.lost(12.01) == ""
    watch.hear_source("path")
    assert watch.lost(12.0 + 2 * TAKE_OVER) == ""
    watch.hear_source("none")
    assert "has cancelled it" in watch.lost(12.0 + 2 * TAKE_OVER)


def test_one_stream_that_the_next_goes_on_from_without_a_word(watch):
    begin(watch, 10.0)
    watch.end(lost=False)
    begin(watch, 12.0, taken=False)
    assert watch.lost(12.0 + 2 * TAKE_OVER) == ""
    watch.hear_source("none")
    assert "has cancelled it" in watch.lost(12.0 + 2 * TAKE_OVER)


def test_a_new_path_on_the_move_is_the_same_stream(watch):
    begin(watch, 10.0)
    watch.begin(11.0)
    watch.hear_source("none")
    assert "has cancelled it" in watch.lost(11.01)


def test_nothing_is_lost_before_a_stream_begins_and_after_its_end(watch):
    watch.hear_source("cmd_vel")
    assert watch.lost(10.0) == ""
    watch.hear_source("none")
    begin(watch, 10.0)
    watch.end(lost=False)
    watch.hear_source("stop")
    assert watch.lost(10.1) == ""


def test_after_control_was_lost_a_new_stream_waits_for_silence(watch):
    assert watch.wait(0.0) == 0.0
    begin(watch, 10.0)
    watch.sent(10.5)
    watch.end(lost=True)
    assert watch.wait(10.6) == pytest.approx(SILENCE - 0.1)
    assert watch.wait(10.5 + SILENCE) == 0.0


def test_after_an_end_of_its_own_it_need_not_wait(watch):
    begin(watch, 10.0)
    watch.end(lost=False)
    assert watch.wait(10.0) == 0.0


@pytest.mark.parametrize(
    "overrule",
    [
        lambda watch: watch.hear_source("cmd_vel"),
        lambda watch: watch.hear_emergency(True),
        lambda watch: watch.hear_stop("/a", True, "stopped"),
    ],
    ids=["cmd_vel", "emergency_stop", "a stopped node"],
)
def test_a_stop_after_the_end_cancels_what_the_controller_still_holds(watch, overrule):
    begin(watch, 10.0)
    watch.end(lost=False)
    overrule(watch)
    assert watch.wait(10.3) == pytest.approx(SILENCE - 0.3)
    assert watch.wait(10.0 + SILENCE) == 0.0


def test_time_that_goes_back_counts_silence_anew(watch):
    begin(watch, 1000.0)
    watch.end(lost=True)
    watch.restart(3.0)
    assert watch.wait(3.5) == pytest.approx(SILENCE - 0.5)


def test_a_stream_overrules_those_below_it_only():
    watch = ControlWatch(SILENCE, "mpc", ("path",))
    for source, why in (("path", ""), ("mpc", ""), ("cmd_vel", "cmd_vel drives")):
        watch.hear_source(source)
        assert watch.obstacle == why


def test_a_stream_goes_on_while_the_one_below_it_is_still_named():
    watch = ControlWatch(SILENCE, "mpc", ("path",))
    watch.hear_source("path")
    watch.begin(10.0)
    assert watch.lost(10.1) == ""
    assert "does not take it" in watch.lost(10.0 + TAKE_OVER + 0.1)
    watch.hear_source("mpc")
    watch.hear_source("path")
    assert "has cancelled it" in watch.lost(10.2)
