"""`omniman parameters`: print tables of the nodes' parameters."""

import argparse

from omniman_ros.console.terminal import write_output
from omniman_ros.core.parameters import Spec
from omniman_ros.nodes.registry import NODES, markdown, node_specs


def run(args: argparse.Namespace) -> int:
    """Run `omniman parameters`; the exit code is 0."""
    write_output((node_table(args.node) if args.node else all_tables()) + "\n")
    return 0


def node_table(node: str) -> str:
    """Return a Markdown table of all parameters of a node, those of the robot first."""
    others = list(markdown(node, robot=False))
    return "\n".join([*markdown(node, robot=True), *others[2:]])


def all_tables() -> str:
    """Return a Markdown section on the parameters that all nodes share, then one for each node."""
    first = next(iter(NODES))
    parts = ["### The robot (all nodes)", "", *markdown(first, robot=True)]
    listed: list[Spec] = []
    for node in NODES:
        parts += ["", f"### {node}'s own", "", *markdown(node, robot=False, listed=listed)]
        listed += node_specs(node)
    return "\n".join(parts)
