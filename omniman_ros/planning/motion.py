"""A motion of the platform in time: what was planned, and the braking at its end."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BRAKE_TICK = 0.05
"""Time between two nodes of a braking [s]."""
REST_TICK = 0.1
"""Time between two looks at a robot at rest [s]."""
SHORTEST = 1e-6
"""Nodes that are closer in time than this are one [s]."""


@dataclass(frozen=True)
class Motion:
    """Nodes in time, joined by cubic Hermite polynomials; it rests after its end.

    Attributes:
        times: (K,) increasing [s].
        poses: (K, 3) of base_link in odom, headings not wrapped [m, m, rad].
        velocities: (K, 3) in odom [m/s, m/s, rad/s].
        currents: (K - 1, n) of the motors from each node on [A]; NaN where none are planned.
    """

    times: Array
    poses: Array
    velocities: Array
    currents: Array

    @staticmethod
    def of_states(start: float, step: float, states: Array, currents: Array) -> "Motion":
        """The plan of states (N + 1, 6), body twists, and currents (N, n), a step [s] apart."""
        times: Array = start + step * np.arange(len(states), dtype=np.float64)
        cos, sin = np.cos(states[:, 2]), np.sin(states[:, 2])
        velocities = np.column_stack(
            [
                cos * states[:, 3] - sin * states[:, 4],
                sin * states[:, 3] + cos * states[:, 4],
                states[:, 5],
            ]
        )
        return Motion(times, states[:, :3], velocities, currents)

    @staticmethod
    def rest(time: float, pose: Array, controls: int) -> "Motion":
        """Standing still from a time on."""
        return Motion.coasting(time, pose, np.zeros(3), controls)

    @staticmethod
    def coasting(time: float, pose: Array, velocity: Array, controls: int) -> "Motion":
        """Going on at a velocity (3,) in odom, for a moment."""
        nodes = np.array([time, time + BRAKE_TICK])
        poses = np.array([pose, pose + BRAKE_TICK * velocity])
        return Motion(nodes, poses, np.tile(velocity, (2, 1)), np.full((1, controls), np.nan))

    @property
    def start(self) -> float:
        """Time of the first node [s]."""
        return float(self.times[0])

    @property
    def end(self) -> float:
        """Time of the last node [s]."""
        return float(self.times[-1])

    def at(self, times: Array) -> tuple[Array, Array]:
        """Poses and velocities (K, 3) at times (K,); at rest outside of the motion."""
        index = np.clip(
            np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2
        )
        span = (self.times[index + 1] - self.times[index])[:, None]
        t = np.clip(times - self.times[index], 0.0, span[:, 0])[:, None]
        x0, x1 = self.poses[index], self.poses[index + 1]
        v0, v1 = self.velocities[index], self.velocities[index + 1]
        gap, lift, u = x1 - x0 - v0 * span, (v1 - v0) * span, t / span
        c2, c3 = 3.0 * gap - lift, lift - 2.0 * gap
        poses = x0 + v0 * t + u * u * (c2 + u * c3)
        velocities = v0 + u / span * (2.0 * c2 + 3.0 * u * c3)
        outside = (times < self.start) | (times > self.end)
        velocities[outside] = 0.0
        return poses, velocities

    def sample(self, time: float) -> tuple[Array, Array]:
        """Pose and velocity (3,) at a time [s]."""
        poses, velocities = self.at(np.array([time]))
        return poses[0], velocities[0]

    def currents_at(self, time: float) -> Array:
        """Currents (n,) [A] at a time; NaN where none are planned."""
        index = int(np.searchsorted(self.times, time, side="right")) - 1
        if not 0 <= index < len(self.currents):
            return np.full(self.currents.shape[1], np.nan)
        row: Array = self.currents[index]
        return row

    def between(self, first: float, last: float) -> "Motion":
        """The part from `first` to `last` [s], with nodes there; it rests beyond its end."""
        last = max(last, first + SHORTEST)
        inner = (self.times > first + SHORTEST) & (self.times < last - SHORTEST)
        times = np.concatenate([[first], self.times[inner], [last]])
        poses, velocities = self.at(times)
        index = np.searchsorted(self.times, times[:-1] + SHORTEST, side="right") - 1
        known = (index >= 0) & (index < len(self.currents))
        currents = np.full((len(index), self.currents.shape[1]), np.nan)
        currents[known] = self.currents[index[known]]
        return Motion(times, poses, velocities, currents)

    def then(self, other: "Motion") -> "Motion":
        """This motion until the other begins, which is where this one ends."""
        return Motion(
            np.concatenate([self.times[:-1], other.times]),
            np.concatenate([self.poses[:-1], other.poses]),
            np.concatenate([self.velocities[:-1], other.velocities]),
            np.concatenate([self.currents, other.currents]),
        )

    def braked(self, time: float, deceleration: tuple[float, float]) -> "Motion":
        """This motion until a time, then braked to rest: linear and angular [m/s^2, rad/s^2].

        Direction of travel and sense of turning stay; the slower of the two ends last.
        """
        pose, velocity = self.sample(time)
        speed, turning = math.hypot(velocity[0], velocity[1]), abs(float(velocity[2]))
        ends = np.array([speed / deceleration[0], turning / deceleration[1]])
        longest = float(ends.max())
        if not SHORTEST <= longest < math.inf:  # what is not finite stays so, to be refused
            tail = Motion.rest(time, pose, self.currents.shape[1])
        else:
            ticks = np.arange(0.0, longest, BRAKE_TICK)
            t = np.unique(np.concatenate([ticks, ends[ends > SHORTEST]]))
            t = t[np.concatenate([[True], np.diff(t) > SHORTEST])]
            spans = np.where(ends > SHORTEST, ends, 1.0)[[0, 0, 1]]
            run = np.minimum(t[:, None], spans)
            poses = pose + velocity * (run - 0.5 * run * run / spans)
            velocities = velocity * (1.0 - run / spans)
            unknown = np.full((len(t) - 1, self.currents.shape[1]), np.nan)
            tail = Motion(time + t, poses, velocities, unknown)
        if time <= self.start + SHORTEST:
            return tail
        return self.between(self.start, time).then(tail)

    def fine(self, first: float, last: float, parts: int) -> tuple[Array, Array, Array]:
        """Times, poses and velocities from `first` on, each span between nodes in `parts`.

        They go on to `last` where the motion is at rest before.
        """
        nodes = np.concatenate([[first], self.times[self.times > first + SHORTEST]])
        rest = nodes[-1]
        more = max(
            math.ceil((max(last, rest) - rest) / REST_TICK - SHORTEST), 1 if len(nodes) == 1 else 0
        )
        nodes = np.concatenate([nodes, rest + REST_TICK * np.arange(1, more + 1)])
        spans = np.diff(nodes)
        times = (nodes[:-1, None] + spans[:, None] * np.arange(parts) / parts).ravel()
        times = np.append(times, nodes[-1])
        return times, *self.at(times)
