import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_srvs.srv import Trigger

from omniman_ros.cli import stop_reset
from omniman_ros.cli.stop_reset import call_all
from omniman_ros.console.session import Session
from omniman_ros.nodes.stoppable_nodes import find_stoppable_nodes

pytestmark = pytest.mark.processes


class StoppableNode:
    """A node with the stop interface; `refuses` names the service that it refuses."""

    def __init__(self, session, name, namespace="", refuses="", silent=False):
        self.called = []
        self.node = Node(name, namespace=namespace, context=session.context)
        self.node.create_publisher(DiagnosticStatus, "stop_state", 1)
        for action in ("stop", "reset"):
            self.node.create_service(Trigger, f"~/{action}", self._answer(action, refuses))
        if not silent:
            session._executor.add_node(self.node)

    def _answer(self, action, refuses):
        def answer(request, response):
            self.called.append(action)
            response.success = action != refuses
            response.message = "still moving" if action == refuses else ""
            return response

        return answer


@pytest.fixture
def nodes_in_session(own_domain, monkeypatch):
    """Return a session, and a function that adds stoppable nodes to it."""
    monkeypatch.setattr(stop_reset, "ANNOUNCEMENT_TIME", 0.2)
    monkeypatch.setattr(stop_reset, "ANSWER_TIMEOUT", 1.0)
    with Session("omniman_test", events=False) as session:
        made = []

        def add(*arguments, **options):
            made.append(StoppableNode(session, *arguments, **options))
            return made[-1]

        yield session, add
        for node in made:
            node.node.destroy_node()


@pytest.mark.parametrize("action", ["stop", "reset"])
def test_every_stoppable_node_is_called_once(nodes_in_session, action):
    session, add = nodes_in_session
    nodes = [add("platform_controller"), add("simulated_drive"), add("arm", "robot2")]
    lines = []
    assert call_all(session, action, out=lines.append) == 0
    assert [node.called for node in nodes] == [[action]] * 3
    assert sorted(lines) == [
        f"/platform_controller: {action} done",
        f"/robot2/arm: {action} done",
        f"/simulated_drive: {action} done",
    ]


def test_a_node_that_refuses_is_reported_and_fails_the_command(nodes_in_session):
    session, add = nodes_in_session
    add("platform_controller", refuses="reset")
    drive = add("simulated_drive")
    lines = []
    assert call_all(session, "reset", out=lines.append) == 1
    assert "/platform_controller: reset REFUSED (still moving)" in lines
    assert drive.called == ["reset"], "the others are called nevertheless"


def test_a_node_that_does_not_answer_is_reported_and_fails_the_command(nodes_in_session):
    session, add = nodes_in_session
    add("platform_controller", silent=True)
    lines = []
    assert call_all(session, "stop", out=lines.append) == 1
    assert lines == ["/platform_controller: no answer within 1 s"]


def test_the_command_fails_and_names_the_domain_if_no_node_is_found(nodes_in_session, monkeypatch):
    session, _ = nodes_in_session
    monkeypatch.setattr(stop_reset, "DISCOVERY_TIMEOUT", 0.1)
    lines = []
    assert call_all(session, "stop", out=lines.append) == 1
    assert "ROS_DOMAIN_ID" in lines[0]


@pytest.mark.parametrize("namespace", ["robot2", "/robot2", "/robot2/"])
def test_a_namespace_leaves_other_nodes_alone(nodes_in_session, namespace):
    session, add = nodes_in_session
    other, ours = add("platform_controller", "robot20"), add("platform_controller", "robot2")
    assert call_all(session, "stop", namespace, out=lambda line: None) == 0
    assert (other.called, ours.called) == ([], ["stop"])


def test_nodes_without_a_stop_state_are_left_alone(nodes_in_session):
    session, add = nodes_in_session
    add("platform_controller")
    stranger = Node("stranger", context=session.context)
    stranger.create_service(Trigger, "~/stop", lambda request, response: response)
    assert session.wait(lambda: bool(find_stoppable_nodes(session.node)), 10.0)
    assert find_stoppable_nodes(session.node) == ["/platform_controller"]
    stranger.destroy_node()
