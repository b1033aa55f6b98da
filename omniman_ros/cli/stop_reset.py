"""`omniman stop`, `omniman reset`: call ~/stop or ~/reset of all nodes that move something."""

import argparse
import time
from collections.abc import Callable

from omniman_ros.cli.session import ANNOUNCED, DISCOVERY, Session
from omniman_ros.cli.terminal import say
from omniman_ros.nodes import movers

ANSWER = 5.0
"""How long a node may take to answer [s]."""


class Calls(movers.Calls):
    """Calls one service of each node that moves something, until no more turn up.

    Args:
        session: The ROS node.
        action: "stop" or "reset".
        namespace: Only nodes in it.
        on_answer: Called with the node's name, success and message as each answer comes.
    """

    def __init__(
        self, session: Session, action: str, namespace: str = "",
        on_answer: Callable[[str, bool, str], None] = lambda name, good, text: None,
    ) -> None:  # fmt: skip
        super().__init__(session.node, action, namespace, on_answer)
        self._session = session

    def run(self, patience: float) -> None:
        """Find and call until no more turn up.

        Args:
            patience: How long to wait for the first node [s].
        """
        found, found_at = 0, time.monotonic()

        def begun() -> bool:
            self.look()
            return bool(self.answers)

        def complete() -> bool:
            nonlocal found, found_at
            done = self.look()
            if len(self.answers) > found:
                found, found_at = len(self.answers), time.monotonic()
            return done and time.monotonic() - found_at > ANNOUNCED

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
