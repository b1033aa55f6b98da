"""What is driven to calibrate the odometry: runs within a square, and a path to check the result.

The floor's frame has its origin and its x axis where base_link is at the start, in the middle of
the square. A run goes straight to a corner and then turns on the spot by half a turn. So, without
a measurement more, the twelve runs drive each side and both diagonals of the square in several
directions of the robot, and show where the centre of a turn is, which a whole turn would not.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.figures import Sample, Triple
from omniman_ros.core.limits import TwistLimits
from omniman_ros.core.robot import Body

SLACK = 0.1
"""Room that is left to the edge of the square, over the reach: the longest run is 2.8 times the
reach, and an odometry that is not calibrated is off by some per cent of it."""
LEAST_REACH = 0.25
"""Least way of base_link from the middle to a side that is worth driving [m]."""
RAMP = 1.0
"""Least time from rest to full speed [s]."""


CORNERS = {
    "front left": (1, 1), "back left": (-1, 1), "back right": (-1, -1), "front right": (1, -1),
    "middle": (0, 0),
}  # fmt: skip
"""Where runs end, over the reach; front and left as seen at the start."""


@dataclass(frozen=True)
class Target:
    """Where a run ends.

    Attributes:
        corner: A name in CORNERS.
        turn: By how much it turns on the spot there [rad].
    """

    corner: str
    turn: float


ROUND = (
    "front left", "back left", "back right", "front right", "back left", "front left",
    "front right", "back right", "back left", "front right", "front left", "middle",
)  # fmt: skip
TARGETS = tuple(
    Target(corner, math.pi if i % 4 < 2 else -math.pi) for i, corner in enumerate(ROUND)
)
"""The runs; turns to the left and to the right come in pairs, the last ends as it began."""


@dataclass(frozen=True)
class Speeds:
    """How fast: speed [m/s], yaw rate [rad/s], and time from rest to them [s]."""

    linear: float
    angular: float
    ramp: float

    @classmethod
    def within(cls, limits: TwistLimits, linear: float) -> "Speeds":
        """A speed that the user asks for, with the rest from the robot's limits.

        Raises:
            CommandError: It is faster than 70 % of the limit, or not above 0.
        """
        fastest = 0.7 * limits.linear_velocity
        if not 0.0 < linear <= fastest:
            raise CommandError(
                f"--speed must be above 0 and at most {fastest:g} m/s, 70 % of the robot's "
                f"limits.linear_velocity, got {linear:g}", 2,
            )  # fmt: skip
        angular = min(2.0 * linear, 0.5 * limits.angular_velocity)
        # A smoothstep of degree 5 is 1.875 times as steep as the straight line.
        ramp = 1.875 / 0.8 * max(
            linear / min(limits.linear_acceleration, limits.linear_deceleration),
            angular / min(limits.angular_acceleration, limits.angular_deceleration),
        )  # fmt: skip
        return cls(linear, angular, max(RAMP, ramp))


def reach_in(area: float, body: Body) -> float:
    """How far base_link may be from the middle, ahead and to the side, in a square [m].

    Args:
        area: Side of the square; the robot stays in it whichever way it is turned [m].
        body: Its size.

    Raises:
        CommandError: The square is too small.
    """
    radius = 0.5 * math.hypot(body.length, body.width)
    reach = (0.5 * area - radius) / (1.0 + SLACK)
    if not reach >= LEAST_REACH:
        least = 2.0 * (radius + (1.0 + SLACK) * LEAST_REACH)
        raise CommandError(
            f"--area {area:g} is too small for a robot of {body.length:g} m by {body.width:g} m: "
            f"at least {math.ceil(10.0 * least) / 10.0:g}", 2,
        )  # fmt: skip
    return reach


class Glide:
    """Progress from 0 to 1 from rest to rest; its rate rises and falls as a quintic smoothstep.

    Args:
        rate: Largest rate [1/s].
        ramp: Time from rest to it, and back [s].
    """

    def __init__(self, rate: float, ramp: float) -> None:
        self._rate = min(rate, 1.0 / ramp)
        self._ramp = ramp
        self.duration = 1.0 / self._rate + ramp

    def sample(self, time: float) -> Triple:
        """Progress, its rate [1/s] and its acceleration [1/s^2] at a time [s]."""
        t = min(max(time, 0.0), self.duration)
        if t > 0.5 * self.duration:
            s, rate, bend = self.sample(self.duration - t)
            return 1.0 - s, rate, -bend
        if t >= self._ramp:
            return self._rate * (t - 0.5 * self._ramp), self._rate, 0.0
        u = t / self._ramp
        area = u**4 * (2.5 + u * (u - 3.0))
        height = u**3 * (10.0 + u * (6.0 * u - 15.0))
        slope = 30.0 * u * u * (1.0 - u) ** 2
        return self._rate * self._ramp * area, self._rate * height, self._rate / self._ramp * slope


Shape = Callable[[float], tuple[Triple, Triple, Triple]]
"""Progress from 0 to 1 to a pose, and its first and second derivatives by progress."""


class Motion:
    """A drive along a shape, from rest to rest.

    Args:
        shape: In the frame of `start`.
        start: Pose in odom where the shape's frame is.
        speeds: Largest speed and yaw rate on it.
    """

    def __init__(self, shape: Shape, start: Triple, speeds: Speeds) -> None:
        self._shape = shape
        self._start = start
        slopes = [shape(i / 200.0)[1] for i in range(201)]
        linear = max(math.hypot(x, y) for x, y, _ in slopes) / speeds.linear
        angular = max(abs(turn) for _, _, turn in slopes) / speeds.angular
        self._glide = Glide(1.0 / max(linear, angular, 1e-3), speeds.ramp)
        self.duration = self._glide.duration

    def sample(self, time: float) -> Sample:
        """The reference in odom `time` seconds after the start."""
        s, rate, bend = self._glide.sample(time)
        pose, first, second = self._shape(s)
        dx, dy, turn = self._turned(pose)
        x, y, theta = self._start
        bent = tuple(q * rate * rate + p * bend for p, q in zip(first, second, strict=True))
        moving = tuple(p * rate for p in first)
        return Sample((x + dx, y + dy, theta + turn), self._turned(moving), self._turned(bent))

    def _turned(self, vector: tuple[float, ...]) -> Triple:
        c, s = math.cos(self._start[2]), math.sin(self._start[2])
        x, y, angle = vector
        return c * x - s * y, s * x + c * y, angle


def straight(way: Triple) -> Shape:
    """Straight to a pose (x, y, turn), turning evenly on the way."""
    x, y, turn = way
    return lambda s: ((s * x, s * y, s * turn), way, (0.0, 0.0, 0.0))


def check_curve(reach: float) -> Shape:
    """The path that nothing is fitted to: curved, turning by 1.5 pi, and it ends elsewhere.

    x = a sin(5/2 pi s), y = -a sin(pi s)^2, theta = 3/2 pi s.
    """

    def shape(s: float) -> tuple[Triple, Triple, Triple]:
        w, u = 2.5 * math.pi, math.pi
        return (
            (reach * math.sin(w * s), -reach * math.sin(u * s) ** 2, 1.5 * math.pi * s),
            (reach * w * math.cos(w * s), -reach * u * math.sin(2 * u * s), 1.5 * math.pi),
            (-reach * w * w * math.sin(w * s), -2 * reach * u * u * math.cos(2 * u * s), 0.0),
        )

    return shape


def way_to(here: Triple, heading: float, corner: str, reach: float) -> Triple:
    """What to drive from a pose on the floor to a corner, in the robot's frame there.

    Args:
        here: Pose on the floor; the heading may be wrapped.
        heading: Heading to arrive with.
        corner: A name in CORNERS.
        reach: See :func:`reach_in`.

    Returns:
        x, y [m] and turn [rad] in base_link as it stands.
    """
    x, y = CORNERS[corner]
    c, s = math.cos(here[2]), math.sin(here[2])
    dx, dy = reach * x - here[0], reach * y - here[1]
    return c * dx + s * dy, -s * dx + c * dy, math.remainder(heading - here[2], math.tau)
