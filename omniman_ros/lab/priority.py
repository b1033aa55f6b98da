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
