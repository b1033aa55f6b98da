"""Arguments of `omniman identify SUBJECT`."""

import argparse
from collections.abc import Callable

from omniman_ros.cli.arguments.common import (
    ROBOT_HELP,
    add_examples,
    add_namespace,
    add_parameters,
    add_results,
)


def add_identify(parser: argparse.ArgumentParser) -> None:
    """Add the subjects of `omniman identify`, each with its arguments."""
    subjects = parser.add_subparsers(dest="subject", metavar="SUBJECT", required=True)
    for name, (text, add_arguments) in SUBJECTS.items():
        subject = subjects.add_parser(
            name, help=text, description=text[0].upper() + text[1:] + ".", allow_abbrev=False
        )
        add_arguments(subject)
        add_parameters(subject, "with --simulate: a parameter, set on every node; may be repeated")
        subject.add_argument("--verbose", action="store_true", help="show the output of the nodes")
        add_namespace(subject, "namespace of the robot")
        add_results(subject)
        run = f"identify {name}"
        add_examples(
            subject, (f"{run} --simulate", f"{run} --runs results/identify_{name}_runs.json")
        )


def add_odometry(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman identify odometry`."""
    parser.add_argument(
        "--area",
        type=float,
        default=3.0,
        metavar="METRES",
        help="side of the free square with the robot in its middle; default: %(default)s",
    )
    parser.add_argument(
        "--speed", type=float, default=0.3, help="speed of the drives [m/s]; default: %(default)s"
    )
    parser.add_argument(
        "--truth",
        metavar="TOPIC",
        help="nav_msgs/Odometry with the measured pose of base_link; default: you type the poses",
    )
    parser.add_argument(
        "--accuracy",
        type=float,
        nargs=2,
        metavar=("MM", "DEGREES"),
        help="standard deviations of a measured pose; default: 3 0.3 for poses that are typed, "
        "1 0.1 for those from a topic",
    )
    parser.add_argument("--yes", action="store_true", help="with --truth: begin without asking")
    parser.add_argument(
        "--runs", metavar="FILE", help="do not drive, but fit to runs that were recorded before"
    )
    parser.add_argument(
        "--simulate",
        action="store_true",
        help="start a simulated robot to be identified, with wrong radii and mounting",
    )
    parser.add_argument("--robot", help=f"with --simulate: {ROBOT_HELP}; default: omniman")


def add_friction(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman identify friction`."""
    parser.add_argument(
        "--lifted",
        action="store_true",
        help="confirm that the wheels are off the floor and free: begin without asking",
    )
    parser.add_argument(
        "--levels",
        type=int,
        default=6,
        metavar="N",
        help="number of voltages in each direction; default: %(default)s",
    )
    parser.add_argument(
        "--rounds",
        type=int,
        default=2,
        metavar="N",
        help="number of times that each voltage is applied; default: %(default)s",
    )
    parser.add_argument(
        "--precision",
        type=float,
        default=0.5,
        metavar="PERCENT",
        help="precision of the mean current at which a measurement ends, after 20 s at the "
        "latest; default: %(default)s",
    )
    parser.add_argument(
        "--runs",
        metavar="FILE",
        help="do not drive the wheels, but fit to runs that were recorded before",
    )
    parser.add_argument(
        "--simulate",
        action="store_true",
        help="start a simulated robot on blocks, whose friction differs from its configuration",
    )
    parser.add_argument(
        "--robot",
        help=f"{ROBOT_HELP}; default: the robot that the drive is configured for; with "
        "--simulate: omniman",
    )


def add_floor(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `omniman identify floor`."""
    parser.add_argument(
        "--area",
        type=float,
        default=2.0,
        metavar="METRES",
        help="side of the free square with the robot in its middle; default: %(default)s",
    )
    parser.add_argument(
        "--duration",
        type=float,
        default=60.0,
        metavar="SECONDS",
        help="duration of the drive that is fitted to; default: %(default)s",
    )
    parser.add_argument("--yes", action="store_true", help="begin without asking")
    parser.add_argument(
        "--runs", metavar="FILE", help="do not drive, but fit to a drive that was recorded before"
    )
    parser.add_argument(
        "--simulate",
        action="store_true",
        help="start a simulated robot to be identified, with other masses, friction and gears",
    )
    parser.add_argument("--robot", help=f"with --simulate: {ROBOT_HELP}; default: omniman")


SUBJECTS: dict[str, tuple[str, Callable[[argparse.ArgumentParser], None]]] = {
    "odometry": ("calibrate the odometry by drives whose ends are measured", add_odometry),
    "friction": ("measure the wheels' friction, with the wheels off the floor", add_friction),
    "floor": ("measure masses, drag and gear efficiency by a drive on the floor", add_floor),
}  #: Help text of each subject, with the function that adds its arguments
