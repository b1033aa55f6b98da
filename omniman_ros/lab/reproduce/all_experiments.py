"""`omniman reproduce all`: runs all experiments in turn, and prints a table of their outcomes."""

import argparse
import importlib
import sys
import time

from omniman_ros.console import results
from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import BOLD, RED, paint, say, table
from omniman_ros.core.errors import OmnimanError
from omniman_ros.lab.registry import EXPERIMENTS


def run(args: argparse.Namespace) -> int:
    """Run all experiments; one that fails does not keep the others from running."""
    outcomes = {}
    rows: list[tuple[str, ...]] = [("experiment", "outcome", "took")]
    chosen = {key: getattr(args, key) for key in ("quick", "full", "seed", "world", "results")}
    for name, study in EXPERIMENTS.items():
        if name == args.name:
            continue
        say(paint(f"\n{name}: {study.about}", BOLD, sys.stdout))
        started = time.monotonic()
        try:
            module = importlib.import_module(f"omniman_ros.lab.{study.module}")
            passed = module.run(study.defaults(name, **chosen)) == 0
        except (CommandError, OmnimanError) as error:
            say(paint(f"error: {error}", RED, sys.stdout))
            passed = False
        outcomes[name] = {"passed": passed, "took_s": time.monotonic() - started}
        took = f"{outcomes[name]['took_s']:.0f} s"
        rows.append((name, "passed" if passed else paint("FAILED", RED, sys.stdout), took))
    say("\n".join(["", *table(rows)]))
    everything = {"quick": args.quick, "seed": args.seed, "world": args.world}
    results.publish("reproduce_all", {**everything, "experiments": outcomes}, args.results)
    return 0 if all(outcome["passed"] for outcome in outcomes.values()) else 1
