"""The drives that calibrate the odometry: runs within a square, and a path to check the result.

The floor's frame has its origin and its x axis at base_link's initial pose, in the middle of the
square. In a run, the robot drives straight to a corner and then rotates in place by pi. Thus the
twelve runs, without further measurements, cover each side and both diagonals of the square in
several directions of the robot, and they reveal the centre of rotation, which a full revolution
would not.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from omniman_ros.console.errors import CommandError
from omniman_ros.control.limits import TwistLimits
from omniman_ros.core.planar import PlanarSample, Triple
from omniman_ros.core.platform import Body

#: Ratio of the distance that is kept from the edge of the square to the reach. The longest run is
#: 2.8 times the reach, and uncalibrated odometry has an error of a few per cent of it.
MARGIN = 0.1
MIN_SIDE_DISTANCE = 0.25  #: Smallest useful distance of base_link from the middle to a side [m]
MIN_RAMP_TIME = 1.0  #: Shortest time from rest to full speed [s]
MAX_SPEED_FRACTION = 0.7  #: Largest speed that the user may choose, over the robot's limit
ANGULAR_SPEED_FRACTION = 0.5  #: Largest yaw rate of the runs, over the robot's limit
ACCELERATION_FRACTION = 0.8  #: Largest acceleration of the runs, over the robot's limit
SMOOTHSTEP_SLOPE = 1.875  #: Largest slope of a quintic smoothstep, over the straight line's


CORNERS = {
    "front left": (1, 1),
    "back left": (-1, 1),
    "back right": (-1, -1),
    "front right": (1, -1),
    "middle": (0, 0),
}  #: Ends of the runs, over the reach; front and left as seen from the initial pose


@dataclass(frozen=True)
class RunTarget:
    """The end of a run."""

    corner: str  #: Name of the corner, a key of `CORNERS`
    turn: float  #: Angle by which the robot rotates in place at the corner [rad]


CORNER_SEQUENCE = (
    "front left",
    "back left",
    "back right",
    "front right",
    "back left",
    "front left",
    "front right",
    "back right",
    "back left",
    "front right",
    "front left",
    "middle",
)  #: Corners in the order of the runs
#: The runs; rotations to the left and to the right come in pairs, and the last run ends at the
#: initial pose.
TARGETS = tuple(
    RunTarget(corner, math.pi if i % 4 < 2 else -math.pi)
    for i, corner in enumerate(CORNER_SEQUENCE)
)


@dataclass(frozen=True)
class Speeds:
    """The speeds of the drives."""

    linear: float  #: Largest speed [m/s]
    angular: float  #: Largest yaw rate [rad/s]
    ramp: float  #: Time from rest to these speeds [s]

    @classmethod
    def within(cls, limits: TwistLimits, linear: float) -> "Speeds":
        """Combine the speed that the user chose with a yaw rate and a ramp within the limits.

        Args:
            linear: Largest speed [m/s].

        Raises:
            CommandError: The speed is not above 0, or above 70 % of the limit.
        """
        fastest = MAX_SPEED_FRACTION * limits.linear_velocity
        if not 0.0 < linear <= fastest:
            raise CommandError(
                f"--speed must be above 0 and at most {fastest:g} m/s, 70 % of the robot's "
                f"limits.linear_velocity, got {linear:g}",
                2,
            )
        angular = min(2.0 * linear, ANGULAR_SPEED_FRACTION * limits.angular_velocity)
        ramp = (
            SMOOTHSTEP_SLOPE
            / ACCELERATION_FRACTION
            * max(
                linear / min(limits.linear_acceleration, limits.linear_deceleration),
                angular / min(limits.angular_acceleration, limits.angular_deceleration),
            )
        )
        return cls(linear, angular, max(MIN_RAMP_TIME, ramp))


def max_reach(area: float, body: Body) -> float:
    """Return the largest distance of base_link from the middle of a square along each side [m].

    Args:
        area: Side of the square, which the robot does not leave in any orientation [m].

    Raises:
        CommandError: The square is too small.
    """
    radius = 0.5 * math.hypot(body.length, body.width)
    reach = (0.5 * area - radius) / (1.0 + MARGIN)
    if not reach >= MIN_SIDE_DISTANCE:
        smallest = 2.0 * (radius + (1.0 + MARGIN) * MIN_SIDE_DISTANCE)
        raise CommandError(
            f"--area {area:g} is too small for a robot of {body.length:g} m by {body.width:g} m: "
            f"at least {math.ceil(10.0 * smallest) / 10.0:g}",
            2,
        )
    return reach


class SmoothProgress:
    """Progress from 0 to 1, from rest to rest; its rate rises and falls as a quintic smoothstep.

    Args:
        rate: Largest rate [1/s].
        ramp: Time from rest to this rate, and back to rest [s].
    """

    def __init__(self, rate: float, ramp: float) -> None:
        self._rate = min(rate, 1.0 / ramp)
        self._ramp = ramp
        self.duration = 1.0 / self._rate + ramp  #: Time from 0 to 1 [s]

    def sample(self, time: float) -> Triple:
        """Return the progress, its rate [1/s] and its acceleration [1/s^2] at a time [s]."""
        t = min(max(time, 0.0), self.duration)
        if t > 0.5 * self.duration:
            s, rate, acceleration = self.sample(self.duration - t)
            return 1.0 - s, rate, -acceleration
        if t >= self._ramp:
            return self._rate * (t - 0.5 * self._ramp), self._rate, 0.0
        u = t / self._ramp
        area = u**4 * (2.5 + u * (u - 3.0))
        height = u**3 * (10.0 + u * (6.0 * u - 15.0))
        slope = 30.0 * u * u * (1.0 - u) ** 2
        return self._rate * self._ramp * area, self._rate * height, self._rate / self._ramp * slope


#: A path: maps progress from 0 to 1 to a pose and its first and second derivatives by progress
Shape = Callable[[float], tuple[Triple, Triple, Triple]]


class CalibrationMotion:
    """A drive along a path, which is in the frame of a start in odom, from rest to rest.

    Args:
        start: Pose of this frame in odom [m, m, rad].
    """

    def __init__(self, shape: Shape, start: Triple, speeds: Speeds) -> None:
        self._shape = shape
        self._start = start
        slopes = [shape(i / 200.0)[1] for i in range(201)]
        linear = max(math.hypot(x, y) for x, y, _ in slopes) / speeds.linear
        angular = max(abs(rate) for _, _, rate in slopes) / speeds.angular
        self._progress = SmoothProgress(1.0 / max(linear, angular, 1e-3), speeds.ramp)
        self.duration = self._progress.duration  #: Duration of the drive [s]

    def sample(self, time: float) -> PlanarSample:
        """Return the reference in odom at a time after the start [s]."""
        s, rate, acceleration = self._progress.sample(time)
        pose, first, second = self._shape(s)
        dx, dy, dtheta = self._rotated(pose)
        x, y, theta = self._start
        velocity = tuple(p * rate for p in first)
        change = tuple(
            q * rate * rate + p * acceleration for p, q in zip(first, second, strict=True)
        )
        return PlanarSample(
            (x + dx, y + dy, theta + dtheta), self._rotated(velocity), self._rotated(change)
        )

    def _rotated(self, vector: tuple[float, ...]) -> Triple:
        c, s = math.cos(self._start[2]), math.sin(self._start[2])
        x, y, angle = vector
        return c * x - s * y, s * x + c * y, angle


def straight_shape(displacement: Triple) -> Shape:
    """Return the straight path to a pose (x [m], y [m], angle [rad]), with a constant yaw rate."""
    x, y, angle = displacement
    return lambda s: ((s * x, s * y, s * angle), displacement, (0.0, 0.0, 0.0))


def check_shape(reach: float) -> Shape:
    """Return the check path, to which no factor is fitted.

    It is curved, rotates by 1.5 pi, and does not end at its start:
    x = a sin(5/2 pi s), y = -a sin(pi s)^2, theta = 3/2 pi s, where a is the reach [m].
    """

    def shape(s: float) -> tuple[Triple, Triple, Triple]:
        w, u = 2.5 * math.pi, math.pi
        return (
            (reach * math.sin(w * s), -reach * math.sin(u * s) ** 2, 1.5 * math.pi * s),
            (reach * w * math.cos(w * s), -reach * u * math.sin(2 * u * s), 1.5 * math.pi),
            (-reach * w * w * math.sin(w * s), -2 * reach * u * u * math.cos(2 * u * s), 0.0),
        )

    return shape


def displacement_to(pose: Triple, heading: float, corner: str, reach: float) -> Triple:
    """Return the way from a pose to a corner and a heading, in the pose's frame [m, m, rad].

    Args:
        heading: Heading to arrive with [rad].
        reach: See :func:`max_reach` [m].
    """
    x, y = CORNERS[corner]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = reach * x - pose[0], reach * y - pose[1]
    return c * dx + s * dy, -s * dx + c * dy, math.remainder(heading - pose[2], math.tau)
