"""The node of the simulated drives on a bus: on python-can's virtual bus, time by hand."""

import os
import struct
import time

import can
import pytest
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.parameter import Parameter

from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes.simulated_can_drives import SimulatedCanDrivesNode

from .harness import free_domain

ARRIVAL = 5.0
"""How long a frame may take through the virtual bus and the receiver's thread [s]."""


class Rig:
    """The node, and a bus to talk to it."""

    def __init__(self, channel, **changes):
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.context = rclpy.Context()
        self.context.init(domain_id=free_domain())
        given = {"can.interface": "virtual", "can.channel": channel, "can.nodes": [1, 2, 3, 4],
                 "use_sim_time": False, **changes}  # fmt: skip
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        self.node, self.bus = None, can.Bus(interface="virtual", channel=channel)
        try:
            self.node = SimulatedCanDrivesNode(context=self.context, parameter_overrides=overrides)
        except BaseException:
            self.close()
            raise
        self.time = 100.0
        self.node.now = lambda: self.time
        self.run(0.1)

    def close(self):
        if self.node is not None:
            self.node.destroy_node()
        self.bus.shutdown()
        self.context.shutdown()

    def run(self, seconds):
        for _ in range(round(seconds / 0.001)):
            self.time += 0.001
            self.node.tick()

    def heard(self):
        """All frames that came from the node."""
        frames = []
        while (message := self.bus.recv(0)) is not None:
            frames.append((message.arbitration_id, bytes(message.data)))
        return frames

    def send(self, can_id, data):
        """Send a frame, and wait until it has arrived."""
        before = self.node.drives.heard
        self.bus.send(
            can.Message(arbitration_id=can_id, data=bytes.fromhex(data), is_extended_id=False)
        )
        self.wait(lambda: self.node._arrived)
        self.node.tick()
        return self.node.drives.heard - before

    @staticmethod
    def wait(condition):
        deadline = time.monotonic() + ARRIVAL
        while not condition():
            assert time.monotonic() < deadline, "nothing came"
            time.sleep(0.0005)


@pytest.fixture
def make(request):
    rigs = []

    def maker(**changes):
        rigs.append(Rig(request.node.name, **changes))
        return rigs[-1]

    yield maker
    for rig in rigs:
        rig.close()


def test_drives_boot_up_on_the_bus_and_answer(make):
    rig = make()
    assert rig.heard() == [(0x700 + node, b"\x00") for node in (1, 2, 3, 4)]
    assert rig.send(0x603, "40 00 10 00 00 00 00 00") == 1
    assert rig.heard() == [(0x583, bytes.fromhex("43 00 10 00 92 01 02 00"))]


def test_the_robot_moves_and_the_truth_is_told(make):
    rig = make()
    truth = []
    rig.node._truth.publish = lambda message: truth.append(message.pose.pose.position.x)
    for node in (1, 2, 3, 4):
        for data in ("2F 60 60 00 03 00 00 00", "2B 40 60 00 06 00 00 00",
                     "2B 40 60 00 07 00 00 00", "2B 40 60 00 0F 00 00 00",
                     "23 FF 60 00 " + struct.pack("<i", 40960).hex()):  # fmt: skip
            rig.send(0x600 + node, data)
    rig.node._report_truth()
    rig.run(1.0)
    rig.node._report_truth()
    assert truth[0] == 0.0 and truth[1] > 0.05
    message = PoseWithCovarianceStamped()
    message.header.frame_id = "map"
    message.pose.pose.position.x = 7.0
    message.pose.pose.orientation.w = 1.0
    rig.node._on_initial_pose(message)
    rig.node._report_truth()
    assert truth[2] == pytest.approx(7.0, abs=0.01)


def test_a_bus_that_fails_is_warned_of_and_survived(make):
    rig = make()

    def fail(*_):
        raise can.CanOperationError("queue full")

    working = rig.node._bus.send, rig.node._bus.recv
    rig.node._bus.send, rig.node._bus.recv = fail, fail
    rig.wait(lambda: rig.node._trouble)
    rig.node.drives.set_faults(rig.node.settings.value.can_faults)
    for _ in range(3):
        rig.bus.send(can.Message(arbitration_id=0, data=[129, 0], is_extended_id=False))
    rig.node._bus.recv = working[1]
    rig.wait(lambda: rig.node._arrived)
    rig.run(0.05)
    counts = rig.node._throttle.counts
    assert counts["bus"] > 0 and counts["send"] > 0
    rig.node._bus.send = working[0]
    rig.heard()
    assert rig.send(0x603, "40 00 10 00 00 00 00 00")
    assert 0x583 in [can_id for can_id, _ in rig.heard()]


def test_an_echo_of_its_own_frame_is_not_heard(make, monkeypatch):
    monkeypatch.setattr("omniman_ros.nodes.simulated_can_drives.ECHOES", ("virtual",))
    rig = make()
    assert rig.send(0x701, "00") == 0  # as it was sent at the start
    assert rig.send(0x701, "00") == 1  # from somebody else


def test_a_frame_is_heard_when_it_came_not_when_it_is_served(make):
    rig = make()
    heard = []
    rig.node.drives.receive = lambda message, at: heard.append(rig.time - at) or []
    for age in (0.0, 0.3, 5.0, -5.0):
        message = can.Message(arbitration_id=0x701, data=b"\x05", is_extended_id=False)
        message.timestamp = time.time() - age
        rig.node._arrived.append(message)
        rig.node.tick()
    assert heard == pytest.approx([0.0, 0.3, 0.0, 0.0], abs=0.05)


def test_faults_are_switched_on_live_and_told(make):
    rig = make()
    set_ = rig.node.set_parameters_atomically
    assert set_([Parameter("can_faults.silent", value=["front_left"])]).successful
    assert rig.node.drives.faults[0].silent
    level, text, _ = rig.node.status()
    assert level != b"\x00" and text == "faults: silent (front_left)"
    refused = set_([Parameter("can_faults.deaf", value=["nobody"])])
    assert not refused.successful and "nobody" in refused.reason
    assert not set_([Parameter("can.nodes", value=[5, 6, 7, 8])]).successful
    assert rig.node.drives.faults[0].silent


def test_shutdown_ramps_all_wheels_to_rest_then_takes_the_power_off(make):
    rig = make()
    for node in (1, 2, 3, 4):
        for data in ("2F 60 60 00 09 00 00 00", "2B 40 60 00 06 00 00 00",
                     "2B 40 60 00 07 00 00 00", "2B 40 60 00 0F 00 00 00",
                     "23 FF 60 00 " + struct.pack("<i", 40960).hex()):  # fmt: skip
            rig.send(0x600 + node, data)
    rig.run(1.0)
    assert rig.node.drives.fastest > 1.0
    rig.node.begin_shutdown("test")
    assert not rig.node.finished
    assert rig.node.patience > 1.1
    rig.run(rig.node.patience)
    assert rig.node.finished
    assert not rig.node.drives.wheels.electrical()[:, 1].any()


@pytest.mark.parametrize(
    ("changes", "name"),
    [({"use_sim_time": True}, "use_sim_time"), ({"can.nodes": [1, 2]}, "can.nodes"),
     ({"can.interface": "none_such"}, "can.interface"),
     ({"can_faults.fault": ["x"]}, "can_faults.fault")],
)  # fmt: skip
def test_what_cannot_run_does_not_start(make, changes, name):
    with pytest.raises(ParameterError, match=name):
        make(**changes)


@pytest.mark.parametrize(
    "fields",
    [{"is_extended_id": []}, {"arbitration_id": 1.5e9}, {"arbitration_id": "x"}, {"data": None}],
    ids=str,
)
def test_a_frame_of_strange_types_is_no_frame_and_makes_nobody_deaf(make, fields):
    rig = make()
    rig.heard()
    strange = can.Message(arbitration_id=0x603, data=bytes(8), is_extended_id=False)
    for name, value in fields.items():
        object.__setattr__(strange, name, value)
    working, once = rig.node._bus.recv, [strange]
    rig.node._bus.recv = lambda timeout: once.pop() if once else working(timeout)
    rig.wait(lambda: not once)
    assert rig.send(0x603, "40 00 10 00 00 00 00 00")
    assert 0x583 in [can_id for can_id, _ in rig.heard()]
