"""The arm of the simulated world's node, moved over a socket, on simulated time."""

import socket

import numpy as np
import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes.simulated_world import SimulatedWorldNode
from omniman_ros.simulation.arm_link.client import ArmLinkClient
from omniman_ros.simulation.ur.arm import CYCLE, UrArmParameters
from omniman_ros.simulation.ur.world_arm import WorldArm
from test.nodes.harness import PERIOD, World

pytest.importorskip("mujoco")


def free_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


class Robot(World):
    """The node in an empty scene, and a controller's arm that the test moves.

    Attributes:
        target: Angles that the arm follows; None to stay where it is.
        delay: Time by which the controller is behind [s].
    """

    def __init__(self, **parameters) -> None:
        self.port = free_port()
        given = {"scene": "empty", "world.wheels": "ideal", "arm_port": self.port}
        super().__init__(SimulatedWorldNode, parameters=given | parameters)
        self.node: SimulatedWorldNode = self.nodes[0]
        self.link = ArmLinkClient(self.port)
        self.arm = WorldArm(UrArmParameters(), self.link, is_lockstep=False)
        self.target, self.delay = None, 0.0
        self._due = self.time
        self.warnings = []
        self.node.warn = lambda subject, text: self.warnings.append(text)

    def cycle(self) -> None:
        """Run the cycles of the controller that are due."""
        while self._due <= self.time - self.delay:
            self.arm.measure(self._due)
            if self.arm.is_connected:
                target = self.arm.q if self.target is None else self.target
                self.arm.follow(np.array(target), CYCLE)
            self._due += CYCLE

    def close(self) -> None:
        if hasattr(self, "link"):
            self.link.close("the test is over")
        super().close()

    def move(self, seconds: float) -> None:
        self.run(seconds, self.cycle)

    @property
    def q(self):
        return self.node.world.arm.positions

    @property
    def is_connected(self) -> bool:
        return dict(self.node.status()[2])["arm_controller_connected"]


@pytest.fixture
def robot():
    with Robot() as robot:
        yield robot


def test_a_controller_moves_the_arm_from_where_it_is(robot):
    start = robot.q
    robot.move(0.1)
    assert robot.is_connected and robot.arm.is_connected
    np.testing.assert_allclose(robot.arm.q, start, atol=1e-3)
    robot.target = start + [0.1, -0.1, 0.1, 0.0, 0.2, 0.0]
    robot.move(0.5)
    np.testing.assert_allclose(robot.q, robot.target, atol=1e-3)
    np.testing.assert_allclose(robot.arm.q, robot.q, atol=1e-3)
    assert robot.warnings == []


@pytest.mark.parametrize("how", ["closes", "is silent", "sends garbage", "sends another time"])
def test_without_its_controller_the_arm_brakes_and_stays(robot, how):
    robot.move(0.1)
    far = robot.q + [1.0, 0, 0, 0, 0, 0]
    robot.target = robot.q
    for _ in range(round(0.2 / PERIOD)):
        robot.target = robot.target + np.clip(far - robot.target, 0, 0.005)
        robot.move(PERIOD)
    assert robot.node.world.arm.velocities[0] > 0.5
    if how == "closes":
        robot.link.close("gone")
    elif how == "sends garbage":
        robot.link._connection.send(b"GET / HTTP/1.1\r\n")
    elif how == "sends another time":
        robot.arm._time += 50.0
        robot.arm.follow(far, CYCLE)
    robot.run(0.3)
    place = robot.q
    robot.run(1.0)
    np.testing.assert_allclose(robot.q, place, atol=1e-4)
    assert place[0] < far[0] - 0.5
    assert not robot.is_connected
    (warning,) = robot.warnings
    assert warning.startswith("the arm's controller is disconnected: ")
    reasons = {
        "closes": "connection",
        "is silent": "no setpoint for 1.0 s",
        "sends garbage": "a frame begins with",
        "sends another time": "the controller's time is another one",
    }
    assert reasons[how] in warning

    robot.target = None
    robot._due = robot.time
    robot.move(0.2)
    assert robot.is_connected, "it may come again"
    np.testing.assert_allclose(robot.q, place, atol=1e-4)


def test_a_controller_that_is_behind_stays_connected(robot):
    """On real time and a busy machine, it may be so for a while."""
    robot.delay = 0.9
    robot.move(1.2)
    assert robot.warnings == []
    assert robot.is_connected and robot.arm.is_connected


def test_a_second_controller_is_refused(robot):
    robot.move(0.1)
    second = ArmLinkClient(robot.port)
    assert second.open()
    robot.move(0.1)
    assert second.wait(5.0) and second.receive() == [] and not second.is_open
    assert robot.warnings == ["a second controller of the arm is refused"]
    assert robot.is_connected


def test_the_node_ends_when_the_arm_has_come_to_rest(robot):
    robot.move(0.1)
    robot.target = robot.q
    for _ in range(round(0.2 / PERIOD)):
        robot.target = robot.target + [0.005, 0, 0, 0, 0, 0]
        robot.move(PERIOD)
    robot.node.begin_shutdown("the test says so")
    assert not robot.node.finished and not robot.is_connected
    robot.run(0.3)
    assert robot.node.finished
    assert abs(robot.node.world.arm.velocities[0]) < 1e-3
    assert not ArmLinkClient(robot.port).open(), "nobody moves it any more"


def test_steps_of_time_longer_than_a_cycle_of_the_controller_are_refused():
    with pytest.raises(ParameterError, match=r"state_rate.*at least 125 Hz"):
        Robot(publish_clock=True, use_sim_time=False, state_rate=100.0)


def test_a_robot_without_an_arm_has_nothing_to_move():
    with Robot(robot="ig42") as robot:
        assert "arm_controller_connected" not in dict(robot.node.status()[2])
        assert not robot.link.open()
