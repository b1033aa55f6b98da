"""Cut of a recorded drive: which parts of it are shown, under what title, and how fast."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.recording.film.film_log import FilmLog

STOP = "stop"  #: Source while the robot is stopped
NO_SOURCE = ("none", "")  #: Sources while nothing drives
TOOL = "tool"  #: Kind of a part in which `path` follows a path of the tool
FAULT = "fault"  #: Kind of a part in which a wheel is without torque
TITLES = {
    "cmd_vel": ("Teleoperation", "twists, in any direction"),
    "path": ("A path", "platform and arm in step"),
    TOOL: ("A path of the tool", "platform and arm as one body"),
    "body": ("A path of the tool", "platform and arm dodge what is around them"),
    "mpc": ("A goal", "planned around what moves"),
    "station": ("Beside another robot", "keeps its station"),
    FAULT: ("A wheel without torque", "noticed; the path goes on with the others"),
    STOP: ("Stop", "platform and arm come to rest"),
}  #: Title and subtitle by the kind of a part
LEAST_LENGTH = 1.0  #: Length from which a part is shown [s]
LONGEST_REST = 0.8  #: Longest time between two parts that are shown as one [s]
#: Time for which a shot is seen at least, if it is not slowed down for that [s]
LEAST_ON_SCREEN = 2.0
STOP_SHOWN = 1.8  #: Time for which a stop is shown [s]
RUN_UP = 2.0  #: Longest part of the drive before a stop that is shown with it [s]
_HALVINGS = 40  #: Number of halvings of the search for the common speed


@dataclass(frozen=True)
class Shot:
    """A part of the drive that is shown, between two ROS times [s]."""

    kind: str  #: One of `TITLES`
    start: float
    end: float
    speed: float = 1.0  #: How many times faster than ROS time it is shown

    @property
    def length(self) -> float:
        """Length in ROS time [s]."""
        return self.end - self.start

    @property
    def on_screen(self) -> float:
        """Length in the film [s]."""
        return self.length / self.speed

    def times(self, rate: float) -> Array:
        """Return the ROS times (k,) of its frames [s] at a number of frames per second."""
        count = max(1, round(self.on_screen * rate))
        return self.start + (np.arange(count) + 0.5) / count * self.length


def cut(log: FilmLog, duration: float) -> list[Shot]:
    """Return the shots of a film, in order.

    Parts in which nothing drives are left out, and a stop is shown with the drive before it. All
    shots have the same speed, except short ones, which are slower.

    Args:
        duration: Length of the film [s]; a drive that is shorter is shown at its own speed.

    Raises:
        InputError: Nothing drove.
    """
    parts = _with_stops(_joined(_driven(log)))
    if not parts:
        raise InputError("no source drove the platform in the recording")
    return _paced(parts, duration)


def _driven(log: FilmLog) -> list[Shot]:
    end = log.robot.span[1]
    shots = []
    for (start, source), (until, _) in pairwise([*log.robot.sources, (end, "")]):
        if source in NO_SOURCE or until <= start:
            continue
        kind = source if source in TITLES else "path"
        if source == "path" and _follows_tool_path(log, start):
            kind = TOOL
        lost = [
            time
            for time, names in zip(log.dead_wheels.times, log.dead_wheels.values, strict=True)
            if names and start < time < until
        ]
        if lost and source != STOP:
            kind = FAULT
        shots.append(Shot(kind, start, until))
    return shots


def _follows_tool_path(log: FilmLog, time: float) -> bool:
    last = {
        name: series.times[index]
        for name, series in (
            ("platform", log.paths),
            ("joints", log.trajectories),
            ("tool", log.tool_paths),
        )
        if (index := series.index(time)) >= 0
    }
    return bool(last) and max(last, key=lambda name: last[name]) == "tool"


def _joined(shots: Sequence[Shot]) -> list[Shot]:
    joined: list[Shot] = []
    for shot in shots:
        last = joined[-1] if joined else None
        if last and last.kind == shot.kind and shot.start - last.end < LONGEST_REST:
            joined[-1] = replace(last, end=shot.end)
        else:
            joined.append(shot)
    return [shot for shot in joined if shot.length >= LEAST_LENGTH or shot.kind == STOP]


def _with_stops(shots: Sequence[Shot]) -> list[Shot]:
    result: list[Shot] = []
    for shot in shots:
        if shot.kind != STOP:
            result.append(shot)
            continue
        before = result.pop() if result and result[-1].end >= shot.start - 1e-6 else None
        if before is None:
            continue
        start = max(before.start, shot.start - RUN_UP)
        if before.kind == STOP:
            result.append(replace(before, end=min(shot.end, shot.start + STOP_SHOWN)))
            continue
        if start - before.start > LEAST_LENGTH:
            result.append(replace(before, end=start))
        result.append(Shot(STOP, start, min(shot.end, shot.start + STOP_SHOWN)))
    return result


def _paced(shots: Sequence[Shot], duration: float) -> list[Shot]:
    def at(speed: float) -> list[Shot]:
        return [replace(s, speed=max(1.0, min(speed, s.length / LEAST_ON_SCREEN))) for s in shots]

    low, high = 1.0, 1000.0
    for _ in range(_HALVINGS):
        middle = (low * high) ** 0.5
        too_long = sum(shot.on_screen for shot in at(middle)) > duration
        low, high = (middle, high) if too_long else (low, middle)
    return at(high)
