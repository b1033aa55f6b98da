"""Command `omniman parameters`: tables of the nodes' parameters, as the README has them."""

import argparse

from omniman_ros.core.parameters import Spec
from omniman_ros.nodes.registry import NODES, markdown, node_specs


def run(args: argparse.Namespace) -> int:
    """Print the table of one node, or all of them with headings."""
    print(table(args.node) if args.node else tables())
    return 0


def table(node: str) -> str:
    """All parameters of a node, the robot's first."""
    others = list(markdown(node, robot=False))
    return "\n".join([*markdown(node, robot=True), *others[2:]])


def tables() -> str:
    """What all nodes know of the robot, then the parameters of each."""
    first = next(iter(NODES))
    parts = ["### The robot (all nodes)", "", *markdown(first, robot=True)]
    told: list[Spec] = []
    for node in NODES:
        parts += ["", f"### {node}'s own", "", *markdown(node, robot=False, told=told)]
        told += node_specs(node)
    return "\n".join(parts)
