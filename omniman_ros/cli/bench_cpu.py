"""CPU time of other processes, from /proc."""

import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from omniman_ros.cli.errors import CommandError


def cpu_time(pid: int) -> float:
    """CPU time of a process and its threads since its start, user and system [s].

    Raises:
        CommandError: There is no /proc, or no such process.
    """
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
    except OSError as error:
        raise CommandError(f"CPU time of process {pid}: {error} (this needs Linux)") from error
    # The second field, the name in brackets, may itself hold blanks and brackets.
    fields = text.rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def cpu_shares(pids: Mapping[str, int], serve: Callable[[], None]) -> dict[str, float]:
    """Share of one core that processes take while `serve` runs.

    Args:
        pids: Names to process ids.
        serve: Runs for as long as is to be measured.
    """
    start = time.monotonic()
    before = {name: cpu_time(pid) for name, pid in pids.items()}
    serve()
    after = {name: cpu_time(pid) for name, pid in pids.items()}
    elapsed = time.monotonic() - start
    return {name: (after[name] - before[name]) / elapsed for name in pids}
