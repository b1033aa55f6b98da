"""Streamer and simulated controller as separate processes: signals, kills, freezes, two arms.

The machine may be busy: timeouts are long, and the tests assert events and not their timing.
The arm is judged by the controller's ground truth and not by the streamer's states.
"""

import math
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from omniman_ros.console.session import Session
from omniman_ros.core.arm_parameters import UR_JOINTS, ArmParameters
from omniman_ros.nodes.registry import node_module
from omniman_ros.nodes.stop_interface import ALL_LATCHED
from omniman_ros.processes.ros_domain import free_domain
from omniman_ros.simulation.ur.arm import CYCLE

pytestmark = pytest.mark.processes

PATIENCE = 40.0
PATIENT = ("ur.read_timeout:=0.2", "ur.feedback_timeout:=1.0", "ur.following_error:=1.0")
PORTS = ("dashboard", "primary", "secondary", "realtime", "rtde", "reverse")
REST, STILL = 0.01, 0.01
"""Speed below which the arm counts as standing [rad/s] and its allowed further travel [rad]."""
#: Reason of a stop by the controller after setpoints that a busy machine has held up
HELD_UP = "stopped: safety mode: protective stop"
RETRY = 1.0  #: Time after which a motion that the arm does not follow begins anew [s]
RESET_PERIOD = 0.5  #: Time after which a reset that was not granted is asked for again [s]
LASTING = 0.4  #: Time for which nothing may move [s]


@pytest.fixture
def domain(monkeypatch):
    """Put this process and those it starts into a ROS domain of the test's own."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def free_ports():
    """Return the numbers of currently free ports."""
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in PORTS]
    numbers = [sock.getsockname()[1] for sock in sockets]
    for sock in sockets:
        sock.close()
    return dict(zip(PORTS, numbers, strict=True))


class Robot:
    """An arm in a namespace: controller, streamer and a probe that moves the arm."""

    def __init__(self, session, namespace=""):
        self.session, self.namespace = session, namespace
        self.ports = free_ports()
        self.children = []
        self.truth, self.reason, self.reasons = [], "", set()
        self.source, self.way = None, -1.0
        self._asked, self._answer = 0.0, None
        node, prefix = session.node, f"{namespace}/" if namespace else ""
        node.create_subscription(
            JointState, f"{prefix}ground_truth/arm_joint_states", self._on_truth, 1000
        )
        node.create_subscription(
            DiagnosticStatus, f"{prefix}stop_state", self._on_stop_state, ALL_LATCHED
        )
        self._previews = node.create_publisher(JointTrajectory, f"{prefix}arm/joint_reference", 1)
        self._reset = node.create_client(Trigger, f"{prefix}arm_streamer/reset")
        self._faults = node.create_client(SetParameters, f"{prefix}simulated_ur/set_parameters")
        node.create_timer(0.04, lambda: self.source and self.source())

    def _on_truth(self, message):
        self.truth.append((time.monotonic(), np.array(message.position), message.velocity))

    def _on_stop_state(self, message):
        self.reason = message.message
        self.reasons.add(message.message)

    def start(self, name, *parameters):
        code = f"import sys; from {node_module(name)} import main; sys.exit(main())"
        words = [word for text in parameters for word in ("-p", text)]
        if self.namespace:
            words += ["-r", f"__ns:=/{self.namespace}"]
        child = subprocess.Popen(
            [sys.executable, "-c", code, "--ros-args", *words], stderr=subprocess.PIPE, text=True
        )
        self.children.append(child)
        return child

    def controller(self):
        names = PORTS[:-1]
        return self.start("simulated_ur", *(f"ports.{k}:={self.ports[k]}" for k in names))

    def streamer(self, *parameters):
        return self.start(
            "arm_streamer",
            *PATIENT,
            *parameters,
            f"ur.rtde_port:={self.ports['rtde']}",
            f"ur.script_port:={self.ports['secondary']}",
            f"ur.dashboard_port:={self.ports['dashboard']}",
            f"ur.reverse_port:={self.ports['reverse']}",
        )

    def end(self):
        for child in self.children:
            if child.poll() is None:
                for pid in (*children_of(child.pid), child.pid):
                    os.kill(pid, signal.SIGKILL)
            child.communicate()

    def until(self, done, what):
        assert self.session.wait(done, PATIENCE), f"waited for {what}: {self.reason}"

    @property
    def speed(self):
        return max(map(abs, self.truth[-1][2])) if self.truth else math.nan

    def rests(self):
        """Return whether the arm stands and has stood for a moment."""
        since = time.monotonic() - 0.1
        recent = [max(map(abs, v)) for at, _, v in self.truth[-30:] if at > since]
        return len(recent) > 5 and max(recent) < REST

    def hardest_braking(self, since):
        """Return the largest deceleration between two samples of the truth [rad/s^2].

        It follows from ways and speeds: the time at which a sample arrives depends on the machine.
        The controller moves the arm by the speed at the end of each cycle.
        """
        samples = self.truth[since:]
        speed = np.array([max(map(abs, velocity)) for _, _, velocity in samples])
        place = np.array([position[0] for _, position, _ in samples])
        way = np.abs(np.diff(place))
        braking = -np.diff(speed**2) / np.maximum(2.0 * way - CYCLE * np.diff(speed), 1e-6)
        return braking[way > 1e-4].max(initial=0.0)

    def stays(self):
        """Assert that nothing moves for a while."""
        place = self.truth[-1][1]
        self.session.spin(LASTING)
        assert np.abs(self.truth[-1][1] - place).max() < STILL, "the arm moves"

    def swing(self):
        """Publish a motion in alternating directions from now on and wait until the arm moves.

        What the machine holds up before that is stopped, and then reset.
        """
        self.until(lambda: self.truth, "the controller")
        begin, home = time.monotonic(), self.truth[-1][1]
        self.way = -self.way

        def send():
            nonlocal begin, home
            if time.monotonic() - begin > RETRY and self.rests():
                begin, home = time.monotonic(), self.truth[-1][1]  # it has not been followed
            now = time.monotonic() - begin
            message = JointTrajectory(joint_names=list(UR_JOINTS))
            message.header.stamp = self.session.node.get_clock().now().to_msg()
            for t in np.arange(0.0, 0.6, 0.02):
                angle = 1.5 * (now + t)
                place = home + self.way * 0.3 * (1.0 - math.cos(angle))
                message.points.append(
                    JointTrajectoryPoint(
                        positions=place.tolist(),
                        velocities=[self.way * 0.45 * math.sin(angle)] * 6,
                        time_from_start=Duration(nanosec=int(t * 1e9)),
                    )
                )
            self._previews.publish(message)

        self.source = send
        self.until(self.moves, "motion")

    def moves(self):
        """Return whether the arm moves; what has been stopped is reset."""
        if self.reason.startswith("stopped: "):
            self._is_reset()
        return self.speed > 0.35

    def call(self, client, request):
        self.until(client.service_is_ready, client.srv_name)
        future = client.call_async(request)
        self.until(future.done, client.srv_name)
        return future.result()

    def fault(self, name, value):
        """Switch a fault of the controller on or off."""
        parameter = Parameter(f"faults.{name}", value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        assert self.call(self._faults, request).results[0].successful

    def reset_refusal(self):
        """Ask for a reset that has to be refused; return why."""
        answer = self.call(self._reset, Trigger.Request())
        assert not answer.success
        return answer.message

    def reset(self):
        self.source, self._answer = None, None
        self.until(self._reset.service_is_ready, "~/reset")
        self.until(self._is_reset, "a reset")
        self.until(lambda: self.reason == "running", "the release")

    def _is_reset(self):
        """Return whether a reset was granted; ask for one periodically."""
        if self._answer is not None and self._answer.done():
            is_granted, self._answer = self._answer.result().success, None
            if is_granted:
                return True
        if time.monotonic() - self._asked > RESET_PERIOD:
            self._asked, self._answer = time.monotonic(), self._reset.call_async(Trigger.Request())
        return False


def children_of(pid):
    """Return the process ids of a process's children."""
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def is_alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture
def robot(domain):
    with Session("probe") as session:
        made = Robot(session)
        yield made
        made.end()


def test_signal_in_motion_brings_the_arm_to_rest_before_the_end(robot):
    robot.controller()
    for number in (signal.SIGTERM, signal.SIGINT):
        streamer = robot.streamer()
        robot.swing()
        (process,) = children_of(streamer.pid)
        streamer.send_signal(number)
        signalled = len(robot.truth)
        robot.until(lambda: "shutting down" in robot.reason, "the stop")
        robot.until(lambda child=streamer: child.poll() is not None, "the end")
        robot.source = None
        assert streamer.returncode == 0
        assert not is_alive(process), "the streaming process is left behind"
        robot.until(robot.rests, "rest")
        # The motion itself decelerates by up to 0.7 rad/s^2, a stop by 4.
        hardest = robot.hardest_braking(signalled)
        assert hardest > 2.0, "the arm followed the motion to its end"
        assert hardest < min(ArmParameters().acceleration), "the arm stopped dead"
        robot.stays()


def test_frozen_and_killed_processes_leave_the_arm_at_rest_until_a_reset(robot):
    # A controller that was frozen reads what has arrived at once, which may end in a protective
    # stop: a reset then unlocks it.
    controller, streamer = robot.controller(), robot.streamer("ur.unlock:=true")
    robot.swing()
    (process,) = children_of(streamer.pid)
    os.kill(process, signal.SIGSTOP)
    robot.until(robot.rests, "rest")
    robot.until(lambda: "has not reported" in robot.reason, "the reason")
    robot.stays()
    os.kill(process, signal.SIGCONT)
    robot.stays()
    robot.reset()
    robot.swing()
    os.kill(controller.pid, signal.SIGSTOP)
    robot.until(lambda: "stopped: no data for" in robot.reason, "the reason")
    os.kill(controller.pid, signal.SIGCONT)
    robot.until(robot.rests, "rest")
    robot.stays()
    robot.reset()
    robot.swing()
    streamer.kill()
    robot.until(robot.rests, "rest")
    robot.until(lambda: not is_alive(process), "the end of the streaming process")


def test_streamer_starts_once_its_port_and_its_controller_are_there(robot):
    attempts = []

    def count_attempts(message):
        values = {value.key: value.value for value in message.status[0].values}
        attempts.append(int(values.get("warned: configure", 0)))

    robot.session.node.create_subscription(DiagnosticArray, "/diagnostics", count_attempts, 10)
    with socket.create_server(("127.0.0.1", robot.ports["reverse"])):
        streamer = robot.streamer("ur.connect_timeout:=1.0")
        robot.until(lambda: attempts and attempts[-1] > 0, "an attempt without the port")
        since = attempts[-1]
    robot.until(lambda: attempts[-1] > since + 1, "an attempt without the controller")
    robot.controller()
    robot.swing()
    streamer.send_signal(signal.SIGTERM)
    robot.until(lambda: streamer.poll() is not None, "the end")
    log = streamer.stderr.read()
    assert f"ur.reverse_port = {robot.ports['reverse']} is not available" in log
    assert "no data from 127.0.0.1: connection refused" in log


def test_reset_unlocks_a_protective_stop_once_the_controller_allows_it(robot):
    robot.controller()
    robot.streamer("ur.unlock:=true")
    robot.swing()
    robot.fault("protective_stop", True)
    robot.until(lambda: "stopped: safety mode: protective stop" in robot.reason, "the stop")
    robot.until(robot.rests, "rest")
    robot.stays()
    robot.reset()
    robot.stays()
    robot.swing()


def test_reset_replaces_a_killed_streaming_process_once_the_controller_answers(robot):
    robot.controller()
    streamer = robot.streamer()
    robot.swing()
    robot.fault("refuse_connections", True)
    (process,) = children_of(streamer.pid)
    os.kill(process, signal.SIGKILL)
    robot.until(lambda: "the streaming process has ended" in robot.reason, "the stop")
    robot.until(robot.rests, "rest")
    robot.stays()
    # A process that has not reported yet is a reason, too.
    robot.until(
        lambda: "still present: connection refused" in robot.reset_refusal(), "the refusal"
    )
    robot.fault("refuse_connections", False)
    robot.reset()
    robot.stays()
    robot.swing()
    assert children_of(streamer.pid) != [process]


def test_restarted_controller_moves_the_arm_after_a_reset(robot):
    first = robot.controller()
    robot.streamer()
    robot.swing()
    first.kill()
    robot.until(lambda: robot.reason.startswith("stopped: "), "the stop")
    first.wait()
    robot.truth.clear()
    robot.controller()
    robot.until(lambda: robot.truth, "the new controller")
    robot.stays()
    robot.reset()
    robot.stays()


def test_stop_of_one_robot_does_not_stop_another_on_the_same_machine(domain):
    with Session("probe") as session:
        left, right = robots = [Robot(session, name) for name in ("left", "right")]
        try:
            for robot in robots:
                robot.controller()
                robot.streamer("ur.unlock:=true")
            for robot in robots:
                robot.swing()
            right.reasons.clear()
            left.children[1].send_signal(signal.SIGTERM)
            left.until(lambda: left.children[1].poll() is not None, "the end")
            left.until(left.rests, "rest")
            right.until(right.moves, "motion")
            assert right.reasons <= {"running", HELD_UP}
        finally:
            for robot in robots:
                robot.end()
