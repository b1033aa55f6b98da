"""Motions that a command sends to the robot and follows, and cancels on Ctrl-C."""

import sys
from collections.abc import Callable
from typing import Protocol, TypeVar

from omniman_ros.console.errors import CommandError
from omniman_ros.console.progress import Progress
from omniman_ros.console.session import Session
from omniman_ros.console.terminal import say
from omniman_ros.processes.process_group import redirect_signals

#: What the robot does once a node has confirmed a cancellation
CANCELLED = "The motion is cancelled: the robot brakes and stands."
NOT_SENT = "Nothing was sent to the robot."  #: What is said when there was nothing to cancel
UNCONFIRMED = (
    "The node did not confirm that the motion is cancelled: the robot may go on. "
    "`omniman stop` stops it."
)  #: What is said when a node does not answer a request to cancel


class CancellableMotion(Protocol):
    """Sends a motion to a node of the robot."""

    def cancel(self) -> str:
        """Cancel the motion, wait until the node confirms it, and return what the robot does."""
        ...


DriverT = TypeVar("DriverT", bound=CancellableMotion)
#: Creates a driver from the ROS session, the progress display and a function to poll.
#:
#: The driver must call that function many times a second; it raises to end the motion early.
DriverFactory = Callable[[Session, Progress, Callable[[], None]], DriverT]


def run_motion(
    name: str, namespace: str, make: DriverFactory[DriverT], move: Callable[[DriverT], None]
) -> int:
    """Run a motion of the robot; cancel it when a signal is received.

    It raises CommandError if the motion failed, and KeyboardInterrupt once it was cancelled.
    """
    progress = Progress()
    # Signals are recorded rather than raised: a KeyboardInterrupt is lost if it is raised within a
    # callback of the executor.
    signals: list[int] = []

    def poll() -> None:
        if signals:
            raise KeyboardInterrupt

    with redirect_signals(signals.append), Session(name, namespace) as session:
        driver = make(session, progress, poll)
        try:
            move(driver)
        except KeyboardInterrupt:
            outcome = driver.cancel()
            progress.abandon()
            say(outcome, sys.stderr)
            raise
        except CommandError:
            progress.abandon()
            raise
    return 0
