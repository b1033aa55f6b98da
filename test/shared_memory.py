"""Removal of the shared memory that killed participants of Fast DDS have left behind.

A segment or a port of Fast DDS 2.14 is a file `fastrtps_NAME`, a lock `fastrtps_NAME_el` or `_sl`
that its participants hold as long as they live (flock(2)), and for a port
`sem.fastrtps_NAME_mutex`. None of them vanishes with a process that is killed: hundreds gather,
and later participants open such ports again, the mutex as the killed process has left it.
"""

import fcntl
import time
from contextlib import ExitStack
from pathlib import Path

FOLDER = Path("/dev/shm")  #: Where Linux keeps shared memory
#: Age of a lock from which it counts as left behind if nobody holds it [s]: a participant that
#: starts makes the file first, and locks it then.
MIN_AGE = 60.0
SUFFIXES = ("_el", "_sl")  #: Ends of the names of the locks: exclusive and shared


def remove_abandoned(folder: Path = FOLDER, min_age: float = MIN_AGE) -> int:
    """Remove segments and ports that no living process holds; return their number.

    Args:
        folder: Where they are; nothing is done where it does not exist.
        min_age: Smallest age of all locks of what is removed [s].
    """
    locks = [path for end in SUFFIXES for path in folder.glob(f"fastrtps_*{end}")]
    names = {path.name[: -len(SUFFIXES[0])] for path in locks}
    return sum(_remove(folder, name, min_age) for name in names)


def _remove(folder: Path, name: str, min_age: float) -> bool:
    """Remove a segment or a port unless somebody holds it; return whether it was removed."""
    locks = [path for end in SUFFIXES if (path := folder / f"{name}{end}").exists()]
    try:
        with ExitStack() as stack:
            for path in locks:
                if time.time() - path.stat().st_mtime < min_age:
                    return False
                file = stack.enter_context(path.open("r+"))
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for path in (folder / name, folder / f"sem.{name}_mutex", *locks):
                path.unlink(missing_ok=True)
    except OSError:  # it is held, it is somebody else's, or another worker has removed it
        return False
    return True
