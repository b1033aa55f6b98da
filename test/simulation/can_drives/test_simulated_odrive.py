import dataclasses
import math
import random
import struct

import can
import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.simulation.can_drives.motor import DriveFaults
from omniman_ros.simulation.can_drives.odrive.drive import OdriveDrive
from omniman_ros.simulation.can_drives.odrive.settings import OdriveSettings
from test.simulation.can_drives.ideal_motor import IdealMotor, play

NODE, K = 5, 0.05
HEARTBEAT, ESTOP, ERROR, AXIS_STATE, ENCODER, MODE = 0x01, 0x02, 0x03, 0x07, 0x09, 0x0B
INPUT_VELOCITY, INPUT_TORQUE, LIMITS = 0x0D, 0x0E, 0x0F
IQ, TEMPERATURE, REBOOT, BUS, CLEAR = 0x14, 0x15, 0x16, 0x17, 0x18
IDLE, CLOSED_LOOP = 1, 8
TORQUE_CONTROL, VELOCITY_CONTROL = 1, 2
SUCCESS, DISARMED, INVALID_STATE, NOT_CALIBRATED = 0, 3, 13, 14
BAD_CONFIG, DRV_FAULT, MISSING_INPUT, UNDER_VOLTAGE = 0x10, 0x20, 0x40, 0x200
VELOCITY_LIMIT, WATCHDOG, ESTOPPED, SPINOUT = 0x8000, 0x1000000, 0x2000000, 0x4000000


def frame(command, layout="", *numbers, node=NODE):
    data = struct.pack("<" + layout, *numbers)
    return can.Message(arbitration_id=node << 5 | command, is_extended_id=False, data=data)


def request(command, node=NODE, dlc=8):
    return can.Message(
        arbitration_id=node << 5 | command, is_extended_id=False, is_remote_frame=True, dlc=dlc
    )


SPEED = frame(INPUT_VELOCITY, "ff", 2.0, 0.0)


def setup(armed=False, **arguments):
    motor = IdealMotor(max_current=200.0)
    drive = OdriveDrive(motor, NODE, OdriveSettings(torque_constant=K, **arguments))
    drive.advance(0.0)
    if armed:
        drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 0.0)
        assert heartbeat(drive)[1] == CLOSED_LOOP
    return drive, motor


def heartbeat(drive):
    """Return the internal state that the next heartbeat will report."""
    return struct.unpack("<IBBBB", drive._heartbeat())[:3]


def sent_as(sent, command):
    number = NODE << 5 | command
    return [message for _, message in sent if message.arbitration_id == number]


def broken(drive, **faults):
    drive.faults = dataclasses.replace(drive.faults, **faults)


# --- frames against public documents ---


@pytest.fixture(scope="module")
def dbc():
    return pytest.importorskip("odrive_can.utils").get_dbc("odrive-cansimple-0.6.10")


def encode(dbc, name, **signals):
    layout = dbc.get_message_by_name(f"Axis{NODE}_{name}")
    return can.Message(
        arbitration_id=layout.frame_id, is_extended_id=False, data=layout.encode(signals)
    )


def decode(dbc, message):
    layout = dbc.get_message_by_frame_id(message.arbitration_id)
    return layout.name.split("_", 1)[1], layout.decode(bytes(message.data))


def test_vendors_dbc_commands_the_drive(dbc):
    drive, motor = setup()

    def send(name, **signals):
        assert drive.receive(encode(dbc, name, **signals), 0.01) == []

    send("Set_Controller_Mode", Control_Mode="VELOCITY_CONTROL", Input_Mode="PASSTHROUGH")
    send("Set_Limits", Velocity_Limit=10.0, Current_Limit=4.0)
    send("Set_Axis_State", Axis_Requested_State="CLOSED_LOOP_CONTROL")
    send("Set_Input_Vel", Input_Vel=-2.5, Input_Torque_FF=0.125)
    assert motor.order == ("velocity", pytest.approx(-2.5 * math.tau), 0.125)
    send("Set_Input_Vel", Input_Vel=12.0, Input_Torque_FF=1.0)
    assert motor.order == ("velocity", pytest.approx(10.0 * math.tau), pytest.approx(4.0 * K))
    send("Set_Controller_Mode", Control_Mode="TORQUE_CONTROL", Input_Mode="PASSTHROUGH")
    send("Set_Input_Torque", Input_Torque=-0.0625)
    assert motor.order == ("torque", -0.0625)
    send("Estop")
    assert motor.order == ("released",)
    assert heartbeat(drive) == (ESTOPPED, IDLE, DISARMED)
    send("Clear_Errors", Identify=0)
    assert heartbeat(drive)[0] == 0


def test_vendors_dbc_reads_the_reports(dbc):
    drive, motor = setup(armed=True, iq=0.02, bus=0.05, position=7.0)
    motor.position, motor.velocity = -12.0, 3.0
    motor.current, motor.voltage, motor.supply = -1.5, -6.0, 24.5
    drive.receive(frame(ESTOP), 0.05)
    messages = drive.advance(0.1)
    for command in (ERROR, TEMPERATURE, 0x00):
        messages += drive.receive(request(command), 0.1)
    read = dict(decode(dbc, message) for message in messages)
    assert len(read) == 7
    assert read["Heartbeat"] == {
        "Axis_Error": "ESTOP_REQUESTED",
        "Axis_State": "IDLE",
        "Procedure_Result": "DISARMED",
        "Trajectory_Done_Flag": 0,
    }
    assert read["Get_Encoder_Estimates"] == {
        "Pos_Estimate": pytest.approx(7.0 - 12.0 / math.tau),
        "Vel_Estimate": pytest.approx(3.0 / math.tau),
    }
    assert read["Get_Iq"] == {"Iq_Setpoint": -1.5, "Iq_Measured": -1.5}
    assert read["Get_Bus_Voltage_Current"] == {
        "Bus_Voltage": 24.5,
        "Bus_Current": pytest.approx(9.0 / 24.5),
    }
    assert read["Get_Error"] == {
        "Active_Errors": "ESTOP_REQUESTED",
        "Disarm_Reason": "ESTOP_REQUESTED",
    }
    assert read["Get_Temperature"] == {"FET_Temperature": 25.0, "Motor_Temperature": 25.0}
    assert (read["Get_Version"]["Protocol_Version"], read["Get_Version"]["Fw_Version_Minor"]) == (
        2,
        6,
    )


@pytest.mark.parametrize(
    ("bit", "name"),
    [
        (BAD_CONFIG, "BAD_CONFIG"),
        (DRV_FAULT, "DRV_FAULT"),
        (MISSING_INPUT, "MISSING_INPUT"),
        (UNDER_VOLTAGE, "DC_BUS_UNDER_VOLTAGE"),
        (VELOCITY_LIMIT, "VELOCITY_LIMIT_VIOLATION"),
        (WATCHDOG, "WATCHDOG_TIMER_EXPIRED"),
        (ESTOPPED, "ESTOP_REQUESTED"),
        (SPINOUT, "SPINOUT_DETECTED"),
    ],
)
def test_error_bits_of_these_tests_are_the_vendors(dbc, bit, name):
    layout = dbc.get_message_by_name("Axis0_Get_Error")
    data = struct.pack("<II", bit, bit)
    assert layout.decode(data) == {"Active_Errors": name, "Disarm_Reason": name}


# --- requests and identifiers ---


@pytest.mark.parametrize("command", [0x00, ERROR, ENCODER, IQ, TEMPERATURE, BUS])
@pytest.mark.parametrize("how", [request, frame])
def test_requests_are_remote_or_empty_frames(command, how):
    drive, _ = setup()
    (answer,) = drive.receive(how(command), 0.01)
    assert answer.arbitration_id == NODE << 5 | command
    assert (answer.dlc, answer.is_remote_frame, answer.is_extended_id) == (8, False, False)


@pytest.mark.parametrize("command", set(range(32)) - {0x00, ERROR, ENCODER, IQ, TEMPERATURE, BUS})
def test_other_frames_are_not_answered(command):
    drive, _ = setup()
    assert drive.receive(request(command), 0.01) == []
    assert drive.receive(frame(command), 0.01) == []


@pytest.mark.parametrize(
    "message",
    [
        frame(INPUT_VELOCITY, "ff", 1.0, 0.0, node=NODE + 1),
        can.Message(arbitration_id=NODE << 5 | 0xD, is_extended_id=True, data=SPEED.data),
        can.Message(arbitration_id=1 << 11 | NODE << 5 | 0xD, data=SPEED.data),
        can.Message(
            arbitration_id=NODE << 5 | 0xD, is_extended_id=False, is_fd=True, data=SPEED.data
        ),
        can.Message(
            arbitration_id=NODE << 5 | 0xD,
            is_extended_id=False,
            is_error_frame=True,
            data=SPEED.data,
        ),
        frame(HEARTBEAT, "Q", 0),  # its own frame, received as an echo
        frame(ENCODER, "ff", 0.0, 0.0),
        frame(BUS, "ff", 0.0, 0.0),
    ],
)
def test_frames_for_other_nodes_neither_act_nor_feed_the_watchdog(message):
    drive, motor = setup(armed=True)
    assert motor.order == ("velocity", 0.0, 0.0)
    assert drive.receive(message, 0.05) == []
    assert motor.order == ("velocity", 0.0, 0.0)
    play(drive, motor, 0.05, 0.102, heard=message)
    assert heartbeat(drive) == (WATCHDOG, IDLE, DISARMED)


@pytest.mark.parametrize(
    ("command", "layout", "numbers", "needed"),
    [
        (AXIS_STATE, "I", (CLOSED_LOOP,), 4),
        (MODE, "II", (TORQUE_CONTROL, 1), 8),
        (INPUT_VELOCITY, "ff", (1.0, 0.5), 8),
        (INPUT_TORQUE, "f", (0.5,), 4),
        (LIMITS, "ff", (5.0, 6.0), 8),
    ],
)
def test_frames_that_are_too_short_are_ignored_longer_ones_not(command, layout, numbers, needed):
    data = struct.pack("<" + layout, *numbers).ljust(8, b"\0")
    for size in range(1, 9):
        drive, _ = setup()
        before = inside(drive)
        message = can.Message(
            arbitration_id=NODE << 5 | command, is_extended_id=False, data=data[:size]
        )
        drive.receive(message, 0.01)
        assert (inside(drive) != before) == (size >= needed)


def inside(drive):
    return (
        drive.axis.state,
        drive.axis.control,
        drive.axis.velocity,
        drive.axis.torque,
        drive.axis.velocity_limit,
        drive.axis.current_limit,
    )


# --- states, modes, errors ---


def test_axis_is_idle_and_free_until_armed():
    drive, motor = setup()
    drive.receive(SPEED, 0.01)
    play(drive, motor, 0.01, 0.05)
    assert motor.order == ("released",)
    drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 0.05)
    # a stale input moves the motor when it is armed: as firmware 0.5
    assert motor.order == ("velocity", pytest.approx(2.0 * math.tau), 0.0)
    drive.receive(frame(AXIS_STATE, "I", IDLE), 0.06)
    assert motor.order == ("released",)
    assert heartbeat(drive) == (0, IDLE, SUCCESS)


@pytest.mark.parametrize("state", [0, 2, 3, 4, 5, 6, 7, 9, 11, 2**32 - 1])
@pytest.mark.parametrize("armed", [False, True])
def test_other_states_are_refused(state, armed):
    drive, _ = setup(armed=armed)
    drive.receive(frame(AXIS_STATE, "I", state), 0.01)
    assert heartbeat(drive) == (0, CLOSED_LOOP if armed else IDLE, INVALID_STATE)
    drive.receive(frame(AXIS_STATE, "I", IDLE), 0.02)
    assert heartbeat(drive) == (0, IDLE, SUCCESS)


@pytest.mark.parametrize(
    "modes", [(0, 1), (3, 1), (2, 0), (2, 5), (2, 6), (1, 2), (1, 3), (7, 7), (2**32 - 1, 1)]
)
def test_modes_that_are_not_modelled_disarm(modes):
    drive, motor = setup(armed=True)
    drive.receive(SPEED, 0.01)
    drive.receive(frame(MODE, "II", *modes), 0.02)
    assert heartbeat(drive) == (BAD_CONFIG, IDLE, DISARMED)
    assert motor.order == ("released",)
    drive.receive(frame(CLEAR), 0.03)
    drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 0.04)
    assert heartbeat(drive) == (BAD_CONFIG, IDLE, DISARMED)
    drive.receive(frame(CLEAR), 0.05)
    drive.receive(frame(MODE, "II", VELOCITY_CONTROL, 1), 0.06)
    drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 0.07)
    assert heartbeat(drive) == (0, CLOSED_LOOP, SUCCESS)


@pytest.mark.parametrize("error", ["estop", "fault", "watchdog"])
def test_errors_stay_until_they_are_cleared_and_forbid_arming(error):
    drive, motor = setup(armed=True)
    drive.receive(SPEED, 0.0)
    if error == "estop":
        drive.receive(frame(ESTOP), 0.01)
    elif error == "fault":
        broken(drive, fault=True)
        drive.advance(0.01)
        broken(drive, fault=False)
    else:
        drive.advance(0.2)
    bit = {"estop": ESTOPPED, "fault": DRV_FAULT, "watchdog": WATCHDOG}[error]
    play(drive, motor, 0.2, 0.3, heard=SPEED)
    drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 0.31)
    assert heartbeat(drive) == (bit, IDLE, DISARMED)
    (answer,) = drive.receive(request(ERROR), 0.32)
    assert struct.unpack("<II", answer.data) == (bit, bit)
    drive.receive(frame(CLEAR, "B", 0), 0.33)
    assert heartbeat(drive)[:2] == (0, IDLE)
    assert motor.order == ("released",), "clearing alone moves nothing"
    drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 0.34)
    assert heartbeat(drive) == (0, CLOSED_LOOP, SUCCESS)


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_input_that_is_not_finite_disarms(number):
    for message in (
        frame(INPUT_VELOCITY, "ff", number, 0.0),
        frame(INPUT_VELOCITY, "ff", 0.0, number),
        frame(INPUT_TORQUE, "f", number),
    ):
        drive, motor = setup(armed=True)
        drive.receive(message, 0.01)
        assert heartbeat(drive) == (MISSING_INPUT, IDLE, DISARMED)
        assert motor.order == ("released",)


@pytest.mark.parametrize("limits", [(math.nan, 1.0), (1.0, math.inf), (-1.0, 1.0), (1.0, -1.0)])
def test_impossible_limits_are_ignored(limits):
    drive, _ = setup()
    before = inside(drive)
    drive.receive(frame(LIMITS, "ff", *limits), 0.01)
    assert inside(drive) == before


def test_overspeed_disarms_at_a_fifth_over_the_limit():
    drive, motor = setup(armed=True, watchdog=0.0)
    drive.receive(frame(LIMITS, "ff", 10.0, 5.0), 0.0)
    for velocity, error in ((-11.9, 0), (12.1, VELOCITY_LIMIT)):
        motor.velocity = velocity * math.tau
        drive.advance(0.01)
        assert heartbeat(drive)[0] == error
    assert motor.order == ("released",)


def test_ramped_input_starts_at_the_measured_velocity():
    drive, motor = setup(watchdog=0.0, velocity_ramp=4.0)
    motor.velocity = -1.0 * math.tau
    drive.receive(frame(MODE, "II", VELOCITY_CONTROL, 2), 0.0)
    drive.receive(SPEED, 0.0)
    drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 1.0)
    assert motor.order[1] == pytest.approx(-1.0 * math.tau)
    drive.advance(1.25)
    assert motor.order[1] == pytest.approx(0.0)
    drive.advance(9.0)
    assert motor.order[1] == pytest.approx(2.0 * math.tau)


def test_going_over_to_a_ramp_starts_at_the_measured_velocity():
    drive, motor = setup(armed=True, watchdog=0.0, velocity_ramp=4.0)
    drive.receive(SPEED, 0.0)
    motor.velocity = 1.0 * math.tau
    drive.receive(frame(MODE, "II", VELOCITY_CONTROL, 2), 5.0)
    assert motor.order[1] == pytest.approx(1.0 * math.tau)


def test_error_of_an_idle_axis_forbids_arming():
    drive, motor = setup()
    drive.receive(frame(ESTOP), 0.0)
    assert heartbeat(drive) == (ESTOPPED, IDLE, SUCCESS)
    drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 0.01)
    assert heartbeat(drive) == (ESTOPPED, IDLE, DISARMED)
    assert motor.order == ("released",)


def test_torque_follows_its_ramp():
    drive, motor = setup(watchdog=0.0, torque_ramp=0.5)
    drive.receive(frame(MODE, "II", TORQUE_CONTROL, 6), 0.0)
    drive.receive(frame(INPUT_TORQUE, "f", -0.25), 0.0)
    drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 1.0)
    drive.advance(1.25)
    assert motor.order == ("torque", pytest.approx(-0.125))
    drive.advance(2.0)
    assert motor.order == ("torque", pytest.approx(-0.25))


# --- watchdog ---


@pytest.mark.parametrize("watchdog", [0.1, 0.03])
def test_watchdog_disarms_the_axis_and_the_motor_coasts(watchdog):
    drive, motor = setup(armed=True, watchdog=watchdog)
    play(drive, motor, 0.0, 0.5, heard=SPEED)
    play(drive, motor, 0.5, 0.5 + watchdog - 0.001)
    assert heartbeat(drive) == (0, CLOSED_LOOP, SUCCESS)
    play(drive, motor, 0.5 + watchdog - 0.001, 0.5 + watchdog + 0.002)
    assert heartbeat(drive) == (WATCHDOG, IDLE, DISARMED)
    assert motor.order == ("released",)
    assert motor.velocity == pytest.approx(2.0 * math.tau), "nothing brakes it"
    play(drive, motor, 0.7, 1.0, heard=SPEED)
    assert motor.order == ("released",), "commands do not bring it back"


@pytest.mark.parametrize(
    "message",
    [
        SPEED,
        frame(INPUT_TORQUE, "f", 0.0),
        frame(LIMITS, "ff", 10.0, 10.0),
        request(BUS),
        request(HEARTBEAT),
        request(INPUT_VELOCITY),
        frame(CLEAR),
        frame(0x1F),
        frame(0x1A, "f", 1.0),
        frame(INPUT_VELOCITY, "f", 1.0),  # short
    ],
)
def test_any_frame_to_the_axis_feeds_the_watchdog(message):
    drive, motor = setup(armed=True)
    for k in range(1, 10):
        drive.receive(message, k * 0.09)
        play(drive, motor, k * 0.09, (k + 1) * 0.09)
    assert heartbeat(drive)[:2] == (0, CLOSED_LOOP)


def test_idle_axis_has_no_watchdog_unless_it_is_reported_so():
    drive, _ = setup()
    drive.advance(100.0)
    assert heartbeat(drive)[0] == 0
    drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 100.0)
    drive.advance(100.05)
    assert heartbeat(drive) == (0, CLOSED_LOOP, SUCCESS)
    drive, _ = setup(watchdog_when_idle=True)
    drive.advance(0.2)
    assert heartbeat(drive) == (WATCHDOG, IDLE, SUCCESS)
    drive.receive(frame(CLEAR), 0.3)
    drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 0.31)
    assert heartbeat(drive) == (0, CLOSED_LOOP, SUCCESS)


def test_axis_without_watchdog_runs_indefinitely():
    drive, motor = setup(armed=True, watchdog=0.0)
    drive.receive(SPEED, 0.0)
    drive.advance(1000.0)
    assert motor.order[0] == "velocity"


def test_mechanical_brake_holds_an_idle_axis():
    drive, motor = setup(brake_deceleration=40.0)
    assert motor.order == ("halt", 40.0)
    drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 0.0)
    play(drive, motor, 0.0, 0.2, heard=SPEED)
    assert motor.velocity == pytest.approx(2.0 * math.tau)
    play(drive, motor, 0.2, 0.3 + 2.0 * math.tau / 40.0 + 0.002)
    assert (motor.order, motor.velocity) == (("halt", 40.0), 0.0)


# --- reports ---


def test_reports_come_at_their_periods():
    drive, motor = setup(heartbeat=0.02, encoder=0.005, iq=0.05, bus=0.1)
    sent = play(drive, motor, 0.0, 1.0)
    counts = [len(sent_as(sent, command)) for command in (HEARTBEAT, ENCODER, IQ, BUS)]
    assert counts == [50, 200, 20, 10]
    assert len(sent) == 280


def test_defaults_are_the_vendors():
    """Docs, can-protocol.rst, Cyclic Messages: heartbeat 100 ms, encoder 10 ms, others never."""
    drive, motor = setup()
    sent = play(drive, motor, 0.0, 1.0)
    assert (len(sent_as(sent, HEARTBEAT)), len(sent_as(sent, ENCODER)), len(sent)) == (
        10,
        100,
        110,
    )


def test_grid_begins_with_the_first_call():
    drive = OdriveDrive(
        IdealMotor(), NODE, OdriveSettings(torque_constant=K, watchdog_when_idle=True)
    )
    assert len(drive.advance(1000.0033)) == 2
    assert drive.advance(1000.0132) == []
    assert len(drive.advance(1000.0134)) == 1
    drive.advance(1000.1032)
    assert heartbeat(drive)[0] == 0
    drive.advance(1000.1034)
    assert heartbeat(drive)[0] == WATCHDOG


# --- faults ---


def test_silent_drive_sends_nothing_and_still_receives():
    drive, motor = setup(armed=True)
    broken(drive, silent=True)
    assert play(drive, motor, 0.0, 0.5, heard=SPEED) == []
    assert drive.receive(request(BUS), 0.5) == []
    assert motor.order[0] == "velocity"


def test_deaf_drive_is_disarmed_by_its_watchdog():
    drive, motor = setup(armed=True)
    broken(drive, deaf=True)
    assert drive.receive(request(BUS), 0.01) == []
    play(drive, motor, 0.0, 0.102, heard=SPEED)
    assert heartbeat(drive)[0] == WATCHDOG


def test_frozen_reports_leave_the_heartbeat_and_the_bus():
    drive, motor = setup(bus=0.1)
    broken(drive, frozen_reports=True)
    sent = play(drive, motor, 0.0, 1.0)
    assert (len(sent_as(sent, HEARTBEAT)), len(sent_as(sent, BUS)), len(sent)) == (10, 10, 20)
    assert drive.receive(request(ENCODER), 1.0) == []


def test_no_heartbeat_leaves_the_reports():
    drive, motor = setup()
    broken(drive, no_heartbeat=True)
    sent = play(drive, motor, 0.0, 1.0)
    assert len(sent_as(sent, ENCODER)) == len(sent) == 100


def test_frozen_encoder_goes_on_reporting_the_same():
    drive, motor = setup(armed=True)
    play(drive, motor, 0.0, 0.1, heard=SPEED)
    broken(drive, frozen_encoder=True)
    sent = sent_as(play(drive, motor, 0.1, 0.5, heard=SPEED), ENCODER)
    assert len(sent) == 40
    assert len({bytes(message.data) for message in sent}) == 1
    broken(drive, frozen_encoder=False)
    (message,) = sent_as(play(drive, motor, 0.5, 0.51, heard=SPEED), ENCODER)
    assert struct.unpack("<ff", message.data)[0] == pytest.approx(motor.position / math.tau)


def test_fault_disarms_and_cannot_be_cleared_while_it_lasts():
    drive, motor = setup(armed=True)
    drive.receive(SPEED, 0.0)
    broken(drive, fault=True)
    play(drive, motor, 0.0, 0.002)
    assert heartbeat(drive) == (DRV_FAULT, IDLE, DISARMED)
    assert motor.order == ("released",)
    drive.receive(frame(CLEAR), 0.01)
    drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 0.02)
    assert heartbeat(drive) == (DRV_FAULT, IDLE, DISARMED)


def test_encoder_that_misleads_disarms():
    drive, motor = setup(armed=True)
    motor.lost = True
    drive.advance(0.001)
    assert heartbeat(drive) == (SPINOUT, IDLE, DISARMED)
    assert motor.order == ("released",)


def test_refused_enabling_is_not_calibrated():
    drive, motor = setup()
    broken(drive, refuse_enable=True)
    drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 0.01)
    assert heartbeat(drive) == (0, IDLE, NOT_CALIBRATED)
    drive.receive(SPEED, 0.02)
    assert motor.order == ("released",)


def test_stuck_status_does_not_change():
    drive, motor = setup(armed=True)
    broken(drive, stuck_status=True)
    drive.receive(frame(ESTOP), 0.01)
    assert motor.order == ("released",)
    sent = sent_as(play(drive, motor, 0.0, 0.5), HEARTBEAT)
    assert {bytes(message.data)[:6] for message in sent} == {struct.pack("<IBB", 0, 8, 0)}
    broken(drive, stuck_status=False)
    sent = sent_as(play(drive, motor, 0.5, 0.6), HEARTBEAT)
    assert struct.unpack("<IBB", sent[0].data[:6]) == (ESTOPPED, IDLE, DISARMED)


def test_short_reports_lack_a_byte_the_heartbeat_does_not():
    drive, motor = setup()
    broken(drive, short_reports=True)
    sent = play(drive, motor, 0.0, 0.2)
    assert {message.dlc for message in sent_as(sent, ENCODER)} == {7}
    assert {message.dlc for message in sent_as(sent, HEARTBEAT)} == {8}
    assert drive.receive(request(BUS), 0.2)[0].dlc == 7


def test_low_supply_disarms_and_is_reported():
    drive, motor = setup(armed=True, bus=0.01)
    broken(drive, supply=10.5)
    play(drive, motor, 0.0, 0.05, heard=SPEED)
    assert heartbeat(drive)[1] == CLOSED_LOOP
    broken(drive, supply=9.5)
    sent = play(drive, motor, 0.05, 0.07, heard=SPEED)
    assert heartbeat(drive) == (UNDER_VOLTAGE, IDLE, DISARMED)
    assert struct.unpack("<ff", sent_as(sent, BUS)[-1].data)[0] == 9.5
    drive.receive(frame(CLEAR), 0.08)
    assert heartbeat(drive)[0] == UNDER_VOLTAGE
    broken(drive, supply=0.0)
    drive.receive(frame(CLEAR), 0.09)
    assert heartbeat(drive)[0] == 0


def test_restarting_drive_neither_sends_nor_receives_and_loses_its_state():
    drive, motor = setup(armed=True, boot_time=0.4, position=3.0)
    play(drive, motor, 0.0, 0.1, heard=SPEED)
    broken(drive, reboots=1)
    assert play(drive, motor, 0.1, 0.499, heard=SPEED) == []
    assert motor.order == ("released",)
    motor.velocity = 0.0
    sent = play(drive, motor, 0.499, 0.501)
    (estimate,) = sent_as(sent, ENCODER)
    assert abs(struct.unpack("<ff", estimate.data)[0]) < 1.0
    assert struct.unpack("<IBB", sent_as(sent, HEARTBEAT)[0].data[:6]) == (0, IDLE, SUCCESS)
    drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 0.51)
    assert motor.order == ("velocity", 0.0, 0.0), "inputs are forgotten"


def test_host_restarts_an_idle_axis_only():
    drive, motor = setup(armed=True, position=3.0)
    drive.receive(frame(REBOOT, "B", 0), 0.01)
    assert heartbeat(drive)[1] == CLOSED_LOOP
    drive.receive(frame(AXIS_STATE, "I", IDLE), 0.02)
    drive.receive(frame(REBOOT, "B", 1), 0.03)  # save_configuration: not modelled
    assert len(play(drive, motor, 0.03, 0.13)) > 0
    drive.receive(frame(REBOOT, "B", 0), 0.13)
    assert play(drive, motor, 0.13, 1.12) == []
    (estimate, *_) = sent_as(play(drive, motor, 1.12, 1.14), ENCODER)
    assert struct.unpack("<ff", estimate.data) == (0.0, 0.0)


@pytest.mark.parametrize(
    "fault", ["wrong_mode", "configuration_refused", "configuration_unanswered"]
)
def test_faults_without_a_cansimple_equivalent_have_no_effect(fault):
    logs = []
    for faults in (DriveFaults(), DriveFaults(**{fault: True})):
        drive, motor = setup()
        drive.faults = faults
        drive.receive(frame(MODE, "II", VELOCITY_CONTROL, 1), 0.0)
        drive.receive(frame(AXIS_STATE, "I", CLOSED_LOOP), 0.0)
        sent = play(drive, motor, 0.0, 0.3, heard=SPEED) + play(
            drive, motor, 0.3, 0.4, heard=request(ERROR)
        )
        logs.append(([(t, bytes(m.data)) for t, m in sent], motor.order))
    assert logs[0] == logs[1]


# --- robustness ---


def test_20000_random_frames_do_no_harm():
    """IdealMotor refuses what is not finite."""
    chance = random.Random(3)
    drive, motor = setup(iq=0.01, bus=0.01, boot_time=0.05)
    now = 0.0
    moved, errors = set(), 0
    for _ in range(20_000):
        now += chance.choice((0.0, 0.0, 0.001, 0.02))
        command = chance.choice((CLEAR, AXIS_STATE, MODE, chance.randrange(32)))
        number = chance.choice((NODE << 5 | command, NODE << 5 | command, chance.randrange(2**11)))
        remote = chance.random() < 0.05
        plain = struct.pack("<II", chance.randrange(12), chance.randrange(8))
        data = chance.choice((plain, chance.randbytes(chance.randrange(9))))
        message = can.Message(
            arbitration_id=number,
            is_extended_id=chance.random() < 0.05,
            is_remote_frame=remote,
            is_error_frame=chance.random() < 0.02,
            dlc=len(data) if remote else None,
            data=None if remote else data,
        )
        for answer in drive.receive(message, now) + drive.advance(now):
            assert not answer.is_extended_id
            assert answer.dlc == 8
        moved.add(motor.order[0])
        errors |= heartbeat(drive)[0]
        motor.velocity = min(max(motor.velocity, -1e4), 1e4)
        motor.step(0.001)
    assert moved == {"velocity", "torque", "released"}
    assert errors & BAD_CONFIG
    assert errors & ESTOPPED
    assert errors & VELOCITY_LIMIT


@pytest.mark.parametrize(
    "wrong",
    [
        {"node": 64},
        {"node": -1},
        {"torque_constant": 0.0},
        {"heartbeat": -0.1},
        {"encoder": math.nan},
        {"watchdog": math.inf},
        {"position": math.nan},
        {"brake_deceleration": -1.0},
    ],
)
def test_invalid_numbers_are_refused_by_name(wrong):
    arguments = {"node": 1, "torque_constant": K, **wrong}
    with pytest.raises(ParameterError, match=f"'{next(iter(wrong))}'"):
        OdriveDrive(IdealMotor(), arguments.pop("node"), OdriveSettings(**arguments))
