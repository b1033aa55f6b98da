"""`omniman reproduce all`: one experiment after the other, and the page that sums them up."""

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

from omniman_ros.cli import results
from omniman_ros.cli.children import signals_to
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.reproduce_report import Experiment, load, summed_up
from omniman_ros.cli.terminal import BOLD, GREEN, RED, paint, say, table

NAME = "reproduce_all"
MINUTES = {
    "coupling": 5, "tool_path": 1, "free": 1, "corridor": 1, "moving": 1, "workshop": 1,
    "scenes": 7,
}  # fmt: skip
"""How long each takes in its default size on two free cores."""
EXPERIMENTS = tuple(MINUTES)
"""In the order in which they are run and told."""
OF_SCENES = ("count", "seeds", "jobs", "solve_time")
"""Options that are handed on to the scenes alone."""
JSON_LINE = '{"name": '
"""How the line begins in which an experiment prints its JSON again."""

PATIENCE = 5.0
"""How long an experiment that is interrupted may take to end [s]."""

Launch = Callable[[Sequence[str]], int]
"""Runs `omniman` with arguments; its exit code."""


def run(args: argparse.Namespace, launch: Launch | None = None) -> int:
    """Run `omniman reproduce all`.

    An experiment that fails ends nothing: the others are run, and the page tells it.

    Args:
        args: Of the command line.
        launch: Runs one experiment; in a process of its own if None.

    Returns:
        1 if an experiment failed, else 0; what the comparison says changes nothing.

    Raises:
        CommandError: The folder cannot be written.
    """
    folder = Path(args.results)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CommandError(f"--results {folder}: {error.strerror}") from error
    started = time.monotonic()
    done = [experiment(args, name, folder, launch or in_process) for name in EXPERIMENTS]
    result, page = summed_up(done, folder, time.monotonic() - started)
    say("\n".join(report(done, result, page)))
    results.publish(NAME, result, folder)
    return 0 if all(one.passed for one in done) else 1


def experiment(args: argparse.Namespace, name: str, folder: Path, launch: Launch) -> Experiment:
    """Run one, or take what is there; a result from before the run is not taken for its own."""
    path = folder / f"reproduce_{name}.json"
    number = EXPERIMENTS.index(name) + 1
    head = f"{number} of {len(EXPERIMENTS)}: {name}"
    if args.reuse and (found := load(path)) is not None:
        say(paint(f"\n{head}, as it is in {path}", BOLD, sys.stdout))
        return Experiment(name, None, found)
    usual = not (args.quick or args.full)
    patience = f", some {MINUTES[name]} minutes" if usual and MINUTES[name] > 1 else ""
    say(paint(f"\n{head}{patience}", BOLD, sys.stdout))
    before = stamp(path)
    code = launch(options(args, name))
    fresh = stamp(path) != before
    if code:
        say(paint(f"'{name}' ended with exit code {code}", RED, sys.stdout))
    return Experiment(name, code, load(path) if fresh else None)


def options(args: argparse.Namespace, name: str) -> list[str]:
    """Arguments of `omniman` for one experiment."""
    chosen = ["reproduce", name, "--seed", str(args.seed), "--results", str(args.results)]
    chosen += [f"--{effort}" for effort in ("quick", "full") if getattr(args, effort)]
    if args.robot:
        chosen += ["--robot", args.robot]
    if name == "scenes":
        for option in OF_SCENES:
            value = getattr(args, option, None)
            if value is not None:
                chosen.append(f"--{option.replace('_', '-')}={value}")
    return chosen


def in_process(arguments: Sequence[str]) -> int:
    """Run `omniman` in a process of its own; what it prints goes on, but for its line of JSON."""

    def interrupted(number: int) -> None:
        raise KeyboardInterrupt

    with signals_to(interrupted):
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
    """The command line of `omniman` with arguments."""
    return [sys.executable, "-u", "-m", "omniman_ros.cli.main", *arguments]


def end(child: "subprocess.Popen[str]") -> None:
    """End what still runs, the processes of its pool included: they are a session of their own."""
    for number in (signal.SIGINT, signal.SIGKILL):
        if child.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(PATIENCE)
    if child.stdout is not None:
        child.stdout.close()


def stamp(path: Path) -> int | None:
    """When a file was written [ns]; None if it is not there."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return None


def report(done: Sequence[Experiment], result: dict[str, Any], page: Path) -> list[str]:
    """What is said at the end."""
    lines = ["", *table([("measured against published", "verdict")] + [
        (row["quantity"], row["verdict"]) for row in result["comparisons"]
    ])]  # fmt: skip
    failed = [one.name for one in done if not one.passed]
    said = (
        paint(f"failed: {', '.join(failed)}", RED, sys.stdout)
        if failed
        else paint("all passed", GREEN, sys.stdout)
    )
    return [*lines, "", f"Experiments: {said}", f"Page: {page}"]
