"""`omniman plot`: draw the standard figures of a drive from a recording."""

import argparse
import webbrowser
from importlib.util import find_spec
from pathlib import Path

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.core.errors import InputError
from omniman_ros.extras import RECORDING, pip_install


def run(args: argparse.Namespace) -> int:
    """Run `omniman plot`; return 0 or raise CommandError."""
    if not RECORDING.is_available:
        raise CommandError(RECORDING.hint)
    if find_spec("matplotlib") is None:
        raise CommandError(f"figures need matplotlib: {pip_install()} matplotlib")
    from omniman_ros.recording.figures import FIGURES, draw_figures
    from omniman_ros.recording.reader import BagReader
    from omniman_ros.recording.robot_log import read_robot_log

    path = Path(args.bag)
    try:
        with BagReader(path) as bag:
            namespace = choose_namespace(bag.topic_types, args.namespace.strip("/"))
            say(f"{path}: {bag.duration:.1f} s, {len(bag.topic_types)} topics")
            if bag.is_unfinished:
                say("It has no end, as its process was killed: the last moments are missing.")
            log = read_robot_log(bag, namespace)
        _ = log.span  # raises if the recording contains no data of the robot
    except InputError as error:
        raise CommandError(str(error)) from error
    name = path.stem if path.is_file() else path.resolve().name
    prefix = "_".join(part for part in (name, namespace.replace("/", "_")) if part)
    drawn = draw_figures(log, Path(args.results), prefix)
    for file in drawn.values():
        say(f"Figure: {file}")
        if args.show:
            webbrowser.open(file.resolve().as_uri())
    missing = [figure.name for figure in FIGURES if figure.name not in drawn]
    if missing:
        say(f"Not in the recording: {', '.join(missing)}")
    return 0


def choose_namespace(topics: dict[str, str], requested: str) -> str:
    """Return the namespace of the robot to plot.

    Args:
        topics: Types of the recorded topics, by name.
        requested: Namespace that the user has given; empty means that of the only robot.

    Raises:
        CommandError: The recording contains no robot, not the requested one, or several robots
            while none was requested.
    """
    from omniman_ros.recording.robot_log import robot_namespaces

    namespaces = robot_namespaces(topics)
    if not namespaces:
        raise CommandError(
            "there is no robot in the recording: no odom, wheel_states or arm/joint_states"
        )
    if requested in namespaces:
        return requested
    known = ", ".join(name or "the one without a namespace" for name in namespaces)
    if requested:
        raise CommandError(
            f"there is no robot '{requested}' in the recording; there are {known}", 2
        )
    if len(namespaces) > 1:
        raise CommandError(
            f"there are several robots in the recording, choose by --namespace: {known}", 2
        )
    return namespaces[0]
