"""Stop and reset of all nodes of a robot, on nodes that do nothing else."""

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_srvs.srv import Trigger

from omniman_ros.client import link
from omniman_ros.client.robot import Robot
from omniman_ros.client.state import NodesRefusedError
from omniman_ros.nodes.stoppable_nodes import has_service
from test.nodes.harness import PERIOD, World


class StoppableNode(Node):
    """A node with the stop interface; `refuses` names the service that it refuses."""

    def __init__(self, world, name, namespace="", refuses="", silent=False):
        self.called = []
        super().__init__(name, namespace=namespace, context=world.context)
        self.create_publisher(DiagnosticStatus, "stop_state", 1)
        for action in ("stop", "reset"):
            self.create_service(Trigger, f"~/{action}", self._answer(action, refuses))
        world.closing.append(self)
        if not silent:
            world.executor.add_node(self)

    def _answer(self, action, refuses):
        def answer(request, response):
            self.called.append(action)
            response.success = action != refuses
            response.message = "still moving" if action == refuses else ""
            return response

        return answer


@pytest.fixture
def world(monkeypatch):
    monkeypatch.setattr(link, "ANNOUNCEMENT_TIME", 2.0)
    monkeypatch.setattr(link, "ANSWER_TIMEOUT", 1.0)
    with World() as world:
        world.closing = []
        yield world
        for node in world.closing:
            world.executor.remove_node(node)
            node.destroy_node()


def client_of(world, namespace=""):
    """Return a client that steps the world while it waits, once all nodes are discovered."""
    names = {node.get_fully_qualified_name() for node in world.closing}
    world._await(lambda: all(has_service(world.probe, f"{n}/stop") for n in names), "the nodes")
    return Robot(namespace, world.probe, serve=lambda seconds: world.run(max(seconds, PERIOD)))


@pytest.mark.parametrize("action", ["stop", "reset"])
def test_every_stoppable_node_is_called_once(world, action):
    names = ("platform_controller", "simulated_drive")
    nodes = [StoppableNode(world, name) for name in names]
    nodes.append(StoppableNode(world, "arm", "robot2"))
    heard = []
    with client_of(world) as robot:
        answers = getattr(robot, action)(report=heard.append)
    assert [node.called for node in nodes] == [[action]] * 3
    expected = ["/platform_controller", "/robot2/arm", "/simulated_drive"]
    assert [answer.node for answer in answers] == expected
    assert sorted(heard) == sorted(answers)


def test_a_node_that_refuses_is_reported_and_the_others_are_called(world):
    StoppableNode(world, "platform_controller", refuses="reset")
    drive = StoppableNode(world, "simulated_drive")
    with client_of(world) as robot, pytest.raises(NodesRefusedError) as raised:
        robot.reset()
    assert raised.value.answers[0] == ("/platform_controller", False, "still moving")
    assert drive.called == ["reset"]


def test_a_node_that_does_not_answer_is_reported(world):
    StoppableNode(world, "platform_controller", silent=True)
    with client_of(world) as robot, pytest.raises(NodesRefusedError, match="within 1 s"):
        robot.stop()


def test_nodes_that_are_discovered_one_after_the_other_are_all_called(world):
    nodes, late = [StoppableNode(world, "platform_controller")], ["simulated_drive", "arm"]
    elapsed = 0.0

    def serve(seconds):
        nonlocal elapsed
        world.run(max(seconds, PERIOD))
        elapsed += max(seconds, PERIOD)
        if late and elapsed > 1.5 * len(nodes):  # the second one after the time for the first
            nodes.append(StoppableNode(world, late.pop(0)))
            name = nodes[-1].get_fully_qualified_name()
            world._await(lambda: has_service(world.probe, f"{name}/stop"), "the node")

    with client_of(world), Robot("", world.probe, serve=serve) as robot:
        robot.stop()
    assert [node.called for node in nodes] == [["stop"]] * 3


@pytest.mark.parametrize("namespace", ["robot2", "/robot2/"])
def test_a_namespace_leaves_other_nodes_alone(world, namespace):
    other = StoppableNode(world, "platform_controller", "robot20")
    ours = StoppableNode(world, "platform_controller", "robot2")
    with client_of(world, namespace) as robot:
        robot.stop()
    assert (other.called, ours.called) == ([], ["stop"])


def test_nodes_without_a_stop_state_are_left_alone(world):
    StoppableNode(world, "platform_controller")
    stranger = Node("stranger", context=world.context)
    world.closing.append(stranger)
    world.executor.add_node(stranger)
    stranger.create_service(Trigger, "~/stop", lambda request, response: response)
    with client_of(world) as robot:
        assert [answer.node for answer in robot.stop()] == ["/platform_controller"]
