"""Command `omniman`: names, arguments and help of the subcommands.

A subcommand's own module, and rclpy and numpy with it, is imported only when it runs.
"""

import argparse
import importlib
import sys
from collections.abc import Callable, Sequence

from omniman_ros.cli.arm import ARMS
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.installation import DRIVES
from omniman_ros.core.errors import OmnimanError
from omniman_ros.nodes.registry import NODES

DESCRIPTION = """\
Mobile manipulator on Mecanum or Omni wheels: start it, drive it, try it, measure it.
"""
EPILOG = """\
`omniman COMMAND --help` explains a command. Exit code 0: it did what it should; 1: it did not,
and the last lines say why; 2: the command line is wrong; 130: ended by Ctrl-C.
"""
ROBOT = "a robot of the package (omniman, ig42) or the path of its .yaml file"


class Version(argparse.Action):
    """Prints the version; looks it up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object, **__: object) -> None:
        """Print and end."""
        from importlib.metadata import PackageNotFoundError, version

        try:
            print("omniman", version("omniman_ros"))
        except PackageNotFoundError:
            print("omniman (not installed, the version is in setup.py)")
        parser.exit()


def add_robot(parser: argparse.ArgumentParser) -> None:
    """Add --robot."""
    parser.add_argument("--robot", default="omniman", help=f"{ROBOT}; default: omniman")


def add_namespace(parser: argparse.ArgumentParser, text: str) -> None:
    """Add --namespace."""
    parser.add_argument("--namespace", default="", metavar="NS", help=text)


def add_results(parser: argparse.ArgumentParser) -> None:
    """Add --results."""
    parser.add_argument(
        "--results", default="results", metavar="FOLDER", help="where the JSON goes; %(default)s"
    )


def add_up(parser: argparse.ArgumentParser) -> None:
    """Arguments of `omniman up`."""
    add_robot(parser)
    add_namespace(parser, "namespace of all nodes and topics")
    parser.add_argument(
        "--only", nargs="+", metavar="NODE", help="start these nodes only; default: all"
    )
    parser.add_argument(
        "--sim-time", action="store_true",
        help="run on /clock, which the simulated drive then publishes",
    )  # fmt: skip
    parser.add_argument(
        "-p", "--param", action="append", default=[], metavar="NAME:=VALUE",
        help="a parameter, given to every node; may be repeated",
    )  # fmt: skip
    parser.add_argument("--params-file", metavar="FILE", help="a ROS parameter file for all nodes")
    add_drive(parser, tuple(DRIVES))
    add_arm(parser, tuple(ARMS))
    parser.add_argument(
        "--controller", default="ur5", metavar="NAME",
        help="with --arm ur: ur5 or the path of a .yaml file; default: %(default)s",
    )  # fmt: skip


def add_arm(parser: argparse.ArgumentParser, arms: Sequence[str]) -> None:
    """Add --arm."""
    kinds = "; ".join(f"{name}: {ARMS[name]}" for name in arms)
    parser.add_argument(
        "--arm", choices=arms,
        help=f"what moves the arm; {kinds}; default: simulated, or none with real drives and "
        "in simulated time",
    )  # fmt: skip


def add_drive(parser: argparse.ArgumentParser, drives: Sequence[str]) -> None:
    """Add --drive and --installation."""
    kinds = "; ".join(f"{name}: {DRIVES[name]}" for name in drives)
    parser.add_argument(
        "--drive", choices=drives, default="simulated",
        help=f"what turns the wheels; {kinds}; default: %(default)s",
    )  # fmt: skip
    parser.add_argument(
        "--installation", default="cia402", metavar="NAME",
        help="drives on the bus: cia402, vesc, odrive or the path of a .yaml file; "
        "default: %(default)s",
    )  # fmt: skip


def add_teleop(parser: argparse.ArgumentParser) -> None:
    """Arguments of `omniman teleop`."""
    parser.add_argument("--linear", type=float, default=0.3, help="speed, m/s; %(default)s")
    parser.add_argument("--angular", type=float, default=0.6, help="yaw rate, rad/s; %(default)s")
    parser.add_argument(
        "--stamped", action="store_true",
        help="publish TwistStamped, for a controller with cmd_vel_stamped",
    )  # fmt: skip
    add_namespace(parser, "namespace of the robot")


def add_goal(parser: argparse.ArgumentParser) -> None:
    """Arguments of `omniman goal`."""
    parser.add_argument("x", type=float, help="m, in odom")
    parser.add_argument("y", type=float, help="m, in odom")
    parser.add_argument("heading", type=float, nargs="?", default=0.0, help="degrees; %(default)s")
    parser.add_argument(
        "--relative", action="store_true", help="seen from the robot, where it is now"
    )
    parser.add_argument(
        "--timeout", type=float, default=120.0, help="seconds until it is cancelled; %(default)s"
    )
    add_namespace(parser, "namespace of the robot")


def add_tool(parser: argparse.ArgumentParser) -> None:
    """Arguments of `omniman tool`."""
    for name in ("x", "y", "z"):
        parser.add_argument(name, type=float, help="m, in odom")
    parser.add_argument(
        "--relative", action="store_true",
        help="from where the tool is, x forward and y left as the robot looks",
    )  # fmt: skip
    parser.add_argument(
        "--timeout", type=float, default=300.0, help="seconds until it is cancelled; %(default)s"
    )
    add_namespace(parser, "namespace of the robot")


def add_record(parser: argparse.ArgumentParser) -> None:
    """Arguments of `omniman record`."""
    parser.add_argument(
        "topics", nargs="*", metavar="TOPIC",
        help="record these only, named in the robot's namespace; default: all of the robot",
    )  # fmt: skip
    parser.add_argument(
        "--output", metavar="FOLDER", help="where it goes; default: recording_DATE_TIME"
    )
    parser.add_argument(
        "--duration", type=float, metavar="SECONDS", help="end after so long; default: Ctrl-C ends"
    )
    add_namespace(parser, "namespace of the robot; default: all robots")


def add_plot(parser: argparse.ArgumentParser) -> None:
    """Arguments of `omniman plot`."""
    parser.add_argument("bag", help="folder of a recording of `omniman record` or `ros2 bag`")
    parser.add_argument(
        "--results", default="results", metavar="FOLDER", help="where the pictures go; %(default)s"
    )
    parser.add_argument("--show", action="store_true", help="open the pictures, too")
    add_namespace(parser, "namespace of the robot, where the recording has several")


def add_stop(parser: argparse.ArgumentParser) -> None:
    """Arguments of `omniman stop` and `omniman reset`."""
    add_namespace(parser, "only the nodes in this namespace; default: all that are found")


def add_demo(parser: argparse.ArgumentParser) -> None:
    """Arguments of `omniman demo`."""
    add_robot(parser)
    parser.add_argument(
        "--keep", action="store_true",
        help="stay up after the show, in your own ROS domain, for your teleop; Ctrl-C ends all",
    )  # fmt: skip
    parser.add_argument("--verbose", action="store_true", help="show what the nodes say")
    add_drive(parser, ("simulated", "can"))
    add_arm(parser, ("simulated", "none"))
    parser.add_argument(
        "-p", "--param", action="append", default=[], metavar="NAME:=VALUE",
        help="a parameter, given to every node; may be repeated",
    )  # fmt: skip
    add_results(parser)


def add_bench(parser: argparse.ArgumentParser) -> None:
    """Arguments of `omniman bench`."""
    parser.add_argument(
        "name", nargs="?", default="control",
        choices=["control", "path", "mpc", "can", "arm", "whole_body"],
        help="control: time of a control tick, CPU of the nodes, latency; the default. "
        "path: time of planning, how near to the least time, CPU of the stream. "
        "mpc: CPU and cost of the planner's solver next to IPOPT and fatrop. "
        "can: round trips over a CAN bus of UDP next to a bare echo, CPU, bus load. "
        "arm: setpoints at 125 Hz in the whole running robot next to a bare loop. "
        "whole_body: time of planning tool paths, CPU of their stream, inverse kinematics",
    )  # fmt: skip
    effort = parser.add_mutually_exclusive_group()
    effort.add_argument(
        "--quick", action="store_true", help="a few samples only: does it run at all?"
    )
    effort.add_argument("--full", action="store_true", help="mpc: more steps, scenes and horizons")
    add_robot(parser)
    add_results(parser)
    arm = parser.add_argument_group("of arm only")
    arm.add_argument("--pairs", type=int, metavar="N", help="pairs of blocks; default: 5")
    arm.add_argument("--seconds", type=float, metavar="S", help="length of each block; default: 8")
    arm.add_argument(
        "--priority", type=int, default=50, metavar="N",
        help="of both loops, SCHED_FIFO where it is permitted; 0: none (a busy machine may need "
        "-p ur.read_timeout:=0.2 then); default: %(default)s",
    )  # fmt: skip
    arm.add_argument(
        "-p", "--param", action="append", default=[], metavar="NAME:=VALUE",
        help="a parameter, given to every node; may be repeated",
    )  # fmt: skip


def add_reproduce(parser: argparse.ArgumentParser) -> None:
    """Arguments of `omniman reproduce`."""
    parser.add_argument(
        "name", nargs="?", default="coupling",
        choices=[
            "coupling", "tool_path", "free", "corridor", "moving", "workshop", "scenes", "all"
        ],
        help="coupling: CCTA 2017 Fig. 7, coupling control on and off; the default. "
        "tool_path: platform and arm in step, with the arm's correction and without. "
        "free, corridor, moving: the cases of MPC 2021. workshop: rooms and doors, with a map. "
        "scenes: random ones. all: one after the other, and a page of measured against published",
    )  # fmt: skip
    effort = parser.add_mutually_exclusive_group()
    effort.add_argument("--quick", action="store_true", help="few drives: does it run at all?")
    effort.add_argument("--full", action="store_true", help="more drives")
    parser.add_argument(
        "--seed", type=int, default=0, help="of random wheels, of noisy observations; %(default)s"
    )
    parser.add_argument(
        "--robot", help=f"{ROBOT}; default: omniman for coupling and tool_path, else ig42"
    )
    parser.add_argument(
        "--reuse", action="store_true",
        help="with all: what has its JSON in the folder already is not run again",
    )  # fmt: skip
    add_results(parser)
    scenes = parser.add_argument_group("of scenes only, in all too")
    scenes.add_argument("--count", type=int, help="how many, from seed 0 on; default: 240")
    scenes.add_argument("--seeds", metavar="A:B", help="these seeds, without B; or one")
    scenes.add_argument("--jobs", type=int, help="processes; default: as many as there are CPUs")
    scenes.add_argument(
        "--solve-time", type=float, metavar="SECONDS",
        help="each answer takes so long, not as long as it takes: a run that repeats exactly",
    )  # fmt: skip


def add_identify(parser: argparse.ArgumentParser) -> None:
    """Arguments of `omniman identify`."""
    subjects = parser.add_subparsers(dest="subject", metavar="SUBJECT", required=True)
    for name, (text, add_arguments) in IDENTIFIED.items():
        subject = subjects.add_parser(
            name, help=text, description=text[0].upper() + text[1:] + ".", allow_abbrev=False
        )
        add_arguments(subject)
        subject.add_argument(
            "-p", "--param", action="append", default=[], metavar="NAME:=VALUE",
            help="with --simulate: a parameter, given to every node; may be repeated",
        )  # fmt: skip
        subject.add_argument("--verbose", action="store_true", help="show what the nodes say")
        add_namespace(subject, "namespace of the robot")
        add_results(subject)


def add_identify_odometry(parser: argparse.ArgumentParser) -> None:
    """Arguments of `omniman identify odometry`."""
    parser.add_argument(
        "--area", type=float, default=3.0, metavar="METRES",
        help="side of the free square in whose middle the robot stands; %(default)s",
    )  # fmt: skip
    parser.add_argument("--speed", type=float, default=0.3, help="m/s; %(default)s")
    parser.add_argument(
        "--truth", metavar="TOPIC",
        help="nav_msgs/Odometry with the measured pose of base_link; default: you are asked",
    )  # fmt: skip
    parser.add_argument(
        "--accuracy", type=float, nargs=2, metavar=("MM", "DEGREES"),
        help="standard deviations of a measured pose; 3 0.3 typed, 1 0.1 from a topic",
    )  # fmt: skip
    parser.add_argument("--yes", action="store_true", help="with --truth: begin without asking")
    parser.add_argument(
        "--runs", metavar="FILE", help="drive nothing, fit to runs recorded before"
    )
    parser.add_argument(
        "--simulate", action="store_true",
        help="start a simulated robot for it, with wrong radii and mounting",
    )  # fmt: skip
    parser.add_argument("--robot", help=f"with --simulate: {ROBOT}; default: omniman")


def add_identify_friction(parser: argparse.ArgumentParser) -> None:
    """Arguments of `omniman identify friction`."""
    parser.add_argument(
        "--lifted", action="store_true",
        help="the wheels are off the floor and free: begin without asking",
    )  # fmt: skip
    parser.add_argument(
        "--levels", type=int, default=6, metavar="N",
        help="voltages in each direction; %(default)s",
    )  # fmt: skip
    parser.add_argument(
        "--rounds", type=int, default=2, metavar="N", help="how often each is given; %(default)s"
    )
    parser.add_argument(
        "--precision", type=float, default=0.5, metavar="PERCENT",
        help="of a mean current, where a measurement ends, after 20 s at the latest; %(default)s",
    )  # fmt: skip
    parser.add_argument("--runs", metavar="FILE", help="turn nothing, fit to runs recorded before")
    parser.add_argument(
        "--simulate", action="store_true",
        help="start a simulated robot for it, on blocks, with friction other than configured",
    )  # fmt: skip
    parser.add_argument(
        "--robot",
        help=f"{ROBOT}; default: what the drive is configured as; with --simulate omniman",
    )


IDENTIFIED: dict[str, tuple[str, Callable[[argparse.ArgumentParser], None]]] = {
    "odometry": (
        "calibrate the odometry by drives whose ends are measured", add_identify_odometry
    ),
    "friction": (
        "measure the wheels' friction, with the wheels off the floor", add_identify_friction
    ),
}  # fmt: skip
"""Subject: help, arguments."""


def add_urdf(parser: argparse.ArgumentParser) -> None:
    """Arguments of `omniman urdf`."""
    add_robot(parser)
    parser.add_argument(
        "-p", "--param", action="append", default=[], metavar="NAME:=VALUE",
        help="a parameter of the robot, of its arm or of the mount; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--params-file", metavar="FILE",
        help="a ROS parameter file, such as that of the arm's controller",
    )  # fmt: skip
    parser.add_argument("--output", metavar="FILE", help="where it goes; default: printed")


def add_parameters(parser: argparse.ArgumentParser) -> None:
    """Arguments of `omniman parameters`."""
    parser.add_argument(
        "node", nargs="?", choices=sorted(NODES), help="one node; default: all, by sections"
    )


COMMANDS: dict[str, tuple[str, str, Callable[[argparse.ArgumentParser], None]]] = {
    "up": ("up", "start the nodes, Ctrl-C stops the robot and ends them", add_up),
    "teleop": ("teleop", "drive with the keyboard: hold to drive, release stops", add_teleop),
    "goal": ("goal", "send the robot to a goal among obstacles; Ctrl-C cancels", add_goal),
    "tool": ("tool", "lead the tool straight to a place; Ctrl-C cancels", add_tool),
    "stop": ("stop_reset", "stop every node that moves something, until a reset", add_stop),
    "reset": ("stop_reset", "release stopped nodes; moves nothing by itself", add_stop),
    "record": ("record", "record what the robot says, for ros2 bag and its likes", add_record),
    "plot": ("plot", "draw the standard figures from a recording", add_plot),
    "demo": ("demo", "a simulated robot drives and is measured, in a minute and a half", add_demo),
    "identify": ("identify", "find out by drives what the robot is really like", add_identify),
    "parameters": ("parameters", "list the parameters of the nodes", add_parameters),
    "urdf": ("urdf", "print the robot's description for RViz and MoveIt", add_urdf),
    "reproduce": ("reproduce", "repeat a paper's experiment in simulation", add_reproduce),
    "bench": ("bench", "measure how fast the control is", add_bench),
}
"""Name: module in omniman_ros.cli with `run(args) -> int`, help, arguments."""


def make_parser() -> argparse.ArgumentParser:
    """Make the parser of the whole command line."""
    parser = argparse.ArgumentParser(
        "omniman", description=DESCRIPTION, epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False,
    )  # fmt: skip
    parser.add_argument("--version", action=Version, nargs=0, help="print the version")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, (_, text, add_arguments) in COMMANDS.items():
        add_arguments(
            commands.add_parser(
                name, help=text, description=text[0].upper() + text[1:] + ".", allow_abbrev=False
            )
        )
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `omniman`; returns the exit code."""
    args = make_parser().parse_args(arguments)
    try:
        command = importlib.import_module(f"omniman_ros.cli.{COMMANDS[args.command][0]}")
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("omniman_ros"):
            raise
        print(f"error: no Python module '{error.name}' here.", file=sys.stderr)
        print(
            "On a ROS 2 machine: source /opt/ros/jazzy/setup.bash first. Elsewhere: "
            "pip install 'omniman_ros[ros]', or use `make demo`.",
            file=sys.stderr,
        )
        return 1
    try:
        return int(command.run(args))
    except CommandError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.code
    except OmnimanError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
