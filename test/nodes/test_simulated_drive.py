"""The simulated drive's node over real topics, on simulated time."""

import math
from unittest.mock import Mock

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import Trigger

from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.simulated_clock import SimulatedClock
from omniman_ros.nodes.simulated_drive import SimulatedDriveNode
from test.nodes.harness import World, last
from test.tiers import exhaustive

NAMES = ["front_left", "front_right", "rear_left", "rear_right"]
NAN, INF = float("nan"), float("inf")


class Drive(World):
    """The node on its own, commanded by the test."""

    def __init__(self, parameters: dict | None = None) -> None:
        super().__init__(SimulatedDriveNode, parameters=parameters)
        self.node: SimulatedDriveNode = self.nodes[0]
        self.states = self.listen(JointState, "wheel_states")
        self.truth = self.listen(Odometry, "ground_truth/odom")
        self._commands = self.publisher(JointState, "wheel_commands")
        self._voltages = self.publisher(JointState, "wheel_voltages")

    def message(self, velocity=(), effort=(), age: float = 0.0, names=NAMES) -> JointState:
        message = JointState(
            name=names, velocity=[*map(float, velocity)], effort=[*map(float, effort)]
        )
        message.header.stamp = self.stamp(-age)
        return message

    def command(self, seconds: float, *args, **options) -> None:
        self.run(seconds, lambda: self._commands.publish(self.message(*args, **options)))

    def volts(self, seconds: float, volts, **options) -> None:
        self.run(seconds, lambda: self._voltages.publish(self.message(effort=volts, **options)))

    def set(self, name: str, value: object) -> object:
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        return self.call(SetParameters, "simulated_drive/set_parameters", request).results[0]

    @property
    def speeds(self) -> np.ndarray:
        """Return the true wheel speeds (n,)."""
        return np.array([wheel.speed for wheel in self.node.drives._plant.wheels])


@pytest.fixture
def drive():
    with Drive() as drive:
        yield drive


def test_velocity_mode_turns_the_wheels_and_moves_the_robot(drive):
    drive.command(1.5, [3.0, 3.0, 3.0, 3.0])
    state = last(drive.states)
    assert list(state.name) == NAMES
    assert list(state.velocity) == pytest.approx([3.0] * 4, abs=0.05)
    truth = last(drive.truth)
    assert truth.twist.twist.linear.x == pytest.approx(3.0 * 0.127, abs=0.01)
    assert truth.header.frame_id == "map"


def test_torque_and_voltage_modes_move_the_robot(drive):
    drive.command(0.5, effort=[2.0, 2.0, 2.0, 2.0])
    speed = last(drive.truth).twist.twist.linear.x
    assert speed > 0.05
    drive.volts(0.5, [12.0] * 4)
    assert last(drive.truth).twist.twist.linear.x > speed


@pytest.mark.parametrize(
    "way",
    [
        lambda drive: drive.command(0.5, [3.0] * 4, age=0.5),
        lambda drive: drive.command(0.5, effort=[2.0] * 4, age=0.5),
        lambda drive: drive.volts(0.5, [12.0] * 4, age=0.5),
    ],
    ids=["velocity", "torque", "voltage"],
)
def test_a_stale_command_moves_nothing(drive, way):
    way(drive)
    assert np.abs(drive.speeds).max() < 0.02


def test_a_reset_in_motion_is_refused_and_one_at_rest_lets_commands_move_the_wheels(drive):
    drive.command(1.0, [4.0] * 4)
    service(drive)
    refused = drive.call(Trigger, "simulated_drive/reset")
    assert not refused.success and drive.speeds.min() > 1.0
    drive.run(1.0)
    assert drive.call(Trigger, "simulated_drive/reset").success
    drive.command(1.0, [3.0] * 4)
    assert drive.speeds == pytest.approx([3.0] * 4, abs=0.1)


def test_topics_have_their_rates_and_the_electrical_layout(drive):
    electrical = drive.listen(Float64MultiArray, "wheel_electrical")
    before = len(drive.states), len(drive.truth), len(electrical)
    drive.command(1.0, [3.0] * 4)
    assert len(drive.states) - before[0] == pytest.approx(200, abs=1)
    assert len(drive.truth) - before[1] == pytest.approx(100, abs=1)
    assert len(electrical) - before[2] == pytest.approx(50, abs=1)
    message = last(electrical)
    assert [(d.label, d.size) for d in message.layout.dim] == [
        ("wheel", 4),
        ("voltage,current,energy", 3),
    ]
    voltage, current, energy = np.array(message.data).reshape(4, 3).T
    assert (voltage > 0).all() and (current > 0).all() and (energy > 0).all()


def silence(drive: Drive) -> None:
    drive.run(0.1)


def service(drive: Drive) -> None:
    assert drive.call(Trigger, "simulated_drive/stop").success


def emergency(drive: Drive) -> Publisher:
    button = drive.publisher(Bool, "emergency_stop")
    button.publish(Bool(data=True))
    return button


def shutdown(drive: Drive) -> None:
    drive.node.begin_shutdown("SIGTERM")


def nan_commands(drive: Drive) -> None:
    drive.command(0.1, [NAN] * 4)


@pytest.mark.parametrize(
    "way", [silence, service, emergency, shutdown, nan_commands], ids=lambda way: way.__name__
)
@pytest.mark.parametrize("mode", ["velocity", "torque", exhaustive("voltage")])
def test_every_cause_of_a_stop_stops_every_wheel(drive, way, mode):
    speeds = [4.0, 3.0, 3.0, 4.0]
    drive.command(1.0, speeds)
    if mode == "torque":
        drive.command(0.1, effort=[1.0] * 4)
    elif mode == "voltage":
        drive.volts(0.1, [10.0] * 4)
    assert drive.speeds.min() > 1.0
    way(drive)
    fastest = []
    drive.run(1.0, lambda: fastest.append(np.abs(drive.speeds).max()))
    assert fastest[-1] < 0.02
    steps = -np.diff(fastest)
    assert steps.max() < 16.0 * 0.005 + 0.05, "faster than the quick stop allows"


def test_the_last_ground_truth_before_the_end_is_that_of_rest_and_is_delivered():
    with Drive({"truth_rate": 2.0}) as drive:
        drive.command(1.5, [3.0] * 4)
        drive.node.begin_shutdown("SIGTERM")
        while not drive.node.finished:
            drive.run(0.005)
        assert abs(last(drive.truth).twist.twist.linear.x) < 0.02
        assert [p.topic_name for p in drive.node.final_publishers] == ["/ground_truth/odom"]


def test_message_loss_and_delay_change_at_runtime(drive):
    assert drive.set("faults.lost_messages", 1.0).successful
    drive.run(0.1)
    count = len(drive.states)
    drive.run(0.5)
    assert len(drive.states) == count
    assert drive.set("faults.lost_messages", 0.0).successful
    assert drive.set("faults.late_messages", 0.2).successful
    drive.run(0.5)
    stamp = last(drive.states).header.stamp
    assert drive.time - (stamp.sec + 1e-9 * stamp.nanosec) == pytest.approx(0.2, abs=0.011)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("plant.slip_velocity", -1.0),
        ("mismatch.friction", [1.0, 2.0]),
        ("firmware.watchdog", NAN),
        ("wheels.x", [0.0] * 4),
    ],
)
def test_invalid_parameters_are_rejected(drive, name, value):
    before = drive.node.settings.value
    assert not drive.set(name, value).successful
    assert drive.node.settings.value == before


def test_simulated_clock_is_published():
    """This runs at ten times real time and is the only test here on the steady clock."""
    from rosgraph_msgs.msg import Clock

    given = {"use_sim_time": False, "publish_clock": True, "real_time_factor": 10.0}
    with World(SimulatedDriveNode, parameters=given) as world:
        clocks = world.listen(Clock, "/clock")
        states = world.listen(JointState, "wheel_states")
        world._await(lambda: len(clocks) > 100 and len(states) > 100, "a hundred clocks")
        times = [c.clock.sec + 1e-9 * c.clock.nanosec for c in clocks]
        steps = np.diff(times) / 0.005  # a busy subscriber may miss some messages
        assert (steps > 0.5).all() and steps == pytest.approx(np.round(steps), abs=1e-3)
        stamp = states[50].header.stamp
        assert stamp.sec + 1e-9 * stamp.nanosec < 100.0, "stamps are in simulated time"


def test_the_diagnostics_name_the_nodes_for_which_simulated_time_stands(monkeypatch):
    given = {"use_sim_time": False, "publish_clock": True}
    with World(SimulatedDriveNode, parameters=given) as world:
        values = dict(world.nodes[0].status()[2])
        assert (values["real_time_factor"], values["waiting_for"]) == (1.0, "")
        monkeypatch.setattr(SimulatedClock, "awaited", ["/a", "/b"])
        assert dict(world.nodes[0].status()[2])["waiting_for"] == "/a /b"


@pytest.mark.parametrize(("duration", "resets"), [(0.004, 0), (0.006, 1)])
def test_a_tick_that_takes_longer_than_its_period_gives_way(drive, monkeypatch, duration, resets):
    now, timer = [drive.time], Mock()

    def tick() -> None:
        now[0] += duration

    monkeypatch.setattr(OmnimanNode, "now", lambda node: now[0])
    monkeypatch.setattr(drive.node, "tick", tick)
    monkeypatch.setattr(drive.node, "_timer", timer)
    drive.node.tick_in_time()
    assert timer.reset.call_count == resets


def test_drive_fault_latches_a_stop_and_is_published(drive):
    from diagnostic_msgs.msg import DiagnosticStatus

    from omniman_ros.nodes.stop_interface import LATCHED

    states = drive.listen(DiagnosticStatus, "stop_state", LATCHED)
    assert drive.set("firmware.encoder_tolerance", 0.1).successful
    assert drive.set("faults.frozen_encoder", ["rear_left"]).successful
    drive.command(1.0, [2.0] * 4)
    assert last(states).level == DiagnosticStatus.ERROR and "rear_left" in last(states).message
    assert drive.call(Trigger, "simulated_drive/reset").success, "the wheels are at rest"
    drive.command(1.0, [2.0] * 4)
    assert "rear_left" in last(states).message, "the fault is still there"


def test_stopped_drive_warns_only_of_commands_to_move(drive):
    service(drive)
    drive.command(0.2, [0.0] * 4)
    assert "wheel_commands refused" not in drive.node.warning_counts
    drive.command(0.2, [1.0] * 4)
    assert drive.node.warning_counts["wheel_commands refused"] > 30


def test_the_plants_mass_is_where_the_arm_is():
    with Drive({"robot": "omniman", "arm.mass": 40.0}) as drive:
        arm, plant = drive.publisher(JointState, "arm/joint_states"), drive.node.drives._plant
        loads = []
        for pan in (0.0, math.pi / 2, math.nan):
            message = JointState(name=list(UR_JOINTS), position=[pan, 0.0, 0.0, 0.0, 0.0, 0.0])
            message.header.stamp = drive.stamp()
            arm.publish(message)
            drive.run(0.06)
            loads.append(np.array(plant._loads))
        ahead, left, held = loads
        assert ahead[:2].sum() > 1.8 * ahead[2:].sum()
        assert left[[0, 2]].sum() > 1.8 * left[[1, 3]].sum()
        np.testing.assert_array_equal(left, held)
        assert drive.node.warning_counts["arm/joint_states"] == 1
        assert drive.set("friction.mu", 0.3).successful  # other parameters leave the posture
        np.testing.assert_array_equal(plant._loads, left)
        assert drive.set("arm.mass", 200.0).successful  # beside the wheels: the plant cannot tip
        assert drive.node.warning_counts["posture"] == 1
        assert np.isfinite(plant._loads).all()


def test_a_stamp_is_read_by_the_clock_that_the_drive_publishes():
    given = {"use_sim_time": False, "publish_clock": True}
    with World(SimulatedDriveNode, parameters=given) as world:
        node = world.nodes[0]
        now, sent = node.now(), node.stamp(node.now())
        assert node.instant(sent) == pytest.approx(now, abs=1e-6)


def test_steps_of_simulated_time_that_no_node_would_permit_are_refused():
    given = {"use_sim_time": False, "publish_clock": True, "state_rate": 99.0}
    with pytest.raises(ParameterError, match=r"state_rate.*at least 100 Hz"):
        World(SimulatedDriveNode, parameters=given)
