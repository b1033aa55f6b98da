"""Motions among people: sampled velocities that are held for a while and then lead to the goal.

Near people, one locally optimal plan is not enough: they close one way and open another. Here,
many motions are rolled out together within the limits of plans, and ranked by the time that they
need, the time of their first contact and the gaps that they leave. The best ones are checked by
`safety.Surroundings`, as all motions are.
"""

import math

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.mpc.solver import Solution
from omniman_ros.surroundings.ellipses import Ellipses

Mask = NDArray[np.bool_]  #: Array of flags

DIRECTIONS = 16  #: Number of directions, evenly spaced from that of the goal
SPEEDS = (1.0, 0.6, 0.3)  #: Parts of the largest speed
HOLDS = (0.6, 1.4)  #: Times for which a velocity is held [s]
DURATION = 2.5  #: Time for which motions are rolled out [s]
NEAREST = 10  #: Number of people, the nearest ones, by whom motions are ranked
STANDING = 14  #: The same of what stands
BEST = 3  #: Number of motions that are returned
BRAKE_FACTOR = 0.8  #: Part of the deceleration with which motions come to rest at the goal
ARRIVAL_WATCH = 1.0  #: Time after the arrival at the goal in which a contact still counts [s]
ARRIVED = 0.03  #: Distance from the goal below which a motion has arrived [m]
ALIGN_DISTANCE = 1.5  #: Distance from the goal from which on the robot turns to the goal's heading
CONTACT_COST, CONTACT_TIME = 8.0, 1.5  #: Cost of a contact at once [s], and its decay [s]
#: Cost of touching [s], and its decay with the gap [m] and with time [s]
NEAR_COST, NEAR_GAP, NEAR_TIME = 0.6, 0.15, 1.5
DISTANCE_COST = 0.3  #: Weight of the mean distance from the goal
UNSAFE_COST = 100.0  #: Cost of a motion that cannot come to rest in time [s]
BRAKING_TICK = 0.1  #: Time between two looks at a robot that brakes [s]
OTHER = 0.5  #: Part of the largest speed by which velocities differ that count as others
TURN_COST = 0.25  #: Cost of the opposite direction of that before [s]


class VelocitySamples:
    """Samples motions that begin on the present one.

    Attributes:
        limits: Limits in effect; may be replaced at any time.
    """

    def __init__(self, model: PlanningModel, limits: EffectiveLimits) -> None:
        self._half, self._wheels, self.limits = model.half, model.wheel_count, limits
        self._velocity = np.zeros(2)

    def best(
        self,
        start: Array,
        due: float,
        goal: Array,
        people: Ellipses,
        others: Ellipses,
        *,
        is_goal: bool = True,
    ) -> tuple[Solution, ...]:
        """Return the best motions from a state (6,) at the time `due` [s] to a pose (3,).

        Their currents are NaN. Where the pose is not the goal, the robot has to remain there.
        """
        step = self.limits.parameters.horizon.step
        count = round(DURATION / step)
        poses, velocities, held = self._rollouts(start, goal, step, count)
        times: Array = due + step * np.arange(1.0, count + 1.0)
        gaps = np.minimum(
            _gaps(poses[:, 1:], self._half, _nearest(people, start, NEAREST), times),
            _gaps(poses[:, 1:], self._half, _nearest(others, start, STANDING), times),
        )
        cost = self._costs(poses[:, 1:], held, goal, is_goal, gaps, step)
        near = _nearest(people, start, NEAREST).joined(_nearest(others, start, STANDING))
        cost += UNSAFE_COST * ~self._can_rest(poses[:, 1], velocities[:, 1], due + step, near)
        order = self._diverse(cost, held)
        self._velocity = held[order[0]]
        return tuple(
            Solution.unchecked(
                currents=np.full((count, self._wheels), np.nan),
                states=_states(poses[k], velocities[k]),
                cost=float(cost[k]),
                slack=np.zeros(count),
                step=0.0,
                iterations=0,
            )
            for k in order.tolist()
        )

    def _diverse(self, cost: Array, held: Array) -> Array:
        """Return the numbers of the best motions, each in another direction than those before."""
        left, order = cost.copy(), list[int]()
        for _ in range(BEST):
            order.append(int(left.argmin()))
            apart = held - held[order[-1]]
            left[np.hypot(apart[:, 0], apart[:, 1]) < OTHER * self.limits.speeds[0]] = np.inf
        return np.array(order)

    def _can_rest(self, poses: Array, velocities: Array, time: float, near: Ellipses) -> Mask:
        """Return which robots (C,) that brake from a time [s] on touch nobody before they rest.

        Who is touched may not come closer. Margins grow with time, as the check has it.
        """
        size = np.column_stack([np.hypot(velocities[:, 0], velocities[:, 1]), velocities[:, 2]])
        ends = np.abs(size) / self.limits.decelerations
        ticks = np.arange(0.0, float(ends.max()) + BRAKING_TICK, BRAKING_TICK)
        elapsed = np.minimum(ticks[:, None], ends[:, None])
        way = elapsed - 0.5 * elapsed**2 / np.maximum(ends, 1e-6)[:, None]
        along = poses[:, None] + velocities[:, None] * way[..., [0, 0, 1]]
        least = self.limits.parameters.safety.least_clearance
        gaps = _gaps_to_each(along, self._half, near, time + ticks) - least
        gaps -= (near.growth * np.maximum(time + ticks - near.time, 0.0)[:, None])[None]
        allowed = np.minimum(gaps[:, :1], 0.0) - 1e-3
        rests = ticks > ends.max(axis=1, keepdims=True) + BRAKING_TICK
        result: Mask = np.all((gaps >= allowed) | rests[..., None], axis=(1, 2))
        return result

    def _rollouts(
        self, start: Array, goal: Array, step: float, count: int
    ) -> tuple[Array, Array, Array]:
        """Return poses and velocities (C, K + 1, 3) in odom, and the velocities held (C, 2)."""
        top, yaw_top = self.limits.speeds
        rate, yaw_rate = self.limits.accelerations
        held, holds = self._held(start, goal, top)
        c = len(held)
        p, v = np.empty((c, count + 1, 2)), np.empty((c, count + 1, 2))
        p[:, 0], v[:, 0] = start[:2], se2.to_world(float(start[2]), start[3:])[:2]
        braking = BRAKE_FACTOR * min(rate, self.limits.decelerations[0])
        for k in range(count):
            ahead = goal[:2] - p[:, k]
            distance = np.hypot(ahead[:, 0], ahead[:, 1])
            # The speed from which the robot comes to rest at the goal, in steps.
            reach = np.sqrt(2.0 * braking * distance + (0.5 * braking * step) ** 2)
            speed = np.clip(reach - 0.5 * braking * step, 0.0, top)
            speed = np.minimum(speed, distance / step)
            wanted = ahead * (speed / np.maximum(distance, 1e-9))[:, None]
            wanted = np.where((k * step < holds)[:, None], held, wanted)
            change = wanted - v[:, k]
            size = np.hypot(change[:, 0], change[:, 1]) / (rate * step)
            v[:, k + 1] = v[:, k] + change / np.maximum(size, 1.0)[:, None]
            p[:, k + 1] = p[:, k] + 0.5 * step * (v[:, k] + v[:, k + 1])
        headings, rates = self._headings(start, goal, p, v, step, yaw_top, yaw_rate)
        poses = np.concatenate([np.tile(p, (2, 1, 1)), headings[..., None]], axis=2)
        velocities = np.concatenate([np.tile(v, (2, 1, 1)), rates[..., None]], axis=2)
        return poses, velocities, np.tile(held, (2, 1))

    def _held(self, start: Array, goal: Array, top: float) -> tuple[Array, Array]:
        """Return velocities (C, 2) in odom and the times (C,) for which they are held [s]."""
        ahead = goal[:2] - start[:2]
        angles = math.atan2(ahead[1], ahead[0]) + np.arange(DIRECTIONS) * math.tau / DIRECTIONS
        rays = np.column_stack([np.cos(angles), np.sin(angles)])
        grid = (top * np.array(SPEEDS)[:, None, None] * rays).reshape(-1, 2)
        now = se2.to_world(float(start[2]), start[3:])[:2]
        each = np.vstack([grid, np.zeros(2), now, self._velocity])
        # The last two go to the goal at once, and rest: neither holds a direction, so that none
        # of them costs a turn near the goal.
        held = np.concatenate([np.tile(each, (len(HOLDS), 1)), np.zeros((2, 2))])
        return held, np.append(np.repeat(HOLDS, len(each)), [0.0, math.inf])

    def _headings(
        self,
        start: Array,
        goal: Array,
        p: Array,
        v: Array,
        step: float,
        top: float,
        rate: float,
    ) -> tuple[Array, Array]:
        """Return headings and yaw rates (2 C, K + 1): towards the goal's, and along the motion.

        Along the motion, the longer side of the robot is in the direction of the velocity until
        the goal is near.
        """
        c, count = p.shape[0], p.shape[1]
        headings, rates = np.empty((2 * c, count)), np.empty((2 * c, count))
        headings[:, 0], rates[:, 0] = start[2], start[5]
        left = np.hypot(goal[0] - p[..., 0], goal[1] - p[..., 1])
        along = np.arctan2(v[..., 1], v[..., 0])
        side = 0.0 if self._half[0] >= self._half[1] else 0.5 * math.pi
        moves = (np.hypot(v[..., 0], v[..., 1]) > 0.1) & (left > ALIGN_DISTANCE)
        final = float(goal[2])
        for k in range(count - 1):
            here = headings[:, k]
            error = np.remainder(final - here + math.pi, math.tau) - math.pi
            turn = along[:, k + 1] - side - here[c:]
            turn = np.remainder(turn + 0.5 * math.pi, math.pi) - 0.5 * math.pi
            error[c:] = np.where(moves[:, k + 1], turn, error[c:])
            size = np.abs(error)
            braking = BRAKE_FACTOR * rate
            speed = np.sqrt(2.0 * braking * size + (0.5 * braking * step) ** 2)
            speed = np.minimum(np.clip(speed - 0.5 * braking * step, 0.0, top), size / step)
            change = np.copysign(speed, error) - rates[:, k]
            rates[:, k + 1] = rates[:, k] + np.clip(change, -rate * step, rate * step)
            headings[:, k + 1] = here + 0.5 * step * (rates[:, k] + rates[:, k + 1])
        return headings, rates

    def _costs(
        self,
        poses: Array,
        held: Array,
        goal: Array,
        is_goal: bool,
        gaps: Array,
        step: float,
    ) -> Array:
        """Return the costs (C,) of motions [s] with poses (C, K, 3) and least gaps (C, K).

        A contact later than ARRIVAL_WATCH after the arrival does not count: the robot drives to a
        goal that somebody will cross, but waits for who is there soon.
        """
        count, top = poses.shape[1], self.limits.speeds[0]
        left = np.hypot(goal[0] - poses[..., 0], goal[1] - poses[..., 1])
        rows, is_there = np.arange(len(poses)), (left < ARRIVED) & is_goal
        arrival = np.where(is_there.any(axis=1), is_there.argmax(axis=1), count)
        touches = (gaps <= 0.0) & (np.arange(count) < arrival[:, None] + ARRIVAL_WATCH / step)
        meets = touches.any(axis=1)
        first = np.where(meets, touches.argmax(axis=1), count - 1)
        times = step * np.arange(1.0, count + 1.0)
        cost = left[rows, first] / top
        cost += meets * CONTACT_COST * np.exp(-times[first] / CONTACT_TIME)
        weight = np.exp(-times / NEAR_TIME)
        cost += NEAR_COST * (np.exp(-np.maximum(gaps, 0.0) / NEAR_GAP) * weight).mean(axis=1)
        cost += DISTANCE_COST * left.mean(axis=1) / top
        difference = held - self._velocity
        turned = 0.5 * np.hypot(difference[:, 0], difference[:, 1]) / top
        result: Array = cost + TURN_COST * turned
        return result


def _nearest(obstacles: Ellipses, start: Array, count: int) -> Ellipses:
    """Return the obstacles that are the nearest to a state (6,)."""
    if len(obstacles) <= count:
        return obstacles
    offset = obstacles.centers - start[:2]
    distance = np.hypot(offset[:, 0], offset[:, 1]) - obstacles.semi_axes.max(axis=1)
    return obstacles.select(np.argpartition(distance, count)[:count])


def _gaps(poses: Array, half: Array, obstacles: Ellipses, times: Array) -> Array:
    """Return the least gaps (C, K) of boxes at poses (C, K, 3) to discs around obstacles [m]."""
    if not len(obstacles):
        return np.full(poses.shape[:2], np.inf)
    result: Array = _gaps_to_each(poses, half, obstacles, times).min(axis=-1)
    return result


def _gaps_to_each(poses: Array, half: Array, obstacles: Ellipses, times: Array) -> Array:
    """Return the gaps (C, K, M) of boxes at poses (C, K, 3) to discs around obstacles [m]."""
    centre = np.moveaxis(obstacles.centers_at(times), -1, 0)  # (2, K, M)
    dx, dy = (centre[k] - poses[..., k, None] for k in (0, 1))
    c, s = np.cos(poses[..., 2, None]), np.sin(poses[..., 2, None])
    x = np.maximum(np.abs(c * dx + s * dy) - half[0], 0.0)
    y = np.maximum(np.abs(c * dy - s * dx) - half[1], 0.0)
    gaps: Array = np.sqrt(x * x + y * y) - obstacles.semi_axes.max(axis=1)
    return gaps


def _states(poses: Array, velocities: Array) -> Array:
    """Return states (K + 1, 6) of poses and velocities (K + 1, 3) in odom."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y, yaw_rate = velocities.T
    return np.column_stack([poses, c * x + s * y, c * y - s * x, yaw_rate])
