"""Runs a node as a child process that ends with its parent: `python -m omniman_ros.cli.node`.

Usage: python -m omniman_ros.cli.node PARENT_PID NODE [ARGUMENT...]. The kernel sends SIGINT to
this process when the parent has died in whatever way, SIGKILL included, so that no node is left
behind; the node then comes to rest and ends as it does on Ctrl-C.
"""

import ctypes
import importlib
import os
import signal
import sys

PR_SET_PDEATHSIG = 1


def follow_parent(parent: int) -> None:
    """Have SIGINT sent to this process when its parent dies (Linux; nothing elsewhere).

    To the kernel the parent is the thread that started this process: the main thread, here.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGINT), 0, 0, 0)
        if os.getppid() != parent:  # it died before the call
            sys.exit("the process that started this node is gone")


def main() -> int:
    """Run the node named on the command line; returns its exit code."""
    parent, name, *arguments = sys.argv[1:]
    module = name if "." in name else f"omniman_ros.nodes.{name}"
    try:
        follow_parent(int(parent))
        node = importlib.import_module(module)
        return int(node.main([name, *arguments]))
    except KeyboardInterrupt:
        return 0  # before or after the node's own handlers: nothing moves


if __name__ == "__main__":
    sys.exit(main())
