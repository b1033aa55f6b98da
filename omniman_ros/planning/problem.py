"""From goal, obstacles and limits to the parameters of one optimal control problem."""

import math

import numpy as np
from numpy.typing import NDArray

from omniman_ros.planning.ellipses import Ellipses, inflated
from omniman_ros.planning.goals import Goal
from omniman_ros.planning.model import PlanningModel
from omniman_ros.planning.motion import Motion
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.planning.separation import box_gap, within_reach
from omniman_ros.planning.transcription import OBSTACLE, SIDES, Stage

Array = NDArray[np.float64]

FAR_AWAY = 1e3
"""Where the obstacle of an empty slot is [m]."""
SLACK = 3.0
"""Weight of the slack over the strongest pull of a goal: then slack is the last resort."""
WIDEST_BERTH = 0.3
"""At most so much more is kept from what moves [m]."""
REACTION = 0.4
"""From when an obstacle turns until the robot brakes [s]."""
CREEPING, CAREFUL = 0.05, 0.2
"""Obstacles that are slower than this stand; the robot may be this fast anywhere [m/s]."""
ROUGHLY = 48
"""So many obstacles are looked at in detail at each step, the nearest by their centres."""
HEADROOM = 0.02
"""Share by which the voltage limit lies above the back-EMF that is there already."""


class Problem:
    """Builds the stages of the problem for a planner's parameters.

    Attributes:
        parameters: Weights, limits and clearance are live.
        share: Share of velocity and acceleration limits that is left.
    """

    def __init__(self, model: PlanningModel, parameters: PlannerParameters) -> None:
        self._model = model
        self.parameters = parameters
        self.share = 1.0

    def stage(
        self,
        start: Array,
        guess: Motion,
        goal: Goal,
        ellipses: Ellipses,
        slots: int,
        clearance: float | None = None,
    ) -> Stage:
        """Parameters of the problem.

        Args:
            start: (6,) state where the plan begins.
            guess: N + 1 nodes; the plan begins at the first.
            goal: Where to.
            ellipses: Obstacles.
            slots: How many of them the problem has room for.
            clearance: Gap to be kept [m]; None for that of the parameters.
        """
        p = self.parameters
        times = guess.times[1:]
        targets, pull = self._targets(start, times, goal)
        ahead = targets[-1, :2] - start[:2]
        direction = math.atan2(ahead[1], ahead[0])
        gap = p.safety.clearance if clearance is None else clearance
        x_min, y_min, x_max, y_max = p.workspace.bounds
        return Stage(
            limits=self._limits(start, direction, self._caution(guess, ellipses)),
            workspace=np.array([x_min + gap, y_min + gap, x_max - gap, y_max - gap]),
            target=targets,
            weights=self._weights(goal.moves, len(times)),
            energy=p.weights.energy,
            slack=(SLACK * pull, SLACK * pull / 0.1),
            obstacles=self._obstacles(guess, ellipses, slots, gap),
            direction=direction,
        )

    def evasion(self, start: Array, direction: float) -> Array:
        """Currents (N, n) that drive off into a direction of odom [rad], then let it roll.

        A guess from which the solver finds ways that it would not find from the last plan.
        """
        p, model = self.parameters, self._model
        steps, step = p.horizon.steps, p.horizon.step
        angle = direction - start[2]
        room = (1.0 - p.reserve) * self.share
        speed, rate = room * p.limits.linear_velocity, room * p.limits.linear_acceleration
        missing = speed * np.array([math.cos(angle), math.sin(angle), 0.0]) - start[3:]
        force = model.inertia @ missing
        lasts = float(np.clip(math.hypot(missing[0], missing[1]) / rate, step, steps * step))
        torque = np.linalg.pinv(model.J.T) @ (force / lasts)
        currents = np.clip(
            torque / (model.efficiency * model.emf), -model.max_current, model.max_current
        )
        pushing = np.arange(steps) * step < lasts - 0.5 * step
        result: Array = pushing[:, None] * currents
        return result

    def _targets(self, start: Array, times: Array, goal: Goal) -> tuple[Array, float]:
        """Targets (N, 6), and the strongest pull of the goal [J/m]."""
        w, p = self.parameters.weights, self.parameters
        poses, velocities = goal.targets(times)
        reach = w.reach + p.limits.linear_velocity * p.horizon.duration
        ahead = poses[:, :2] - start[:2]
        distance = np.hypot(ahead[:, 0], ahead[:, 1])
        poses[:, :2] = start[:2] + ahead * (reach / np.maximum(distance, reach))[:, None]
        strength = w.position * (1.0 + w.running * p.horizon.duration)
        return np.hstack([poses, velocities]), 2.0 * max(strength, 1.0) * reach

    def _weights(self, moves: bool, steps: int) -> Array:
        """Weights (N, 5) at the ends of the steps."""
        w, model = self.parameters.weights, self._model
        size = math.hypot(*model.half)
        velocity = w.velocity if moves else 0.0
        last = np.array([w.position, w.heading, velocity, velocity * size**2, 0.0])
        weights = np.tile(last * w.running * self.parameters.horizon.step, (steps, 1))
        weights[-1] += last
        weights[-1, 4] = w.energy / model.efficiency
        return weights

    def _limits(self, start: Array, direction: float, caution: Array) -> Array:
        """Limits (N, 6); what is above its limit already may come down in its time."""
        p, model, twist = self.parameters, self._model, start[3:]
        linear, angular = p.limits.velocity
        room = (1.0 - p.reserve) * self.share
        wheels = float(np.abs(model.J @ twist).max())
        # What of its limit the polygon takes this velocity for.
        along = math.atan2(twist[1], twist[0]) + start[2] - direction
        normals = (np.arange(SIDES) + 0.5) * (2.0 * math.pi / SIDES)
        share = float(np.cos(along - normals).max()) / math.cos(math.pi / SIDES)
        linear_now = math.hypot(twist[0], twist[1]) * share
        now = np.array([linear_now, abs(twist[2]), wheels])
        steps = len(caution)
        most = np.tile([linear * room, angular * room, model.max_speed], (steps, 1))
        most[:, 0] = np.minimum(most[:, 0], caution)
        a, b = room * p.limits.linear_acceleration, room * p.limits.angular_acceleration
        rates = 0.5 * np.array([a, b, a / model.half.min()])
        passed = p.horizon.step * np.arange(1, steps + 1)[:, None]
        # No headroom here: over the cycles it would add up to ever higher speeds.
        limits = np.maximum(most, now - rates * passed)
        volts = max(model.max_voltage, model.emf * wheels * (1.0 + HEADROOM))
        return np.hstack([limits, np.tile([volts, a, b], (steps, 1))])

    def _obstacles(self, guess: Motion, ellipses: Ellipses, slots: int, clearance: float) -> Array:
        """The nearest obstacles (N, M, 7) along a guess, with their margins."""
        times = guess.times[1:]
        table = np.zeros((len(times), slots, OBSTACLE))
        table[..., :2] = FAR_AWAY
        table[..., 2], table[..., 5], table[..., 6] = 1.0, 1.0, 1.0
        if not slots or not len(ellipses):
            return table
        reachable = self._reachable(guess, ellipses)
        if not reachable.any():
            return table
        near = ellipses.select(reachable)
        centers, axes = near.centers_at(times), near.axes_at(times, clearance + self._berth(near))
        angles = np.broadcast_to(near.angles, centers.shape[:2])
        velocities = np.broadcast_to(near.velocities, centers.shape)
        if len(near) > slots:
            chosen = self._beside(guess.poses[1:], near, centers, axes, slots)
            centers, axes, velocities = (
                np.take_along_axis(values, chosen[..., None], axis=1)
                for values in (centers, axes, velocities)
            )
            angles = np.take_along_axis(angles, chosen, axis=1)
        axes = inflated(axes, self._sag(guess, velocities, axes))
        cos, sin = np.cos(angles), np.sin(angles)
        m = centers.shape[1]
        table[:, :m, :2] = centers
        table[:, :m, 2], table[:, :m, 3] = cos / axes[..., 0], sin / axes[..., 0]
        table[:, :m, 4], table[:, :m, 5] = -sin / axes[..., 1], cos / axes[..., 1]
        table[:, :m, 6] = axes.min(axis=-1)
        return table

    def _caution(self, guess: Motion, ellipses: Ellipses) -> Array:
        """Speeds (N,) [m/s] from which the robot still comes to rest if an obstacle turns to it.

        The robot closes in on it at c, along the line between them. If it turns, the robot reacts
        after t and brakes at a; the gap must last for the way of both until then, at the
        obstacle's speed u, and until it is as fast itself to get away: c t + c^2 / (2 a) +
        u (t + c / a) + u^2 / (2 a) = gap.
        """
        p, result = self.parameters, np.full(len(guess.times) - 1, math.inf)
        speeds = np.hypot(ellipses.velocities[:, 0], ellipses.velocities[:, 1])
        moving = speeds > CREEPING
        if not moving.any():
            return result
        near, u = ellipses.select(moving), speeds[moving]
        times, poses, velocities = guess.times[1:], guess.poses[1:], guess.velocities[1:]
        centers = near.centers_at(times)
        gaps = box_gap(poses, self._model.half, centers, near.axes_at(times), near.angles)
        away = centers - poses[:, None, :2]
        distance = np.maximum(np.hypot(away[..., 0], away[..., 1]), 1e-6)
        closing = (away * velocities[:, None, :2]).sum(axis=-1) / distance
        a = (1.0 - p.reserve) * p.limits.linear_deceleration
        late = REACTION + u / a
        room = np.maximum(gaps - u * REACTION - 0.5 * u * u / a, 0.0)
        allowed = a * (np.sqrt(late * late + 2.0 * room / a) - late)
        speed = np.hypot(velocities[:, 0], velocities[:, 1])[:, None]
        slower = speed * allowed / np.maximum(closing, CREEPING)
        slower[closing <= CREEPING] = math.inf
        result[:] = np.maximum(slower.min(axis=1), CAREFUL)
        return result

    def _berth(self, ellipses: Ellipses) -> Array:
        """What plans keep (M,) from obstacles that move, beside the clearance [m]."""
        speeds = np.hypot(ellipses.velocities[:, 0], ellipses.velocities[:, 1])
        return np.minimum(self.parameters.safety.berth * speeds, WIDEST_BERTH)

    def _beside(
        self, poses: Array, ellipses: Ellipses, centers: Array, axes: Array, slots: int
    ) -> NDArray[np.intp]:
        """Indices (N, slots) of the obstacles that matter at each pose.

        The nearest in each of as many sectors around the robot, where there are any, then the
        nearest of the others: a wall beside it is many discs, and must not hide the other side.
        """
        size = axes.max(axis=-1)
        away = centers - poses[:, None, :2]
        rough = np.hypot(away[..., 0], away[..., 1]) - size
        if len(ellipses) > ROUGHLY:
            some = np.argpartition(rough, ROUGHLY, axis=1)[:, :ROUGHLY]
        else:
            some = np.broadcast_to(np.arange(len(ellipses)), rough.shape)
        away, seen, wide = (
            np.take_along_axis(values, some[..., None], axis=1) for values in (away, centers, axes)
        )
        gaps = box_gap(poses, self._model.half, seen, wide, ellipses.angles[some])
        cos, sin = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
        a, b = self._model.half
        ahead = (cos * away[..., 0] + sin * away[..., 1]) / a
        aside = (cos * away[..., 1] - sin * away[..., 0]) / b
        sector = np.floor(np.arctan2(aside, ahead) * (slots / math.tau)).astype(int) % slots
        order = np.argsort(gaps, axis=1, kind="stable")
        sorted_sector = np.take_along_axis(sector, order, axis=1)
        rank = np.zeros(order.shape, dtype=int)  # among those of its sector
        for k in range(slots):
            inside = sorted_sector == k
            rank[inside] = (np.cumsum(inside, axis=1) - 1)[inside]
        best = np.argsort(rank, axis=1, kind="stable")[:, :slots]
        chosen = np.take_along_axis(order, best, axis=1)
        result: NDArray[np.intp] = np.take_along_axis(some, chosen, axis=1)
        return result

    def _reachable(self, guess: Motion, ellipses: Ellipses) -> NDArray[np.bool_]:
        """Which obstacles can come near at all, whatever the plan will be."""
        p = self.parameters
        fastest = max(p.limits.linear_velocity, float(np.abs(guess.velocities).max()))
        # Twice the speed and back again reaches as far as away for good.
        there_and_back = np.tile([2.0 * fastest, 0.0, 0.0], (2, 1))
        return within_reach(
            guess.times[[0, -1]], np.tile(guess.poses[0], (2, 1)), there_and_back,
            self._model.half, ellipses, p.safety.clearance,
        )  # fmt: skip

    def _sag(self, guess: Motion, velocities: Array, axes: Array) -> Array:
        """By how much (N, M) [m] the robot could cut into an obstacle between two nodes.

        A chord of length L between two points outside of a circle of radius c around a corner's
        way comes as near as sqrt(c^2 - L^2 / 4): the circle is made wider by that. c is the
        ellipse's least radius of curvature.
        """
        span = np.diff(guess.times)[:, None]
        relative = guess.velocities[1:, None, :2] - velocities
        turning = math.hypot(*self._model.half) * np.abs(guess.velocities[1:, 2:])
        travel = span * (np.hypot(relative[..., 0], relative[..., 1]) + turning)
        curvature = axes.min(axis=-1) ** 2 / axes.max(axis=-1)
        result: Array = np.sqrt(curvature**2 + 0.25 * travel**2) - curvature
        return result
