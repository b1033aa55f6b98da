"""`omniman stop`, `omniman reset`: call ~/stop or ~/reset of all nodes that move something."""

import argparse
import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger

from omniman_ros.cli.session import ANNOUNCED, DISCOVERY, Session
from omniman_ros.cli.terminal import say

ANSWER = 5.0
"""How long a node may take to answer [s]."""

TRIGGER = "std_srvs/srv/Trigger"
STOP_STATE = "stop_state"
STATE_TYPE = "diagnostic_msgs/msg/DiagnosticStatus"


def nodes_that_move(node: Node, namespace: str = "") -> list[str]:
    """Full names of nodes that publish stop_state, in the graph as it is known now.

    Args:
        node: Whose view of the graph.
        namespace: Only in and below this one.
    """
    inside = f"/{namespace.strip('/')}/" if namespace.strip("/") else "/"
    topics = [
        topic
        for topic, types in node.get_topic_names_and_types()
        if topic.endswith(f"/{STOP_STATE}") and STATE_TYPE in types
    ]
    names = {
        f"{info.node_namespace.rstrip('/')}/{info.node_name}"
        for topic in topics
        for info in node.get_publishers_info_by_topic(topic)
    }
    return sorted(name for name in names if name.startswith(inside))


def has_service(node: Node, service: str) -> bool:
    """Whether a Trigger service is in the graph."""
    return (service, [TRIGGER]) in node.get_service_names_and_types()


class Calls:
    """Calls one service of each node that moves something, as they are found.

    Args:
        session: The ROS node.
        action: "stop" or "reset".
        namespace: Only nodes in it.

        on_answer: Called with the node's name, success and message as each answer comes.

    Attributes:
        answers: Full node name to success and message, or None while there is no answer.
    """

    def __init__(
        self, session: Session, action: str, namespace: str = "",
        on_answer: Callable[[str, bool, str], None] = lambda name, good, text: None,
    ) -> None:  # fmt: skip
        self._session = session
        self._action = action
        self._namespace = namespace
        self._on_answer = on_answer
        self._futures: dict[str, Any] = {}
        self.answers: dict[str, tuple[bool, str] | None] = {}
        self.found_at = time.monotonic()

    def look(self) -> bool:
        """Call the nodes that are new in the graph; True if all that are known have answered."""
        node = self._session.node
        for name in nodes_that_move(node, self._namespace):
            service = f"{name}/{self._action}"
            if name in self.answers or not has_service(node, service):
                continue
            client = node.create_client(Trigger, service)
            if not client.service_is_ready():
                node.destroy_client(client)
                continue
            self._futures[name] = client.call_async(Trigger.Request())
            self.answers[name] = None
            self.found_at = time.monotonic()
        for name, future in self._futures.items():
            if future.done() and self.answers[name] is None:
                answer = future.result()
                self.answers[name] = (answer.success, answer.message)
                self._on_answer(name, answer.success, answer.message)
        return all(answer is not None for answer in self.answers.values())

    def run(self, patience: float) -> None:
        """Find and call until no more turn up.

        Args:
            patience: How long to wait for the first node [s].
        """

        def begun() -> bool:
            self.look()
            return bool(self.answers)

        def complete() -> bool:
            done = self.look()
            return done and time.monotonic() - self.found_at > ANNOUNCED

        self._session.wait(begun, patience)
        self._session.wait(complete, ANNOUNCED + ANSWER)


def call_all(
    session: Session, action: str, namespace: str = "", out: Callable[[str], None] = say
) -> int:
    """Call all, print each answer; returns 0 if there were some and all agreed."""

    def tell(name: str, success: bool, message: str) -> None:
        verdict = "done" if success else "REFUSED"
        out(f"{name}: {action} {verdict}" + (f" ({message})" if message else ""))

    calls = Calls(session, action, namespace, tell)
    calls.run(DISCOVERY)
    if not calls.answers:
        out(f"no node that moves something was found within {DISCOVERY:g} s; is ROS_DOMAIN_ID "
            "the robot's?")  # fmt: skip
        return 1
    for name, answer in calls.answers.items():
        if answer is None:
            out(f"{name}: no answer within {ANSWER:g} s")
    return 0 if all(answer is not None and answer[0] for answer in calls.answers.values()) else 1


def run(args: argparse.Namespace) -> int:
    """Run `omniman stop` or `omniman reset`; returns the exit code."""
    with Session(f"omniman_{args.command}") as session:
        return call_all(session, args.command, args.namespace)
