import json
import math
import os
import signal
import time
from dataclasses import replace

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile
from robots import robot
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray

from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.identify_friction import confirm, truth_of, unlike
from omniman_ros.cli.identify_friction_bench import Bench, Drive, electrical_arrays
from omniman_ros.cli.identify_friction_record import FrictionRecord, Truth, load, save
from omniman_ros.cli.identify_friction_report import parameter_file, report
from omniman_ros.cli.identify_robot import LATCHED
from omniman_ros.cli.isolation import free_domain
from omniman_ros.cli.main import main
from omniman_ros.cli.progress import Progress
from omniman_ros.cli.session import Session
from omniman_ros.conversions import electrical
from omniman_ros.core.errors import InputError
from omniman_ros.core.friction_experiment import Phase, make_plan
from omniman_ros.core.friction_identification import SteadyRun, identify_friction
from omniman_ros.core.parameters import build, flatten_mapping
from omniman_ros.core.robot import Friction
from omniman_ros.nodes.registry import known_names
from omniman_ros.robots import robot_file

from .support import PATIENCE, Running, children_of, command, environment, is_alive, wait_until

IG42 = robot("ig42")
BACK_EMF, ETA, RESISTANCE = 0.78, 0.66, 1.85
A, B = np.array([0.005, 0.0034, 0.0044, 0.0028]), np.array([0.31, 0.21, 0.275, 0.175])


# ---- record and result -------------------------------------------------------------------------


def recorded(a=A, b=B, seed=4, back_emf=1.0, truth=None):
    """Runs as the experiment leaves them, with noise."""
    rng = np.random.default_rng(seed)
    runs = []
    for value in [18.0, 14.0, 8.0, 2.0, -18.0, -14.0, -8.0, -2.0] * 2:
        speed = np.full(4, value) + rng.normal(0.0, 0.01, 4)
        current = (a * speed + b * np.sign(speed)) / (ETA * BACK_EMF) + rng.normal(0, 1e-3, 4)
        volts = RESISTANCE * current + back_emf * BACK_EMF * speed
        spikes = rng.integers(0, 3, 4)
        runs.append(
            SteadyRun(volts, current, speed, np.full(4, 1e-3), np.ones(4, bool), 75, spikes)
        )
    return FrictionRecord(IG42, tuple(runs), truth)


def test_a_record_is_read_as_it_was_written(tmp_path):
    for record in (recorded(), recorded(truth=Truth(tuple(A.tolist()), tuple(B.tolist())))):
        save(record, tmp_path / "deep" / "runs.json")
        back = load(tmp_path / "deep" / "runs.json")
        assert back.robot == record.robot and back.truth == record.truth
        for one, other in zip(back.runs, record.runs, strict=True):
            for name in ("voltage", "current", "speed", "error", "steady", "spikes", "samples"):
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize(
    "text",
    [None, "", "{}", "[1]", '{"format": "omniman odometry runs 1"}',
     '{"format": "omniman friction runs 1"}'],
)  # fmt: skip
def test_a_file_that_is_no_record_is_refused(tmp_path, text, capsys):
    path = tmp_path / "runs.json"
    if text is not None:
        path.write_text(text)
    assert main(["identify", "friction", "--runs", str(path), "--results", str(tmp_path)]) == 2
    assert "holds no recorded runs" in capsys.readouterr().err


def test_recorded_runs_are_fitted_and_written(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    path = tmp_path / "runs.json"
    save(recorded(truth=Truth(tuple(A.tolist()), tuple(B.tolist()))), path)
    assert main(["identify", "friction", "--runs", str(path), "--results", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    result = json.loads(lines[-1])
    assert result == json.loads((tmp_path / "identify_friction.json").read_text())
    assert result["ok"] is True and result["warnings"] == []
    assert any("in the simulation" in line for line in lines)
    tree = yaml.safe_load((tmp_path / "friction.yaml").read_text())
    values = flatten_mapping(tree["/**"]["ros__parameters"])
    assert set(values) == {"friction.viscous", "friction.coulomb"} <= set(known_names())
    loaded = build(Friction, values, "friction.")
    np.testing.assert_allclose(loaded.viscous, A, rtol=0.05)
    np.testing.assert_allclose(loaded.coulomb, B, rtol=0.01)
    assert result["parameters"]["friction.coulomb"] == pytest.approx(loaded.coulomb, rel=1e-3)
    image = (tmp_path / "friction.png").read_bytes()
    assert image.startswith(b"\x89PNG") and len(image) > 20000


def test_the_robot_s_data_can_be_changed_afterwards(tmp_path, capsys):
    """With a gear of 0.8 for the IG42's 0.66 and another motor, the same currents are more."""
    path = tmp_path / "runs.json"
    save(recorded(), path)
    changed = tmp_path / "mine.yaml"
    values = yaml.safe_load(robot_file("ig42").read_text(encoding="utf-8"))
    values["/**"]["ros__parameters"]["motor"]["gear_efficiency"] = 0.8
    changed.write_text(yaml.safe_dump(values))
    arguments = ["identify", "friction", "--runs", str(path), "--results", str(tmp_path)]
    assert main([*arguments, "--robot", str(changed)]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])["parameters"]["friction.coulomb"]
    np.testing.assert_allclose(found, B * 0.8 / 0.66, rtol=0.01)


def test_a_motor_constant_that_is_off_is_warned_of_from_3_percent_on(tmp_path):
    def told(factor):
        record = recorded(back_emf=factor)
        return "\n".join(report(record, identify_friction(record.runs, IG42)))

    assert "WARNING" not in told(1.01) and "WARNING" not in told(0.98)
    assert told(1.06).count("WARNING") == 4
    assert "front_left: N K is 0.8268 V s/rad by voltage, current and speed, +6.0 % off" in told(
        1.06
    )


def test_directions_that_differ_and_friction_like_none_are_told():
    record = recorded(a=np.zeros(4))
    shifted = tuple(
        SteadyRun(run.voltage, run.current + [0.05, 0, 0, 0], run.speed, run.error, run.steady, 9,
                  run.spikes)
        for run in record.runs
    )  # fmt: skip
    text = "\n".join(report(record, identify_friction(shifted, IG42)))
    assert "front_left: the directions differ (p = " in text
    assert "front_right: the directions differ" not in text
    assert "a is not told from 0" in text


def test_the_parameter_file_has_intervals_and_nothing_below_zero():
    record = recorded(a=np.full(4, -0.002))
    text = parameter_file(identify_friction(record.runs, IG42))
    assert text.count("+-") == 8 + 1
    values = flatten_mapping(yaml.safe_load(text)["/**"]["ros__parameters"])
    assert values["friction.viscous"] == [0.0] * 4
    assert build(Friction, values, "friction.").viscous == (0.0,) * 4


def test_too_few_runs_write_nothing_and_name_the_wheel(tmp_path, capsys):
    path = tmp_path / "runs.json"
    record = recorded()
    save(replace(record, runs=record.runs[:5]), path)
    assert main(["identify", "friction", "--runs", str(path), "--results", str(tmp_path)]) == 1
    assert "'front_left': 1 of 5 runs were steady backwards" in capsys.readouterr().err
    assert not (tmp_path / "friction.yaml").exists()


# ---- command line ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-p", "plant.lifted:=true"], "-p is for --simulate"),
        (["--levels", "2"], "--levels 2 is not within 3 to 50"),
        (["--rounds", "0"], "--rounds 0"),
        (["--precision", "0"], "--precision 0"),
        (["--precision", "nan"], "--precision nan"),
        (["--simulate", "--robot", "nobody"], "nobody"),
        (["--simulate", "-p", "plant.lifted=true"], "is not NAME:=VALUE"),
    ],
)
def test_a_wrong_option_is_said_in_one_line(arguments, message, capsys):
    assert main(["identify", "friction", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_the_simulated_robot_is_other_than_configured_and_noisy():
    names = [text.partition(":=")[0] for text in unlike(robot("omni3"))]
    assert names == ["mismatch.friction", "mismatch.torque_constant", "faults.current_noise"]
    truth = truth_of(Drive("/drive", {"mismatch.friction": [2.0]}), IG42)
    assert truth == Truth((0.008,) * 4, (0.5,) * 4)


class Typing:
    """Lines from a list."""

    def __init__(self, *lines):
        self._lines = list(lines)

    def next(self, wait):
        wait()
        if not self._lines:
            raise CommandError("no more input: the poses cannot be typed in")
        return self._lines.pop(0)


def test_the_user_must_say_that_the_wheels_are_off_the_floor(capsys):
    asked = Typing("", "no", "maybe", " YES ", "never read")
    confirm(asked, lambda: None)
    assert capsys.readouterr().out.count("Are all wheels off the floor?") == 4
    assert asked.next(lambda: None) == "never read"
    with pytest.raises(CommandError, match="--lifted says so"):
        confirm(Typing("no"), lambda: None)


def test_a_stop_while_the_user_is_asked_keeps_its_reason():
    def stopped():
        raise CommandError("the emergency stop is on")

    with pytest.raises(CommandError, match="emergency stop"):
        confirm(Typing("yes"), stopped)


def test_electrical_values_come_back_from_the_message_that_the_drive_makes():
    rows = np.arange(12.0).reshape(4, 3)
    voltage, current = electrical_arrays(electrical(rows), 4)
    np.testing.assert_array_equal(voltage, rows[:, 0])
    np.testing.assert_array_equal(current, rows[:, 1])
    with pytest.raises(InputError, match="12 numbers, expected 9"):
        electrical_arrays(electrical(rows), 3)
    with pytest.raises(InputError, match="columns"):
        electrical_arrays(Float64MultiArray(data=[0.0] * 12), 4)


# ---- on topics, next to a drive that does what the test says ------------------------------------


class SharedSession(Session):
    """Serves the drive too, whenever the bench serves itself.

    Not with the events executor: it keeps its nodes alive, and here others come after them.
    """

    def __init__(self, drive):
        super().__init__("omniman_identify", events=False)
        self._drive = drive

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while True:
            self._drive.tick()
            super().spin(min(max(end - time.monotonic(), 0.0), 0.002))
            if time.monotonic() >= end:
                return

    def _spin_once(self, timeout):
        self._drive.tick()
        super()._spin_once(min(timeout, 0.002))


AMPS = np.array([0.4, 0.5, 0.6, 0.7])


class FakeDrive:
    """A drive in the test's own process, in a context of its own, that does what it is told."""

    def __init__(self):
        self.session = Session("fake_drive", events=False).__enter__()
        node = self.session.node
        self.states = node.create_publisher(JointState, "wheel_states", 50)
        self.electrical = node.create_publisher(Float64MultiArray, "wheel_electrical", 50)
        self.stop_state = node.create_publisher(DiagnosticStatus, "stop_state", LATCHED)
        node.create_subscription(JointState, "wheel_voltages", self._on_volts, 5000)
        self.volts, self.position = np.zeros(4), np.zeros(4)
        self.heard, self.given = [], []
        self.fault = None
        self.at = None
        self.ticks = 0
        self._last = time.monotonic()

    def _on_volts(self, message):
        self.heard.append(time.monotonic())
        self.given.append(list(message.effort))
        self.volts = np.array(message.effort)

    def close(self):
        self.session.__exit__(None, None, None)

    def tick(self):
        """Serve, and report when it is time: 100 and 50 times a second."""
        self.session.spin(0.0)
        now = time.monotonic()
        if now - self._last < 0.01:
            return
        step, self._last, self.ticks = now - self._last, now, self.ticks + 1
        free = np.maximum(np.abs(self.volts) - 0.9, 0.0) / BACK_EMF
        speed = np.sign(self.volts) * free
        self.position += step * speed
        current = np.sign(self.volts) * AMPS
        # in an order of its own
        message = JointState(
            name=list(IG42.wheels.names)[::-1],
            position=self.position[::-1].tolist(),
            velocity=speed[::-1].tolist(),
        )
        message.header.stamp = self.session.node.get_clock().now().to_msg()
        rows = np.column_stack([self.volts, current, np.zeros(4)])[::-1].copy()
        if self.fault is not None and self.fault(message, rows):
            return
        self.states.publish(message)
        if self.ticks % 2 == 0:
            self.electrical.publish(electrical(rows))


_seen = set()


@pytest.fixture
def own_domain(monkeypatch):
    """A domain that no test before it used: what a failed one leaves is in this process still."""
    domain = next(d for d in iter(free_domain, None) if d not in _seen)
    _seen.add(domain)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


@pytest.fixture
def bench(own_domain):
    """A bench that has met its fake drive, with a quick plan."""
    drive = FakeDrive()
    events = []

    def poll():
        if drive.at is not None and made.experiment is not None:
            events.append(drive.at(made.experiment))

    with SharedSession(drive) as session:
        made = Bench(session, Progress(), poll)
        made.drive = drive
        made.plan = replace(
            make_plan(IG42, levels=3, rounds=1), shortest=0.4, settle=2.0, ramp=60.0, silence=1.0
        )
        made.meet(IG42)
        try:
            yield made
        finally:
            drive.close()


def assert_rest(drive):
    """The last voltages that the drive heard are zero, and it heard some that were not."""
    drive.session.wait(lambda: drive.given[-1] == [0.0] * 4, 5.0)
    assert drive.given[-1] == [0.0] * 4
    assert np.abs(drive.given).max() > 1.0


@pytest.mark.processes
def test_all_levels_are_given_and_the_wheels_rest(bench):
    experiment = bench.turn(bench.plan)
    assert experiment.phase is Phase.DONE and len(experiment.runs) == 6
    for run, level in zip(experiment.runs, bench.plan.levels, strict=True):
        np.testing.assert_allclose(run.voltage, level * bench.plan.signs)
        np.testing.assert_allclose(np.abs(run.current), AMPS)
        np.testing.assert_allclose(np.abs(run.speed), (abs(level) - 0.9) / BACK_EMF, rtol=0.1)
    assert_rest(bench.drive)
    assert np.median(np.diff(bench.drive.heard)) < 0.02, "at 50 Hz or more"


def first_run(do):
    """A reaction to the first level: done once, from then on."""

    def at(experiment):
        if experiment.reached == 0 and experiment.phase is not Phase.RAMP:
            do()

    return at


def nan_position(message, rows):
    message.position[1] = math.nan


def wrong_names(message, rows):
    message.name = ["a", "b", "c", "d"]


def nan_current(message, rows):
    rows[2, 1] = math.nan


def silent(message, rows):
    return True


@pytest.mark.processes
@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (nan_position, "wheel_states cannot be used: .*not finite"),
        (wrong_names, "wheel_states cannot be used: no front_left"),
        (nan_current, "wheel_electrical cannot be used: .*not finite"),
        (silent, "no wheel_(states|electrical) for"),
    ],
)
def test_feedback_that_is_nonsense_or_silent_brings_the_wheels_to_rest(bench, fault, message):
    drive = bench.drive
    drive.at = first_run(lambda: setattr(drive, "fault", fault))
    with pytest.raises(CommandError, match=message):
        bench.turn(bench.plan)
    drive.fault = None
    assert_rest(drive)


@pytest.mark.processes
def test_a_stop_of_the_drive_ends_it_with_zero_at_once(bench):
    drive = bench.drive
    stopped = DiagnosticStatus(
        level=DiagnosticStatus.ERROR, name="/fake_drive", message="stopped: ~/stop"
    )
    drive.at = first_run(lambda: drive.stop_state.publish(stopped))
    with pytest.raises(CommandError, match=r"/fake_drive is stopped: ~/stop: `omniman reset`"):
        bench.turn(bench.plan)
    assert_rest(drive)
    given = np.abs(drive.given).max(axis=1)
    last = np.flatnonzero(given)[-1]
    assert given[last] == pytest.approx(bench.plan.levels[0]), "no ramp in between"


@pytest.mark.processes
@pytest.mark.parametrize("qos", [LATCHED, QoSProfile(depth=1)])
def test_the_emergency_stop_ends_it_latched_or_not(bench, qos):
    drive = bench.drive
    button = drive.session.node.create_publisher(Bool, "emergency_stop", qos)
    drive.at = first_run(lambda: button.publish(Bool(data=True)))
    with pytest.raises(CommandError, match="the emergency stop is on"):
        bench.turn(bench.plan)
    assert_rest(drive)


@pytest.mark.processes
@pytest.mark.parametrize("topic", ["wheel_voltages", "wheel_commands"])
def test_somebody_else_who_commands_the_wheels_ends_it(bench, topic):
    drive = bench.drive
    others = []

    def come():
        if not others:
            others.append(drive.session.node.create_publisher(JointState, topic, 1))

    drive.at = first_run(come)
    # By its name, or, where only its publisher was discovered so far, without.
    with pytest.raises(CommandError, match=f"publishes '{topic}'"):
        bench.turn(bench.plan)
    assert_rest(drive)


@pytest.mark.processes
def test_ctrl_c_ramps_down(bench):
    drive = bench.drive
    pressed = []

    def press():
        if not pressed:
            pressed.append(True)
            raise KeyboardInterrupt

    drive.at = first_run(press)
    with pytest.raises(KeyboardInterrupt):
        bench.turn(bench.plan)
    assert_rest(drive)
    given = np.abs(drive.given).max(axis=1)
    down = given[np.flatnonzero(given)[-1]]
    assert down < 0.2 * bench.plan.levels[0], "a ramp, no jump"


# ---- real processes ----------------------------------------------------------------------------


@pytest.mark.processes
def test_it_does_not_begin_next_to_a_controller(own_domain):
    """Refused before anything is published, and whatever the user says."""
    tool = command("identify", "friction", "--lifted")
    with Session("platform_controller", events=False) as controller:
        controller.node.create_publisher(JointState, "wheel_commands", 1)
        with Running(tool, dict(os.environ)) as running:
            assert running.finish() == 1
    assert "/platform_controller publishes 'wheel_commands'" in running.output
    assert "two must not command the wheels" in running.output
    assert "LIFT" not in running.output


@pytest.mark.processes
def test_ctrl_c_ends_a_simulation_with_130_and_leaves_nothing(tmp_path):
    arguments = ("identify", "friction", "--simulate", "--results", str(tmp_path))
    with Running(command(*arguments), environment()) as running:
        running.wait_for("the wheels turn freely")
        pids = children_of(running.process.pid)
        assert len(pids) == 1
        running.process.send_signal(signal.SIGINT)
        assert running.process.wait(timeout=PATIENCE) == 130
        wait_until(lambda: not any(map(is_alive, pids)), "the end of the node")
    assert not list(tmp_path.iterdir()), "no run was whole, nothing is kept"


@pytest.mark.processes
def test_a_running_drive_on_the_floor_is_found_out(tmp_path):
    """Lifted, says the user; the drive's wheels say otherwise."""
    env = environment()
    up = command("up", "--robot", "ig42", "--only", "simulated_drive")
    tool = command("identify", "friction", "--lifted", "--results", str(tmp_path))
    with Running(up, env) as drive, Running(tool, env) as running:
        assert running.finish() == 1, running.output
        assert "LIFT THE ROBOT" in running.output
        assert "does it touch the floor" in running.output
        drive.process.send_signal(signal.SIGINT)
        drive.process.wait(timeout=PATIENCE)
    assert not list(tmp_path.iterdir())
