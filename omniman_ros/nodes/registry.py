"""The nodes of the package, and tables of their parameters."""

import difflib
import importlib
from collections.abc import Collection, Iterable, Iterator
from functools import cache

from omniman_ros.core.parameters import Spec, specs

#: Parameter dataclass of each executable, within the package.
#: A node that is given a name that it has no parameter of looks it up here when it starts, node
#: after node, so the modules named here import nothing heavy; in particular, not the nodes
#: themselves. The robots' files name parameters of the first.
NODES = {
    "platform_controller": "nodes.platform_controller_parameters.PlatformControllerParameters",
    "simulated_ur": "nodes.simulated_ur_parameters.SimulatedUrParameters",
    "simulated_drive": "nodes.simulated_drive_parameters.SimulatedDriveParameters",
    "simulated_world": "nodes.simulated_world_parameters.SimulatedWorldParameters",
    "can_bridge": "nodes.can_bridge_parameters.CanBridgeParameters",
    "simulated_can_drives": "nodes.simulated_can_drives_parameters.SimulatedCanDrivesParameters",
    "arm_streamer": "nodes.arm_streamer_parameters.ArmStreamerParameters",
    "path_interpolator": "nodes.path_interpolator.parameters.PathInterpolatorParameters",
    "mpc_planner": "nodes.mpc_planner.parameters.MpcPlannerParameters",
    "whole_body_planner": "nodes.whole_body_planner.parameters.WholeBodyPlannerParameters",
    "station_keeper": "nodes.station_keeper_parameters.StationKeeperParameters",
    "collision_monitor": "nodes.collision_monitor_parameters.CollisionMonitorParameters",
    "obstacle_tracker": "nodes.obstacle_tracker_parameters.ObstacleTrackerParameters",
    "joint_states_merger": ("nodes.joint_states_merger_parameters.JointStatesMergerParameters"),
    "odometry": "nodes.odometry_parameters.OdometryNodeParameters",
    "viewer": "viewer.ros.parameters.ViewerParameters",
}
#: Nodes that have a folder, with their `main()` in its module `node`
FOLDERS = ("mpc_planner", "path_interpolator", "whole_body_planner")
#: Beginnings of the names of parameters that rclpy declares for every node
_OF_RCLPY = ("use_sim_time", "qos_overrides", "start_type_description_service")


def node_module(name: str) -> str:
    """Return the module of an executable, which contains its `main()`."""
    if name == "viewer":
        return "omniman_ros.viewer.node"
    module = f"omniman_ros.nodes.{name}"
    return f"{module}.node" if name in FOLDERS else module


def parameter_class(node: str) -> type:
    """Return the dataclass of a node's parameters."""
    module, _, name = NODES[node].rpartition(".")
    found: type = getattr(importlib.import_module(f"omniman_ros.{module}"), name)
    return found


def node_specs(node: str) -> list[Spec]:
    """Return the parameters of a node; those of the robot come first."""
    return specs(parameter_class(node))


@cache
def known_names() -> frozenset[str]:
    """Return the names of all parameters that any node of the package has."""
    return frozenset(spec.name for node in NODES for spec in node_specs(node))


def _names_of_no_node(given: Iterable[str]) -> set[str]:
    """Return those names that no node of the package has a parameter of.

    The nodes are asked one after the other, until all names are found: to import the parameters of
    all of them takes as much time as to make a node.
    """
    left = set(given)
    for node in NODES:
        if not left:
            break
        left -= {spec.name for spec in node_specs(node)}
    return left


def unknown_names(given: Iterable[str], own: Iterable[str] = ()) -> list[str]:
    """Return a sentence about each given parameter name that no node of the package has.

    rclpy ignores a mistyped name in a file silently.
    """
    strange = [name for name in {*given} - {*own, "robot"} if not name.startswith(_OF_RCLPY)]
    sentences = []
    for name in sorted(_names_of_no_node(strange)):
        close = difflib.get_close_matches(name, {*known_names(), "robot"}, 1)
        hint = f", did you mean '{close[0]}'?" if close else ""
        sentences.append(f"no node of omniman_ros has a parameter '{name}'{hint}")
    return sentences


def markdown(node: str, *, robot: bool, listed: Collection[Spec] = ()) -> Iterator[str]:
    """Yield the lines of a Markdown table of a node's parameters.

    Args:
        robot: Whether to list the parameters of the robot, or the others.
        listed: Parameters that another table lists; their groups are only named.
    """
    shared = _robot_names()
    known = {spec for spec in listed if "." in spec.name}
    groups: dict[str, None] = {}
    yield "| parameter | default | unit | range | meaning |"
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
    names = [{spec.name for spec in node_specs(node)} for node in NODES]
    return set.intersection(*(known for known in names if "wheels.names" in known))


def _default(spec: Spec) -> str:
    """Return the default as a YAML file has it; "robot" if the robot's file must give it."""
    if spec.required:
        return "robot"
    value = spec.default
    if isinstance(value, tuple):
        return "[" + ", ".join(map(str, value)) + "]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _range(spec: Spec) -> str:
    """Return the range or the choices of a parameter; empty if it is unbounded."""
    if spec.choices:
        return ", ".join(spec.choices)
    if spec.low is None and spec.high is None:
        return ""
    low = "" if spec.low is None else f"{spec.low:g}"
    high = "" if spec.high is None else f"{spec.high:g}"
    return f"{low} to {high}"
