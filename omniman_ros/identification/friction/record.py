"""Steady runs of wheels off the floor, as a file that can be fitted again."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omniman_ros.core.parameters import build, flatten
from omniman_ros.core.platform import Platform
from omniman_ros.identification.friction.friction_fit import SteadyRun
from omniman_ros.identification.record_file import load_record, save_record

FORMAT = "omniman friction runs 1"  #: Name and version of the file format
#: Units of the numbers in the file
UNITS = "V, A, rad/s; error: standard error of the mean current, A"
#: Names of a run's arrays in the file, which are those of `SteadyRun`
RUN_ARRAYS = ("voltage", "current", "speed", "error", "steady", "spikes")


@dataclass(frozen=True)
class Truth:
    """True friction of a simulated robot, to compare the result with."""

    viscous: tuple[float, ...]  #: (n,) viscous friction of each wheel [N m s/rad]
    coulomb: tuple[float, ...]  #: (n,) Coulomb friction of each wheel [N m]


@dataclass(frozen=True)
class FrictionRecord:
    """Input of a fit."""

    robot: Platform  #: The robot as configured
    runs: tuple[SteadyRun, ...] = ()  #: Steady runs in the order in which they were measured
    truth: Truth | None = None  #: True friction, in simulation only


def save(record: FrictionRecord, path: Path) -> None:
    """Write a record completely, or not at all with an OSError."""
    tree: dict[str, Any] = {
        "robot": flatten(record.robot),
        "runs": [
            {name: getattr(run, name).tolist() for name in RUN_ARRAYS} | {"samples": run.samples}
            for run in record.runs
        ],
        "truth": record.truth and flatten(record.truth),
    }
    save_record(path, FORMAT, UNITS, tree)


def load(path: Path) -> FrictionRecord:
    """Read a record; without such a file, a CommandError is raised."""
    return load_record(path, FORMAT, "recorded runs", _parse)


def _parse(tree: Mapping[str, Any]) -> FrictionRecord:
    truth = tree["truth"]
    return FrictionRecord(
        robot=build(Platform, tree["robot"]),
        runs=tuple(
            SteadyRun(**{name: run[name] for name in RUN_ARRAYS}, samples=int(run["samples"]))
            for run in tree["runs"]
        ),
        truth=None
        if truth is None
        else Truth(
            tuple(map(float, truth["viscous"])),
            tuple(map(float, truth["coulomb"])),
        ),
    )
