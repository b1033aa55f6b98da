"""The arm of a simulated controller in a simulated world, as processes."""

import os
import re
import signal
import socket
import subprocess
import sys

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from omniman_ros.console.session import Session
from test.nodes.harness import free_domain
from test.running import arm_on_free_ports

pytest.importorskip("mujoco")
pytestmark = pytest.mark.processes

PATIENCE = 120.0  #: Real time for what a test waits for [s]
STOP = 2.0  #: Real time for which simulated time has to stand while a process is stopped [s]
SCENE = """
tables:
  - {name: table, x: 1.2, y: 0.0, length: 0.8, width: 1.6, height: 0.35}
"""
MOVE = "def f():\n  movej([{}], a=3.0, v=0.6)\nend\n"


class Robot:
    """World and controller, their time, and where the arm is."""

    def __init__(self, session, up, log):
        self.session, self.up, self._log = session, up, log
        self.time, self.states, self.touched = 0.0, [], []
        self._passed_at = session.now()
        node = session.node
        node.create_subscription(Clock, "/clock", self._on_clock, 200)
        truth = "ground_truth/arm_joint_states"
        node.create_subscription(JointState, truth, self.states.append, 10)
        node.create_subscription(DiagnosticArray, "contacts", self._on_contacts, 10)

    def _on_clock(self, message):
        now = message.clock.sec + 1e-9 * message.clock.nanosec
        if now != self.time:
            self.time, self._passed_at = now, self.session.now()

    def _on_contacts(self, message):
        self.touched += [{v.key: v.value for v in status.values} for status in message.status]

    def has_stood(self):
        return self.session.now() - self._passed_at > STOP

    def log(self):
        return self._log.read_text()

    def until(self, condition, what):
        assert self.session.wait(condition, PATIENCE), f"waited for {what}: {self.log()}"

    def move(self, *angles):
        """Send a program that moves the arm."""
        port = int(re.search(r"secondary (\d+)", self.log())[1])
        program = MOVE.format(", ".join(map(str, angles)))
        with socket.create_connection(("127.0.0.1", port)) as connection:
            connection.sendall(program.encode())
            connection.recv(1)  # the controller reads in its cycle, and then sends its state
        return np.array(angles)

    def distance(self, angles):
        return float(np.abs(np.array(self.states[-1].position) - angles).max())


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_DOMAIN_ID"] = str(free_domain())
    folder = tmp_path_factory.mktemp("up")
    scene, log = folder / "scene.yaml", folder / "log"
    scene.write_text(SCENE)
    options = ["--world", str(scene), *arm_on_free_ports()]
    options += ["--only", "simulated_world", "simulated_ur"]
    with log.open("w") as output:
        up = subprocess.Popen(
            [sys.executable, "-m", "omniman_ros.cli.main", "up", *options],
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        try:
            with Session("probe") as session:
                it = Robot(session, up, log)
                it.until(lambda: it.states and "the arm answers: RUNNING" in it.log(), "the arm")
                yield it
        finally:
            up.send_signal(signal.SIGINT)
            code = up.wait(PATIENCE)
    assert code == 0


def test_time_waits_for_a_controller_that_is_stopped_and_the_arm_goes_on(robot):
    goal = robot.move(0.3, -1.0, 0.5, -1.57, -1.57, 0.0)
    pid = int(re.search(r"simulated_ur \(pid (\d+)\)", robot.log())[1])
    os.kill(pid, signal.SIGSTOP)
    try:
        robot.until(robot.has_stood, "simulated time to stand")
    finally:
        os.kill(pid, signal.SIGCONT)
    robot.until(lambda: robot.distance(goal) < 2e-3, "the arm at its goal")
    assert "disconnected" not in robot.log() and "protective stop" not in robot.log()


def test_an_arm_that_is_moved_into_a_table_is_stopped(robot):
    robot.move(0.0, 1.0, 0.0, -1.57, -1.57, 0.0)
    robot.until(lambda: "protective stop: collision detected" in robot.log(), "the stop")
    robot.until(lambda: robot.touched, "the contact")
    assert robot.touched[0]["thing"] == "table"
    end = robot.time + 0.5
    robot.until(lambda: robot.time > end, "half a second")
    assert np.abs(robot.states[-1].velocity).max() < 0.01
    assert float(robot.touched[-1]["force_z"]) < 100.0
