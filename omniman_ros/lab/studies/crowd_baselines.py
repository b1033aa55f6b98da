"""Published ways through a crowd, beside the planner: ORCA and a holonomic dynamic window.

Both know the true positions and velocities of all discs. Their robot is kinematic: it has the
velocity that they choose within the speeds, accelerations and decelerations of plans, and turns
to the heading of its goal meanwhile.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from omniman_ros.control.limits import slew
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.lab.studies.closed_loop import PERIOD
from omniman_ros.lab.studies.crowds import (
    CLEARANCE,
    HALF,
    RADIUS,
    DiscCrowd,
    disc_gaps,
    neighbours,
)
from omniman_ros.lab.studies.mpc_loop import PLANNER_PERIOD
from omniman_ros.planning.cycle import AT_REST
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.simulation.world.avoidance import DIRECTIONS, half_planes
from omniman_ros.simulation.world.velocity_program import HalfPlane, nearest_velocity

HORIZON = 1.5  #: how far ahead ORCA minds discs [s]; with more it gets nowhere
WALL_HORIZON = 0.8  #: how far ahead ORCA minds the edges of the square [s]
APPROACH = 3.0  #: speed over the distance of a goal that is near [1/s]
#: Candidates of the dynamic window: bearings from that of the goal [rad], shares of the speed
BEARINGS, SHARES = math.tau / 16 * np.arange(16), np.array([1.0, 2.0 / 3.0, 1.0 / 3.0])
STEP, STEPS, BRAKING_STEPS = 0.125, 20, 8  #: of the dynamic window [s], and their numbers
NEAREST = 10  #: number of discs that the dynamic window minds
ARRIVED = 0.1  #: distance from the goal at which a candidate has arrived [m]
#: Cost of the dynamic window [s]: of an early contact with its decay [s], of small gaps with
#: decays [m] and [s], of the mean distance over the speed, and of a turn back
CONTACT, CONTACT_TIME, GAP, GAP_LENGTH, GAP_TIME = 4.0, 1.0, 0.6, 0.15, 1.5
MEAN_DISTANCE, TURN_BACK = 0.3, 0.25

LINEAR: Array = np.array([1.0, 1.0, 0.0])  #: selects the linear part of a velocity
#: Function that is told pose (3,) and velocity (3,) of a robot in the world after each tick
OnTick = Callable[[Array, Array], None]


#: Function that returns the velocity (3,) of a robot in a crowd in the world [m/s, m/s, rad/s]
Method = Callable[["KinematicRobot", DiscCrowd], Array]


class KinematicRobot:
    """A robot that moves as a method chooses.

    Args:
        method: Function that returns the velocity (3,) in the world [m/s, m/s, rad/s].
        timer: Clock by which the method's answers take their time [s].
    """

    def __init__(
        self,
        parameters: PlannerParameters,
        method: "Method",
        crowd: DiscCrowd,
        timer: Callable[[], float],
        on_tick: OnTick,
    ) -> None:
        body, share = parameters.robot.body, 1.0 - parameters.reserve
        self.half: Array = np.array([body.length, body.width]) / 2.0  #: (2,) [m]
        limits = {name: share * value for name, value in vars(parameters.limits).items()}
        self.limits = replace(parameters.limits, **limits)
        self.pose: Array = np.zeros(3)  #: (3,) [m, m, rad]
        self.velocity: Array = np.zeros(3)  #: (3,) in the world [m/s, m/s, rad/s]
        self.wanted: Array = np.zeros(3)  #: velocity (3,) that was chosen last
        self.goal: Array = np.zeros(3)  #: (3,) [m, m, rad]
        self.cycle_times: list[float] = []  #: durations of the method's answers [s]
        self._ticks = 0
        self._arrival, self._method, self._crowd = parameters.arrival, method, crowd
        self._timer, self._on_tick = timer, on_tick

    @property
    def now(self) -> float:
        """Present time of the simulation [s]."""
        return self._ticks * PERIOD

    def reach(self, pose: Array, end: float) -> bool:
        """Drive to a pose (3,) until a time [s]; return whether the robot rests there."""
        self.goal = pose
        while self.now < end:
            self.cycle()
            x, y, angle = self._error()
            near = math.hypot(x, y) <= self._arrival.position
            turned = abs(angle) <= self._arrival.heading
            if near and turned and float(np.abs(self.velocity).max()) < AT_REST:
                return True
        return False

    def approach(self) -> Array:
        """Return the velocity (3,) straight to the goal from which the robot stops there."""
        x, y, angle = self._error()
        limits, left = self.limits, math.hypot(x, y)
        speed = _approach(left, limits.linear_velocity, limits.linear_deceleration)
        rate = _approach(abs(angle), limits.angular_velocity, limits.angular_deceleration)
        share = speed / max(left, 1e-9)
        return np.array([share * x, share * y, math.copysign(rate, angle)])

    def cycle(self) -> None:
        """Ask for a velocity, follow it once it is there, and go on until the next cycle."""
        begin = self._timer()
        wanted = self._method(self, self._crowd)
        self.cycle_times.append(self._timer() - begin)
        for tick in range(round(PLANNER_PERIOD / PERIOD)):
            if tick * PERIOD >= self.cycle_times[-1]:
                self.wanted = wanted
            self._step()

    def _error(self) -> tuple[float, float, float]:
        x, y, angle = (self.goal - self.pose).tolist()
        return x, y, se2.wrap(angle)

    def _step(self) -> None:
        linear, angular = (
            slew(part * self.velocity, part * self.wanted, self.limits, PERIOD)
            for part in (LINEAR, 1.0 - LINEAR)
        )
        self.velocity = linear + angular
        self.pose = self.pose + PERIOD * self.velocity
        self._ticks += 1
        self._on_tick(self.pose, self.velocity)


def _approach(left: float, limit: float, deceleration: float) -> float:
    return min(limit, math.sqrt(2.0 * deceleration * left), APPROACH * left)


def orca(robot: KinematicRobot, crowd: DiscCrowd) -> Array:
    """Return the velocity (3,) of ORCA; see :mod:`~omniman_ros.lab.studies.crowds`.

    The robot is its circumscribed circle, as it turns. It takes half of each avoidance.
    """
    place, radius = robot.pose[:2], float(np.hypot(*robot.half))
    supports = crowd.positions @ DIRECTIONS.T + RADIUS
    speeds = crowd.velocities
    around = neighbours(supports, speeds, speeds, radius + CLEARANCE, HORIZON)
    wish = robot.approach()
    planes = half_planes(place, robot.velocity[:2], wish[:2], around)
    x, y = place.tolist()
    walls: list[HalfPlane] = [
        (nx, ny, -(HALF - radius + nx * x + ny * y) / WALL_HORIZON)
        for nx, ny in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
    ]
    wanted = float(wish[0]), float(wish[1])
    chosen = nearest_velocity(wanted, robot.limits.linear_velocity, walls, planes)
    return np.array([*chosen, wish[2]])


def dynamic_window(robot: KinematicRobot, crowd: DiscCrowd) -> Array:
    """Return the velocity (3,) of least cost with which the robot can still stop, or else rest.

    Source: D. Fox, W. Burgard and S. Thrun, "The Dynamic Window Approach to Collision Avoidance"
    (1997), here with velocities in all directions, discs at constant velocity and a cost in time.
    A contact after a candidate has arrived does not count.
    """
    limits, before = robot.limits, robot.velocity[:2]
    wish = robot.approach()
    bearings = BEARINGS + math.atan2(wish[1], wish[0])
    speeds = limits.linear_velocity * SHARES[:, None]
    ahead = np.stack([speeds * np.cos(bearings), speeds * np.sin(bearings)], 2)
    ahead[:, 0] = SHARES[:, None] * wish[:2]  # straight to the goal: no faster than to stop there
    wanted = np.vstack([np.zeros((1, 2)), ahead.reshape(-1, 2)])

    # How the velocities (n, k, 2) change at the limits: towards the candidate; from there to rest
    times = STEP * np.arange(1, STEPS + 1)
    change = wanted - before
    need = np.hypot(*change.T)[:, None] / limits.linear_acceleration
    shares = np.minimum(times / np.maximum(need, 1e-9), 1.0)
    velocities = before + shares[:, :, None] * change[:, None]
    first = velocities[:, :1]
    need = np.hypot(first[..., 0], first[..., 1]) / limits.linear_deceleration
    shares = np.maximum(1.0 - STEP * np.arange(BRAKING_STEPS) / np.maximum(need, 1e-9), 0.0)
    braking = first * shares[:, :, None]

    _, gaps = _rollouts(robot, crowd, braking)
    present = _gaps(robot, crowd, robot.pose[None, None], np.zeros(1))
    free = (gaps > 0.0) | (gaps > present) | (shares <= 0.0)[:, :, None]
    can_stop = free.all(axis=(1, 2))
    places, gaps = _rollouts(robot, crowd, velocities)
    left = np.hypot(*np.moveaxis(robot.goal[:2] - places, 2, 0))  # (n, k)
    left = np.minimum.accumulate(left, axis=1)  # a candidate passes its goal, and would stop
    arrived = left < ARRIVED
    nearest = np.where(arrived, math.inf, gaps.min(axis=2))
    touched = np.maximum.accumulate(nearest < 0.0, axis=1)
    rows, ends = np.arange(len(wanted)), np.minimum((~touched).sum(axis=1), STEPS - 1)
    contact = np.where(touched.any(axis=1), times[ends], math.inf)
    small = np.exp(-np.maximum(nearest, 0.0) / GAP_LENGTH) * np.exp(-times / GAP_TIME)
    speed = limits.linear_velocity
    cost = (
        left[rows, ends] / speed
        + CONTACT * np.exp(-contact / CONTACT_TIME)
        + GAP * small.mean(axis=1)
        + MEAN_DISTANCE * left.mean(axis=1) / speed
        + TURN_BACK * 0.5 * np.hypot(*(wanted - robot.wanted[:2]).T) / speed
    )
    cost[~can_stop] = math.inf
    best = int(np.argmin(cost))
    chosen: Array = np.append(wanted[best], wish[2]) * can_stop[best]
    return chosen


def _rollouts(robot: KinematicRobot, crowd: DiscCrowd, velocities: Array) -> tuple[Array, Array]:
    """Return the places (n, k, 2) and the gaps (n, k, m) of velocities (n, k, 2)."""
    times = STEP * np.arange(1, velocities.shape[1] + 1)
    before = np.broadcast_to(robot.velocity[:2], velocities[:, :1].shape)
    means = 0.5 * (velocities + np.concatenate([before, velocities[:, :-1]], axis=1))
    poses = np.empty((*means.shape[:2], 3))
    poses[..., :2] = robot.pose[:2] + STEP * np.cumsum(means, axis=1)
    turn, rate = se2.wrap(float(robot.goal[2] - robot.pose[2])), robot.limits.angular_velocity
    poses[..., 2] = robot.pose[2] + np.clip(turn, -rate * times, rate * times)
    return poses[..., :2], _gaps(robot, crowd, poses, times)


def _gaps(robot: KinematicRobot, crowd: DiscCrowd, poses: Array, times: Array) -> Array:
    """Return the gaps (n, k, m) to the nearest discs and the edge at poses (n, k, 3), times (k,).

    They are those that remain beside the clearance. To the edge of the square it is that of the
    circumscribed circle.
    """
    nearest = np.argsort(np.hypot(*(crowd.positions - robot.pose[:2]).T))[:NEAREST]
    ways = times[:, None, None] * crowd.velocities[nearest]
    gaps = disc_gaps(poses[:, :, None], robot.half, crowd.positions[nearest] + ways)
    room = HALF - float(np.hypot(*robot.half)) - np.abs(poses[..., :2]).max(axis=2)
    return np.concatenate([gaps, room[:, :, None]], axis=2) - CLEARANCE
