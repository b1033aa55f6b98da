"""Run a node as a child process that ends with its parent.

Usage: `python -m omniman_ros.processes.run_node PARENT_PID NODE [ARGUMENT...]`. The kernel sends
SIGINT to this process when the parent has died for any reason, SIGKILL included, so that no node
is left behind; the node then comes to rest and ends as it does on Ctrl-C.
"""

import ctypes
import importlib
import os
import signal
import sys

PR_SET_PDEATHSIG = 1
"""Option of prctl(2) that sets the signal a process gets when its parent dies."""


def follow_parent(parent: int) -> None:
    """Have the kernel send SIGINT to this process when its parent dies.

    To the kernel, the parent is the thread that started this process, here the main thread. Only
    Linux offers this; elsewhere the call does nothing.

    Args:
        parent: Process id of the parent. This process exits if the parent has died already.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGINT), 0, 0, 0)
        if os.getppid() != parent:  # the parent died before the call
            sys.exit("the process that started this node is gone")


def main() -> int:
    """Run the node named on the command line, and return its exit code."""
    parent, name, *arguments = sys.argv[1:]
    try:
        follow_parent(int(parent))
        # Imports take time, during which a signal must be handled here.
        from omniman_ros.nodes.registry import node_module

        module = name if "." in name else node_module(name)
        node = importlib.import_module(module)
        return int(node.main([name, *arguments]))
    except KeyboardInterrupt:
        return 0  # the node does not handle signals at this time: nothing moves


if __name__ == "__main__":
    sys.exit(main())
