"""`omniman stop` and `omniman reset`: call `~/stop` or `~/reset` of all stoppable nodes."""

import argparse
import time
from collections.abc import Callable

from omniman_ros.console.session import ANNOUNCEMENT_TIME, DISCOVERY_TIMEOUT, Session
from omniman_ros.console.terminal import say
from omniman_ros.nodes.stoppable_nodes import TriggerCalls

ANSWER_TIMEOUT = 5.0  #: Time within which a node must answer [s]


def call_all(
    session: Session, action: str, namespace: str = "", out: Callable[[str], None] = say
) -> int:
    """Call a service of all nodes that can be stopped, and write a line about each answer.

    The action is "stop" or "reset"; an empty namespace means all nodes. The exit code is 0 if
    there were such nodes and the call succeeded on each of them, else 1.
    """

    def report(name: str, success: bool, message: str) -> None:
        verdict = "done" if success else "REFUSED"
        out(f"{name}: {action} {verdict}" + (f" ({message})" if message else ""))

    calls = TriggerCalls(session.node, action, namespace, report)
    _call_found(session, calls)
    if not calls.answers:
        out(
            f"no node that can be stopped was found within {DISCOVERY_TIMEOUT:g} s; check that "
            "ROS_DOMAIN_ID is the robot's"
        )
        return 1
    for name, answer in calls.answers.items():
        if answer is None:
            out(f"{name}: no answer within {ANSWER_TIMEOUT:g} s")
    return 0 if all(answer is not None and answer[0] for answer in calls.answers.values()) else 1


def _call_found(session: Session, calls: TriggerCalls) -> None:
    found, found_at = 0, time.monotonic()

    def has_begun() -> bool:
        calls.poll()
        return bool(calls.answers)

    def is_complete() -> bool:
        nonlocal found, found_at
        answered = calls.poll()
        if len(calls.answers) > found:
            found, found_at = len(calls.answers), time.monotonic()
        return answered and time.monotonic() - found_at > ANNOUNCEMENT_TIME

    session.wait(has_begun, DISCOVERY_TIMEOUT)
    session.wait(is_complete, ANNOUNCEMENT_TIME + ANSWER_TIMEOUT)


def run(args: argparse.Namespace) -> int:
    """Run `omniman stop` or `omniman reset`; the exit code is that of :func:`call_all`."""
    with Session(f"omniman_{args.command}") as session:
        return call_all(session, args.command, args.namespace)
