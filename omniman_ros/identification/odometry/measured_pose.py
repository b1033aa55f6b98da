"""Measured poses of the robot after a run: typed in by the user, or from a topic."""

import math
import sys
from collections.abc import Callable
from typing import Protocol

from omniman_ros.console.errors import CommandError
from omniman_ros.console.terminal import say
from omniman_ros.core.planar import Triple
from omniman_ros.identification.line_reader import LineReader

MAX_COORDINATE = 100.0  #: Largest coordinate that is accepted as metres [m]
MAX_DEGREES = 36000.0  #: Largest heading that is accepted [degrees]
MAX_POSITION_DEVIATION = 0.3  #: Distance from which a typed pose must be confirmed [m]
#: Heading difference from the odometry above which the user must confirm a typed pose [rad]
MAX_HEADING_DEVIATION = math.radians(15.0)
#: Description of the input that is expected
FORMAT = "x y heading, in metres and degrees, as in: 0.853 -0.012 179.5"


class TypedPoseError(ValueError):
    """The text that the user typed is not a pose; the message gives the reason."""


def parse_pose(text: str) -> Triple | None:
    """Parse a pose that the user typed.

    Returns:
        The pose [m, m, rad], or None if the text is `skip`.

    Raises:
        TypedPoseError: The text is neither a pose nor `skip`.
    """
    if text.strip().lower() == "skip":
        return None
    words = text.replace(";", " ").split()
    if len(words) != 3:
        raise TypedPoseError(f"{len(words)} words, expected three numbers: {FORMAT}")
    x, y, degrees = map(_parse_number, words)
    if max(abs(x), abs(y)) > MAX_COORDINATE:
        raise TypedPoseError(f"{x:g} {y:g}: metres, not millimetres")
    if abs(degrees) > MAX_DEGREES:
        raise TypedPoseError(f"{degrees:g} degrees is too much")
    return x, y, math.radians(degrees)


def _parse_number(word: str) -> float:
    if "," in word:
        raise TypedPoseError(f"'{word}': write a point, and blanks between the numbers: {FORMAT}")
    try:
        value = float(word)
    except ValueError:
        raise TypedPoseError(f"'{word}' is not a number: {FORMAT}") from None
    if not math.isfinite(value):
        raise TypedPoseError(f"'{word}' is not a finite number: {FORMAT}")
    return value


def describe_deviation(typed: Triple, expected: Triple) -> str:
    """Describe the deviation of a typed pose from the odometry's; empty if it is small.

    Args:
        typed: Pose that the user typed [m, m, rad].
        expected: Pose by the odometry [m, m, rad].
    """
    distance = math.hypot(typed[0] - expected[0], typed[1] - expected[1])
    angle = abs(math.remainder(typed[2] - expected[2], math.tau))
    if distance <= MAX_POSITION_DEVIATION and angle <= MAX_HEADING_DEVIATION:
        return ""
    return (
        f"odometry says {expected[0]:.3f} {expected[1]:.3f} "
        f"{math.degrees(math.remainder(expected[2], math.tau)):.1f}, {distance:.2f} m and "
        f"{math.degrees(angle):.0f} degrees from that"
    )


class PoseSource(Protocol):
    """Measures the pose of the robot on the floor."""

    def start(self) -> Triple:
        """Return the pose before the first run [m, m, rad]."""

    def measure(self, run: str, expected: Triple) -> Triple | None:
        """Return the pose after a run [m, m, rad]; None if it was not measured."""


class TypedPoses:
    """Poses that the user measures and types."""

    def __init__(self, lines: LineReader, wait: Callable[[], None]) -> None:
        self._lines = lines
        self._wait = wait

    def start(self) -> Triple:
        """Return the origin, which the user has marked on the floor."""
        return 0.0, 0.0, 0.0

    def measure(self, run: str, expected: Triple) -> Triple | None:
        """Ask the user until the input is a pose or `skip`.

        A pose that is far from the odometry's is accepted only if it is typed twice.

        Raises:
            CommandError: The input has ended.
        """
        doubted: Triple | None = None
        while True:
            say(f"  Where is the robot after '{run}'? {FORMAT}; or: skip")
            sys.stdout.flush()
            try:
                pose = parse_pose(self._lines.next(self._wait))
            except TypedPoseError as error:
                say(f"    {error}")
                continue
            doubt = describe_deviation(pose, expected) if pose is not None else ""
            if pose is None or not doubt or pose == doubted:
                return pose
            doubted = pose
            say(f"    {doubt}. If it is right, type the same again.")


def floor_pose(origin: Triple, pose: Triple) -> Triple:
    """Return a pose [m, m, rad] in the frame of the origin; its heading is wrapped."""
    c, s = math.cos(origin[2]), math.sin(origin[2])
    dx, dy = pose[0] - origin[0], pose[1] - origin[1]
    return c * dx + s * dy, -s * dx + c * dy, math.remainder(pose[2] - origin[2], math.tau)


class TopicPoses:
    """Poses from a topic: of a motion-capture system, or of the simulation.

    Args:
        topic: Name of the topic, for messages.
        pose_at_rest: Returns the mean of some messages while the robot is at rest, or None if
            none was received.
    """

    def __init__(self, topic: str, pose_at_rest: Callable[[], Triple | None]) -> None:
        self._topic = topic
        self._pose_at_rest = pose_at_rest
        self.origin: Triple | None = None  #: Pose of the floor's frame; None until `start`

    def _pose(self) -> Triple:
        pose = self._pose_at_rest()
        if pose is None:
            raise CommandError(f"nothing received on '{self._topic}' while the robot stood")
        return pose

    def start(self) -> Triple:
        """Make the current pose the origin of the floor's frame."""
        self.origin = self._pose()
        return 0.0, 0.0, 0.0

    def measure(self, run: str, expected: Triple) -> Triple | None:
        """Return the current pose on the floor."""
        assert self.origin is not None
        return floor_pose(self.origin, self._pose())
