"""What the simulated drives that report periodically have in common."""

import can
import pytest

from omniman_ros.simulation.can_drives.firmware import ReportFaults, Timer
from omniman_ros.simulation.can_drives.motor import DriveFaults


def due(timer, *times):
    return [timer.due(now) for now in times]


def test_a_timer_is_due_on_its_grid_and_does_not_make_up_for_what_it_missed():
    timer = Timer(0.005)
    timer.restart(1000.0033)
    assert due(timer, 1000.0033, 1000.0081, 1000.0083) == [True, False, True]
    assert due(timer, 1000.0982, 1000.0982, 1000.0984) == [True, False, True]
    assert due(timer, 1e6 + 0.0034, 1e6 + 0.0082, 1e6 + 0.0084) == [True, False, True]


def test_rounding_of_the_time_costs_no_turn_of_a_timer():
    timer, now = Timer(0.005), 0.0
    for _ in range(10_000):
        assert timer.due(now)
        now += 0.005


def test_a_timer_without_a_period_is_never_due():
    assert due(Timer(0.0), 0.0, 1.0, 1e9) == [False] * 3


@pytest.mark.parametrize(
    ("faults", "sent"),
    [
        ({}, [b"aa", b"bb", b"cc", b"dd"]),
        ({"short_reports": True}, [b"a", b"b", b"c", b"d"]),
        ({"duplicated_reports": True}, [b"aa", b"aa", b"bb", b"bb", b"cc", b"cc", b"dd", b"dd"]),
        ({"reordered_reports": True}, [b"bb", b"aa", b"dd", b"cc"]),
    ],
)
@pytest.mark.parametrize("extended", [False, True])
def test_reports_are_cut_sent_twice_or_in_pairs_the_later_first(faults, sent, extended):
    play, found = ReportFaults(), []
    for data in (b"aa", b"bb", b"cc", b"dd"):
        report = can.Message(arbitration_id=0x123, data=data, is_extended_id=extended)
        found += play.apply(report, DriveFaults(**faults))
    assert [bytes(message.data) for message in found] == sent
    assert {(m.arbitration_id, m.is_extended_id) for m in found} == {(0x123, extended)}


def test_reports_of_each_identifier_are_reordered_by_themselves():
    play, faults = ReportFaults(), DriveFaults(reordered_reports=True)
    found = []
    for number in (1, 2, 1, 2):
        found += play.apply(can.Message(arbitration_id=number), faults)
    assert [message.arbitration_id for message in found] == [1, 1, 2, 2]


def test_a_report_that_was_held_back_is_sent_when_the_fault_ends():
    play, found = ReportFaults(), []
    for data, faults in ((b"a", DriveFaults(reordered_reports=True)), (b"b", DriveFaults())):
        found += play.apply(can.Message(arbitration_id=1, data=data), faults)
    assert [bytes(message.data) for message in found] == [b"a", b"b"]
