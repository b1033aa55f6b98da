"""Priority of processes over whatever else keeps the cores busy."""

import contextlib
import os
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


def scheduling(pid: int) -> str:
    """Return the scheduling class and priority of a process's main thread, as text."""
    policy, priority = os.sched_getscheduler(pid), os.sched_getparam(pid).sched_priority
    name = {os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO"}.get(policy, str(policy))
    return f"{name} {priority}" if priority else name
