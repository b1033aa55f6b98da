"""The simulated CiA 402 drive against CiA 301 and CiA 402-2."""

import math
import struct
import threading
from dataclasses import replace

import can
import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.can_drives.cia402.drive import Cia402Settings
from omniman_ros.simulation.can_drives.motor import DriveFaults
from test.simulation.can_drives.cia402.rig import Rig

UNIT = 2 * math.pi / 4096
TURN = 2 * math.pi


# start, NMT and heartbeat (CiA 301, 7.2.8)


def test_drive_boots_up_once_and_is_pre_operational():
    rig = Rig(boot=False)
    frames = rig.run(0.05)
    assert frames == [(0x705, b"\x00")]  # boot-up of node 5: 705#00
    assert rig.drive.nmt == 127


def test_drive_neither_sends_nor_receives_before_boot_up():
    rig = Rig(boot=False, boot_time=0.1)
    rig.drive.advance(rig.now)
    assert rig.send(0x605, "40 00 10 00 00 00 00 00") == []
    assert rig.run(0.09) == []
    assert rig.run(0.02) == [(0x705, b"\x00")]


@pytest.mark.parametrize(
    ("command", "state"), [(1, 5), (2, 4), (128, 127)], ids=["start", "stop", "pre-operational"]
)
@pytest.mark.parametrize("address", [5, 0], ids=["itself", "all"])
@pytest.mark.parametrize("before", [1, 2, 128])
def test_each_nmt_command_leads_to_its_state_from_each_state(command, state, address, before):
    rig = Rig()
    rig.nmt(before)
    rig.nmt(command, address)
    assert rig.drive.nmt == state


@pytest.mark.parametrize("data", ["01 06", "01", "01 05 00", "", "07 05"], ids=repr)
def test_nmt_commands_to_others_or_of_another_length_are_ignored(data):
    rig = Rig()
    rig.send(0x000, data)
    assert rig.drive.nmt == 127


@pytest.mark.parametrize(("command", "state"), [(1, "05"), (2, "04"), (128, "7F")])
def test_heartbeat_reports_the_state_at_its_period(command, state):
    rig = Rig()
    assert rig.write(0x1017, 0, 100, 2) == 0
    rig.nmt(command)
    beats = [frame for frame in rig.run(1.0) if frame[0] == 0x705]
    assert set(beats) == {(0x705, bytes.fromhex(state))}
    assert 10 <= len(beats) <= 11
    assert rig.drive.nmt == 4 or rig.write(0x1017, 0, 0, 2) == 0
    if command != 2:
        assert [frame for frame in rig.run(1.0) if frame[0] == 0x705] == []


def test_missed_heartbeats_are_not_sent_later():
    rig = Rig()
    rig.write(0x1017, 0, 10, 2)
    rig.run(0.05)
    rig.now += 1.0
    frames = rig.take(rig.drive.advance(rig.now))
    assert len(frames) == 1
    assert len(rig.run(0.1)) == 10


def test_no_thread_is_started():
    before = threading.active_count()
    rig = Rig()
    rig.write(0x1017, 0, 10, 2)
    rig.nmt(1)
    rig.run(0.1)
    assert threading.active_count() == before


def test_pdos_are_of_the_operational_state_only():
    rig = Rig()
    rig.cyclic()
    rig.write(0x6007, 0, 0, 2)
    assert [can_id for can_id, _ in rig.command(0x0F, 0)] == [0x185, 0x285]
    for command in (2, 128):
        rig.nmt(command)
        assert rig.command(0x0F, 4096) == []
        rig.run(0.01)
        assert rig.motor.order == ("velocity", 0.0, 0.0)
    rig.nmt(1)
    assert len(rig.sync()) == 2
    rig.command(0x0F, 4096)
    assert rig.motor.velocity == pytest.approx(TURN)


def test_sdo_is_of_pre_operational_and_operational_only():
    rig = Rig()
    request = "40 00 10 00 00 00 00 00"
    assert len(rig.send(0x605, request)) == 1
    rig.nmt(1)
    assert any(frame[0] == 0x585 for frame in rig.send(0x605, request))
    rig.nmt(2)
    assert rig.send(0x605, request) == []


@pytest.mark.parametrize("command", [129, 130], ids=["node", "communication"])
def test_reset_boots_up_and_forgets_the_communication_objects(command):
    rig = Rig()
    rig.cyclic()
    rig.write(0x6085, 0, 1234, 4)
    rig.write(0x1017, 0, 20, 2)
    rig.log.clear()
    rig.nmt(command)
    rig.run(0.1)
    assert [frame[1:] for frame in rig.log] == [(0x705, b"\x00")]
    assert rig.drive.nmt == 127
    assert rig.read(0x1017) == 0
    assert rig.read(0x1600, 2) == 0
    assert (rig.read(0x6085) == 1234) == (command == 130)
    assert rig.motor.order == ("release",)


# SDO (CiA 301, 7.2.4): the frames are those of the standard's layout


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        # upload of the device type: servo drive, profile 402
        ("40 00 10 00 00 00 00 00", "43 00 10 00 92 01 02 00"),
        # download of 2 bytes: heartbeat of 100 ms
        ("2B 17 10 00 64 00 00 00", "60 17 10 00 00 00 00 00"),
        # download of 4 bytes: host 127 is watched, 100 ms
        ("23 16 10 01 64 00 7F 00", "60 16 10 01 00 00 00 00"),
        # download of 1 byte: mode 9
        ("2F 60 60 00 09 00 00 00", "60 60 60 00 00 00 00 00"),
        # upload of the COB-ID of its emergencies
        ("40 14 10 00 00 00 00 00", "43 14 10 00 85 00 00 00"),
        # aborts: no object, no sub-index, read-only, wrong length, a toggle bit too many
        ("40 00 20 00 00 00 00 00", "80 00 20 00 00 00 02 06"),
        ("40 18 10 09 00 00 00 00", "80 18 10 09 11 00 09 06"),
        ("2B 41 60 00 00 00 00 00", "80 41 60 00 02 00 01 06"),
        ("23 40 60 00 00 00 00 00", "80 40 60 00 10 00 07 06"),
        ("40 03 10 01 00 00 00 00", "80 03 10 01 24 00 00 08"),
    ],
    ids=lambda value: value[:11],
)
def test_sdo_answers_match_the_standard(request_, answer):
    assert Rig().send(0x605, request_)[:1] == [(0x585, bytes.fromhex(answer))]


def test_long_object_comes_in_segments():
    rig = Rig()
    ((_, first),) = rig.send(0x605, "40 08 10 00 00 00 00 00")
    assert first[0] == 0x41 and first[4] == len("simulated drive")
    text, toggle = b"", 0
    while True:
        ((_, part),) = rig.send(0x605, bytes([0x60 | toggle]) + bytes(7))
        assert part[0] & 0x10 == toggle
        text += part[1 : 8 - (part[0] >> 1 & 7)]
        toggle ^= 0x10
        if part[0] & 1:
            break
    assert text == b"simulated drive"


@pytest.mark.parametrize(
    "data",
    [
        "",
        "40",
        "40 00 10 00",
        "E0 00 00 00 00 00 00 00",
        "60 00 00 00 00 00 00 00",
        "00 00 00 00 00 00 00 00",
    ],
)
def test_malformed_sdo_requests_are_refused_or_ignored(data):
    rig = Rig()
    answers = rig.send(0x605, data)
    assert all(can_id == 0x585 and answer[0] == 0x80 for can_id, answer in answers)
    assert len(answers) == (len(bytes.fromhex(data)) == 8)
    assert rig.read(0x1000) == 0x0002_0192


@pytest.mark.parametrize(
    ("index", "value", "size"), [(0x605A, 3, 2), (0x6007, 9, 2), (0x6060, 8, 1), (0x1029, 3, 1)]
)
def test_unsupported_value_is_refused(index, value, size):
    rig = Rig()
    before = rig.read(index, 1 if index == 0x1029 else 0)
    assert rig.write(index, 1 if index == 0x1029 else 0, value, size) == 0x0609_0030
    assert rig.read(index, 1 if index == 0x1029 else 0) == before


# mapping of PDOs (CiA 301, 7.5.2.36)


def test_mapping_is_written_only_to_a_disabled_pdo_with_none_mapped():
    rig = Rig()
    assert rig.write(0x1600, 0, 0, 1) == 0x0601_0000  # enabled
    assert rig.write(0x1600, 1, 0x6040_0010, 4) == 0x0601_0000
    assert rig.write(0x1400, 1, 0x8000_0205, 4) == 0
    assert rig.write(0x1600, 1, 0x6040_0010, 4) == 0x0601_0000  # one is mapped
    assert rig.write(0x1600, 0, 0, 1) == 0
    assert rig.write(0x1600, 1, 0x6040_0010, 4) == 0
    assert rig.write(0x1600, 0, 1, 1) == 0
    assert rig.write(0x1400, 1, 0x205, 4) == 0


@pytest.mark.parametrize(
    ("base", "entry", "abort"),
    [
        (0x1400, 0x2000_0010, 0x0602_0000),  # no object
        (0x1400, 0x6040_0110, 0x0609_0011),  # no sub-index
        (0x1400, 0x6041_0010, 0x0604_0041),  # of the drive
        (0x1400, 0x6502_0020, 0x0604_0041),  # not for PDOs
        (0x1400, 0x6040_0020, 0x0604_0041),  # not of that length
        (0x1800, 0x1017_0010, 0x0604_0041),
        (0x1800, 0x0005_0008, 0x0604_0041),  # fills only PDOs that are received
        (0x1400, 0x0005_0010, 0x0604_0041),
        (0x1400, 0x0005_0008, 0),
        (0x1800, 0x60FF_0020, 0),
        (0x1800, 0x6064_0020, 0),
    ],
    ids=hex,
)
def test_only_mappable_objects_are_mapped(base, entry, abort):
    rig = Rig()
    rig.off(base)
    assert rig.write(base + 0x200, 0, 0, 1) == 0
    assert rig.write(base + 0x200, 1, entry, 4) == abort


def test_no_more_than_eight_bytes_are_mapped():
    rig = Rig()
    rig.off(0x1801)
    rig.write(0x1A01, 0, 0, 1)
    for sub, entry in enumerate((0x6064_0020, 0x606C_0020, 0x6061_0008), 1):
        assert rig.write(0x1A01, sub, entry, 4) == 0
    assert rig.write(0x1A01, 0, 3, 1) == 0x0604_0042
    assert rig.write(0x1A01, 0, 9, 1) == 0x0604_0042
    assert rig.write(0x1A01, 3, 0, 4) == 0
    assert rig.write(0x1A01, 0, 3, 1) == 0x0602_0000  # the third is none
    assert rig.write(0x1A01, 0, 2, 1) == 0


def test_enabled_pdo_keeps_its_id_and_restricted_ids_are_refused():
    rig = Rig()
    assert rig.write(0x1400, 1, 0x206, 4) == 0x0609_0030
    assert rig.write(0x1400, 1, 0x8000_0206, 4) == 0
    assert rig.write(0x1400, 1, 0x206, 4) == 0
    rig.off(0x1401)
    for number in (0x000, 0x105, 0x585, 0x605, 0x705, 0x2000_0205):
        assert rig.write(0x1401, 1, number, 4) == 0x0609_0030


@pytest.mark.parametrize("kind", [241, 251, 252, 253])
def test_invalid_transmission_types_are_refused(kind):
    assert Rig().write(0x1800, 2, kind, 1) == 0x0609_0030


# PDOs at work (CiA 301, 7.2.2)


def test_data_of_a_synchronous_pdo_take_effect_at_the_next_sync():
    rig = Rig()
    rig.cyclic()
    rig.send(0x205, struct.pack("<Hi", 15, 4096))
    rig.run(0.01)
    assert rig.read(0x60FF) == 0
    assert rig.motor.order == ("velocity", 0.0, 0.0)
    rig.sync()
    assert rig.read(0x60FF) == 4096
    assert rig.motor.order == ("velocity", pytest.approx(TURN), 0.0)


def test_data_of_an_event_driven_pdo_take_effect_at_once():
    rig = Rig()
    rig.map(0x1400, [0x6040_0010, 0x60FF_0020], kind=255)
    rig.nmt(1)
    rig.send(0x205, struct.pack("<Hi", 0, -7))
    assert rig.read(0x60FF) == -7


def test_pdos_restart_with_each_start_of_the_node():
    rig = Rig()
    rig.off(0x1801)
    rig.map(0x1400, [0x6040_0010, 0x60FF_0020])
    rig.map(0x1800, [0x6064_0020], kind=255)
    rig.map(0x1802, [0x6064_0020], kind=3)
    assert [can_id for can_id, _ in rig.nmt(1)] == [0x185]
    rig.send(0x205, struct.pack("<Hi", 0, 77))
    assert rig.sync() == rig.nmt(128) == []
    assert rig.read(0x60FF) == 77
    rig.nmt(1)
    rig.send(0x205, struct.pack("<Hi", 0, 88))  # for a SYNC that never comes
    rig.sync()
    rig.send(0x205, struct.pack("<Hi", 0, 99))
    rig.nmt(128)
    assert [can_id for can_id, _ in rig.nmt(1)] == [0x185]
    assert [len(rig.sync()) for _ in range(3)] == [0, 0, 1]
    assert rig.read(0x60FF) == 88


def test_dummies_are_skipped():
    rig = Rig()
    rig.map(0x1400, [0x0006_0010, 0x60FF_0020], kind=255)
    rig.off(0x1800, 0x1801)
    rig.nmt(1)
    rig.send(0x205, struct.pack("<Hi", 0xFFFF, -7))
    assert rig.read(0x60FF) == -7
    assert rig.read(0x6040) == 0


@pytest.mark.parametrize("every", [1, 2, 5, 240])
def test_tpdo_comes_with_each_nth_sync(every):
    rig = Rig()
    rig.off(0x1800, 0x1801)
    rig.map(0x1802, [0x6041_0010], kind=every)
    rig.nmt(1)
    got = [len(rig.sync()) for _ in range(480)]
    assert sum(got) == 480 // every
    assert got[every - 1] == 1 and sum(got[: every - 1]) == 0


def test_tpdo_of_type_0_comes_with_a_sync_after_a_change():
    rig = Rig()
    rig.off(0x1800, 0x1801)
    rig.map(0x1802, [0x6064_0020], kind=0)
    rig.nmt(1)
    assert len(rig.sync()) == 1
    assert rig.sync() == []
    rig.motor.position += 1.0
    assert rig.run(0.01) == []
    assert len(rig.sync()) == 1


def test_tpdo_is_sampled_at_the_sync():
    rig = Rig()
    rig.cyclic()
    rig.motor.position = 100 * UNIT
    rig.run(0.005)
    rig.motor.position = 300 * UNIT
    assert (0x285, struct.pack("<ii", 300, 0)) in rig.sync()


def test_event_driven_tpdo_comes_at_the_start_on_change_and_by_its_timer():
    rig = Rig()
    rig.off(0x1801)
    rig.map(0x1800, [0x6064_0020], kind=255)
    assert len(rig.nmt(1)) == 1
    assert rig.run(0.1) == []
    rig.motor.position = 1.0
    assert rig.run(0.1) == [(0x185, struct.pack("<i", round(1 / UNIT)))]
    rig.write(0x1800, 5, 50, 2)
    assert len(rig.run(1.0)) == 20


def test_inhibit_time_keeps_events_apart():
    rig = Rig()
    rig.off(0x1801)
    rig.map(0x1800, [0x6064_0020], kind=255)
    assert rig.write(0x1800, 3, 200, 2) == 0x0609_0030  # not while it is enabled
    rig.off(0x1800)
    assert rig.write(0x1800, 3, 200, 2) == 0  # 20 ms
    rig.write(0x1800, 1, 0x185, 4)
    rig.nmt(1)
    rig.motor.velocity = 10.0
    assert 48 <= len(rig.run(1.0)) <= 51


def test_short_pdo_is_reported_once_and_changes_nothing():
    rig = Rig()
    rig.cyclic()
    rig.command(15, 4096)
    for _ in range(3):
        rig.send(0x205, "0F 00 00")
        rig.sync()
    emergencies = [data for _, can_id, data in rig.log if can_id == 0x085]
    assert emergencies == [bytes.fromhex("10 82 11 00 00 00 00 00")]
    assert rig.word & 0x80
    assert rig.read(0x60FF) == 4096
    rig.command(15, 0)
    assert (0x085, bytes(8)) in [entry[1:] for entry in rig.log]
    assert rig.state == "enabled" and not rig.word & 0x80


def test_long_pdo_is_reported_and_its_first_bytes_are_taken():
    rig = Rig()
    rig.cyclic()
    rig.send(0x205, struct.pack("<Hi", 15, 77) + b"\x01")
    rig.sync()
    assert (0x085, bytes.fromhex("20 82 11 00 00 00 00 00")) in [e[1:] for e in rig.log]
    assert rig.read(0x60FF) == 77


@pytest.mark.parametrize(
    "kind",
    [{"is_extended_id": True}, {"is_remote_frame": True}, {"is_error_frame": True}],
    ids=str,
)
def test_frames_of_another_kind_are_ignored(kind):
    rig = Rig()
    rig.cyclic()
    assert rig.send(0x80, b"", **kind) == []
    assert len(rig.send(0x80, b"")) == 2


# the power state machine (CiA 402-2, figure of transitions)

PATHS = {
    "disabled": (),
    "ready": (0x06,),
    "on": (0x06, 0x07),
    "enabled": (0x06, 0x07, 0x0F),
    "quick stop": (0x06, 0x07, 0x0F, 0x02),
}

COMMANDS = {
    "disabled": {
        0x00: "disabled",
        0x02: "disabled",
        0x06: "ready",
        0x07: "disabled",
        0x0F: "disabled",
    },
    "ready": {0x00: "disabled", 0x02: "disabled", 0x06: "ready", 0x07: "on", 0x0F: "enabled"},
    "on": {0x00: "disabled", 0x02: "disabled", 0x06: "ready", 0x07: "on", 0x0F: "enabled"},
    "enabled": {0x00: "disabled", 0x02: "quick stop", 0x06: "ready", 0x07: "on", 0x0F: "enabled"},
    "quick stop": {
        0x00: "disabled",
        0x02: "quick stop",
        0x06: "quick stop",
        0x07: "quick stop",
        0x0F: "enabled",
    },
}


@pytest.mark.parametrize("before", PATHS)
@pytest.mark.parametrize("word", [0x00, 0x02, 0x06, 0x07, 0x0F])
def test_each_command_in_each_state_follows_the_standard(before, word):
    rig = Rig()
    rig.write(0x6060, 0, 9, 1)
    rig.write(0x605A, 0, 6, 2)  # stays in quick stop
    rig.control(*PATHS[before])
    assert rig.state == before
    rig.control(word)
    rig.run(0.01)
    assert rig.state == COMMANDS[before][word]


@pytest.mark.parametrize("word", [0xFFFD, 0x0085, 0x000D])
def test_controlword_without_bit_1_disables_voltage_whatever_its_other_bits(word):
    rig = Rig()
    rig.enable()
    rig.control(word)
    assert rig.state == "disabled"
    assert rig.motor.order == ("release",)


@pytest.mark.parametrize(
    ("path", "word"),
    [((), 0x0250), ((6,), 0x0231), ((6, 7), 0x0233), ((6, 7, 15), 0x1237), ((6, 7, 15, 2), 0x217)],
)
def test_statuswords_have_their_bits(path, word):
    rig = Rig()
    rig.write(0x605A, 0, 6, 2)
    rig.write(0x6060, 0, 9, 1)
    rig.off(0x1800, 0x1801)
    rig.nmt(1)
    rig.control(*path)
    assert rig.word == word


@pytest.mark.parametrize("option", [0, 1, 2, 5, 6])
def test_quick_stop_follows_its_option(option):
    rig = Rig()
    rig.write(0x605A, 0, option, 2)
    rig.write(0x6084, 0, round(20.0 / UNIT), 4)
    rig.write(0x6085, 0, round(50.0 / UNIT), 4)
    rig.enable()
    rig.write(0x60FF, 0, round(10.0 / UNIT), 4)
    rig.run(0.01)
    rig.control(0x02)
    if option == 0:
        assert rig.state == "disabled" and rig.motor.order == ("release",)
        return
    rate = 20.0 if option in (1, 5) else 50.0
    assert rig.motor.order == ("halt", pytest.approx(rate, rel=1e-3))
    rig.run(10.0 / rate - 0.02)
    assert rig.state == "quick stop"
    rig.run(0.05)
    assert rig.state == ("disabled" if option < 5 else "quick stop")
    assert rig.motor.order[0] == ("release" if option < 5 else "halt")
    assert abs(rig.motor.velocity) < 0.01
    rig.control(0x0F)
    assert rig.state == ("disabled" if option < 5 else "enabled")


def test_quick_stop_that_ends_in_disabled_is_not_left_for_enabled():
    rig = Rig()
    rig.enable()
    rig.write(0x60FF, 0, round(10.0 / UNIT), 4)
    rig.run(0.01)
    rig.control(0x02, 0x0F)
    assert rig.state == "quick stop"


def test_disable_operation_ramps_down_first_and_shutdown_coasts():
    rig = Rig(deceleration=20.0)
    rig.enable()
    rig.write(0x60FF, 0, round(10.0 / UNIT), 4)
    rig.run(0.01)
    rig.control(0x07)
    assert rig.motor.order == ("halt", pytest.approx(20.0, rel=1e-3))
    rig.run(0.4)
    assert rig.state == "enabled" and rig.motor.halts == 1
    rig.run(0.2)
    assert rig.state == "on" and rig.motor.velocity == 0.0
    rig.enable()
    rig.run(0.01)
    rig.control(0x06)
    assert rig.state == "ready" and rig.motor.order == ("release",)


def test_enable_during_the_ramp_of_disable_operation_goes_on():
    rig = Rig(deceleration=20.0)
    rig.enable()
    rig.write(0x60FF, 0, round(10.0 / UNIT), 4)
    rig.run(0.01)
    rig.control(0x07)
    rig.run(0.1)
    rig.control(0x0F)
    rig.run(0.002)
    assert rig.state == "enabled"
    assert rig.motor.order == ("velocity", pytest.approx(10.0, rel=1e-3), 0.0)


def test_ramp_that_does_not_stop_the_motor_is_given_up():
    rig = Rig(quick_stop_deceleration=50.0)
    rig.enable()
    rig.write(0x60FF, 0, round(10.0 / UNIT), 4)
    rig.run(0.01)
    rig.motor.tick = lambda step: None
    rig.control(0x02)
    rig.run(1.1)
    assert rig.state == "quick stop"
    rig.run(0.2)
    assert rig.state == "disabled" and rig.motor.order == ("release",)


def test_stale_target_moves_the_motor_when_enabled():
    rig = Rig()
    rig.enable()
    rig.write(0x60FF, 0, 4096, 4)
    rig.control(0x00)
    rig.run(0.1)
    assert rig.motor.order == ("release",)
    rig.control(0x06, 0x07)
    assert rig.motor.order == ("release",)
    rig.control(0x0F)
    rig.run(0.002)
    assert rig.motor.order == ("velocity", pytest.approx(TURN), 0.0)


# modes of operation


def test_cyclic_velocity_follows_target_and_offsets():
    rig = Rig()
    rig.enable(9)
    rig.write(0x60FF, 0, 4096, 4)
    rig.write(0x60B1, 0, -1024, 4)
    rig.write(0x60B2, 0, 250, 2)
    rig.run(0.002)
    assert rig.motor.order == ("velocity", pytest.approx(0.75 * TURN), pytest.approx(0.5))


def test_cyclic_torque_follows_thousandths_of_the_rated_torque():
    rig = Rig()
    rig.enable(10)
    rig.write(0x6071, 0, -500, 2)
    rig.write(0x60B2, 0, 100, 2)
    rig.run(0.002)
    assert rig.motor.order == ("torque", pytest.approx(-0.8))
    rig.motor.torque, rig.motor.current = -0.8, 4.0
    assert rig.read(0x6077) == -400
    assert rig.read(0x6078) == 400
    assert (rig.read(0x6076), rig.read(0x6075)) == (2000, 10000)


def test_profile_velocity_ramps_and_halts():
    rig = Rig(acceleration=20.0, deceleration=40.0)
    rig.enable(3)
    rig.write(0x60FF, 0, round(10.0 / UNIT), 4)
    rig.run(0.25)
    assert rig.motor.velocity == pytest.approx(5.0, abs=0.1)
    rig.run(0.3)
    assert rig.motor.velocity == pytest.approx(10.0, abs=0.01)
    assert rig.word & 0x0400
    rig.control(0x10F)
    rig.run(0.125)
    assert rig.motor.velocity == pytest.approx(5.0, abs=0.1)
    rig.run(0.2)
    assert rig.motor.velocity == 0.0 and rig.word & 0x1000


def test_profile_torque_ramps_by_its_slope():
    rig = Rig()
    rig.enable(4)
    rig.write(0x6087, 0, 1000, 4)  # thousandths a second
    rig.write(0x6071, 0, 500, 2)
    rig.run(0.25)
    assert rig.motor.order == ("torque", pytest.approx(0.5, abs=0.01))
    rig.run(1.0)
    assert rig.motor.order == ("torque", pytest.approx(1.0))


def test_mode_that_the_drive_lacks_is_refused_and_not_in_6502():
    rig = Rig(modes=(3,))
    assert rig.read(0x6502) == 0x04
    assert rig.write(0x6060, 0, 9, 1) == 0x0609_0030
    assert rig.write(0x6060, 0, 3, 1) == 0
    assert rig.read(0x6061) == 3
    assert Rig().read(0x6502) == 0x04 | 0x08 | 0x100 | 0x200


def test_mode_by_pdo_that_the_drive_lacks_changes_nothing():
    rig = Rig(modes=(3, 9))
    rig.map(0x1401, [0x6040_0010, 0x6060_0008], kind=255)
    rig.nmt(1)
    for mode, shown in ((9, 9), (10, 9), (0, 9), (3, 3)):
        rig.send(0x305, struct.pack("<Hb", 0, mode))
        assert rig.read(0x6061) == shown


def test_same_mode_again_does_not_begin_the_ramp_again():
    rig = Rig(acceleration=20.0)
    rig.enable(3)
    rig.write(0x60FF, 0, round(10.0 / UNIT), 4)
    asked = []
    rig.motor.follow_velocity = lambda speed, torque=0.0: asked.append(
        speed
    )  # a wheel that sticks
    rig.run(0.25, each=lambda: rig.write(0x6060, 0, 3, 1))
    assert asked[-1] == pytest.approx(5.0, abs=0.1)


def test_internal_limit_is_reported_by_bit_11():
    rig = Rig(max_speed=10.0, max_torque=1.0)
    rig.enable(9)
    rig.write(0x60FF, 0, round(-20.0 / UNIT), 4)
    rig.run(0.002)
    assert rig.motor.order == ("velocity", -10.0, 0.0)
    assert rig.word & 0x0800
    rig.write(0x60FF, 0, round(-9.0 / UNIT), 4)
    rig.run(0.002)
    assert not rig.word & 0x0800
    rig.write(0x6060, 0, 10, 1)
    rig.write(0x6071, 0, 600, 2)
    rig.run(0.002)
    assert rig.motor.order == ("torque", 1.0) and rig.word & 0x0800
    rig.write(0x6072, 0, 300, 2)
    rig.run(0.002)
    assert rig.motor.order == ("torque", pytest.approx(0.6))


def test_measurements_are_in_the_drives_units():
    rig = Rig(counts=1000, velocity_scale=60)
    rig.motor.position, rig.motor.velocity = -2.5 * TURN, 20 * TURN
    assert rig.read(0x6064) == -2500
    assert rig.read(0x606C) == 1200  # rpm
    assert rig.read(0x6079) == 48_000
    assert rig.read(0x608F, 1) == 1000


def test_count_starts_anywhere_and_wraps():
    rig = Rig(start_count=2**31 - 10)
    assert rig.read(0x6064) == 2**31 - 10
    rig.motor.position = 15 * UNIT
    assert rig.read(0x6064) == -(2**31) + 5
    rig.motor.position = 9 * UNIT
    assert rig.read(0x6064) == 2**31 - 1


# errors (CiA 301, 7.2.7; CiA 402-2, 605E and transitions 13 to 15)


def fault(rig, **faults):
    rig.drive.faults = DriveFaults(**faults)


@pytest.mark.parametrize("option", [0, 1, 2])
def test_fault_stops_by_its_option_reports_it_and_stays(option):
    rig = Rig(deceleration=20.0, quick_stop_deceleration=50.0)
    rig.write(0x605E, 0, option, 2)
    rig.enable()
    rig.write(0x60FF, 0, round(10.0 / UNIT), 4)
    rig.run(0.01)
    fault(rig, fault=True)
    frames = rig.run(0.002)
    # over-current, register: generic and current
    assert frames == [(0x085, bytes.fromhex("10 23 03 00 00 00 00 00"))]
    assert rig.read(0x603F) == 0x2310
    assert rig.read(0x1001) == 3
    assert (rig.read(0x1003, 0), rig.read(0x1003, 1)) == (1, 0x2310)
    if option:
        assert rig.state == "reaction"
        assert rig.motor.order == ("halt", pytest.approx(20.0 if option == 1 else 50.0, rel=1e-3))
        rig.run(0.6)
    assert rig.state == "fault" and rig.motor.order == ("release",)
    rig.control(0x00, 0x06, 0x07, 0x0F)
    assert rig.state == "fault"


def test_fault_is_reset_by_the_rising_edge_only_and_only_without_its_cause():
    rig = Rig()
    rig.control(0x80)  # high already when the fault comes
    fault(rig, fault=True)
    rig.run(0.01)
    fault(rig)
    rig.run(0.01)
    rig.control(0x80)
    assert rig.state == "fault"
    rig.control(0x00)
    rig.log.clear()
    rig.control(0x80)
    assert rig.state == "disabled"
    assert (0x085, bytes(8)) in [entry[1:] for entry in rig.log]  # no error any more
    assert (rig.read(0x603F), rig.read(0x1001)) == (0, 0)
    assert rig.read(0x1003, 0) == 1  # the history stays, until
    assert rig.write(0x1003, 0, 1, 1) == 0x0609_0030
    assert rig.write(0x1003, 0, 0, 1) == 0
    assert rig.read(0x1003, 0) == 0
    fault(rig, fault=True)
    rig.run(0.01)
    rig.log.clear()
    rig.control(0x00, 0x80)
    rig.run(0.01)
    assert rig.state == "fault"
    assert not [entry for entry in rig.log if entry[1] == 0x085]


def test_history_has_the_latest_first():
    rig = Rig()
    fault(rig, fault=True)
    rig.run(0.002)
    fault(rig, fault=True, supply=10.0)
    rig.run(0.002)
    assert [rig.read(0x1003, sub) for sub in range(3)] == [2, 0x3220, 0x2310]
    assert rig.read(0x1001) == 0x07


def test_supply_that_is_too_low_is_a_fault():
    rig = Rig()
    rig.enable()
    fault(rig, supply=23.9)
    frames = rig.run(0.002)
    assert frames == [(0x085, bytes.fromhex("20 32 05 00 00 00 00 00"))]
    assert rig.read(0x6079) == 23_900
    rig.run(0.1)
    assert rig.state == "fault" and not rig.word & 0x10
    fault(rig, supply=24.1)
    rig.run(0.01)
    rig.control(0x00, 0x80)
    assert rig.state == "disabled" and rig.word & 0x10


def test_encoder_that_misleads_is_a_fault():
    rig = Rig()
    rig.enable()
    rig.motor.lost = True
    assert rig.run(0.002) == [(0x085, bytes.fromhex("05 73 21 00 00 00 00 00"))]


def test_emergencies_wait_while_the_node_is_stopped():
    rig = Rig()
    rig.nmt(2)
    fault(rig, fault=True)
    assert rig.run(0.05) == []
    assert rig.nmt(128) == [(0x085, bytes.fromhex("10 23 03 00 00 00 00 00"))]


# the host falls silent (CiA 301, 7.2.8.3.2; CiA 402-2, 6007)


def watched(option=3, on_error=None, **settings):
    rig = Rig(**settings)
    rig.write(0x6007, 0, option, 2)
    rig.write(0x1016, 1, 127 << 16 | 100, 4)
    if on_error is not None:
        rig.write(0x1029, 1, on_error, 1)
    rig.cyclic()
    rig.command(15, round(10.0 / UNIT))
    return rig


def test_watch_starts_with_the_first_heartbeat():
    rig = watched()
    rig.run(1.0)
    assert rig.state == "enabled"
    rig.beat(127)
    rig.run(0.098)
    assert rig.state == "enabled"
    rig.run(0.003)
    assert rig.state == "quick stop"


@pytest.mark.parametrize("value", [127 << 16, 100, 128 << 16 | 100], ids=hex)
def test_no_time_or_no_node_means_no_watch(value):
    rig = watched()
    assert rig.write(0x1016, 1, value, 4) == 0
    rig.beat(127)
    rig.run(0.5)
    assert rig.state == "enabled"
    assert rig.write(0x1016, 1, 1 << 24 | 127 << 16 | 100, 4) == 0x0604_0043


def test_only_the_host_that_is_watched_counts():
    rig = watched()
    rig.beat(1)
    rig.run(0.5)
    assert rig.state == "enabled"
    rig.beat(127)
    rig.run(0.5, each=lambda: rig.beat(1))
    assert rig.state == "fault"


def test_host_with_a_heartbeat_does_not_count_as_silent():
    rig = watched()
    for _ in range(50):
        rig.beat(127)
        rig.run(0.09)
    assert rig.state == "enabled"


def test_silent_host_leads_to_rest_within_heartbeat_time_and_ramp_then_fault():
    rig = watched(quick_stop_deceleration=100.0)
    rig.beat(127)
    rig.log.clear()
    rig.run(0.1 + 10.0 / 100.0 + 0.002)
    assert rig.motor.velocity == 0.0
    assert rig.motor.halts == 1
    emergencies = [entry for entry in rig.log if entry[1] == 0x085]
    assert [entry[2] for entry in emergencies] == [bytes.fromhex("30 81 11 00 00 00 00 00")]
    rig.run(0.01)
    assert rig.state == "fault" and rig.motor.order == ("release",)
    assert rig.read(0x603F, signed=False) == 0x8130
    # reset only once the host's heartbeat is received again; nothing moves by that
    rig.control(0x00, 0x80)
    assert rig.state == "fault"
    rig.beat(127)
    assert rig.read(0x1001) == 0x11  # until the reset
    rig.control(0x00, 0x80)
    assert rig.state == "disabled" and rig.read(0x1001) == 0
    assert rig.motor.order == ("release",)


def test_nothing_but_power_off_gets_through_while_a_lost_host_stops_the_motor():
    rig = watched(on_error=1)
    rig.write(0x605A, 0, 6, 2)
    rig.beat(127)
    rig.run(0.11)
    assert rig.state == "quick stop"
    rig.beat(127)
    rig.command(15, 9999)
    assert rig.state == "quick stop" and rig.read(0x1001) == 0x11
    rig.command(0, 0)
    assert rig.state == "fault" and rig.motor.order == ("release",)


@pytest.mark.parametrize(
    ("option", "state", "order"),
    [
        (0, "enabled", "velocity"),
        (1, "reaction", "halt"),
        (2, "disabled", "release"),
        (3, "quick stop", "halt"),
    ],
)
def test_abort_connection_option_decides(option, state, order):
    for silence in (lambda rig: rig.run(0.11), lambda rig: (rig.nmt(2), rig.nmt(128))):
        rig = watched(option)
        rig.beat(127)
        silence(rig)
        assert rig.state == state
        assert rig.motor.order[0] == order


@pytest.mark.parametrize("path", [(6,), (6, 7)], ids=["ready", "on"])
def test_silent_host_takes_a_drive_that_is_not_enabled_to_disabled(path):
    rig = Rig()
    rig.write(0x6007, 0, 3, 2)
    rig.write(0x1016, 1, 127 << 16 | 100, 4)
    rig.control(*path)
    rig.beat(127)
    rig.run(0.11)
    # the controlword would go on asking: it comes from a host that is gone
    assert rig.state == "disabled"


def test_end_of_one_error_of_two_is_not_reported():
    rig = watched(option=0, on_error=1)
    rig.beat(127)
    rig.run(0.11)
    rig.send(0x205, "0F 00")
    assert rig.read(0x1001) == 0x11
    rig.command(15, 0)
    codes = [entry[2][:2] for entry in rig.log if entry[1] == 0x085]
    assert codes == [b"\x30\x81", b"\x10\x82"]
    rig.beat(127)
    codes = [entry[2][:2] for entry in rig.log if entry[1] == 0x085]
    assert codes[2:] == [b"\x00\x00"]


@pytest.mark.parametrize(("value", "state"), [(0, 127), (1, 5), (2, 4)])
def test_error_behaviour_selects_the_state_of_the_node(value, state):
    rig = watched(on_error=value)
    rig.beat(127)
    rig.run(0.11)
    assert rig.drive.nmt == state


def test_host_that_comes_back_to_a_drive_without_power_leaves_no_error():
    rig = Rig()
    rig.write(0x6007, 0, 3, 2)
    rig.write(0x1016, 1, 127 << 16 | 100, 4)
    rig.beat(127)
    rig.run(0.2)
    assert rig.state == "disabled" and rig.read(0x1001) == 0x11
    rig.beat(127)
    assert rig.read(0x1001) == 0
    assert [entry[2][:3] for entry in rig.log if entry[1] == 0x85] == [b"\x30\x81\x11", bytes(3)]


# faults to play


def test_silent_sends_nothing_and_still_obeys():
    rig = Rig()
    rig.cyclic()
    fault(rig, silent=True)
    assert rig.command(15, 4096) == []
    assert rig.motor.velocity == pytest.approx(TURN)


def test_deaf_drive_receives_nothing_and_still_sends_heartbeats():
    rig = Rig()
    rig.write(0x1017, 0, 10, 2)
    rig.cyclic()
    fault(rig, deaf=True)
    assert rig.command(15, 4096) == []
    assert rig.motor.velocity == 0.0
    assert (0x705, b"\x05") in rig.run(0.05)


def test_frozen_reports_stop_motion_reports_only():
    rig = Rig()
    rig.cyclic()
    fault(rig, frozen_reports=True)
    assert [can_id for can_id, _ in rig.sync()] == [0x185]


def test_frozen_encoder_reports_the_same_for_ever():
    rig = Rig()
    rig.cyclic()
    rig.command(15, 4096)
    rig.run(0.1)
    fault(rig, frozen_encoder=True)
    rig.sync()
    first = [frame for frame in rig.sync() if frame[0] == 0x285]
    rig.run(0.1)
    assert [frame for frame in rig.sync() if frame[0] == 0x285] == first
    fault(rig)
    rig.run(0.001)
    assert [frame for frame in rig.sync() if frame[0] == 0x285] != first


def test_no_heartbeat_stops_the_heartbeat_only():
    rig = Rig()
    rig.write(0x1017, 0, 10, 2)
    rig.cyclic()
    fault(rig, no_heartbeat=True)
    rig.run(0.002)
    frames = rig.run(0.1) + rig.sync()
    assert {can_id for can_id, _ in frames} == {0x185, 0x285}


def test_drive_that_refuses_to_be_enabled_stays_switched_on():
    rig = Rig()
    fault(rig, refuse_enable=True)
    rig.write(0x6060, 0, 9, 1)
    rig.control(6, 7, 15)
    rig.run(0.1)
    assert rig.state == "on" and rig.motor.order == ("release",)
    fault(rig)
    rig.run(0.01)
    assert rig.state == "enabled"


def test_wrong_mode_is_shown():
    rig = Rig()
    rig.write(0x6060, 0, 9, 1)
    fault(rig, wrong_mode=True)
    rig.run(0.002)
    assert rig.read(0x6061) not in (3, 4, 9, 10)


def test_stuck_status_does_not_change():
    rig = Rig()
    rig.enable()
    fault(rig, stuck_status=True)
    rig.run(0.002)
    rig.control(0x00)
    assert rig.state == "enabled" and rig.motor.order == ("release",)


def test_configuration_is_refused_or_unanswered():
    rig = Rig()
    fault(rig, configuration_refused=True)
    rig.run(0.002)
    assert rig.write(0x1017, 0, 10, 2) == 0x0800_0022
    assert rig.read(0x1000) == 0x0002_0192
    fault(rig, configuration_unanswered=True)
    rig.run(0.002)
    assert rig.send(0x605, "40 00 10 00 00 00 00 00") == []


def test_short_duplicated_and_reordered_reports():
    rig = Rig()
    rig.cyclic()
    plain = dict(rig.sync())
    assert {can_id: len(data) for can_id, data in plain.items()} == {0x185: 5, 0x285: 8}
    fault(rig, short_reports=True)
    assert rig.sync() == [(can_id, data[:-1]) for can_id, data in plain.items()]
    fault(rig, duplicated_reports=True)
    assert rig.sync() == [frame for frame in plain.items() for _ in range(2)]
    fault(rig, reordered_reports=True)
    got = []
    for position in (100, 200, 300, 400):
        rig.motor.position = position * UNIT
        got += [struct.unpack("<ii", data)[0] for can_id, data in rig.sync() if can_id == 0x285]
    assert got == [200, 100, 400, 300]


def test_reboot_loses_power_configuration_and_count():
    rig = Rig(start_count=500)
    rig.cyclic()
    rig.command(15, 4096)
    rig.run(0.1)
    rig.log.clear()
    fault(rig, reboots=1)
    rig.run(0.001)
    assert rig.motor.order == ("release",)
    frames = rig.run(0.05)
    assert frames == [(0x705, b"\x00")]
    assert rig.state == "disabled"
    assert (rig.read(0x60FF), rig.read(0x6060), rig.read(0x1600, 2)) == (0, 0, 0)
    assert 0 < rig.read(0x6064) < 0.1 * 4096
    rig.drive.faults = replace(rig.drive.faults)
    rig.run(0.05)
    assert len(rig.log) > 1 and not any(entry[1] == 0x705 for entry in rig.log[1:])


# settings and dependencies


@pytest.mark.parametrize(
    "bad",
    [{"counts": 0}, {"velocity_scale": -1}, {"rated_torque": math.nan}, {"modes": (8,)}],
    ids=str,
)
def test_invalid_settings_are_refused(bad):
    with pytest.raises(ParameterError):
        Cia402Settings(**bad)


def test_arbitrary_frames_are_tolerated():
    import random

    random_ = random.Random(3)
    rig = Rig()
    ids = [0, 0x80, 0x205, 0x305, 0x405, 0x505, 0x605, 0x701, 0x585, 0x705]
    for _ in range(3000):
        can_id = random_.choice(ids) if random_.random() < 0.9 else random_.randrange(0x800)
        data = bytes(
            random_.choice((0, 1, 5, 15, 255, random_.randrange(256)))
            for _ in range(random_.randrange(9))
        )
        for frame in rig.drive.receive(
            can.Message(arbitration_id=can_id, data=data, is_extended_id=False), rig.now
        ):
            assert len(frame.data) <= 8
        rig.run(0.001)
    rig.nmt(129)
    assert rig.run(0.1)[0] == (0x705, b"\x00")
