"""Optimal reciprocal collision avoidance (ORCA) among bodies of any convex outline.

Source: J. van den Berg, S. J. Guy, M. Lin and D. Manocha, "Reciprocal n-Body Collision Avoidance",
Robotics Research, STAR 70 (2011), there for discs. Here an outline C, grown by the person's radius
and seen from the person, is described by its support function h(n), the largest n . c for c in C.
The velocity obstacle, which holds all relative velocities that lead into C within the time tau, is
convex: it consists of the v with n . v < h(n) / tau for every direction n with h(n) <= 0. So the
paper's u, the least change of velocity that leads out of it or to its border, points along the
direction in which n . v - h(n) / tau is largest. It is searched among :data:`DIRECTIONS`: each of
them bounds the obstacle, so that a coarse search costs room and never safety.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.simulation.world.velocity_program import HalfPlane

DIRECTION_COUNT = 72  #: Number of directions; even, so that each has its opposite
_ANGLES = math.tau / DIRECTION_COUNT * np.arange(DIRECTION_COUNT)
#: Unit vectors to which outlines are sampled, (d, 2)
DIRECTIONS: Array = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
KEEP_RIGHT = 0.2  #: Preference for the right [m/s]: who meet head-on would otherwise stop
RECOVERY = 0.5  #: Time in which bodies that are too near to each other move apart [s]
#: Preference for each direction (second index) while another (first index) is the nearest
_SIDES: Array = KEEP_RIGHT * np.sin(_ANGLES[None, :] - _ANGLES[:, None])


def outline(points: Array, radius: float = 0.0) -> Array:
    """Return the support function (d,) [m] of the hull of points (m, 2) [m], grown by a radius."""
    support: Array = (points @ DIRECTIONS.T).max(axis=0) + radius
    return support


@dataclass(frozen=True)
class AvoidedNeighbours(Validated):
    """What a person keeps clear of."""

    outlines: Annotated[Array, Shape("m", "d")]  #: Support functions in the world, (m, d) [m]
    velocities: Annotated[Array, Shape("m", 2)]  #: Velocities in the world, (m, 2) [m/s]
    #: Velocities that they would have if they had not to give way, (m, 2) [m/s]
    wishes: Annotated[Array, Shape("m", 2)]
    #: Least distances of the person's middle to each, (m,) [m]
    reaches: Annotated[Array, Shape("m")]
    horizons: Annotated[Array, Shape("m")]  #: How far ahead each is minded, (m,) [s]
    #: Fraction of the avoidance, (m,): 1, or 1/2 where the other does the same
    fractions: Annotated[Array, Shape("m")]
    fixed: int  #: Number of the first of them that are fixed


def half_planes(
    position: Array, velocity: Array, wish: Array, around: AvoidedNeighbours
) -> list[HalfPlane]:
    """Return the velocities that keep a person clear of each of m things.

    On which side somebody passes is chosen by what both wish, not by their velocities as in the
    paper: these get small in a crowd, and then do not tell where anybody wants to go. By how
    much they avoid each other follows from their velocities. The half-planes of things at rest
    that are not too near permit a velocity of zero.

    Args:
        position: Position of the person in the world, (2,) [m].
        wish: Velocity that the person would have if there were nothing around, (2,) [m/s].
    """
    heights = around.outlines - DIRECTIONS @ position + around.reaches[:, None]
    nearest = heights.argmin(axis=1)
    rows = np.arange(len(heights))
    is_apart = heights[rows, nearest] <= 0.0
    rates = heights / np.where(is_apart, around.horizons, RECOVERY)[:, None]
    margins = (wish - around.wishes) @ DIRECTIONS.T - rates + _SIDES[nearest]
    margins[heights > 0.0] = -math.inf
    best = np.where(is_apart, margins.argmax(axis=1), nearest)
    normals = DIRECTIONS[best]
    # With a fraction of one, the person's own velocity drops out.
    along = normals @ velocity
    change = rates[rows, best] + (normals * around.velocities).sum(axis=1) - along
    least = along + around.fractions * change
    return [(nx, ny, c) for (nx, ny), c in zip(normals.tolist(), least.tolist(), strict=True)]
