"""Drives on the floor, as a file that can be fitted again."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from omniman_ros.core.parameters import build, flatten
from omniman_ros.core.platform import Platform
from omniman_ros.identification.floor.floor_drive import FloorDrive
from omniman_ros.identification.record_file import load_record, save_record

FORMAT = "omniman floor drives 1"  #: Name and version of the file format
UNITS = "s, rad, A, V"  #: Units of the numbers in the file
#: Names of a drive's arrays in the file, which are those of `FloorDrive`
DRIVE_ARRAYS = ("times", "positions", "electrical_times", "currents", "voltages")
DIGITS = 7  #: Number of decimals in the file


@dataclass(frozen=True)
class FloorRecord:
    """Input of an identification."""

    robot: Platform  #: The robot as configured, with calibrated wheel radii
    drive: FloorDrive | None = None  #: The drive to fit; None before it was driven
    check: FloorDrive | None = None  #: A drive to which nothing is fitted; None if there is none
    truth: Platform | None = None  #: The simulated robot, in simulation only


def save(record: FloorRecord, path: Path) -> None:
    """Write a record completely, or not at all with an OSError."""
    tree: dict[str, Any] = {
        "robot": flatten(record.robot),
        "drive": _drive_tree(record.drive),
        "check": _drive_tree(record.check),
        "truth": record.truth and flatten(record.truth),
    }
    save_record(path, FORMAT, UNITS, tree)


def load(path: Path) -> FloorRecord:
    """Read a record; without such a file, a CommandError is raised."""
    return load_record(path, FORMAT, "recorded drives", _parse)


def _parse(tree: Mapping[str, Any]) -> FloorRecord:
    return FloorRecord(
        robot=build(Platform, tree["robot"]),
        drive=_drive(tree["drive"]),
        check=_drive(tree["check"]),
        truth=tree["truth"] and build(Platform, tree["truth"]),
    )


def _drive_tree(drive: FloorDrive | None) -> dict[str, Any] | None:
    """Return a drive as lists; null stands for a voltage that was not reported."""
    if drive is None:
        return None
    tree = {name: np.round(getattr(drive, name), DIGITS).tolist() for name in DRIVE_ARRAYS}
    tree["voltages"] = [
        [None if value != value else value for value in row] for row in tree["voltages"]
    ]
    return tree


def _drive(tree: Mapping[str, Any] | None) -> FloorDrive | None:
    if tree is None:
        return None
    return FloorDrive(**{name: np.array(tree[name], dtype=float) for name in DRIVE_ARRAYS})
