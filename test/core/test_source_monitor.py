"""What counts as blind: what a robot was told to look at, and does not get in usable form."""

import pytest

from omniman_ros.core.source_monitor import SourceMonitor, SourcePublisher, SourceTerms

TRACKER = SourcePublisher("/obstacle_tracker")
DEAF = SourcePublisher("/camera", "its quality of service is best effort")
STREAM = {"timeout": 1.0, "patience": 1.0}
LATCHED = {"timeout": 0.0, "patience": 2.0}


def source(topic="obstacles", **terms):
    return SourceMonitor(topic, SourceTerms(**(terms or STREAM)))


@pytest.mark.parametrize("terms", [STREAM, LATCHED])
def test_a_robot_without_sensors_is_not_blind(terms):
    monitor = source(**terms)
    assert monitor.blind_reason(0.0) == ""
    monitor.survey([], 5.0)
    assert monitor.blind_reason(1e6) == ""


@pytest.mark.parametrize("terms", [STREAM, LATCHED])
def test_what_somebody_publishes_and_has_never_come_is_blind(terms):
    monitor = source(**terms)
    monitor.survey([TRACKER], 10.0)
    assert monitor.blind_reason(10.0 + terms["patience"]) == ""
    for late in (0.1, 1e6):
        now = 10.0 + terms["patience"] + late
        monitor.survey([TRACKER], now)
        assert monitor.blind_reason(now) == "no obstacles yet from /obstacle_tracker"
    monitor.use(now)
    assert monitor.blind_reason(now) == ""


def test_a_publisher_that_leaves_before_anything_came_is_not_awaited():
    monitor = source()
    monitor.survey([TRACKER], 0.0)
    assert monitor.blind_reason(2.0)
    monitor.survey([], 2.0)
    assert monitor.blind_reason(2.0) == ""
    monitor.survey([TRACKER], 9.0)  # its patience begins anew
    assert monitor.blind_reason(9.5) == ""


@pytest.mark.parametrize("terms", [STREAM, LATCHED])
def test_what_came_and_was_never_usable_is_blind_at_once(terms):
    monitor = source("map", **terms)
    monitor.refuse("it has 2010 x 2000 cells")
    assert monitor.blind_reason(0.0) == "map cannot be used: it has 2010 x 2000 cells"
    monitor.survey([], 10.0)
    assert not monitor.dismiss()  # it told of something that is not known
    assert monitor.blind_reason(10.0)
    monitor.use(11.0)
    assert monitor.blind_reason(11.0) == ""


def test_a_stream_that_can_no_longer_be_used_is_blind_after_its_timeout():
    monitor = source()
    monitor.use(100.0)
    monitor.refuse("NaN")
    assert monitor.blind_reason(101.0) == ""  # the last usable message is not too old yet
    assert monitor.blind_reason(101.1) == "obstacles cannot be used: NaN"


def test_what_is_sent_once_is_blind_if_its_last_message_cannot_be_used():
    monitor = source("map", **LATCHED)
    monitor.use(100.0)
    assert monitor.blind_reason(1e6) == ""
    monitor.refuse("NaN")
    assert monitor.blind_reason(1e6) == "map cannot be used: NaN"


def test_a_silent_source_is_blind_until_it_is_dismissed():
    monitor = source()
    monitor.use(100.0)
    assert monitor.blind_reason(101.0) == ""
    assert monitor.blind_reason(101.24) == "no obstacles received for 1.2 s"
    monitor.survey([TRACKER], 102.0)
    assert not monitor.dismiss()  # somebody still publishes
    monitor.survey([], 103.0)
    assert monitor.dismiss()
    assert monitor.blind_reason(104.0) == ""
    monitor.use(105.0)
    assert monitor.blind_reason(106.5) == "no obstacles received for 1.5 s"


def test_a_publisher_that_cannot_be_received_makes_blind_whatever_the_others_send():
    monitor = source(timeout=0.0, patience=0.0)
    monitor.use(0.0)
    monitor.survey([TRACKER, DEAF], 0.0)
    reason = "obstacles of /camera cannot be received: its quality of service is best effort"
    assert monitor.blind_reason(0.1) == reason
    monitor.survey([TRACKER], 0.2)
    assert monitor.blind_reason(0.3) == ""


def test_a_required_source_is_awaited_without_a_publisher():
    monitor = source(timeout=0.0, patience=0.0, is_required=True)
    assert monitor.blind_reason(0.0) == "no obstacles yet: nobody sends it"
    monitor.survey([TRACKER], 0.0)
    assert monitor.blind_reason(0.0) == "no obstacles yet from /obstacle_tracker"
    monitor.use(0.0)
    assert monitor.blind_reason(1e6) == ""  # a timeout of 0 disables it
    monitor.survey([], 1.0)
    assert not monitor.dismiss()


def test_zero_timeout_and_patience_wait_for_nothing():
    monitor = source(timeout=0.0, patience=0.0)
    monitor.survey([TRACKER], 0.0)
    assert monitor.blind_reason(1e6) == ""


def test_times_count_anew_when_the_clock_goes_back():
    monitor = source()
    monitor.use(100.0)
    assert monitor.blind_reason(3.0) == ""
    assert monitor.blind_reason(4.5) == "no obstacles received for 1.5 s"
    waiting = source()
    waiting.survey([TRACKER], 100.0)
    waiting.survey([TRACKER], 3.0)
    assert waiting.blind_reason(4.0) == ""
    assert waiting.blind_reason(4.1)
