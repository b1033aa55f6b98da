"""The nodes of a robot as child processes: their selection, command lines and order."""

import os
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from omniman_ros.console.errors import CommandError
from omniman_ros.core.errors import ParameterError
from omniman_ros.extras import PLANNING, VIEWER, WORLD
from omniman_ros.processes.arm_options import (
    private_controller_arguments,
    resolve_arm,
    world_arm_arguments,
)
from omniman_ros.processes.checked_parameters import check_node
from omniman_ros.processes.drive_options import (
    find_installation_file,
    find_settings_file,
    simulated_bus_arguments,
)
from omniman_ros.processes.process_group import ProcessSpec
from omniman_ros.robots import robot_file, robot_parameters
from omniman_ros.simulation.scene_files import load_scene, scene_file


@dataclass(frozen=True)
class NodeKind:
    """A node of the package, and the conditions under which it is started and stopped."""

    name: str  #: Name of the executable and of the node
    #: Stage in which the node is stopped: a drive runs until the nodes that command it have come
    #: to rest and ended.
    stage: int
    sim_time: str = "use_sim_time"  #: Parameter that `--sim-time` sets to true
    #: Returns whether the libraries that the node needs are installed. If not, the node is started
    #: only if it is requested by name, and then reports what is missing.
    is_available: Callable[[], bool] = lambda: True
    essential: bool = True  #: Whether the robot is stopped when the node ends
    on_request: bool = False  #: Whether the node is started only if it is requested by name
    #: Values of `--drive` with which the node is started, where `--world` counts as `world`; if
    #: empty, all.
    drives: tuple[str, ...] = ()
    arms: tuple[str, ...] = ()  #: Values of `--arm` with which the node is started; if empty, all


WORLD_DRIVE = "world"  #: Kind of the drives of a robot in a world, next to those in `DRIVES`

COLLISION_MONITOR = "collision_monitor"  #: Name of the node that limits the speed before contact

#: Name of the node that turns laser scans into obstacles and a map
OBSTACLE_TRACKER = "obstacle_tracker"

#: Name of the node that takes `tool_path` from `path_interpolator`
WHOLE_BODY_PLANNER = "whole_body_planner"

VIEWER_NODE = "viewer"  #: Name of the node that serves the page

ROBOT_NODES = (
    NodeKind("platform_controller", stage=0),
    NodeKind("path_interpolator", stage=0),
    NodeKind("mpc_planner", stage=0, is_available=lambda: PLANNING.is_available),
    NodeKind(WHOLE_BODY_PLANNER, stage=0, on_request=True),
    NodeKind("joint_states_merger", stage=0, essential=False),
    NodeKind("odometry", stage=0, on_request=True),
    NodeKind("station_keeper", stage=0, on_request=True),
    NodeKind(COLLISION_MONITOR, stage=0, essential=False, on_request=True),
    NodeKind(OBSTACLE_TRACKER, stage=0, essential=False, on_request=True),
    NodeKind("simulated_drive", stage=3, sim_time="publish_clock", drives=("simulated",)),
    NodeKind("simulated_world", stage=3, sim_time="publish_clock", drives=(WORLD_DRIVE,)),
    NodeKind("can_bridge", stage=1, drives=("can", "real")),
    NodeKind("simulated_can_drives", stage=2, sim_time="publish_clock", drives=("can",)),
    NodeKind("arm_streamer", stage=1, arms=("simulated", "ur")),
    NodeKind("simulated_ur", stage=2, arms=("simulated",)),
    NodeKind(VIEWER_NODE, stage=0, is_available=lambda: VIEWER.is_available, essential=False),
)  #: All nodes that a robot may consist of

LIMITED_NODES = (
    "platform_controller",
    "path_interpolator",
    WHOLE_BODY_PLANNER,
    "arm_streamer",
)  #: Nodes that obey the collision monitor, and stop without it, where it is started

#: Nodes that wait for the obstacles of the tracker where it is started, whatever becomes of it
SEEING_NODES = ("mpc_planner", WHOLE_BODY_PLANNER, COLLISION_MONITOR)

#: Nodes that plan within the arm's limits, predict by them or publish them, or know its joints.
#: Like the nodes of the arm, they get the parameters in the file of the arm's controller.
ARM_AWARE_NODES = (
    "path_interpolator",
    WHOLE_BODY_PLANNER,
    "joint_states_merger",
    COLLISION_MONITOR,
    OBSTACLE_TRACKER,
)

#: Arguments that move the transforms of a robot into its namespace.
#: The frames of other robots have the same names.
TRANSFORM_REMAPPING = ("-r", "/tf:=tf", "-r", "/tf_static:=tf_static")


@dataclass(frozen=True)
class RobotSetup:
    """Options with which `omniman up` starts a robot."""

    robot: str = "omniman"  #: Name of a robot of the package, or path of a robot's file
    #: Names of the nodes to start; if empty, all that fit the other options
    only: Sequence[str] = ()
    sim_time: bool = False  #: Whether the nodes run on `/clock`
    namespace: str = ""  #: Namespace of all nodes, with or without slashes at its ends
    params: Sequence[str] = ()  #: Parameters for every node, each NAME:=VALUE
    params_file: str | None = None  #: Path of a ROS parameter file for every node
    drive: str = "simulated"  #: Kind of wheel drives, a key of `DRIVES`
    installation: str = "cia402"  #: Name of an installation of drives, or path of its file
    #: Kind of arm, a key of `ARMS`; None selects the one that fits drive and time
    arm: str | None = None
    controller: str = "ur5"  #: Name of an arm's controller, or path of its file
    #: Name of a scene, or path of its file, if the robot is simulated in a world
    world: str | None = None
    #: Whether a collision monitor limits the robot's speed. With `only`, one does if it is among
    #: these nodes.
    collision_monitor: bool = False
    #: Whether laser scans are turned into obstacles and a map; with `only`, likewise
    obstacle_tracker: bool = False
    #: Whether platform and arm avoid obstacles on paths of the tool; with `only`, likewise
    whole_body_planner: bool = False

    @property
    def is_limited(self) -> bool:
        """Whether a collision monitor is started."""
        return COLLISION_MONITOR in self.only if self.only else self.collision_monitor

    @property
    def has_obstacle_tracker(self) -> bool:
        """Whether laser scans are turned into obstacles and a map."""
        return OBSTACLE_TRACKER in self.only if self.only else self.obstacle_tracker

    @property
    def has_whole_body_planner(self) -> bool:
        """Whether a whole-body planner is started."""
        return WHOLE_BODY_PLANNER in self.only if self.only else self.whole_body_planner

    @property
    def wheel_drive(self) -> str:
        """Kind of the wheel drives: `drive`, or :data:`WORLD_DRIVE` in a world."""
        return self.drive if self.world is None else WORLD_DRIVE


def robot_processes(setup: RobotSetup) -> list[ProcessSpec]:
    """Return a process for each chosen node; one that was requested by name is essential.

    Raises:
        CommandError: The robot, a node, the installation, the controller or a file does not
            exist; a parameter is not NAME:=VALUE, or a node would refuse it; simulated time is
            combined with drives or an arm that run on real time; or a world cannot be used.
    """
    _check_options(setup)
    robot = resolve_robot(setup.robot)
    arm = resolve_arm(setup.arm, setup.drive, setup.sim_time)
    chosen = [kind for kind in ROBOT_NODES if _is_chosen(kind, setup, arm)]
    more = _arm_arguments(arm, setup, robot, chosen)
    if setup.drive == "can":
        for name, arguments in simulated_bus_arguments(setup.namespace, setup.sim_time).items():
            more.setdefault(name, []).extend(arguments)
    of_nodes = {
        kind.name: _ros_arguments(kind, robot, setup, more.get(kind.name, ())) for kind in chosen
    }
    for name, given in of_nodes.items():
        check_node(name, setup.namespace, given)
    return [
        ProcessSpec(
            kind.name,
            node_command(kind.name, of_nodes[kind.name]),
            kind.stage,
            kind.essential or bool(setup.only),
        )
        for kind in chosen
    ]


def _check_options(setup: RobotSetup) -> None:
    """Raise CommandError if an option of a robot cannot be used."""
    known = [kind.name for kind in ROBOT_NODES]
    unknown = [name for name in setup.only if name not in known]
    if unknown:
        raise CommandError(f"no node '{unknown[0]}'; there are {', '.join(known)}", 2)
    for text in setup.params:
        if not re.fullmatch(r"[^\s:=]+:=.+", text):
            raise CommandError(f"parameter '{text}' is not NAME:=VALUE", 2)
    if setup.params_file is not None and not Path(setup.params_file).is_file():
        raise CommandError(f"no parameter file '{setup.params_file}'", 2)
    if setup.sim_time and setup.drive == "real":
        raise CommandError("--sim-time: drives 'real' run on real time", 2)
    if setup.world is not None:
        _check_world(setup, setup.world)


def _check_world(setup: RobotSetup, world: str) -> None:
    """Raise CommandError if a robot cannot be simulated in a world."""
    if setup.drive != "simulated":
        raise CommandError(f"--world: drives '{setup.drive}' are not in a world", 2)
    if setup.only and "simulated_world" not in setup.only:
        raise CommandError("--world: simulated_world is not among the nodes of --only", 2)
    if not WORLD.is_available:
        raise CommandError(WORLD.hint)
    try:
        load_scene(world)
    except ParameterError as error:
        reason = error.reason if error.name == "scene" else error
        raise CommandError(f"--world: {reason}", 2) from error


def _is_chosen(kind: NodeKind, setup: RobotSetup, arm: str) -> bool:
    if setup.only:
        return kind.name in setup.only
    if kind.name == COLLISION_MONITOR:
        return setup.is_limited
    if kind.name == OBSTACLE_TRACKER:
        return setup.has_obstacle_tracker
    if kind.name == WHOLE_BODY_PLANNER:
        return setup.has_whole_body_planner
    drives = kind.drives
    fits = (not drives or setup.wheel_drive in drives) and (not kind.arms or arm in kind.arms)
    return kind.is_available() and fits and not kind.on_request


def _arm_arguments(
    arm: str, setup: RobotSetup, robot: str, chosen: Sequence[NodeKind]
) -> dict[str, list[str]]:
    """Return the arguments that concern the arm, by the name of the node."""
    if arm == "none" and not setup.only:
        return {"joint_states_merger": ["-p", "describe_arm:=false"]}
    if not any(kind.arms for kind in chosen):
        return {}
    shared: list[str] = []
    if arm == "ur":
        shared = ["--params-file", find_settings_file("controller", "ur", setup.controller)]
    elif arm == "simulated":
        shared = private_controller_arguments()
    names = [kind.name for kind in chosen]
    arguments = {
        kind.name: list(shared) for kind in chosen if kind.arms or kind.name in ARM_AWARE_NODES
    }
    has_both = "simulated_world" in names and "simulated_ur" in names
    if has_both and robot_parameters(robot).get("arm.mass", 0.0) > 0.0:
        for name, more in world_arm_arguments().items():
            arguments.setdefault(name, []).extend(more)
    return arguments


def resolve_robot(robot: str) -> str:
    """Return a robot's name, or its file's absolute path; raise CommandError for others."""
    try:
        path = robot_file(robot)
    except ParameterError as error:
        raise CommandError(f"robot '{robot}': {error.reason}", 2) from error
    return str(path.resolve()) if Path(robot).suffix else robot


def node_command(node: str, arguments: Sequence[str]) -> tuple[str, ...]:
    """Return the command line of a node that ends when this process does."""
    runner = "omniman_ros.processes.run_node"
    return (sys.executable, "-m", runner, str(os.getpid()), node, *arguments)


def _world_arguments(kind: NodeKind, world: str) -> list[str]:
    """Return the ROS arguments of a node in a world, whose scanners are where parameters say."""
    if WORLD_DRIVE in kind.drives:
        return ["-p", f"scene:={scene_file(world).resolve()}"]
    return ["-p", "scanners_by_tf:=false"] if kind.name in (OBSTACLE_TRACKER, VIEWER_NODE) else []


def _peer_arguments(kind: NodeKind, setup: RobotSetup) -> list[str]:
    """Return the ROS arguments by which a node counts on others that are started."""
    arguments = []
    if setup.is_limited and kind.name in LIMITED_NODES:
        arguments += ["-p", "collision_monitor.use:=true"]
    if setup.has_obstacle_tracker and kind.name in SEEING_NODES:
        arguments += ["-p", "obstacles.required:=true"]
    if setup.has_whole_body_planner and kind.name == "path_interpolator":
        arguments += ["-p", "takes_tool_paths:=false"]
    return arguments


def _ros_arguments(
    kind: NodeKind, robot: str, setup: RobotSetup, more: Sequence[str]
) -> list[str]:
    """Return the ROS arguments of a node; a later value of a parameter overrides earlier ones."""
    arguments = ["--ros-args", "-p", f"robot:={robot}"]
    if setup.world is not None:
        arguments += _world_arguments(kind, setup.world)
    if set(kind.drives) & {"can", "real"}:
        arguments += ["--params-file", find_installation_file(setup.installation)]
    arguments += [*more, *_peer_arguments(kind, setup)]
    if setup.params_file is not None:
        arguments += ["--params-file", setup.params_file]
    for text in setup.params:
        arguments += ["-p", text]
    if setup.sim_time:
        arguments += ["-p", f"{kind.sim_time}:=true"]
        if kind.name == "arm_streamer":
            arguments += ["-p", "simulated_controller:=true"]
    if setup.namespace:
        arguments += ["-r", f"__ns:=/{setup.namespace.strip('/')}", *TRANSFORM_REMAPPING]
    return arguments
