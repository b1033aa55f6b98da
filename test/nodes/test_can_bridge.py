"""The bridge's topics and life cycle, on real time, with simulated drives on a virtual bus.

Reactions in time are tested on the policy, in injected time (test/can_drive); here all waits are
for conditions.
"""

import os
import threading
import time
from contextlib import contextmanager

import can
import pytest
import rclpy
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import Trigger

from omniman_ros.can_drive.phase import Phase
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.drive.can.network import OwnFrames, SimulatedBus
from omniman_ros.drive.can.parameters import CanFaultParameters
from omniman_ros.drive.parameters import SimulationParameters
from omniman_ros.nodes.can_bridge import CanBridgeNode
from omniman_ros.robots import load_robot

from .harness import free_domain

pytestmark = pytest.mark.processes  # watches real time

PATIENCE = 30.0
NODES = (1, 2, 3, 4)
PATIENT = {
    "can.interface": "virtual", "can.nodes": list(NODES), "can.rate": 50.0,
    "can.missed_periods": 200, "can.heartbeat_timeout": 4.0, "can.drive_heartbeat": 0.5,
    "can.command_timeout": 2.0, "can.direction": [1.0, -1.0, 1.0, -1.0],
}  # fmt: skip


class Drives(threading.Thread):
    """Simulated drives on a virtual bus, in real time."""

    def __init__(self, channel, **options):
        super().__init__(daemon=True)
        robot = build(Robot, load_robot("omniman"))
        values = {key: tuple(v) if isinstance(v, list) else v for key, v in PATIENT.items()}
        plant = build(SimulationParameters, {"plant.lifted": True})
        self.simulated = SimulatedBus(robot, plant, build(CanParameters, values, "can."))
        self.bus = can.Bus(interface="virtual", channel=channel)
        self.ended = False
        self.heard = []

    def run(self):
        own = OwnFrames()
        while not self.ended:
            message = self.bus.recv(0.002)
            now = time.monotonic()
            answers = self.simulated.advance(now)
            if message is not None and not own.is_echo(message, now):
                self.heard.append(message)
                answers += self.simulated.receive(message, now)
            for answer in answers:
                self.bus.send(answer)
        self.bus.shutdown()

    @property
    def speeds(self):
        return [self.simulated.wheels.velocity(k) for k in range(4)]


class Bench:
    """A bridge and a probe, in one executor that the test spins."""

    def __init__(self, context, channel, **parameters):
        self.executor = SingleThreadedExecutor(context=context)
        given = PATIENT | {"can.channel": channel} | parameters
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        self.node = CanBridgeNode(context=context, parameter_overrides=overrides)
        self.probe = Node("probe", context=context)
        for node in (self.node, self.probe):
            self.executor.add_node(node)
        self.states, self.electrical = [], []
        self.probe.create_subscription(JointState, "wheel_states", self.states.append, 10)
        self.probe.create_subscription(
            Float64MultiArray, "wheel_electrical", self.electrical.append, 10
        )
        self.commands = self.probe.create_publisher(JointState, "wheel_commands", 1)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.emergency = self.probe.create_publisher(Bool, "emergency_stop", latched)
        self.speed = None

    def until(self, done, what="it"):
        end = time.monotonic() + PATIENCE
        said = 0.0
        while not done():
            assert time.monotonic() < end, f"waited for {what}: {self.node.status()}"
            self.executor.spin_once(timeout_sec=0.02)
            if self.speed is not None and time.monotonic() - said > 0.05:
                said = time.monotonic()
                self.send(self.speed)

    def send(self, speed, names=None, **fields):
        names = names or list(self.node.settings.value.robot.wheels.names)
        message = JointState(name=names, velocity=[speed] * len(names))
        for name, value in fields.items():
            setattr(message, name, value)
        self.commands.publish(message)

    def call(self, kind, service, request):
        client = self.probe.create_client(kind, service)
        self.until(client.service_is_ready, service)
        future = client.call_async(request)
        self.until(future.done, service)
        return future.result()

    def change(self, transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        return self.call(ChangeState, "can_bridge/change_state", request).success

    @property
    def state(self):
        return self.call(GetState, "can_bridge/get_state", GetState.Request()).current_state.id

    def drive(self, drives, speed=3.0):
        self.speed = speed
        self.until(lambda: min(drives.speeds) > 0.9 * speed, "speed")


@contextmanager
def bench(channel, **parameters):
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    context = rclpy.Context()
    context.init(domain_id=free_domain())
    made = None
    try:
        made = Bench(context, channel, **parameters)
        yield made
    finally:
        if made is not None:
            for node in (made.probe, made.node):
                made.executor.remove_node(node)
                node.destroy_node()
            made.executor.shutdown()
        context.try_shutdown()


@pytest.fixture
def channel(request):
    return f"{request.node.name}-{os.getpid()}"


@pytest.fixture
def drives(channel):
    thread = Drives(channel)
    thread.start()
    yield thread
    thread.ended = True
    thread.join(5.0)


def rest(drives):
    return lambda: max(map(abs, drives.speeds)) < 0.05


def test_it_starts_itself_drives_and_reports(drives, channel):
    with bench(channel) as it:
        it.drive(drives)
        assert it.states[-1].name == list(it.node.settings.value.robot.wheels.names)
        it.until(lambda: min(it.states[-1].velocity) > 2.5, "feedback")
        it.until(lambda: bool(it.electrical), "wheel_electrical")
        assert [d.size for d in it.electrical[-1].layout.dim] == [4, 3]
        level, message, values = it.node.status()
        assert (level, message) == (b"\x00", "driving")
        assert ("front_left (node 1)", "enabled") in values
        it.speed = 0.0
        it.until(rest(drives), "rest")


def test_it_waits_for_drives_that_are_switched_on_later(channel):
    with bench(channel, **{"can.configure_timeout": 1.0, "can.rate": 200.0}) as it:
        end = time.monotonic() + 1.5
        it.until(lambda: time.monotonic() > end)
        assert it.node.status()[1] == "unconfigured"
        thread = Drives(channel)
        thread.start()
        try:
            it.until(lambda: it.node.status()[1] == "driving", "driving")
        finally:
            thread.ended = True
            thread.join(5.0)


def test_the_life_cycle_opens_enables_disables_and_closes(drives, channel):
    with bench(channel, autostart=False) as it:
        assert it.state == State.PRIMARY_STATE_UNCONFIGURED
        assert it.node.link is None
        assert it.change(Transition.TRANSITION_CONFIGURE)
        assert it.node.link.drives.phase is Phase.IDLE
        it.until(lambda: it.commands.get_subscription_count(), "a listener")
        it.send(3.0)
        it.until(lambda: it.node._throttle.counts, "a warning")
        assert it.change(Transition.TRANSITION_ACTIVATE)
        assert it.state == State.PRIMARY_STATE_ACTIVE
        it.drive(drives)
        it.speed = None
        assert it.change(Transition.TRANSITION_DEACTIVATE)
        it.until(rest(drives), "rest")
        assert it.node.link.drives.is_off
        assert it.change(Transition.TRANSITION_CLEANUP)
        assert it.node.link is None
        assert it.state == State.PRIMARY_STATE_UNCONFIGURED


@pytest.mark.parametrize(
    "transition",
    [
        Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE,
        Transition.TRANSITION_CLEANUP, Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, 200,
    ],
)  # fmt: skip
def test_a_transition_that_its_state_does_not_have_is_refused_and_it_drives_on(
    drives, channel, transition
):
    with bench(channel) as it:
        it.drive(drives)
        assert not it.change(transition)
        assert it.node._throttle.counts["transition"] == 1
        assert it.state == State.PRIMARY_STATE_ACTIVE
        assert min(drives.speeds) > 2.0


def test_what_was_taken_down_by_hand_is_not_brought_up_again(drives, channel):
    with bench(channel) as it:
        later = it.node.now() + 3600.0  # by hand is faster than by itself
        it.node._attempt = later
        assert it.change(Transition.TRANSITION_CONFIGURE)
        assert it.change(Transition.TRANSITION_ACTIVATE)
        assert it.change(Transition.TRANSITION_DEACTIVATE)
        assert it.node._attempt is None
        it.node._attempt = later
        assert it.change(Transition.TRANSITION_CLEANUP)
        assert it.node._attempt is None
        it.node._attempt = later
        assert it.change(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
        it.node._start()
        assert it.state == State.PRIMARY_STATE_FINALIZED


def test_an_error_in_a_transition_is_told_and_closes_the_bus(drives, channel, capfd):
    with bench(channel, autostart=False) as it:
        assert it.change(Transition.TRANSITION_CONFIGURE)
        it.node.link.drives.enable = lambda now: 1 / 0
        assert not it.change(Transition.TRANSITION_ACTIVATE)
        assert it.node.link is None
        assert it.state == State.PRIMARY_STATE_UNCONFIGURED
    assert "on_activate failed" in (said := capfd.readouterr().err)
    assert "ZeroDivisionError" in said


def test_a_stop_is_latched_until_the_reset_which_moves_nothing(drives, channel):
    with bench(channel) as it:
        it.drive(drives)
        assert it.call(Trigger, "can_bridge/stop", Trigger.Request()).success
        it.until(rest(drives), "rest")
        it.until(lambda: it.node.link.drives.is_off, "power off")
        answer = it.call(Trigger, "can_bridge/reset", Trigger.Request())
        assert answer.success, answer.message
        it.drive(drives)


def test_an_emergency_stop_stops_and_refuses_a_reset(drives, channel):
    with bench(channel) as it:
        it.drive(drives)
        it.emergency.publish(Bool(data=True))
        it.until(rest(drives), "rest")
        answer = it.call(Trigger, "can_bridge/reset", Trigger.Request())
        assert not answer.success
        assert "emergency_stop" in answer.message


def test_an_emergency_stop_from_before_keeps_the_drives_off(drives, channel):
    with bench(channel, autostart=False) as it:
        it.emergency.publish(Bool(data=True))
        it.until(lambda: it.node.latch.emergency, "the emergency stop")
        assert it.change(Transition.TRANSITION_CONFIGURE)
        assert not it.change(Transition.TRANSITION_ACTIVATE)
        assert it.node.link.drives.is_off


def test_a_fault_stops_all_and_is_named_in_state_and_diagnostics(drives, channel):
    with bench(channel) as it:
        it.drive(drives)
        drives.simulated.set_faults(CanFaultParameters(fault=("rear_left",)))
        it.until(lambda: not it.node.latch.released, "the stop")
        level, message, _ = it.node.status()
        assert level == b"\x02"
        assert message.startswith("rear_left: EMCY 2310")
        it.until(rest(drives), "rest")


@pytest.mark.parametrize(
    ("fields", "names"),
    [
        ({"velocity": [float("nan")] * 4}, None),
        ({"velocity": [1e9] * 4}, None),
        ({"velocity": [3.0] * 3}, None),
        ({"velocity": [], "effort": [1.0] * 4}, None),
        ({}, ["a", "b", "c", "d"]),
    ],
    ids=["nan", "huge", "short", "torque", "names"],
)
def test_a_bad_command_moves_nothing_and_is_warned_of(drives, channel, fields, names):
    with bench(channel) as it:
        it.until(lambda: it.node.status()[1] == "driving", "driving")
        for _ in range(10):
            it.send(3.0, names=names, **fields)
            it.executor.spin_once(timeout_sec=0.02)
        it.until(lambda: it.node._throttle.counts, "a warning")
        assert rest(drives)()


def test_a_missing_bus_is_named_and_the_node_lives_on(channel):
    with bench(channel, **{"can.interface": "no_such_interface"}) as it:
        it.until(lambda: it.node._throttle.counts, "a warning")
        assert it.node.status()[1] == "unconfigured"


@pytest.mark.parametrize(
    ("parameters", "name"),
    [
        ({"can.nodes": [1, 2, 3]}, "can.nodes"),
        ({"can.direction": [2.0]}, "can.direction"),
        ({"can.protocol": "modbus"}, "can.protocol"),
        ({"use_sim_time": True}, "use_sim_time"),
    ],
)
def test_a_bad_installation_is_refused_with_its_name(channel, parameters, name):
    with pytest.raises(ParameterError, match=name), bench(channel, **parameters):
        pass


def test_what_is_fixed_and_what_is_live(drives, channel):
    with bench(channel) as it:
        fixed, live = it.node.set_parameters(
            [Parameter("can.rate", value=100.0), Parameter("can.max_speed", value=1.0)]
        )
        assert not fixed.successful
        assert live.successful
        it.until(lambda: it.node.status()[1] == "driving", "driving")
        it.send(3.0)
        it.until(lambda: it.node._throttle.counts, "a warning")
        assert rest(drives)()


def test_its_end_takes_the_power_off(drives, channel):
    with bench(channel) as it:
        it.drive(drives)
        it.speed = None
        it.node.begin_shutdown("SIGTERM")
        assert not it.node.finished
        it.until(lambda: it.node.finished, "the end")
        assert rest(drives)()
