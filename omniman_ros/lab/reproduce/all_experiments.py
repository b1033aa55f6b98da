"""`omniman reproduce all`: runs all experiments in turn and writes a page that sums them up."""

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from omniman_ros.console import results
from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import BOLD, RED, paint, say, table
from omniman_ros.lab.reproduce.experiments import (
    EXPERIMENTS,
    SCENES_OPTIONS,
    Experiment,
    result_name,
)
from omniman_ros.lab.reproduce.report import ExperimentResult, load, summarize
from omniman_ros.lab.verdicts import verdict
from omniman_ros.processes.process_group import redirect_signals
from omniman_ros.simulation.world.parameters import ROLLERS

NAME = "reproduce_all"
"""Name of the results, without a suffix."""
JSON_LINE = '{"name": '
"""Start of the line on which an experiment prints its result as JSON."""
STOP_TIMEOUT = 5.0
"""Time that an interrupted experiment is given to end before it is killed [s]."""

Launch = Callable[[Sequence[str]], int]
"""Function that runs `omniman` with the given arguments and returns its exit code."""


def run(args: argparse.Namespace, launch: Launch | None = None) -> int:
    """Run `omniman reproduce all`.

    If an experiment fails, the others still run, and the page reports the failure. With
    `--world`, those that can be driven in the physics world are driven there as well; their
    figures stand beside the others and do not decide on the exit code.

    Args:
        args: Parsed command line.
        launch: Function that runs one experiment; None runs each in a subprocess.

    Returns:
        1 if an experiment failed, else 0, regardless of the agreement with the papers.

    Raises:
        CommandError: The folder of the results cannot be created.
    """
    folder = Path(args.results)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CommandError(f"--results {folder}: {error.strerror}") from error
    started = time.monotonic()
    finished = [
        run_one(args, experiment, folder, launch or run_subprocess)
        for experiment in EXPERIMENTS.values()
    ]
    if args.world:
        for experiment in EXPERIMENTS.values():
            if experiment.in_world:
                run_one(args, experiment, folder, launch or run_subprocess, args.world)
    wheels = args.world or ROLLERS
    result, page = summarize(finished, folder, time.monotonic() - started, wheels)
    say("\n".join(report(finished, result, page)))
    results.publish(NAME, result, folder)
    return 0 if all(experiment.passed for experiment in finished) else 1


def run_one(
    args: argparse.Namespace,
    experiment: Experiment,
    folder: Path,
    launch: Launch,
    wheels: str | None = None,
) -> ExperimentResult:
    """Run one experiment, or reuse its existing result if `--reuse` was given.

    After a run, the result file is read only if the run has written it: a file left by an earlier
    run is not mistaken for the result of this one.

    Args:
        args: Parsed command line.
        experiment: The experiment.
        folder: Folder of the results.
        launch: Function that runs `omniman`.
        wheels: Kind of wheels in the physics world; None for the plant.
    """
    name = experiment.name
    path = folder / f"{result_name(name, wheels)}.json"
    heading = f"{list(EXPERIMENTS).index(name) + 1} of {len(EXPERIMENTS)}: {name}"
    heading += f", in the physics world, wheels '{wheels}'" if wheels else ""
    if args.reuse and (existing := load(path)) is not None:
        say(paint(f"\n{heading}, result reused from {path}", BOLD, sys.stdout))
        return ExperimentResult(name, None, existing)
    is_long = experiment.minutes > 1 and not (args.quick or args.full)
    expected = f", about {experiment.minutes} minutes" if is_long else ""
    say(paint(f"\n{heading}{expected}", BOLD, sys.stdout))
    before = modification_time(path)
    code = launch(experiment_arguments(args, name, wheels))
    is_new = modification_time(path) != before
    if code:
        say(paint(f"'{name}' ended with exit code {code}", RED, sys.stdout))
    return ExperimentResult(name, code, load(path) if is_new else None)


def experiment_arguments(
    args: argparse.Namespace, name: str, wheels: str | None = None
) -> list[str]:
    """Return the arguments with which `omniman` runs one experiment.

    Args:
        args: Parsed command line of `omniman reproduce all`.
        name: Name of the experiment.
        wheels: Kind of wheels in the physics world; None for the plant.
    """
    arguments = ["reproduce", name, "--seed", str(args.seed), "--results", str(args.results)]
    arguments += [f"--{effort}" for effort in ("quick", "full") if getattr(args, effort)]
    if args.robot:
        arguments += ["--robot", args.robot]
    if wheels:
        arguments += ["--world", wheels]
    if name == "scenes":
        for option in SCENES_OPTIONS:
            value = getattr(args, option, None)
            if value is not None:
                arguments.append(f"--{option.replace('_', '-')}={value}")
    return arguments


def run_subprocess(arguments: Sequence[str]) -> int:
    """Run `omniman` in a subprocess, and print its output without the line of JSON.

    Args:
        arguments: Arguments of `omniman`.

    Returns:
        Exit code of the subprocess.

    Raises:
        KeyboardInterrupt: This process was interrupted; the subprocess has been stopped.
    """

    def interrupt(number: int) -> None:
        raise KeyboardInterrupt

    with redirect_signals(interrupt):
        child = subprocess.Popen(
            command(arguments),
            stdout=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        try:
            assert child.stdout is not None
            for line in child.stdout:
                if not line.startswith(JSON_LINE):
                    say(line.rstrip("\n"))
            return child.wait()
        finally:
            stop(child)


def command(arguments: Sequence[str]) -> list[str]:
    """Return the command line that runs `omniman` with the given arguments."""
    return [sys.executable, "-u", "-m", "omniman_ros.cli.main", *arguments]


def stop(child: "subprocess.Popen[str]") -> None:
    """Stop a subprocess together with its process pool: both are in one session of their own.

    They are interrupted first, and killed if they have not ended after `STOP_TIMEOUT`.
    """
    for number in (signal.SIGINT, signal.SIGKILL):
        if child.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(STOP_TIMEOUT)
    if child.stdout is not None:
        child.stdout.close()


def modification_time(path: Path) -> int | None:
    """Return the time at which a file was last modified [ns]; None if it does not exist."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return None


def report(finished: Sequence[ExperimentResult], result: dict[str, Any], page: Path) -> list[str]:
    """Return the lines of the report on the terminal.

    Args:
        finished: Results of the experiments.
        result: Summary of all results.
        page: Path of the HTML page.
    """
    lines = [
        "",
        *table(
            [("measured against published", "verdict")]
            + [(row["quantity"], row["verdict"]) for row in result["comparisons"]]
        ),
    ]
    failed = [experiment.name for experiment in finished if not experiment.passed]
    outcome = verdict(not failed, "all passed", f"failed: {', '.join(failed)}")
    return [*lines, "", f"Experiments: {outcome}", f"Page: {page}"]
