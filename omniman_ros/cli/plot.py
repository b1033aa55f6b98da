"""`omniman plot`: the standard figures of a drive, from a recording."""

import argparse
import webbrowser
from importlib.util import find_spec
from pathlib import Path

from omniman_ros.bag import availability
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.terminal import say
from omniman_ros.core.errors import InputError


def run(args: argparse.Namespace) -> int:
    """Run `omniman plot`."""
    if not availability.is_available():
        raise CommandError(availability.HINT)
    if find_spec("matplotlib") is None:
        raise CommandError("pictures need matplotlib: pip install 'omniman_ros[plot]'")
    from omniman_ros.bag.reader import BagReader
    from omniman_ros.bag.robot_log import read
    from omniman_ros.cli.bag_picture import FIGURES, draw

    path = Path(args.bag)
    try:
        with BagReader(path) as bag:
            namespace = chosen_namespace(bag.kinds, args.namespace.strip("/"))
            say(f"{path}: {bag.duration:.1f} s, {len(bag.kinds)} topics")
            log = read(bag, namespace)
        log.span  # noqa: B018  (raises if there is nothing)
    except InputError as error:
        raise CommandError(str(error)) from error
    name = path.stem if path.is_file() else path.resolve().name
    prefix = "_".join(part for part in (name, namespace.replace("/", "_")) if part)
    drawn = draw(log, Path(args.results), prefix)
    for file in drawn.values():
        say(f"Picture: {file}")
        if args.show:
            webbrowser.open(file.resolve().as_uri())
    left_out = [name for name, _, _ in FIGURES if name not in drawn]
    if left_out:
        say(f"Not in the recording: {', '.join(left_out)}")
    return 0


def chosen_namespace(topics: dict[str, str], wanted: str) -> str:
    """Return the namespace of the robot to be drawn.

    Args:
        topics: Of the recording.
        wanted: What the user said, or empty.

    Raises:
        CommandError: No robot, not this one, or several and none was named.
    """
    from omniman_ros.bag.robot_log import namespaces

    found = namespaces(topics)
    if not found:
        raise CommandError("no robot in it: no odom, wheel_states or arm/joint_states")
    if wanted in found:
        return wanted
    known = ", ".join(name or "the one without a namespace" for name in found)
    if wanted:
        raise CommandError(f"no robot '{wanted}' in it; there are {known}", 2)
    if len(found) > 1:
        raise CommandError(f"several robots in it, choose by --namespace: {known}", 2)
    return found[0]
