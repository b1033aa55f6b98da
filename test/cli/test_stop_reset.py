import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_srvs.srv import Trigger

from omniman_ros.cli import stop_reset
from omniman_ros.cli.session import Session
from omniman_ros.cli.stop_reset import Calls, call_all
from omniman_ros.nodes.movers import nodes_that_move

pytestmark = pytest.mark.processes


class Mover:
    """A node with the stop interface; `refuses` names the service that it refuses."""

    def __init__(self, session, name, namespace="", refuses="", deaf=False):
        self.called = []
        self.node = Node(name, namespace=namespace, context=session.context)
        self.node.create_publisher(DiagnosticStatus, "stop_state", 1)
        for action in ("stop", "reset"):
            self.node.create_service(Trigger, f"~/{action}", self._answer(action, refuses))
        if not deaf:
            session._executor.add_node(self.node)

    def _answer(self, action, refuses):
        def answer(request, response):
            self.called.append(action)
            response.success = action != refuses
            response.message = "still moving" if action == refuses else ""
            return response

        return answer


@pytest.fixture
def movers(own_domain, monkeypatch):
    """A session, and a function that adds nodes to it."""
    monkeypatch.setattr(stop_reset, "ANNOUNCED", 0.2)
    monkeypatch.setattr(stop_reset, "ANSWER", 1.0)
    with Session("omniman_test", events=False) as session:
        made = []

        def add(*arguments, **options):
            made.append(Mover(session, *arguments, **options))
            return made[-1]

        yield session, add
        for mover in made:
            mover.node.destroy_node()


@pytest.mark.parametrize("action", ["stop", "reset"])
def test_every_node_that_moves_something_is_called_once(movers, action):
    session, add = movers
    nodes = [add("platform_controller"), add("simulated_drive"), add("arm", "robot2")]
    lines = []
    assert call_all(session, action, out=lines.append) == 0
    assert [node.called for node in nodes] == [[action]] * 3
    assert sorted(lines) == [
        f"/platform_controller: {action} done",
        f"/robot2/arm: {action} done",
        f"/simulated_drive: {action} done",
    ]


def test_one_that_refuses_is_told_and_fails_it_all(movers):
    session, add = movers
    add("platform_controller", refuses="reset")
    drive = add("simulated_drive")
    lines = []
    assert call_all(session, "reset", out=lines.append) == 1
    assert "/platform_controller: reset REFUSED (still moving)" in lines
    assert drive.called == ["reset"], "the others are called nevertheless"


def test_one_that_does_not_answer_fails_it_all(movers):
    session, add = movers
    add("platform_controller", deaf=True)
    lines = []
    assert call_all(session, "stop", out=lines.append) == 1
    assert lines == ["/platform_controller: no answer within 1 s"]


def test_none_at_all_is_a_failure_that_says_where_it_looked(movers, monkeypatch):
    session, _ = movers
    calls = Calls(session, "stop")
    calls.run(patience=0.2)
    assert calls.answers == {}
    monkeypatch.setattr(stop_reset, "DISCOVERY", 0.1)
    lines = []
    assert call_all(session, "stop", out=lines.append) == 1
    assert "ROS_DOMAIN_ID" in lines[0]


@pytest.mark.parametrize("namespace", ["robot2", "/robot2", "/robot2/"])
def test_a_namespace_leaves_the_others_alone(movers, namespace):
    session, add = movers
    other, ours = add("platform_controller", "robot20"), add("platform_controller", "robot2")
    assert call_all(session, "stop", namespace, out=lambda line: None) == 0
    assert (other.called, ours.called) == ([], ["stop"])


def test_nodes_without_a_stop_state_are_left_alone(movers):
    session, add = movers
    add("platform_controller")
    stranger = Node("stranger", context=session.context)
    stranger.create_service(Trigger, "~/stop", lambda request, response: response)
    assert session.wait(lambda: bool(nodes_that_move(session.node)), 10.0)
    assert nodes_that_move(session.node) == ["/platform_controller"]
    stranger.destroy_node()
