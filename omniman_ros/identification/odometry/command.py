"""`omniman identify odometry`: drive, measure the ends, fit, check, and write the parameters.

The parts: `campaign`, `wheel_integration`, `least_squares` and `factor_selection` (mathematics);
`drive_plan`, `measured_pose` and `experiment` (the drives, over the shared `robot_session`);
`record` and `report` (files and tables).
"""

import argparse
import math
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from omniman_ros.console import results
from omniman_ros.console.errors import CommandError
from omniman_ros.console.files import write_atomically
from omniman_ros.console.progress import Progress
from omniman_ros.console.session import Session
from omniman_ros.console.terminal import GREEN, RED, paint, say
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.identification.line_reader import LineReader
from omniman_ros.identification.odometry.campaign import Accuracy
from omniman_ros.identification.odometry.drive_plan import TARGETS, Speeds, max_reach
from omniman_ros.identification.odometry.experiment import OdometryExperiment, expected_duration
from omniman_ros.identification.odometry.factor_selection import identify
from omniman_ros.identification.odometry.measured_pose import PoseSource, TopicPoses, TypedPoses
from omniman_ros.identification.odometry.record import OdometryRecord, load, save
from omniman_ros.identification.odometry.report import (
    calibrated,
    faults,
    judge,
    parameter_file,
    report,
    result,
)
from omniman_ros.identification.robot_session import RobotSession, read_controller
from omniman_ros.identification.simulated_robot import run_with_simulated_robot
from omniman_ros.processes.process_group import redirect_signals
from omniman_ros.processes.robot_setup import RobotSetup, resolve_robot
from omniman_ros.robots import robot_parameters

NAME = "identify_odometry"  #: Stem of the names of the result's files
#: Parameters for a simulation on a busy machine: no real robot is endangered when a process waits
#: for the processor.
LENIENT_TIMEOUTS = (
    "timeouts.wheel_states:=3.0",
    "drive.following_time:=5.0",
    "firmware.watchdog:=0.5",
)
NODES = ("platform_controller", "simulated_drive")  #: Nodes of the simulated robot
TRUTH_TOPIC = "ground_truth/odom"  #: Topic on which the simulated drive publishes the true pose
TYPED_ACCURACY = Accuracy(0.003, math.radians(0.3))  #: Of a tape measure and a mark
TOPIC_ACCURACY = Accuracy(0.001, math.radians(0.1))  #: Accuracy of a motion-capture system
#: Errors of the simulated robot's geometry unless the user sets them: radii and mounting of the
#: wheels.
MISMATCH = {
    "mismatch.radius": (1.012, 0.991, 0.986, 1.008),
    "mismatch.offset_x": (0.004, -0.003, 0.002, -0.005),
    "mismatch.offset_y": (-0.003, -0.004, 0.005, 0.002),
    "mismatch.heading": (0.006, -0.004, 0.008, 0.003),
}


def run(args: argparse.Namespace) -> int:
    """Run `omniman identify odometry` and return the exit code."""
    accuracy = stated_accuracy(args)
    folder = Path(args.results)
    if args.runs is not None:
        record = load(Path(args.runs))
        return conclude(replace(record, accuracy=accuracy or record.accuracy), folder)
    if not args.simulate and (args.param or args.robot is not None):
        raise CommandError("--robot and -p are for --simulate: a running robot has its own", 2)
    drive = drive_simulated_robot if args.simulate else drive_running_robot
    return conclude(drive(args, accuracy), folder)


def stated_accuracy(args: argparse.Namespace) -> Accuracy | None:
    """Return the stated accuracy of poses, or None; a wrong one raises a CommandError."""
    if args.accuracy is None:
        return None
    millimetres, degrees = args.accuracy
    if not (0.0 < millimetres < 1000.0 and 0.0 < degrees < 45.0):
        raise CommandError(f"--accuracy {millimetres:g} {degrees:g}: both must be above 0", 2)
    return Accuracy(1e-3 * millimetres, math.radians(degrees))


def drive_simulated_robot(args: argparse.Namespace, accuracy: Accuracy | None) -> OdometryRecord:
    """Drive a simulated robot that this command starts itself.

    Its geometry differs from its configuration.
    """
    name = args.robot or "omniman"
    set_by_user = {text.partition(":=")[0] for text in args.param}
    mismatch = [] if set_by_user & MISMATCH.keys() else mismatch_parameters(resolve_robot(name))
    params = [*LENIENT_TIMEOUTS, *mismatch, *args.param]
    errors = mismatch or [text for text in args.param if text.startswith("mismatch.")]
    return run_with_simulated_robot(
        RobotSetup(robot=name, only=NODES, namespace=args.namespace, params=params),
        [
            f"omniman identify odometry: robot '{name}' in simulation; its errors, which it does "
            "not know:",
            *(f"  {text}" for text in errors),
        ],
        args.verbose,
        lambda poll: measure(args, args.truth or TRUTH_TOPIC, accuracy, poll, None),
    )


def mismatch_parameters(robot: str) -> list[str]:
    """Return assignments NAME:=VALUE by which the simulated wheels differ from the configured."""
    n = build(Platform, robot_parameters(robot)).wheel_count
    return [
        f"{name}:=[{', '.join(str(values[i % len(values)]) for i in range(n))}]"
        for name, values in MISMATCH.items()
    ]


def drive_running_robot(args: argparse.Namespace, accuracy: Accuracy | None) -> OdometryRecord:
    """Drive the robot that is already running."""
    signals: list[int] = []

    def poll() -> None:
        if signals:
            raise KeyboardInterrupt

    is_asked = args.truth is None or not args.yes
    with redirect_signals(signals.append):
        keyboard = sys.stdin.fileno() if is_asked else None
        return measure(args, args.truth, accuracy, poll, keyboard)


def measure(
    args: argparse.Namespace,
    truth: str | None,
    accuracy: Accuracy | None,
    poll: Callable[[], None],
    keyboard: int | None,
) -> OdometryRecord:
    """Drive all runs and the check; save the runs, also if the experiment ends early.

    Args:
        truth: Topic of a measured pose, or None to ask the user.
        accuracy: Accuracy of the poses; None means the usual one of their source.
    """
    progress = Progress()
    with ExitStack() as stack:
        session = stack.enter_context(Session("omniman_identify", args.namespace))
        progress.begin("starting")
        controller = read_controller(session, args.namespace, poll)
        robot = RobotSession(session, controller, truth, progress, poll)
        robot.connect()
        progress.end("the robot is running")
        lines = None if keyboard is None else LineReader(keyboard)
        parameters = controller.parameters
        speeds = Speeds.within(parameters.limits, args.speed)
        reach = max_reach(args.area, parameters.robot.body)
        if lines is not None:
            explain(args.area, speeds, reach, truth)
            lines.next(robot.wait)
        if truth is not None:
            poses: PoseSource = TopicPoses(truth, robot.pose_at_rest)
        else:
            assert lines is not None
            poses = TypedPoses(lines, robot.wait)
        usual = TYPED_ACCURACY if truth is None else TOPIC_ACCURACY
        record = OdometryRecord(parameters.robot.wheels, parameters.odometry, accuracy or usual)
        experiment = OdometryExperiment(robot, progress, poses, speeds, reach, record)
        stack.callback(lambda: keep(experiment.record, Path(args.results)))
        stack.callback(robot.halt)
        experiment.drive_all(TARGETS)
        return experiment.record


def explain(area: float, speeds: Speeds, reach: float, truth: str | None) -> None:
    """Explain the experiment and its preparation to the user."""
    minutes = expected_duration(len(TARGETS), reach, speeds) / 60.0
    say(f"""
The robot will drive {len(TARGETS)} runs and a check path, {minutes:.0f} minutes in all, at up to
{speeds.linear:g} m/s and {speeds.angular:.2g} rad/s. It stays within a square of {area:g} m by
{area:g} m around its current position, with sides along the robot's: keep that free. Be ready to
stop it: Ctrl-C here, `omniman stop` in another terminal, or the emergency stop. Do not push it
between the runs.""")
    if truth is None:
        say("""
Mark the floor under base_link, and a line ahead: this is the origin and the x axis, y is left.
After each run you are asked for x and y of base_link [m] and the heading [degrees, left is +].""")
    else:
        say(f"\nPoses of base_link come from '{truth}'.")
    say("Enter begins, Ctrl-C ends.")


def keep(record: OdometryRecord, folder: Path) -> None:
    """Save the runs that were driven, if there are any."""
    if record.runs:
        path = folder / f"{NAME}_runs.json"
        save(record, path)
        say(f"Recorded runs: {path} (fit again: omniman identify odometry --runs {path})")


def conclude(record: OdometryRecord, folder: Path) -> int:
    """Fit, report, write the files, and return the exit code; a failure raises an InputError."""
    calibration = identify(record.campaign, record.odometry)
    say("\n".join(report(record, calibration)))
    found_faults = faults(record, judge(record, calibration))
    if found_faults:
        say(paint("Not calibrated:", RED, sys.stdout) + " " + "; ".join(found_faults))
    else:
        path = folder / "odometry.yaml"
        write_atomically(path, parameter_file(calibration))
        say(paint("Calibrated.", GREEN, sys.stdout) + f" {path} is a ROS parameter file; use it:")
        say(f"  omniman up --params-file {path}")
        say(f"  ros2 run omniman_ros platform_controller --ros-args --params-file {path}")
        say("or put its values into the robot's own file: " + ", ".join(calibrated(calibration)))
    results.publish(NAME, result(record, calibration), folder)
    return 1 if found_faults else 0
