"""The baseline of `omniman bench arm`: a bare loop with a period of 8 ms, and its sink.

Usage: `arm_bare sink PORT`, or `arm_bare loop PORT CONTROL PRIORITY`. The sink receives what the
loop sends. The loop connects to the benchmark at the port CONTROL, receives the duration of each
block from it, and replies with the intervals between its sends. It does nothing but sleep until
absolute deadlines and send as many bytes as a setpoint has.
"""

import gc
import itertools
import json
import os
import socket
import time

from omniman_ros.console.terminal import say
from omniman_ros.ur.parameters import PERIOD

SIZE = 32  # size of a setpoint: a time-out, six joints and a mode, four bytes each [byte]
CONNECT_TIMEOUT = 20.0  # longest time until a server listens on the port to connect to [s]


def main(args: list[str] | None = None) -> int:
    """Run the sink or the loop until SIGINT, or until the other end closes the connection."""
    _, kind, *numbers = args or []
    try:
        if kind == "sink":
            sink(int(numbers[0]))
        else:
            loop(*map(int, numbers))
    except KeyboardInterrupt:
        return 0
    return 0


def sink(port: int) -> None:
    """Accept one connection on a port, and discard the data until the sender closes it."""
    with socket.create_server(("127.0.0.1", port)) as listener, listener.accept()[0] as peer:
        while peer.recv(4096):
            pass


def loop(port: int, control: int, priority: int) -> None:
    """Run a block for each line with a duration [s] that the benchmark sends."""
    gc.disable()
    if priority:
        request_priority(priority)
    with connected(port) as out, connected(control) as bench, bench.makefile("rw") as lines:
        for line in lines:
            lines.write(json.dumps(block(out, float(line))) + "\n")
            lines.flush()


def request_priority(priority: int) -> None:
    """Request a SCHED_FIFO priority if permitted; the benchmark checks the scheduling class."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        say(f"no real-time priority: {error.strerror}")


def connected(port: int) -> socket.socket:
    """Connect to a port of this machine as soon as a server listens on it."""
    end = time.monotonic() + CONNECT_TIMEOUT
    while True:
        try:
            out = socket.create_connection(("127.0.0.1", port))
            out.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return out
        except ConnectionRefusedError:
            if time.monotonic() > end:
                raise
            time.sleep(0.05)


def block(out: socket.socket, seconds: float) -> list[float]:
    """Send at absolute deadlines, one per period.

    Returns:
        Intervals between the sends [s].
    """
    message, sent = bytes(SIZE), []
    due = time.monotonic()
    for _ in range(round(seconds / PERIOD) + 1):
        due += PERIOD
        time.sleep(max(due - time.monotonic(), 0.0))
        out.sendall(message)
        sent.append(time.monotonic())
    return [after - before for before, after in itertools.pairwise(sent)]
