"""Drives on the floor, as a file that can be fitted again."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.core.errors import OmnimanError
from omniman_ros.core.parameters import build, flatten
from omniman_ros.core.robot import Robot
from omniman_ros.identification.files import write_atomically
from omniman_ros.identification.floor.floor_drive import FloorDrive

FORMAT = "omniman floor drives 1"
"""Name and version of the file format."""
DRIVE_ARRAYS = ("times", "positions", "electrical_times", "currents", "voltages")
"""Names of a drive's arrays in the file, which are those of `FloorDrive`."""
DIGITS = 7
"""Number of decimals in the file."""


@dataclass(frozen=True)
class FloorRecord:
    """Input of an identification.

    Attributes:
        robot: The robot as configured, with calibrated wheel radii.
        drive: The drive to fit; None before it was driven.
        check: A drive to which nothing is fitted; None if there is none.
        truth: The simulated robot, in simulation only.
    """

    robot: Robot
    drive: FloorDrive | None = None
    check: FloorDrive | None = None
    truth: Robot | None = None


def save(record: FloorRecord, path: Path) -> None:
    """Write a record completely or not at all.

    Raises:
        OSError: The file cannot be written.
    """
    tree: dict[str, Any] = {
        "format": FORMAT,
        "units": "s, rad, A, V",
        "robot": flatten(record.robot),
        "drive": _drive_tree(record.drive),
        "check": _drive_tree(record.check),
        "truth": record.truth and flatten(record.truth),
    }
    write_atomically(path, json.dumps(tree, allow_nan=False) + "\n")


def load(path: Path) -> FloorRecord:
    """Read a record.

    Raises:
        CommandError: The file does not exist, or is not such a record.
    """
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
        if tree["format"] != FORMAT:
            raise ValueError(f"its format is '{tree['format']}', expected '{FORMAT}'")
        return FloorRecord(
            robot=build(Robot, tree["robot"]),
            drive=_drive(tree["drive"]),
            check=_drive(tree["check"]),
            truth=tree["truth"] and build(Robot, tree["truth"]),
        )
    except (OSError, ValueError, KeyError, TypeError, OmnimanError) as error:
        raise CommandError(f"'{path}' contains no recorded drives: {error!r}", 2) from error


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
