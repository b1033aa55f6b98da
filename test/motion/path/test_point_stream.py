import pytest

from omniman_ros.motion.path.moving_target import PointStream

PAUSE = 1.2


@pytest.fixture
def stream():
    made = PointStream()
    assert made.offer(10.0, "", PAUSE) == ""
    made.follow(10.2)
    return made


def test_a_stream_is_silent_after_its_time_and_goes_on_with_its_next_point(stream):
    assert not stream.is_silent(10.19) and stream.is_silent(10.21)
    stream.end()
    assert not stream.active and not stream.is_silent(99.0)
    assert stream.offer(10.3, "", PAUSE) == ""


def test_a_stream_that_lost_control_must_pause_before_it_is_used_again(stream):
    stream.lose("paused")
    for now in (10.02, 11.0, 12.0, 13.1):
        assert stream.offer(now, "", PAUSE) == "paused; the stream must pause for 1.2 s"
    assert stream.offer(14.4, "", PAUSE) == ""


def test_a_stream_that_runs_through_a_stop_does_not_move_the_arm_after_it(stream):
    assert stream.offer(10.02, "stopped", PAUSE) == "stopped" and not stream.active
    assert stream.offer(10.04, "", PAUSE).startswith("stopped; ")
    assert stream.offer(11.30, "", PAUSE) == ""


def test_only_a_stream_that_drives_can_lose_control(stream):
    stream.end()
    stream.lose("given up")
    assert stream.offer(10.02, "", PAUSE) == ""


def test_a_jump_back_in_time_ends_no_pause(stream):
    stream.lose("time went back")
    assert stream.offer(2.0, "", PAUSE) and stream.offer(2.02, "", PAUSE)
    assert stream.offer(3.5, "", PAUSE) == ""
