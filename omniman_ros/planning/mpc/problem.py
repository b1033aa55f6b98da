"""Parameters of an optimal control problem from goal, obstacles and limits."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.goals import PlanTarget
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.mpc.gap_rows import OBSTACLE
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.mpc.transcription import EXTREMES, SIDES, Stage
from omniman_ros.planning.obstacles.pairs import Pairs
from omniman_ros.planning.obstacles.separation import box_gap, facing_gap, within_distance
from omniman_ros.surroundings.ellipses import Ellipses

FAR_AWAY = 1e3  #: Coordinates of the obstacle in an empty slot [m]
#: Ratio of the slack's weight to the largest gradient of the goal's cost [-]; above 1, slack is
#: used only as a last resort.
SLACK_FACTOR = 3.0
MAX_BERTH = 0.3  #: Largest additional gap to moving obstacles [m]
REACTION_TIME = 0.4  #: Time from a change of an obstacle's direction until the robot brakes [s]
STANDING_SPEED = 0.05  #: Speed below which an obstacle counts as being at rest [m/s]
CAUTIOUS_SPEED = 0.2  #: Speed that is always allowed, however close a moving obstacle is [m/s]
#: Number of obstacles, the nearest by their centres, whose gaps are computed at each step
DETAILED_OBSTACLES = 48
#: Ratio of a plan's speed to its limit that is allowed for where its reach counts [-]
SPEED_EXCESS = 1.1
#: Part of the error to the poses that a guess follows which it reduces in a second [1/s]
FOLLOWING_RATE = 1.5
VOLTAGE_HEADROOM = 0.02  #: Part by which the voltage limit exceeds the back-EMF of the start [-]


class Problem:
    """Builds the parameters of optimal control problems; `limits` may be replaced at any time."""

    def __init__(self, model: PlanningModel, limits: EffectiveLimits) -> None:
        self.model = model
        self.limits = limits

    def is_confined(
        self, start: Array, footprint: Footprint, clearance: float | None = None
    ) -> bool:
        """Return whether the robot can reach the border of its workspace within the horizon.

        Arguments are those of :meth:`stage`.
        """
        p = self.limits.parameters
        gap = p.safety.clearance if clearance is None else clearance
        # Never faster than now, or than the limit: see `_limits`.
        fastest = max(p.limits.linear_velocity, math.hypot(start[3], start[4])) * SPEED_EXCESS
        reach = footprint.radius + gap + fastest * p.horizon.duration
        x_min, y_min, x_max, y_max = p.workspace.bounds
        x, y = float(start[0]), float(start[1])
        return min(x - x_min, x_max - x, y - y_min, y_max - y) <= reach

    def stage(
        self,
        start: Array,
        guess: HermiteTrajectory,
        goal: PlanTarget,
        pairs: Pairs,
        slots: int,
        clearance: float | None = None,
        confined: bool = True,
    ) -> Stage:
        """Return the parameters of one problem.

        The plan begins at `start` (6,), pose in odom and body twist, the first node of the guess
        of N + 1 nodes around which gaps are linearised. The clearance [m] is that of the
        parameters if None. A problem that is not confined has no rows of the workspace.
        """
        p = self.limits.parameters
        times = guess.times[1:]
        targets, gradient = self._targets(start, times, goal)
        ahead = targets[-1, :2] - start[:2]
        direction = math.atan2(ahead[1], ahead[0])
        gap = p.safety.clearance if clearance is None else clearance
        x_min, y_min, x_max, y_max = p.workspace.bounds
        outline = pairs.footprint.whole
        extremes = farthest_points(guess.poses[1:, 2], outline) if confined else None
        return Stage.unchecked(
            limits=self._limits(start, direction, self._caution(guess, pairs)),
            workspace=np.array([x_min + gap, y_min + gap, x_max - gap, y_max - gap]),
            target=targets,
            weights=self._weights(goal.moves, len(times)),
            energy=p.weights.energy,
            slack=(SLACK_FACTOR * gradient, SLACK_FACTOR * gradient / 0.1),
            obstacles=self._obstacles(guess, pairs, slots, gap),
            extremes=np.empty((len(times), 0, 2)) if extremes is None else extremes,
            direction=direction,
        )

    def evasion(self, start: Array, direction: float) -> Array:
        """Return currents (N, n) [A] that drive off in a direction of odom [rad], then coast.

        From this guess the solver finds paths that it would not find from the last plan.
        """
        p, model = self.limits.parameters, self.model
        steps, step = p.horizon.steps, p.horizon.step
        angle = direction - start[2]
        speed, rate = self.limits.speeds[0], self.limits.accelerations[0]
        change = speed * np.array([math.cos(angle), math.sin(angle), 0.0]) - start[3:]
        momentum = model.inertia @ change
        duration = float(np.clip(math.hypot(change[0], change[1]) / rate, step, steps * step))
        torque = np.linalg.pinv(model.J.T) @ (momentum / duration)
        currents = np.clip(
            torque / (model.efficiency * model.emf), -model.max_current, model.max_current
        )
        driven = np.arange(steps) * step < duration - 0.5 * step
        result: Array = driven[:, None] * currents
        return result

    def along(self, start: Array, poses: Array) -> Array:
        """Return currents (N, n) [A] that lead along poses (N, 3) in odom, one at each step's end.

        Velocities follow those of the poses and reduce the error to them, both within the limits.
        """
        model, step = self.model, self.limits.parameters.horizon.step
        top, rates = self.limits.speeds, np.array(self.limits.accelerations)
        inverse = np.linalg.pinv(model.drive)
        paces = np.diff(poses, axis=0, prepend=start[None, :3]) / step
        pose, twist = start[:3], start[3:]
        velocity = se2.to_world(float(pose[2]), twist)
        currents = np.empty((len(poses), model.wheel_count))
        for k, pace in enumerate(paces):
            wanted = pace + FOLLOWING_RATE * (poses[k] - pace * step - pose)
            wanted = _shortened(wanted, top)
            change = _shortened(wanted - velocity, rates * step)
            pose = pose + step * (velocity + 0.5 * change)
            velocity = velocity + change
            after = se2.to_robot(float(pose[2]), velocity)
            free = np.asarray(model.free_rate(0.5 * (twist + after))[0])[:, 0]
            currents[k] = inverse @ ((after - twist) / step - free)
            twist = after
        result: Array = np.clip(currents, -model.max_current, model.max_current)
        return result

    def _targets(self, start: Array, times: Array, goal: PlanTarget) -> tuple[Array, float]:
        """Return the targets (N, 6), and the largest gradient of the goal's cost [J/m]."""
        w, p = self.limits.parameters.weights, self.limits.parameters
        poses, velocities = goal.targets(times)
        reach = w.reach + p.limits.linear_velocity * p.horizon.duration
        ahead = poses[:, :2] - start[:2]
        distance = np.hypot(ahead[:, 0], ahead[:, 1])
        poses[:, :2] = start[:2] + ahead * (reach / np.maximum(distance, reach))[:, None]
        strength = w.position * (1.0 + w.running * p.horizon.duration)
        return np.hstack([poses, velocities]), 2.0 * max(strength, 1.0) * reach

    def _weights(self, moves: bool, steps: int) -> Array:
        w, model = self.limits.parameters.weights, self.model
        size = math.hypot(*model.half)
        velocity = w.velocity if moves else 0.0
        last = np.array([w.position, w.heading, velocity, velocity * size**2, 0.0])
        weights = np.tile(last * w.running * self.limits.parameters.horizon.step, (steps, 1))
        weights[-1] += last
        weights[-1, 4] = w.energy / model.efficiency
        return weights

    def _limits(self, start: Array, direction: float, caution: Array) -> Array:
        """Return the limits (N, 6); a speed above its limit may be reduced gradually."""
        p, model, twist = self.limits.parameters, self.model, start[3:]
        linear, angular = self.limits.speeds
        a, b = self.limits.accelerations
        wheels = float(np.abs(model.J @ twist).max())
        # Factor from this speed to its measure in the polygon that replaces the limit's circle:
        # by the angle from the middle of the nearest side.
        vx, vy, yaw_rate = twist.tolist()
        side = math.tau / SIDES
        along = math.atan2(vy, vx) + float(start[2]) - direction
        fraction = math.cos((along / side % 1.0 - 0.5) * side) / math.cos(0.5 * side)
        now = np.array([math.hypot(vx, vy) * fraction, abs(yaw_rate), wheels])
        rates = 0.5 * np.array([a, b, a / model.half.min()])
        elapsed = p.horizon.step * np.arange(1, len(caution) + 1)[:, None]
        result = np.empty((len(caution), 6))
        result[:, 0], result[:, 1] = np.minimum(linear, caution), angular
        result[:, 2], result[:, 4], result[:, 5] = model.max_speed, a, b
        # There is no headroom here: over the cycles it would add up to ever higher speeds.
        result[:, :3] = np.maximum(result[:, :3], now - rates * elapsed)
        result[:, 3] = max(model.max_voltage, model.emf * wheels * (1.0 + VOLTAGE_HEADROOM))
        return result

    def _obstacles(
        self, guess: HermiteTrajectory, pairs: Pairs, slots: int, clearance: float
    ) -> Array:
        """Return the nearest pairs (N, M, 15) along a guess, the obstacles with their margins."""
        times = guess.times[1:]
        table = np.zeros((len(times), slots, OBSTACLE))
        table[..., :2] = FAR_AWAY
        table[..., 2], table[..., 4:6] = 1.0, 1.0
        table[..., 10], table[..., 12:14] = 1.0, self.model.half
        if not slots or not len(pairs):
            return table
        if len(pairs) > slots:
            pairs = pairs.select(self._reachable(guess, pairs))
        near, boxes = pairs.ellipses, pairs.boxes
        centers, axes = near.centers_at(times), near.axes_at(times, clearance + self._berth(near))
        angles, velocities = near.angles, near.velocities
        if len(near) > slots:
            chosen = self._beside(guess.poses[1:], pairs, centers, axes, slots)
            centers, axes = (
                np.take_along_axis(values, chosen[..., None], axis=1) for values in (centers, axes)
            )
            angles, velocities, boxes = angles[chosen], velocities[chosen], boxes.select(chosen)
        m = centers.shape[1]
        table[:, :m, :2] = centers
        table[:, :m, 2], table[:, :m, 3] = np.cos(angles), np.sin(angles)
        table[:, :m, 4:6], table[:, :m, 6:8] = axes, velocities
        table[:, :m, 8:10] = boxes.centre
        table[:, :m, 10], table[:, :m, 11] = np.cos(boxes.yaw), np.sin(boxes.yaw)
        table[:, :m, 12:14], table[:, :m, 14] = boxes.half, boxes.radius
        return table

    def _caution(self, guess: HermiteTrajectory, pairs: Pairs) -> Array:
        """Return speeds (N,) [m/s] from which the robot can avoid an obstacle that approaches it.

        The robot approaches the obstacle at the speed c along the line between them. If the
        obstacle turns towards the robot at its speed u, the robot reacts after the time t and
        accelerates away at a. The gap must suffice until both have the same velocity:
        c t + c^2 / (2 a) + u (t + c / a) + u^2 / (2 a) = gap.
        """
        steps, known = len(guess.times) - 1, pairs.ellipses
        speeds = np.hypot(known.velocities[:, 0], known.velocities[:, 1])
        moving = speeds > STANDING_SPEED
        if not moving.any():
            return np.full(steps, math.inf)
        near, boxes, u = known.select(moving), pairs.boxes.select(moving), speeds[moving]
        times, poses, velocities = guess.times[1:], guess.poses[1:], guess.velocities[1:]
        centers = near.centers_at(times)
        gaps = facing_gap(poses, boxes, centers, near.axes_at(times), near.angles)
        offset = centers - poses[:, None, :2]
        distance = np.maximum(np.hypot(offset[..., 0], offset[..., 1]), 1e-6)
        closing = (offset * velocities[:, None, :2]).sum(axis=-1) / distance
        a = self.limits.decelerations[0]
        delay = REACTION_TIME + u / a
        remaining_gap = np.maximum(gaps - u * REACTION_TIME - 0.5 * u * u / a, 0.0)
        allowed = a * (np.sqrt(delay * delay + 2.0 * remaining_gap / a) - delay)
        speed = np.hypot(velocities[:, 0], velocities[:, 1])[:, None]
        slower = speed * allowed / np.maximum(closing, STANDING_SPEED)
        slower[closing <= STANDING_SPEED] = math.inf
        result: Array = np.maximum(slower.min(axis=1), CAUTIOUS_SPEED)
        return result

    def _berth(self, ellipses: Ellipses) -> Array:
        """Return the gaps (M,) to moving obstacles in addition to the clearance [m]."""
        speeds = np.hypot(ellipses.velocities[:, 0], ellipses.velocities[:, 1])
        return np.minimum(self.limits.parameters.safety.berth * speeds, MAX_BERTH)

    def _beside(
        self, poses: Array, pairs: Pairs, centers: Array, axes: Array, slots: int
    ) -> NDArray[np.intp]:
        """Return indices (N, slots) of the most relevant pairs at each pose.

        The nearest obstacle in each of `slots` sectors around the robot comes first, then the
        nearest of the others: a wall consists of many discs, which must not displace the obstacles
        on the other side.
        """
        size = axes.max(axis=-1)
        offset = centers - poses[:, None, :2]
        rough_gaps = np.hypot(offset[..., 0], offset[..., 1]) - size
        if len(pairs) > DETAILED_OBSTACLES:
            near = np.argpartition(rough_gaps, DETAILED_OBSTACLES, axis=1)[:, :DETAILED_OBSTACLES]
        else:
            near = np.broadcast_to(np.arange(len(pairs)), rough_gaps.shape)
        offset, near_centers, near_axes = (
            np.take_along_axis(values, near[..., None], axis=1)
            for values in (offset, centers, axes)
        )
        boxes, angles = pairs.boxes.select(near), pairs.ellipses.angles[near]
        gaps = box_gap(poses, boxes, near_centers, near_axes, angles)
        cos, sin = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
        a, b = self.model.half
        forward = (cos * offset[..., 0] + sin * offset[..., 1]) / a
        left = (cos * offset[..., 1] - sin * offset[..., 0]) / b
        sector = np.floor(np.arctan2(left, forward) * (slots / math.tau)).astype(int) % slots
        order = np.argsort(gaps, axis=1, kind="stable")
        sorted_sector = np.take_along_axis(sector, order, axis=1)
        rank = np.zeros(order.shape, dtype=int)  # among the obstacles of the same sector
        for k in range(slots):
            inside = sorted_sector == k
            rank[inside] = (np.cumsum(inside, axis=1) - 1)[inside]
        best = np.argsort(rank, axis=1, kind="stable")[:, :slots]
        chosen = np.take_along_axis(order, best, axis=1)
        result: NDArray[np.intp] = np.take_along_axis(near, chosen, axis=1)
        return result

    def _reachable(self, guess: HermiteTrajectory, pairs: Pairs) -> NDArray[np.bool_]:
        """Return (M,) bool: pairs that can come near, whatever the plan is."""
        p = self.limits.parameters
        fastest = max(p.limits.linear_velocity, float(np.abs(guess.velocities).max()))
        # A motion there and back at twice the speed reaches as far as one that does not return.
        there_and_back = np.tile([2.0 * fastest, 0.0, 0.0], (2, 1))
        return within_distance(
            guess.times[[0, -1]],
            np.tile(guess.poses[0], (2, 1)),
            there_and_back,
            pairs.boxes,
            pairs.ellipses,
            p.safety.clearance,
        )


def _shortened(vector: Array, limits: Sequence[float] | Array) -> Array:
    """Return a vector (3,) whose linear and angular part do not exceed their limits."""
    linear = limits[0] / max(math.hypot(vector[0], vector[1]), limits[0])
    angular = limits[1] / max(abs(vector[2]), limits[1])
    result: Array = vector * np.array([linear, linear, angular])
    return result


def farthest_points(headings: Array, outline: Rectangles) -> Array:
    """Return points (N, 8, 2) in base_link, the farthest towards the workspace's sides [m].

    There are two for each of x_min, x_max, y_min and y_max at headings (N,) in odom.

    Args:
        headings: (N,) headings of the robot in odom [rad].
    """
    corners = outline.corners.reshape(-1, 2)
    c, s = np.cos(headings)[:, None], np.sin(headings)[:, None]
    x, y = c * corners[:, 0] - s * corners[:, 1], s * corners[:, 0] + c * corners[:, 1]
    order = np.argsort(np.stack((x, -x, y, -y), axis=1), axis=-1)[..., : EXTREMES // 4]
    return corners[order].reshape(len(headings), EXTREMES, 2)
