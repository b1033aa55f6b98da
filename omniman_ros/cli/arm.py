"""What moves the arm: a simulated controller on this machine, a real one, or nothing."""

import socket
from collections.abc import Iterable
from contextlib import ExitStack

from omniman_ros.cli.errors import CommandError

ARMS = {
    "simulated": "a simulated UR5 controller on this machine",
    "ur": "the controller of --controller",
    "none": "there is no arm",
}
"""What moves the arm."""

PORTS = {
    "dashboard": 29999,
    "primary": 30001,
    "secondary": 30002,
    "realtime": 30003,
    "rtde": 30004,
}
"""Ports of every UR controller, where clients look for it."""


PATIENCE = ("ur.read_timeout:=0.2", "ur.feedback_timeout:=0.5")
"""A simulated controller is a process that waits for its turn on a busy machine."""


def chosen_arm(arm: str | None, drive: str, sim_time: bool) -> str:
    """Return what moves the arm; where nothing was said, what fits the drive and the time.

    Raises:
        CommandError: An arm with simulated time: it has none.
    """
    if arm is None:
        return "none" if drive == "real" or sim_time else "simulated"
    if sim_time and arm != "none":
        raise CommandError(f"--sim-time: the arm '{arm}' runs on real time", 2)
    return arm


def private_controller() -> list[str]:
    """Parameters of a simulated controller and its client: the usual ports, or any free ones."""
    ports = (
        PORTS if _are_free(PORTS.values()) else dict(zip(PORTS, _free(len(PORTS)), strict=True))
    )
    arguments = [f"ports.{name}:={port}" for name, port in ports.items()]
    arguments += [
        f"ur.dashboard_port:={ports['dashboard']}", f"ur.script_port:={ports['secondary']}",
        f"ur.rtde_port:={ports['rtde']}", "ur.reverse_port:=0", "ur.host:=127.0.0.1",
        "ur.unlock:=true", *PATIENCE,
    ]  # fmt: skip
    return [word for argument in arguments for word in ("-p", argument)]


def _are_free(ports: Iterable[int]) -> bool:
    try:
        with ExitStack() as stack:
            for port in ports:
                stack.enter_context(_listener(port))
    except OSError:
        return False
    return True


def _free(count: int) -> list[int]:
    with ExitStack() as stack:
        listeners = [stack.enter_context(_listener(0)) for _ in range(count)]
        return [listener.getsockname()[1] for listener in listeners]


def _listener(port: int) -> socket.socket:
    listener = socket.socket()
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", port))
        listener.listen()
    except OSError:
        listener.close()
        raise
    return listener
