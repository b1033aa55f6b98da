"""The CiA 402 axis with an obedient drive: configuration, driving, feedback."""

import itertools
import math
import struct

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from omniman_ros.can_drives.axis import REST, AxisState, Demand, DriveSetpoint, Receipt
from omniman_ros.can_drives.cia402 import setup as cia402_setup
from omniman_ros.can_drives.cia402.axis import Cia402Axis
from omniman_ros.can_drives.cia402.network import CanopenNetwork
from omniman_ros.can_drives.cia402.state import CONTROLWORDS, PdsState, pds_state
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.core.errors import InputError, ParameterError
from test.can_drives.cia402.fake_cia402 import WORDS, Bench, FakeDrive
from test.can_drives.fuzz import settings

fixed = hypothesis_settings(deadline=None, derandomize=True, max_examples=300)
VELOCITY, TORQUE = DriveMode.VELOCITY, DriveMode.TORQUE


# Configuration


def test_nothing_is_sent_before_configuration():
    bench = Bench()
    assert bench.axis.state is AxisState.OFFLINE
    for demand in Demand:
        assert bench.axis.tick(demand, REST, 0.0) == []
    bench.axis.reset(0.0)
    assert (bench.axis.state, bench.axis.tick(Demand.DRIVE, REST, 0.1)) == (AxisState.OFFLINE, [])


def test_configuration_begins_with_nmt_pre_operational_and_power_off():
    bench = Bench()
    bench.drive.state, bench.drive.nmt = "enabled", 5
    bench.configured()
    assert str(bench.sent[1]) == "000#8005"  # after the host's heartbeat
    assert bench.drive.written[0] == (0x6040, 0, 0)
    assert bench.drive.state in ("disabled", "ready")


def test_configuration_sends_one_request_at_a_time_and_starts_last():
    bench = Bench().configured()
    own = [f for f in bench.sent if f.id not in (0x080, 0x77F)]
    assert {f.id for f in own[1:]} == {0x605, 0x000}
    ids = [f.id for f in own]
    start = [str(f) for f in own].index("000#0105")
    assert set(ids[1:start]) == {0x605}
    requests = start - 1
    assert 0.005 * requests <= bench.now <= 0.005 * requests + 0.06  # one a tick


def test_stale_setpoints_are_zeroed_before_the_node_is_started():
    drive = Bench(mode=TORQUE, feed_forward=True).configured().drive
    stale = {0x60FF, 0x6071, 0x60B1, 0x60B2}
    assert [w for w in drive.written if w[0] in stale and w[2]] == []
    assert {w[0] for w in drive.written} >= stale


def test_watchdogs_are_set():
    bench = Bench(heartbeat_timeout=0.3).configured()
    # 127 << 16 | 300: the frame of a CODESYS master, see test_canopen
    assert "605#231610012C017F00" in [str(f) for f in bench.sent]
    objects = bench.drive.objects
    assert objects[0x1017, 0] == 30
    assert objects[0x605A, 0] == 6
    assert objects[0x6007, 0] == 3
    assert objects[0x605E, 0] == 2
    assert objects[0x1029, 1] == 1
    assert objects[0x6085, 0] == round(200.0 / math.tau * 4096)


def test_used_pdos_are_mapped_and_others_disabled():
    objects = Bench(mode=TORQUE, feed_forward=True).configured().drive.objects

    def mapped(record):
        return [objects[record, n + 1] for n in range(objects[record, 0])]

    # index << 16 | sub << 8 | bits; CiA 301 7.5.2.36
    assert mapped(0x1600) == [0x60400010, 0x60FF0020, 0x60600008]
    assert mapped(0x1601) == [0x60400010, 0x60710010, 0x60600008]
    assert mapped(0x1602) == [0x60B20010]
    assert mapped(0x1A00) == [0x60410010, 0x60610008, 0x60770010]
    assert mapped(0x1A01) == [0x60640020, 0x606C0020]
    assert mapped(0x1A02) == [0x603F0010, 0x60790020]
    ids = [objects[0x1400 + n, 1] for n in range(4)]
    assert ids == [0x205, 0x305, 0x405, 0x80000505]
    # bit 30 (no RTR) is left as the drive had it
    ids = [objects[0x1800 + n, 1] for n in range(4)]
    assert ids == [0x40000185, 0x40000285, 0x40000385, 0xC0000485]
    types = [objects[0x1400, 2], objects[0x1401, 2], objects[0x1402, 2]]
    assert types + [objects[0x1800 + n, 2] for n in range(3)] == [1, 1, 1, 1, 1, 10]


def test_pdo_is_disabled_and_empty_during_mapping():
    written = Bench().configured().drive.written
    own = [(i, s, v & 0xFFFFFFFF) for i, s, v in written if i in (0x1400, 0x1600)]
    assert own == [
        (0x1400, 1, 0x80000205),
        (0x1400, 2, 1),
        (0x1600, 0, 0),
        (0x1600, 1, 0x60400010),
        (0x1600, 2, 0x60FF0020),
        (0x1600, 3, 0x60600008),
        (0x1600, 0, 3),
        (0x1400, 1, 0x205),
    ]


def test_torque_is_mapped_only_where_it_is_needed():
    bench = Bench().configured()
    assert set(bench.axis.modes) == {VELOCITY}
    assert bench.drive.objects[0x1401, 1] >> 31
    assert set(Bench(mode=DriveMode.VOLTAGE).configured().axis.modes) == {VELOCITY, TORQUE}


@pytest.mark.parametrize(
    "supported, velocity, torque", [(0x300, 9, 10), (0x30C, 9, 10), (0x00C, 3, 4), (0x108, 9, 4)]
)
def test_profile_modes_replace_missing_cyclic_modes(supported, velocity, torque):
    drive = FakeDrive()
    drive.objects[0x6502, 0] = supported
    bench = Bench(drive, mode=TORQUE).driving()
    assert bench.rpdos()[1][6] == velocity
    bench.setpoint = DriveSetpoint(TORQUE, 0.0)
    bench.step(3)
    assert bench.rpdos()[2][4] == torque
    assert (bench.axis.state, bench.axis.fault_reason) == (AxisState.ENABLED, "")


@pytest.mark.parametrize(
    "period, cycle",
    [
        (0.005, (5, -3)),
        (0.001, (1, -3)),
        (0.1, (100, -3)),
        (1 / 400, (25, -4)),
        (1 / 300, (33, -4)),
    ],
)
def test_cycle_is_written(period, cycle):
    bench = Bench(period=period).configured()
    objects = bench.drive.objects
    assert (objects[0x60C2, 1], objects[0x60C2, 2] - 256) == cycle


@pytest.mark.parametrize(
    "absent",
    [
        (0x60C2, 1),
        (0x60C2, 2),
        (0x6007, 0),
        (0x605A, 0),
        (0x605E, 0),
        (0x1029, 1),
        (0x60B1, 0),
        (0x60B2, 0),
    ],
)
def test_optional_objects_may_be_absent(absent):
    drive = FakeDrive()
    del drive.objects[absent]
    Bench(drive).configured()


# 06010002: read only; 06090030: value range; 08000022: not in this state (CiA 301 table 22)
@pytest.mark.parametrize("abort", [0x06010002, 0x06090030, 0x08000022])
@pytest.mark.parametrize("entry", [(0x60C2, 1), (0x60C2, 2), (0x605E, 0), (0x1029, 1)])
def test_optional_writes_may_be_refused(entry, abort):
    drive = FakeDrive()
    drive.aborts[(*entry, "w")] = abort
    Bench(drive).configured()


@pytest.mark.parametrize("period, cycle", [(0.005, (5, -3)), (1 / 400, (1, -3))])
def test_cycle_is_not_written_with_an_exponent_that_the_drive_lacks(period, cycle):
    drive = FakeDrive()
    drive.aborts[0x60C2, 2, "w"] = 0x06010002
    Bench(drive, period=period).configured()
    assert (drive.objects[0x60C2, 1], drive.objects[0x60C2, 2]) == cycle


def test_spare_pdo_that_stays_enabled_is_tolerated():
    drive = FakeDrive()
    drive.aborts[0x1803, 1, "w"] = 0x06010002
    Bench(drive).configured()


@pytest.mark.parametrize("entry, kept", [((0x605A, 0), 2), ((0x6007, 0), 1)])
def test_alternative_stop_option_is_accepted_if_the_preferred_is_refused(entry, kept):
    drive = FakeDrive()
    drive.objects[entry] = 0
    normal = drive.serve

    def serve(data):
        head = bytes((0x2B, entry[0] & 0xFF, entry[0] >> 8, 0))
        if data[:4] == head and data[4] != kept:
            return [CanFrame(0x585, bytes((0x80, *head[1:])) + bytes.fromhex("30000906"))]
        return normal(data)

    drive.serve = serve
    Bench(drive).configured()
    assert drive.objects[entry] == kept


def test_listed_mode_that_is_refused_is_replaced():
    # 6502 may describe other field buses of the manufacturer
    drive = FakeDrive()
    normal = drive.serve

    def serve(data):
        if data[:4] == bytes.fromhex("2F606000") and data[4] in (9, 10):
            return [CanFrame(0x585, bytes.fromhex("8060600030000906"))]
        return normal(data)

    drive.serve = serve
    bench = Bench(drive, mode=TORQUE).driving()
    assert bench.rpdos()[1][6] == 3
    bench.setpoint = DriveSetpoint(TORQUE, 0.0)
    bench.step(3)
    assert bench.rpdos()[2][4] == 4


def test_configuration_ends_in_the_velocity_mode():
    written = Bench(mode=TORQUE).configured().drive.written
    assert [value for index, _, value in written if index == 0x6060] == [10, 9]


def test_rounded_heartbeat_time_is_accepted_within_the_timeout():
    drive = FakeDrive()
    drive.ignored.add((0x1017, 0))
    drive.objects[0x1017, 0] = 40
    Bench(drive).configured()


def test_power_may_take_a_second_to_switch_off():
    for period in (0.005, 0.001):
        drive = FakeDrive()
        drive.frozen_word = WORDS["reaction"]
        bench = Bench(drive, period=period)
        bench.axis.configure(0.0)
        bench.step(round(0.9 / period))
        assert bench.axis.state is AxisState.CONFIGURING
        drive.frozen_word = None
        bench.until(AxisState.READY)


def test_power_is_switched_off_without_any_answer():
    bench = Bench().driving(DriveSetpoint(VELOCITY, 5.0))
    bench.lost = lambda frame: True
    bench.axis.configure(bench.now)
    bench.step(3)
    assert bench.drive.state == "disabled"


def test_any_device_type_of_drive_is_accepted():
    drive = FakeDrive()
    drive.objects[0x1000, 0] = 0x00040192  # a stepper; CiA 402 "device type"
    Bench(drive).configured()


def test_spare_pdos_may_be_absent():
    drive = FakeDrive()
    del drive.objects[0x1403, 1], drive.objects[0x1803, 1]
    Bench(drive).configured()


@pytest.mark.parametrize("index, left", [(0x6079, 1), (0x1802, 0)])
def test_drive_without_voltage_report_is_accepted(index, left):
    drive = FakeDrive()
    if index == 0x6079:
        drive.aborts[0x1A02, 2, "w"] = 0x06040041  # cannot be mapped
    else:
        del drive.objects[0x1802, 1]
    bench = Bench(drive).configured()
    bench.step(30)
    assert math.isnan(bench.axis.feedback.bus_voltage)
    assert drive.objects[0x1A02, 0] == left
    assert bench.axis.fault_reason == ""


def test_rated_torque_is_requested_unless_given():
    asked = "605#4076600000000000"
    bench = Bench(rated_torque=0.0).configured()
    assert asked in [str(f) for f in bench.sent]
    bench.tell(0x180, "370209E803")  # 1000 / 1000 of 1000 mN m
    assert bench.axis.feedback.torque == pytest.approx(1.0)
    assert bench.axis.feedback.current == pytest.approx(20.0)
    bench = Bench(rated_torque=0.5).configured()
    assert asked not in [str(f) for f in bench.sent]
    bench.tell(0x180, "370209E803")
    assert bench.axis.feedback.torque == pytest.approx(0.5)


def test_quick_stop_option_2_is_accepted_if_6_is_refused():
    drive = FakeDrive()
    drive.objects[0x605A, 0] = 1
    normal = drive.serve

    def serve(data):
        if data[:4] == bytes.fromhex("2B5A6000") and data[4] == 6:
            return [CanFrame(0x585, bytes.fromhex("805A600030000906"))]
        return normal(data)

    drive.serve = serve
    bench = Bench(drive).driving()
    assert drive.objects[0x605A, 0] == 2
    # With option 2 the drive switches off by itself at rest, which is not a fault.
    bench.demand = Demand.STOP
    bench.step(2)
    drive.state = "disabled"
    bench.step(2)
    assert (bench.axis.state, bench.axis.fault_reason) == (AxisState.READY, "")


REFUSALS = {
    "device type": ({"set": {(0x1000, 0): 0x00030191}}, "no CiA 402 drive: device type 00030191"),
    "velocity": ({"set": {(0x6502, 0): 0x200}}, "neither cyclic synchronous velocity nor"),
    "torque": ({"set": {(0x6502, 0): 0x100}}, "neither cyclic synchronous torque nor profiled"),
    "modes": (
        {"aborts": {(0x6060, 0, "w"): 0x06090030}},
        "is 000003AF; SDO 6060:00 (modes of operation) = 10: "
        "abort 06090030 (Value range of parameter exceeded)",
    ),
    "rated torque": ({"set": {(0x6076, 0): 0}}, "6076:00 (motor rated torque) is 0 N m, "),
    "unit of torque": ({"set": {(0x6076, 0): 800_000}}, "is 800 N m, with at most 2 N m at this"),
    "small torque": ({"set": {(0x6076, 0): 1}}, "is 0.001 N m, with at most 2 N m at this motor"),
    "slow heartbeat": (
        {"ignored": {(0x1017, 0)}, "set": {(0x1017, 0): 100}},
        "1017:00 (producer heartbeat time) reads 100 after 30 was written",
    ),
    "abort": (
        {"aborts": {(0x1600, 2, "w"): 0x06040041}},
        "SDO 1600:02 (RPDO1 mapping) = 60FF0020: abort 06040041 (Object cannot be mapped",
    ),
    "abort of a read": (
        {"aborts": {(0x6502, 0, "r"): 0x06020000}},
        "SDO 6502:00 (supported drive modes): abort 06020000 (Object does not",
    ),
    "6007": (
        {"aborts": {(0x6007, 0, "w"): 0x06090030}},
        "6007:00 (abort connection option code) stays 0, but must be 3 or 1",
    ),
    "1016": ({"ignored": {(0x1016, 1)}}, "1016:01 (consumer heartbeat time) reads 0 after 8323"),
    "605A": (
        {"set": {(0x605A, 0): 5}, "ignored": {(0x605A, 0)}},
        "605A:00 (quick stop option code) stays 5, but must be 6 or 2",
    ),
    "6085": ({"ignored": {(0x6085, 0)}}, "6085:00 (quick stop deceleration) reads 1 aft"),
    "mapping": ({"ignored": {(0x1A01, 0)}}, "TPDO2 was not accepted: 0 entries"),
    "switched on": (
        {"ignored": {(0x1801, 1)}, "set": {(0x1801, 1): 0xC0000285}},
        "TPDO2 was not accepted: 2 entries, COB-id C0000285",
    ),
    "no answer": ({"mute": {(0x1017, 0)}}, "no answer to SDO 1017:00 (producer heartbeat time)"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_value_not_retained_is_reported_and_the_drive_is_not_started(case):
    bent, trouble = REFUSALS[case]
    drive = FakeDrive()
    drive.objects |= bent.get("set", {})
    drive.aborts |= bent.get("aborts", {})
    drive.ignored |= bent.get("ignored", set())
    drive.mute |= bent.get("mute", set())
    bench = Bench(drive, mode=TORQUE, rated_torque=0.0)
    bench.axis.configure(0.0)
    bench.until(AxisState.OFFLINE)
    assert trouble in bench.axis.fault_reason
    bench.demand = Demand.DRIVE
    bench.step(100)
    assert drive.nmt == 0x7F
    assert "000#0105" not in [str(f) for f in bench.sent]


def test_drive_that_keeps_power_on_is_reported():
    drive = FakeDrive()
    drive.frozen_word = WORDS["enabled"]
    bench = Bench(drive)
    bench.axis.configure(0.0)
    bench.until(AxisState.OFFLINE)
    assert "keeps power on the motor: statusword 0237" in bench.axis.fault_reason


def test_configuration_can_be_retried():
    drive = FakeDrive()
    drive.silent = {"sdo"}
    bench = Bench(drive)
    bench.axis.configure(0.0)
    assert bench.until(AxisState.OFFLINE) == pytest.approx(0.6, abs=0.03)
    assert bench.axis.fault_reason == "no answer to SDO 6040:00 (controlword)"
    drive.silent = set()
    bench.axis.reset(bench.now)
    assert (bench.axis.state, bench.axis.fault_reason) == (AxisState.CONFIGURING, "")
    bench.until(AxisState.READY)


def test_lost_answer_only_causes_a_repetition():
    bench = Bench()
    answers = []

    def lost(frame):
        answers.append(frame)
        return frame.id == 0x585 and len(answers) % 20 == 19

    bench.lost = lost
    bench.configured()
    assert bench.now > 0.6


@pytest.mark.parametrize(
    "part, trouble",
    [
        ("heartbeat", "does not become operational after"),
        ("status", "sends no statusword (TPDO1)"),
    ],
)
def test_drive_that_does_not_start_is_reported(part, trouble):
    drive = FakeDrive()
    drive.silent = {part}
    bench = Bench(drive)
    bench.axis.configure(0.0)
    bench.until(AxisState.OFFLINE)
    assert trouble in bench.axis.fault_reason


def test_heartbeat_from_before_the_start_does_not_count():
    drive = FakeDrive()
    drive.silent = {"heartbeat"}
    bench = Bench(drive)
    bench.axis.configure(0.0)
    bench.step(20)
    bench.tell(0x700, "05")
    bench.until(AxisState.OFFLINE)
    assert "no heartbeat" in bench.axis.fault_reason


def test_lost_start_is_repeated():
    drive = FakeDrive()
    bench, normal, starts = Bench(drive), drive.receive, []

    def receive(frame):
        if str(frame) == "000#0105":
            starts.append(bench.now)
            if len(starts) < 3:
                return []
        return normal(frame)

    drive.receive = receive
    bench.configured()
    assert len(starts) == 3


def test_drive_that_boots_during_configuration_is_configured_anew():
    bench = Bench()
    bench.axis.configure(0.0)
    bench.step(30)
    bench.drive = FakeDrive()
    bench.tell(0x700, "00")
    bench.until(AxisState.READY)
    assert bench.drive.objects[0x1016, 1] == 127 << 16 | 100
    assert bench.axis.fault_reason == ""


@pytest.mark.parametrize(
    "changes, name",
    [
        ({"node": 127}, "nodes"),
        ({"node": 0}, "nodes"),
        ({"counts": 0.0}, "counts"),
        ({"velocity_scale": math.nan}, "velocity_scale"),
        ({"torque_constant": 0.0}, "torque_const"),
        ({"heartbeat_timeout": 1e-4}, "heartbeat_timeout"),
        ({"drive_heartbeat": 70.0}, "drive_hea"),
        ({"quick_stop_deceleration": 1e9}, "quick_stop_deceleration"),
        ({"period": 0.0}, "period"),
        ({"heartbeat_timeout": 65.536}, "heartbeat_timeout"),
        ({"drive_heartbeat": 65.536}, "drive_heartbeat"),
        ({"quick_stop_deceleration": 2**32 * math.tau / 4096}, "quick_stop_deceleration"),
        ({"heartbeat_timeout": math.inf}, "heartbeat_timeout"),
        ({"period": 1e-9}, "rate"),
        ({"max_torque": 0.0}, "max_torque"),
        ({"max_speed": math.nan}, "max_speed"),
        ({"rated_torque": -1.0}, "rated_torque"),
        ({"node": 128}, "nodes"),
    ],
)
def test_settings_that_the_drive_cannot_hold_are_refused(changes, name):
    with pytest.raises(ParameterError, match=f"can.{name}"):
        Cia402Axis(settings(**changes))


def test_settings_at_the_limits_of_the_drive_are_accepted():
    most = {"heartbeat_timeout": 65.535, "drive_heartbeat": 65.535}
    Cia402Axis(settings(**most, quick_stop_deceleration=(2**32 - 1) * math.tau / 4096))
    Cia402Axis(settings(heartbeat_timeout=0.001, drive_heartbeat=0.001))


@pytest.mark.parametrize("told, state", [(9, "ready"), (11, "ready"), (12, "offline")])
def test_small_deceleration_may_be_off_by_one(told, state):
    drive = FakeDrive()
    drive.ignored.add((0x6085, 0))
    drive.objects[0x6085, 0] = told
    bench = Bench(drive, velocity_scale=1.0, quick_stop_deceleration=10 * math.tau)
    bench.axis.configure(0.0)
    bench.until(AxisState(state))


def test_feed_forward_requires_a_drive_that_supports_torque_offset():
    drive = FakeDrive()
    del drive.objects[0x60B2, 0]
    drive.aborts[0x1602, 1, "w"] = 0x06020000  # no such object to map
    bench = Bench(drive, feed_forward=True)
    bench.axis.configure(0.0)
    bench.until(AxisState.OFFLINE)
    assert "SDO 1602:01 (RPDO3 mapping) = 60B20010: abort 06020000" in bench.axis.fault_reason


# Driving


def test_statuswords_are_named_by_the_table_of_the_profile():
    # mask, value: IEC 61800-7-201 table "state coding"
    table = {
        0x0000: PdsState.NOT_READY,
        0x0040: PdsState.SWITCH_ON_DISABLED,
        0x0021: PdsState.READY,
        0x0023: PdsState.SWITCHED_ON,
        0x0027: PdsState.ENABLED,
        0x0007: PdsState.QUICK_STOP,
        0x000F: PdsState.FAULT_REACTION,
        0x0008: PdsState.FAULT,
    }
    for value, state in table.items():
        for other in (0x0000, 0x0010, 0xFF80, 0x0290):
            assert pds_state(value | other) is state
    assert pds_state(0x0031) is PdsState.READY
    assert pds_state(0x0060) is PdsState.SWITCH_ON_DISABLED
    assert pds_state(0x0001) is None
    assert pds_state(0x0047) is None


def test_controlwords_match_the_profile():
    # IEC 61800-7-201 "controlword": bits 7, 3, 2, 1, 0 of each command
    d, i, s = CONTROLWORDS[Demand.DRIVE], CONTROLWORDS[Demand.IDLE], CONTROLWORDS[Demand.STOP]
    assert d[PdsState.SWITCH_ON_DISABLED] == 0b0110
    assert d[PdsState.READY] == 0b0111
    assert d[PdsState.SWITCHED_ON] == d[PdsState.ENABLED] == 0b1111
    assert d[PdsState.QUICK_STOP] == 0  # transition 12, not 16
    assert i[PdsState.ENABLED] == i[PdsState.SWITCHED_ON] == 0b0110
    assert i[PdsState.QUICK_STOP] == 0
    assert set(s.values()) == {0b0010}
    for words in (d, i, s):
        assert set(words) == set(PdsState)
        assert not any(word & 0x80 for word in words.values())


def test_drive_is_enabled_step_by_step_at_zero():
    bench = Bench().configured()
    bench.demand, bench.setpoint = Demand.DRIVE, DriveSetpoint(VELOCITY, 100.0)
    seen = []
    while bench.axis.state is not AxisState.ENABLED:
        bench.step()
        seen.append(bench.rpdos()[1])
        assert seen[-1][2:6] == bytes(4)
        assert bench.drive.objects[0x60FF, 0] == 0
    assert [word[0] for word in seen] == [0x06, 0x07, 0x0F]
    bench.step()
    assert struct.unpack("<Hib", bench.rpdos()[1]) == (0x0F, round(100 / math.tau * 4096), 9)


def test_drive_gets_no_setpoint_until_the_mode_is_shown():
    drive = FakeDrive()
    bench = Bench(drive).configured()
    drive.shown_mode = 3
    bench.demand, bench.setpoint = Demand.DRIVE, DriveSetpoint(VELOCITY, 100.0)
    bench.step(15)
    assert drive.state == "enabled"
    assert bench.axis.state is AxisState.READY
    assert drive.objects[0x60FF, 0] == 0
    drive.shown_mode = None
    bench.step(2)
    assert bench.axis.state is AxisState.ENABLED
    assert drive.objects[0x60FF, 0] != 0


def test_one_frame_per_tick_carries_mode_and_setpoint():
    bench = Bench(mode=TORQUE).driving(DriveSetpoint(VELOCITY, 10.0))
    assert list(bench.rpdos()) == [1]
    bench.setpoint = DriveSetpoint(TORQUE, 0.5)
    bench.step()
    # no zero in between: the drive would brake, or coast, for a tick
    assert struct.unpack("<Hhb", bench.rpdos()[2]) == (0x0F, 500, 10)
    assert list(bench.rpdos()) == [2]
    bench.setpoint = DriveSetpoint(VELOCITY, -10.0)
    bench.step()
    assert struct.unpack("<Hib", bench.rpdos()[1]) == (0x0F, -round(10 / math.tau * 4096), 9)
    assert list(bench.rpdos()) == [1]
    bench.step(30)
    assert bench.axis.fault_reason == ""


def test_setpoints_continue_while_the_shown_mode_lags():
    bench = Bench(mode=TORQUE).driving(DriveSetpoint(VELOCITY, 10.0))
    bench.drive.shown_mode = 9
    bench.setpoint = DriveSetpoint(TORQUE, 0.5)
    for _ in range(4):
        bench.step()
        assert struct.unpack("<Hhb", bench.rpdos()[2]) == (0x0F, 500, 10)
        assert bench.axis.state is AxisState.ENABLED
    bench.drive.shown_mode = None
    bench.step(30)
    assert bench.axis.fault_reason == ""


def test_mode_that_the_drive_lacks_is_refused():
    bench = Bench().driving()
    for mode in (TORQUE, DriveMode.VOLTAGE):
        with pytest.raises(InputError, match=f"no {mode.value} mode"):
            bench.axis.tick(Demand.DRIVE, DriveSetpoint(mode, 0.0), bench.now)


def test_feed_forward_precedes_the_velocity_and_is_never_sent_with_a_torque():
    bench = Bench(mode=TORQUE, feed_forward=True).driving(DriveSetpoint(VELOCITY, 1.0, -0.25))
    assert list(bench.rpdos()) == [3, 1]
    assert bench.rpdos()[3] == struct.pack("<h", -250)
    bench.setpoint = DriveSetpoint(TORQUE, 1.0, 0.25)
    bench.step()
    assert bench.rpdos()[3] == bytes(2)
    bench.demand = Demand.STOP
    bench.step()
    assert bench.rpdos()[3] == bytes(2)


@pytest.mark.parametrize(
    "value, mode, sent",
    [
        (600.0, VELOCITY, 325949),
        (-600.0, VELOCITY, -325949),
        (1e300, VELOCITY, 325949),
        (2.5, TORQUE, 2000),
        (-1e9, TORQUE, -2000),
    ],
)
def test_setpoints_are_clipped_to_the_limits(value, mode, sent):
    bench = Bench(mode=TORQUE).driving(DriveSetpoint(mode, 0.0))
    bench.setpoint = DriveSetpoint(mode, value)
    bench.step()
    (frame,) = bench.rpdos().values()
    assert struct.unpack("<Hib" if mode is VELOCITY else "<Hhb", frame)[1] == sent


def test_torques_are_thousandths_of_the_rated_torque():
    bench = Bench(mode=TORQUE, rated_torque=0.4).driving(DriveSetpoint(TORQUE, 0.1))
    assert struct.unpack("<Hhb", bench.rpdos()[2])[1] == 250


def test_setpoints_are_clipped_to_the_integers():
    bench = Bench(mode=TORQUE, max_speed=1e9, max_torque=1e9).driving()
    for mode, value, end in [
        (VELOCITY, 1e9, 2**31 - 1),
        (VELOCITY, -1e9, 1 - 2**31),
        (TORQUE, 1e9, 32767),
        (TORQUE, -1e9, -32767),
    ]:
        bench.setpoint = DriveSetpoint(mode, value)
        bench.step()
        (frame,) = bench.rpdos().values()
        assert struct.unpack("<Hib" if mode is VELOCITY else "<Hhb", frame)[1] == end


@fixed
@given(st.floats(-500, 500), st.sampled_from([1.0, 10.0, 4096.0, 65536.0]))
def test_velocities_are_rounded_to_half_a_unit(value, scale):
    axis, now = driving_axis(scale)
    (frame,) = axis.tick(Demand.DRIVE, DriveSetpoint(VELOCITY, value), now)
    word, units, mode = struct.unpack("<Hib", frame.data)
    assert (word, mode) == (0x0F, 9)
    assert abs(units / scale * math.tau - value) <= 0.5001 * math.tau / scale
    axis.receive(CanFrame(0x285, struct.pack("<ii", 0, units)), now)
    assert axis.feedback.velocity == pytest.approx(units / scale * math.tau)


AXES = {}


def driving_axis(scale):
    if scale not in AXES:
        AXES[scale] = Bench(velocity_scale=scale, quick_stop_deceleration=10.0).driving()
    return AXES[scale].axis, AXES[scale].now


def test_stop_is_a_quick_stop_at_zero_and_is_repeated():
    bench = Bench(mode=TORQUE).driving(DriveSetpoint(TORQUE, 1.0))
    bench.demand = Demand.STOP
    for _ in range(50):
        bench.step()
        # in velocity mode: a quick stop in torque mode may coast
        assert bench.rpdos() == {1: bytes.fromhex("02000000000009")}
    assert (bench.axis.state, bench.axis.fault_reason) == (AxisState.STOPPING, "")


def test_stop_may_be_requested_between_two_ticks():
    bench = Bench().driving(DriveSetpoint(VELOCITY, 5.0))
    (frame,) = bench.axis.tick(Demand.STOP, bench.setpoint, bench.now)
    assert str(frame) == "205#02000000000009"


def test_drive_is_enabled_after_a_quick_stop_through_disable_voltage():
    bench = Bench().driving(DriveSetpoint(VELOCITY, 5.0))
    bench.demand = Demand.STOP
    bench.step(5)
    bench.demand = Demand.DRIVE
    words = []
    while bench.axis.state is not AxisState.ENABLED:
        bench.step()
        words.append(bench.rpdos()[1][0])
        assert bench.rpdos()[1][2:6] == bytes(4)
    assert words == [0x00, 0x06, 0x07, 0x0F]
    assert bench.axis.fault_reason == ""


@pytest.mark.parametrize("state", ["ready", "on", "enabled", "quick", "disabled"])
def test_idle_switches_the_power_off_from_any_state(state):
    bench = Bench().driving(DriveSetpoint(VELOCITY, 5.0))
    bench.drive.state = state
    bench.demand = Demand.IDLE
    bench.step(5)
    assert bench.drive.state in ("ready", "disabled")
    assert (bench.axis.state, bench.axis.fault_reason) == (AxisState.READY, "")


def test_drive_restarts_at_zero_after_a_stop_while_still_shown_as_enabled():
    # where the quick stop is left by "enable operation" (transition 16) an old speed would return
    bench = Bench().driving(DriveSetpoint(VELOCITY, 5.0))
    bench.lost = lambda frame: True
    for demand in (Demand.STOP, Demand.IDLE):
        bench.demand = demand
        bench.step()
        bench.demand = Demand.DRIVE
        for _ in range(3):
            bench.step()
            assert bench.rpdos()[1][2:6] == bytes(4)


def test_switching_to_idle_and_back_is_not_a_fault():
    bench = Bench().driving()
    for demand in (Demand.IDLE, Demand.DRIVE, Demand.STOP, Demand.DRIVE) * 3:
        bench.demand = demand
        for _ in range(5):
            bench.step()
            assert bench.axis.fault_reason == ""


# Feedback


def test_feedback_is_in_units_of_the_shaft():
    bench = Bench(velocity_scale=10.0, quick_stop_deceleration=50.0).configured()
    bench.tell(0x280, struct.pack("<ii", 1024, -20).hex())
    feedback = bench.axis.feedback
    assert feedback.position == pytest.approx(math.pi / 2)
    assert feedback.velocity == pytest.approx(-4 * math.pi)
    bench.tell(0x180, "3702099CFF")  # -100 / 1000 of 1 N m
    assert feedback.torque == pytest.approx(-0.1)
    assert feedback.current == pytest.approx(-2.0)
    bench.tell(0x380, "0000C05D0000")  # 24000 mV
    assert feedback.bus_voltage == pytest.approx(24.0)
    assert math.isnan(feedback.voltage)


@pytest.mark.parametrize("sign", [1, -1])
def test_position_is_continuous_where_the_counter_wraps(sign):
    bench = Bench().configured()
    start = sign * (2**31 - 1000)
    expected = None
    for k in range(5):
        count = (start + sign * 600 * k + 2**31) % 2**32 - 2**31
        bench.tell(0x280, struct.pack("<ii", count, 0).hex())
        position = bench.axis.feedback.position
        if expected is not None:
            assert position - expected == pytest.approx(sign * 600 / 4096 * math.tau)
        expected = position
    assert count * sign < 0  # the counter did wrap


def test_age_and_count_advance_with_a_complete_tpdo2_only():
    bench = Bench().configured()
    before = bench.axis.feedback.at, bench.axis.feedback.count
    bench.now += 0.001
    assert bench.tell(0x280, "00112233445566") is Receipt.MALFORMED
    assert bench.tell(0x180, "3702090000") is Receipt.ACCEPTED
    assert bench.tell(0x380, "000000000000") is Receipt.ACCEPTED
    assert (bench.axis.feedback.at, bench.axis.feedback.count) == before
    assert bench.tell(0x280, "0011223344556677") is Receipt.ACCEPTED
    after = bench.axis.feedback.at, bench.axis.feedback.count
    assert after == (bench.now, before[1] + 1)


def test_pdos_of_a_foreign_mapping_are_not_feedback():
    bench = Bench()
    bench.axis.configure(0.0)
    bench.step(5)
    for cob_id in (0x180, 0x280, 0x380, 0x480):
        assert bench.tell(cob_id, "3702000000000000") is Receipt.ACCEPTED
    assert bench.axis.feedback.count == 0
    assert math.isnan(bench.axis.feedback.torque)
    assert bench.axis.state is AxisState.CONFIGURING


def test_pdos_before_configuration_are_not_feedback():
    bench = Bench()
    for cob_id in (0x180, 0x280, 0x380, 0x480):
        assert bench.tell(cob_id, "3702090000000000") is Receipt.ACCEPTED
    assert bench.axis.feedback.count == 0
    assert math.isnan(bench.axis.feedback.torque)


@pytest.mark.parametrize(
    "frame, receipt",
    [
        (CanFrame(0x186, bytes(5)), Receipt.FOREIGN),
        (CanFrame(0x080, b""), Receipt.FOREIGN),
        (CanFrame(0x205, bytes(7)), Receipt.FOREIGN),
        (CanFrame(0x605, bytes(8)), Receipt.FOREIGN),
        (CanFrame(0x185, bytes(5), extended=True), Receipt.FOREIGN),
        (CanFrame(0x185, b"", remote=True), Receipt.FOREIGN),
        # node guarding of another host
        (CanFrame(0x705, b"\x00", remote=True), Receipt.FOREIGN),
        (CanFrame(0x185, bytes(4)), Receipt.MALFORMED),
        (CanFrame(0x285, bytes(7)), Receipt.MALFORMED),
        (CanFrame(0x385, bytes(5)), Receipt.MALFORMED),
        (CanFrame(0x485, bytes(8)), Receipt.MALFORMED),
        (CanFrame(0x085, bytes(7)), Receipt.MALFORMED),
        (CanFrame(0x705, b""), Receipt.MALFORMED),
        (CanFrame(0x705, b"\x06"), Receipt.MALFORMED),
        (CanFrame(0x585, bytes(8)), Receipt.MALFORMED),
        # no state has that word
        (CanFrame(0x185, bytes.fromhex("0100090000")), Receipt.MALFORMED),
    ],
)
def test_receipts(frame, receipt):
    bench = Bench().driving()
    assert bench.axis.receive(frame, bench.now) is receipt
    assert (bench.axis.state, bench.axis.fault_reason) == (AxisState.ENABLED, "")


# Network


def test_heartbeat_is_sent_first_and_sync_last():
    bench = Bench().driving()
    for _ in range(20):
        bench.step()
        assert [str(f) for f in bench.last if f.id == 0x080] == ["080#"]
        assert bench.last[-1].id == 0x080
        assert all(f.id != 0x77F for f in bench.last[1:])


@pytest.mark.parametrize("timeout, every", [(0.1, 5), (0.2, 10), (0.01, 1)])
def test_host_heartbeat_is_sent_four_times_per_timeout(timeout, every):
    network = CanopenNetwork((settings(heartbeat_timeout=timeout), settings(node=6)))
    beats = [k for k in range(1, 101) if network.before(0.005 * k)]
    expected = min(every, 5)  # the other drive's is 0.1 s
    assert {b - a for a, b in itertools.pairwise(beats)} == {expected}
    assert str(CanopenNetwork((settings(),)).before(0.0)[0]) == "77F#05"


def test_command_ids_are_those_of_the_host():
    assert set(Cia402Axis(settings()).command_ids) == {
        (0x205, False),
        (0x305, False),
        (0x405, False),
        (0x505, False),
        (0x605, False),
    }
    network = CanopenNetwork((settings(),))
    assert set(network.command_ids) == {(0x000, False), (0x080, False), (0x77F, False)}
    with pytest.raises(InputError):
        CanopenNetwork(())


def test_every_sent_frame_has_a_command_id():
    bench = Bench(mode=TORQUE, feed_forward=True).driving()
    bench.setpoint = DriveSetpoint(TORQUE, 0.1)
    bench.step(3)
    known = {*bench.axis.command_ids, *bench.network.command_ids}
    assert {(f.id, f.extended) for f in bench.sent} <= known


def test_master_is_the_node_of_the_heartbeat():
    assert cia402_setup.HOST_NODE == 127
