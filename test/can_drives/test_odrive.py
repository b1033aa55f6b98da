import functools
import math
import struct
from dataclasses import fields

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omniman_ros.can_drives import odrive
from omniman_ros.can_drives.axis import REST, AxisState, Demand, DriveSetpoint, Receipt
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.can_drives.odrive import OdriveAxis, error_text
from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.core.errors import ParameterError
from test.can_drives.fuzz import COUNT, endure, frames
from test.can_drives.fuzz import settings as axis_settings

NODE = 5
DT = 0.005
PATIENCE = 3 * 0.03 + DT
FAST = DriveSetpoint(DriveMode.VELOCITY, 30.0)
IDLE, CLOSED_LOOP = 1, 8
examples = settings(deadline=None, derandomize=True, max_examples=300)


def id_of(command):
    return NODE << 5 | command


ZERO = CanFrame(id_of(0x0D), bytes(8))
ASK_IDLE = CanFrame(id_of(0x07), bytes([IDLE, 0, 0, 0, 0, 0, 0, 0]))
ASK_CLOSED_LOOP = CanFrame(id_of(0x07), bytes([CLOSED_LOOP, 0, 0, 0, 0, 0, 0, 0]))
VELOCITY_MODE = CanFrame(id_of(0x0B), bytes([2, 0, 0, 0, 1, 0, 0, 0]))
TORQUE_MODE = CanFrame(id_of(0x0B), bytes([1, 0, 0, 0, 1, 0, 0, 0]))
CLEAR = CanFrame(id_of(0x18), bytes(8))


def heartbeat(state=IDLE, error=0):
    return CanFrame(id_of(0x01), struct.pack("<IBxxx", error, state))


def encoder(position=0.0, speed=0.0):
    return CanFrame(id_of(0x09), struct.pack("<ff", position, speed))


def tick(axis, demand, setpoint=REST, now=0.0):
    """Frames of a tick, without requests for current and supply."""
    return [frame for frame in axis.tick(demand, setpoint, now) if not frame.remote]


def in_state(state, now=0.0, position=0.0, **changes):
    """An axis brought to a state at a time; the last request was sent and shown just before."""
    axis = OdriveAxis(axis_settings(**changes))
    if state is AxisState.OFFLINE:
        return axis
    axis.configure(now - 2e-6)
    tick(axis, Demand.IDLE, now=now - 2e-6)
    axis.receive(encoder(position), now - 1e-6)
    if state is AxisState.CONFIGURING:
        return axis
    axis.receive(heartbeat(), now - 1e-6)
    assert axis.state is AxisState.READY
    if state is AxisState.ENABLED:
        tick(axis, Demand.DRIVE, now=now - 5e-7)
        axis.receive(heartbeat(CLOSED_LOOP), now)
    elif state is AxisState.FAULT:
        axis.receive(heartbeat(error=0x200), now)
    assert axis.state is state
    return axis


def moves(frame):
    """Whether a frame asks for motion; going to closed loop does not."""
    if frame.remote or frame.id in (id_of(0x0B), id_of(0x0F), id_of(0x18)):
        return False
    if frame.id == id_of(0x07):
        return frame not in (ASK_IDLE, ASK_CLOSED_LOOP)
    return frame.id not in (id_of(0x0D), id_of(0x0E)) or any(frame.data)


# ---- frames, against the data base of another project -------------------------------------------


@functools.cache
def database(version):
    name = f"odrive-cansimple-{version}"
    return pytest.importorskip("odrive_can", reason="odrive-can is not installed").get_dbc(name)


def decoded(frame, version):
    """Name of a frame's message without its axis, and its signals as numbers."""
    message = database(version).get_message_by_frame_id(frame.id)
    assert message.length <= len(frame.data) == 8
    axis, name = message.name.split("_", 1)
    assert axis == f"Axis{NODE}"
    return name, message.decode(frame.data, decode_choices=False)


def encoded(name, version, **signals):
    message = database(version).get_message_by_name(f"Axis{NODE}_{name}")
    values = {signal.name: 0 for signal in message.signals} | signals
    return CanFrame(message.frame_id, message.encode(values))


@pytest.mark.parametrize("version", ["0.5.6", "0.6.10"])
def test_configuration_decodes_in_the_published_data_base(version):
    axis = OdriveAxis(axis_settings(max_speed=8 * math.pi, max_torque=0.4))
    axis.configure(0.0)
    assert [decoded(frame, version) for frame in tick(axis, Demand.IDLE)] == [
        ("Set_Input_Vel", {"Input_Vel": 0.0, "Input_Torque_FF": 0.0}),
        ("Set_Axis_State", {"Axis_Requested_State": 1}),
        ("Set_Controller_Mode", {"Control_Mode": 2, "Input_Mode": 1}),
        ("Set_Limits", {"Velocity_Limit": 4.0, "Current_Limit": 8.0}),
    ]


@examples
@given(st.floats(-500, 500), st.floats(-2, 2), st.sampled_from(["0.5.6", "0.6.10"]))
def test_velocities_decode_in_the_published_data_base(speed, torque, version):
    axis = in_state(AxisState.ENABLED, feed_forward=True)
    (frame,) = tick(axis, Demand.DRIVE, DriveSetpoint(DriveMode.VELOCITY, speed, torque))
    name, signals = decoded(frame, version)
    assert name == "Set_Input_Vel"
    assert signals["Input_Vel"] * math.tau == pytest.approx(speed, rel=1e-6, abs=1e-30)
    assert signals["Input_Torque_FF"] == pytest.approx(torque, rel=1e-6, abs=1e-30)


@examples
@given(st.floats(-2, 2), st.sampled_from(["0.5.6", "0.6.10"]))
def test_torques_decode_in_the_published_data_base(torque, version):
    axis = in_state(AxisState.ENABLED)
    frame = tick(axis, Demand.DRIVE, DriveSetpoint(DriveMode.TORQUE, torque))[-1]
    name, signals = decoded(frame, version)
    assert name == "Set_Input_Torque"
    assert signals["Input_Torque"] == pytest.approx(torque, rel=1e-6, abs=1e-30)


@examples
@given(
    st.floats(-4000, 4000, width=32),
    st.floats(-100, 100, width=32),
    st.floats(-50, 50, width=32),
    st.floats(0, 60, width=32),
    st.sampled_from(["0.5.6", "0.6.10"]),
)
def test_reports_of_the_published_data_base_are_read(position, speed, current, volts, version):
    axis = OdriveAxis(axis_settings())
    for frame in (
        encoded("Get_Encoder_Estimates", version, Pos_Estimate=position, Vel_Estimate=speed),
        encoded("Get_Iq", version, Iq_Setpoint=-1.0, Iq_Measured=current),
        encoded("Get_Bus_Voltage_Current", version, Bus_Voltage=volts, Bus_Current=-1.0),
    ):
        assert axis.receive(frame, 2.0) is Receipt.ACCEPTED
    feedback = axis.feedback
    assert feedback.position == pytest.approx(position * math.tau)
    assert feedback.velocity == pytest.approx(speed * math.tau)
    assert (feedback.current, feedback.bus_voltage) == (current, volts)
    assert feedback.torque == pytest.approx(0.05 * current)
    assert (feedback.at, feedback.count) == (2.0, 1)
    assert math.isnan(feedback.voltage)


@pytest.mark.parametrize(
    "version, table, skip",
    [
        ("0.6.10", odrive.ERRORS, ()),
        ("0.5.6", odrive.ERRORS_05, ()),
    ],
)
def test_error_names_are_those_of_the_published_data_base(version, table, skip):
    message = database(version).get_message_by_name("Axis0_Heartbeat")
    choices = message.get_signal_by_name("Axis_Error").choices
    named = {value: str(name) for value, name in choices.items() if value}
    assert {1 << bit: name for bit, name in table.items()} == named


def test_published_heartbeat_is_read():
    # odrive-can's documentation, "Odrive cansimple interface": error INVALID_STATE, state HOMING.
    axis = in_state(AxisState.READY)
    axis.receive(CanFrame(id_of(0x01), b"\x01\x00\x00\x00\x0b\x00\x00\x00"), DT)
    assert axis.state is AxisState.FAULT
    assert "INVALID_STATE" in axis.fault_reason


def test_ids_are_node_and_command():
    # docs.odriverobotics.com, "CAN Protocol": 0x01 << 5 | 0x0C = 0x2C.
    axis = OdriveAxis(axis_settings(node=1))
    assert (0x2C, False) in axis.command_ids
    assert axis.tick(Demand.IDLE, REST, 0.0)[0].id == 0x2D


# ---- states -------------------------------------------------------------------------------------


def test_axis_is_ready_when_idle_and_encoder_are_reported_after_configuration():
    axis = OdriveAxis(axis_settings())
    axis.configure(0.0)
    axis.receive(encoder(), 0.001)
    axis.receive(heartbeat(), 0.001)
    assert axis.state is AxisState.CONFIGURING  # nothing was sent yet
    tick(axis, Demand.IDLE, now=0.002)
    axis.receive(heartbeat(CLOSED_LOOP), 0.003)
    assert axis.state is AxisState.CONFIGURING
    axis.receive(heartbeat(), 0.004)
    assert axis.state is AxisState.READY


def test_axis_is_not_ready_without_an_encoder_report():
    axis = OdriveAxis(axis_settings())
    axis.receive(encoder(), 0.0)
    axis.configure(1.0)
    tick(axis, Demand.IDLE, now=1.0)
    axis.receive(heartbeat(), 1.1)
    assert axis.state is AxisState.CONFIGURING


def test_configuration_is_repeated_while_the_heartbeat_does_not_show_idle():
    axis = OdriveAxis(axis_settings())
    axis.configure(0.0)
    sent = [len(tick(axis, Demand.IDLE, now=k * DT)) for k in range(40)]
    assert sent == [4, *[1] * 18, 4, *[1] * 18, 4, 1]


def test_no_configuration_requests_closed_loop_or_motion():
    axis = in_state(AxisState.ENABLED)
    axis.configure(0.0)
    for k in range(100):
        sent = tick(axis, Demand.DRIVE, FAST, k * DT)
        axis.receive(heartbeat(CLOSED_LOOP), k * DT)
        assert ASK_CLOSED_LOOP not in sent and not any(map(moves, sent))
        assert sent[0] == ZERO


def test_axis_is_enabled_at_zero_velocity_when_closed_loop_is_reported():
    axis = in_state(AxisState.READY)
    first = tick(axis, Demand.DRIVE, FAST, DT)
    assert first[0] == ZERO and first[1] == VELOCITY_MODE and first[-1] == ASK_CLOSED_LOOP
    assert tick(axis, Demand.DRIVE, FAST, 2 * DT) == [ZERO]
    axis.receive(heartbeat(IDLE), 2 * DT)
    assert axis.state is AxisState.READY
    axis.receive(heartbeat(CLOSED_LOOP), 3 * DT)
    assert axis.state is AxisState.ENABLED
    (frame,) = tick(axis, Demand.DRIVE, FAST, 3 * DT)
    assert struct.unpack("<ff", frame.data) == pytest.approx((30 / math.tau, 0.0))


def test_closed_loop_is_requested_again_but_not_each_period():
    axis = in_state(AxisState.READY)
    asked = []
    for k in range(1, 41):
        axis.receive(heartbeat(IDLE), k * DT)
        asked.append(ASK_CLOSED_LOOP in tick(axis, Demand.DRIVE, FAST, k * DT))
    assert [k for k, one in enumerate(asked) if one] == [0, 19, 38]


def test_idle_is_requested_until_reported_by_the_heartbeat():
    axis = in_state(AxisState.ENABLED)
    assert tick(axis, Demand.IDLE, FAST, DT) == [ZERO, ASK_IDLE]
    asked = 0
    for k in range(2, 42):
        axis.receive(heartbeat(CLOSED_LOOP), k * DT)
        assert axis.state is AxisState.ENABLED
        asked += ASK_IDLE in tick(axis, Demand.IDLE, FAST, k * DT)
    assert asked == 2
    axis.receive(heartbeat(IDLE), 0.3)
    assert axis.state is AxisState.READY and not axis.fault_reason
    assert tick(axis, Demand.IDLE, FAST, 0.3) == [ZERO]


def test_axis_is_not_enabled_again_before_idle_is_reported():
    axis = in_state(AxisState.ENABLED)
    tick(axis, Demand.IDLE, FAST, DT)
    assert tick(axis, Demand.DRIVE, FAST, 2 * DT) == [ZERO]
    axis.receive(heartbeat(IDLE), 3 * DT)
    assert ASK_CLOSED_LOOP in tick(axis, Demand.DRIVE, FAST, 3 * DT)


def test_stop_during_enabling_withdraws_the_request():
    axis = in_state(AxisState.READY)
    tick(axis, Demand.DRIVE, FAST, DT)
    assert tick(axis, Demand.STOP, FAST, 2 * DT) == [ZERO, ASK_IDLE]
    axis.receive(heartbeat(CLOSED_LOOP), 3 * DT)
    assert axis.state is AxisState.READY
    assert tick(axis, Demand.STOP, FAST, 3 * DT) == [ZERO]


def test_heartbeat_of_before_the_request_does_not_show_idle():
    axis = in_state(AxisState.READY)
    tick(axis, Demand.DRIVE, FAST, DT)
    tick(axis, Demand.STOP, FAST, 2 * DT)
    assert tick(axis, Demand.DRIVE, FAST, 3 * DT) == [ZERO]
    axis.receive(heartbeat(IDLE), 4 * DT)
    assert ASK_CLOSED_LOOP in tick(axis, Demand.DRIVE, FAST, 4 * DT)


def test_stop_follows_the_ramp():
    axis = in_state(AxisState.ENABLED)
    for speed in (30.0, 10.0, 0.0, 0.0):
        (frame,) = tick(axis, Demand.STOP, DriveSetpoint(DriveMode.VELOCITY, speed))
        assert frame.id == ZERO.id
        assert struct.unpack("<ff", frame.data)[0] * math.tau == pytest.approx(speed)
    assert axis.state is AxisState.ENABLED


def test_another_mode_is_announced_after_its_zero_and_before_its_setpoint():
    axis = in_state(AxisState.ENABLED)
    torque = DriveSetpoint(DriveMode.TORQUE, 0.5)
    wanted = CanFrame(id_of(0x0E), struct.pack("<ff", 0.5, 0.0))
    zero = CanFrame(id_of(0x0E), bytes(8))
    tick(axis, Demand.DRIVE, FAST)
    assert tick(axis, Demand.DRIVE, torque) == [zero, TORQUE_MODE, wanted]
    assert tick(axis, Demand.DRIVE, torque) == [wanted]
    *before, frame = tick(axis, Demand.STOP, FAST)
    assert before == [ZERO, VELOCITY_MODE] and frame.id == ZERO.id


def test_axis_is_enabled_in_velocity_mode_after_torque_mode():
    axis = in_state(AxisState.ENABLED)
    tick(axis, Demand.DRIVE, DriveSetpoint(DriveMode.TORQUE, 0.5), DT)
    tick(axis, Demand.IDLE, now=2 * DT)
    axis.receive(heartbeat(), 3 * DT)
    sent = tick(axis, Demand.DRIVE, DriveSetpoint(DriveMode.TORQUE, 0.5), 4 * DT)
    assert sent.index(ZERO) < sent.index(VELOCITY_MODE) < sent.index(ASK_CLOSED_LOOP)


@pytest.mark.parametrize("state", AxisState)
def test_each_tick_feeds_the_watchdog(state):
    if state is AxisState.STOPPING:
        return
    axis = in_state(state)
    for k, demand in enumerate((Demand.IDLE, Demand.STOP, Demand.DRIVE) * 10):
        assert tick(axis, demand, FAST, k * DT)


@pytest.mark.parametrize("feed_forward, sent", [(True, 0.25), (False, 0.0)])
def test_feed_forward_torque_is_sent_if_configured(feed_forward, sent):
    axis = in_state(AxisState.ENABLED, feed_forward=feed_forward)
    (frame,) = tick(axis, Demand.DRIVE, DriveSetpoint(DriveMode.VELOCITY, 0.0, 0.25))
    assert struct.unpack("<ff", frame.data) == (0.0, sent)


@pytest.mark.parametrize(
    "mode, value, sent",
    [
        (DriveMode.VELOCITY, 1e300, (500 / math.tau, 2.0)),
        (DriveMode.VELOCITY, -1e300, (-500 / math.tau, 2.0)),
        (DriveMode.TORQUE, 1e300, (2.0, 0.0)),
        (DriveMode.TORQUE, -1e300, (-2.0, 0.0)),
    ],
)
def test_setpoints_are_clipped(mode, value, sent):
    axis = in_state(AxisState.ENABLED, feed_forward=True)
    frame = tick(axis, Demand.DRIVE, DriveSetpoint(mode, value, 1e300))[-1]
    assert struct.unpack("<ff", frame.data) == pytest.approx(sent)


# ---- troubles -----------------------------------------------------------------------------------


def test_axis_error_is_a_fault_at_reception():
    axis = in_state(AxisState.ENABLED)
    axis.receive(heartbeat(IDLE, 0x01000000), DT)
    assert axis.state is AxisState.FAULT
    assert axis.fault_reason == "axis error 0x01000000: WATCHDOG_TIMER_EXPIRED (firmware 0.6)"
    axis.receive(heartbeat(IDLE), 2 * DT)
    assert axis.state is AxisState.FAULT


@pytest.mark.parametrize(
    "error, text",
    [
        (
            0x800,
            "DC_BUS_OVER_REGEN_CURRENT (firmware 0.6) or WATCHDOG_TIMER_EXPIRED (firmware 0.5)",
        ),
        (
            0x300,
            "DC_BUS_OVER_VOLTAGE, DC_BUS_UNDER_VOLTAGE (firmware 0.6) or "
            "ENCODER_FAILED, CONTROLLER_FAILED (firmware 0.5)",
        ),
        (0x40000, "OVER_TEMP (firmware 0.5)"),
        (0x80000000, "unknown"),
    ],
)
def test_error_is_named_in_both_firmwares(error, text):
    assert error_text(error) == f"axis error 0x{error:08X}: {text}"


@pytest.mark.parametrize("axis_state", [0, 1, 2, 11])
def test_leaving_closed_loop_unrequested_is_treated_as_a_restart(axis_state):
    axis = in_state(AxisState.ENABLED)
    axis.receive(heartbeat(axis_state), DT)
    assert axis.state is AxisState.OFFLINE
    assert (
        axis.fault_reason == f"it left closed loop control by itself, to axis state {axis_state}"
    )


@pytest.mark.parametrize("axis_state", [0, 3])
def test_state_other_than_idle_while_ready_is_treated_as_a_restart(axis_state):
    axis = in_state(AxisState.READY)
    axis.receive(heartbeat(axis_state), DT)
    assert axis.state is AxisState.OFFLINE
    assert f"axis state {axis_state}" in axis.fault_reason


def test_closed_loop_that_was_not_requested_is_ended():
    axis = in_state(AxisState.READY)
    axis.receive(heartbeat(CLOSED_LOOP), 0.2)
    assert axis.state is AxisState.READY
    for demand in Demand:
        assert tick(in_closed_loop(), demand, FAST, 0.2) == [ZERO, ASK_IDLE]


def in_closed_loop():
    axis = in_state(AxisState.READY)
    axis.receive(heartbeat(CLOSED_LOOP), 0.2)
    return axis


@pytest.mark.parametrize("state", [AxisState.READY, AxisState.ENABLED])
def test_heartbeat_is_missing_after_three_periods_and_a_tick(state):
    axis = in_state(state)
    demand = Demand.DRIVE if state is AxisState.ENABLED else Demand.IDLE
    lost = None
    for k in range(40):
        tick(axis, demand, now=k * DT)
        if axis.fault_reason:
            lost = k * DT
            break
    assert lost is not None and PATIENCE < lost + 1e-9 <= PATIENCE + DT + 1e-9
    assert "heartbeat" in axis.fault_reason


def test_axis_with_missing_heartbeat_still_follows_the_ramp():
    axis = in_state(AxisState.ENABLED)
    (frame,) = tick(axis, Demand.STOP, FAST, 1.0)
    assert axis.fault_reason and moves(frame)


def test_drive_with_a_fault_is_not_enabled():
    axis = in_state(AxisState.READY)
    assert tick(axis, Demand.DRIVE, FAST, 1.0) == [ZERO]
    assert axis.fault_reason
    axis.receive(heartbeat(), 1.0)
    assert tick(axis, Demand.DRIVE, FAST, 1.0) == [ZERO]


@pytest.mark.parametrize("state", [AxisState.READY, AxisState.ENABLED])
def test_position_that_jumps_has_restarted_and_is_continued(state):
    axis = in_state(state, position=1000.0)
    axis.receive(encoder(0.25), DT)
    assert axis.state is AxisState.OFFLINE
    assert axis.fault_reason == "it restarted: its position jumped by -999.75 rev"
    assert axis.feedback.restarts == 1
    assert axis.feedback.position == pytest.approx(1000 * math.tau)
    axis.receive(encoder(0.5, 1.0), 2 * DT)
    assert axis.feedback.position == pytest.approx(1000.25 * math.tau)


def test_position_jump_before_ready_is_not_a_fault():
    axis = in_state(AxisState.CONFIGURING, position=1000.0)
    axis.receive(encoder(0.0), DT)
    assert axis.state is AxisState.CONFIGURING and not axis.fault_reason


def test_invalid_position_does_not_affect_later_positions():
    axis = in_state(AxisState.READY, position=10.0)
    for k, position in enumerate((3e38, -3e38, 10.0, 10.5)):
        axis.receive(encoder(position), (k + 1) * DT)
    assert axis.feedback.position == pytest.approx(10.5 * math.tau)


def test_fastest_possible_motion_is_no_restart():
    axis = in_state(AxisState.ENABLED)
    for k in range(1, 100):
        axis.receive(encoder(500 / math.tau * k * DT), k * DT)
    assert not axis.fault_reason


def test_voltage_is_refused():
    axis = in_state(AxisState.ENABLED)
    assert DriveMode.VOLTAGE not in axis.modes
    assert tick(axis, Demand.DRIVE, DriveSetpoint(DriveMode.VOLTAGE, 12.0)) == [ZERO]
    assert axis.fault_reason == "it does not support voltage mode"


def test_reset_clears_the_errors_first_and_configures_again():
    axis = in_state(AxisState.FAULT)
    axis.reset(DT)
    assert axis.state is AxisState.CONFIGURING and not axis.fault_reason
    axis.receive(heartbeat(error=0x200), DT)  # still on its way
    sent = tick(axis, Demand.DRIVE, FAST, DT)
    assert sent[0] == CLEAR and ASK_IDLE in sent and not any(map(moves, sent))
    axis.receive(heartbeat(error=0x200), DT + 0.9 * PATIENCE)
    assert not axis.fault_reason
    axis.receive(encoder(), 0.1)
    axis.receive(heartbeat(), 0.1)
    assert axis.state is AxisState.READY
    assert CLEAR not in tick(axis, Demand.DRIVE, FAST, 0.11)


def test_error_that_comes_back_after_reset_is_a_fault_again():
    axis = in_state(AxisState.FAULT)
    axis.reset(DT)
    tick(axis, Demand.IDLE, now=DT)
    axis.receive(heartbeat(error=0x200), DT + PATIENCE + 1e-6)
    assert axis.state is AxisState.FAULT
    assert "DC_BUS_UNDER_VOLTAGE" in axis.fault_reason


def test_configure_clears_no_errors():
    axis = in_state(AxisState.FAULT)
    axis.configure(DT)
    assert CLEAR not in tick(axis, Demand.IDLE, now=DT)
    axis.receive(heartbeat(error=0x200), DT)
    assert axis.state is AxisState.FAULT and axis.fault_reason


def test_reset_does_not_affect_an_axis_without_fault():
    axis = in_state(AxisState.ENABLED)
    axis.reset(DT)
    assert axis.state is AxisState.ENABLED
    assert CLEAR not in tick(axis, Demand.DRIVE, FAST, DT)


def test_first_fault_stays_until_reset():
    axis = in_state(AxisState.ENABLED)
    axis.receive(heartbeat(IDLE), DT)
    axis.receive(heartbeat(IDLE, 0x1), 2 * DT)
    assert "by itself" in axis.fault_reason
    axis.reset(3 * DT)
    assert not axis.fault_reason


# ---- requests -----------------------------------------------------------------------------------


def test_current_and_supply_are_requested_in_turn_ten_times_a_second():
    axis = in_state(AxisState.READY)
    asked = []
    for k in range(200):
        axis.receive(heartbeat(), k * DT)
        remote = [f for f in axis.tick(Demand.IDLE, REST, k * DT) if f.remote]
        assert len(remote) <= 1
        asked += remote
    assert 8 <= len(asked) <= 11
    assert [frame.id & 31 for frame in asked[:4]] in ([0x14, 0x17] * 2, [0x17, 0x14] * 2)
    assert all(f.data == b"" and not f.extended and f.id >> 5 == NODE for f in asked)


def test_values_reported_periodically_are_not_requested():
    axis = in_state(AxisState.READY)
    asked = []
    for k in range(200):
        now = k * DT
        axis.receive(heartbeat(), now)
        axis.receive(CanFrame(id_of(0x14), struct.pack("<ff", 0.0, 1.0)), now)
        asked += [f.id & 31 for f in axis.tick(Demand.IDLE, REST, now) if f.remote]
    assert set(asked) == {0x17}


# ---- frames that are not reports ----------------------------------------------------------------


@pytest.mark.parametrize(
    "frame, receipt",
    [
        (encoder(), Receipt.ACCEPTED),
        (heartbeat(), Receipt.ACCEPTED),
        (CanFrame(id_of(0x15), bytes(8)), Receipt.ACCEPTED),
        (CanFrame(id_of(0x09), bytes(7)), Receipt.MALFORMED),
        (CanFrame(id_of(0x01), bytes(7)), Receipt.MALFORMED),
        (CanFrame(id_of(0x09), bytes(8), extended=True), Receipt.FOREIGN),
        (encoder(math.nan), Receipt.MALFORMED),
        (encoder(0.0, math.inf), Receipt.MALFORMED),
        (encoder(-math.inf), Receipt.MALFORMED),
        (CanFrame(id_of(0x14), struct.pack("<ff", 0.0, math.nan)), Receipt.MALFORMED),
        (CanFrame(id_of(0x17), struct.pack("<ff", math.inf, 0.0)), Receipt.MALFORMED),
        (CanFrame(id_of(0x14), b"", remote=True), Receipt.FOREIGN),
        (CanFrame(id_of(0x0D), bytes(8)), Receipt.FOREIGN),
        (CanFrame(id_of(0x09) + 32, bytes(8)), Receipt.FOREIGN),
        (CanFrame(1 << 11 | id_of(0x09), bytes(8), extended=True), Receipt.FOREIGN),
    ],
)
def test_frames_are_sorted(frame, receipt):
    axis = in_state(AxisState.READY)
    before = [getattr(axis.feedback, one.name) for one in fields(axis.feedback)]
    assert axis.receive(frame, DT) is receipt
    if receipt is not Receipt.ACCEPTED:
        after = [getattr(axis.feedback, one.name) for one in fields(axis.feedback)]
        assert repr(after) == repr(before)


def test_each_command_that_is_sent_is_one_of_a_host():
    axis = in_state(AxisState.FAULT)
    axis.reset(0.0)
    sent = tick(axis, Demand.IDLE)
    axis = in_state(AxisState.ENABLED)
    sent += tick(axis, Demand.DRIVE, DriveSetpoint(DriveMode.TORQUE, 1.0))
    assert {frame.id & 31 for frame in sent} == {0x07, 0x0B, 0x0D, 0x0E, 0x0F, 0x18}
    assert all((frame.id, frame.extended) in axis.command_ids for frame in sent)


def test_command_ids_are_sent_only_by_hosts():
    # "CAN Protocol": set axis state, controller mode, position, velocity, torque, limits; reboot,
    # clear errors, set absolute position
    commands = (0x07, 0x0B, 0x0C, 0x0D, 0x0E, 0x0F, 0x16, 0x18, 0x19)
    axis = OdriveAxis(axis_settings())
    assert set(axis.command_ids) == {(id_of(command), False) for command in commands}


@pytest.mark.parametrize(
    "name, value",
    [
        ("torque_constant", 0.0),
        ("drive_heartbeat", math.inf),
        ("period", -1.0),
    ],
)
def test_settings_that_the_codec_divides_by_are_checked(name, value):
    with pytest.raises(ParameterError, match=name):
        OdriveAxis(axis_settings(**{name: value}))


@pytest.mark.parametrize("state", [s for s in AxisState if s is not AxisState.STOPPING])
def test_no_frame_raises_or_moves_the_motor_or_makes_values_infinite(state):
    ids = [id_of(command) for command in (0x01, 0x09, 0x14, 0x17, 0x15, 0x0D, 0x07)]
    endure(in_state, state, frames(state.value, COUNT, ids), moves)
