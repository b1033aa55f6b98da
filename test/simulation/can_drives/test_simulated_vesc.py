import dataclasses
import math
import random
import struct

import can
import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.can_drives.motor import DriveFaults
from omniman_ros.simulation.can_drives.vesc import VescDrive, VescSettings
from test.simulation.can_drives.ideal_motor import IdealMotor, play

NODE, POLE_PAIRS, K = 23, 7, 0.05
SET_DUTY, SET_CURRENT, SET_BRAKE, SET_RPM = 0, 1, 2, 3
ERPM = 60.0 / (2.0 * math.pi) * POLE_PAIRS
NO_REPORTS = {"status_1_rate": 0.0, "status_4_rate": 0.0, "status_5_rate": 0.0}


def frame(command, number, node=NODE, size=4):
    data = struct.pack(">i", number).ljust(8, b"\0")[:size]
    return can.Message(arbitration_id=command << 8 | node, is_extended_id=True, data=data)


def setup(**arguments):
    motor = IdealMotor(max_current=200.0)
    drive = VescDrive(
        motor, NODE, VescSettings(pole_pairs=POLE_PAIRS, torque_constant=K, **arguments)
    )
    drive.advance(0.0)
    return drive, motor


def ids(sent, command=None):
    return [
        (time, message)
        for time, message in sent
        if command is None or message.arbitration_id == command << 8 | NODE
    ]


def status_1(message):
    erpm, current, duty = struct.unpack(">ihh", message.data)
    return erpm, current / 10, duty / 1000


def status_5(message):
    tachometer, supply, reserved = struct.unpack(">ihh", message.data)
    return tachometer, supply / 10, reserved


# --- commands ---


@pytest.mark.parametrize(
    ("data", "duty"),
    [
        # payloads of COMM_SET_DUTY, same scale and byte order: crate vesc 0.4.0, tests/command.rs
        (bytes([0, 0, 39, 16]), 0.1),
        (bytes([0, 0, 223, 35]), 0.57123),
        (bytes([255, 255, 216, 240]), -0.1),
    ],
)
def test_duty_is_a_part_of_the_supply(data, duty):
    drive, motor = setup()
    drive.receive(can.Message(arbitration_id=NODE, is_extended_id=True, data=data), 0.01)
    assert motor.order == ("voltage", pytest.approx(24.0 * duty))
    motor.supply = 20.0
    drive.advance(0.02)
    assert motor.order == ("voltage", pytest.approx(20.0 * duty))


def test_duty_is_clipped_at_the_largest():
    drive, motor = setup()
    for number, duty in ((100000, 0.95), (-(2**31), -0.95)):
        drive.receive(frame(SET_DUTY, number), 0.01)
        assert motor.order == ("voltage", pytest.approx(24.0 * duty))


@pytest.mark.parametrize(
    ("command", "number", "order"),
    [
        (SET_CURRENT, -2500, ("torque", -2.5 * K)),
        (SET_CURRENT, 2**31 - 1, ("torque", 60.0 * K)),
        (SET_CURRENT, 49, ("released",)),
        (SET_RPM, 4200, ("velocity", 4200.0 / ERPM, 0.0)),
        (SET_RPM, -4200, ("velocity", -4200.0 / ERPM, 0.0)),
        (SET_RPM, 0, ("velocity", 0.0, 0.0)),
        (10, -50000, ("torque", -30.0 * K)),  # SET_CURRENT_REL
        (SET_BRAKE, 3000, ("torque", -3.0 * K)),
        (SET_BRAKE, -3000, ("torque", -3.0 * K)),
        (SET_BRAKE, 49, ("released",)),
        (11, 50000, ("torque", -30.0 * K)),  # SET_CURRENT_BRAKE_REL
        (12, 4000, ("torque", -4.0 * K)),  # SET_CURRENT_HANDBRAKE
        (13, 10000, ("torque", -6.0 * K)),  # SET_CURRENT_HANDBRAKE_REL
    ],
)
def test_simple_commands_reach_a_motor_that_turns_forwards(command, number, order):
    drive, motor = setup()
    motor.velocity = 100.0
    drive.receive(frame(command, number), 0.01)
    assert motor.order[0] == order[0]
    assert motor.order[1:] == pytest.approx(order[1:])


def test_speeds_below_the_smallest_short_the_motor():
    # mcpwm_foc.c: "Brake when set ERPM is below min ERPM", duty 0
    drive, motor = setup(min_erpm=900.0)
    drive.receive(frame(SET_RPM, 900), 0.01)
    assert motor.order[0] == "velocity"
    drive.receive(frame(SET_RPM, -899), 0.02)
    assert motor.order == ("voltage", 0.0)


@pytest.mark.parametrize(
    "message",
    [
        can.Message(arbitration_id=0x117, is_extended_id=False, data=b"\0\0\x10\0"),
        frame(SET_CURRENT, 4096, node=NODE + 1),
        can.Message(arbitration_id=1 << 16 | 0x117, is_extended_id=True, data=b"\0\0\x10\0"),
        can.Message(arbitration_id=0x117, is_extended_id=True, is_remote_frame=True, dlc=4),
        can.Message(
            arbitration_id=0x117, is_extended_id=True, is_error_frame=True, data=b"\0\0\x10\0"
        ),
        can.Message(arbitration_id=0x117, is_extended_id=True, is_fd=True, data=b"\0\0\x10\0"),
        *(frame(SET_CURRENT, 0x40404040, size=size) for size in range(4)),
        frame(4, 4096),  # SET_POS
        frame(17, 4096),  # PING
        frame(99, 4096),
    ],
)
def test_other_frames_neither_move_the_motor_nor_reset_the_timeout(message):
    drive, motor = setup(**NO_REPORTS)
    play(drive, motor, 0.0, 0.2, heard=message)
    assert motor.order == ("released",)
    drive.receive(frame(SET_RPM, 4200), 0.2)
    play(drive, motor, 0.2, 0.69, heard=message)
    assert motor.order[0] == "velocity"
    play(drive, motor, 0.69, 0.9, heard=message)
    assert motor.order == ("voltage", 0.0), "braked to rest"


@pytest.mark.parametrize("size", [4, 5, 6, 7, 8])
def test_frames_may_be_longer(size):
    drive, motor = setup()
    drive.receive(frame(SET_CURRENT, 4000, size=size), 0.01)
    assert motor.order == ("torque", pytest.approx(4.0 * K))


def test_node_255_addresses_every_drive():
    drive, motor = setup()
    drive.receive(frame(SET_CURRENT, 4000, node=255), 0.01)
    assert motor.order[0] == "torque"


def test_ping_is_answered_with_a_pong_to_its_sender():
    drive, _ = setup()
    ping = can.Message(arbitration_id=17 << 8 | NODE, is_extended_id=True, data=b"\x2a")
    (pong,) = drive.receive(ping, 0.01)
    assert (pong.arbitration_id, pong.is_extended_id) == (18 << 8 | 0x2A, True)
    assert bytes(pong.data) == bytes([NODE, 0])


# --- timeout and brake ---


@pytest.mark.parametrize("timeout", [0.5, 0.1])
def test_without_commands_the_motor_is_braked_after_the_timeout(timeout):
    drive, motor = setup(timeout=timeout, timeout_brake_current=4.0)
    drive.receive(frame(SET_CURRENT, 1000), 0.1)
    play(drive, motor, 0.1, 0.1 + timeout - 0.001)
    assert motor.order == ("torque", pytest.approx(K))
    play(drive, motor, 0.1 + timeout - 0.001, 0.1 + timeout + 0.002)
    assert motor.order == ("torque", pytest.approx(-4.0 * K))


def test_motor_comes_to_rest_and_stays_until_the_next_command():
    drive, motor = setup(timeout_brake_current=2.0)
    motor.velocity = 150.0
    play(drive, motor, 0.0, 5.0)
    assert abs(motor.velocity) < 1e-3
    drive.receive(frame(SET_RPM, 4200), 5.0)
    play(drive, motor, 5.0, 5.1)
    assert motor.velocity == pytest.approx(4200 / ERPM)


def test_every_command_resets_the_timeout():
    drive, motor = setup(timeout=0.1)
    for number, command in enumerate((0, 1, 2, 3, 10, 11, 12, 13) * 2):
        now = 0.09 * number
        drive.receive(frame(command, 50000), now)
        before = motor.order[0]
        play(drive, motor, now, now + 0.09)
        if command in (SET_DUTY, SET_CURRENT, SET_RPM, 10):
            assert motor.order[0] == before
    play(drive, motor, 2.0, 2.11)
    assert motor.order[0] in ("torque", "voltage")


def test_no_brake_current_lets_the_motor_coast():
    drive, motor = setup(timeout_brake_current=0.0)
    drive.receive(frame(SET_RPM, 4200), 0.0)
    play(drive, motor, 0.0, 2.0)
    assert motor.order == ("released",)
    assert motor.velocity == pytest.approx(4200 / ERPM)


def test_motor_without_timeout_runs_indefinitely():
    drive, motor = setup(timeout=0.0, **NO_REPORTS)
    drive.receive(frame(SET_RPM, 4200), 0.0)
    play(drive, motor, 0.0, 5.0, step=0.01)
    assert motor.order[0] == "velocity"


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("step", [0.0005, 0.002])
def test_brake_opposes_the_motion_and_never_reverses_the_motor(direction, step):
    drive, motor = setup(**NO_REPORTS)
    motor.velocity = 200.0 * direction
    brake = frame(SET_BRAKE, 3000)
    drive.receive(brake, 0.0)
    play(drive, motor, 0.0, 0.02, step=step, heard=brake)
    assert motor.current == pytest.approx(-3.0 * direction)
    last = motor.velocity * direction
    for k in range(1, 400):
        play(drive, motor, 0.02 + (k - 1) * step, 0.02 + k * step, step=step, heard=brake)
        assert -1e-9 < motor.velocity * direction < last or abs(motor.velocity) < 1e-6
        last = motor.velocity * direction
    assert motor.order == ("voltage", 0.0)


def test_brake_holds_a_motor_that_is_pushed():
    drive, motor = setup(**NO_REPORTS)
    brake = frame(SET_BRAKE, 3000)
    drive.receive(brake, 0.0)
    assert motor.order == ("voltage", 0.0)
    motor.velocity = 60.0  # the shorted motor would give 6 A
    play(drive, motor, 0.0, 0.003, heard=brake)
    assert motor.order == ("torque", pytest.approx(-3.0 * K))
    play(drive, motor, 0.003, 1.0, heard=brake)
    assert abs(motor.velocity) < 1e-3


# --- status frames ---


def test_status_frames_come_at_their_rates_with_8_bytes():
    drive, motor = setup()
    sent = play(drive, motor, 0.0, 1.0)
    assert len(ids(sent, 9)) == len(ids(sent, 27)) == 200
    assert len(ids(sent, 16)) == 20
    assert len(sent) == 420
    assert all(message.is_extended_id and message.dlc == 8 for _, message in sent)


def test_rates_are_configured_and_0_is_never():
    drive, motor = setup(status_1_rate=50.0, status_4_rate=0.0, status_5_rate=100.0)
    sent = play(drive, motor, 0.0, 1.0)
    assert [len(ids(sent, command)) for command in (9, 16, 27)] == [50, 0, 100]


def test_grid_begins_with_the_first_call():
    motor = IdealMotor()
    drive = VescDrive(
        motor,
        NODE,
        VescSettings(
            pole_pairs=POLE_PAIRS, torque_constant=K, status_4_rate=0.0, status_5_rate=0.0
        ),
    )
    assert len(drive.advance(1000.0033)) == 1
    assert drive.advance(1000.0081) == []
    assert len(drive.advance(1000.0083)) == 1
    drive.advance(1000.5)
    assert motor.order == ("released",)
    drive.advance(1000.504)  # the timeout runs from the first call, too
    assert motor.order == ("voltage", 0.0)


def test_values_of_the_status_frames():
    drive, motor = setup()
    motor.position, motor.velocity = 3.0, -12.5
    motor.voltage, motor.current, motor.supply = -6.0, -41.26, 24.37
    sent = ids([(0, message) for message in drive.advance(0.06)])
    (one,) = ids(sent, 9)
    (four,) = ids(sent, 16)
    (five,) = ids(sent, 27)
    assert one[1].data == struct.pack(">ihh", int(-12.5 * ERPM), 412, -246)
    assert four[1].data == struct.pack(">hhhh", 250, 250, 101, int(math.degrees(3.0) * 50))
    assert five[1].data == struct.pack(">ihh", math.floor(3.0 / math.tau * 7 * 6), 243, 0)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_current_is_negative_while_the_motor_brakes(direction):
    """mcpwm_foc_get_tot_current_filtered: positive draws, negative generates."""
    drive, motor = setup()
    motor.velocity = 100.0 * direction
    drive.receive(frame(SET_CURRENT, round(-2000 * direction)), 0.0)
    sent = play(drive, motor, 0.0, 0.01)
    assert status_1(ids(sent, 9)[-1][1])[1] == pytest.approx(-2.0)
    drive.receive(frame(SET_CURRENT, round(2000 * direction)), 0.01)
    sent = play(drive, motor, 0.01, 0.02)
    assert status_1(ids(sent, 9)[-1][1])[1] == pytest.approx(2.0)


def test_values_out_of_range_are_clipped():
    drive, motor = setup()
    motor.velocity, motor.voltage, motor.current, motor.supply = 1e12, 1e6, 1e6, 1e6
    values = {m.arbitration_id >> 8: bytes(m.data) for m in drive.advance(0.06)}
    assert values[9] == struct.pack(">ihh", 2**31 - 1, 2**15 - 1, 1000)
    assert values[27][4:6] == struct.pack(">h", 2**15 - 1)


@pytest.mark.parametrize("direction", [1, -1])
def test_tachometer_wraps_both_ways(direction):
    start = 2**31 - 10 if direction > 0 else -(2**31) + 10
    drive, motor = setup(tachometer=start)
    seen = []
    for k in range(1, 201):
        motor.position = direction * k * 0.01
        seen += [status_5(m)[0] for _, m in ids([(0, m) for m in drive.advance(k * 0.005)], 27)]
    counts = [math.floor(direction * k * 0.01 / math.tau * 42) for k in range(1, 201)]
    assert seen == [(start + count + 2**31) % 2**32 - 2**31 for count in counts]
    assert min(seen) < -(2**31) + 10
    assert max(seen) > 2**31 - 11


def test_tachometer_starts_anywhere_and_counts_6_in_an_electrical_turn():
    motor = IdealMotor()
    motor.position = 77.7
    drive = VescDrive(
        motor, NODE, VescSettings(pole_pairs=POLE_PAIRS, torque_constant=K, tachometer=-123456)
    )
    first = status_5(ids([(0, m) for m in drive.advance(0.0)], 27)[0][1])[0]
    motor.position += 2 * math.tau
    second = status_5(ids([(0, m) for m in drive.advance(0.005)], 27)[0][1])[0]
    assert (first, second) == (-123456, -123456 + 2 * 7 * 6)


# --- faults ---


def broken(drive, **faults):
    drive.faults = dataclasses.replace(drive.faults, **faults)


def test_silent_drive_sends_nothing_and_still_receives():
    drive, motor = setup()
    broken(drive, silent=True)
    drive.receive(frame(SET_RPM, 4200), 0.0)
    assert motor.order[0] == "velocity"
    assert play(drive, motor, 0.0, 0.5) == []
    ping = can.Message(arbitration_id=17 << 8 | NODE, is_extended_id=True, data=b"\x2a")
    assert drive.receive(ping, 0.5) == []


def test_deaf_drive_times_out_and_still_reports():
    drive, motor = setup()
    command = frame(SET_RPM, 4200)
    drive.receive(command, 0.0)
    broken(drive, deaf=True)
    sent = play(drive, motor, 0.0, 0.502, heard=command)
    assert motor.order[0] == "torque"
    assert len(ids(sent, 9)) == 100


def test_frozen_reports_leave_status_4():
    drive, motor = setup()
    broken(drive, frozen_reports=True)
    sent = play(drive, motor, 0.0, 1.0)
    assert len(sent) == len(ids(sent, 16)) == 20


def test_frozen_encoder_goes_on_reporting_the_same_and_the_rest_lives():
    drive, motor = setup(status_4_rate=0.0)
    drive.receive(frame(SET_RPM, 4200), 0.0)
    play(drive, motor, 0.0, 0.1)
    broken(drive, frozen_encoder=True)
    drive.receive(frame(SET_RPM, -2100), 0.1)
    sent = play(drive, motor, 0.1, 0.3)
    (speed,) = {status_1(m)[0] for _, m in ids(sent, 9)}
    assert speed in (4199, 4200)
    assert len({status_5(m)[0] for _, m in ids(sent, 27)}) == 1
    assert status_1(ids(sent, 9)[-1][1])[2] < 0
    broken(drive, frozen_encoder=False)
    sent = play(drive, motor, 0.3, 0.31)
    assert status_1(ids(sent, 9)[-1][1])[0] in (-2099, -2100)


def test_error_releases_the_motor_and_ends_by_itself():
    drive, motor = setup(timeout=0.0)
    command = frame(SET_RPM, 4200)
    drive.receive(command, 0.0)
    broken(drive, fault=True)
    play(drive, motor, 0.0, 0.002)
    assert motor.order == ("released",)
    sent = play(drive, motor, 0.002, 0.3, heard=command)
    assert motor.order == ("released",)
    assert {status_1(m)[1] for _, m in ids(sent, 9)} == {0.0}
    broken(drive, fault=False)
    play(drive, motor, 0.3, 0.79, heard=command)
    assert motor.order == ("released",)
    play(drive, motor, 0.79, 1.5)
    assert motor.order == ("released",), "commands given meanwhile are lost"
    drive.receive(command, 1.5)
    assert motor.order[0] == "velocity"


def test_timeout_does_not_brake_while_there_is_an_error():
    drive, motor = setup(timeout=0.1)
    motor.velocity = 100.0
    broken(drive, fault=True)
    play(drive, motor, 0.0, 0.5)
    assert motor.order == ("released",)
    broken(drive, fault=False)
    play(drive, motor, 0.5, 0.99)
    assert motor.order == ("released",)
    play(drive, motor, 0.99, 1.01)
    assert motor.order[0] == "torque"


def test_command_while_there_is_an_error_moves_nothing():
    drive, motor = setup()
    broken(drive, fault=True)
    drive.receive(frame(SET_RPM, 4200), 0.001)
    assert motor.order == ("released",)


def test_encoder_that_misleads_is_an_error():
    drive, motor = setup()
    drive.receive(frame(SET_RPM, 4200), 0.0)
    motor.lost = True
    drive.advance(0.001)
    assert motor.order == ("released",)


def test_low_supply_is_reported_and_is_an_error():
    drive, motor = setup()
    command = frame(SET_RPM, 4200)
    broken(drive, supply=12.0)
    sent = play(drive, motor, 0.0, 0.1, heard=command)
    assert motor.order[0] == "velocity"
    assert status_5(ids(sent, 27)[-1][1])[1] == pytest.approx(12.0)
    broken(drive, supply=7.9)
    play(drive, motor, 0.1, 0.2, heard=command)
    assert motor.order == ("released",)
    broken(drive, supply=0.0)
    play(drive, motor, 0.2, 0.71, heard=command)
    assert motor.order[0] == "velocity"


def test_refused_enabling_leaves_the_motor_released():
    drive, motor = setup()
    broken(drive, refuse_enable=True)
    for command in (0, 1, 2, 3, 10, 11, 12, 13):
        drive.receive(frame(command, 50000), 0.01)
        assert motor.order == ("released",)
    play(drive, motor, 0.01, 1.0)
    assert motor.order == ("released",)


def test_short_reports_lack_a_byte():
    drive, motor = setup()
    good = play(drive, motor, 0.0, 0.1)
    broken(drive, short_reports=True)
    short = play(drive, motor, 0.1, 0.2)
    assert [len(m.data) for _, m in short] == [7] * len(good)
    assert all(m.dlc == 7 for _, m in short)


def test_restarting_drive_neither_sends_nor_receives_and_loses_its_state():
    drive, motor = setup(tachometer=5000, boot_time=0.4)
    motor.velocity = 100.0
    command = frame(SET_CURRENT, 1000)
    play(drive, motor, 0.0, 0.1, heard=command)
    broken(drive, reboots=1)
    assert play(drive, motor, 0.1, 0.499, heard=command) == []
    assert motor.order == ("released",)
    sent = play(drive, motor, 0.499, 0.501)
    assert 0 <= status_5(ids(sent, 27)[0][1])[0] < 2000
    assert motor.order == ("released",)
    play(drive, motor, 0.501, 0.6)
    assert motor.order == ("released",), "no motion without a command"


@pytest.mark.parametrize(
    "fault",
    [
        "no_heartbeat",
        "wrong_mode",
        "stuck_status",
        "configuration_refused",
        "configuration_unanswered",
    ],
)
def test_faults_without_a_vesc_equivalent_have_no_effect(fault):
    logs = []
    for faults in (DriveFaults(), DriveFaults(**{fault: True})):
        drive, motor = setup()
        drive.faults = faults
        sent = play(drive, motor, 0.0, 0.3, heard=frame(SET_DUTY, 20000))
        logs.append(([(t, bytes(m.data)) for t, m in sent], motor.order))
    assert logs[0] == logs[1]


# --- robustness ---


def test_20000_random_frames_do_no_harm():
    """IdealMotor refuses what is not finite."""
    chance = random.Random(2)
    drive, motor = setup(timeout=0.01)
    now = 0.0
    moved = set()
    for _ in range(20_000):
        now += chance.choice((0.0, 0.0, 0.001, 0.02))
        extended = chance.random() < 0.9
        close = chance.choice((NODE, 255, chance.randrange(256)))
        number = chance.choice((chance.randrange(32) << 8 | close, chance.randrange(2**29)))
        remote = chance.random() < 0.05
        data = chance.randbytes(chance.randrange(9))
        message = can.Message(
            arbitration_id=number if extended else number & 0x7FF,
            is_extended_id=extended,
            is_remote_frame=remote,
            is_error_frame=chance.random() < 0.02,
            dlc=len(data) if remote else None,
            data=None if remote else data,
        )
        for answer in drive.receive(message, now) + drive.advance(now):
            assert answer.is_extended_id
            assert len(answer.data) <= 8
        moved.add(motor.order[0])
        motor.step(0.001)
    assert moved == {"velocity", "torque", "voltage", "released"}


def test_first_and_the_last_node_and_one_pole_pair_are_possible():
    for node in (0, 254):
        drive = VescDrive(IdealMotor(), node, VescSettings(pole_pairs=1, torque_constant=K))
        assert drive.advance(0.0)[0].arbitration_id == 9 << 8 | node


@pytest.mark.parametrize(
    "wrong",
    [
        {"node": 255},
        {"node": -1},
        {"pole_pairs": 0},
        {"torque_constant": 0.0},
        {"timeout": -1.0},
        {"status_1_rate": math.nan},
        {"timeout_brake_current": math.inf},
        {"max_current": 0.0},
        {"max_duty": 0.0},
    ],
)
def test_invalid_numbers_are_refused_by_name(wrong):
    arguments = {"node": 1, "pole_pairs": 7, "torque_constant": K, **wrong}
    with pytest.raises(ParameterError, match=f"'{next(iter(wrong))}'"):
        VescDrive(IdealMotor(), arguments.pop("node"), VescSettings(**arguments))
