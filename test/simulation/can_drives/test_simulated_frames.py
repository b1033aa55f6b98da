"""Frames as public documents print them, and what the simulated drives do with them.

Sources:
    [1] vedderb/bldc, documentation/comm_can.md: Single-Frame Commands, Status Commands.
    [2] vesc-project.com/node/3345: candump of the status frames of VESC 4, firmware 5.
    [3] Shell scripts and notes in public repositories, with their own comments.
    [4] ODrive docs, can-guide.rst: candump of two axes.
    [5] odriverobotics/ODriveResources, examples/can_simple.py, can_watchdog.py,
        can_simple_utils.py: Python's struct and numbers, worked out to bytes.
"""

import math

import can
import pytest

from omniman_ros.simulation.can_drives.odrive.drive import OdriveDrive
from omniman_ros.simulation.can_drives.odrive.settings import OdriveSettings
from omniman_ros.simulation.can_drives.vesc import VescDrive, VescSettings
from test.simulation.can_drives.ideal_motor import IdealMotor

K = 0.05
POLE_PAIRS = 7
RPM = math.tau / 60.0


def hear(drive, text, extended, now=0.01):
    number, data = text.split("#")
    remote = data.startswith("R")
    message = can.Message(
        arbitration_id=int(number, 16),
        is_extended_id=extended,
        is_remote_frame=remote,
        dlc=int(data[1:]) if remote else None,
        data=None if remote else bytes.fromhex(data),
    )
    return drive.receive(message, now)


def shown(messages):
    return [f"{message.arbitration_id:03X}#{bytes(message.data).hex()}" for message in messages]


VESC = [
    # node, frame, meaning and source, order to the motor
    (23, "00000117#0000C738", "51 A [1]", ("torque", 51.0 * K)),
    (124, "0000037C#00000BB8", "3000 eRPM [3]", ("velocity", 3000 * RPM / POLE_PAIRS, 0.0)),
    (1, "00000301#000003E8", "1000 eRPM [3]", ("velocity", 1000 * RPM / POLE_PAIRS, 0.0)),
    (
        104,
        "00000368#0000138800000000",
        "5000 eRPM, 8 bytes [3]",
        ("velocity", 5000 * RPM / POLE_PAIRS, 0.0),
    ),
    (104, "00000168#0000000000000000", "0 A, 8 bytes: stop [3]", ("released",)),
    (10, "0000000A#0000C350", "duty 0.5, scale 100000 [1]", ("voltage", 12.0)),
    (10, "0000000A#FFFF3CB0", "duty -0.5 [1]", ("voltage", -12.0)),
    (10, "00000A0A#000186A0", "SET_CURRENT_REL 1.0 [1]", ("torque", 60.0 * K)),
    (10, "0000020A#00000BB8", "brake with 3 A, turning forwards [1]", ("torque", -3.0 * K)),
    (10, "00000B0A#00002710", "brake with a tenth [1]", ("torque", -6.0 * K)),
    (10, "00000C0A#00000BB8", "handbrake with 3 A [1]", ("torque", -3.0 * K)),
]


@pytest.mark.parametrize(("node", "text", "meaning", "order"), VESC, ids=[v[2] for v in VESC])
def test_frames_to_a_vesc(node, text, meaning, order):
    motor = IdealMotor()
    drive = VescDrive(motor, node, VescSettings(pole_pairs=POLE_PAIRS, torque_constant=K))
    motor.velocity = 100.0
    assert hear(drive, text, extended=True) == []
    assert motor.order[0] == order[0]
    assert motor.order[1:] == pytest.approx(order[1:])
    motor.release()
    assert hear(drive, text.removeprefix("00000"), extended=False) == []
    assert motor.order == ("released",)


def test_status_frames_of_a_vesc_at_rest_are_those_of_a_real_one():
    """[2] 00000904 [8] 00 00 00 00 00 00 00 29 and 00001B04 [8] 00 00 00 0C 00 EF 00 00: 0 eRPM,
    0.0 A, duty 0.041; tachometer 12, 23.9 V, reserved."""
    motor = IdealMotor(supply=23.95)
    drive = VescDrive(
        motor, 4, VescSettings(pole_pairs=POLE_PAIRS, torque_constant=K, tachometer=12)
    )
    motor.voltage = 0.0411 * 23.95
    sent = shown(drive.advance(0.0))
    assert sent[:2] == ["904#0000000000000029", "1B04#0000000c00ef0000"]


ODRIVE = [
    # node, frames, meaning and source, order to the motor, heartbeat
    (
        0,
        ["007#08000000"],
        "closed loop, pack('<I', 8) [5]",
        ("velocity", 0.0, 0.0),
        "001#0000000008000000",
    ),
    (
        1,
        ["027#0800000000000000"],
        "closed loop, 8 bytes [3], heartbeat [4]",
        ("velocity", 0.0, 0.0),
        "021#0000000008000000",
    ),
    (0, [], "idle [4]", ("released",), "001#0000000001000000"),
    (
        0,
        ["007#08000000", "00D#0000803F00000000"],
        "pack('<ff', 1.0, 0.0): 1 turn/s [5]",
        ("velocity", math.tau, 0.0),
        "001#0000000008000000",
    ),
    (
        1,
        ["02B#0100000001000000", "027#0800000000000000", "02E#0000803E"],
        "torque control, passed through [3]; 0.25 N m",
        ("torque", 0.25),
        "021#0000000008000000",
    ),
    (
        0,
        ["007#08000000", "007#01000000"],
        "idle, pack('<I', 1) [5]",
        ("released",),
        "001#0000000001000000",
    ),
    (0, ["007#08000000", "002#"], "Estop", ("released",), "001#0000000201030000"),
    (
        0,
        ["007#08000000", "002#", "018#00"],
        "Clear_Errors, b'\\x00' [5]",
        ("released",),
        "001#0000000001030000",
    ),
    (
        0,
        ["007#0300000000000000"],
        "full calibration [5]: refused here",
        ("released",),
        "001#00000000010d0000",
    ),
]


@pytest.mark.parametrize(
    ("node", "texts", "meaning", "order", "heartbeat"), ODRIVE, ids=[o[2] for o in ODRIVE]
)
def test_frames_to_an_odrive(node, texts, meaning, order, heartbeat):
    motor = IdealMotor()
    drive = OdriveDrive(motor, node, OdriveSettings(torque_constant=K, encoder=0.0))
    for text in texts:
        assert hear(drive, text, extended=False) == []
    assert motor.order[0] == order[0]
    assert motor.order[1:] == pytest.approx(order[1:])
    assert shown(drive.advance(0.05)) == [heartbeat]


def test_encoder_estimates_are_read_as_the_vendors_example_reads_them():
    """[5] struct.unpack('<ff'): 1.5 turns, -0.25 turns/s; asked for by a remote frame."""
    motor = IdealMotor()
    drive = OdriveDrive(motor, 3, OdriveSettings(torque_constant=K))
    drive.advance(0.0)
    motor.position, motor.velocity = 1.5 * math.tau, -0.25 * math.tau
    assert shown(hear(drive, "069#R8", extended=False)) == ["069#0000c03f000080be"]
