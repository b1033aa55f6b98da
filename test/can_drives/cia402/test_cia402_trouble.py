"""Detection, reporting and recovery of faults by a CiA 402 axis, in injected time."""

import math
import struct

import pytest

from omniman_ros.can_drives.axis import AxisState, Demand, DriveSetpoint, Receipt
from omniman_ros.can_drives.cia402.state import FaultReset
from omniman_ros.control.wheel_cascade import DriveMode
from test.can_drives.cia402.fake_cia402 import WORDS, Bench, FakeDrive

MOVING = DriveSetpoint(DriveMode.VELOCITY, 50.0)


def still(bench, steps=1):
    """Step, and assert that no motion is requested."""
    for _ in range(steps):
        bench.step()
        for number, data in bench.rpdos().items():
            assert data[2:6] == bytes(4) if number == 1 else number != 2


# At reception: the fault is present as soon as the axis receives the frame, without a tick.


def test_emergency_is_a_fault_at_reception():
    bench = Bench().driving(MOVING)
    assert bench.tell(0x080, "1032050102030405") is Receipt.ACCEPTED
    assert bench.axis.fault_reason == "EMCY 3210 (Voltage), error register 05"
    still(bench, 5)
    assert bench.axis.state is AxisState.STOPPING  # DRIVE with trouble is a quick stop


def test_cleared_emergency_clears_nothing_and_is_not_a_fault():
    bench = Bench().driving(MOVING)
    bench.tell(0x080, "0000000000000000")
    assert bench.axis.fault_reason == ""
    bench.tell(0x080, "3081110000000000")
    bench.tell(0x080, "0000000000000000")
    assert bench.axis.fault_reason == "EMCY 8130 (Monitoring), error register 11"


@pytest.mark.parametrize("word, name", [("1F02", "fault reaction active"), ("1802", "fault")])
def test_fault_is_a_fault_at_reception(word, name):
    bench = Bench().driving(MOVING)
    bench.tell(0x180, word + "090000")
    assert bench.axis.state is AxisState.FAULT
    assert bench.axis.fault_reason == f"{name}, statusword {word[2:]}{word[:2]}"
    still(bench)


def test_error_code_of_a_fault_is_reported():
    bench = Bench().driving(MOVING)
    bench.tell(0x380, "1023C05D0000")  # 2310 at 24 V: an old one, it is kept
    assert bench.axis.fault_reason == ""
    bench.tell(0x180, "1802090000")
    assert bench.axis.fault_reason == "fault, statusword 0218; error code 2310 (Current)"


def test_boot_up_is_a_fault_at_reception_and_needs_a_configuration():
    bench = Bench().driving(MOVING)
    before = bench.axis.feedback.restarts
    assert bench.tell(0x700, "00") is Receipt.ACCEPTED
    assert bench.axis.fault_reason == "restarted (boot-up)"
    assert bench.axis.state is AxisState.OFFLINE
    assert bench.axis.feedback.restarts == before + 1
    still(bench, 3)


def test_position_continues_after_a_restart():
    bench = Bench().driving(MOVING)
    bench.step(50)
    before = bench.axis.feedback.position
    assert before > 1.0
    bench.drive = FakeDrive()
    bench.drive.objects[0x6064, 0] = 123456
    bench.tell(0x700, "00")
    bench.demand = Demand.IDLE
    bench.axis.reset(bench.now)
    bench.until(AxisState.READY)
    bench.step(3)
    assert bench.axis.feedback.position == pytest.approx(before)


def test_position_continues_after_an_unnoticed_restart():
    bench = Bench().driving(MOVING)
    bench.step(50)
    before = bench.axis.feedback.position
    bench.now += 60.0
    bench.drive = FakeDrive()
    bench.drive.objects[0x6064, 0] = -987654
    bench.demand = Demand.IDLE
    bench.configured()
    bench.step(3)
    assert bench.axis.feedback.position == pytest.approx(before)


def test_position_continues_after_a_restart_of_a_lost_drive():
    bench = Bench().driving(MOVING)
    bench.step(50)
    bench.drive.silent = {"heartbeat", "motion", "status"}
    bench.step(30)
    assert (
        "heartbeat lost" in bench.axis.fault_reason or "statusword lost" in bench.axis.fault_reason
    )
    before = bench.axis.feedback.position
    bench.drive = FakeDrive()
    bench.drive.objects[0x6064, 0] = -987654
    bench.demand = Demand.IDLE
    bench.step(10)
    bench.axis.reset(bench.now)
    bench.until(AxisState.READY)
    bench.step(3)
    assert bench.axis.feedback.position == pytest.approx(before)


def test_position_is_kept_by_a_configuration():
    bench = Bench().driving(MOVING)
    bench.step(50)
    before = bench.axis.feedback.position
    bench.drive.objects[0x6064, 0] += 1024  # it rolls on
    bench.demand = Demand.IDLE
    bench.configured()
    bench.step(3)
    assert bench.axis.feedback.position == pytest.approx(before + math.pi / 2)


@pytest.mark.parametrize("data, name", [("7F", "pre-operational"), ("04", "stopped")])
def test_drive_that_is_not_operational_is_a_fault_at_reception(data, name):
    bench = Bench().driving(MOVING)
    bench.tell(0x700, data)
    assert bench.axis.fault_reason == f"left operational by itself: heartbeat reports {name}"
    assert bench.axis.state is AxisState.OFFLINE
    still(bench)


@pytest.mark.parametrize(
    "state, trouble",
    [
        ("disabled", "lost its power stage: switch on disabled"),
        ("ready", "lost its power stage: ready to switch on"),
        ("on", "lost its power stage: switched on"),
        ("boot", "lost its power stage: not ready to switch on"),
        ("quick", "stops by itself: quick stop active"),
    ],
)
def test_unrequested_leaving_of_the_enabled_state_is_a_fault_at_reception(state, trouble):
    bench = Bench().driving(MOVING)
    bench.tell(0x180, struct.pack("<Hbh", WORDS[state], 9, 0).hex())
    assert bench.axis.fault_reason == trouble
    still(bench)
    assert bench.axis.state in (AxisState.READY, AxisState.STOPPING)


def test_requested_leaving_of_the_enabled_state_is_not_a_fault():
    bench = Bench().driving(MOVING)
    bench.demand = Demand.STOP
    bench.step()
    bench.demand = Demand.DRIVE
    bench.tell(0x180, struct.pack("<Hbh", WORDS["quick"], 9, 0).hex())
    bench.step()
    assert bench.axis.fault_reason == ""


def test_up_to_four_reasons_are_kept():
    bench = Bench().driving()
    for code in ("1032", "1032", "2031", "1023", "3081", "0050"):
        bench.tell(0x080, code + "000000000000")
    assert [part[:9] for part in bench.axis.fault_reason.split("; ")] == [
        "EMCY 3210",
        "EMCY 3120",
        "EMCY 2310",
        "EMCY 8130",
    ]


# In the tick


def lost_after(bench, part):
    """Return the time from the last frame of a kind until the fault."""
    bench.step(6 - bench.steps % 6)  # a heartbeat was just sent
    begin = bench.now
    bench.drive.silent = {part}
    while not bench.axis.fault_reason:
        bench.step()
        assert bench.now - begin < 1.0
    still(bench, 2)
    return bench.now - begin - 0.01


def test_missing_heartbeat_is_a_fault_after_three_periods_and_a_tick():
    bench = Bench().driving(MOVING)
    assert 0.09 <= lost_after(bench, "heartbeat") <= 0.09 + 2 * 0.005 + 1e-9
    assert bench.axis.fault_reason.startswith("heartbeat lost for 0.")
    assert bench.axis.state is AxisState.OFFLINE
    assert (
        bench.drive.state == "quick"
    )  # the drive still obeys PDOs although nothing is received from it


def test_missing_statusword_is_a_fault_after_three_periods_and_a_tick():
    bench = Bench().driving(MOVING)
    assert 0.015 <= lost_after(bench, "status") <= 0.025 + 1e-9
    assert bench.axis.fault_reason.startswith("statusword lost for 0.02")
    assert bench.drive.state == "quick"


def test_pause_of_the_ticks_is_not_a_loss_of_the_drive():
    bench = Bench().driving()
    for _ in range(40):
        bench.now += 0.03
        bench.deliver(bench.drive.heartbeat())
    bench.step(10)
    assert bench.axis.fault_reason == ""


def test_wrong_mode_is_a_fault_after_a_tenth_of_a_second():
    bench = Bench().driving(MOVING)
    bench.drive.shown_mode = 3
    begin = bench.now
    while not bench.axis.fault_reason:
        bench.step()
        assert bench.now - begin < 1.0
    assert 0.1 < bench.now - begin <= 0.1 + 3 * 0.005
    assert bench.axis.fault_reason == (
        "shows mode 3 (profiled velocity) instead of 9 (cyclic synchronous velocity)"
    )
    still(bench, 3)


def test_drive_that_refuses_a_mode_is_reported():
    bench = Bench(mode=DriveMode.TORQUE).driving(MOVING)
    bench.drive.shown_mode = 9
    bench.setpoint = DriveSetpoint(DriveMode.TORQUE, 0.1)
    bench.step(30)
    assert "shows mode 9 (cyclic synchronous velocity) instead of 10" in bench.axis.fault_reason


def test_stuck_statusword_is_reported_when_it_does_not_stop():
    bench = Bench().driving(MOVING)
    bench.drive.frozen_word = WORDS["enabled"]
    bench.demand = Demand.STOP
    bench.step(18)
    assert bench.axis.fault_reason == ""
    bench.step(6)
    assert bench.axis.fault_reason == "shows operation enabled although a quick stop was commanded"


# Recovery


@pytest.mark.parametrize("cause", ["0x080", "left"])
def test_reset_clears_the_fault_without_motion(cause):
    bench = Bench().driving(MOVING)
    if cause == "left":
        bench.drive.state = "disabled"
    else:
        bench.tell(0x080, "1032050102030405")
    bench.step(5)
    assert bench.axis.fault_reason
    bench.demand = Demand.IDLE
    bench.axis.reset(bench.now)
    assert bench.axis.fault_reason == ""
    still(bench, 20)
    bench.demand = Demand.DRIVE
    bench.until(AxisState.ENABLED)
    assert bench.axis.fault_reason == ""


def faulted():
    bench = Bench().driving(MOVING)
    bench.drive.state = "fault"
    bench.step(3)
    assert bench.axis.state is AxisState.FAULT
    bench.demand = Demand.IDLE
    return bench


def test_fault_is_reset_by_an_edge_of_bit_7():
    bench = faulted()
    bench.axis.reset(bench.now)
    words = []
    while bench.axis.state is AxisState.FAULT:
        still(bench)
        words.append(bench.rpdos()[1][0])
        assert len(words) < 20
    assert set(words[:-1]) == {0x00} and words[-1] == 0x80
    assert (bench.drive.resets, bench.axis.fault_reason) == (1, "")
    bench.step(5)
    assert bench.rpdos()[1][0] == 0x06
    assert bench.axis.state is AxisState.READY


def test_edges_are_repeated_until_the_fault_is_left():
    bench = faulted()
    bench.drive.fixes = False
    bench.axis.reset(bench.now)
    still(bench, 60)
    assert bench.drive.resets >= 3
    assert bench.axis.fault_reason == ""
    bench.drive.fixes = True
    still(bench, 20)
    assert (bench.axis.state, bench.axis.fault_reason) == (AxisState.READY, "")


def test_reset_of_a_persistent_fault_is_given_up():
    bench = faulted()
    bench.drive.fixes = False
    bench.axis.reset(bench.now)
    begin = bench.now
    while not bench.axis.fault_reason:
        still(bench)
    assert FaultReset.TIMEOUT < bench.now - begin <= FaultReset.TIMEOUT + 0.01
    assert "fault is not reset in 1 s" in bench.axis.fault_reason
    resets = bench.drive.resets
    still(bench, 50)
    assert bench.drive.resets == resets
    bench.drive.fixes = True
    bench.axis.reset(bench.now)
    still(bench, 20)
    assert (bench.axis.state, bench.axis.fault_reason) == (AxisState.READY, "")


def test_fault_after_a_reset_is_a_fault_again():
    bench = faulted()
    bench.axis.reset(bench.now)
    still(bench, 20)
    bench.demand = Demand.DRIVE
    bench.until(AxisState.ENABLED)
    bench.drive.state = "fault"
    bench.step(2)
    assert bench.axis.fault_reason == "fault, statusword 0218"


def test_no_edge_is_sent_to_a_drive_without_a_fault():
    bench = Bench().driving(MOVING)
    bench.tell(0x080, "1032050102030405")
    bench.step(3)
    bench.demand = Demand.IDLE
    bench.axis.reset(bench.now)
    for _ in range(50):
        bench.step()
        assert bench.rpdos()[1][0] != 0x80


def test_drive_that_restarted_is_configured_again_by_a_reset():
    bench = Bench().driving(MOVING)
    bench.drive = FakeDrive()
    bench.tell(0x700, "00")
    bench.demand = Demand.STOP
    bench.step(20)
    assert bench.axis.state is AxisState.OFFLINE
    bench.axis.reset(bench.now)
    assert (bench.axis.state, bench.axis.fault_reason) == (AxisState.CONFIGURING, "")
    bench.demand = Demand.IDLE
    bench.until(AxisState.READY)
    assert bench.drive.objects[0x1016, 1] == 127 << 16 | 100
    assert bench.drive.nmt == 5


def test_reset_of_a_drive_offline_in_fault_resets_the_fault_too():
    bench = Bench().driving(MOVING)
    bench.drive.state, bench.drive.nmt = "fault", 0x7F
    bench.step(10)
    assert bench.axis.state is AxisState.OFFLINE
    bench.demand = Demand.IDLE
    bench.axis.reset(bench.now)
    bench.until(AxisState.READY)
    assert (bench.axis.fault_reason, bench.drive.resets) == ("", 1)


def test_drive_configured_in_fault_reports_it_and_waits_for_a_reset():
    drive = FakeDrive()
    drive.state = "fault"
    bench = Bench(drive)
    bench.axis.configure(0.0)
    bench.until(AxisState.FAULT)
    assert bench.axis.fault_reason == "fault, statusword 0218"
    assert drive.resets == 0
    bench.axis.reset(bench.now)
    bench.until(AxisState.READY)


def test_reset_during_configuration_has_no_effect():
    bench = Bench()
    bench.axis.configure(0.0)
    bench.step(20)
    bench.axis.reset(bench.now)
    bench.until(AxisState.READY)
    assert [str(f) for f in bench.sent].count("000#8005") == 1


def test_configure_in_motion_switches_the_power_off():
    bench = Bench().driving(MOVING)
    bench.axis.configure(bench.now)
    assert bench.axis.state is AxisState.CONFIGURING
    bench.step(3)
    assert bench.drive.state == "disabled"
    bench.demand = Demand.IDLE
    still(bench, 150)
    assert bench.axis.state is AxisState.READY


@pytest.mark.parametrize("demand, word", [(Demand.STOP, 2), (Demand.DRIVE, 2), (Demand.IDLE, 0)])
def test_drive_that_receives_no_pdo_is_stopped_by_sdo(demand, word):
    bench = Bench().driving(MOVING)
    bench.drive.nmt = 0x7F  # it keeps turning: the profile defines no reaction to this
    bench.tell(0x700, "7F")
    bench.demand = demand
    still(bench, 2)
    assert (0x6040, 0, word) in bench.drive.written
    assert bench.drive.state == {2: "quick", 0: "disabled"}[word]
    still(bench, 50)
    told = bench.drive.written.count((0x6040, 0, word)) - (word == 0)  # once in the beginning
    assert told == 3  # in 0.26 s
    assert Receipt.MALFORMED not in bench.receipts


def test_drive_whose_reconfiguration_fails_is_still_commanded_to_stop():
    bench = Bench().driving(MOVING)
    bench.tell(0x700, "7F")
    bench.lost = lambda frame: True
    bench.axis.reset(bench.now)
    bench.until(AxisState.OFFLINE)
    assert "no answer" in bench.axis.fault_reason
    bench.drive.state = "enabled"
    bench.demand = Demand.STOP
    still(bench, 25)
    assert bench.rpdos()[1][0] == 2
    assert bench.drive.state == "quick"


def test_stale_answer_is_not_taken_for_feedback():
    bench = Bench().driving()
    bench.tell(0x700, "00")
    before = bench.axis.feedback.count
    assert bench.tell(0x280, "00" * 8) is Receipt.ACCEPTED  # default mapping, not ours
    assert bench.axis.feedback.count == before


def test_mismatched_sdo_answers_do_not_end_the_configuration():
    bench = Bench()
    bench.axis.configure(0.0)
    while bench.axis.state is AxisState.CONFIGURING:
        bench.step()
        if bench.axis.state is AxisState.CONFIGURING:
            for data in ("6099990000000000", "4B99990000000000", "8099990000000206", "60"):
                assert bench.tell(0x580, data) is Receipt.MALFORMED
        assert bench.now < 3.0
    assert (bench.axis.state, bench.axis.fault_reason) == (AxisState.READY, "")


def test_abort_is_a_fault_at_reception():
    bench = Bench()
    bench.axis.configure(0.0)
    bench.lost = lambda frame: frame.id == 0x585
    bench.step(3)
    assert bench.tell(0x580, "6040600000000000") is Receipt.ACCEPTED
    bench.step()
    assert bench.tell(0x580, "8000100000000008") is Receipt.ACCEPTED
    assert bench.axis.fault_reason == "SDO 1000:00 (device type): abort 08000000 (General error)"
    assert bench.axis.state is AxisState.OFFLINE


def test_there_is_no_feedback_before_the_first_report():
    feedback = Bench().axis.feedback
    assert (feedback.at, feedback.count) == (-math.inf, 0)
