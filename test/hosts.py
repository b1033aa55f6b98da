"""Two hosts on this machine, joined by a cable: namespaces of network and shared memory."""

import contextlib
import json
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Self

from test.running import PATIENCE

ROBOT_ADDRESS, DESK_ADDRESS = "10.77.0.1", "10.77.0.2"
"""Addresses of the two hosts."""
CABLE = "lan"  #: Name of the network interface of each host
REST = 0.005  #: Speed below which the robot counts as standing [m/s]
_ROUTE = f"route add 224.0.0.0/4 dev {CABLE}"
_ALONE = ("unshare", "--net", "--mount", "--propagation", "private")
_AS_ROOT = ("--user", "--map-root-user")
#: Script that keeps a host: shared memory of another host must not be found
_KEEP = "mount -t tmpfs none /dev/shm && ip link set lo up && echo ready && exec sleep 86400"


def _is_root() -> bool:
    return os.geteuid() == 0


def missing_permission() -> str:
    """Return why there can be no two hosts on this machine, or an empty string."""
    try:
        with two_hosts():
            return ""
    except (OSError, subprocess.SubprocessError, AssertionError) as error:
        return f"network namespaces are not permitted: {error}"


class Host:
    """A host, kept by a process that sleeps.

    Args:
        first: Host that this one is to be joined to; None for the first one.

    Attributes:
        pid: Process that keeps the namespaces.
    """

    def __init__(self, first: "Host | None" = None) -> None:
        if first is not None:
            command = [*first.inside, *_ALONE]
        else:
            command = [*_ALONE, *(() if _is_root() else _AS_ROOT)]
        self._keeper = subprocess.Popen(
            [*command, "sh", "-c", _KEEP], stdout=subprocess.PIPE, text=True
        )
        self.pid = self._keeper.pid
        assert self._keeper.stdout is not None
        assert self._keeper.stdout.readline() == "ready\n", "unshare or mount failed"

    @property
    def inside(self) -> tuple[str, ...]:
        """Beginning of the command line of a process on this host."""
        user = () if _is_root() else ("--user", "--preserve-credentials")
        return ("nsenter", "--target", str(self.pid), "--net", "--mount", *user, "--")

    def ip(self, *arguments: str) -> None:
        """Run `ip` with these arguments."""
        subprocess.run([*self.inside, "ip", *arguments], check=True, timeout=PATIENCE)

    def close(self) -> None:
        """End the host; what runs on it ends by itself."""
        self._keeper.kill()
        self._keeper.wait()


class Cable:
    """The cable between two hosts; it is pulled at the second one.

    Args:
        robot: Host at which nothing changes when the cable is pulled, but that nobody answers.
    """

    def __init__(self, robot: Host, desk: Host, multicast: bool) -> None:
        self._multicast = multicast
        peer = ("peer", "name", CABLE, "netns", str(desk.pid))
        robot.ip("link", "add", CABLE, "type", "veth", *peer)
        for host, address in ((robot, ROBOT_ADDRESS), (desk, DESK_ADDRESS)):
            host.ip("address", "add", f"{address}/24", "dev", CABLE)
            host.ip("link", "set", CABLE, "up")
            if multicast:
                host.ip(*_ROUTE.split())
        # A process that waits for commands: starting one would take too long.
        self._ip = subprocess.Popen(
            [*desk.inside, "ip", "-batch", "-"], stdin=subprocess.PIPE, text=True, bufsize=1
        )

    def pull(self) -> float:
        """Pull the cable; return the time of the steady clock before that [s]."""
        before = time.monotonic()
        self._do(f"link set {CABLE} down")
        return before

    def plug(self) -> None:
        """Plug the cable in again."""
        self._do(f"link set {CABLE} up")
        if self._multicast:
            self._do(_ROUTE)  # the kernel forgets routes of an interface that is down

    def _do(self, command: str) -> None:
        assert self._ip.stdin is not None
        self._ip.stdin.write(command + "\n")
        self._ip.stdin.flush()

    def close(self) -> None:
        """End the process that pulls and plugs."""
        self._ip.kill()
        self._ip.wait()


@contextlib.contextmanager
def two_hosts(multicast: bool = True) -> Iterator[tuple[Host, Host, Cable]]:
    """Yield a robot's host, a desk's host, and the cable between them."""
    with contextlib.ExitStack() as stack:
        robot = Host()
        stack.callback(robot.close)
        desk = Host(robot)
        stack.callback(desk.close)
        cable = Cable(robot, desk, multicast)
        stack.callback(cable.close)
        yield robot, desk, cable


class Observer:
    """A process on a host that publishes what it is told, and reports what it receives.

    It runs `host_observer.py`; what it reports is kept here.

    Attributes:
        truth: Time of arrival on the steady clock [s], speed [m/s] and x [m] of each true state.
        states: Last stop state of each node, by its name.
        source: Source that drives, as reported last; empty before the first report.
    """

    def __init__(self, host: Host, env: Mapping[str, str]) -> None:
        self.truth: list[tuple[float, float, float]] = []
        self.states: dict[str, str] = {}
        self.source = ""
        self._process = subprocess.Popen(
            [*host.inside, sys.executable, str(Path(__file__).with_name("host_observer.py"))],
            env=dict(env),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        threading.Thread(target=self._read, daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            kind, *values = json.loads(line)
            if kind == "truth":
                self.truth.append(tuple(values))
            elif kind == "state":
                self.states[values[0]] = values[1]
            else:
                self.source = values[0]

    def tell(self, *words: object) -> None:
        """Have it publish something; `host_observer.py` has the words."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(words) + "\n")

    @property
    def speed(self) -> float:
        """True speed of the robot that was reported last [m/s]; NaN before the first report."""
        return self.truth[-1][1] if self.truth else math.nan

    @property
    def position(self) -> float:
        """True x of the robot that was reported last [m]."""
        return self.truth[-1][2]

    def time_of_rest(self, after: float) -> float:
        """Return the time since `after` from which the robot has been at rest [s]."""
        moving = [time for time, speed, _ in self.truth if speed > REST and time > after]
        return max(moving, default=after) - after

    def longest_gap(self, after: float) -> float:
        """Return the longest time without a report from `after` on [s]."""
        times = [time for time, _, _ in self.truth if time > after]
        return max((b - a for a, b in pairwise(times)), default=math.inf)
