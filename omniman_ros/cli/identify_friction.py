"""`omniman identify friction`: turn lifted wheels at constant voltages, fit their friction.

MPC 2021, (22) to (24); the experiment is `core.friction_experiment`, the fit
`core.friction_identification`.
"""

import argparse
import math
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from omniman_ros.cli import results
from omniman_ros.cli.children import Children, signals_to
from omniman_ros.cli.demo import refuse_other_robots
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.fleet import Setup, resolved, tasks
from omniman_ros.cli.identify_friction_bench import Bench, Drive
from omniman_ros.cli.identify_friction_record import FrictionRecord, Truth, load, save
from omniman_ros.cli.identify_friction_report import calibrated, parameter_file, report, result
from omniman_ros.cli.identify_pose import Lines
from omniman_ros.cli.identify_record import write_whole
from omniman_ros.cli.isolation import isolate
from omniman_ros.cli.output import NodeLog
from omniman_ros.cli.progress import Progress
from omniman_ros.cli.session import Session
from omniman_ros.cli.terminal import GREEN, paint, say
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.friction_experiment import Plan, make_plan
from omniman_ros.core.friction_identification import WheelFriction, identify_friction
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.robots import load_robot

NAME = "identify_friction"
NODES = ("simulated_drive",)
PATIENT = ("firmware.watchdog:=0.5", "command_timeout:=0.5")
"""A simulation on a busy machine: nothing real is at stake when a process waits for its turn."""
SILENCE, PATIENT_SILENCE = 0.3, 3.0
"""Time without feedback at which it ends, and in simulation [s]."""
FRICTION = (1.25, 0.85, 1.1, 0.7)
"""Friction of the simulated wheels over the configured one, unless the user says what."""
CONSTANT = (1.01, 0.99)
"""Motor constants of the simulated wheels over the configured one."""
NOISE = 0.004
"""Standard deviation of the simulated current sensors, over the largest current."""
YES = ("yes", "lifted")


def run(args: argparse.Namespace) -> int:
    """Run `omniman identify friction`; returns the exit code."""
    folder = Path(args.results)
    if args.runs is not None:
        record = load(Path(args.runs))
        if args.robot is not None:
            record = replace(record, robot=build(Robot, load_robot(args.robot)))
        return conclude(record, folder)
    if not args.simulate and args.param:
        raise CommandError("-p is for --simulate: a running robot has its own parameters", 2)
    check_options(args)
    return conclude(simulate(args) if args.simulate else turn_running(args), folder)


def check_options(args: argparse.Namespace) -> None:
    """Refuse what cannot be asked for.

    Raises:
        CommandError: An option is out of its range.
    """
    for name, low, high in (("levels", 3, 50), ("rounds", 1, 50), ("precision", 0.01, 20.0)):
        value = getattr(args, name)
        if not (math.isfinite(value) and low <= value <= high):
            raise CommandError(f"--{name} {value:g} is not within {low:g} to {high:g}", 2)


def planned(args: argparse.Namespace, robot: Robot, silence: float) -> Plan:
    """The plan that the options ask for.

    Raises:
        InputError: The robot cannot be measured.
    """
    return make_plan(robot, args.levels, args.rounds, 1e-2 * args.precision, silence)


# ---- in simulation -----------------------------------------------------------------------------


def unlike(robot: Robot) -> list[str]:
    """Parameters that make the simulated wheels other than configured, with noisy sensors."""
    n = robot.wheel_count

    def listed(values: Sequence[float]) -> str:
        return f"[{', '.join(str(values[k % len(values)]) for k in range(n))}]"

    return [
        f"mismatch.friction:={listed(FRICTION)}",
        f"mismatch.torque_constant:={listed(CONSTANT)}",
        f"faults.current_noise:={NOISE * robot.motor.max_current:.4g}",
    ]


def simulate(args: argparse.Namespace) -> FrictionRecord:
    """Measure simulated drives of this command's own."""
    name = resolved(args.robot or "omniman")
    configured = build(Robot, load_robot(name))
    given = {text.partition(":=")[0] for text in args.param}
    wrong = [text for text in unlike(configured) if text.partition(":=")[0] not in given]
    params = [*PATIENT, "plant.lifted:=true", *wrong, *args.param]
    chosen = tasks(Setup(robot=name, only=NODES, namespace=args.namespace, params=params))
    private = "ROS_DOMAIN_ID" not in os.environ
    isolate(os.environ)
    log = NodeLog(args.verbose)
    children = Children(chosen, on_line=log)
    say(f"omniman identify friction: robot '{args.robot or 'omniman'}' in simulation, on blocks;")
    say("other than configured, unknown to the fit:")
    for text in [*wrong, *args.param]:
        say(f"  {text}")
    with signals_to(children.interrupt):
        try:
            if not private:
                refuse_other_robots(children.check)
            with children:
                record = perform(args, children.check, None, simulated=True)
                children.stop()
        except CommandError:
            log.show()
            raise
    return record


def truth_of(drive: Drive, robot: Robot) -> Truth:
    """Friction that a simulated drive has."""
    factors = list(drive.values.get("mismatch.friction", [1.0]))
    factors = factors if len(factors) > 1 else factors * robot.wheel_count
    friction = robot.friction
    return Truth(
        tuple(a * f for a, f in zip(friction.viscous, factors, strict=True)),
        tuple(b * f for b, f in zip(friction.coulomb, factors, strict=True)),
    )


# ---- on a running drive ------------------------------------------------------------------------


def turn_running(args: argparse.Namespace) -> FrictionRecord:
    """Measure the drives that are there."""
    signals: list[int] = []

    def poll() -> None:
        if signals:
            raise KeyboardInterrupt

    with signals_to(signals.append):
        return perform(args, poll, None if args.lifted else sys.stdin.fileno(), simulated=False)


def robot_of(args: argparse.Namespace, drive: Drive, simulated: bool) -> Robot:
    """The robot as the user or its drive says.

    Raises:
        CommandError: Neither does.
    """
    if args.robot is not None and not simulated:
        return build(Robot, load_robot(args.robot))
    try:
        return build(Robot, drive.values)
    except ParameterError as error:
        raise CommandError(
            f"{drive.name} does not tell the robot's data ({error}): give --robot"
        ) from error


def perform(
    args: argparse.Namespace, poll: Callable[[], None], keyboard: int | None, simulated: bool
) -> FrictionRecord:
    """Turn the wheels; what was measured is saved, also when it ends early.

    Args:
        args: Of the command line.
        poll: Called many times a second; raises to end early.
        keyboard: File descriptor of what the user types; None if nobody is asked.
        simulated: Whether the drive is this command's own.
    """
    progress = Progress()
    with ExitStack() as stack:
        session = stack.enter_context(Session("omniman_identify", args.namespace))
        progress.begin("looking around")
        bench = Bench(session, progress, poll)
        drive = bench.find_drive(("mismatch.friction",) if simulated else ())
        robot = robot_of(args, drive, simulated)
        plan = planned(args, robot, PATIENT_SILENCE if simulated else SILENCE)
        bench.meet(robot)
        progress.end(f"{drive.name} is there, nobody else commands it")
        if not simulated:
            explain(plan, robot)
        if keyboard is not None:
            confirm(Lines(keyboard), bench.wait)
        record = FrictionRecord(robot, truth=truth_of(drive, robot) if simulated else None)

        def measured() -> FrictionRecord:
            runs = bench.experiment.runs if bench.experiment is not None else []
            return replace(record, runs=tuple(runs))

        stack.callback(lambda: keep(measured(), Path(args.results)))
        bench.turn(plan)
        return measured()


def explain(plan: Plan, robot: Robot) -> None:
    """Tell the user what will happen, and what it takes."""
    top = max(plan.levels)
    speed = top / (robot.motor.gear_ratio * robot.motor.torque_constant)
    least = (len(plan.levels) + 1) * (plan.shortest + 1.5) / 60.0
    most = plan.longest_time / 60.0
    say(f"""
LIFT THE ROBOT: all wheels must be off the floor and free to turn, and the robot safe on blocks.
They will turn for {least:.0f} to {most:.0f} minutes, in both directions, at up to {top:.1f} V
and {speed:.1f} rad/s: keep hands, hair and cables away. To stop: Ctrl-C here, `omniman stop` in
another terminal, or the emergency stop.""")


def confirm(lines: Lines, wait: Callable[[], None]) -> None:
    """Ask until the user says that the wheels are off the floor.

    Raises:
        CommandError: There is nobody to ask.
        KeyboardInterrupt: The user ended it.
    """
    while True:
        say("Are all wheels off the floor? Type yes; Ctrl-C ends.")
        try:
            answer = lines.next(wait)
        except CommandError as error:
            if "no more input" not in str(error):
                raise
            raise CommandError(
                "nobody says that the wheels are off the floor: --lifted says so"
            ) from error
        if answer.strip().lower() in YES:
            return


# ---- the result --------------------------------------------------------------------------------


def keep(record: FrictionRecord, folder: Path) -> None:
    """Save what was measured, if anything."""
    if record.runs:
        path = folder / f"{NAME}_runs.json"
        save(record, path)
        say(f"Recorded runs: {path} (fit again: omniman identify friction --runs {path})")


def conclude(record: FrictionRecord, folder: Path) -> int:
    """Fit, tell, write the files; returns the exit code."""
    if not record.runs:
        raise InputError("no steady run was recorded")
    found = identify_friction(record.runs, record.robot)
    say("\n".join(report(record, found)))
    path = folder / "friction.yaml"
    write_whole(path, parameter_file(found))
    picture = draw(record, found, folder / "friction.png")
    say(paint("Identified.", GREEN, sys.stdout) + f" {path} is a ROS parameter file; use it:")
    say(f"  omniman up --params-file {path}")
    say(f"  ros2 run omniman_ros platform_controller --ros-args --params-file {path}")
    values = ", ".join(f"friction.{name}" for name in calibrated(found))
    say(f"or put its values into the robot's own file: {values}")
    say(f"Picture: {picture}" if picture else "No picture: matplotlib is not installed.")
    summary: dict[str, Any] = result(record, found) | {"picture": picture and str(picture)}
    results.publish(NAME, summary, folder)
    return 0


def draw(record: FrictionRecord, found: Sequence[WheelFriction], path: Path) -> Path | None:
    """Draw the runs into a PNG file, where there is matplotlib."""
    try:
        from omniman_ros.cli import identify_friction_picture
    except ImportError:
        return None
    identify_friction_picture.draw(record, found, path)
    return path
