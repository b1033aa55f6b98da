"""The baseline of `omniman bench arm`: a bare loop with a period of 8 ms.

Usage: `arm_bare SECONDS PRIORITY`. It does nothing but sleep until absolute deadlines and send as
many bytes as a setpoint has to a process that discards them. At the end it prints its scheduling
class and the intervals between its sends.
"""

import contextlib
import gc
import itertools
import json
import os
import socket
import time

from omniman_ros.console.terminal import say
from omniman_ros.lab.priority import scheduling
from omniman_ros.ur.parameters import PERIOD

SIZE = 32  #: size of a setpoint: a time-out, six joints and a mode, four bytes each [byte]


def main(args: list[str] | None = None) -> int:
    """Run the loop for SECONDS at a SCHED_FIFO priority, or in the normal class if that is 0."""
    seconds, priority = (args or [])[1:]
    out, sink = socket.socketpair()
    if os.fork() == 0:
        out.close()
        while sink.recv(4096):
            pass
        os._exit(0)
    sink.close()
    gc.disable()
    if int(priority):
        with contextlib.suppress(OSError):  # the benchmark compares the scheduling classes
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(int(priority)))
    sent, due = list[float](), time.monotonic()
    for _ in range(round(float(seconds) / PERIOD) + 1):
        due += PERIOD
        time.sleep(max(due - time.monotonic(), 0.0))
        out.sendall(bytes(SIZE))
        sent.append(time.monotonic())
    intervals = [after - before for before, after in itertools.pairwise(sent)]
    say(json.dumps({"scheduling": scheduling(os.getpid()), "intervals": intervals}))
    return 0
