import math
from dataclasses import fields

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from omniman_ros.can_drives.axis import REST, AxisState, Demand, DriveSetpoint, Receipt
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.can_drives.vesc import VescAxis
from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.core.errors import ParameterError
from test.can_drives.fuzz import COUNT, endure, frames
from test.can_drives.fuzz import settings as axis_settings

NODE = 5
DUTY, CURRENT, RPM = 0x0005, 0x0105, 0x0305
STATUS, STATUS_5 = 0x0905, 0x1B05
DT = 0.005
FAST = DriveSetpoint(DriveMode.VELOCITY, 30.0)
RELEASE = CanFrame(CURRENT, bytes(4), True)
STAND = CanFrame(RPM, bytes(4), True)
examples = settings(deadline=None, derandomize=True, max_examples=300)


def int_of(data, start=0, stop=None):
    return int.from_bytes(data[start:stop], "big", signed=True)


def status(erpm=0, current=0, duty=0):
    """A report as comm_can_send_status1 packs it."""
    parts = ((erpm, 4), (current, 2), (duty, 2))
    return CanFrame(STATUS, b"".join(v.to_bytes(n, "big", signed=True) for v, n in parts), True)


def status_5(tachometer=0, volts=240):
    parts = ((tachometer, 4), (volts, 2), (0, 2))
    return CanFrame(STATUS_5, b"".join(v.to_bytes(n, "big", signed=True) for v, n in parts), True)


def hear(axis, now, erpm=0, current=0, duty=0, tachometer=0, volts=240):
    assert axis.receive(status(erpm, current, duty), now) is Receipt.ACCEPTED
    assert axis.receive(status_5(tachometer, volts), now) is Receipt.ACCEPTED


def in_state(state, now=0.0, tachometer=0, **changes):
    """An axis brought to a state at a time."""
    axis = VescAxis(axis_settings(**changes))
    if state is AxisState.OFFLINE:
        return axis
    axis.configure(now)
    if state is AxisState.CONFIGURING:
        return axis
    hear(axis, now, tachometer=tachometer)
    assert axis.state is AxisState.READY
    if state is AxisState.ENABLED:
        axis.tick(Demand.DRIVE, REST, now)
        assert axis.state is AxisState.ENABLED
    return axis


def moves(frame):
    """Whether a frame asks for motion, or puts power on a motor that was released."""
    return frame.id not in (CURRENT, RPM) or int_of(frame.data) != 0


# ---- known frames -------------------------------------------------------------------------------


def test_51_amperes_to_node_23_is_the_frame_of_the_documentation():
    # documentation/comm_can.md of github.com/vedderb/bldc, "Single-Frame (simple) Commands".
    axis = in_state_of_node(23, torque_constant=0.1, max_torque=100.0)
    (frame,) = axis.tick(Demand.DRIVE, DriveSetpoint(DriveMode.TORQUE, 5.1), 0.0)
    assert frame == CanFrame(0x0117, bytes.fromhex("0000C738"), extended=True)


def in_state_of_node(node, **changes):
    axis = VescAxis(axis_settings(node=node, **changes))
    axis.configure(0.0)
    for frame in (status(), status_5()):
        axis.receive(frame._replace(id=frame.id - NODE + node), 0.0)
    axis.tick(Demand.DRIVE, REST, 0.0)
    return axis


def test_half_duty_is_50000():
    # triforce-docs.readthedocs.io, "VESC Canbus Communication": "50000 -> 50%".
    axis = in_state(AxisState.ENABLED)
    (frame,) = axis.tick(Demand.DRIVE, DriveSetpoint(DriveMode.VOLTAGE, 12.0), 0.0)
    assert frame == CanFrame(DUTY, (50_000).to_bytes(4, "big"), extended=True)


def test_speed_is_electrical_rpm_unscaled():
    # comm_can_set_rpm in comm_can.md's C code: (int32_t)rpm.
    axis = in_state(AxisState.ENABLED)
    (frame,) = axis.tick(Demand.DRIVE, DriveSetpoint(DriveMode.VELOCITY, -20 * math.tau), 0.0)
    assert frame == CanFrame(RPM, (-20 * 60 * 7).to_bytes(4, "big", signed=True), extended=True)


def test_recorded_status_frames_match_the_values_reported_by_the_drive():
    # vesc-project.com/node/3345: status frames of node 4, and its answer to COMM_GET_VALUES with
    # the same duty 0x29, input voltage 0xEF and tachometer 0x0C.
    axis = VescAxis(axis_settings(node=4))
    axis.configure(0.0)
    for id, data in (
        (0x0904, "0000000000000029"),
        (0x0E04, "0000000000000000"),
        (0x0F04, "0000000000000000"),
        (0x1004, "00FDFE840000251E"),
        (0x1B04, "0000000C00EF0000"),
    ):
        frame = CanFrame(id, bytes.fromhex(data), extended=True)
        assert axis.receive(frame, 1.0) is Receipt.ACCEPTED
    feedback = axis.feedback
    assert axis.state is AxisState.READY
    assert feedback.bus_voltage == pytest.approx(23.9)
    assert feedback.voltage == pytest.approx(0.041 * 23.9)
    assert feedback.position == pytest.approx(12 / 6 / 7 * math.tau)
    assert feedback.velocity == feedback.current == 0.0


# ---- round trips --------------------------------------------------------------------------------


@examples
@given(st.floats(-500, 500), st.integers(1, 50))
def test_speed_setpoint_comes_back_as_the_velocity_reported(speed, pairs):
    axis = in_state(AxisState.ENABLED, pole_pairs=pairs)
    (frame,) = axis.tick(Demand.DRIVE, DriveSetpoint(DriveMode.VELOCITY, speed), 0.0)
    hear(axis, DT, erpm=int_of(frame.data))
    assert axis.feedback.velocity == pytest.approx(speed, abs=math.tau / 60 / pairs)


@examples
@given(st.floats(-2, 2), st.floats(0.01, 1.0))
def test_torque_setpoint_comes_back_as_the_torque_reported(torque, constant):
    axis = in_state(AxisState.ENABLED, torque_constant=constant, max_torque=2.0)
    (frame,) = axis.tick(Demand.DRIVE, DriveSetpoint(DriveMode.TORQUE, torque), 0.0)
    milliamperes = int_of(frame.data)
    assert milliamperes == pytest.approx(torque / constant * 1e3, abs=0.51)
    hear(axis, DT, current=abs(round(milliamperes / 100)), duty=1 if torque > 0 else -1)
    assert axis.feedback.torque == pytest.approx(torque, abs=0.06 * constant)


@examples
@given(st.floats(-60, 60), st.integers(80, 600))
def test_duty_times_measured_supply_is_the_voltage_within_its_limit(volts, supply):
    axis = in_state(AxisState.ENABLED)
    hear(axis, DT, volts=supply)
    (frame,) = axis.tick(Demand.DRIVE, DriveSetpoint(DriveMode.VOLTAGE, volts), DT)
    limit = 0.95 * supply / 10
    assert frame.id == DUTY
    assert int_of(frame.data) * 1e-5 * supply / 10 == pytest.approx(
        min(max(volts, -limit), limit), abs=1e-3
    )


@pytest.mark.parametrize(
    "duty, current, torque",
    [
        (300, 40, 0.2),
        (300, -40, -0.2),
        (-300, 40, -0.2),
        (-300, -40, 0.2),
    ],
)
def test_current_drawn_has_the_direction_of_the_duty_and_generated_the_other(
    duty, current, torque
):
    # mcpwm_foc_get_tot_current_filtered: positive where the motor draws, whichever way it turns.
    axis = in_state(AxisState.READY)
    hear(axis, DT, duty=duty, current=current)
    assert axis.feedback.torque == pytest.approx(torque)
    assert axis.feedback.current == pytest.approx(torque / 0.05)


@pytest.mark.parametrize(
    "value, mode, number",
    [
        (1e9, DriveMode.VELOCITY, 500 * 60 / math.tau * 7),
        (-1e9, DriveMode.VELOCITY, -500 * 60 / math.tau * 7),
        (1e9, DriveMode.TORQUE, 40_000),
        (-1e9, DriveMode.TORQUE, -40_000),
        (1e300, DriveMode.VOLTAGE, 95_000),
        (-1e300, DriveMode.VOLTAGE, -95_000),
    ],
)
def test_setpoints_are_clipped(value, mode, number):
    axis = in_state(AxisState.ENABLED)
    (frame,) = axis.tick(Demand.DRIVE, DriveSetpoint(mode, value), 0.0)
    assert int_of(frame.data) == pytest.approx(number, abs=0.51)


@pytest.mark.parametrize("sign", [1, -1])
def test_setpoints_are_clipped_to_32_bits(sign):
    axis = in_state(AxisState.ENABLED, max_speed=1e12)
    (frame,) = axis.tick(Demand.DRIVE, DriveSetpoint(DriveMode.VELOCITY, sign * 1e12), 0.0)
    assert int_of(frame.data) == sign * (2**31 - 1)


# ---- states -------------------------------------------------------------------------------------


def test_axis_is_ready_after_both_reports_since_configure():
    axis = VescAxis(axis_settings())
    hear(axis, 0.0)
    assert axis.state is AxisState.OFFLINE
    axis.configure(1.0)
    for report in (status(), status()):
        axis.receive(report, 1.0)
        assert axis.state is AxisState.CONFIGURING
    axis.receive(status_5(), 1.0)
    assert axis.state is AxisState.READY


def test_axis_is_released_during_configuration_even_after_driving():
    axis = in_state(AxisState.ENABLED)
    axis.configure(DT)
    assert axis.tick(Demand.DRIVE, FAST, DT) == [RELEASE]
    assert axis.state is AxisState.CONFIGURING


def test_first_tick_of_driving_requests_zero_whatever_the_setpoint():
    axis = in_state(AxisState.READY)
    assert axis.tick(Demand.DRIVE, FAST, 0.0) == [STAND]
    assert axis.state is AxisState.ENABLED
    assert int_of(axis.tick(Demand.DRIVE, FAST, DT)[0].data) == round(30 * 60 / math.tau * 7)


def test_axis_with_old_reports_is_not_enabled():
    axis = in_state(AxisState.READY)
    assert axis.tick(Demand.DRIVE, FAST, 0.016) == [RELEASE]
    assert axis.state is AxisState.READY
    hear(axis, 0.02)
    axis.tick(Demand.DRIVE, FAST, 0.02)
    assert axis.state is AxisState.ENABLED


def test_idle_releases_the_motor_each_period():
    axis = in_state(AxisState.ENABLED)
    for k in range(3):
        assert axis.tick(Demand.IDLE, FAST, k * DT) == [RELEASE]
        assert axis.state is AxisState.READY


def test_stop_follows_the_ramp_and_stays_enabled():
    axis = in_state(AxisState.ENABLED)
    for speed in (30.0, 10.0, 0.0, 0.0):
        (frame,) = axis.tick(Demand.STOP, DriveSetpoint(DriveMode.VELOCITY, speed), DT)
        assert frame.id == RPM
        assert int_of(frame.data) == round(speed * 60 / math.tau * 7)
    assert axis.state is AxisState.ENABLED


@pytest.mark.parametrize("state", [AxisState.OFFLINE, AxisState.CONFIGURING, AxisState.READY])
def test_stop_puts_no_power_on_a_drive_that_did_not_drive(state):
    axis = in_state(state)
    assert axis.tick(Demand.STOP, FAST, 0.0) == [RELEASE]
    assert axis.state is state


# ---- feedback -----------------------------------------------------------------------------------


def test_feedback_is_received_when_both_reports_have_come_since_the_last_time():
    axis = VescAxis(axis_settings())
    seen = []
    for k, report in enumerate((status(), status(), status_5(), status_5(), status())):
        axis.receive(report, float(k))
        seen.append((axis.feedback.count, axis.feedback.at))
    assert seen == [(0, -math.inf), (0, -math.inf), (1, 2.0), (1, 2.0), (2, 4.0)]


def test_values_that_were_not_received_are_nan():
    axis = VescAxis(axis_settings())
    axis.receive(status(duty=500), 0.0)
    assert math.isnan(axis.feedback.voltage)
    assert math.isnan(axis.feedback.position)
    axis.receive(status_5(volts=240), 0.0)
    assert axis.feedback.voltage == pytest.approx(12.0)


@pytest.mark.parametrize("sign", [1, -1])
def test_tachometer_is_joined_over_its_wrap(sign):
    start = sign * (2**31 - 10)
    axis = in_state(AxisState.ENABLED, tachometer=start)
    before = axis.feedback.position
    reading = start + sign * 100
    wrapped = (reading + 2**31) % 2**32 - 2**31
    assert wrapped != reading
    hear(axis, DT, tachometer=wrapped)
    assert axis.feedback.position - before == pytest.approx(sign * 100 / 42 * math.tau)
    assert not axis.fault_reason


# ---- troubles -----------------------------------------------------------------------------------


@pytest.mark.parametrize("state", [AxisState.READY, AxisState.ENABLED])
def test_tachometer_that_jumps_has_restarted(state):
    axis = in_state(state, tachometer=100_000)
    before = axis.feedback.position
    hear(axis, DT, tachometer=3)
    assert axis.state is AxisState.OFFLINE and axis.feedback.restarts == 1
    assert "restarted" in axis.fault_reason and "-2380.9 revolutions" in axis.fault_reason
    assert axis.feedback.position == before
    hear(axis, 2 * DT, tachometer=45)
    assert axis.feedback.position == pytest.approx(before + math.tau)


@pytest.mark.parametrize("state", [AxisState.READY, AxisState.ENABLED])
def test_drive_that_reports_a_boot_has_restarted(state):
    # CAN_PACKET_NOTIFY_BOOT is 57 in datatypes.h; of any length
    axis = in_state(state, tachometer=100)
    before = axis.feedback.position
    assert axis.receive(CanFrame(0x3905, b"\x05", True), DT) is Receipt.ACCEPTED
    assert axis.state is AxisState.OFFLINE and axis.feedback.restarts == 1
    assert axis.fault_reason == "it restarted: it reports a boot"
    hear(axis, 2 * DT, tachometer=0)
    assert axis.feedback.position == before


def test_boot_before_driving_is_not_a_fault():
    axis = in_state(AxisState.CONFIGURING)
    axis.receive(CanFrame(0x3905, b"", True), DT)
    assert axis.state is AxisState.CONFIGURING and not axis.fault_reason


def test_axis_that_restarted_in_motion_is_held_at_zero_until_released():
    axis = in_state(AxisState.ENABLED, tachometer=100_000)
    hear(axis, DT, tachometer=0)
    assert axis.tick(Demand.DRIVE, FAST, DT) == [STAND]
    assert axis.tick(Demand.STOP, FAST, DT) == [STAND]
    assert axis.tick(Demand.IDLE, FAST, DT) == [RELEASE]
    assert axis.tick(Demand.STOP, FAST, DT) == [RELEASE]


def test_fastest_possible_motion_is_no_restart():
    axis = in_state(AxisState.ENABLED)
    tachometer = 0
    for k in range(1, 200):
        late = 3 * DT if k % 7 == 0 else 0.0
        tachometer += round(500 * (DT + late) / math.tau * 42)
        hear(axis, k * DT, tachometer=tachometer)
    assert not axis.fault_reason


def test_reports_read_in_one_burst_are_no_restart():
    axis = in_state(AxisState.ENABLED)
    for k in range(1, 4):
        hear(axis, 3 * DT, tachometer=round(k * 500 * DT / math.tau * 42))
    assert not axis.fault_reason


def test_jump_is_judged_by_the_time_since_the_last_report():
    axis = in_state(AxisState.ENABLED)
    for k in range(1, 200):
        hear(axis, k * DT)
    hear(axis, 200 * DT, tachometer=20 * 42)
    assert "jumped by 20.0 revolutions" in axis.fault_reason


def test_position_jump_before_ready_is_not_a_fault():
    axis = in_state(AxisState.CONFIGURING)
    axis.receive(status_5(1_000_000), 0.0)
    axis.receive(status_5(0), DT)
    assert axis.state is AxisState.CONFIGURING and not axis.fault_reason


def test_reset_configures_a_restarted_axis_and_clears_the_reason():
    axis = in_state(AxisState.ENABLED, tachometer=100_000)
    hear(axis, DT, tachometer=0)
    axis.reset(2 * DT)
    assert axis.state is AxisState.CONFIGURING and not axis.fault_reason
    assert axis.tick(Demand.DRIVE, FAST, 2 * DT) == [RELEASE]
    hear(axis, 3 * DT)
    assert axis.state is AxisState.READY


def test_reset_does_not_affect_an_axis_without_fault():
    axis = in_state(AxisState.ENABLED)
    axis.reset(DT)
    assert axis.state is AxisState.ENABLED


@pytest.mark.parametrize("volts", [0, -240, 49])
def test_voltage_without_a_sane_supply_is_no_current_and_a_fault(volts):
    axis = in_state(AxisState.ENABLED)
    hear(axis, DT, volts=volts)
    assert axis.tick(Demand.DRIVE, DriveSetpoint(DriveMode.VOLTAGE, 12.0), DT) == [RELEASE]
    assert "no plausible bus voltage received" in axis.fault_reason


def test_first_fault_stays_until_reset():
    axis = in_state(AxisState.ENABLED, tachometer=100_000)
    hear(axis, DT, volts=0, tachometer=100_000)
    axis.tick(Demand.DRIVE, DriveSetpoint(DriveMode.VOLTAGE, 12.0), DT)
    hear(axis, 2 * DT, volts=240, tachometer=0)
    assert "bus voltage" in axis.fault_reason
    assert axis.state is AxisState.OFFLINE


# ---- frames that are not reports ----------------------------------------------------------------


@pytest.mark.parametrize(
    "frame, receipt",
    [
        (CanFrame(STATUS, bytes(8), True), Receipt.ACCEPTED),
        (CanFrame(STATUS, bytes(7), True), Receipt.MALFORMED),
        (CanFrame(STATUS_5, bytes(7), True), Receipt.MALFORMED),
        (CanFrame(STATUS_5, b"", True), Receipt.MALFORMED),
        (CanFrame(STATUS, bytes(8), False), Receipt.FOREIGN),
        (CanFrame(STATUS, b"", True, True), Receipt.FOREIGN),
        (CanFrame(STATUS, bytes(8), True, True), Receipt.FOREIGN),
        (CanFrame(STATUS + 1, bytes(8), True), Receipt.FOREIGN),
        (CanFrame(1 << 16 | STATUS, bytes(8), True), Receipt.FOREIGN),
        (CanFrame(RPM, bytes(4), True), Receipt.FOREIGN),
        (CanFrame(0x1005, bytes(8), True), Receipt.ACCEPTED),
        (CanFrame(0x3A05, bytes(8), True), Receipt.ACCEPTED),  # status 6 is 58
        (CanFrame(0x1C05, bytes(8), True), Receipt.FOREIGN),
        (CanFrame(0x3905, b"\x05", False), Receipt.FOREIGN),
        (CanFrame(0x3905, b"", True, True), Receipt.FOREIGN),
    ],
)
def test_frames_are_sorted(frame, receipt):
    axis = in_state(AxisState.READY)
    assert axis.receive(frame, DT) is receipt


def test_malformed_report_changes_nothing():
    axis = in_state(AxisState.READY)
    before = [getattr(axis.feedback, one.name) for one in fields(axis.feedback)]
    axis.receive(status(erpm=1000)._replace(data=status(erpm=1000).data[:7]), DT)
    axis.receive(status_5(50)._replace(extended=False), DT)
    assert [getattr(axis.feedback, one.name) for one in fields(axis.feedback)] == before


def test_each_command_that_is_sent_is_one_of_a_host():
    axis = in_state(AxisState.ENABLED)
    setpoints = [DriveSetpoint(mode, 1.0) for mode in axis.modes]
    sent = [axis.tick(Demand.DRIVE, setpoint, 0.0)[0] for setpoint in setpoints]
    assert {frame.id for frame in sent} == {DUTY, CURRENT, RPM}
    assert all((frame.id, frame.extended) in axis.command_ids for frame in sent)


def test_command_ids_are_all_simple_commands():
    # datatypes.h, CAN_PACKET_ID: SET_DUTY to SET_POS, SET_CURRENT_REL to _HANDBRAKE_REL
    ids = {number << 8 | NODE for number in (0, 1, 2, 3, 4, 10, 11, 12, 13)}
    assert set(VescAxis(axis_settings()).command_ids) == {(id, True) for id in ids}


@pytest.mark.parametrize(
    "name, value",
    [
        ("pole_pairs", 0),
        ("torque_constant", 0.0),
        ("torque_constant", math.nan),
        ("period", -1.0),
    ],
)
def test_settings_that_the_codec_divides_by_are_checked(name, value):
    with pytest.raises(ParameterError, match=name):
        VescAxis(axis_settings(**{name: value}))


@pytest.mark.parametrize(
    "state",
    [
        AxisState.OFFLINE,
        AxisState.CONFIGURING,
        AxisState.READY,
        AxisState.ENABLED,
    ],
)
def test_no_frame_raises_or_moves_the_motor_or_makes_values_infinite(state):
    ids = [STATUS, STATUS_5, 0x1005, CURRENT, RPM, 0x0904]
    endure(in_state, state, frames(state.value, COUNT, [], ids), moves)
