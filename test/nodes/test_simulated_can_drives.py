"""The node of simulated bus drives on python-can's virtual bus, with stepped time."""

import os
import struct
import time

import can
import pytest
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.parameter import Parameter

from omniman_ros.conversions.headers import time_seconds
from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes.simulated_can_drives import SimulatedCanDrivesNode
from test.nodes.harness import free_domain

ARRIVAL = 5.0  #: Time limit of a frame through the virtual bus and the receiver's thread [s]


class Rig:
    """The node with a bus to exchange frames."""

    def __init__(self, channel, **changes):
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.context = rclpy.Context()
        self.context.init(domain_id=free_domain())
        given = {
            "can.interface": "virtual",
            "can.channel": channel,
            "can.nodes": [1, 2, 3, 4],
            "use_sim_time": False,
            **changes,
        }
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

    def place(self, message):
        """Have the node receive a message on `initialpose`."""
        topics = {each.topic_name: each for each in self.node.subscriptions}
        topics["/initialpose"].callback(message)

    def received(self):
        """Return all frames sent by the node."""
        frames = []
        while (message := self.bus.recv(0)) is not None:
            frames.append((message.arbitration_id, bytes(message.data)))
        return frames

    def send(self, can_id, data):
        """Send a frame and wait until the node has received it."""
        before = self.node.drives.received
        self.bus.send(
            can.Message(arbitration_id=can_id, data=bytes.fromhex(data), is_extended_id=False)
        )
        self.wait(lambda: self.node._receiver.received)
        self.node.tick()
        return self.node.drives.received - before

    @staticmethod
    def wait(condition):
        deadline = time.monotonic() + ARRIVAL
        while not condition():
            assert time.monotonic() < deadline, "no frame was received"
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


def test_drives_boot_on_the_bus_and_answer(make):
    rig = make()
    assert rig.received() == [(0x700 + node, b"\x00") for node in (1, 2, 3, 4)]
    assert rig.send(0x603, "40 00 10 00 00 00 00 00") == 1
    assert rig.received() == [(0x583, bytes.fromhex("43 00 10 00 92 01 02 00"))]


def test_the_robot_moves_and_the_ground_truth_is_published(make):
    rig = make()
    truth = []
    rig.node._truth.publish = lambda message: truth.append(message.pose.pose.position.x)
    for node in (1, 2, 3, 4):
        for data in (
            "2F 60 60 00 03 00 00 00",
            "2B 40 60 00 06 00 00 00",
            "2B 40 60 00 07 00 00 00",
            "2B 40 60 00 0F 00 00 00",
            "23 FF 60 00 " + struct.pack("<i", 40960).hex(),
        ):
            rig.send(0x600 + node, data)
    rig.node._publish_truth()
    rig.run(1.0)
    rig.node._publish_truth()
    assert truth[0] == 0.0 and truth[1] > 0.05
    message = PoseWithCovarianceStamped()
    message.header.frame_id = "map"
    message.pose.pose.position.x = 7.0
    message.pose.pose.orientation.w = 1.0
    rig.place(message)
    rig.node._publish_truth()
    assert truth[2] == pytest.approx(7.0, abs=0.01)


def test_ground_truth_is_stamped_with_the_instant_that_the_plant_has_reached(make):
    rig = make()
    stamps = []
    rig.node._truth.publish = lambda m: stamps.append(time_seconds(m.header.stamp))
    rig.node._publish_truth()
    rig.time += 0.05  # the machine holds the node up, and the report comes before the next tick
    rig.node._publish_truth()
    rig.node.tick()
    rig.node._publish_truth()
    assert stamps[1] == pytest.approx(stamps[0], abs=1e-3)
    assert stamps[2] == pytest.approx(stamps[0] + 0.05, abs=2e-3)


def test_bus_failure_causes_a_warning_and_the_node_keeps_running(make):
    rig = make()

    def fail(*_):
        raise can.CanOperationError("queue full")

    working = rig.node._bus.send, rig.node._bus.recv
    rig.node._bus.send, rig.node._bus.recv = fail, fail
    rig.wait(lambda: rig.node._receiver.errors)
    rig.node.drives.set_faults(rig.node.settings.value.can_faults)
    for _ in range(3):
        rig.bus.send(can.Message(arbitration_id=0, data=[129, 0], is_extended_id=False))
    rig.node._bus.recv = working[1]
    rig.wait(lambda: rig.node._receiver.received)
    rig.run(0.05)
    counts = rig.node.warning_counts
    assert counts["bus"] > 0 and counts["send"] > 0
    rig.node._bus.send = working[0]
    rig.received()
    assert rig.send(0x603, "40 00 10 00 00 00 00 00")
    assert 0x583 in [can_id for can_id, _ in rig.received()]


def test_echo_of_a_frame_of_the_node_is_ignored(make, monkeypatch):
    monkeypatch.setattr("omniman_ros.nodes.simulated_can_drives.ECHOING_INTERFACES", ("virtual",))
    rig = make()
    assert rig.send(0x701, "00") == 0  # equal to the frame sent at the start
    assert rig.send(0x701, "00") == 1  # from another sender


def test_frame_takes_effect_at_its_arrival_and_not_at_its_delivery(make):
    rig = make()
    received = []
    rig.node.drives.receive = lambda message, at: received.append(rig.time - at) or []
    for age in (0.0, 0.3, 5.0, -5.0):
        message = can.Message(arbitration_id=0x701, data=b"\x05", is_extended_id=False)
        message.timestamp = time.time() - age
        rig.node._receiver.received.append(message)
        rig.node.tick()
    assert received == pytest.approx([0.0, 0.3, 0.0, 0.0], abs=0.05)


def test_faults_are_switched_on_at_runtime_and_reported(make):
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


def test_shutdown_ramps_all_wheels_to_rest_then_switches_the_power_off(make):
    rig = make()
    for node in (1, 2, 3, 4):
        for data in (
            "2F 60 60 00 09 00 00 00",
            "2B 40 60 00 06 00 00 00",
            "2B 40 60 00 07 00 00 00",
            "2B 40 60 00 0F 00 00 00",
            "23 FF 60 00 " + struct.pack("<i", 40960).hex(),
        ):
            rig.send(0x600 + node, data)
    rig.run(1.0)
    assert rig.node.drives.fastest > 1.0
    rig.node.begin_shutdown("test")
    assert not rig.node.finished
    assert rig.node.stop_timeout > 1.1
    rig.run(rig.node.stop_timeout)
    assert rig.node.finished
    assert not rig.node.drives.wheels.electrical()[:, 1].any()


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"use_sim_time": True}, "use_sim_time"),
        ({"can.nodes": [1, 2]}, "can.nodes"),
        ({"can.interface": "none_such"}, "can.interface"),
        ({"can_faults.fault": ["x"]}, "can_faults.fault"),
    ],
)
def test_node_with_an_invalid_configuration_does_not_start(make, changes, name):
    with pytest.raises(ParameterError, match=name):
        make(**changes)


@pytest.mark.parametrize(
    "fields",
    [{"is_extended_id": []}, {"arbitration_id": 1.5e9}, {"arbitration_id": "x"}, {"data": None}],
    ids=str,
)
def test_frame_with_fields_of_wrong_types_is_dropped_and_reception_continues(make, fields):
    rig = make()
    rig.received()
    strange = can.Message(arbitration_id=0x603, data=bytes(8), is_extended_id=False)
    for name, value in fields.items():
        object.__setattr__(strange, name, value)
    working, once = rig.node._bus.recv, [strange]
    rig.node._bus.recv = lambda timeout: once.pop() if once else working(timeout)
    rig.wait(lambda: not once)
    assert rig.send(0x603, "40 00 10 00 00 00 00 00")
    assert 0x583 in [can_id for can_id, _ in rig.received()]
