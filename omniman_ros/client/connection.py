"""Who owns the node of a client: the client with a thread of its own, or the user."""

import os
import threading
from collections.abc import Callable

from rclpy.node import Node

from omniman_ros.client.link import RobotLink
from omniman_ros.client.state import RobotError
from omniman_ros.console.session import Session

SPIN_TIME = 0.05  #: Time for which callbacks are served before the end is looked for again [s]


class OwnConnection:
    """A link on a node of its own, which a thread of its own spins.

    Args:
        domain: ROS domain; None for that of the environment.
    """

    def __init__(self, namespace: str, domain: int | None) -> None:
        prefix = _prefix(namespace)
        # Taking an events executor down can deadlock; see `nodes.rclpy_compat`.
        self._session = Session(f"client_{os.getpid()}", prefix, events=False, domain=domain)
        self._session.__enter__()
        self.link = RobotLink(self._session.node, prefix)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="omniman_client", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        try:
            while not self._ending.is_set():
                self._session.spin(SPIN_TIME)
        except BaseException as error:
            self.link.shared.fail(error)

    def close(self) -> None:
        """End what the link moves, and the thread."""
        is_inside = threading.current_thread() is self._thread  # which must not wait for itself
        try:
            if not is_inside:
                self.link.halt()
            self.link.flush()
        finally:
            self._ending.set()
            self.link.shared.fail(RobotError("it was closed"))
            if not is_inside:
                self._thread.join()
                self._session.__exit__(None, None, None)


class SharedConnection:
    """A link on a node of the user's; see `Robot`."""

    def __init__(
        self, node: Node, namespace: str, serve: Callable[[float], object] | None
    ) -> None:
        self.link = RobotLink(node, _prefix(namespace or node.get_namespace()), serve)

    def close(self) -> None:
        """End what the link moves, and take it off the node."""
        self.link.halt()
        self.link.flush()
        self.link.shared.fail(RobotError("it was closed"))
        self.link.shared.detach()


def _prefix(namespace: str) -> str:
    """Return an absolute namespace without a slash at its end."""
    bare = namespace.strip("/")
    return f"/{bare}" if bare else ""
