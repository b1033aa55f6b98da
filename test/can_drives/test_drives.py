"""The drive policy: stops, their reaction times and restarts."""

import math

import numpy as np
import pytest

from omniman_ros.can_drives.axis import AxisState, Demand
from omniman_ros.can_drives.drives import LISTEN_TIME, REST_TIME, CanDrives, CanDrivesPhase
from omniman_ros.can_drives.foreign_host import ECHO_MEMORY
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.control.wheel_cascade import DriveMode, WheelCommand
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.robots import robot_parameters
from test.can_drives.scripted import COMMAND, PROTOCOL, SYNC, report

PERIOD = 0.005
NODES = (11, 12, 13, 14)
SPEED = np.array([4.0, -2.0, 1.0, 3.0])


class Bench:
    """Drives that report their setpoints, one period at a time."""

    def __init__(self, **changes):
        robot = build(Platform, robot_parameters("omniman"))
        given = {"protocol": PROTOCOL, "nodes": NODES, "direction": (1.0, -1.0, 1.0, -1.0)}
        values = {f"can.{key}": value for key, value in (given | changes).items()}
        self.parameters = build(CanParameters, values, "can.")
        self.robot = robot
        self.drives = CanDrives(robot, self.parameters)
        self.axes = self.drives.axes
        self.now = 100.0
        self.silent = set()
        self.positions = [0.0] * 4
        self.sent = []

    def period(self, count=1, command=None):
        for _ in range(count):
            self.now += PERIOD
            if command is not None:
                self.drives.set_command(command, self.now)
            self.sent = self.drives.tick(self.now)
            for k, axis in enumerate(self.axes):
                if axis.settings.node in self.silent:
                    continue
                _, setpoint = axis.asked[-1]
                speed = setpoint.value if setpoint.mode is DriveMode.VELOCITY else 0.0
                self.positions[k] += speed * PERIOD
                self.hear(report(axis.settings.node, self.positions[k], speed))
        return self

    def hear(self, frame):
        return self.drives.receive(frame, self.now + 0.001)

    def configure(self):
        self.drives.configure(self.now)
        while self.drives._is_listening:
            self.now += PERIOD
            self.sent = self.drives.tick(self.now)
        return self

    def up(self):
        self.configure().period(3)
        assert self.drives.phase is CanDrivesPhase.IDLE
        self.drives.enable(self.now)
        self.period(3)
        assert self.drives.phase is CanDrivesPhase.DRIVING
        return self

    def driving(self, speed=SPEED):
        self.up().period(100, WheelCommand(DriveMode.VELOCITY, np.zeros(4), speed))
        assert self.speeds() == pytest.approx(speed)
        return self

    def asked(self):
        return [axis.asked[-1][0] for axis in self.axes]

    def speeds(self):
        """Return the requested wheel speeds [rad/s]."""
        ratio = self.robot.motor.gear_ratio
        return [
            axis.asked[-1][1].value / ratio * direction
            for axis, direction in zip(self.axes, self.parameters.direction, strict=True)
        ]


@pytest.fixture
def bench():
    return Bench()


def velocity(*speeds):
    """Return a command, without the check of its own, so that the policy has to refuse it."""
    return WheelCommand.unchecked(
        mode=DriveMode.VELOCITY, effort=np.zeros(4), velocity=np.array(speeds, dtype=float)
    )


# ---- set-up ---------------------------------------------------------------------------------


def test_nothing_is_sent_before_configuration(bench):
    assert bench.drives.tick(1.0) == []
    assert bench.drives.phase is CanDrivesPhase.UNCONFIGURED


def test_nothing_is_sent_before_listening_to_the_bus(bench):
    start = bench.now
    bench.drives.configure(bench.now)
    while not bench.drives.tick(bench.now):
        assert bench.drives.phase is CanDrivesPhase.CONFIGURING
        bench.now += PERIOD
    assert bench.now - start == pytest.approx(LISTEN_TIME, abs=PERIOD)


def test_drives_commanded_by_another_host_are_not_commanded_until_that_host_is_gone(bench):
    bench.drives.configure(bench.now)
    bench.hear(report(11, 0.0, 0.0))
    assert bench.drives.phase is CanDrivesPhase.CONFIGURING
    assert bench.hear(CanFrame(SYNC, b"")) == []
    assert bench.drives.phase is CanDrivesPhase.UNCONFIGURED
    assert bench.drives.stop_reason == (
        "not configured: another host commands the drives: frame 080#"
    )
    assert bench.drives.tick(bench.now + 1.0) == []
    bench.configure().period(3)
    assert bench.drives.phase is CanDrivesPhase.IDLE


def test_period_ends_with_the_frames_of_the_network(bench):
    bench.up()
    assert [frame.id for frame in bench.sent] == [*(COMMAND + node for node in NODES), SYNC]


def test_silent_drives_are_named_after_the_configuration_timeout(bench):
    bench.silent = {12, 14}
    bench.configure()
    bench.period(round(bench.parameters.configure_timeout / PERIOD) - 1)
    assert bench.drives.phase is CanDrivesPhase.CONFIGURING
    bench.period(3)
    assert bench.drives.phase is CanDrivesPhase.UNCONFIGURED
    assert bench.drives.stop_reason == (
        "not configured: front_right (node 12): silent, rear_right (node 14): silent"
    )


def test_earlier_fault_is_reset_once_during_configuration(bench):
    bench.configure()
    bench.axes[0].state, bench.axes[0].fault_reason = AxisState.FAULT, "EMCY 8130"
    bench.period(4)
    assert bench.axes[0].resets == 1
    assert bench.drives.phase is CanDrivesPhase.IDLE


def test_drive_that_refuses_its_configuration_twice_is_named(bench):
    for axis in bench.axes:
        axis.obedient = False
    bench.configure()
    for _ in range(2):
        bench.axes[0].fault_reason = "SDO 1017:00: abort 06020000"
        bench.period()
    assert bench.drives.phase is CanDrivesPhase.UNCONFIGURED
    assert "front_left (node 11): SDO 1017:00: abort 06020000" in bench.drives.stop_reason


def test_enabling_begins_at_zero_and_ignores_earlier_commands(bench):
    bench.configure()
    bench.period(3)
    assert bench.drives.set_command(velocity(1, 1, 1, 1), bench.now) == "idle"
    for axis in bench.axes:
        axis.obedient = False
    bench.drives.enable(bench.now)
    bench.period(5, velocity(1, 1, 1, 1))
    assert bench.drives.phase is CanDrivesPhase.ENABLING
    assert bench.asked() == [Demand.DRIVE] * 4
    assert bench.speeds() == [0.0] * 4


def test_drive_that_is_not_enabled_in_time_stops_all_and_is_named(bench):
    bench.configure()
    bench.period(3)
    bench.axes[2].obedient = False
    bench.drives.enable(bench.now)
    bench.period(round(bench.parameters.enable_timeout / PERIOD) + 2)
    assert bench.drives.stop_reason == "not enabled: rear_left (node 13): ready"
    bench.period(200)
    assert bench.asked() == [Demand.IDLE] * 4


def test_drives_that_are_not_configured_cannot_be_enabled(bench):
    with pytest.raises(InputError, match="unconfigured"):
        bench.drives.enable(0.0)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"nodes": (1, 2, 3)}, "must have 4 node ids, one per wheel, has 3"),
        ({"nodes": (1, 2, 3, 3)}, "must not repeat"),
        ({"nodes": (1, 2, 3, 64), "protocol": "odrive"}, "0 to 63"),
        ({"nodes": (0, 1, 2, 3), "protocol": "cia402"}, "1 to 126"),
        ({"direction": (1.0, 0.5, 1.0, 1.0)}, "1 or -1"),
        ({"direction": (1.0, 1.0)}, "1 or -1"),
    ],
)
def test_installation_that_does_not_fit_is_refused(changes, reason):
    with pytest.raises(ParameterError, match=reason):
        Bench(**changes)


# ---- commands -------------------------------------------------------------------------------


def test_command_reaches_the_motors_through_gear_and_direction(bench):
    bench.driving()
    ratio = bench.robot.motor.gear_ratio
    values = [axis.asked[-1][1].value for axis in bench.axes]
    assert values == pytest.approx([4 * ratio, 2 * ratio, ratio, -3 * ratio])


def test_feedback_comes_back_in_wheel_units_once_all_have_reported(bench):
    bench.driving()
    states = bench.drives.take_states()
    assert states.velocity == pytest.approx(SPEED, abs=1e-4)
    assert states.position.shape == states.effort.shape == (4,)
    assert bench.drives.take_states() is None
    bench.now += PERIOD
    bench.drives.tick(bench.now)
    for k in range(4):
        assert bench.drives.take_states() is None
        bench.hear(report(NODES[k], bench.positions[k], 0.0))
    assert bench.drives.take_states() is not None


def test_time_of_a_measurement_is_that_of_the_sync_and_always_increases(bench):
    bench.driving()
    bench.drives.take_states()
    bench.period()
    assert bench.drives.take_states().at == bench.now
    bench.silent = set(NODES)
    bench.period(2)
    for node in NODES[:3]:
        bench.hear(report(node, 0.0, 0.0))
    bench.now += PERIOD
    bench.drives.tick(bench.now)
    bench.hear(report(NODES[3], 0.0, 0.0))
    late = bench.drives.take_states().at
    assert late == pytest.approx(bench.now - PERIOD), "the oldest answers the SYNC before"
    bench.silent = set()
    bench.period()
    assert bench.drives.take_states().at > late
    for node in NODES:
        bench.hear(report(node, 0.0, 0.0))
    assert bench.drives.take_states() is None, "a second answer to the same SYNC"


def test_first_command_is_approached_by_a_ramp_on_its_curve(bench):
    bench.up()
    rows = []
    for _ in range(60):
        bench.period(1, velocity(*SPEED))
        rows.append(bench.speeds())
    steps = np.abs(np.diff(rows, axis=0)).max()
    assert steps <= bench.parameters.acceleration * PERIOD + 1e-9
    moving = np.array([row for row in rows if row[0]])
    assert np.allclose(moving / moving[:, :1], SPEED / SPEED[0])
    assert rows[-1] == pytest.approx(SPEED)


def test_later_commands_are_followed_without_a_ramp(bench):
    bench.driving().period(1, velocity(-4, 2, -1, -3))
    assert bench.speeds() == pytest.approx([-4, 2, -1, -3])


def test_stale_command_becomes_a_ramp_to_rest_on_the_curve(bench):
    bench.driving()
    last, rows = bench.now, []
    while bench.speeds() != [0.0] * 4:
        bench.period()
        rows.append(bench.speeds())
    age = bench.parameters.command_timeout
    assert bench.now - last == pytest.approx(age + 4.0 / bench.parameters.deceleration, abs=0.02)
    assert np.abs(np.diff(rows, axis=0)).max() <= bench.parameters.deceleration * PERIOD + 1e-9
    slowing = np.array(rows[:-1])
    assert np.allclose(slowing / slowing[:, :1], SPEED / SPEED[0])
    assert bench.asked() == [Demand.DRIVE] * 4, "the drives stay enabled"
    assert not bench.drives.stop_reason
    bench.period(100, velocity(*SPEED))
    assert bench.speeds() == pytest.approx(SPEED), "the next command moves again"


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (velocity(1e3, 0, 0, 0), "1000.0 rad/s; the limit is"),
        (velocity(math.nan, 0, 0, 0), "must be finite"),
        (velocity(math.inf, 0, 0, 0), "must be finite"),
        (
            WheelCommand.unchecked(
                mode=DriveMode.VELOCITY, effort=np.full(4, math.nan), velocity=np.zeros(4)
            ),
            "must be finite",
        ),
        (WheelCommand(DriveMode.TORQUE, np.zeros(4)), "can.mode is velocity"),
        (WheelCommand(DriveMode.VOLTAGE, np.zeros(4)), "can.mode is velocity"),
        (WheelCommand(DriveMode.VELOCITY, np.zeros(3), np.zeros(3)), "got 3"),
    ],
)
def test_refused_command_is_not_fresh(bench, command, reason):
    bench.driving()
    start = bench.now
    while bench.now - start < 1.0:
        bench.period()
        with pytest.raises(InputError, match=reason):
            bench.drives.set_command(command, bench.now)
    assert bench.speeds() == [0.0] * 4


def test_voltages_become_torques_by_the_motor_model_within_the_supply():
    bench = Bench(mode="voltage")
    bench.up()
    motor = bench.robot.motor
    for axis in bench.axes:
        axis.feedback.bus_voltage = 20.0
    volts = np.array([6.0, -6.0, 3.0, 100.0])
    bench.period(1, WheelCommand(DriveMode.VOLTAGE, volts))
    asked = [axis.asked[-1][1] for axis in bench.axes]
    assert {setpoint.mode for setpoint in asked} == {DriveMode.TORQUE}
    k, r = motor.torque_constant, motor.resistance
    expected = [k * 6 / r, k * 6 / r, k * 3 / r, -k * 20 / r]
    bound = motor.max_current * k * motor.gear_efficiency
    expected = [min(max(value, -bound), bound) for value in expected]
    assert [setpoint.value for setpoint in asked] == pytest.approx(expected)


def test_turning_motor_gets_less_torque_at_the_same_voltage():
    bench = Bench(mode="voltage", max_torque=1000.0)
    bench.up()
    motor, speed = bench.robot.motor, 30.0
    bench.hear(report(NODES[0], 0.0, speed))
    bench.drives.set_command(WheelCommand(DriveMode.VOLTAGE, np.full(4, 5.0)), bench.now)
    bench.drives.tick(bench.now)
    expected = motor.torque_constant * (5.0 - motor.torque_constant * speed) / motor.resistance
    assert bench.axes[0].asked[-1][1].value == pytest.approx(expected)


def test_stale_torques_become_a_ramp_of_speeds_from_the_measured_ones():
    bench = Bench(mode="torque", heartbeat_timeout=1.0)
    bench.up()
    ratio = bench.robot.motor.gear_ratio
    bench.period(1, WheelCommand(DriveMode.TORQUE, np.full(4, 0.5)))
    for node, direction in zip(NODES, bench.parameters.direction, strict=True):
        bench.hear(report(node, 0.0, 3.0 * ratio * direction))
    bench.now += 0.1
    bench.period()
    assert {axis.asked[-1][1].mode for axis in bench.axes} == {DriveMode.VELOCITY}
    assert bench.speeds() == pytest.approx([3.0] * 4)


# ---- stops ----------------------------------------------------------------------------------


def all_commanded_to_stop(frames):
    return sorted(frame.id for frame in frames if frame.data[:1] == b"s") == [
        COMMAND + node for node in NODES
    ]


def test_fault_is_answered_at_reception_by_a_stop_of_all(bench):
    bench.driving()
    bench.axes[1].fault_reason = "EMCY 2310"
    frames = bench.hear(report(12, 0.0, 0.0))
    assert all_commanded_to_stop(frames)
    assert bench.drives.stop_reason == "front_right: EMCY 2310"


@pytest.mark.parametrize(
    ("happen", "reason"),
    [
        (lambda b: b.drives.stop("~/stop", b.now), "~/stop"),
        (lambda b: b.drives.on_bus_failure("off", b.now), "bus: off"),
        (
            lambda b: b.hear(CanFrame(COMMAND + 13, b"d\x01\x02\x03\x04")),
            "another host commands the drives: frame 20D#6401020304",
        ),
        (lambda b: b.hear(report(14, 0.0, 1e4)), "rear_right: runs away"),
    ],
)
def test_each_cause_stops_all_at_once(bench, happen, reason):
    bench.driving()
    assert all_commanded_to_stop(happen(bench))
    assert bench.drives.stop_reason.startswith(reason)
    bench.period()
    assert bench.asked() == [Demand.STOP] * 4


def test_silent_wheel_stops_all_after_three_missed_periods_and_one_tick(bench):
    bench.driving()
    bench.silent = {13}
    heard = bench.axes[2].feedback.at
    while not bench.drives.stop_reason:
        bench.period(1, velocity(*SPEED))
    assert bench.now - heard <= 4 * PERIOD + 1e-9
    assert bench.drives.stop_reason.startswith("rear_left: no feedback for ")
    assert bench.asked() == [Demand.STOP] * 4


def test_two_missed_periods_are_tolerated(bench):
    bench.driving()
    bench.silent = {13}
    bench.period(2, velocity(*SPEED))
    bench.silent = set()
    bench.period(10, velocity(*SPEED))
    assert not bench.drives.stop_reason


def test_drive_that_leaves_its_power_stage_stops_all(bench):
    bench.driving()
    bench.axes[0].state, bench.axes[0].obedient = AxisState.READY, False
    bench.period()
    assert bench.drives.stop_reason == "lost: front_left (node 11): ready"
    assert bench.asked() == [Demand.STOP] * 4


def test_supply_that_breaks_down_stops_all():
    bench = Bench(min_bus_voltage=18.0).driving()
    bench.axes[3].feedback.bus_voltage = 17.0
    bench.period(1, velocity(*SPEED))
    assert bench.drives.stop_reason == "rear_right: supply 17.0 V, at least 18.0 V are needed"


def test_encoder_that_stands_while_its_speed_does_not_stops_all(bench):
    bench.driving()
    start, speed = bench.positions[0], SPEED[0]
    began = bench.now
    while not bench.drives.stop_reason and bench.now < began + 1.0:
        bench.positions[0] = start - bench.axes[0].asked[-1][1].value * PERIOD
        bench.period(1, velocity(*SPEED))
    assert bench.drives.stop_reason.startswith("front_left: its encoder moved 0.")
    assert bench.now - began < 2.5 * 0.5 / speed, "after half a radian or so"


def test_stop_ramps_all_wheels_and_then_takes_the_power_off(bench):
    bench.driving()
    bench.drives.stop("~/stop", bench.now)
    began, rows, demands = bench.now, [], []
    while Demand.IDLE not in bench.asked():
        bench.period()
        rows.append(bench.speeds())
        demands.append(bench.asked())
    ramp = 4.0 / bench.parameters.quick_stop_deceleration
    assert bench.now - began == pytest.approx(ramp + REST_TIME, abs=0.03)
    assert all(row == [Demand.STOP] * 4 for row in demands[:-1])
    steps = np.abs(np.diff(rows, axis=0)).max()
    assert steps <= bench.parameters.quick_stop_deceleration * PERIOD + 1e-9
    bench.period(2)
    assert bench.drives.is_off


def test_power_is_switched_off_in_bounded_time_with_a_lost_wheel(bench):
    bench.driving()
    bench.silent = {11}
    bench.drives.stop("~/stop", bench.now)
    began = bench.now
    while Demand.IDLE not in bench.asked() and bench.now < began + 60:
        bench.period()
    assert bench.now - began <= bench.drives.longest_stop + 0.02
    bench.period(200)
    assert bench.drives.at_rest(bench.now), "a reset is possible once the drive is back"


def test_wheel_that_turns_is_not_at_rest(bench):
    bench.driving()
    assert not bench.drives.at_rest(bench.now)


def test_nothing_starts_again_by_itself_after_a_stop(bench):
    bench.driving()
    bench.drives.stop("~/stop", bench.now)
    bench.period(1000, velocity(*SPEED))
    assert bench.drives.set_command(velocity(*SPEED), bench.now) == "stopped: ~/stop"
    assert bench.asked() == [Demand.IDLE] * 4
    with pytest.raises(InputError, match="stopped: ~/stop"):
        bench.drives.enable(bench.now)


def test_reset_moves_nothing_and_enables_again_at_zero(bench):
    bench.driving()
    bench.drives.stop("~/stop", bench.now)
    bench.period(300, velocity(*SPEED))
    bench.drives.reset(bench.now)
    for _ in range(20):
        bench.period()
        assert bench.speeds() == [0.0] * 4
    assert bench.drives.phase is CanDrivesPhase.DRIVING
    assert [axis.resets for axis in bench.axes] == [1] * 4
    bench.period(100, velocity(*SPEED))
    assert bench.speeds() == pytest.approx(SPEED)


def test_drive_that_restarted_is_configured_again_by_the_reset(bench):
    bench.driving()
    bench.axes[1].state, bench.axes[1].fault_reason = AxisState.OFFLINE, "restarted (boot-up)"
    bench.hear(report(12, 0.0, 0.0))
    assert bench.drives.stop_reason == "front_right: restarted (boot-up)"
    bench.period(300)
    bench.drives.reset(bench.now)
    bench.period(10)
    assert bench.drives.phase is CanDrivesPhase.DRIVING


def test_fault_that_comes_back_after_the_reset_stops_again(bench):
    bench.driving()
    for _ in range(2):
        bench.axes[1].state, bench.axes[1].fault_reason = AxisState.FAULT, "fault"
        bench.period(300)
        assert bench.drives.stop_reason == "front_right: fault"
        bench.drives.reset(bench.now)
    bench.axes[1].fault_reason = "fault"
    bench.period(2)
    assert bench.drives.stop_reason == "front_right: fault"


def test_deactivating_stops_the_wheels_first(bench):
    bench.driving()
    bench.drives.disable(bench.now)
    bench.period()
    assert bench.asked() == [Demand.STOP] * 4
    bench.period(300)
    assert bench.asked() == [Demand.IDLE] * 4
    assert bench.drives.is_off
    bench.drives.enable(bench.now)
    bench.period(5)
    assert bench.drives.phase is CanDrivesPhase.DRIVING


class BrokenError(Exception):
    """Error of an unforeseen type."""


def breaks(axis):
    def tick(demand, setpoint, now):
        raise BrokenError("a codec that breaks")

    axis.tick = tick


@pytest.mark.parametrize("k", range(4))
def test_axis_that_fails_does_not_keep_the_others_from_being_stopped_at_once(bench, k):
    bench.driving()
    breaks(bench.axes[k])
    bench.period(1, velocity(*SPEED))
    others = sorted(COMMAND + node for i, node in enumerate(NODES) if i != k)
    assert sorted(f.id for f in bench.sent if f.data[:1] == b"s") == others
    assert {f.data[:1] for f in bench.sent if f.id != SYNC} == {b"s"}, "and no other command"
    name = bench.axes[k].settings.name
    assert bench.drives.stop_reason == f"{name}: BrokenError: a codec that breaks"
    del bench.axes[k].tick
    bench.period(300, velocity(*SPEED))
    assert bench.asked() == [Demand.IDLE] * 4


def test_every_stop_reaches_the_other_wheels_though_one_axis_fails(bench):
    bench.driving()
    breaks(bench.axes[0])
    frames = bench.drives.stop("~/stop", bench.now)
    assert sorted(frame.id for frame in frames) == [COMMAND + node for node in NODES[1:]]
    while bench.now - bench.drives._phase_began_at < bench.drives.longest_stop + 0.1:
        bench.period()
        assert len(bench.sent) == 4, "three wheels and the SYNC"
    assert bench.drives.stop_reason == "~/stop"
    assert [axis.asked[-1][0] for axis in bench.axes[1:]] == [Demand.IDLE] * 3


def test_failing_axis_ends_the_configuration(bench):
    bench.configure()
    breaks(bench.axes[2])
    bench.drives.tick(bench.now)
    assert bench.drives.phase is CanDrivesPhase.UNCONFIGURED
    assert bench.drives.stop_reason == (
        "not configured: rear_left: BrokenError: a codec that breaks"
    )


@pytest.mark.parametrize("speed", [1e4, -1e4])
def test_wheel_that_runs_away_does_not_hold_up_the_stop_of_the_others(bench, speed):
    bench.driving()
    bench.hear(report(NODES[0], 0.0, speed))
    assert "runs away" in bench.drives.stop_reason
    limit = bench.drives._setpoints.max_speed
    assert max(map(abs, bench.speeds())) <= limit
    bench.period(round(limit / bench.parameters.quick_stop_deceleration / PERIOD) + 2)
    assert bench.speeds() == pytest.approx([0.0] * 4, abs=1e-9)
    assert bench.asked() == [Demand.STOP] * 4, "still under power when they stand"


def test_lower_limits_do_not_take_the_power_off_wheels_that_still_turn(bench):
    bench.driving()
    before = bench.drives.longest_stop
    slow = {"nodes": NODES, "max_speed": 0.01, "direction": bench.parameters.direction}
    bench.drives.update_parameters(
        bench.robot, build(CanParameters, {f"can.{k}": v for k, v in slow.items()}, "can.")
    )
    assert bench.drives.longest_stop == before
    while any(abs(speed) > 1e-9 for speed in bench.speeds()):
        bench.period()
        assert Demand.IDLE not in bench.asked()
    assert bench.drives.stop_reason.startswith("front_left: runs away at 4.0 rad/s")


def test_speeds_after_torques_begin_at_those_of_the_wheels():
    bench = Bench(mode="torque").up()
    ratio = bench.robot.motor.gear_ratio
    turning = np.array([6.0, -3.0, 1.0, 5.0])
    for _ in range(5):
        bench.now += PERIOD
        bench.drives.set_command(WheelCommand(DriveMode.TORQUE, np.full(4, 0.5)), bench.now)
        bench.drives.tick(bench.now)
        for node, d, speed in zip(NODES, bench.parameters.direction, turning, strict=True):
            bench.hear(report(node, 0.0, speed * ratio * d))
    bench.now += PERIOD
    bench.drives.set_command(velocity(*(0.99 * turning)), bench.now)
    bench.drives.tick(bench.now)
    step = bench.parameters.acceleration * PERIOD
    assert bench.speeds() == pytest.approx(turning, abs=step)
    bench.period(1, velocity(0, 0, 0, 0))
    assert bench.speeds() == pytest.approx(turning, abs=2 * step), "a ramp to a far command"


def test_no_wheel_accelerates_when_time_stands_or_goes_back(bench):
    bench.driving()
    bench.drives.stop("~/stop", bench.now)
    last = np.abs(bench.speeds())
    for step in (0.0, -1.0, 0.0, -30.0, PERIOD, PERIOD, -0.1, PERIOD):
        bench.now += step
        bench.drives.tick(bench.now)
        speeds = np.abs(bench.speeds())
        assert (speeds <= last + 1e-9).all()
        last = speeds
    bench.drives.tick(bench.now + 1e6)
    assert Demand.DRIVE not in bench.asked()


@pytest.mark.parametrize("seed", range(3))
def test_jitter_of_the_periods_is_tolerated(bench, seed):
    bench.up()
    rng = np.random.default_rng(seed)
    for _ in range(500):
        bench.now += PERIOD * rng.uniform(-0.9, 1.0)
        bench.period(1, velocity(*SPEED))
    assert not bench.drives.stop_reason
    assert bench.speeds() == pytest.approx(SPEED)


def test_resets_without_a_stop_change_nothing(bench):
    bench.driving()
    for _ in range(50):
        bench.drives.reset(bench.now)
        bench.period(1, velocity(*SPEED))
    assert bench.drives.phase is CanDrivesPhase.DRIVING
    assert bench.speeds() == pytest.approx(SPEED)
    assert [axis.resets for axis in bench.axes] == [0] * 4


def test_reset_storm_while_a_drive_stays_in_fault_never_moves_a_wheel(bench):
    bench.driving()
    axis = bench.axes[1]
    axis.state, axis.fault_reason, axis.obedient = AxisState.FAULT, "fault", False
    axis.reset = lambda now: None
    bench.period(300)
    for _ in range(300):
        bench.drives.reset(bench.now)
        bench.period(1, velocity(*SPEED))
        assert bench.speeds() == [0.0] * 4
        assert bench.drives.phase is not CanDrivesPhase.DRIVING
    assert bench.drives.stop_reason == "front_right: fault"


def test_stop_while_the_drives_are_enabled_reaches_those_that_already_are(bench):
    bench.configure()
    bench.period(3)
    bench.axes[3].obedient = False
    bench.drives.enable(bench.now)
    bench.period(2)
    assert bench.drives.phase is CanDrivesPhase.ENABLING
    assert all_commanded_to_stop(bench.drives.stop("~/stop", bench.now))
    bench.period(60)
    assert bench.drives.is_off
    assert bench.asked() == [Demand.IDLE] * 4


def test_ramp_of_a_stale_command_continues_when_deactivated(bench):
    bench.driving()
    while max(bench.speeds()) > 3.5:
        bench.period()
    last = max(bench.speeds())
    bench.drives.disable(bench.now)
    while not bench.drives.is_off:
        bench.period()
        fastest = max(map(abs, bench.speeds()))
        assert fastest <= last + 1e-9
        last = fastest
    assert last == 0.0


def test_reports_before_the_configuration_stop_nothing(bench):
    bench.hear(report(NODES[0], 0.0, 1e5))
    bench.configure()
    bench.period(3)
    assert bench.drives.phase is CanDrivesPhase.IDLE
    assert not bench.drives.stop_reason


def test_one_dead_axis_gives_no_feedback_of_the_robot(bench):
    bench.driving()
    bench.drives.take_states()
    bench.silent = {12}
    for _ in range(20):
        bench.period()
        assert bench.drives.take_states() is None
    bench.silent = set()
    bench.period()
    assert bench.drives.take_states() is not None


# ---- the bus --------------------------------------------------------------------------------


def test_bus_failure_while_the_drives_are_configured_is_the_stop_reason(bench):
    bench.configure()
    assert bench.drives.on_bus_failure("frame 000#8001 not sent: queue full", bench.now) == []
    assert bench.drives.phase is CanDrivesPhase.UNCONFIGURED
    assert bench.drives.stop_reason == ("not configured: bus: frame 000#8001 not sent: queue full")
    bench.configure()
    bench.period(3)
    assert bench.drives.phase is CanDrivesPhase.IDLE
    assert not bench.drives.stop_reason, "the next attempt begins anew"


def test_second_host_that_reports_the_same_is_found(bench):
    bench.driving()
    for _ in range(ECHO_MEMORY):  # frames that this bench has not yet echoed
        bench.hear(bench.sent[0])
    assert not bench.drives.stop_reason
    bench.hear(bench.sent[0])
    assert bench.drives.stop_reason.startswith("another host commands the drives")


def test_own_echoes_are_recognised_and_counted(bench):
    bench.driving()
    for frame in bench.sent:
        assert bench.hear(frame) == []
    assert bench.drives.host_detector.counts["echo"] == 5
    assert not bench.drives.stop_reason


def test_unknown_short_and_foreign_frames_are_counted_and_change_nothing(bench):
    bench.driving()
    before = bench.drives.take_states()
    assert before is not None
    for frame in (
        CanFrame(0x7A5, b"12345678"),
        CanFrame(0x18B, b"123"),
        CanFrame(0x18B, b"12345678", extended=True),
    ):
        assert bench.hear(frame) == []
    assert bench.drives.host_detector.counts == {"unknown": 2, "malformed": 1}
    assert bench.drives.take_states() is None


def test_frozen_host_finds_its_commands_stale_and_its_wheels_lost(bench):
    bench.driving()
    bench.now += 1.0
    frames = bench.drives.tick(bench.now)
    assert all_commanded_to_stop(frames)
    assert bench.drives.stop_reason == "the bridge was held up for 1.00 s"


@pytest.mark.parametrize("gap", [0.15, 0.3, 1.5])
@pytest.mark.parametrize("frames_first", [False, True])
def test_ramp_continues_on_schedule_after_a_gap_of_the_host(bench, gap, frames_first):
    bench.driving()
    bench.now += gap
    if frames_first:  # old frames that waited in the interface
        for node, axis in zip(NODES, bench.axes, strict=True):
            bench.hear(report(node, 0.0, axis.asked[-1][1].value))
    bench.drives.tick(bench.now)
    assert bench.drives.stop_reason == f"the bridge was held up for {gap:.2f} s"
    fraction = max(1.0 - gap * bench.parameters.quick_stop_deceleration / 4.0, 0.0)
    assert bench.speeds() == pytest.approx(SPEED * fraction, abs=0.02)
    assert bench.asked() == [Demand.STOP] * 4


def test_drives_that_are_offline_are_commanded_to_stop_for_as_long_as_their_wheels_may_turn(bench):
    bench.driving()
    for axis in bench.axes:
        axis.obedient, axis.state = False, AxisState.OFFLINE
    bench.silent = set(NODES)
    began = bench.now
    bench.period(5)
    assert bench.drives.stop_reason
    while bench.asked() == [Demand.STOP] * 4 and bench.now < began + 60:
        bench.period()
    assert bench.now - began == pytest.approx(bench.drives.longest_stop, abs=0.1)


def test_limits_can_change_at_run_time(bench):
    bench.driving()
    lower = build(
        CanParameters,
        {f"can.{k}": v for k, v in {"nodes": NODES, "max_speed": 3.0}.items()},
        "can.",
    )
    bench.drives.update_parameters(bench.robot, lower)
    with pytest.raises(InputError, match=r"4\.0 rad/s; the limit is 3\.0"):
        bench.drives.set_command(velocity(*SPEED), bench.now)


def test_energy_is_the_integral_of_the_motors_power(bench):
    bench.up()
    for axis in bench.axes:
        axis.feedback.voltage, axis.feedback.current = 10.0, -2.0
    for _ in range(50):
        table = bench.drives.electrical(0.02)
    assert table[:, 2] == pytest.approx([-20.0] * 4)
    assert table[1, :2] == pytest.approx([-10.0, 2.0]), "in the wheel's direction"


def test_energy_omits_unknown_and_invalid_power(bench):
    bench.up()
    for axis, current in zip(bench.axes, (1.0, math.nan, math.inf, -math.inf), strict=True):
        axis.feedback.voltage, axis.feedback.current = 10.0, current
    bench.drives.electrical(0.5)
    assert bench.drives.electrical(0.5)[:, 2] == pytest.approx([10.0, 0.0, 0.0, 0.0])


# ---- what has moved ---------------------------------------------------------------------------


def test_drives_that_rest_have_not_moved(bench):
    bench.up().period(20, velocity(0, 0, 0, 0))
    assert not bench.drives.may_have_moved


@pytest.mark.parametrize(
    "command",
    [
        velocity(0, 0, 0, 0.1),
        WheelCommand(DriveMode.VELOCITY, np.array([0, 0, 0, 0.01]), np.zeros(4)),
    ],
    ids=["velocity", "feed-forward"],
)
def test_an_accepted_command_may_have_moved_the_drives_for_good(bench, command):
    bench.up().period(1, command)
    assert bench.drives.may_have_moved
    bench.drives.stop("button", bench.now)
    bench.period(200)
    assert bench.drives.may_have_moved


def test_a_refused_command_has_moved_nothing(bench):
    bench.configure().period(3)
    assert bench.drives.set_command(velocity(1, 1, 1, 1), bench.now)
    assert not bench.drives.may_have_moved


def test_a_wheel_that_rotates_under_power_has_moved(bench):
    bench.configure().period(3)
    ratio = bench.robot.motor.gear_ratio
    bench.hear(report(NODES[0], 0.0, 0.2 * ratio))
    assert not bench.drives.may_have_moved, "it has no power"
    bench.period(1)
    bench.drives.enable(bench.now)
    bench.period(3)
    bench.hear(report(NODES[0], 0.0, 0.2 * ratio))
    assert bench.drives.may_have_moved
    bench.period(1).drives.stop("button", bench.now)
    bench.period(200)
    assert bench.drives.may_have_moved
