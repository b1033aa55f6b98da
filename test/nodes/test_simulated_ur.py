"""The node of the simulated UR controller, with cycles stepped by the test."""

import os
import socket

import pytest
import rclpy
from rclpy.parameter import Parameter

from omniman_ros.conversions.headers import time_seconds
from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes.simulated_ur import SimulatedUrNode
from omniman_ros.simulation.ur.arm import CYCLE
from omniman_ros.simulation.ur.controller_server import ControllerServer
from omniman_ros.simulation.ur.modes import Cb3RobotMode
from test.nodes.harness import free_domain

FREE = {f"ports.{name}": 0 for name in ("dashboard", "primary", "secondary", "realtime", "rtde")}


class Rig:
    def __init__(self, **changes):
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.context = rclpy.Context()
        self.context.init(domain_id=free_domain())
        given = FREE | {"use_sim_time": False} | changes
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        self.node = None
        try:
            self.node = SimulatedUrNode(context=self.context, parameter_overrides=overrides)
        except BaseException:
            self.close()
            raise
        self.cycles = 0

    def close(self):
        if self.node is not None:
            self.node.destroy_node()
        self.context.shutdown()

    def run(self, seconds):
        for _ in range(round(seconds / CYCLE)):
            self.cycles += 1
            self.node.server.cycle(10.0 + self.cycles * CYCLE)

    def set(self, **values):
        changes = [
            Parameter(name.replace("__", "."), value=value) for name, value in values.items()
        ]
        return self.node.set_parameters_atomically(changes)

    def values(self):
        return dict(self.node.status()[2])


@pytest.fixture
def make(monkeypatch):
    monkeypatch.setattr(ControllerServer, "start", lambda self: None)
    rigs = []

    def maker(**changes):
        rigs.append(Rig(**changes))
        return rigs[-1]

    yield maker
    for rig in rigs:
        rig.close()


def program(rig, line):
    assert rig.node.controller.start(f"def f():\n{line}\nend\n")


def test_ground_truth_is_published_with_the_joint_names(make):
    names = [f"left_{k}" for k in range(6)]
    rig = make(**{"arm.joints": names, "simulated_arm.initial": [0.1] * 6})
    truth = []
    rig.node._truth.publish = lambda m: truth.append((m.name, list(m.position), list(m.velocity)))
    program(rig, "  speedj([0.5, 0, 0, 0, 0, 0], 5, 10)")
    rig.run(1.0)
    rig.node._report_truth()
    name, position, velocity = truth[0]
    assert name == [f"left_{k}" for k in range(6)]
    assert 0.4 < position[0] < 0.6 and position[1:] == pytest.approx([0.1] * 5)
    assert velocity == pytest.approx([0.5, 0, 0, 0, 0, 0], abs=1e-3)


def test_ground_truth_is_stamped_with_the_instant_of_the_cycle_that_measured_it(make):
    rig = make()
    reports = []
    rig.node._truth.publish = lambda m: reports.append(
        (time_seconds(m.header.stamp), m.position[0])
    )
    rig.node._report_truth()
    assert not reports  # nothing was measured yet
    program(rig, "  speedj([0.5, 0, 0, 0, 0, 0], 5, 10)")
    rig.run(1.0)
    rig.node._report_truth()
    rig.node._report_truth()  # the thread was held up: nothing has moved
    rig.run(0.4)
    rig.node._report_truth()
    (first, begin), (again, _), (last, end) = reports
    assert again == pytest.approx(first, abs=1e-3)
    assert last - first == pytest.approx(0.4, abs=1e-3)
    assert (end - begin) / (last - first) == pytest.approx(0.5, rel=1e-2)


def test_diagnostics_contain_modes_program_and_ports(make):
    rig = make()
    rig.run(0.1)
    level, text, _ = rig.node.status()
    assert (level, text) == (b"\x00", "RUNNING, NORMAL")
    program(rig, "  servoj(get_actual_joint_positions(), t=0.008)\n  sync()")
    rig.run(0.1)
    values = rig.values()
    assert values["program_end_reason"] == "completed" and values["servo_calls"] == 1
    assert values["program_state"] == "STOPPED" and values["programs"] == 1
    assert values["port rtde"] > 0 and values["clients of rtde"] == 0


def test_joints_in_a_world_that_is_not_there_are_reported(make):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        rig = make(**{"simulated_arm.world_port": taken.getsockname()[1]})
        rig.run(0.1)
        truth = []
        rig.node._truth.publish = truth.append
        rig.node._report_truth()
        address = ("127.0.0.1", rig.node.server.ports.numbers["primary"])
        with socket.create_connection(address):
            rig.run(0.1)
            assert rig.values()["clients of primary"] == 0
        assert truth == [], "nobody knows where the arm is"
    level, text, _ = rig.node.status()
    assert level == b"\x01" and text.startswith("no arm: no world at port")
    assert rig.values()["robot_mode"] == "DISCONNECTED"
    assert not rig.node.controller.start("def f():\nend\n")


def test_faults_and_slider_change_at_runtime_and_are_reported(make):
    rig = make()
    assert rig.set(faults__protective_stop=True, pendant__speed_slider=0.5).successful
    rig.run(0.1)
    level, text, _ = rig.node.status()
    assert (level, text) == (b"\x01", "faults: protective_stop")
    assert rig.values()["safety_mode"] == "PROTECTIVE_STOP"
    assert rig.node.controller.slider == 0.5
    # A client moves the slider; setting other parameters does not move the slider back.
    rig.node.controller.slider = 0.3
    assert rig.set(faults__protective_stop=False).successful
    assert rig.node.controller.slider == 0.3
    assert not rig.set(pendant__speed_slider=0.0).successful
    assert not rig.set(simulated_arm__speed=1.0).successful


def test_messages_of_the_controller_are_logged(make):
    rig = make()
    program(rig, '  textmsg("hello")')
    rig.run(0.1)
    lines = []
    rig.node.get_logger = lambda: type(
        "Logger", (), {"info": lambda _, line: lines.append(line)}
    )()
    rig.node._write_log()
    assert lines == ["program says: hello", "program ended: completed"]


def test_simulation_failure_is_reported(make):
    rig = make()
    rig.node.server.error = ZeroDivisionError("x")
    level, text, _ = rig.node.status()
    assert level == b"\x02" and "ZeroDivisionError" in text


def test_shutdown_brakes_the_arm_and_switches_the_power_off(make):
    rig = make()
    program(rig, "  speedj([2, 0, 0, 0, 0, 0], 10, 10)")
    rig.run(1.0)
    rig.node.begin_shutdown("test")
    rig.run(CYCLE)
    assert not rig.node.finished
    rig.run(rig.node.stop_timeout)
    assert rig.node.finished
    assert rig.node.controller.modes.robot is Cb3RobotMode.POWER_OFF


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"arm.joints": ["a", "b"]}, "arm.joints"),
        ({"ports.address": "256.0.0.1"}, "ports.dashboard"),
        ({"simulated_arm.initial": [0.0]}, "simulated_arm.initial"),
    ],
)
def test_node_with_an_invalid_configuration_does_not_start(make, changes, name):
    with pytest.raises(ParameterError, match=name):
        make(**changes)
