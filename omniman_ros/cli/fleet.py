"""The nodes of a robot as child processes: which there are, their command lines, their order."""

import os
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from omniman_ros.cli.arm import chosen_arm, private_controller
from omniman_ros.cli.children import Task
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.installation import installation_file, private_bus, settings_file
from omniman_ros.core.errors import ParameterError
from omniman_ros.planning import availability as planning_availability
from omniman_ros.robots import robot_file
from omniman_ros.viewer import availability as viewer_availability


@dataclass(frozen=True)
class NodeKind:
    """A node of the package.

    Attributes:
        name: Of the executable and of the node.
        stage: When it is stopped: a drive lives until those that command it are at rest.
        sim_time: The parameter that --sim-time sets.
        is_available: Whether what it needs is installed; if not, it is started only where it is
            asked for by name, and then says what is missing.
        essential: Whether the robot is stopped when it dies.
        drives: With which drives it is started; none: with all.
        arms: With which arms it is started; none: with all.
    """

    name: str
    stage: int
    sim_time: str = "use_sim_time"
    is_available: Callable[[], bool] = lambda: True
    essential: bool = True
    drives: tuple[str, ...] = ()
    arms: tuple[str, ...] = ()


NODES = (
    NodeKind("platform_controller", stage=0),
    NodeKind("path_interpolator", stage=0),
    NodeKind("mpc_planner", stage=0, is_available=planning_availability.is_available),
    NodeKind("joint_state_broadcaster", stage=0, essential=False),
    NodeKind("simulated_drive", stage=1, sim_time="publish_clock", drives=("simulated",)),
    NodeKind("can_bridge", stage=1, drives=("can", "real")),
    NodeKind("simulated_can_drives", stage=2, drives=("can",)),
    NodeKind("arm_streamer", stage=1, arms=("simulated", "ur")),
    NodeKind("simulated_ur", stage=2, arms=("simulated",)),
    NodeKind("viewer", stage=0, is_available=viewer_availability.is_available, essential=False),
)

KNOW_THE_ARM = ("path_interpolator", "joint_state_broadcaster")
"""They plan within the arm's limits, or tell them, and get what its controller's file says."""

OWN_TRANSFORMS = ("-r", "/tf:=tf", "-r", "/tf_static:=tf_static")
"""Robots in namespaces have frames of the same names: each keeps its transforms to itself."""
PATIENCE = (
    "-p", "can.missed_periods:=40", "-p", "can.drive_heartbeat:=0.1",
    "-p", "can.heartbeat_timeout:=0.3",
)  # fmt: skip
"""Simulated drives are processes that wait for their turn on a busy machine; real ones do not."""


@dataclass(frozen=True)
class Setup:
    """What the nodes are started with; the fields are the options of `omniman up`."""

    robot: str = "omniman"
    only: Sequence[str] = ()
    sim_time: bool = False
    namespace: str = ""
    params: Sequence[str] = ()
    params_file: str | None = None
    drive: str = "simulated"
    installation: str = "cia402"
    arm: str | None = None
    controller: str = "ur5"


def tasks(setup: Setup) -> list[Task]:
    """Tasks of the chosen nodes.

    Raises:
        CommandError: No such robot, node, installation or file, a parameter that is not
            NAME:=VALUE, or simulated time with drives that have none.
    """
    known = [kind.name for kind in NODES]
    unknown = [name for name in setup.only if name not in known]
    if unknown:
        raise CommandError(f"no node '{unknown[0]}'; there are {', '.join(known)}", 2)
    for text in setup.params:
        if not re.fullmatch(r"[^\s:=]+:=.+", text):
            raise CommandError(f"parameter '{text}' is not NAME:=VALUE", 2)
    if setup.params_file is not None and not Path(setup.params_file).is_file():
        raise CommandError(f"no parameter file '{setup.params_file}'", 2)
    if setup.sim_time and setup.drive != "simulated":
        raise CommandError(f"--sim-time: drives '{setup.drive}' run on real time", 2)
    robot = resolved(setup.robot)
    arm = chosen_arm(setup.arm, setup.drive, setup.sim_time)
    chosen = [kind for kind in NODES if _is_chosen(kind, setup, arm)]
    of_arm = _arm_arguments(arm, setup) if any(kind.arms for kind in chosen) else []
    return [
        Task(
            kind.name,
            node_command(kind.name, _ros_arguments(kind, robot, setup, of_arm)),
            kind.stage,
            kind.essential or bool(setup.only),
        )
        for kind in chosen
    ]


def _is_chosen(kind: NodeKind, setup: Setup, arm: str) -> bool:
    if setup.only:
        return kind.name in setup.only
    fits = (not kind.drives or setup.drive in kind.drives) and (not kind.arms or arm in kind.arms)
    return kind.is_available() and fits


def _arm_arguments(arm: str, setup: Setup) -> list[str]:
    if arm == "ur":
        return ["--params-file", settings_file("controller", "ur", setup.controller)]
    return private_controller() if arm == "simulated" else []


def resolved(robot: str) -> str:
    """The robot's name as it is, or the whole path of its file.

    Raises:
        CommandError: There is no such robot.
    """
    try:
        path = robot_file(robot)
    except ParameterError as error:
        raise CommandError(f"robot '{robot}': {error.reason}", 2) from error
    return str(path.resolve()) if Path(robot).suffix else robot


def node_command(node: str, arguments: Sequence[str]) -> tuple[str, ...]:
    """Command line of a node, by name or module, that ends when this process does."""
    return (sys.executable, "-m", "omniman_ros.cli.node", str(os.getpid()), node, *arguments)


def _ros_arguments(kind: NodeKind, robot: str, setup: Setup, of_arm: Sequence[str]) -> list[str]:
    arguments = ["--ros-args", "-p", f"robot:={robot}"]
    if set(kind.drives) & {"can", "real"}:
        arguments += ["--params-file", installation_file(setup.installation)]
        if setup.drive == "can":
            arguments += [*private_bus(setup.namespace), *PATIENCE]
    if kind.arms or kind.name in KNOW_THE_ARM:
        arguments += of_arm
    if setup.params_file is not None:
        arguments += ["--params-file", setup.params_file]
    for text in setup.params:
        arguments += ["-p", text]
    if setup.sim_time:
        arguments += ["-p", f"{kind.sim_time}:=true"]
    if setup.namespace:
        arguments += ["-r", f"__ns:=/{setup.namespace.strip('/')}", *OWN_TRANSFORMS]
    return arguments
