"""Commands that send the robot somewhere and follow it: Ctrl-C calls it back."""

from collections.abc import Callable
from typing import Protocol, TypeVar

from omniman_ros.cli.children import signals_to
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.progress import Progress
from omniman_ros.cli.session import Session


class Driver(Protocol):
    """What can be called back."""

    def cancel(self) -> None:
        """End the motion, and wait until the node says so."""
        ...


D = TypeVar("D", bound=Driver)
Maker = Callable[[Session, Progress, Callable[[], None]], D]


def drive(name: str, namespace: str | None, make: Maker[D], go: Callable[[D], None]) -> int:
    """Make a driver and let it go; returns the exit code.

    Args:
        name: Of the ROS node.
        namespace: Of the robot.
        make: Makes the driver; what it is given third is to be called many times a second, and
            raises to end it early.
        go: Drives.

    Raises:
        CommandError: The robot does not get there.
        KeyboardInterrupt: It was called back.
    """
    progress = Progress()
    # Noted, not raised: a KeyboardInterrupt that comes up in a callback of the executor gets lost.
    signals: list[int] = []

    def poll() -> None:
        if signals:
            raise KeyboardInterrupt

    with signals_to(signals.append), Session(name, namespace) as session:
        driver = make(session, progress, poll)
        try:
            go(driver)
        except KeyboardInterrupt:
            driver.cancel()
            progress.abandon()
            raise
        except CommandError:
            progress.abandon()
            raise
    return 0
