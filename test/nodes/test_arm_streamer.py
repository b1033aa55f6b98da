"""Topics and life cycle of the arm streamer, in real time with a simulated controller.

Timing is tested on the policy with injected time (test/arm); here all waits are for
conditions. The controller shares this process with node and test, so its timeouts are long.
"""

import math
import os
import signal
import socket
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes.arm_streamer import ArmStreamerNode
from omniman_ros.nodes.stop_interface import ALL_LATCHED, LATCHED
from omniman_ros.simulation.ur.arm import UrArmParameters
from omniman_ros.simulation.ur.controller_server import ControllerServer
from omniman_ros.simulation.ur.modes import RobotMode, RuntimeState, SafetyMode
from omniman_ros.simulation.ur.tcp_ports import UrPortParameters
from test.nodes.harness import free_domain

pytestmark = pytest.mark.processes  # checks real time

PATIENCE = 30.0
FREE = UrPortParameters(dashboard=0, primary=0, secondary=0, realtime=0, rtde=0)
PATIENT = {
    "ur.reverse_port": 0,
    "ur.read_timeout": 0.2,
    "ur.feedback_timeout": 1.0,
    "ur.following_error": 1.0,
}
NODE = "/arm_streamer"
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
REST, STILL = 0.01, 0.005
"""Speed below which the arm counts as standing [rad/s] and its allowed further travel [rad]."""


class Controller:
    """A simulated controller in a thread."""

    def __init__(self):
        self.server = ControllerServer(UrArmParameters(), FREE)
        self.server.start()
        self.inner = self.server.controller

    @property
    def ports(self):
        numbers = self.server.ports.numbers
        return {
            "ur.rtde_port": numbers["rtde"],
            "ur.script_port": numbers["secondary"],
            "ur.dashboard_port": numbers["dashboard"],
        }

    def fault(self, **changes):
        self.inner.faults = replace(self.inner.faults, **changes)

    def power_on(self):
        if (
            self.inner.modes.wanted is not RobotMode.RUNNING
        ):  # its thread may have missed the command
            self.inner.power(RobotMode.RUNNING)
        return self.inner.robot_mode is RobotMode.RUNNING

    @property
    def place(self):
        return self.inner.arm.q.copy()

    @property
    def speed(self):
        return float(np.abs(self.inner.arm.qd).max())

    def rests(self):
        return self.speed < REST

    def plays(self):
        return self.inner.runtime is RuntimeState.PLAYING


class Bench:
    """A streamer and a probe in one executor that the test spins."""

    def __init__(self, context, ports, **parameters):
        self.executor = SingleThreadedExecutor(context=context)
        given = PATIENT | ports | parameters
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        self.node = ArmStreamerNode(context=context, parameter_overrides=overrides)
        self.probe = Node("probe", context=context)
        for node in (self.node, self.probe):
            self.executor.add_node(node)
        self.states, self.scaling, self.timing = [], [], []
        self.stops, self.diagnostics = {}, {}
        listen = self.probe.create_subscription
        listen(JointState, "arm/joint_states", self.states.append, 10)
        listen(Float64, "arm/speed_scaling", lambda m: self.scaling.append(m.data), 10)
        listen(Float64MultiArray, "arm/timing", self.timing.append, 10)
        listen(DiagnosticStatus, "stop_state", self._on_stop_state, ALL_LATCHED)
        listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.previews = self.probe.create_publisher(JointTrajectory, "arm/joint_reference", 1)
        self.emergency = self.probe.create_publisher(Bool, "emergency_stop", LATCHED)
        self.peers = self.probe.create_publisher(DiagnosticStatus, "stop_state", LATCHED)
        self.source = None
        self.said, self.way = 0.0, -1.0
        self.clients = {}

    def _on_stop_state(self, message):
        self.stops[message.name] = message.message

    def _on_diagnostics(self, message):
        self.diagnostics |= {status.name: status for status in message.status}

    def until(self, done, what="it", patience=PATIENCE):
        end = time.monotonic() + patience
        while not done():
            assert time.monotonic() < end, f"waited for {what}: {self.node.status()}"
            if self.source is not None and time.monotonic() - self.said > 0.04:
                self.said = time.monotonic()
                self.source()
            self.executor.spin_once(timeout_sec=0.01)

    def spin(self, seconds):
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() > end)

    def call(self, kind, service, request):
        if service not in self.clients:
            self.clients[service] = self.probe.create_client(kind, service)
        client = self.clients[service]
        self.until(client.service_is_ready, service)
        future = client.call_async(request)
        self.until(future.done, service)
        return future.result()

    def ask(self, name):
        return self.call(Trigger, f"arm_streamer/{name}", Trigger.Request())

    def change(self, transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        return self.call(ChangeState, "arm_streamer/change_state", request).success

    @property
    def state(self):
        return self.call(GetState, "arm_streamer/get_state", GetState.Request()).current_state.id

    def set(self, **values):
        changes = [Parameter(n.replace("__", "."), value=value) for n, value in values.items()]
        return self.node.set_parameters(changes)

    def streams(self):
        return self.node.status()[:2] == (OK, "streaming")

    def ready(self):
        self.until(self.streams, "streaming")
        self.until(lambda: self.states, "joint states")
        self.until(self.previews.get_subscription_count, "a listener")
        self.home = np.array(self.states[-1].position)

    def message(self, place, times=(0.0, 0.4), names=UR_JOINTS, ago=0.0):
        """Return a preview; `place` maps a time since the stamp to angles and speeds."""
        message = JointTrajectory(joint_names=list(names))
        stamp = self.probe.get_clock().now() - rclpy.duration.Duration(seconds=ago)
        message.header.stamp = stamp.to_msg()
        for t in times:
            angles, speeds = place(t)
            message.points.append(
                JointTrajectoryPoint(
                    positions=[*map(float, angles)],
                    velocities=[*map(float, speeds)],
                    time_from_start=Duration(sec=int(t), nanosec=int(t % 1 * 1e9)),
                )
            )
        return message

    def swing(self, controller, amplitude=0.3, rate=1.5):
        """Publish a motion in alternating directions from now on and wait until the arm moves."""
        begin, home = time.monotonic(), controller.place
        self.way = -self.way
        amplitude *= self.way

        def send():
            nonlocal begin
            if controller.rests():
                begin = time.monotonic()  # the preview is not yet followed
            now = time.monotonic() - begin

            def place(t):
                angle = rate * (now + t)
                offset, speed = 1.0 - math.cos(angle), rate * math.sin(angle)
                return home + amplitude * offset, np.full(6, amplitude * speed)

            self.previews.publish(self.message(place, np.arange(0.0, 0.6, 0.02)))

        self.source = send
        self.until(lambda: controller.speed > 0.3, "motion")


@contextmanager
def bench(ports, **parameters):
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    context = rclpy.Context()
    context.init(domain_id=free_domain())
    made = None
    try:
        made = Bench(context, ports, **parameters)
        yield made
    finally:
        if made is not None:
            for node in (made.probe, made.node):
                made.executor.remove_node(node)
                node.destroy_node()
            made.executor.shutdown()
        context.try_shutdown()


@pytest.fixture
def arm():
    controller = Controller()
    yield controller
    controller.server.close()


@pytest.fixture(scope="module")
def streaming():
    """Return a bench for tests that leave the arm holding, as before."""
    controller = Controller()
    with bench(controller.ports) as it:
        it.ready()
        yield it, controller
    controller.server.close()


def assert_stands(it, controller, reason):
    """Assert that the arm is stopped for a reason and stays at rest despite new previews."""
    it.until(controller.rests, "rest")
    it.until(lambda: it.stops.get(NODE, "").startswith("stopped: "), "the stop")
    place = controller.place
    it.spin(0.3)
    assert np.abs(controller.place - place).max() < 0.02
    assert reason in it.stops[NODE]
    it.until(lambda: it.diagnostics[NODE].level == ERROR, "the diagnostics")
    assert reason in it.diagnostics[NODE].message


def assert_goes_on(it, controller):
    """Assert that the streamer holds the arm at its position after a reset."""
    it.source = None
    controller.fault(pause_program=False)
    it.until(lambda: it.ask("reset").success, "a reset")
    it.until(it.streams, "streaming")
    place = controller.place
    it.spin(0.2)
    assert np.abs(controller.place - place).max() < STILL, "a reset starts no motion"


def test_streamer_starts_itself_moves_the_arm_and_reports(arm):
    with bench(arm.ports) as it:
        it.ready()
        it.swing(arm)
        message = it.states[-1]
        assert tuple(message.name) == UR_JOINTS and max(map(abs, message.velocity)) > 0.1
        age = it.node.get_clock().now().nanoseconds * 1e-9 - (
            message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        )
        assert 0.0 <= age < 1.0
        it.until(lambda: it.timing, "timing")
        intervals, ages = it.timing[-1].layout.dim
        assert (intervals.label, ages.label) == ("intervals", "ages")
        assert intervals.size >= 25 and ages.size > 0
        assert len(it.timing[-1].data) == intervals.size + ages.size
        it.until(lambda: it.diagnostics.get(NODE) is not None, "diagnostics")
        arm.inner.slider = 0.5
        it.until(lambda: it.scaling[-1] == 0.5, "the speed slider")
        arm.inner.slider = 1.0
        it.until(lambda: it.scaling[-1] == 1.0, "the speed slider")
        it.ask("stop")
        it.until(lambda: it.scaling[-1] == 0.0, "an arm that does not move is told as 0")


def test_life_cycle_connects_holds_stops_and_disconnects(arm):
    with bench(arm.ports, autostart=False) as it:
        assert it.state == State.PRIMARY_STATE_UNCONFIGURED
        assert it.change(Transition.TRANSITION_CONFIGURE)
        assert not arm.plays()
        it.until(lambda: it.states, "joint states before it is active")
        it.previews.publish(it.message(lambda t: (arm.place, np.zeros(6))))
        it.until(lambda: it.node.warning_counts, "a warning")
        assert not it.scaling
        assert it.change(Transition.TRANSITION_ACTIVATE)
        assert it.state == State.PRIMARY_STATE_ACTIVE and arm.plays()
        it.swing(arm)
        assert it.change(Transition.TRANSITION_DEACTIVATE)
        it.until(lambda: not arm.plays() and arm.rests(), "rest, and the program's end")
        process = it.node.streaming.process._process
        assert process.poll() is None
        assert it.change(Transition.TRANSITION_CLEANUP)
        assert process.poll() == 0
        assert it.state == State.PRIMARY_STATE_UNCONFIGURED
        assert it.change(Transition.TRANSITION_CONFIGURE)
        assert it.change(Transition.TRANSITION_ACTIVATE)
        for wrong in (
            Transition.TRANSITION_CONFIGURE,
            Transition.TRANSITION_ACTIVATE,
            Transition.TRANSITION_CLEANUP,
            200,
        ):
            assert not it.change(wrong)
        assert it.state == State.PRIMARY_STATE_ACTIVE and it.streams()


def test_stop_reset_while_inactive_does_not_return(streaming):
    it, _ = streaming
    it.ask("stop")
    it.until(lambda: it.node.streaming.report.stop_reason, "the stop")
    assert it.change(Transition.TRANSITION_DEACTIVATE)
    assert not it.change(Transition.TRANSITION_ACTIVATE), "the streamer is stopped"
    assert it.ask("reset").success
    it.spin(0.2)
    assert it.node.latch.released
    assert it.change(Transition.TRANSITION_ACTIVATE)
    assert it.streams()


def test_failed_activation_can_be_retried_at_once(arm):
    with bench(arm.ports, autostart=False) as it:
        assert it.change(Transition.TRANSITION_CONFIGURE)
        arm.inner.power(RobotMode.POWER_OFF)
        it.until(lambda: "power off" in it.node.streaming.report.blocking_reason, "power off")
        assert not it.change(Transition.TRANSITION_ACTIVATE)
        it.until(arm.power_on, "power")
        it.until(lambda: not it.node.streaming.report.blocking_reason, "the news of it")
        assert it.change(Transition.TRANSITION_ACTIVATE)


def test_streamer_waits_for_a_controller_that_is_switched_on_later(arm):
    arm.fault(refuse_connections=True)
    with bench(arm.ports, **{"ur.connect_timeout": 0.1}) as it:
        it.until(lambda: it.node.warning_counts.get("configure"), "an attempt")
        assert it.node.status()[:2] == (WARN, "unconfigured")
        arm.fault(refuse_connections=False)
        it.until(it.streams, "streaming")


def test_configure_reports_a_controller_that_refuses(arm, capfd):
    why = "output 'output_int_register_24': NOT_FOUND; parameter ur.register chooses it"
    arm.fault(outputs_not_found=("output_int_register_24",))
    with bench(arm.ports, autostart=False, **{"ur.connect_timeout": 0.2}) as it:
        assert not it.change(Transition.TRANSITION_CONFIGURE)
        assert it.state == State.PRIMARY_STATE_UNCONFIGURED
    assert why in capfd.readouterr().err


def test_occupied_reverse_port_is_reported(capfd):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with bench({}, autostart=False, **{"ur.reverse_port": port}) as it:
            assert not it.change(Transition.TRANSITION_CONFIGURE)
    assert f"ur.reverse_port = {port} is not available" in capfd.readouterr().err


@pytest.mark.parametrize("how", ["service", "topic"])
def test_stop_is_latched_until_a_reset_that_starts_no_motion(streaming, how):
    it, arm = streaming
    it.swing(arm)
    if how == "service":
        assert it.ask("stop").success
        assert_stands(it, arm, "~/stop")
    else:
        it.emergency.publish(Bool(data=True))
        assert_stands(it, arm, "emergency_stop")
        answer = it.ask("reset")
        assert not answer.success and "emergency_stop is true" in answer.message
        it.emergency.publish(Bool(data=False))
        it.until(lambda: not it.node.latch.emergency, "the release")
        assert_stands(it, arm, "emergency_stop")
    assert not arm.plays()
    assert_goes_on(it, arm)
    it.swing(arm)
    it.source = None
    it.until(arm.rests, "rest")


def test_earlier_emergency_stop_keeps_the_streamer_inactive(arm):
    with bench(arm.ports, autostart=False) as it:
        it.emergency.publish(Bool(data=True))
        it.until(lambda: it.node.latch.emergency, "the emergency stop")
        assert it.change(Transition.TRANSITION_CONFIGURE)
        assert not it.change(Transition.TRANSITION_ACTIVATE)
        assert not arm.inner.counts.programs


def test_stopped_peer_holds_the_arm_with_the_program_running(streaming):
    it, arm = streaming
    programs = arm.inner.counts.programs
    it.swing(arm)
    peer = DiagnosticStatus(name="/probe", level=ERROR, message="stopped: test")
    it.peers.publish(peer)
    it.until(lambda: it.stops.get(NODE, "").startswith("holding: stopped peer /probe"), "it")
    it.until(arm.rests, "rest")
    place = arm.place
    it.spin(0.3)
    assert np.abs(arm.place - place).max() < 0.02 and arm.plays()
    it.source = None
    it.spin(0.1)
    peer.level = OK
    it.peers.publish(peer)
    it.until(lambda: it.stops[NODE] == "running", "the release")
    place = arm.place
    it.spin(0.2)
    assert np.abs(arm.place - place).max() < STILL, "a release starts no motion"
    assert arm.inner.counts.programs == programs
    it.swing(arm)
    it.source = None
    it.until(arm.rests, "rest")


def test_reset_unlocks_a_protective_stop_only_where_allowed(streaming):
    it, arm = streaming
    it.swing(arm)
    arm.fault(protective_stop=True)
    assert_stands(it, arm, "safety mode: protective stop")
    answer = it.ask("reset")
    assert not answer.success and "ur.unlock" in answer.message
    assert all(result.successful for result in it.set(ur__unlock=True))
    arm.fault(protective_stop=False)
    answer = it.ask("reset")
    assert not answer.success
    assert "the controller reports: Cannot unlock protective stop until 5s" in answer.message
    arm.inner.modes = replace(arm.inner.modes, stopped=-10.0)  # long ago
    assert_goes_on(it, arm)


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        ({"emergency_stop": True}, "safety mode: robot emergency stop"),
        ({"pause_program": True}, "the program is paus"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_controller_fault_is_reported_and_latched(streaming, fault, why):
    it, arm = streaming
    it.swing(arm)
    arm.fault(**fault)
    assert_stands(it, arm, why)
    if "emergency_stop" in fault:
        assert "still present: safety mode" in it.ask("reset").message
        arm.fault(emergency_stop=False)
        it.until(lambda: arm.inner.safety_mode is SafetyMode.NORMAL, "the release")
        it.until(arm.power_on, "power")
    assert_goes_on(it, arm)


BAD = {
    "nan": lambda it: it.message(lambda t: (it.home + math.nan, np.zeros(6))),
    "infinity": lambda it: it.message(lambda t: (it.home + math.inf, np.zeros(6))),
    "nan speed": lambda it: it.message(lambda t: (it.home, np.full(6, math.nan))),
    "huge": lambda it: it.message(lambda t: (it.home + 1e300, np.zeros(6))),
    "jump 0.16": lambda it: it.message(lambda t: (it.home + 0.16, np.zeros(6))),
    "jump 3": lambda it: it.message(lambda t: (it.home - 3.0, np.zeros(6))),
    "alias": lambda it: it.message(lambda t: (it.home + math.tau, np.zeros(6))),
    "too sharp": lambda it: it.message(lambda t: (it.home + 0.5 * t, np.zeros(6))),
    "too fast": lambda it: it.message(lambda t: (it.home + 1.5 * t, np.zeros(6)), (0.0, 0.6)),
    "late": lambda it: it.message(lambda t: (it.home + 0.01, np.zeros(6)), ago=2.0),
    "early": lambda it: it.message(lambda t: (it.home + 0.01, np.zeros(6)), ago=-2.0),
    "names": lambda it: it.message(lambda t: (it.home, np.zeros(6)), names=list("abcdef")),
    "twice": lambda it: it.message(
        lambda t: (it.home, np.zeros(6)), names=[*UR_JOINTS[:5], UR_JOINTS[0]]
    ),
    "five": lambda it: it.message(lambda t: (it.home[:5], np.zeros(5))),
    "no speeds": lambda it: it.message(lambda t: (it.home, ())),
    "empty": lambda it: it.message(None, times=()),
    "backward": lambda it: it.message(lambda t: (it.home, np.zeros(6)), times=(0.4, 0.0)),
}


@pytest.mark.parametrize("bad", BAD)
def test_invalid_preview_causes_a_warning_and_no_motion(streaming, bad):
    it, controller = streaming
    it.home = controller.place
    counts = it.node.warning_counts
    before = sum(counts.values())
    it.previews.publish(BAD[bad](it))
    it.until(lambda: sum(counts.values()) > before, "a warning")
    assert it.node.streaming.report.at_rest and it.streams()
    it.spin(0.05)
    assert it.node.streaming.report.at_rest
    assert np.abs(controller.place - it.home).max() < STILL


@pytest.mark.parametrize(
    ("parameters", "name"),
    [
        ({"use_sim_time": True}, "use_sim_time"),
        ({"arm.joints": ["a", "b", "c"]}, "arm"),
        ({"arm.velocity": [4.0]}, "arm.velocity"),
        ({"arm.lower": [1.0], "arm.upper": [0.0]}, "arm.lower"),
        ({"ur.read_timeout": 0.5}, "ur.read_timeout"),
        ({"ur.register": 48}, "ur.register"),
    ],
)
def test_invalid_parameter_is_rejected_naming_the_parameter(parameters, name):
    with pytest.raises(ParameterError, match=name), bench({}, autostart=False, **parameters):
        pass


def test_fixed_parameters_are_read_only_and_live_ones_change_at_runtime(streaming):
    it, _ = streaming
    fixed, bad, live = it.set(ur__read_timeout=0.1, arm__velocity=[-1.0], arm__upper=[6.0])
    assert not fixed.successful and not bad.successful
    assert "arm.velocity" in bad.reason
    assert live.successful


def test_hanging_streaming_process_is_reported_and_a_reset_refused(streaming):
    it, arm = streaming
    process = it.node.streaming.process._process
    os.kill(process.pid, signal.SIGSTOP)
    try:
        it.until(lambda: "has not reported" in it.stops.get(NODE, ""), "the stop")
        assert "still present: the streaming process has not reported" in it.ask("reset").message
    finally:
        os.kill(process.pid, signal.SIGCONT)
    assert_goes_on(it, arm)


def test_granted_reset_replaces_an_ended_streaming_process(arm):
    with bench(arm.ports, **{"ur.connect_timeout": 0.3}) as it:
        it.ready()
        it.swing(arm)
        arm.fault(refuse_connections=True)
        os.kill(it.node.streaming.process._process.pid, signal.SIGKILL)
        assert_stands(it, arm, "the streaming process has ended")
        assert not it.ask("reset").success, "there is no controller"
        arm.fault(refuse_connections=False)
        assert_goes_on(it, arm)


def test_shutdown_brings_the_arm_to_rest_and_ends_the_program(arm):
    with bench(arm.ports) as it:
        it.ready()
        it.swing(arm)
        it.source = None
        it.node.begin_shutdown("SIGTERM")
        assert not it.node.finished
        it.until(lambda: it.node.finished, "the end")
        it.until(lambda: arm.rests() and not arm.plays(), "rest")
        process = it.node.streaming.process._process
    assert process.poll() == 0
