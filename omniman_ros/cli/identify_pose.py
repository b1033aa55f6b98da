"""Where the robot stands after a run: typed in by the user, or from a topic."""

import math
import os
import select
import sys
from collections.abc import Callable
from typing import Protocol

from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.figures import Triple
from omniman_ros.cli.terminal import say

FARTHEST = 100.0
"""Largest coordinate that is taken for metres [m]."""
SURPRISE_XY, SURPRISE_HEADING = 0.3, math.radians(15.0)
"""Difference to the odometry from which a typed pose is asked for again [m, rad]."""
FORMAT = "x y heading, in metres and degrees, as in: 0.853 -0.012 179.5"


class Typo(ValueError):
    """What was typed is no pose; the message says why."""


def parse_pose(text: str) -> Triple | None:
    """Pose [m, m, rad] from what was typed; None for `skip`.

    Raises:
        Typo: It is neither.
    """
    if text.strip().lower() == "skip":
        return None
    words = text.replace(";", " ").split()
    if len(words) != 3:
        raise Typo(f"{len(words)} words, expected three numbers: {FORMAT}")
    values = []
    for word in words:
        if "," in word:
            raise Typo(f"'{word}': write a point, and blanks between the numbers: {FORMAT}")
        try:
            value = float(word)
        except ValueError:
            raise Typo(f"'{word}' is not a number: {FORMAT}") from None
        if not math.isfinite(value):
            raise Typo(f"'{word}' is not a finite number: {FORMAT}")
        values.append(value)
    x, y, degrees = values
    if max(abs(x), abs(y)) > FARTHEST:
        raise Typo(f"{x:g} {y:g}: metres, not millimetres")
    if abs(degrees) > 36000.0:
        raise Typo(f"{degrees:g} degrees is too much")
    return x, y, math.radians(degrees)


def surprise(typed: Triple, expected: Triple) -> str:
    """Why a typed pose is hard to believe, or an empty string."""
    away = math.hypot(typed[0] - expected[0], typed[1] - expected[1])
    turned = abs(math.remainder(typed[2] - expected[2], math.tau))
    if away <= SURPRISE_XY and turned <= SURPRISE_HEADING:
        return ""
    return (
        f"odometry says {expected[0]:.3f} {expected[1]:.3f} "
        f"{math.degrees(math.remainder(expected[2], math.tau)):.1f}, {away:.2f} m and "
        f"{math.degrees(turned):.0f} degrees from that"
    )


class PoseSource(Protocol):
    """Measures where the robot stands."""

    def start(self) -> Triple:
        """Pose on the floor before the first run [m, m, rad]."""

    def measure(self, run: str, expected: Triple) -> Triple | None:
        """Pose on the floor after a run; None to do without.

        Args:
            run: Its name.
            expected: Pose by odometry.
        """


class Lines:
    """Lines from a file descriptor, without waiting for more than is there."""

    def __init__(self, file: int) -> None:
        self._file = file
        self._text = ""
        self._ended = False

    def next(self, wait: Callable[[], None]) -> str:
        """The next line, without its end; calls `wait` again and again until there is one.

        Raises:
            CommandError: There will be none.
        """
        while "\n" not in self._text:
            if self._ended:
                raise CommandError("no more input: the poses cannot be typed in")
            wait()
            if select.select([self._file], [], [], 0.0)[0]:
                data = os.read(self._file, 4096)
                self._ended = not data
                self._text += data.decode(errors="replace")
        line, _, self._text = self._text.partition("\n")
        return line.rstrip("\r")


class TypedPoses:
    """Asks the user.

    Args:
        lines: What the user types.
        wait: Serves everything else for a moment; raises to end.
    """

    def __init__(self, lines: Lines, wait: Callable[[], None]) -> None:
        self._lines = lines
        self._wait = wait

    def start(self) -> Triple:
        """The origin: the user has marked it."""
        return 0.0, 0.0, 0.0

    def measure(self, run: str, expected: Triple) -> Triple | None:
        """Ask until it is a pose or `skip`; what is far from the odometry is asked for twice."""
        doubted: Triple | None = None
        while True:
            say(f"  where is it after '{run}'? {FORMAT}; or: skip")
            sys.stdout.flush()
            try:
                pose = parse_pose(self._lines.next(self._wait))
            except Typo as error:
                say(f"    {error}")
                continue
            doubt = surprise(pose, expected) if pose is not None else ""
            if pose is None or not doubt or pose == doubted:
                return pose
            doubted = pose
            say(f"    {doubt}. If it is right, type the same again.")


def floor_pose(origin: Triple, pose: Triple) -> Triple:
    """A pose in the frame of the origin, the heading within half a turn."""
    c, s = math.cos(origin[2]), math.sin(origin[2])
    dx, dy = pose[0] - origin[0], pose[1] - origin[1]
    return c * dx + s * dy, -s * dx + c * dy, math.remainder(pose[2] - origin[2], math.tau)


class TopicPoses:
    """Takes them from a topic: a motion-capture system, or the simulation.

    Args:
        topic: Its name, for messages.
        at_rest: Gives the mean of some messages while the robot stands, or None if none came.
    """

    def __init__(self, topic: str, at_rest: Callable[[], Triple | None]) -> None:
        self._topic = topic
        self._at_rest = at_rest
        self.origin: Triple | None = None

    def _pose(self) -> Triple:
        pose = self._at_rest()
        if pose is None:
            raise CommandError(f"nothing heard on '{self._topic}' while the robot stood")
        return pose

    def start(self) -> Triple:
        """The origin is where the robot is now."""
        self.origin = self._pose()
        return 0.0, 0.0, 0.0

    def measure(self, run: str, expected: Triple) -> Triple | None:
        """The pose now."""
        assert self.origin is not None
        return floor_pose(self.origin, self._pose())
