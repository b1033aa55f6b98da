"""Bridge and simulated drives as separate processes, on a bus of UDP multicast.

The machine may be busy: timeouts are long, and the tests assert events and not their timing;
the table of faults (`omniman bench faults`) measures reactions.
"""

import math
import os
import signal
import time
from contextlib import contextmanager

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from omniman_ros.console.session import Session
from omniman_ros.nodes.stop_interface import ALL_LATCHED
from omniman_ros.processes.drive_options import FIRST_PORT
from omniman_ros.processes.ros_domain import free_domain
from test.end_to_end.bus_recorder import BusRecorder
from test.running import (
    PATIENCE,
    Running,
    children_of,
    command,
    environment,
    is_alive,
    wait_until,
)

pytestmark = pytest.mark.processes

NODES = ("platform_controller", "can_bridge", "simulated_can_drives")
CONTROLLER, BRIDGE, DRIVES = NODES
TIMEOUTS = (
    "timeouts.wheel_states:=2.0",
    "firmware.watchdog:=0.5",
    "safety.deadline:=0.05",
    "can.missed_periods:=100",
    "can.drive_heartbeat:=0.2",
    "can.heartbeat_timeout:=0.5",
    "can.command_timeout:=0.5",
)  #: Parameters that relax timeouts for a busy machine: no real robot moves while a process waits
OPTIONS = [word for text in TIMEOUTS for word in ("-p", text)]
SPEED = 0.3  #: Commanded speed of the platform [m/s]
#: Speed below which the platform counts as standing [m/s]; a wheel turns at 0.04 rad/s then
REST = 0.005
LASTING = 0.5  #: Time for which nothing may move [s]

POWER_OFF = {
    # Controlword "disable voltage" or, once it is off, "shutdown" (IEC 61800-7-201); no target.
    "cia402": lambda node: {0x200 + node: ("000000000000", "060000000000")},
    "vesc": lambda node: {0x100 | node: ("00000000",)},  # zero current
    # Axis state IDLE (CANSimple, Set_Axis_State) and zero velocity.
    "odrive": lambda node: {
        node << 5 | 0x07: ("0100000000000000",),
        node << 5 | 0x0D: ("0000000000000000",),
    },
}  #: Ids of the last frames to a drive by node id, with the allowed beginnings of their data
NODE_IDS = {"cia402": (1, 2, 3, 4), "vesc": (1, 2, 3, 4), "odrive": (0, 1, 2, 3)}


@pytest.fixture
def domain(monkeypatch):
    """Put this process, and those that it starts, into a ROS domain of the test's own."""
    number = free_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return number


class Probe:
    """A probe that drives the robot and receives its ground truth and its nodes' stop states."""

    def __init__(self, session):
        self.session = session
        node = session.node
        self.truth = self.odom = None
        self.reasons = {}
        self._twist = Twist()
        self._publisher = node.create_publisher(Twist, "cmd_vel", QoSProfile(depth=1))
        node.create_subscription(Odometry, "ground_truth/odom", self._on_truth, 10)
        node.create_subscription(Odometry, "odom", self._on_odom, 10)
        node.create_subscription(DiagnosticStatus, "stop_state", self._on_state, ALL_LATCHED)
        self._resets = {
            f"/{name}": node.create_client(Trigger, f"{name}/reset") for name in NODES[:2]
        }
        node.create_timer(0.05, lambda: self._publisher.publish(self._twist))

    def _on_truth(self, message):
        self.truth = message

    def _on_odom(self, message):
        self.odom = message

    def _on_state(self, message):
        self.reasons[message.name] = message.message

    def ask(self, x=0.0, y=0.0, turn=0.0):
        """Publish a twist continuously from now on."""
        self._twist.linear.x, self._twist.linear.y, self._twist.angular.z = x, y, turn

    def until(self, condition, what):
        assert self.session.wait(condition, PATIENCE), f"waited for {what}: {self.reasons}"

    @property
    def speed(self):
        twist = self.truth.twist.twist
        return math.hypot(twist.linear.x, twist.linear.y) + 0.3 * abs(twist.angular.z)

    def moves(self):
        return self.truth is not None and self.speed > 0.9 * SPEED

    def rests(self):
        return self.truth is not None and self.speed < REST

    def come_to_rest(self):
        self.until(self.rests, "rest")

    def stay(self):
        """Assert that nothing moves for a while."""
        end = time.monotonic() + LASTING
        assert not self.session.wait(lambda: not self.rests(), LASTING), "the robot moves"
        assert time.monotonic() >= end

    def drive(self, condition, what, **twist):
        """Drive until a condition holds; nodes that are stopped are reset, repeatedly if refused.

        A bus on real time may stop the robot on a machine that stands still for a moment. After a
        stop a source of motion is ignored until it has commanded zero once.
        """
        asked = released = -math.inf

        def driven():
            nonlocal asked, released
            now = time.monotonic()
            held = [name for name in self._resets if self.reasons.get(name) != "running"]
            if held:
                released = now
                if now - asked > 0.3:
                    asked = now
                    for name in held:
                        if self._resets[name].service_is_ready():
                            self._resets[name].call_async(Trigger.Request())
            self.ask(**(twist if now - released > LASTING else {}))
            return condition()

        self.until(driven, what)

    def set_off(self):
        """Drive ahead, after a reset of what is stopped."""
        self.drive(self.moves, "motion", x=SPEED)


def poses(probe):
    """Return the true and the estimated pose of the robot: x, y and heading."""
    result = []
    for message in (probe.truth, probe.odom):
        at, q = message.pose.pose.position, message.pose.pose.orientation
        result.append((at.x, at.y, 2.0 * math.atan2(q.z, q.w)))
    return result


def pids(*ups):
    """Return the process ids of the nodes, by name."""
    return {
        name: pid
        for up in ups
        for pid, line in children_of(up.process.pid).items()
        for name in NODES
        if name in line.split()
    }


def start(domain, protocol, *names):
    arguments = ("up", "--drive", "can", "--installation", protocol, *OPTIONS, "--only", *names)
    return Running(command(*arguments), environment(domain))


@contextmanager
def robot(domain, protocol="cia402"):
    """Yield a driving robot: the running command, the probe, and the nodes' process ids."""
    with start(domain, protocol, *NODES) as up:
        up.wait_for("Ctrl-C stops")
        with Session("probe") as session:
            probe = Probe(session)
            try:
                probe.set_off()
            except AssertionError as error:
                up.process.terminate()
                up.finish()
                pytest.fail(f"{error}\n{up.output}")
            found = pids(up)
            assert set(found) == set(NODES)
            yield up, probe, found
        wait_until(lambda: not any(map(is_alive, found.values())), "the end of the nodes")


def follow(probe):
    """Drive a curve and stop: odometry over the bus agrees with the ground truth."""
    curve = {"x": 0.8 * SPEED, "y": 0.6 * SPEED, "turn": 0.4}
    probe.drive(lambda: abs(poses(probe)[0][2]) > 0.4, "a turn", **curve)
    probe.ask()
    probe.come_to_rest()

    def agrees():
        true, believed = poses(probe)
        return math.dist(true, believed) < 0.03

    probe.until(agrees, f"odometry like the truth, {poses(probe)}")
    true, _ = poses(probe)
    assert math.hypot(*true[:2]) > 0.2


def freeze(probe, bridge):
    """Freeze the bridge in motion: the drives stop by themselves and wait for a reset."""
    probe.set_off()
    os.kill(bridge, signal.SIGSTOP)
    try:
        probe.come_to_rest()
        probe.stay()
    finally:
        os.kill(bridge, signal.SIGCONT)
    probe.stay()
    probe.until(lambda: probe.reasons["/can_bridge"].startswith("stopped"), "the reason")
    probe.stay()
    probe.set_off()


def last_frames(frames, protocol):
    """Return the data of the last frame of each id that shows whether the drives have power."""
    ids = {i for node in NODE_IDS[protocol] for i in POWER_OFF[protocol](node)}
    return {frame.id: frame.data.hex() for frame in frames if frame.id in ids}


@pytest.mark.parametrize(
    "protocol",
    [
        "cia402",
        pytest.param("vesc", marks=pytest.mark.exhaustive),
        pytest.param("odrive", marks=pytest.mark.exhaustive),
    ],
)
def test_robot_of_up_follows_stops_when_frozen_and_ends_without_power(domain, protocol):
    with robot(domain, protocol) as (up, probe, found):
        follow(probe)
        if protocol != "odrive":  # the drive's watchdog lets the wheels turn freely
            freeze(probe, found[BRIDGE])
        probe.set_off()
        listener = BusRecorder(FIRST_PORT + domain)
        try:
            up.process.send_signal(signal.SIGINT)
            probe.until(lambda: not is_alive(found[BRIDGE]), "the bridge's end")
            frames = list(listener.frames)
        finally:
            listener.close()
        assert up.finish() == 0, up.output
        probe.session.spin(0.2)
        assert probe.rests(), "drives outlive the bridge, and all are at rest"
    last = last_frames(frames, protocol)
    for node in NODE_IDS[protocol]:
        for id, allowed in POWER_OFF[protocol](node).items():
            assert last[id].startswith(allowed), f"{id:X}: {last[id]}"


def test_killed_drives_are_reported_and_no_process_is_left_behind(domain):
    """The robot need not move: a bus on real time may stop it on a machine that stands still."""
    with start(domain, "cia402", *NODES) as up:
        up.wait_for("configured: 4 drives (cia402)")
        found = pids(up)
        assert set(found) == set(NODES)
        os.kill(found[DRIVES], signal.SIGKILL)
        assert up.finish() == 1
        assert not any(map(is_alive, found.values()))
    assert f"{DRIVES} was killed by SIGKILL: stopping the robot" in up.output


def test_new_bridge_after_a_killed_one_configures_the_drives_and_drives(domain):
    with (
        start(domain, "cia402", CONTROLLER, DRIVES) as others,
        start(domain, "cia402", BRIDGE) as first,
        Session("probe") as session,
    ):
        first.wait_for("Ctrl-C stops")
        others.wait_for("Ctrl-C stops")
        probe = Probe(session)
        probe.set_off()
        os.kill(pids(first)[BRIDGE], signal.SIGKILL)
        assert first.finish() == 1
        probe.come_to_rest()
        probe.stay()
        with start(domain, "cia402", BRIDGE) as second:
            second.wait_for("configured: 4 drives (cia402)")
            probe.set_off()
            for up in (second, others):
                up.process.send_signal(signal.SIGINT)
                assert up.finish() == 0, up.output
        session.spin(0.2)
        assert probe.rests()
