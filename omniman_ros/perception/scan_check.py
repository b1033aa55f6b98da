"""Whether a scanner sees: scans of a covered, frozen or dirty one must not count as fresh."""

from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated
from omniman_ros.perception.no_return import NAN, ZERO
from omniman_ros.perception.scan import Scan

MOVED, TURNED = 0.02, 0.01
"""Distance [m] and angle [rad] by which the robot must have moved for its scan to change."""
LEAST_HITS = 10  #: Number of beams that must meet something for a scan to be recognised


@dataclass(frozen=True)
class ScanCheckParameters(Validated):
    """What a scan must have to be used."""

    most_blind: float = parameter(
        0.5,
        "Share of beams without a measurement, or nearer than the shortest range, above which the "
        "scanner counts as covered.",
        low=0.0,
        high=1.0,
    )
    most_lost: float = parameter(
        0.2,
        "Share of single beams that see nothing between two that do, above which it counts as "
        "dirty.",
        low=0.0,
        high=1.0,
    )
    timeout: float = parameter(
        0.3,
        "Age of a scanner's last usable scan from which it counts as silent.",
        unit="s",
        low=0.02,
        high=10.0,
    )


def _hint(ranges: Array, excess: float) -> str:
    """Return the parameter that would help if a value of `excess` of the beams is meant."""
    for word, found in ((ZERO, ranges == 0.0), (NAN, np.isnan(ranges))):
        if (fraction := float(found.mean())) >= excess:
            return (
                f"; {100.0 * fraction:.0f} % are {word}: if that is what this scanner sends where "
                f"it meets nothing, set scanners.no_return to {word}"
            )
    return ""


class ScanCheck:
    """Judges the scans of one scanner."""

    def __init__(self) -> None:
        self._ranges: Array = np.zeros(0)
        self._pose: Array = np.zeros(3)

    def fault(self, scan: Scan, pose: Array, parameters: ScanCheckParameters) -> str:
        """Return why a scan at a pose (3,) in odom must not be used, or an empty string.

        Args:
            pose: (3,) pose of the robot at its end in odom [m, m, rad].
        """
        ranges = scan.ranges
        with np.errstate(invalid="ignore"):
            is_blind = ~(ranges > 0.0)
        blind = float(is_blind.mean())
        if blind > parameters.most_blind:
            hint = _hint(ranges, blind - parameters.most_blind)
            return f"covered: {100.0 * blind:.0f} % of the beams measure nothing{hint}"
        met = np.zeros(len(ranges), dtype=bool)
        met[scan.hits] = True
        lost = met[:-2] & met[2:] & np.isposinf(ranges[1:-1])
        fraction = float(lost.mean()) if len(lost) else 0.0
        if fraction > parameters.most_lost:
            return f"dirty: {100.0 * fraction:.0f} % of the beams are lost between two others"
        return self._frozen(scan, pose)

    def _frozen(self, scan: Scan, pose: Array) -> str:
        """Return whether the same ranges come again although the robot has moved."""
        ranges = scan.ranges
        is_same = np.array_equal(ranges, self._ranges, equal_nan=True)
        if not is_same or len(scan.hits) < LEAST_HITS:
            self._ranges, self._pose = ranges, pose
            return ""
        away = np.abs(pose - self._pose)
        if float(np.hypot(away[0], away[1])) < MOVED and away[2] < TURNED:
            return ""
        return f"frozen: the same {len(ranges)} ranges although the robot has moved"
