"""`omniman identify friction`: drive lifted wheels at constant voltages, and fit their friction.

The parts: `robust_statistics` and `friction_fit` (mathematics of MPC 2021, (22) to (24));
`voltage_plan`, `level_samples`, `feedback_monitor`, `experiment` (the experiment without ROS) and
`drive_session` (over ROS); `record`, `report`, `figure` (files and tables).
"""

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from omniman_ros.console import results
from omniman_ros.console.errors import CommandError
from omniman_ros.console.files import write_atomically
from omniman_ros.console.progress import Progress
from omniman_ros.console.session import Session
from omniman_ros.console.terminal import GREEN, paint, say
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.identification.friction.drive_session import DriveNode, DriveSession
from omniman_ros.identification.friction.friction_fit import WheelFriction, identify_friction
from omniman_ros.identification.friction.record import FrictionRecord, Truth, load, save
from omniman_ros.identification.friction.report import calibrated, parameter_file, report, result
from omniman_ros.identification.friction.voltage_plan import VoltagePlan, make_plan
from omniman_ros.identification.line_reader import EndOfInputError, LineReader
from omniman_ros.identification.simulated_robot import run_with_simulated_robot
from omniman_ros.processes.process_group import redirect_signals
from omniman_ros.processes.robot_setup import RobotSetup, resolve_robot
from omniman_ros.robots import robot_parameters

NAME = "identify_friction"  #: Stem of the names of the result's files
NODES = ("simulated_drive",)  #: Nodes of the simulated robot
#: Parameters for a simulation on a busy machine: no real robot is endangered when a process waits
#: for the processor.
LENIENT_TIMEOUTS = ("firmware.watchdog:=0.5", "command_timeout:=0.5")
FEEDBACK_TIMEOUT = 0.3  #: Time without feedback after which the experiment ends [s]
SIMULATED_FEEDBACK_TIMEOUT = 3.0  #: The same in simulation: processes wait
#: Ratio of each simulated wheel's friction to the configured one, unless the user sets it
SIMULATED_FRICTION = (1.25, 0.85, 1.1, 0.7)
#: Ratio of each simulated motor's constant to the configured one, unless the user sets it
SIMULATED_TORQUE_CONSTANT = (1.01, 0.99)
SIMULATED_NOISE = 0.004  #: Noise of the simulated currents over the largest current
YES = ("yes", "lifted")  #: Answers that confirm that the wheels are off the floor


def run(args: argparse.Namespace) -> int:
    """Run `omniman identify friction` and return the exit code."""
    folder = Path(args.results)
    if args.runs is not None:
        record = load(Path(args.runs))
        if args.robot is not None:
            record = replace(record, robot=build(Platform, robot_parameters(args.robot)))
        return conclude(record, folder)
    if not args.simulate and args.param:
        raise CommandError("-p is for --simulate: a running robot has its own parameters", 2)
    check_options(args)
    return conclude(
        measure_simulated_drive(args) if args.simulate else measure_running_drive(args), folder
    )


def check_options(args: argparse.Namespace) -> None:
    """Raise a CommandError where an option is out of its range."""
    for name, low, high in (("levels", 3, 50), ("rounds", 1, 50), ("precision", 0.01, 20.0)):
        value = getattr(args, name)
        if not (math.isfinite(value) and low <= value <= high):
            raise CommandError(f"--{name} {value:g} is not within {low:g} to {high:g}", 2)


# ---- in simulation -----------------------------------------------------------------------------


def mismatch_parameters(robot: Platform) -> list[str]:
    """Return assignments NAME:=VALUE by which the simulated wheels and sensors differ."""
    n = robot.wheel_count

    def per_wheel(values: Sequence[float]) -> str:
        return f"[{', '.join(str(values[k % len(values)]) for k in range(n))}]"

    return [
        f"mismatch.friction:={per_wheel(SIMULATED_FRICTION)}",
        f"mismatch.torque_constant:={per_wheel(SIMULATED_TORQUE_CONSTANT)}",
        f"faults.current_noise:={SIMULATED_NOISE * robot.motor.max_current:.4g}",
    ]


def measure_simulated_drive(args: argparse.Namespace) -> FrictionRecord:
    """Measure a simulated drive that this command starts itself."""
    robot = resolve_robot(args.robot or "omniman")
    set_by_user = {text.partition(":=")[0] for text in args.param}
    mismatch = [
        text
        for text in mismatch_parameters(build(Platform, robot_parameters(robot)))
        if text.partition(":=")[0] not in set_by_user
    ]
    params = [*LENIENT_TIMEOUTS, "plant.lifted:=true", *mismatch, *args.param]
    return run_with_simulated_robot(
        RobotSetup(robot=robot, only=NODES, namespace=args.namespace, params=params),
        [
            f"omniman identify friction: robot '{args.robot or 'omniman'}' in simulation, on "
            "blocks;",
            "it differs from its configuration, which the fit does not know:",
            *(f"  {text}" for text in [*mismatch, *args.param]),
        ],
        args.verbose,
        lambda poll: measure(args, poll, None, is_simulated=True),
    )


def true_friction(drive: DriveNode, robot: Platform) -> Truth:
    """Return the friction that a simulated drive has."""
    factors = list(drive.values.get("mismatch.friction", [1.0]))
    factors = factors if len(factors) > 1 else factors * robot.wheel_count
    friction = robot.friction
    return Truth(
        tuple(a * f for a, f in zip(friction.viscous, factors, strict=True)),
        tuple(b * f for b, f in zip(friction.coulomb, factors, strict=True)),
    )


# ---- on a running drive ------------------------------------------------------------------------


def measure_running_drive(args: argparse.Namespace) -> FrictionRecord:
    """Measure the drive that is already running."""
    signals: list[int] = []

    def poll() -> None:
        if signals:
            raise KeyboardInterrupt

    with redirect_signals(signals.append):
        keyboard = None if args.lifted else sys.stdin.fileno()
        return measure(args, poll, keyboard, is_simulated=False)


def configured_robot(args: argparse.Namespace, drive: DriveNode, is_simulated: bool) -> Platform:
    """Return the robot that the user or the drive describes."""
    if args.robot is not None and not is_simulated:
        return build(Platform, robot_parameters(args.robot))
    try:
        return build(Platform, drive.values)
    except ParameterError as error:
        raise CommandError(
            f"{drive.name} does not report the robot's data ({error}): give --robot"
        ) from error


def measure(
    args: argparse.Namespace, poll: Callable[[], None], keyboard: int | None, is_simulated: bool
) -> FrictionRecord:
    """Drive the wheels and measure; save the runs, also if the experiment ends early."""
    progress = Progress()
    with ExitStack() as stack:
        session = stack.enter_context(Session("omniman_identify", args.namespace))
        progress.begin("looking around")
        drives = DriveSession(session, progress, poll)
        drive = drives.find_drive(("mismatch.friction",) if is_simulated else ())
        robot = configured_robot(args, drive, is_simulated)
        timeout = SIMULATED_FEEDBACK_TIMEOUT if is_simulated else FEEDBACK_TIMEOUT
        plan = make_plan(robot, args.levels, args.rounds, 1e-2 * args.precision, timeout)
        drives.connect(robot)
        progress.end(f"{drive.name} is running, nobody else commands it")
        if not is_simulated:
            explain(plan, robot)
        if keyboard is not None:
            confirm(LineReader(keyboard), drives.wait)
        record = FrictionRecord(robot, truth=true_friction(drive, robot) if is_simulated else None)

        def measured() -> FrictionRecord:
            runs = drives.experiment.runs if drives.experiment is not None else []
            return replace(record, runs=tuple(runs))

        stack.callback(lambda: keep(measured(), Path(args.results)))
        drives.run(plan)
        return measured()


def explain(plan: VoltagePlan, robot: Platform) -> None:
    """Explain the experiment and its preparation to the user."""
    top = max(plan.levels)
    speed = top / (robot.motor.gear_ratio * robot.motor.torque_constant)
    low = (len(plan.levels) + 1) * (plan.min_measurement + 1.5) / 60.0
    high = plan.longest_time / 60.0
    say(f"""
LIFT THE ROBOT: all wheels must be off the floor and free to turn, and the robot safe on blocks.
They will turn for {low:.0f} to {high:.0f} minutes, in both directions, at up to {top:.1f} V
and {speed:.1f} rad/s: keep hands, hair and cables away. To stop: Ctrl-C here, `omniman stop` in
another terminal, or the emergency stop.""")


def confirm(lines: LineReader, wait: Callable[[], None]) -> None:
    """Ask until the user confirms that the wheels are off the floor."""
    while True:
        say("Are all wheels off the floor? Type yes; Ctrl-C ends.")
        try:
            answer = lines.next(wait)
        except EndOfInputError as error:
            raise CommandError(
                "nobody confirms that the wheels are off the floor: --lifted confirms it"
            ) from error
        if answer.strip().lower() in YES:
            return


# ---- the result --------------------------------------------------------------------------------


def keep(record: FrictionRecord, folder: Path) -> None:
    """Save the runs that were measured, if there are any."""
    if record.runs:
        path = folder / f"{NAME}_runs.json"
        save(record, path)
        say(f"Recorded runs: {path} (fit again: omniman identify friction --runs {path})")


def conclude(record: FrictionRecord, folder: Path) -> int:
    """Fit, report, write the files, and return the exit code; a failure raises an InputError."""
    if not record.runs:
        raise InputError("no steady run was recorded")
    wheels = identify_friction(record.runs, record.robot)
    say("\n".join(report(record, wheels)))
    path = folder / "friction.yaml"
    write_atomically(path, parameter_file(wheels))
    figure = draw(record, wheels, folder / "friction.png")
    say(paint("Identified.", GREEN, sys.stdout) + f" {path} is a ROS parameter file; use it:")
    say(f"  omniman up --params-file {path}")
    say(f"  ros2 run omniman_ros platform_controller --ros-args --params-file {path}")
    names = ", ".join(f"friction.{name}" for name in calibrated(wheels))
    say(f"or put its values into the robot's own file: {names}")
    say(f"Figure: {figure}" if figure else "No figure: matplotlib is not installed.")
    summary: dict[str, Any] = result(record, wheels) | {"picture": figure and str(figure)}
    results.publish(NAME, summary, folder)
    return 0


def draw(record: FrictionRecord, wheels: Sequence[WheelFriction], path: Path) -> Path | None:
    """Draw the runs into a PNG file; return its path, or None without matplotlib."""
    try:
        from omniman_ros.identification.friction import figure
    except ImportError:
        return None
    figure.draw(record, wheels, path)
    return path
