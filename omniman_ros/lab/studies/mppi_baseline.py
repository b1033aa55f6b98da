"""Model predictive path integral control of Nav2, with its published critics and defaults.

Sources: G. Williams et al., "Information Theoretic Model Predictive Control" (2018); the
configuration guide of `nav2_mppi_controller` (motion model Omni), whose names the constants have.
Where the guide leaves a choice, it is that for robots that are not round and drive sideways: the
footprint is considered, `TwirlingCritic` takes the place of `PreferForwardCritic` and
`PathAngleCritic`. Obstacles count where they are now, as in a costmap. The path is planned on
the same costs each second. The limits are those of the robot.
"""

import heapq
import math

import numpy as np

from omniman_ros.collision.upright_obstacles import Mask
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.lab.studies.crowd_baselines import KinematicRobot
from omniman_ros.lab.studies.crowds import HALF, RADIUS, DiscCrowd, disc_gaps

TIME_STEPS, MODEL_DT, BATCH_SIZE = 56, 0.05, 1000
STD: Array = np.array([0.2, 0.2, 0.4])  #: vx_std, vy_std, wz_std [m/s, m/s, rad/s]
TEMPERATURE, GAMMA = 0.3, 0.015
PRUNE_DISTANCE = 1.7  #: length of the path that critics see [m]
PATH_STEP = 0.05  #: distance of its points [m]
REPLANNING = 1.0  #: period of the path's planning [s]
#: Costs of the costmap: of an obstacle, within the inscribed radius, and decay beyond [1/m]
LETHAL, INSCRIBED, SCALING = 254.0, 253.0, 3.0
INFLATION = 0.7  #: distance from an obstacle up to which there is a cost [m]
CELL, NEUTRAL = 0.1, 50.0  #: edge of the planner's cells [m], and its cost of a free one
GOAL_TOLERANCE = 0.25  #: distance at which the goal is reached for Nav2 [m]; the rest is straight
CONSTRAINT, COST, GOAL, GOAL_ANGLE = 4.0, 3.81 / 254.0, 5.0, 3.0  #: weights of critics
PATH_ALIGN, PATH_FOLLOW, TWIRLING = 14.0, 5.0, 10.0
COLLISION, NEAR_COLLISION, CRITICAL = 1e6, 253.0, 300.0
COST_STEP, ALIGN_STEP = 2, 4  #: steps between points that `CostCritic` and `PathAlign` look at
#: Distances from which on goals count [m], and below which the path does not
GOAL_NEAR, GOAL_ANGLE_NEAR, COST_NEAR, FOLLOW_FROM, ALIGN_FROM = 1.4, 0.5, 1.0, 1.4, 0.5
FOLLOW_OFFSET, ALIGN_OFFSET = 5, 20  #: numbers of points of the path
MAX_OCCUPANCY = 0.05  #: fraction of the path in the way of something from which it is not aligned
#: Second-order Savitzky-Golay filter over nine controls
SMOOTHING: Array = np.array([-21.0, 14.0, 39.0, 54.0, 59.0, 54.0, 39.0, 14.0, -21.0]) / 231.0


class Mppi:
    """Chooses the velocity of a robot in a crowd; to be made anew for each drive."""

    def __init__(self, seed: int = 0) -> None:
        self._random = np.random.default_rng([seed, 7])
        self._controls = np.zeros((TIME_STEPS, 3))  # in the robot's frame
        self._history = np.zeros((4, 3))
        self._path: Array | None = None
        self._planned = -math.inf
        self._goal: Array = np.full(3, np.nan)

    def __call__(self, robot: KinematicRobot, crowd: DiscCrowd) -> Array:
        """Return the velocity (3,) in the world [m/s, m/s, rad/s]."""
        left = float(np.hypot(*(robot.goal - robot.pose)[:2]))
        if left < GOAL_TOLERANCE:
            self._controls[:] = self._history[:] = 0.0
            return robot.approach()
        is_new = not np.array_equal(robot.goal, self._goal)
        if is_new or robot.now - self._planned >= REPLANNING - 1e-9:
            self._goal, self._planned = robot.goal.copy(), robot.now
            path = planned_path(robot.pose[:2], robot.goal[:2], crowd.positions, robot.half[1])
            self._path = self._path if path is None and not is_new else path
        if self._path is None:
            return np.zeros(3)
        self._optimize(robot, crowd, self._path)
        control = self._controls[1].copy()  # the first is the present one
        self._controls = np.vstack([self._controls[1:], self._controls[-1:]])
        speed = float(np.hypot(*control[:2]))
        control[:2] *= min(1.0, robot.limits.linear_velocity / max(speed, 1e-9))
        return se2.to_world(float(robot.pose[2]), control)

    def _optimize(self, robot: KinematicRobot, crowd: DiscCrowd, planned: Array) -> None:
        limits = robot.limits
        accelerations = np.array(
            [limits.linear_acceleration] * 2 + [limits.angular_acceleration], dtype=np.float64
        )
        speeds = np.array([limits.linear_velocity] * 2 + [limits.angular_velocity])
        now = se2.to_robot(float(robot.pose[2]), robot.velocity)
        noise = self._random.standard_normal((BATCH_SIZE, TIME_STEPS, 3)) * STD
        sampled = self._controls + noise
        velocities = np.empty_like(sampled)
        velocities[:, 0] = now
        for k in range(1, TIME_STEPS):  # the motion model keeps the accelerations
            change = sampled[:, k - 1] - velocities[:, k - 1]
            bound = MODEL_DT * accelerations
            velocities[:, k] = velocities[:, k - 1] + np.clip(change, -bound, bound)
        poses = integrated(robot.pose, velocities)
        begin = int(np.hypot(*(planned - robot.pose[:2]).T).argmin())
        path = planned[begin : begin + round(PRUNE_DISTANCE / PATH_STEP) + 1]
        costs = path_costs(robot, crowd, velocities, poses, path)
        gains = GAMMA / STD**2 * self._controls
        costs += ((sampled - self._controls) * gains).sum(axis=(1, 2))
        weights = np.exp(-(costs - costs.min()) / TEMPERATURE)
        controls = np.tensordot(weights / weights.sum(), sampled, 1)
        padded = np.vstack([self._history, controls, np.repeat(controls[-1:], 4, axis=0)])
        smooth = np.stack([np.convolve(each, SMOOTHING, "valid") for each in padded.T], axis=1)
        self._history = np.vstack([self._history[1:], smooth[1]])
        smooth[0] = before = now
        for k in range(1, TIME_STEPS):
            wanted = np.clip(smooth[k], -speeds, speeds)
            bound = MODEL_DT * accelerations
            before = smooth[k] = before + np.clip(wanted - before, -bound, bound)
        self._controls = smooth


def path_costs(
    robot: KinematicRobot, crowd: DiscCrowd, velocities: Array, poses: Array, path: Array
) -> Array:
    """Return the costs (n,) of velocities and poses (n, k, 3) along a path (m, 2)."""
    place, goal = robot.pose[:2], robot.goal
    left = float(np.hypot(*(goal[:2] - place)))
    length = PATH_STEP * (len(path) - 1)
    speed = np.hypot(velocities[..., 0], velocities[..., 1])
    excess = np.maximum(speed - robot.limits.linear_velocity, 0.0)
    costs: Array = CONSTRAINT * MODEL_DT * excess.sum(axis=1)
    costs += COST * obstacle_costs(robot, crowd, poses[:, ::COST_STEP], left)
    costs += TWIRLING * np.abs(velocities[..., 2]).mean(axis=1)
    if left < GOAL_NEAR:
        apart = poses[..., :2] - goal[:2]
        costs += GOAL * np.hypot(apart[..., 0], apart[..., 1]).mean(axis=1)
    if left < GOAL_ANGLE_NEAR:
        turn = np.abs((poses[..., 2] - goal[2] + math.pi) % math.tau - math.pi)
        costs += GOAL_ANGLE * turn.mean(axis=1)
    ends = poses[:, -1, :2]
    reached = int(np.hypot(*np.moveaxis(path - ends[:, None], 2, 0)).argmin(axis=1).max())
    is_clear = costmap(path, crowd.positions, robot.half[1]) < INSCRIBED
    if length >= FOLLOW_FROM:
        ahead = min(reached + FOLLOW_OFFSET, len(path) - 1)
        while ahead < len(path) - 1 and not is_clear[ahead]:
            ahead += 1
        costs += PATH_FOLLOW * np.hypot(*(ends - path[ahead]).T)
    if length >= ALIGN_FROM and reached >= ALIGN_OFFSET:
        blocked = np.count_nonzero(~is_clear[: reached + 1])
        if not (blocked > 2 and blocked / (reached + 1) > MAX_OCCUPANCY):
            costs += PATH_ALIGN * aligned(poses[:, ::ALIGN_STEP, :2], path, is_clear)
    return costs


def obstacle_costs(robot: KinematicRobot, crowd: DiscCrowd, poses: Array, left: float) -> Array:
    """Return the costs (n,) of poses (n, k, 3) near discs, a distance before the goal [m]."""
    inscribed, around = float(robot.half[1]), float(np.hypot(*robot.half))
    cost = costmap(poses[..., :2], crowd.positions, inscribed)
    hits = np.zeros(cost.shape, dtype=bool)
    possible = np.argwhere(cost >= inflated_cost(np.array(around), inscribed))
    if len(possible):
        near = poses[possible[:, 0], possible[:, 1]]
        gaps = disc_gaps(near[:, None], robot.half, crowd.positions).min(axis=1)
        c, s = np.abs(np.cos(near[:, 2])), np.abs(np.sin(near[:, 2]))
        extents = np.stack([c, s], 1) * robot.half[0] + np.stack([s, c], 1) * robot.half[1]
        room = (HALF - np.abs(near[:, :2]) - extents).min(axis=1)
        hits[tuple(possible.T)] = np.minimum(gaps, room) <= 0.0
    each = np.where(cost >= NEAR_COLLISION, CRITICAL, cost if left >= COST_NEAR else 0.0)
    total = np.where(hits.any(axis=1), COLLISION, each.sum(axis=1))
    result: Array = total / poses.shape[1]
    return result


def integrated(pose: Array, velocities: Array) -> Array:
    """Return the poses (n, k, 3) of velocities (n, k, 3) in the robot's frame from a pose (3,)."""
    yaw = pose[2] + MODEL_DT * np.cumsum(velocities[..., 2], axis=1)
    before = np.concatenate([np.full((len(yaw), 1), pose[2]), yaw[:, :-1]], axis=1)
    c, s = np.cos(before), np.sin(before)
    dx = c * velocities[..., 0] - s * velocities[..., 1]
    dy = s * velocities[..., 0] + c * velocities[..., 1]
    x, y = (MODEL_DT * np.cumsum(part, axis=1) for part in (dx, dy))
    return np.stack([pose[0] + x, pose[1] + y, yaw], axis=2)


def inflated_cost(distance: Array, inscribed: float) -> Array:
    """Return the costs of places at distances (...) from what is occupied [m]."""
    decayed = (INSCRIBED - 1.0) * np.exp(-SCALING * (distance - inscribed))
    cost = np.where(distance <= inscribed, INSCRIBED, decayed)
    cost = np.where(distance <= 0.0, LETHAL, cost)
    result: Array = np.where(distance > INFLATION, 0.0, cost)
    return result


def costmap(places: Array, discs: Array, inscribed: float) -> Array:
    """Return the costs (...) of places (..., 2) among discs (m, 2) in the square."""
    distance = HALF - np.abs(places).max(axis=-1)
    for disc in discs:
        apart = np.hypot(places[..., 0] - disc[0], places[..., 1] - disc[1]) - RADIUS
        distance = np.minimum(distance, apart)
    return inflated_cost(distance, inscribed)


def aligned(places: Array, path: Array, is_clear: Mask) -> Array:
    """Return the mean distances (n,) of places (n, k, 2) from the path at the same lengths."""
    steps = np.diff(places, axis=1)
    lengths = np.cumsum(np.hypot(steps[..., 0], steps[..., 1]), axis=1)
    index = np.minimum(np.round(lengths / PATH_STEP).astype(int), len(path) - 1)
    off = path[index] - places[:, 1:]
    counts = is_clear[index]
    total = (np.hypot(off[..., 0], off[..., 1]) * counts).sum(axis=1)
    result: Array = total / np.maximum(counts.sum(axis=1), 1)
    return result


def planned_path(start: Array, goal: Array, discs: Array, inscribed: float) -> Array | None:
    """Return points (k, 2) at equal distances of a path of least cost, or None without one."""
    count = round(2.0 * HALF / CELL)
    axis = -HALF + CELL * (np.arange(count) + 0.5)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=2)
    cost = costmap(grid, discs, inscribed)
    price = np.where(cost >= INSCRIBED, math.inf, NEUTRAL + 0.8 * cost)
    first, last = (
        tuple(np.clip(((place + HALF) / CELL).astype(int), 0, count - 1).tolist())
        for place in (goal, start)
    )
    price[first] = price[last] = NEUTRAL  # who stands too near may leave
    best, before = {first: 0.0}, dict[tuple[int, int], tuple[int, int]]()
    queue = [(0.0, first)]
    while queue:
        spent, cell = heapq.heappop(queue)
        if cell == last:
            break
        if spent > best[cell]:
            continue
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                there = cell[0] + i, cell[1] + j
                if not (0 <= there[0] < count and 0 <= there[1] < count):
                    continue
                total = spent + math.hypot(i, j) * float(price[there])
                if total < best.get(there, math.inf):
                    best[there], before[there] = total, cell
                    heapq.heappush(queue, (total, there))
    if last not in best:
        return None
    cells = [last]
    while cells[-1] != first:
        cells.append(before[cells[-1]])
    points = np.vstack([start, [axis[list(cell)] for cell in cells[1:-1]] or [goal], goal])
    steps = np.concatenate([[0.0], np.hypot(*np.diff(points, axis=0).T)]).cumsum()
    places = np.arange(0.0, steps[-1] + PATH_STEP, PATH_STEP)
    return np.column_stack([np.interp(places, steps, each) for each in points.T])
