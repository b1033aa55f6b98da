"""`omniman info`: what a report of a bug needs, as plain text.

It makes no ROS node, and works without rclpy, without extras, and with a robot that cannot be
loaded.
"""

import argparse
import importlib
import os
import platform
from collections.abc import Iterator, Mapping
from pathlib import Path

import omniman_ros
from omniman_ros.cli.installation import (
    Requirements,
    commit_text,
    extra_text,
    installation_text,
    installed_version,
    own_distribution,
    parse_requirements,
)
from omniman_ros.console.terminal import write_output
from omniman_ros.extras import ROS

#: Libraries whose versions are told where there is no metadata that names them
LIBRARIES = ("numpy", "casadi", "scipy", "python-can", "canopen")
#: Environment variables that are told even if they are not set, and what ROS then does
DEFAULTS = {"ROS_DOMAIN_ID": "0", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
#: Other environment variables that change who hears whom, or which code runs
VARIABLES = (
    "ROS_STATIC_PEERS",
    "ROS_LOCALHOST_ONLY",
    "ROS_DISCOVERY_SERVER",
    "ROS_SUPER_CLIENT",
    "RMW_IMPLEMENTATION",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_BUILTIN_TRANSPORTS",
    "RMW_FASTRTPS_USE_QOS_FROM_XML",
    "CYCLONEDDS_URI",
    "ZENOH_SESSION_CONFIG_URI",
    "ROS_SECURITY_ENABLE",
    "ROS_SECURITY_STRATEGY",
    "ROS_PYTHON_CHECK_FIELDS",
    "AMENT_PREFIX_PATH",
    "PYTHONPATH",
    "VIRTUAL_ENV",
)

Rows = Iterator[tuple[str, str]]  #: Names and texts of the lines of a section


def run(args: argparse.Namespace) -> int:
    """Run `omniman info`; the exit code is 1 if the robot cannot be loaded, else 0."""
    found = own_distribution()
    lines = [] if found is None else found.requires or []
    extras = [] if found is None else found.metadata.get_all("Provides-Extra") or []
    requirements = parse_requirements(lines, extras)
    robot, is_loaded = robot_rows(args.robot)
    folder = Path(omniman_ros.__file__).parent
    sections = {
        "omniman_ros": [
            ("version", "unknown" if found is None else found.version),
            ("installed", installation_text(found, os.environ)),
            ("runs from", str(folder)),
            ("commit", commit_text(folder)),
        ],
        "machine": list(machine_rows()),
        "ROS": [*ros_rows(requirements), *environment_rows(os.environ)],
        "libraries": [
            (name, installed_version(name) or "missing")
            for name in requirements.always or LIBRARIES
        ],
        "extras": [(name, extra_text(names)) for name, names in requirements.extras.items()],
        "robot": robot,
    }
    write_output(layout(sections))
    return 0 if is_loaded else 1


def layout(sections: Mapping[str, list[tuple[str, str]]]) -> str:
    """Return sections of lines as text; those without lines are left out."""
    width = max(len(name) for rows in sections.values() for name, _ in rows)
    blocks = [
        "\n".join([title, *(f"  {name:<{width}}  {text}" for name, text in rows)])
        for title, rows in sections.items()
        if rows
    ]
    return "\n\n".join(blocks) + "\n"


def machine_rows() -> Rows:
    """Yield what is known of the machine and its Python."""
    yield "Python", f"{platform.python_implementation()} {platform.python_version()}"
    try:
        name = platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        name = platform.system()
    yield "system", name
    yield "kernel", f"{platform.system()} {platform.release()} {platform.machine()}"
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    yield "CPUs", f"{os.cpu_count()}, of which this process may use {usable}"


def ros_rows(requirements: Requirements) -> Rows:
    """Yield the distribution of ROS, and what of it this Python finds; it makes no node."""
    wheels = {
        distro: f"{distro}, by pip: {wheel} {installed_version(wheel)}"
        for distro, wheel in requirements.ros_wheels.items()
        if installed_version(wheel)
    }
    distro = os.environ.get("ROS_DISTRO", "")
    yield "distribution", wheels.get(distro) or distro or next(iter(wheels.values()), "none")
    if not ROS.is_available:
        yield "rclpy", "missing"
        return
    yield "rclpy", installed_version("rclpy") or "of an unknown version"
    yield "middleware", _middleware()


def _middleware() -> str:
    try:
        utilities = importlib.import_module("rclpy.utilities")
        return str(utilities.get_rmw_implementation_identifier())
    except Exception as error:  # whatever is wrong with ROS, the report goes on
        return f"cannot be loaded: {_in_one_line(error)}"


def environment_rows(environment: Mapping[str, str]) -> Rows:
    """Yield the variables that are set, and those that have a default."""
    for name, default in DEFAULTS.items():
        yield name, environment.get(name) or f"not set: {default}"
    yield from ((name, environment[name]) for name in VARIABLES if environment.get(name))


def robot_rows(robot: str) -> tuple[list[tuple[str, str]], bool]:
    """Return what a robot is, or why it cannot be loaded; and whether it can."""
    rows = [("name", robot)]
    try:
        from omniman_ros.robot_model import load_robot
        from omniman_ros.robots import robot_file

        rows.append(("file", str(robot_file(robot).resolve())))
        model = load_robot(robot)
    except Exception as error:  # whatever is wrong with it, the report goes on
        return [*rows, ("error", f"{type(error).__name__}: {_in_one_line(error)}")], False
    kinds = ["Omni" if angle == 0.0 else "Mecanum" for angle in model.wheels.roller_angle]
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    arm, joints = model.platform.arm, model.arm.joints
    is_carried = arm.mass > 0.0
    rows += [
        ("wheels", f"{counts}: {', '.join(model.wheels.names)}"),
        (
            "arm",
            f"{len(joints)} joints, {arm.mass:g} kg" if is_carried else "none (arm.mass is 0)",
        ),
    ]
    return rows, True


def _in_one_line(error: Exception) -> str:
    return " ".join(str(error).split())
