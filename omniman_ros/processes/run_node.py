"""Run a node as a child process that ends with its parent.

Usage: `python -m omniman_ros.processes.run_node PARENT_PID NODE [ARGUMENT...]`. The kernel sends
SIGINT to this process when the parent has died for any reason, SIGKILL included, so that no node
is left behind; the node then comes to rest and ends as it does on Ctrl-C.
"""

import gc
import importlib
import sys

from omniman_ros.nodes.parent_process import follow_parent


def main() -> int:
    """Run the node named on the command line, and return its exit code."""
    parent, name, *arguments = sys.argv[1:]
    try:
        follow_parent(int(parent))
        # Nothing that the imports make is garbage; `nodes.runtime.run` enables the search for it.
        gc.disable()
        # Imports take time, during which a signal must be handled here.
        from omniman_ros.nodes.registry import node_module

        module = name if "." in name else node_module(name)
        node = importlib.import_module(module)
        return int(node.main([name, *arguments]))
    except KeyboardInterrupt:
        return 0  # the node does not handle signals at this time: nothing moves


if __name__ == "__main__":
    sys.exit(main())
