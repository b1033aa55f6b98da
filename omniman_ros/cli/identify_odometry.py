"""`omniman identify odometry`: drive, measure where it ends, fit, check, write the parameters."""

import argparse
import math
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from omniman_ros.cli import results
from omniman_ros.cli.children import Children, signals_to
from omniman_ros.cli.demo import refuse_other_robots
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.figures import Triple
from omniman_ros.cli.fleet import Setup, resolved, tasks
from omniman_ros.cli.identify_plan import (
    TARGETS,
    Motion,
    Speeds,
    Target,
    check_curve,
    reach_in,
    straight,
    way_to,
)
from omniman_ros.cli.identify_pose import Lines, PoseSource, TopicPoses, TypedPoses, floor_pose
from omniman_ros.cli.identify_record import Check, Record, load, save, thinned, write_whole
from omniman_ros.cli.identify_report import (
    calibrated,
    faults,
    judge,
    parameter_file,
    report,
    result,
)
from omniman_ros.cli.identify_robot import Controller, Robot, read_controller
from omniman_ros.cli.isolation import isolate
from omniman_ros.cli.output import NodeLog
from omniman_ros.cli.progress import Progress
from omniman_ros.cli.session import Session
from omniman_ros.cli.terminal import GREEN, RED, paint, say
from omniman_ros.core.calibration import Accuracy, Pose, Run, forward_matrix, integrate
from omniman_ros.core.identification import identify
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot as RobotData
from omniman_ros.robots import load_robot

NAME = "identify_odometry"
PATIENT = (
    "timeouts.wheel_states:=3.0", "drive.following_time:=5.0", "firmware.watchdog:=0.5",
)  # fmt: skip
"""A simulation on a busy machine: nothing real is at stake when a process waits for its turn."""
NODES = ("platform_controller", "simulated_drive")
TRUTH = "ground_truth/odom"
"""Where the simulated drive tells the true pose."""
TYPED = Accuracy(0.003, math.radians(0.3))
"""Of a tape measure and a mark on the floor."""
BY_TOPIC = Accuracy(0.001, math.radians(0.1))
"""Of a motion-capture system."""
MOST_SHORT = 3
"""Runs that may be cut short: by a controller or a machine that was held up."""
WRONG = {
    "mismatch.radius": (1.012, 0.991, 0.986, 1.008),
    "mismatch.offset_x": (0.004, -0.003, 0.002, -0.005),
    "mismatch.offset_y": (-0.003, -0.004, 0.005, 0.002),
    "mismatch.heading": (0.006, -0.004, 0.008, 0.003),
}
"""What is wrong with the simulated robot unless the user says what: radii, and how its wheels
are mounted."""


def run(args: argparse.Namespace) -> int:
    """Run `omniman identify odometry`; returns the exit code."""
    accuracy = stated_accuracy(args)
    folder = Path(args.results)
    if args.runs is not None:
        record = load(Path(args.runs))
        return conclude(replace(record, accuracy=accuracy or record.accuracy), folder)
    if not args.simulate and (args.param or args.robot is not None):
        raise CommandError("--robot and -p are for --simulate: a running robot has its own", 2)
    drive = simulate if args.simulate else drive_running
    return conclude(drive(args, accuracy), folder)


def stated_accuracy(args: argparse.Namespace) -> Accuracy | None:
    """What the user says of the measured poses, or None."""
    if args.accuracy is None:
        return None
    millimetres, degrees = args.accuracy
    if not (0.0 < millimetres < 1000.0 and 0.0 < degrees < 45.0):
        raise CommandError(f"--accuracy {millimetres:g} {degrees:g}: both must be above 0", 2)
    return Accuracy(1e-3 * millimetres, math.radians(degrees))


def simulate(args: argparse.Namespace, accuracy: Accuracy | None) -> Record:
    """Drive a simulated robot of this command's own, whose geometry is not as configured."""
    name = args.robot or "omniman"
    given = [text.partition(":=")[0] for text in args.param]
    wrong = () if set(given) & WRONG.keys() else wrong_geometry(resolved(name))
    params = [*PATIENT, *wrong, *args.param]
    chosen = tasks(Setup(robot=name, only=NODES, namespace=args.namespace, params=params))
    private = "ROS_DOMAIN_ID" not in os.environ
    isolate(os.environ)
    log = NodeLog(args.verbose)
    children = Children(chosen, on_line=log)
    say(f"omniman identify odometry: robot '{name}' in simulation; wrong with it, unknown to it:")
    for text in wrong or [text for text in args.param if text.startswith("mismatch.")]:
        say(f"  {text}")
    with signals_to(children.interrupt):
        try:
            if not private:
                refuse_other_robots(children.check)
            with children:
                record = perform(args, args.truth or TRUTH, accuracy, children.check, None)
                children.stop()
        except CommandError:
            log.show()
            raise
    return record


def wrong_geometry(robot: str) -> list[str]:
    """Parameters that make the simulated wheels other than configured."""
    n = build(RobotData, load_robot(robot)).wheel_count
    return [
        f"{name}:=[{', '.join(str(values[i % len(values)]) for i in range(n))}]"
        for name, values in WRONG.items()
    ]


def drive_running(args: argparse.Namespace, accuracy: Accuracy | None) -> Record:
    """Drive the robot that is there."""
    signals: list[int] = []

    def poll() -> None:
        if signals:
            raise KeyboardInterrupt

    asked = args.truth is None or not args.yes
    with signals_to(signals.append):
        return perform(args, args.truth, accuracy, poll, sys.stdin.fileno() if asked else None)


def perform(
    args: argparse.Namespace, truth: str | None, accuracy: Accuracy | None,
    poll: Callable[[], None], keyboard: int | None,
) -> Record:  # fmt: skip
    """Drive all runs and the check; what was driven is saved, also when it ends early.

    Args:
        args: Of the command line.
        truth: Topic that measures, or None to ask the user.
        accuracy: Of the poses, or None for what is usual.
        poll: Called many times a second; raises to end early.
        keyboard: File descriptor of what the user types; None if nobody is asked.
    """
    progress = Progress()
    with ExitStack() as stack:
        session = stack.enter_context(Session("omniman_identify", args.namespace))
        progress.begin("starting")
        controller = read_controller(session, args.namespace, poll)
        robot = Robot(session, controller, truth, progress, poll)
        robot.meet()
        progress.end("the robot is there")
        lines = None if keyboard is None else Lines(keyboard)
        parameters = controller.parameters
        speeds = Speeds.within(parameters.limits, args.speed)
        reach = reach_in(args.area, parameters.robot.body)
        if lines is not None:
            explain(args.area, speeds, reach, truth)
            lines.next(robot.wait)
        if truth is not None:
            source: PoseSource = TopicPoses(truth, robot.pose_at_rest)
        else:
            assert lines is not None
            source = TypedPoses(lines, robot.wait)
        usual = TYPED if truth is None else BY_TOPIC
        record = Record(parameters.robot.wheels, parameters.odometry, accuracy or usual)
        drives = Drives(robot, progress, source, controller, speeds, reach, record)
        stack.callback(keep, drives, Path(args.results))
        stack.callback(robot.halt)
        drives.drive_all(TARGETS)
        return drives.record


def explain(area: float, speeds: Speeds, reach: float, truth: str | None) -> None:
    """Tell the user what will happen, and what to do."""
    legs = [Motion(straight((2.0 * reach, 0.0, 0.0)), (0.0, 0.0, 0.0), speeds).duration,
            Motion(straight((0.0, 0.0, math.pi)), (0.0, 0.0, 0.0), speeds).duration]  # fmt: skip
    minutes = (len(TARGETS) + 1) * sum(legs) / 60.0
    say(f"""
The robot will drive {len(TARGETS)} runs and a check path, {minutes:.0f} minutes in all, at up to
{speeds.linear:g} m/s and {speeds.angular:.2g} rad/s. It stays within a square of {area:g} m by
{area:g} m around where it stands now, the sides along the robot's: keep that free. Be ready to
stop it: Ctrl-C here, `omniman stop` in another terminal, or the emergency stop. Do not push it
between the runs.""")
    if truth is None:
        say("""
Mark the floor under base_link, and a line ahead: this is the origin and the x axis, y is left.
After each run you are asked for x and y of base_link [m] and the heading [degrees, left is +].""")
    else:
        say(f"\nPoses of base_link come from '{truth}'.")
    say("Enter begins, Ctrl-C ends.")


class Drives:
    """Drives runs and collects them.

    Attributes:
        record: What there is so far.
    """

    def __init__(
        self, robot: Robot, progress: Progress, source: PoseSource, controller: Controller,
        speeds: Speeds, reach: float, record: Record,
    ) -> None:  # fmt: skip
        self._robot = robot
        self._progress = progress
        self._source = source
        self._forward = forward_matrix(
            controller.parameters.robot.wheels, controller.parameters.odometry
        )
        self._speeds = speeds
        self._reach = reach
        self._short = 0
        self.record = record

    def drive_all(self, targets: Sequence[Target]) -> None:
        """Drive all runs, then the check."""
        here = self._source.start()
        self.record = replace(self.record, poses=(here,))
        heading = 0.0
        for number, target in enumerate(targets, 1):
            here = self._run(f"{number} {target.corner}", here, heading, target)
            heading += target.turn
        self._check(here, heading)

    def _run(self, name: str, here: Triple, heading: float, target: Target) -> Triple:
        """Drive a run; returns where it ended, measured or, if not, by odometry."""
        self._progress.begin(name + " ")
        self._robot.record()
        way = way_to(here, heading, target.corner, self._reach)
        whole = self._robot.drive(name, self._motion(way), (0.0, 0.6))
        turn = (0.0, 0.0, target.turn)
        if not whole or not self._robot.drive(name, self._motion(turn), (0.6, 1.0)):
            self._cut_short(name)
        times, positions = self._wheels()
        end = self._expected(positions, here)
        measured = self._measured(name, end)
        self.record = self.record.with_run(Run(name, thinned(times, positions)[1]), measured)
        return measured or end

    def _check(self, here: Triple, heading: float) -> None:
        """Drive the path that nothing is fitted to, after a last correction of the pose."""
        name = "check"
        if self.record.poses[-1] is None:
            say("  no check: the pose before it was not measured")
            return
        self._progress.begin(name)
        self._robot.record()
        way = way_to(here, heading, "middle", self._reach)
        whole = self._robot.drive(name, self._motion(way), (0.0, 0.2))
        curve = Motion(check_curve(self._reach), self._robot.pose, self._speeds)
        if not whole or not self._robot.drive(name, curve, (0.2, 1.0)):
            self._cut_short(name)
        times, positions = self._wheels()
        end = self._measured(name, self._expected(positions, here))
        truth = [
            (row[0], *floor_pose(self._source.origin, row[1:]))
            for row in self._robot.recording.truth
            if isinstance(self._source, TopicPoses) and self._source.origin is not None
        ]
        times, positions = thinned(times, positions)
        check = Check(times, positions, here, end, np.array(truth).reshape(-1, 4))
        self.record = replace(self.record, check=check)

    def _cut_short(self, name: str) -> None:
        """Count a run that was cancelled on its way; what the wheels did is good all the same.

        Raises:
            CommandError: There were too many of them.
        """
        self._short += 1
        if self._short > MOST_SHORT:
            raise CommandError(
                f"run '{name}' and {MOST_SHORT} before it were cancelled on the way"
            )

    def _motion(self, way: Triple) -> Motion:
        return Motion(straight(way), self._robot.pose, self._speeds)

    def _wheels(self) -> tuple[np.ndarray, np.ndarray]:
        recording = self._robot.recording
        return np.array(recording.times), np.array(recording.positions)

    def _expected(self, positions: np.ndarray, here: Triple) -> Triple:
        x, y, theta = integrate(self._forward, positions, here)[-1].tolist()
        return x, y, theta

    def _measured(self, name: str, expected: Triple) -> Pose | None:
        self._progress.end("at rest")
        pose = self._source.measure(name, expected)
        if pose is None:
            say("  skipped")
        return pose


def keep(drives: Drives, folder: Path) -> None:
    """Save what was driven, if anything."""
    if drives.record.runs:
        path = folder / f"{NAME}_runs.json"
        save(drives.record, path)
        say(f"Recorded runs: {path} (fit again: omniman identify odometry --runs {path})")


def conclude(record: Record, folder: Path) -> int:
    """Fit, tell, write the files; returns the exit code."""
    calibration = identify(record.campaign, record.odometry)
    say("\n".join(report(record, calibration)))
    wrong = faults(record, judge(record, calibration))
    if wrong:
        say(paint("Not calibrated:", RED, sys.stdout) + " " + "; ".join(wrong))
    else:
        path = folder / "odometry.yaml"
        write_whole(path, parameter_file(calibration))
        say(paint("Calibrated.", GREEN, sys.stdout) + f" {path} is a ROS parameter file; use it:")
        say(f"  omniman up --params-file {path}")
        say(f"  ros2 run omniman_ros platform_controller --ros-args --params-file {path}")
        say("or put its values into the robot's own file: " + ", ".join(calibrated(calibration)))
    results.publish(NAME, result(record, calibration), folder)
    return 1 if wrong else 0
