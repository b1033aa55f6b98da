"""`omniman reproduce all`: one experiment after the other, and the page that summarizes them."""

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
from omniman_ros.lab.reproduce.experiments import EXPERIMENTS, SCENES_OPTIONS, Experiment
from omniman_ros.lab.reproduce.report import ExperimentResult, load, summarize
from omniman_ros.lab.verdicts import verdict
from omniman_ros.processes.process_group import redirect_signals

NAME = "reproduce_all"
JSON_LINE = '{"name": '
"""Begin of the line in which an experiment prints its JSON."""
STOP_TIMEOUT = 5.0
"""Longest time until an interrupted experiment ends [s]."""

Launch = Callable[[Sequence[str]], int]
"""Runs `omniman` with arguments and returns its exit code."""


def run(args: argparse.Namespace, launch: Launch | None = None) -> int:
    """Run `omniman reproduce all`.

    If an experiment fails, the others are run nevertheless, and the page reports the failure.

    Args:
        args: Command line.
        launch: Runs one experiment; None means that each runs in a separate process.

    Returns:
        1 if an experiment failed, else 0, whatever the comparison says.

    Raises:
        CommandError: The folder cannot be written.
    """
    folder = Path(args.results)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CommandError(f"--results {folder}: {error.strerror}") from error
    started = time.monotonic()
    done = [
        run_one(args, experiment, folder, launch or in_process)
        for experiment in EXPERIMENTS.values()
    ]
    result, page = summarize(done, folder, time.monotonic() - started)
    say("\n".join(report(done, result, page)))
    results.publish(NAME, result, folder)
    return 0 if all(experiment.passed for experiment in done) else 1


def run_one(
    args: argparse.Namespace, experiment: Experiment, folder: Path, launch: Launch
) -> ExperimentResult:
    """Run one experiment, or reuse its result.

    A result that is older than the run does not count as the result of the run.
    """
    name = experiment.name
    path = folder / f"{experiment.result_name}.json"
    head = f"{list(EXPERIMENTS).index(name) + 1} of {len(EXPERIMENTS)}: {name}"
    if args.reuse and (found := load(path)) is not None:
        say(paint(f"\n{head}, as it is in {path}", BOLD, sys.stdout))
        return ExperimentResult(name, None, found)
    is_long = experiment.minutes > 1 and not (args.quick or args.full)
    expected = f", some {experiment.minutes} minutes" if is_long else ""
    say(paint(f"\n{head}{expected}", BOLD, sys.stdout))
    before = written_at(path)
    code = launch(options(args, name))
    fresh = written_at(path) != before
    if code:
        say(paint(f"'{name}' ended with exit code {code}", RED, sys.stdout))
    return ExperimentResult(name, code, load(path) if fresh else None)


def options(args: argparse.Namespace, name: str) -> list[str]:
    """Return the arguments of `omniman` for one experiment."""
    chosen = ["reproduce", name, "--seed", str(args.seed), "--results", str(args.results)]
    chosen += [f"--{effort}" for effort in ("quick", "full") if getattr(args, effort)]
    if args.robot:
        chosen += ["--robot", args.robot]
    if name == "scenes":
        for option in SCENES_OPTIONS:
            value = getattr(args, option, None)
            if value is not None:
                chosen.append(f"--{option.replace('_', '-')}={value}")
    return chosen


def in_process(arguments: Sequence[str]) -> int:
    """Run `omniman` in a process of its own, and print its output without its line of JSON."""

    def interrupted(number: int) -> None:
        raise KeyboardInterrupt

    with redirect_signals(interrupted):
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
            end(child)


def command(arguments: Sequence[str]) -> list[str]:
    """Return the command line of `omniman` with arguments."""
    return [sys.executable, "-u", "-m", "omniman_ros.cli.main", *arguments]


def end(child: "subprocess.Popen[str]") -> None:
    """End a process and those of its pool, which are a session of their own."""
    for number in (signal.SIGINT, signal.SIGKILL):
        if child.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(STOP_TIMEOUT)
    if child.stdout is not None:
        child.stdout.close()


def written_at(path: Path) -> int | None:
    """Return the time at which a file was written [ns]; None if it does not exist."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return None


def report(done: Sequence[ExperimentResult], result: dict[str, Any], page: Path) -> list[str]:
    """Return the lines of the report."""
    lines = [
        "",
        *table(
            [("measured against published", "verdict")]
            + [(row["quantity"], row["verdict"]) for row in result["comparisons"]]
        ),
    ]
    failed = [experiment.name for experiment in done if not experiment.passed]
    outcome = verdict(not failed, "all passed", f"failed: {', '.join(failed)}")
    return [*lines, "", f"Experiments: {outcome}", f"Page: {page}"]
