"""Station keeping: meet a station beside a moving leader, keep it, and leave it, within limits.

The reference continues from tick to tick, whatever the leader's odometry does. Its velocity is
that of the station plus an approach velocity along the way to it, around the leader; a limiter of
velocity, acceleration and jerk leads to it. So the first approach, noise, a leader that turns or
stops and a station that is moved are one case.
"""

import math
from dataclasses import dataclass
from enum import Enum
from typing import Annotated

import numpy as np

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.limits import TwistLimiter, saturation
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.planar import Triple
from omniman_ros.core.validated import Validated
from omniman_ros.motion.path.pace import LEAD, Window
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.station.parameters import StationParameters

LEAVING = 2.0  #: Multiple of the tolerances above which a kept station counts as approached again
Vector = tuple[float, float]  #: A vector in the plane [m] or [m/s]


class StationState(Enum):
    """State of station keeping."""

    IDLE = "idle"
    APPROACHING = "approaching"
    KEEPING = "keeping station"
    WAITING = "waiting for the leader"
    BRAKING = "braking"


@dataclass(frozen=True)
class Leader(Validated):
    """The leader at the time of a measurement; its twist is taken to be constant from then on."""

    time: float  #: Time of the measurement [s]
    pose: Triple  #: Pose of its base_link in odom of the follower [m, m, rad]
    twist: Annotated[Array, Shape(3)]  #: Twist (3,) in its base_link [m/s, m/s, rad/s]

    def predicted_pose(self, time: float) -> Triple:
        """Return the pose at a time [s], in odom of the follower [m, m, rad]."""
        return se2.compose(self.pose, se2.arc(self.twist * (time - self.time)))

    def station(self, offset: Triple, time: float) -> tuple[Triple, Triple]:
        """Return pose and velocity of a station at a time, in odom of the follower.

        A station at (a, b) in base_link of the leader, whose twist is (x', y', theta'), moves
        at (x' - theta' b, y' + theta' a, theta') there.

        Returns:
            Pose [m, m, rad], whose heading is not wrapped, and velocity [m/s, m/s, rad/s].
        """
        pose = self.predicted_pose(time)
        x_rate, y_rate, yaw_rate = self.twist.tolist()
        ux, uy = x_rate - yaw_rate * offset[1], y_rate + yaw_rate * offset[0]
        c, s = math.cos(pose[2]), math.sin(pose[2])
        return se2.compose(pose, offset), (c * ux - s * uy, s * ux + c * uy, yaw_rate)


def approach_speed(distance: float, gain: float, deceleration: float) -> float:
    """Return the speed with which to close a distance, of the distance's sign.

    It is proportional to small distances, and the square root that a constant deceleration gives
    for larger ones; both have the same slope where they meet.

    Args:
        distance: Distance [m or rad].
        gain: Slope for small distances [1/s].
        deceleration: Deceleration for larger ones [m/s^2 or rad/s^2].
    """
    proportional = deceleration / gain**2
    if abs(distance) <= proportional:
        return gain * distance
    speed = math.sqrt(2.0 * deceleration * (abs(distance) - 0.5 * proportional))
    return math.copysign(speed, distance)


def path_around(start: Vector, goal: Vector, radius: float) -> tuple[float, Vector]:
    """Return the shortest way to a goal around a disc at the origin.

    Args:
        start: Place at which the way starts [m]; inside the disc, it starts as a tangent there.
        goal: Place at which it ends [m], outside of the disc or on its edge.

    Returns:
        Length of the way [m], and its direction at the start: a unit vector, zero at the goal.
    """
    dx, dy = goal[0] - start[0], goal[1] - start[1]
    length = math.hypot(dx, dy)
    if length == 0.0:
        return 0.0, (0.0, 0.0)
    nearest = -(start[0] * dx + start[1] * dy) / length
    miss = abs(start[0] * dy - start[1] * dx) / length
    if miss >= radius or not 0.0 < nearest < length:
        return length, (dx / length, dy / length)
    from_start, from_goal = max(math.hypot(*start), radius), max(math.hypot(*goal), radius)
    cross = start[0] * goal[1] - start[1] * goal[0]
    dot = start[0] * goal[0] + start[1] * goal[1]
    arc = math.atan2(abs(cross), dot)
    arc -= math.acos(radius / from_start) + math.acos(radius / from_goal)
    straight = math.sqrt(from_start**2 - radius**2) + math.sqrt(from_goal**2 - radius**2)
    tangent = math.copysign(math.asin(radius / from_start), -cross)
    heading = math.atan2(-start[1], -start[0]) + tangent
    return straight + radius * max(arc, 0.0), (math.cos(heading), math.sin(heading))


class StationKeeper:
    """Generates the reference of a robot that keeps a station relative to a leader.

    Attributes:
        reason: Why the station was given up last; empty if it was not.
        offset: Pose of the station in base_link of the leader [m, m, rad].
        error: Error (3,) of the robot relative to the station in odom, both as measured
            [m, m, rad]; NaN before the first.
        limit_scale: Fraction (0, 1] of the limits that is left without a dead wheel.
    """

    def __init__(self, parameters: StationParameters) -> None:
        self.state = StationState.IDLE
        self.reason = ""
        self.offset: Triple = (0.0, 0.0, 0.0)
        self.error: Array = np.full(3, np.nan)
        self.limit_scale = 1.0
        self._leader: Leader | None = None
        self._reference = _at_rest(0.0, np.zeros(3))
        self.configure(parameters)

    def configure(self, parameters: StationParameters) -> None:
        """Set new parameters, which apply from the next tick on."""
        self._parameters = parameters
        self._limiter = TwistLimiter(parameters.usable_limits(self.limit_scale))
        self._wheels = PlatformKinematics(parameters.robot.wheels).J
        reserve = parameters.station.reserve
        self._max_wheel_speed = (1.0 - reserve) * parameters.robot.motor.max_speed

    def scale_limits(self, scale: float) -> None:
        """Use a fraction (0, 1] of the limits from the next tick on."""
        self.limit_scale = scale
        self.configure(self._parameters)

    @property
    def end(self) -> float:
        """Time up to which there is a reference [s]."""
        return float(self._reference.times[-1])

    @property
    def stop_time(self) -> float:
        """Longest time that coming to rest within the limits takes [s]."""
        limits = self._limiter.limits
        pairs = zip(limits.velocity, limits.deceleration, limits.jerk, strict=True)
        return max(velocity / rate + rate / jerk for velocity, rate, jerk in pairs)

    def update_leader(self, time: float, pose: Triple, twist: Array) -> None:
        """Take over the odometry of the leader; what is not newer than the last is ignored.

        A pose that jumps makes the robot give the station up, as its place is in doubt.

        Args:
            pose: Pose of its base_link in its odom [m, m, rad].
            twist: Twist (3,) in its base_link [m/s, m/s, rad/s].
        """
        options, last = self._parameters.leader, self._leader
        if last is not None and time <= last.time:
            return
        self._leader = Leader(time, se2.compose(options.odom, pose), twist)
        if last is None or time - last.time > options.timeout:
            return
        x, y, angle = _difference(self._leader.pose, last.predicted_pose(time))
        if math.hypot(x, y) > options.max_position_jump or abs(angle) > options.max_heading_jump:
            self.give_up(f"the leader's pose jumped by {math.hypot(x, y):.2f} m, {angle:.2f} rad")

    def forget_leader(self) -> None:
        """Forget the odometry of the leader, because time went back."""
        self._leader = None

    def leader_silence(self, now: float) -> float:
        """Return the age of the leader's odometry [s]; infinite if there is none."""
        return math.inf if self._leader is None else now - self._leader.time

    def keep(self, offset: Triple, pose: Triple, now: float) -> None:
        """Approach a station and keep it, from rest or in place of another station.

        Args:
            pose: Measured pose of the robot in odom [m, m, rad]; without a motion under way, the
                robot must be at rest there.

        Raises:
            InputError: The leader is unknown, or the station is too far away.
        """
        leader, options = self._leader, self._parameters.station
        if leader is None or self.leader_silence(now) > self._parameters.leader.timeout:
            raise InputError("there is no recent leader/odom")
        x, y, _ = _difference(leader.station(offset, now)[0], pose)
        if math.hypot(x, y) > options.max_distance:
            raise InputError(
                f"the station is {math.hypot(x, y):.2f} m away, at most "
                f"{options.max_distance:g} m are allowed"
            )
        if self.state is StationState.IDLE:
            self._reference = _at_rest(now, np.array(pose))
        self.offset, self.reason = offset, ""
        self.state = StationState.APPROACHING

    def release(self) -> None:
        """Leave the station: come to rest as soon as the limits allow."""
        if self.state is not StationState.IDLE:
            self.state = StationState.BRAKING

    def give_up(self, reason: str) -> None:
        """Leave the station, for a reason."""
        if self.state not in (StationState.IDLE, StationState.BRAKING):
            self.reason = reason
            self.release()

    def abort(self, reason: str) -> None:
        """Forget the station at once, as something else drives or nothing may move."""
        self.state, self.reason = StationState.IDLE, reason

    def update(self, pose: Triple, time: float, now: float) -> None:
        """Update error and state with a pose that was measured at `time` [s].

        Args:
            pose: Measured pose of the robot in odom [m, m, rad].
        """
        if self._leader is not None:
            self.error = _difference(pose, self._leader.station(self.offset, time)[0])
        if self.state is StationState.BRAKING:
            if not self._reference.velocities.any():
                self.state = StationState.IDLE
        elif self.state is not StationState.IDLE:
            self._judge(now)

    def _judge(self, now: float) -> None:
        options = self._parameters.station
        distance, angle = math.hypot(self.error[0], self.error[1]), abs(float(self.error[2]))
        factor = LEAVING if self.state is StationState.KEEPING else 1.0
        if self.leader_silence(now) > self._parameters.leader.timeout:
            self.state = StationState.WAITING
        elif distance > options.max_distance:
            self.give_up(f"the station is {distance:.2f} m away")
        elif (
            max(distance / options.position_tolerance, angle / options.heading_tolerance) > factor
        ):
            self.state = StationState.APPROACHING
        else:
            self.state = StationState.KEEPING

    def window(self, now: float, horizon: float) -> Window | None:
        """Return the reference from now on for `horizon` [s], at least two ticks; None if idle."""
        if self.state is StationState.IDLE:
            return None
        old, count = self._reference, max(int(horizon / TICK), 1) + 1
        first = min(max(int((now - old.times[0]) / TICK + 1e-6), 0), len(old.times) - 1)
        kept = slice(first, first + LEAD + 1)
        times = old.times[first] + TICK * np.arange(count)
        rows = [
            list(part[kept][:count]) for part in (old.positions, old.velocities, old.accelerations)
        ]
        self._limiter.restart(rows[2][-1])
        leader = self._followed_leader()
        for time in times[len(rows[0]) :].tolist():
            self._append_tick(rows, leader, time - TICK)
        self._reference = Window(times, *map(np.array, rows))
        return self._reference

    def _followed_leader(self) -> Leader | None:
        resting = self.state in (StationState.BRAKING, StationState.WAITING)
        return None if resting else self._leader

    def _append_tick(self, rows: list[list[Array]], leader: Leader | None, time: float) -> None:
        position, velocity = rows[0][-1], rows[1][-1]
        target = np.zeros(3)
        if leader is not None:
            target = self._target_velocity(leader, position, time)
        new = self._limiter.step(velocity, target, TICK)
        rows[0].append(position + 0.5 * TICK * (velocity + new))
        rows[1].append(new)
        rows[2].append((new - velocity) / TICK)

    def _target_velocity(self, leader: Leader, position: Array, time: float) -> Array:
        """Return the velocity (3,) that leads from a pose (3,) to the station [m/s, rad/s]."""
        x, y, theta = position.tolist()
        station, velocity = leader.station(self.offset, time)
        center, center_velocity = leader.station((0.0, 0.0, 0.0), time)
        limits, gain = self._limiter.limits, self._parameters.station.gain
        ux, uy = self._approach(
            (x - center[0], y - center[1]),
            (station[0] - center[0], station[1] - center[1]),
            (velocity[0] - center_velocity[0], velocity[1] - center_velocity[1]),
        )
        turn = approach_speed(
            se2.wrap(station[2] - theta), gain, 0.5 * limits.angular_deceleration
        )
        target = np.array([center_velocity[0] + ux, center_velocity[1] + uy, velocity[2] + turn])
        wheels = self._wheels @ se2.to_robot(theta, target)
        limited: Array = target * saturation(wheels, self._max_wheel_speed)
        return limited

    def _approach(self, place: Vector, station: Vector, velocity: Vector) -> Vector:
        """Return the velocity relative to the leader with which to approach the station [m/s].

        It closes in on the disc around the leader only as fast as it could stop there.

        Args:
            place: Place relative to the leader, in directions of odom [m].
            station: Place of the station, likewise [m].
            velocity: Velocity of the station relative to the leader [m/s].
        """
        gain, deceleration = (
            self._parameters.station.gain,
            0.5 * self._limiter.limits.deceleration[0],
        )
        radius = min(self._parameters.least_distance, math.hypot(*station))
        length, direction = path_around(place, station, radius)
        speed = approach_speed(length, gain, deceleration)
        ux, uy = velocity[0] + speed * direction[0], velocity[1] + speed * direction[1]
        distance = math.hypot(*place)
        if distance == 0.0:
            return ux, uy
        nx, ny = place[0] / distance, place[1] / distance
        allowed = approach_speed(distance - radius, gain, deceleration)
        excess = max(-(ux * nx + uy * ny) - allowed, 0.0)
        return ux + excess * nx, uy + excess * ny


def _at_rest(time: float, pose: Array) -> Window:
    rest = np.zeros((1, 3))
    return Window(np.array([time]), pose[None, :], rest, rest)


def _difference(pose: Triple, other: Triple) -> Array:
    return np.array([pose[0] - other[0], pose[1] - other[1], se2.wrap(pose[2] - other[2])])
