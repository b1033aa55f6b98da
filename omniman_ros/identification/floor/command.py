"""`omniman identify floor`: drive on the floor, fit masses, friction and gear, check, and write.

The parts: `windows`, `regressor`, `solution`, `motor_fit`, `floor_fit` and `feed_forward`
(mathematics); `excitation` (the drives, over the shared `robot_session`); `floor_drive`, `record`
and `report` (files and tables).
"""

import argparse
import math
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from omniman_ros.console import results
from omniman_ros.console.errors import CommandError
from omniman_ros.console.files import write_atomically
from omniman_ros.console.progress import Progress
from omniman_ros.console.session import Session
from omniman_ros.console.terminal import GREEN, RED, paint, say
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.identification.floor.excitation import (
    MIN_DURATION,
    Excitation,
    choose_excitation,
    random_excitation,
)
from omniman_ros.identification.floor.floor_drive import FloorDrive
from omniman_ros.identification.floor.floor_fit import identify_floor
from omniman_ros.identification.floor.record import FloorRecord, load, save
from omniman_ros.identification.floor.report import (
    faults,
    parameter_file,
    parameters,
    report,
    residuals,
    result,
)
from omniman_ros.identification.line_reader import LineReader
from omniman_ros.identification.odometry.drive_plan import MARGIN, max_reach
from omniman_ros.identification.robot_session import Recording, RobotSession, read_controller
from omniman_ros.identification.simulated_robot import run_with_simulated_robot
from omniman_ros.processes.process_group import redirect_signals
from omniman_ros.processes.robot_setup import RobotSetup, resolve_robot
from omniman_ros.robots import robot_parameters

NAME = "identify_floor"  #: Stem of the names of the result's files
NODES = ("platform_controller", "simulated_drive")  #: Nodes of the simulated robot
#: Parameters for a simulation on a busy machine: no real robot is endangered when a process waits
#: for the processor.
LENIENT_TIMEOUTS = (
    "timeouts.wheel_states:=3.0",
    "drive.following_time:=5.0",
    "firmware.watchdog:=0.5",
)
MAX_DURATION = 600.0  #: Longest drive that the user may choose [s]
CHECK_DURATION = 20.0  #: Duration of the drive that nothing is fitted to [s]
CHECK_SEED = 1000  #: Seed of that drive
FACTORS = {
    "body.mass": 1.15,
    "body.inertia": 0.85,
    "motor.gear_efficiency": 0.9,
    "friction.viscous": 1.2,
    "friction.coulomb": 0.85,
    "friction.roller": 1.2,
}  #: Ratios of the simulated robot's parameters to the configured ones, unless the user sets them
#: Differences of the simulated robot's centre of mass from the configured one [m]
OFFSETS = {"body.com_x": -0.04, "body.com_y": 0.03}


def run(args: argparse.Namespace) -> int:
    """Run `omniman identify floor` and return the exit code."""
    folder = Path(args.results)
    if args.runs is not None:
        return conclude(load(Path(args.runs)), folder)
    if not args.simulate and (args.param or args.robot is not None):
        raise CommandError("--robot and -p are for --simulate: a running robot has its own", 2)
    if not MIN_DURATION <= args.duration <= MAX_DURATION:
        limits = f"{MIN_DURATION:g} to {MAX_DURATION:g}"
        raise CommandError(f"--duration {args.duration:g} is not within {limits} s", 2)
    drive = drive_simulated_robot if args.simulate else drive_running_robot
    return conclude(drive(args), folder)


def other_parameters(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters that differ from configured ones in all that is identified."""
    other: dict[str, Any] = {}
    for name, factor in FACTORS.items():
        value = values[name]
        other[name] = (
            [factor * item for item in value] if isinstance(value, list) else factor * value
        )
    for name, offset in OFFSETS.items():
        other[name] = values.get(name, 0.0) + offset
    return other


def drive_simulated_robot(args: argparse.Namespace) -> FloorRecord:
    """Drive a simulated robot that this command starts itself.

    Its masses, friction and gear differ from its configuration.
    """
    name = resolve_robot(args.robot or "omniman")
    values = robot_parameters(name)
    other = other_parameters(values)
    lines = ["/**/simulated_drive:", "  ros__parameters:"]
    lines += [f"    {key}: {value}" for key, value in other.items()]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "simulated_robot.yaml"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        record = run_with_simulated_robot(
            RobotSetup(
                robot=name,
                only=NODES,
                namespace=args.namespace,
                params=[*LENIENT_TIMEOUTS, *args.param],
                params_file=str(path),
            ),
            [
                f"omniman identify floor: robot '{args.robot or 'omniman'}' in simulation; it "
                "differs from its configuration, which the fit does not know:",
                *lines[2:],
            ],
            args.verbose,
            lambda poll: measure(args, poll, None),
        )
    return replace(record, truth=build(Platform, {**values, **other}))


def drive_running_robot(args: argparse.Namespace) -> FloorRecord:
    """Drive the robot that is already running."""
    signals: list[int] = []

    def poll() -> None:
        if signals:
            raise KeyboardInterrupt

    with redirect_signals(signals.append):
        return measure(args, poll, None if args.yes else sys.stdin.fileno())


def measure(
    args: argparse.Namespace, poll: Callable[[], None], keyboard: int | None
) -> FloorRecord:
    """Drive the robot and the check; save the drives, also if the experiment ends early."""
    progress = Progress()
    with ExitStack() as stack:
        session = stack.enter_context(Session("omniman_identify", args.namespace))
        progress.begin("starting")
        controller = read_controller(session, args.namespace, poll)
        session_robot = RobotSession(
            session, controller, None, progress, poll, with_electrical=True
        )
        session_robot.connect()
        progress.end("the robot is running")
        configured = controller.parameters
        robot = configured.odometry.calibrated(configured.robot)
        reach = max_reach(args.area, robot.body)
        limits = configured.limits
        main = choose_excitation(robot, limits, reach, args.duration)
        check = random_excitation(robot, limits, reach, CHECK_DURATION, CHECK_SEED)
        if keyboard is not None:
            explain(args.area, main)
            LineReader(keyboard).next(session_robot.wait)
        record = FloorRecord(robot)
        stack.callback(lambda: keep(record, Path(args.results)))
        stack.callback(session_robot.halt)
        home = session_robot.pose

        def driven(name: str, motion: Excitation) -> FloorDrive:
            progress.begin(name)
            session_robot.start_recording()
            allowed = (1.0 + MARGIN) * reach
            if not session_robot.drive(name, motion.started_at(home), reach=allowed):
                raise CommandError(f"'{name}' was cancelled on its way")
            progress.end("at rest")
            return floor_drive(session_robot.recording)

        record = replace(record, drive=driven("drive", main))
        record = replace(record, check=driven("check", check))
        return record


def floor_drive(recording: Recording) -> FloorDrive:
    """Return recorded topics as a drive; an InputError says that they are none."""
    times, positions = np.array(recording.times), np.array(recording.positions)
    keep_states = _increasing(times)
    stamps = np.array([row[0] for row in recording.electrical])
    if len(stamps) < 2:
        raise InputError("wheel_electrical was not received during the drive")
    kept = _increasing(stamps)
    voltages, currents = (np.array([row[k] for row in recording.electrical]) for k in (1, 2))
    return FloorDrive(
        times[keep_states], positions[keep_states], stamps[kept], currents[kept], voltages[kept]
    )


def _increasing(times: np.ndarray[Any, Any]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return flags (k,) of the times that are above all before them."""
    highest = np.maximum.accumulate(times)
    return np.concatenate([[True], times[1:] > highest[:-1]])


def explain(area: float, motion: Excitation) -> None:
    """Explain the experiment and its preparation to the user."""
    poses, velocities, _ = motion.track(np.arange(0.0, motion.duration, 0.05))
    speed = np.hypot(*velocities[:, :2].T).max()
    turn = math.degrees(np.abs(poses[:, 2]).max())
    say(f"""
The robot will drive to and fro and turn for {motion.duration:.0f} s, then {CHECK_DURATION:.0f} s
for a check, at up to {speed:.2f} m/s and turned by up to {turn:.0f} degrees. It stays within a
square of {area:g} m by {area:g} m around its current position: keep that free and level. Keep the
arm still, with its tool and load, in the posture of everyday work; what the arm overhangs is not
part of the square. Be ready to stop the robot: Ctrl-C here, `omniman stop` in another terminal, or
the emergency stop. Enter begins, Ctrl-C ends.""")


def keep(record: FloorRecord, folder: Path) -> None:
    """Save the drives, if there are any."""
    if record.drive is not None:
        path = folder / f"{NAME}_runs.json"
        save(record, path)
        say(f"Recorded drives: {path} (fit again: omniman identify floor --runs {path})")


def conclude(record: FloorRecord, folder: Path) -> int:
    """Fit, report, write the files, and return the exit code; no drive raises an InputError."""
    if record.drive is None:
        raise InputError("no drive was recorded")
    fit = identify_floor(record.drive, record.robot)
    say("\n".join(report(record, fit)))
    found_faults = faults(residuals(record, fit))
    if found_faults:
        say(paint("Not identified:", RED, sys.stdout) + " " + "; ".join(found_faults))
    else:
        path = folder / "floor.yaml"
        write_atomically(path, parameter_file(fit))
        say(paint("Identified.", GREEN, sys.stdout) + f" {path} is a ROS parameter file; use it:")
        say(f"  omniman up --params-file {path}")
        say("or put its values into the robot's own file: " + ", ".join(parameters(fit)))
    results.publish(NAME, result(record, fit), folder)
    return 1 if found_faults else 0
