"""Motion of the platform over time: a plan, and the braking at the end of it."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated

BRAKING_STEP = 0.05  #: Time between two nodes while the robot brakes [s]
REST_STEP = 0.1  #: Time between two samples of a robot at rest [s]
MIN_SPAN = 1e-6  #: Time between two nodes below which they count as the same [s]


@dataclass(frozen=True)
class HermiteTrajectory(Validated):
    """Nodes in time, joined by cubic Hermite polynomials; the robot rests outside of them.

    Poses that are not finite are let in: the check of a motion counts them as a contact.
    """

    times: Annotated[Array, Shape("K", unit="s", increasing=True)]  #: (K,) increasing times [s]
    #: (K, d) poses of base_link in odom (d = 3), headings not wrapped [m, m, rad]
    poses: Annotated[Array, Shape("K", "d", finite=False)]
    velocities: Annotated[
        Array, Shape("K", "d", finite=False)
    ]  #: (K, 3) velocities in odom [m/s, m/s, rad/s]
    #: (K - 1, n) motor currents from each node on [A]; NaN where none are planned
    currents: Annotated[Array, Shape("K - 1", "n", finite=False)]

    @staticmethod
    def of_states(
        start: float, step: float, states: Array, currents: Array
    ) -> "HermiteTrajectory":
        """Return the motion of a plan with states (N + 1, 6), one a step [s].

        The states are poses in odom and body twists; currents (N, n) are held over each step [A].
        """
        times: Array = start + step * np.arange(len(states), dtype=np.float64)
        cos, sin = np.cos(states[:, 2]), np.sin(states[:, 2])
        velocities = np.column_stack(
            [
                cos * states[:, 3] - sin * states[:, 4],
                sin * states[:, 3] + cos * states[:, 4],
                states[:, 5],
            ]
        )
        return HermiteTrajectory.unchecked(
            times=times,
            poses=states[:, :3].copy(),
            velocities=velocities,
            currents=currents.copy(),
        )

    @staticmethod
    def rest(time: float, pose: Array, controls: int) -> "HermiteTrajectory":
        """Return a motion at rest at a pose (3,) from a time [s] on, with n = `controls`."""
        return HermiteTrajectory.coasting(time, pose, np.zeros(3), controls)

    @staticmethod
    def coasting(time: float, pose: Array, velocity: Array, controls: int) -> "HermiteTrajectory":
        """Return a motion of one BRAKING_STEP at a velocity (3,) in odom, with n = `controls`."""
        nodes = np.array([time, time + BRAKING_STEP])
        poses = np.array([pose, pose + BRAKING_STEP * velocity])
        return HermiteTrajectory.unchecked(
            times=nodes,
            poses=poses,
            velocities=np.tile(velocity, (2, 1)),
            currents=np.full((1, controls), np.nan),
        )

    @property
    def start(self) -> float:
        """Time of the first node [s]."""
        return float(self.times[0])

    @property
    def end(self) -> float:
        """Time of the last node [s]."""
        return float(self.times[-1])

    def at(self, times: Array) -> tuple[Array, Array]:
        """Return poses and velocities (K, 3) at times (K,) [s]; at rest outside of the motion."""
        index = np.clip(
            np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2
        )
        span = self.times[index + 1] - self.times[index]
        t = np.clip(times - self.times[index], 0.0, span)
        poses, velocities = self._within(index, span[:, None], t[:, None])
        outside = (times < self.start) | (times > self.end)
        velocities[outside] = 0.0
        return poses, velocities

    def sample(self, time: float) -> tuple[Array, Array]:
        """Return pose and velocity (3,) at a time [s]."""
        k = int(self.times.searchsorted(time, side="right")) - 1
        k = min(max(k, 0), len(self.times) - 2)
        begin, end = self.times[k : k + 2].tolist()
        span = end - begin
        pose, velocity = self._within(k, span, min(max(time - begin, 0.0), span))
        return pose, velocity if self.start <= time <= self.end else np.zeros_like(velocity)

    def _within(
        self, k: NDArray[np.intp] | int, span: Array | float, t: Array | float
    ) -> tuple[Array, Array]:
        """Return poses and velocities at times t after nodes k, with spans to the next [s]."""
        x0, v0 = self.poses[k], self.velocities[k]
        # Cubic Hermite coefficients of u^2 and u^3.
        gap, change = self.poses[k + 1] - x0 - v0 * span, (self.velocities[k + 1] - v0) * span
        c2, c3, u = 3.0 * gap - change, change - 2.0 * gap, t / span
        return x0 + v0 * t + u * u * (c2 + u * c3), v0 + u / span * (2.0 * c2 + 3.0 * u * c3)

    def currents_at(self, time: float) -> Array:
        """Return the motor currents (n,) [A] at a time [s]; NaN where none are planned."""
        index = int(np.searchsorted(self.times, time, side="right")) - 1
        if not 0 <= index < len(self.currents):
            return np.full(self.currents.shape[1], np.nan)
        row: Array = self.currents[index]
        return row

    def between(self, first: float, last: float) -> "HermiteTrajectory":
        """Return the part from `first` to `last` [s], with nodes at both."""
        last = max(last, first + MIN_SPAN)
        inner = (self.times > first + MIN_SPAN) & (self.times < last - MIN_SPAN)
        times = np.concatenate([[first], self.times[inner], [last]])
        poses, velocities = self.at(times)
        index = np.searchsorted(self.times, times[:-1] + MIN_SPAN, side="right") - 1
        known = (index >= 0) & (index < len(self.currents))
        currents = np.full((len(index), self.currents.shape[1]), np.nan)
        currents[known] = self.currents[index[known]]
        return HermiteTrajectory.unchecked(
            times=times, poses=poses, velocities=velocities, currents=currents
        )

    def then(self, other: "HermiteTrajectory") -> "HermiteTrajectory":
        """Return this motion followed by another one that begins at its end."""
        return HermiteTrajectory.unchecked(
            times=np.concatenate([self.times[:-1], other.times]),
            poses=np.concatenate([self.poses[:-1], other.poses]),
            velocities=np.concatenate([self.velocities[:-1], other.velocities]),
            currents=np.concatenate([self.currents, other.currents]),
        )

    def braked(self, time: float, deceleration: tuple[float, float]) -> "HermiteTrajectory":
        """Return this motion up to a time [s], then braked to rest [m/s^2, rad/s^2].

        The directions of travel and of rotation stay; the two come to rest independently.
        """
        pose, velocity = self.sample(time)
        speed, yaw_rate = math.hypot(velocity[0], velocity[1]), abs(float(velocity[2]))
        ends = np.array([speed / deceleration[0], yaw_rate / deceleration[1]])
        longest = float(ends.max())
        if not MIN_SPAN <= longest < math.inf:  # non-finite values are kept, so that checks fail
            tail = HermiteTrajectory.rest(time, pose, self.currents.shape[1])
        else:
            ticks = np.arange(0.0, longest, BRAKING_STEP)
            t = np.unique(np.concatenate([ticks, ends[ends > MIN_SPAN]]))
            t = t[np.concatenate([[True], np.diff(t) > MIN_SPAN])]
            spans = np.where(ends > MIN_SPAN, ends, 1.0)[[0, 0, 1]]
            elapsed = np.minimum(t[:, None], spans)
            poses = pose + velocity * (elapsed - 0.5 * elapsed * elapsed / spans)
            velocities = velocity * (1.0 - elapsed / spans)
            unknown = np.full((len(t) - 1, self.currents.shape[1]), np.nan)
            tail = HermiteTrajectory.unchecked(
                times=time + t, poses=poses, velocities=velocities, currents=unknown
            )
        if time <= self.start + MIN_SPAN:
            return tail
        return self.between(self.start, time).then(tail)

    def fine(self, first: float, last: float, parts: int) -> tuple[Array, Array, Array]:
        """Return times (K,), poses (K, 3) and velocities (K, 3), each span in equal parts.

        Samples go from `first` up to `last` [s] if the motion is at rest before.
        """
        nodes = np.concatenate([[first], self.times[self.times > first + MIN_SPAN]])
        end = nodes[-1]
        rest_count = max(
            math.ceil((max(last, end) - end) / REST_STEP - MIN_SPAN), 1 if len(nodes) == 1 else 0
        )
        nodes = np.concatenate([nodes, end + REST_STEP * np.arange(1, rest_count + 1)])
        spans = np.diff(nodes)
        times = (nodes[:-1, None] + spans[:, None] * np.arange(parts) / parts).ravel()
        times = np.append(times, nodes[-1])
        return times, *self.at(times)
