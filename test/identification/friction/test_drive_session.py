"""The friction experiment over topics, with a fake drive, on stepped time."""

import argparse
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray

from omniman_ros.console.errors import CommandError
from omniman_ros.console.progress import Progress
from omniman_ros.conversions.wheels import electrical_arrays, electrical_message
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import flatten
from omniman_ros.identification.friction import command as friction_command
from omniman_ros.identification.friction.drive_session import DriveSession
from omniman_ros.identification.friction.experiment import ExperimentPhase
from omniman_ros.identification.friction.record import load
from omniman_ros.identification.friction.voltage_plan import make_plan
from omniman_ros.identification.node_access import LATCHED
from test.nodes.harness import PERIOD, World
from test.robots import robot

IG42 = robot("ig42")
BACK_EMF = 0.78
AMPERES = np.array([0.4, 0.5, 0.6, 0.7])


def test_electrical_values_are_those_of_the_message_that_the_drive_makes():
    rows = np.arange(12.0).reshape(4, 3)
    voltage, current = electrical_arrays(electrical_message(rows), 4)
    np.testing.assert_array_equal(voltage, rows[:, 0])
    np.testing.assert_array_equal(current, rows[:, 1])
    with pytest.raises(InputError, match="12 numbers, expected 9"):
        electrical_arrays(electrical_message(rows), 3)
    with pytest.raises(InputError, match="columns"):
        electrical_arrays(Float64MultiArray(data=[0.0] * 12), 4)


class SteppedSession:
    """Stands in for a command's session: time passes only while the command serves ROS."""

    def __init__(self, world):
        self.world = world
        self.node = world.probe

    def spin(self, seconds):
        self.world.run(max(seconds, PERIOD))

    def wait(self, condition, timeout):
        end = self.world.time + timeout
        while not condition():
            if self.world.time >= end:
                return False
            self.world.run(PERIOD)
        return True


class FakeDrive(Node):
    """A drive whose wheels reach their speed at once; `fault` changes or swallows its feedback."""

    def __init__(self, context, parameter_overrides):
        super().__init__("fake_drive", context=context)
        for name, value in flatten(IG42).items():
            self.declare_parameter(name, list(value) if isinstance(value, tuple) else value)
        self.states = self.create_publisher(JointState, "wheel_states", 50)
        self.electrical = self.create_publisher(Float64MultiArray, "wheel_electrical", 50)
        self.stop_state = self.create_publisher(DiagnosticStatus, "stop_state", LATCHED)
        self.create_subscription(JointState, "wheel_voltages", self._on_voltages, 5000)
        self.voltages, self.position = np.zeros(4), np.zeros(4)
        self.received_at, self.received = [], []
        self.fault = None
        self.ticks = itertools.count()
        self.world = None

    def _on_voltages(self, message):
        self.received_at.append(self.world.time)
        self.received.append(list(message.effort))
        self.voltages = np.array(message.effort)

    def tick(self):
        """Publish states 100 times, and electrical values 50 times a second."""
        tick = next(self.ticks)
        if tick % 2:
            return
        free = np.maximum(np.abs(self.voltages) - 0.9, 0.0) / BACK_EMF
        speed = np.sign(self.voltages) * free
        self.position += 2 * PERIOD * speed
        current = np.sign(self.voltages) * AMPERES
        message = JointState(  # the wheels are in another order than the robot's
            name=list(IG42.wheels.names)[::-1],
            position=self.position[::-1].tolist(),
            velocity=speed[::-1].tolist(),
        )
        message.header.stamp = self.world.stamp()
        rows = np.column_stack([self.voltages, current, np.zeros(4)])[::-1].copy()
        if self.fault is not None and self.fault(message, rows):
            return
        self.states.publish(message)
        if tick % 4 == 0:
            self.electrical.publish(electrical_message(rows))


class Bench:
    """A drive session beside its fake drive.

    Attributes:
        react: Called with the experiment many times a second, once it has begun.
    """

    def __init__(self, world):
        self.world = world
        (self.drive,) = world.nodes
        self.drive.world = world
        world.hooks.append(self.drive.tick)
        self.react = lambda experiment: None
        self.session = DriveSession(
            SteppedSession(world), Progress(), self._poll, lambda: world.time
        )
        world._await(lambda: self.drive.states.get_subscription_count() > 0, "a match")
        world._await(lambda: self.drive.electrical.get_subscription_count() > 0, "a match")
        self.plan = replace(
            make_plan(IG42, levels=3, rounds=1, feedback_timeout=1.0),
            min_measurement=0.4,
            settle_timeout=2.0,
            ramp_rate=60.0,
        )

    def _poll(self):
        if self.session.experiment is not None:
            self.react(self.session.experiment)

    def assert_rest(self):
        """The last voltages that the drive received are zero, and earlier ones were not."""
        self.world.run_until(lambda: self.drive.received[-1] == [0.0] * 4, 5.0, "zero voltages")
        assert np.abs(self.drive.received).max() > 1.0


@pytest.fixture
def bench():
    with World(FakeDrive) as world:
        yield Bench(world)


class SteppedContext(SteppedSession):
    """A stepped session as a context manager, in place of the session that a command opens."""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None


@pytest.fixture
def connected(bench):
    bench.session.connect(IG42)
    return bench


def during_first_level(do):
    """A reaction to the first level, repeated from then on."""

    def react(experiment):
        if experiment.level_index == 0 and experiment.phase is not ExperimentPhase.RAMP:
            do()

    return react


def once(do):
    done = []

    def do_once():
        if not done:
            done.append(True)
            do()

    return do_once


# ---- before the experiment -------------------------------------------------------------------


def test_the_drive_is_found_with_the_robot_that_it_is_configured_for(bench):
    drive = bench.session.find_drive(("mismatch.friction",))
    assert drive.name == "/fake_drive"
    assert tuple(drive.values["wheels.names"]) == IG42.wheels.names
    assert drive.values["motor.gear_ratio"] == IG42.motor.gear_ratio
    assert "mismatch.friction" not in drive.values, "the drive does not have this parameter"


def test_a_drive_on_simulated_time_is_refused(bench):
    bench.drive.declare_parameter("publish_clock", True)
    with pytest.raises(CommandError, match="/fake_drive runs on simulated time"):
        bench.session.find_drive()


def test_a_drive_that_publishes_no_states_is_not_found(bench):
    bench.drive.destroy_publisher(bench.drive.states)
    bench.world.hooks.clear()
    bench.world._await(lambda: not bench.world.probe.count_publishers("wheel_states"), "its end")
    with pytest.raises(CommandError, match="nobody publishes 'wheel_states'"):
        bench.session.find_drive()


def test_a_drive_that_a_controller_commands_is_refused(bench):
    controller = bench.drive.create_publisher(JointState, "wheel_commands", 1)
    world = bench.world
    world._await(lambda: world.probe.count_publishers(controller.topic_name) > 0, "its discovery")
    with pytest.raises(CommandError, match="publishes 'wheel_commands': two must not command"):
        bench.session.find_drive()
    assert bench.drive.received == []


def test_missing_feedback_is_named(bench):
    bench.drive.fault = missing
    with pytest.raises(CommandError, match=r"nothing received .* wheel_electrical, wheel_states"):
        bench.session.connect(IG42)


# ---- the experiment --------------------------------------------------------------------------


def test_all_levels_are_applied_and_the_wheels_come_to_rest(connected):
    experiment = connected.session.run(connected.plan)
    assert experiment.phase is ExperimentPhase.DONE and len(experiment.runs) == 6
    for run, level in zip(experiment.runs, connected.plan.levels, strict=True):
        np.testing.assert_allclose(run.voltage, level * connected.plan.signs)
        np.testing.assert_allclose(np.abs(run.current), AMPERES)
        np.testing.assert_allclose(np.abs(run.speed), (abs(level) - 0.9) / BACK_EMF, rtol=0.1)
    connected.assert_rest()
    assert np.median(np.diff(connected.drive.received_at)) < 0.02, "at 50 Hz or more"


def nan_position(message, rows):
    message.position[1] = math.nan


def wrong_names(message, rows):
    message.name = ["a", "b", "c", "d"]


def nan_current(message, rows):
    rows[2, 1] = math.nan


def missing(message, rows):
    return True


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (nan_position, "wheel_states cannot be used: .*not finite"),
        (wrong_names, "wheel_states cannot be used: there is no front_left"),
        (nan_current, "wheel_electrical cannot be used: .*not finite"),
        (missing, "no wheel_(states|electrical) for"),
    ],
)
def test_invalid_or_missing_feedback_brings_the_wheels_to_rest(connected, fault, message):
    drive = connected.drive
    connected.react = during_first_level(lambda: setattr(drive, "fault", fault))
    with pytest.raises(CommandError, match=message):
        connected.session.run(connected.plan)
    drive.fault = None
    connected.assert_rest()


def test_a_stop_of_the_drive_ends_it_with_zero_at_once(connected):
    drive = connected.drive
    stopped = DiagnosticStatus(
        level=DiagnosticStatus.ERROR, name="/fake_drive", message="stopped: ~/stop"
    )
    connected.react = during_first_level(lambda: drive.stop_state.publish(stopped))
    with pytest.raises(CommandError, match=r"/fake_drive is stopped: ~/stop: `omniman reset`"):
        connected.session.run(connected.plan)
    connected.assert_rest()
    magnitudes = np.abs(drive.received).max(axis=1)
    last = np.flatnonzero(magnitudes)[-1]
    assert magnitudes[last] == pytest.approx(connected.plan.levels[0]), "no ramp in between"


@pytest.mark.parametrize("qos", [LATCHED, QoSProfile(depth=1)])
def test_the_emergency_stop_ends_it_latched_or_not(connected, qos):
    button = connected.drive.create_publisher(Bool, "emergency_stop", qos)
    connected.world._await(lambda: button.get_subscription_count() > 0, "a match")
    connected.react = during_first_level(lambda: button.publish(Bool(data=True)))
    with pytest.raises(CommandError, match="the emergency stop is on"):
        connected.session.run(connected.plan)
    connected.assert_rest()


@pytest.mark.parametrize("topic", ["wheel_voltages", "wheel_commands"])
def test_another_publisher_of_commands_ends_it(connected, topic):
    world = connected.world

    def appear():
        count = world.probe.count_publishers(topic)
        connected.drive.create_publisher(JointState, topic, 1)
        world._await(lambda: world.probe.count_publishers(topic) > count, "its discovery")

    connected.react = during_first_level(once(appear))
    # Its name, or, where only its publisher was discovered so far, that it is unknown.
    with pytest.raises(CommandError, match=f"publishes '{topic}'"):
        connected.session.run(connected.plan)
    connected.assert_rest()


def test_ctrl_c_ramps_down(connected):
    def press():
        raise KeyboardInterrupt

    connected.react = during_first_level(once(press))
    with pytest.raises(KeyboardInterrupt):
        connected.session.run(connected.plan)
    connected.assert_rest()
    magnitudes = np.abs(connected.drive.received).max(axis=1)
    down = magnitudes[np.flatnonzero(magnitudes)[-1]]
    assert down < 0.2 * connected.plan.levels[0], "a ramp, no jump"


def test_the_command_measures_and_keeps_its_runs(bench, monkeypatch, tmp_path, capsys):
    world = bench.world
    monkeypatch.setattr(friction_command, "Session", lambda *_: SteppedContext(world))
    monkeypatch.setattr(friction_command, "DriveSession", lambda *_: bench.session)
    bench.drive.declare_parameter("mismatch.friction", [1.2])
    args = argparse.Namespace(
        namespace="", robot=None, levels=3, rounds=1, precision=20.0, results=str(tmp_path)
    )
    record = friction_command.measure(args, lambda: None, None, is_simulated=True)
    assert len(record.runs) == 6 and record.robot == IG42
    assert record.truth.coulomb == pytest.approx([1.2 * b for b in IG42.friction.coulomb])
    kept = load(tmp_path / "identify_friction_runs.json")
    assert len(kept.runs) == 6 and kept.truth == record.truth
    assert "/fake_drive is running" in capsys.readouterr().out
    bench.assert_rest()


def test_an_interrupted_command_keeps_its_complete_runs(bench, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(friction_command, "Session", lambda *_: SteppedContext(bench.world))
    monkeypatch.setattr(friction_command, "DriveSession", lambda *_: bench.session)

    def interrupt_second_level(experiment):
        if experiment.level_index == 1:
            raise KeyboardInterrupt

    bench.react = interrupt_second_level
    args = argparse.Namespace(
        namespace="", robot="ig42", levels=3, rounds=1, precision=20.0, results=str(tmp_path)
    )
    with pytest.raises(KeyboardInterrupt):
        friction_command.measure(args, lambda: None, None, is_simulated=False)
    assert len(load(tmp_path / "identify_friction_runs.json").runs) == 1
    assert "LIFT THE ROBOT" in capsys.readouterr().out
    bench.assert_rest()
