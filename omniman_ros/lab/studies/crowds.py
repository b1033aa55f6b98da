"""Crowds of discs on a square, and the judge of a robot among them.

Discs cross the square straight, from side to side. Two kinds: those that go through each other and
see nobody, and those that give way to each other and to the robot by optimal reciprocal collision
avoidance (van den Berg, Guy, Lin and Manocha, "Reciprocal n-Body Collision Avoidance", 2011) as
the persons of the physics world do, with the same code. Two discs share an avoidance; to the robot
a disc gives way alone, as people do to a machine.
"""

import math

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.lab.studies.closed_loop import PERIOD
from omniman_ros.planning.cycle import AT_REST
from omniman_ros.simulation.world.avoidance import (
    DIRECTIONS,
    AvoidedNeighbours,
    half_planes,
    outline,
)
from omniman_ros.simulation.world.velocity_program import nearest_velocity

HALF = 5.0  #: half of the square's edge [m]
RADIUS = 0.25  #: radius of the discs [m]
SPEEDS = (0.4, 1.0)  #: range of the discs' speeds [m/s]
NEAR = 0.3  #: distance from its target at which a disc takes another one [m]
FREE_START = 1.5  #: radius around the robot's start without discs [m]
DECISION_TICKS = 10  #: ticks between two decisions of a disc that gives way
HORIZON = 2.5  #: how far ahead a disc minds others [s]
MINDED = 10  #: number of nearest others whom a disc minds, apart from the robot
CLEARANCE = 0.05  #: gap that discs keep to what they give way to, if they can [m]


def neighbours(
    supports: Array,
    velocities: Array,
    wishes: Array,
    reach: float,
    horizon: float,
    fractions: float | Array = 0.5,
) -> AvoidedNeighbours:
    """Return what a disc of radius `reach` [m] keeps clear of for a time `horizon` [s].

    The others are as in :class:`~omniman_ros.simulation.world.avoidance.AvoidedNeighbours`.
    """
    each = np.ones(len(supports))
    return AvoidedNeighbours(
        outlines=supports,
        velocities=velocities,
        wishes=wishes,
        reaches=reach * each,
        horizons=horizon * each,
        fractions=fractions * each,
        fixed=0,
    )


class DiscCrowd:
    """Discs that cross straight from side to side.

    Args:
        gives_way: Whether they avoid each other and the robot; else they go through each other.
    """

    def __init__(self, count: int, seed: int, gives_way: bool = False) -> None:
        self._random = np.random.default_rng([seed, 0])
        places: list[Array] = []
        while len(places) < count:
            place = self._random.uniform(-HALF, HALF, 2)
            apart = [math.dist(place, other) for other in places]
            if np.hypot(*place) > FREE_START and min(apart, default=HALF) > 3.0 * RADIUS:
                places.append(place)
        self.positions: Array = np.array(places)  #: (n, 2) [m]
        self.velocities: Array = np.zeros((count, 2))  #: (n, 2) [m/s]
        self._gives_way, self._tick = gives_way, 0
        self._speeds = self._random.uniform(*SPEEDS, count)
        self._targets = np.array([self._target(place) for place in self.positions])

    def _target(self, place: Array) -> Array:
        """Return a place on the opposite side, left and right or up and down at random."""
        target: Array = self._random.uniform(-HALF, HALF, 2)
        axis = int(self._random.integers(2))
        target[axis] = -math.copysign(HALF, place[axis])
        return target

    def _wishes(self) -> Array:
        """Return the velocities (n, 2) towards the targets; who is there takes another one."""
        away = self._targets - self.positions
        for k in np.flatnonzero(np.hypot(*away.T) < NEAR).tolist():
            self._targets[k] = self._target(self.positions[k])
            away[k] = self._targets[k] - self.positions[k]
        wishes: Array = away / np.hypot(*away.T)[:, None] * self._speeds[:, None]
        return wishes

    def advance(self, corners: Array, velocity: Array) -> None:
        """Advance by one tick beside a robot with corners (k, 2) [m] and a velocity (2,) [m/s]."""
        if not self._gives_way:
            self.velocities = self._wishes()
        elif self._tick % DECISION_TICKS == 0:
            self._give_way(outline(corners), velocity)
        self.positions = self.positions + PERIOD * self.velocities
        self._tick += 1

    def _give_way(self, robot: Array, velocity: Array) -> None:
        """Choose all velocities beside a robot's support function (d,) and its velocity (2,)."""
        places, wishes, before = self.positions, self._wishes(), self.velocities
        supports = places @ DIRECTIONS.T + RADIUS
        chosen = []
        for k, place in enumerate(places):
            others = np.argsort(np.hypot(*(places - place).T))[1 : MINDED + 1]
            around = neighbours(
                np.vstack([supports[others], robot]),
                np.vstack([before[others], velocity]),
                np.vstack([wishes[others], velocity]),
                RADIUS + CLEARANCE,
                HORIZON,
                np.append(np.full(len(others), 0.5), 1.0),
            )
            planes = half_planes(place, before[k], wishes[k], around)
            wish = float(wishes[k, 0]), float(wishes[k, 1])
            chosen.append(nearest_velocity(wish, float(self._speeds[k]), [], planes))
        self.velocities = np.array(chosen)


def disc_gaps(pose: Array, half: Array, positions: Array) -> Array:
    """Return the gaps (...) of discs to boxes [m].

    Args:
        pose: Poses (..., 3) of the boxes [m, m, rad].
        half: Half length and half width of a box (2,) [m].
        positions: Positions (..., 2) of the discs [m].
    """
    offset = positions - pose[..., :2]
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x = np.abs(c * offset[..., 0] + s * offset[..., 1]) - half[0]
    y = np.abs(c * offset[..., 1] - s * offset[..., 0]) - half[1]
    gaps: Array = np.hypot(np.maximum(x, 0.0), np.maximum(y, 0.0)) - RADIUS
    return gaps


class ContactJudge:
    """Counts contacts, each once from its begin to its end, by the robot's motion at its begin.

    Args:
        half: Half length and half width of the robot (2,) [m].
    """

    def __init__(self, half: Array) -> None:
        self.moving = 0  #: number of contacts that began while the robot moved
        self.at_rest = 0  #: number of contacts that began while it rested
        self._half = half
        self._touching: set[int] = set()

    def add(self, pose: Array, velocity: Array, positions: Array) -> None:
        """Add a tick: pose (3,) and velocity (3,) of the robot, positions (n, 2) of the discs."""
        gaps = disc_gaps(pose, self._half, positions)
        touched = set(np.flatnonzero(gaps < 0.0).tolist())
        begun = len(touched - self._touching)
        if float(np.abs(velocity).max()) < AT_REST:
            self.at_rest += begun
        else:
            self.moving += begun
        self._touching = touched
