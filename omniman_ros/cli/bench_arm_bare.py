"""What `omniman bench arm` compares with: a bare loop of 8 ms, and the sink that it sends to.

Usage: bench_arm_bare sink PORT, or bench_arm_bare loop PORT CONTROL PRIORITY. The loop asks the
bench at the port CONTROL for the length of each block, and answers by the intervals in it. It does
nothing but sleep to absolute deadlines and send as many bytes as a setpoint has.
"""

import gc
import json
import os
import socket
import time

from omniman_ros.arm.parameters import PERIOD

SIZE = 32
"""Of a message [byte]: a timeout, six joints and a mode."""
PATIENCE = 20.0
"""How long the other end may take to listen [s]."""


def main(args: list[str] | None = None) -> int:
    """Serve until SIGINT or the other end is gone."""
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
    """Take what comes from one sender, and do nothing with it."""
    with socket.create_server(("127.0.0.1", port)) as listener, listener.accept()[0] as peer:
        while peer.recv(4096):
            pass


def loop(port: int, control: int, priority: int) -> None:
    """Run a block for each line with its length [s]."""
    gc.disable()
    if priority:
        be_first(priority)
    with connected(port) as out, connected(control) as orders, orders.makefile("rw") as lines:
        for line in lines:
            lines.write(json.dumps(block(out, float(line))) + "\n")
            lines.flush()


def be_first(priority: int) -> None:
    """Ask for SCHED_FIFO, as the streaming process does; the bench looks whether it was given."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        print(f"no real-time priority: {error.strerror}", flush=True)


def connected(port: int) -> socket.socket:
    """Connect to a port of this machine, as soon as somebody listens.

    Raises:
        OSError: Nobody does.
    """
    end = time.monotonic() + PATIENCE
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
    """Send on absolute deadlines for a time; the intervals between the sends [s]."""
    message, sent = bytes(SIZE), []
    due = time.monotonic()
    for _ in range(round(seconds / PERIOD) + 1):
        due += PERIOD
        time.sleep(max(due - time.monotonic(), 0.0))
        out.sendall(message)
        sent.append(time.monotonic())
    return [after - before for before, after in zip(sent, sent[1:], strict=False)]
