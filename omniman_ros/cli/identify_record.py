"""What was driven and measured, as a file that can be fitted again."""

import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.cli.errors import CommandError
from omniman_ros.core.calibration import Accuracy, Campaign, Pose, Run
from omniman_ros.core.errors import OmnimanError
from omniman_ros.core.odometry import OdometryParameters
from omniman_ros.core.parameters import build, flatten
from omniman_ros.core.robot import Wheels

Array = NDArray[np.float64]

FORMAT = "omniman odometry runs 1"
DIGITS = 7
"""Decimals of a wheel's position: far below an encoder count."""


@dataclass(frozen=True)
class Check:
    """A path that nothing is fitted to.

    Attributes:
        times, positions: (k,) [s] and (k, n) [rad] of the wheels.
        start, end: Measured poses on the floor [m, m, rad]; end None if it was not measured.
        truth: (m, 4) times [s] and poses measured on the way, or (0, 4).
    """

    times: Array
    positions: Array
    start: Pose
    end: Pose | None
    truth: Array


@dataclass(frozen=True)
class Record:
    """All that a calibration needs.

    Attributes:
        wheels: As configured, without calibration.
        odometry: In force while it was driven.
        accuracy: Of the measured poses.
        runs, poses: As in `Campaign`.
        check: If it was driven.
    """

    wheels: Wheels
    odometry: OdometryParameters
    accuracy: Accuracy
    runs: tuple[Run, ...] = ()
    poses: tuple[Pose | None, ...] = ()
    check: Check | None = None

    @property
    def campaign(self) -> Campaign:
        """The runs for the fit.

        Raises:
            InputError: Too few poses were measured.
        """
        return Campaign(self.wheels, self.runs, self.poses, self.accuracy)

    def with_run(self, run: Run, pose: Pose | None) -> "Record":
        """The record with one more run and the pose after it."""
        return replace(self, runs=(*self.runs, run), poses=(*self.poses, pose))


def write_whole(path: Path, text: str) -> None:
    """Write a file whole or not at all.

    Raises:
        OSError: It cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False) as file:
        file.write(text)
    Path(file.name).chmod(0o644)
    os.replace(file.name, path)


def thinned(times: Array, positions: Array) -> tuple[Array, Array]:
    """Leave out rows in which no wheel has moved since the one before; the last one stays."""
    keep = np.ones(len(positions), dtype=bool)
    keep[1:] = (np.diff(positions, axis=0) != 0.0).any(axis=1)
    keep[-1] = True
    return times[keep], positions[keep]


def save(record: Record, path: Path) -> None:
    """Write a record whole or not at all.

    Raises:
        OSError: It cannot be written.
    """
    tree: dict[str, Any] = {
        "format": FORMAT,
        "units": "m, rad, s; poses (x, y, heading) of base_link on the floor",
        "wheels": flatten(record.wheels),
        "odometry": flatten(record.odometry),
        "accuracy": [record.accuracy.position, record.accuracy.heading],
        "start": record.poses[0] if record.poses else None,
        "runs": [
            {"name": run.name, "pose": pose, "positions": np.round(run.positions, DIGITS).tolist()}
            for run, pose in zip(record.runs, record.poses[1:], strict=True)
        ],
        "check": None,
    }
    if record.check is not None:
        check = record.check
        tree["check"] = {
            "start": check.start, "end": check.end,
            "times": np.round(check.times, 6).tolist(),
            "positions": np.round(check.positions, DIGITS).tolist(),
            "truth": np.round(check.truth, DIGITS).tolist(),
        }  # fmt: skip
    write_whole(path, json.dumps(tree, allow_nan=False) + "\n")


def load(path: Path) -> Record:
    """Read a record.

    Raises:
        CommandError: There is none, or it is not such a file.
    """
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
        if tree["format"] != FORMAT:
            raise ValueError(f"its format is '{tree['format']}', expected '{FORMAT}'")
        check = tree["check"]
        return Record(
            wheels=build(Wheels, tree["wheels"]),
            odometry=build(OdometryParameters, tree["odometry"]),
            accuracy=Accuracy(*map(float, tree["accuracy"])),
            runs=tuple(Run(str(run["name"]), _matrix(run["positions"])) for run in tree["runs"]),
            poses=(_pose(tree["start"]), *(_pose(run["pose"]) for run in tree["runs"])),
            check=None if check is None else _check(check),
        )
    except (OSError, ValueError, KeyError, TypeError, OmnimanError) as error:
        raise CommandError(f"'{path}' holds no recorded runs: {error!r}", 2) from error


def _check(tree: Mapping[str, Any]) -> Check:
    start = _pose(tree["start"])
    if start is None:
        raise ValueError("the check has no start")
    return Check(
        np.array(tree["times"], dtype=float), _matrix(tree["positions"]), start,
        _pose(tree["end"]), _matrix(tree["truth"]).reshape(-1, 4),
    )  # fmt: skip


def _matrix(rows: Any) -> Array:
    return np.array(rows, dtype=float)


def _pose(values: Any) -> Pose | None:
    if values is None:
        return None
    x, y, theta = map(float, values)
    return x, y, theta
