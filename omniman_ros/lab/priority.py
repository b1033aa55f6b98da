"""Priority of processes over whatever else keeps the cores busy."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path


def set_niceness(pid: int, niceness: int, proc: Path = Path("/proc")) -> bool:
    """Set the niceness of all threads of a process, and of its session if it leads one.

    Where the kernel groups processes by session (`kernel.sched_autogroup_enabled`, sched(7)), the
    niceness of a thread counts within its session only. Each node of a robot leads one.
    """
    try:
        for thread in os.listdir(f"/proc/{pid}/task"):
            os.setpriority(os.PRIO_PROCESS, int(thread), niceness)
        if os.getsid(pid) == pid:
            with contextlib.suppress(FileNotFoundError):  # a kernel without groups
                (proc / str(pid) / "autogroup").write_text(str(niceness), encoding="ascii")
    except OSError:
        return False
    return True


@contextlib.contextmanager
def own_niceness(niceness: int, proc: Path = Path("/proc")) -> Iterator[None]:
    """Give this process and its session a niceness, where the system permits it, and restore it.

    A process that drives nodes which are preferred needs their niceness: one that gets less of the
    cores falls behind with what it receives, and hears of answers and reports many seconds late.
    """
    pid, account = os.getpid(), proc / "self" / "autogroup"
    before, before_of_group = os.getpriority(os.PRIO_PROCESS, pid), _group_niceness(account)
    is_set = set_niceness(pid, niceness, proc)
    if is_set and before_of_group is not None:
        _set_group_niceness(account, niceness)
    try:
        yield
    finally:
        if is_set:
            set_niceness(pid, before, proc)
        if is_set and before_of_group is not None:
            _set_group_niceness(account, before_of_group)


def _group_niceness(account: Path) -> int | None:
    """Return the niceness of a process's session; None where the kernel groups none."""
    try:
        words = account.read_text(encoding="ascii").split()
    except OSError:
        return None
    return int(words[-1]) if words else None


def _set_group_niceness(account: Path, niceness: int) -> None:
    with contextlib.suppress(OSError):  # refused, or written twice within 100 ms
        account.write_text(str(niceness), encoding="ascii")


def scheduling(pid: int) -> str:
    """Return the scheduling class and priority of a process's main thread, as text."""
    policy, priority = os.sched_getscheduler(pid), os.sched_getparam(pid).sched_priority
    name = {os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO"}.get(policy, str(policy))
    return f"{name} {priority}" if priority else name
