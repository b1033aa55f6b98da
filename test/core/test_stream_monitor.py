"""The stream monitor: whether a stream is followed and when a new one may begin."""

import pytest

from omniman_ros.core.stream_monitor import TAKE_OVER, StreamMonitor

SILENCE = 1.2


@pytest.fixture
def watch():
    watch = StreamMonitor(SILENCE)
    watch.update_source("none")
    return watch


def begin(watch: StreamMonitor, now: float, taken: bool = True) -> None:
    watch.begin(now)
    watch.sent(now)
    if taken:
        watch.update_source("path")


def test_no_path_begins_without_a_controller():
    assert "no platform_controller" in StreamMonitor(SILENCE).blocking_reason


@pytest.mark.parametrize("source", ["none", "path"])
def test_path_may_begin_when_no_source_drives(watch, source):
    watch.update_source(source)
    assert watch.blocking_reason == ""


@pytest.mark.parametrize(
    ("source", "why"),
    [("cmd_vel", "cmd_vel drives"), ("mpc", "mpc drives"), ("stop", "the platform is stopped")],
)
def test_other_driving_source_blocks_a_path_and_takes_control(watch, source, why):
    begin(watch, 10.0)
    assert watch.loss_reason(10.1) == ""
    watch.update_source(source)
    assert watch.blocking_reason == watch.loss_reason(10.1) == why


def test_emergency_stop_has_priority_until_false_is_received(watch):
    begin(watch, 10.0)
    watch.update_source("stop")
    watch.update_emergency(True)
    assert watch.loss_reason(10.1) == "emergency_stop is true"
    watch.update_emergency(False)
    assert watch.blocking_reason == "the platform is stopped"


def test_stop_is_distinguished_from_other_driving_sources(watch):
    watch.update_source("cmd_vel")
    assert (watch.blocking_reason, watch.stop_reason) == ("cmd_vel drives", "")
    watch.update_stop_state("/arm_streamer", True, "~/stop")
    assert watch.stop_reason == watch.blocking_reason == "/arm_streamer is ~/stop"
    watch.update_emergency(True)
    assert watch.stop_reason == "emergency_stop is true"


def test_stopped_nodes_are_listed_until_each_runs_again(watch):
    begin(watch, 10.0)
    watch.update_stop_state("/b", True, "stopped: ~/stop")
    watch.update_stop_state("/a", True, "stopped: fault")
    assert watch.loss_reason(10.1) == "/a is stopped: fault; /b is stopped: ~/stop"
    assert set(watch.stopped_nodes) == {"/a", "/b"}
    watch.update_stop_state("/a", False, "running")
    watch.update_stop_state("/c", False, "running")
    assert watch.blocking_reason == "/b is stopped: ~/stop"
    watch.update_stop_state("/b", False, "running")
    assert watch.blocking_reason == "" and watch.stopped_nodes == ()


def test_controller_may_accept_a_stream_with_a_delay(watch):
    begin(watch, 10.0, taken=False)
    assert watch.loss_reason(10.0 + TAKE_OVER - 1e-6) == ""
    assert "does not follow it" in watch.loss_reason(10.0 + TAKE_OVER + 1e-6)
    watch.update_source("path")
    assert watch.loss_reason(10.0 + TAKE_OVER + 1e-6) == ""


def test_accepted_and_then_dropped_stream_was_cancelled(watch):
    begin(watch, 10.0)
    watch.update_source("none")
    assert "has cancelled it" in watch.loss_reason(10.01)


def test_end_of_a_previous_stream_does_not_count_for_the_next(watch):
    begin(watch, 10.0)
    watch.end(lost=False)
    begin(watch, 12.0, taken=False)  # `path` was reported for the previous stream
    watch.update_source("none")
    assert watch.loss_reason(12.01) == ""
    watch.update_source("path")
    assert watch.loss_reason(12.0 + 2 * TAKE_OVER) == ""
    watch.update_source("none")
    assert "has cancelled it" in watch.loss_reason(12.0 + 2 * TAKE_OVER)


def test_next_stream_may_continue_the_previous_without_a_report_between(watch):
    begin(watch, 10.0)
    watch.end(lost=False)
    begin(watch, 12.0, taken=False)
    assert watch.loss_reason(12.0 + 2 * TAKE_OVER) == ""
    watch.update_source("none")
    assert "has cancelled it" in watch.loss_reason(12.0 + 2 * TAKE_OVER)


def test_new_path_in_motion_continues_the_same_stream(watch):
    begin(watch, 10.0)
    watch.begin(11.0)
    watch.update_source("none")
    assert "has cancelled it" in watch.loss_reason(11.01)


def test_control_is_not_lost_before_a_stream_begins_or_after_its_end(watch):
    watch.update_source("cmd_vel")
    assert watch.loss_reason(10.0) == ""
    watch.update_source("none")
    begin(watch, 10.0)
    watch.end(lost=False)
    watch.update_source("stop")
    assert watch.loss_reason(10.1) == ""


def test_new_stream_after_lost_control_waits_for_silence(watch):
    assert watch.waiting_time(0.0) == 0.0
    begin(watch, 10.0)
    watch.sent(10.5)
    watch.end(lost=True)
    assert watch.waiting_time(10.6) == pytest.approx(SILENCE - 0.1)
    assert watch.waiting_time(10.5 + SILENCE) == 0.0


def test_new_stream_after_a_regular_end_need_not_wait(watch):
    begin(watch, 10.0)
    watch.end(lost=False)
    assert watch.waiting_time(10.0) == 0.0


@pytest.mark.parametrize(
    "overrule",
    [
        lambda watch: watch.update_source("cmd_vel"),
        lambda watch: watch.update_emergency(True),
        lambda watch: watch.update_stop_state("/a", True, "stopped"),
    ],
    ids=["cmd_vel", "emergency_stop", "a stopped node"],
)
def test_stop_after_the_end_cancels_the_stream_still_active_in_the_controller(watch, overrule):
    begin(watch, 10.0)
    watch.end(lost=False)
    overrule(watch)
    assert watch.waiting_time(10.3) == pytest.approx(SILENCE - 0.3)
    assert watch.waiting_time(10.0 + SILENCE) == 0.0


def test_backward_time_jump_restarts_the_silence(watch):
    begin(watch, 1000.0)
    watch.end(lost=True)
    watch.restart(3.0)
    assert watch.waiting_time(3.5) == pytest.approx(SILENCE - 0.5)


def test_stream_overrides_only_lower_priorities():
    watch = StreamMonitor(SILENCE, "mpc", ("path",))
    for source, why in (("path", ""), ("mpc", ""), ("cmd_vel", "cmd_vel drives")):
        watch.update_source(source)
        assert watch.blocking_reason == why


def test_stream_continues_while_a_lower_one_is_still_reported():
    watch = StreamMonitor(SILENCE, "mpc", ("path",))
    watch.update_source("path")
    watch.begin(10.0)
    assert watch.loss_reason(10.1) == ""
    assert "does not follow it" in watch.loss_reason(10.0 + TAKE_OVER + 0.1)
    watch.update_source("mpc")
    watch.update_source("path")
    assert "has cancelled it" in watch.loss_reason(10.2)
