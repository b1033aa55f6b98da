"""Recorded runs and measured poses, as a file that can be fitted again."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from omniman_ros.control.odometry import OdometryParameters
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build, flatten
from omniman_ros.core.platform import Wheels
from omniman_ros.identification.odometry.campaign import Accuracy, CalibrationRun, Campaign, Pose
from omniman_ros.identification.record_file import load_record, save_record

FORMAT = "omniman odometry runs 1"  #: Name and version of the file format
#: Units of the numbers in the file
UNITS = "m, rad, s; poses (x, y, heading) of base_link on the floor"
DIGITS = 7  #: Number of decimals; the rounding error is far below an encoder count


@dataclass(frozen=True)
class CheckDrive:
    """A drive along the check path, to which no factor is fitted."""

    times: Array  #: (k,) times of the wheel positions [s]
    positions: Array  #: (k, n) wheel positions [rad]
    start: Pose  #: Measured pose before the drive [m, m, rad]
    end: Pose | None  #: Measured pose after it [m, m, rad]; None if it was not measured
    truth: Array  #: (m, 4) times [s] and poses [m, m, rad] measured during the drive, or (0, 4)


@dataclass(frozen=True)
class OdometryRecord:
    """Input of a calibration."""

    wheels: Wheels  #: The wheels as configured, without calibration
    odometry: OdometryParameters  #: Parameters in force while the runs were driven
    accuracy: Accuracy  #: Accuracy of the measured poses
    runs: tuple[CalibrationRun, ...] = ()  #: Runs, see :class:`Campaign`
    poses: tuple[Pose | None, ...] = ()  #: Measured poses, see :class:`Campaign`
    check: CheckDrive | None = None  #: The drive along the check path, if there was one

    @property
    def campaign(self) -> Campaign:
        """The runs to fit; too few measured poses raise an InputError."""
        return Campaign(self.wheels, self.runs, self.poses, self.accuracy)

    def with_run(self, run: CalibrationRun, pose: Pose | None) -> "OdometryRecord":
        """Return the record with one more run and the measured pose after it."""
        return replace(self, runs=(*self.runs, run), poses=(*self.poses, pose))


def without_standstill(times: Array, positions: Array) -> tuple[Array, Array]:
    """Remove rows in which no wheel has moved since the row before; the last row stays.

    Args:
        positions: (k, n) wheel positions [rad].
    """
    keep = np.ones(len(positions), dtype=bool)
    keep[1:] = (np.diff(positions, axis=0) != 0.0).any(axis=1)
    keep[-1] = True
    return times[keep], positions[keep]


def save(record: OdometryRecord, path: Path) -> None:
    """Write a record completely, or not at all with an OSError."""
    tree: dict[str, Any] = {
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
            "start": check.start,
            "end": check.end,
            "times": np.round(check.times, 6).tolist(),
            "positions": np.round(check.positions, DIGITS).tolist(),
            "truth": np.round(check.truth, DIGITS).tolist(),
        }
    save_record(path, FORMAT, UNITS, tree)


def load(path: Path) -> OdometryRecord:
    """Read a record; without such a file, a CommandError is raised."""
    return load_record(path, FORMAT, "recorded runs", _parse)


def _parse(tree: Mapping[str, Any]) -> OdometryRecord:
    check = tree["check"]
    return OdometryRecord(
        wheels=build(Wheels, tree["wheels"]),
        odometry=build(OdometryParameters, tree["odometry"]),
        accuracy=Accuracy(*map(float, tree["accuracy"])),
        runs=tuple(
            CalibrationRun(str(run["name"]), _matrix(run["positions"])) for run in tree["runs"]
        ),
        poses=(_pose(tree["start"]), *(_pose(run["pose"]) for run in tree["runs"])),
        check=None if check is None else _check_drive(check),
    )


def _check_drive(tree: Mapping[str, Any]) -> CheckDrive:
    start = _pose(tree["start"])
    if start is None:
        raise ValueError("the check has no start")
    return CheckDrive(
        np.array(tree["times"], dtype=float),
        _matrix(tree["positions"]),
        start,
        _pose(tree["end"]),
        _matrix(tree["truth"]).reshape(-1, 4),
    )


def _matrix(rows: Any) -> Array:
    return np.array(rows, dtype=float)


def _pose(values: Any) -> Pose | None:
    if values is None:
        return None
    x, y, theta = map(float, values)
    return x, y, theta
