"""Steady runs of wheels off the floor, as a file that can be fitted again."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.identify_record import write_whole
from omniman_ros.core.errors import OmnimanError
from omniman_ros.core.friction_identification import SteadyRun
from omniman_ros.core.parameters import build, flatten
from omniman_ros.core.robot import Robot

FORMAT = "omniman friction runs 1"
ARRAYS = ("voltage", "current", "speed", "error", "steady", "spikes")


@dataclass(frozen=True)
class Truth:
    """Friction (n,) of a simulated robot [N m s/rad, N m], to compare with; nobody else has it."""

    viscous: tuple[float, ...]
    coulomb: tuple[float, ...]


@dataclass(frozen=True)
class FrictionRecord:
    """All that the fit needs.

    Attributes:
        robot: As configured.
        runs: In the order in which they were done.
        truth: In simulation.
    """

    robot: Robot
    runs: tuple[SteadyRun, ...] = ()
    truth: Truth | None = None


def save(record: FrictionRecord, path: Path) -> None:
    """Write a record whole or not at all.

    Raises:
        OSError: It cannot be written.
    """
    tree: dict[str, Any] = {
        "format": FORMAT,
        "units": "V, A, rad/s; error: standard error of the mean current, A",
        "robot": flatten(record.robot),
        "runs": [
            {name: getattr(run, name).tolist() for name in ARRAYS} | {"samples": run.samples}
            for run in record.runs
        ],
        "truth": record.truth and flatten(record.truth),
    }
    write_whole(path, json.dumps(tree, allow_nan=False) + "\n")


def load(path: Path) -> FrictionRecord:
    """Read a record.

    Raises:
        CommandError: There is none, or it is not such a file.
    """
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
        if tree["format"] != FORMAT:
            raise ValueError(f"its format is '{tree['format']}', expected '{FORMAT}'")
        truth = tree["truth"]
        return FrictionRecord(
            robot=build(Robot, tree["robot"]),
            runs=tuple(
                SteadyRun(**{name: run[name] for name in ARRAYS}, samples=int(run["samples"]))
                for run in tree["runs"]
            ),
            truth=None
            if truth is None
            else Truth(
                tuple(map(float, truth["viscous"])),
                tuple(map(float, truth["coulomb"])),
            ),
        )
    except (OSError, ValueError, KeyError, TypeError, OmnimanError) as error:
        raise CommandError(f"'{path}' holds no recorded runs: {error!r}", 2) from error
