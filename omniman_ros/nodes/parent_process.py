"""End a node's process with the process that started it."""

import ctypes
import os
import signal
import sys

#: Environment variable with the id of the process that supervises this one, if there is one
PARENT_VARIABLE = "OMNIMAN_PARENT"
#: Option of prctl(2) that sets the signal a process gets when its parent dies
PR_SET_PDEATHSIG = 1


def follow_parent(parent: int) -> None:
    """Have the kernel send SIGINT to this process when its parent dies; exit if it has died.

    To the kernel, the parent is the thread that started this process, here the main thread. Only
    Linux offers this; elsewhere the call does nothing.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGINT), 0, 0, 0)
        if os.getppid() != parent:  # the parent died before the call
            sys.exit("the process that started this node is gone")


def obey_supervisor() -> None:
    """Follow the process that `PARENT_VARIABLE` names, which alone tells this process to stop.

    This process leaves its process group, because a terminal sends Ctrl-C to a whole group: the
    drives would stop before the nodes that command them. It does nothing without the variable.
    """
    parent = os.environ.pop(PARENT_VARIABLE, "")
    if not parent.isdecimal():
        return
    follow_parent(int(parent))
    if os.getpgrp() != os.getpid():
        os.setpgid(0, 0)
