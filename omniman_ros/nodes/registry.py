"""The nodes of the package and the parameters they have."""

import importlib
from collections.abc import Collection, Iterator

from omniman_ros.core.parameters import Spec, specs

NODES = {
    "platform_controller": "PlatformControllerParameters",
    "simulated_drive": "SimulatedDriveParameters",
    "can_bridge": "CanBridgeParameters",
    "simulated_can_drives": "SimulatedCanDrivesParameters",
    "simulated_ur": "SimulatedUrParameters",
    "arm_streamer": "ArmStreamerParameters",
    "path_interpolator": "PathInterpolatorParameters",
    "mpc_planner": "MpcPlannerParameters",
    "joint_state_broadcaster": "JointStateBroadcasterParameters",
    "viewer": "ViewerParameters",
}
"""Executable, which is also its module here, and the dataclass of its parameters there."""


def node_specs(node: str) -> list[Spec]:
    """List a node's parameters; those of the robot come first."""
    module = importlib.import_module(f"omniman_ros.nodes.{node}")
    return specs(getattr(module, NODES[node]))


def known_names() -> set[str]:
    """Names of all parameters that any node of the package has."""
    return {spec.name for node in NODES for spec in node_specs(node)}


def markdown(node: str, *, robot: bool, told: Collection[Spec] = ()) -> Iterator[str]:
    """Lines of a table of a node's parameters.

    Args:
        node: A name from NODES.
        robot: Whether to list the parameters of the robot, or the others.
        told: Parameters that another table has; groups of them are only named.
    """
    shared = _robot_names()
    known = {spec for spec in told if "." in spec.name}
    groups: dict[str, None] = {}
    yield "| parameter | default | unit | range | |"
    yield "|---|---|---|---|---|"
    for spec in node_specs(node):
        if (spec.name in shared) is not robot:
            continue
        if spec in known:
            groups[f"`{spec.name.partition('.')[0]}.*`"] = None
            continue
        fixed = "*fixed.* " if spec.read_only else ""
        yield (
            f"| `{spec.name}` | {_default(spec)} | {spec.unit} | {_range(spec)} "
            f"| {fixed}{spec.doc} |"
        )
    if groups:
        yield f"| {', '.join(groups)} | as above | | | |"


def _robot_names() -> set[str]:
    """Names that all nodes have which know the robot (a node may do without)."""
    names = [{spec.name for spec in node_specs(node)} for node in NODES]
    return set.intersection(*(known for known in names if "wheels.names" in known))


def _default(spec: Spec) -> str:
    if spec.required:
        return "robot"
    value = spec.default
    if isinstance(value, tuple):
        return "[" + ", ".join(map(str, value)) + "]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _range(spec: Spec) -> str:
    if spec.choices:
        return ", ".join(spec.choices)
    if spec.low is None and spec.high is None:
        return ""
    low = "" if spec.low is None else f"{spec.low:g}"
    high = "" if spec.high is None else f"{spec.high:g}"
    return f"{low} to {high}"
