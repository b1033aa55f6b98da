"""Rectangles that cover an outline from outside."""

import math
from functools import lru_cache
from itertools import combinations

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.polygon import trapezoids

#: Directions of rectangles that are tried besides those of the outline's sides [rad]
DIRECTIONS = np.arange(18) * (0.5 * math.pi / 18)
#: Least area that a rectangle must save, over that of the rectangle around the outline
SAVING = 0.01
LEAST_HALF = 0.02  #: Smallest half length and half width of a rectangle [m]

Corners = tuple[tuple[float, float], ...]  #: Corners of a polygon in order [m]


@lru_cache(maxsize=16)
def outline_cover(corners: Corners, most: int) -> Array:
    """Return rectangles whose union contains a polygon, its corners in order [m].

    The polygon is divided into trapezoids at its corners and between them, across and along the
    smallest rectangle around it. Two parts whose common rectangle is little larger than theirs are
    joined, again and again. The rows (P, 5) are centre, direction of the length, half length and
    half width [m, m, rad, m, m].
    """
    polygon = np.array(corners)
    sides = np.roll(polygon, -1, axis=0) - polygon
    own = np.arctan2(sides[:, 1], sides[:, 0]) % (0.5 * math.pi)
    directions = np.unique(np.concatenate((DIRECTIONS, own)))
    whole = _bounds(polygon, directions)
    covers = [
        _joined(_parts(polygon, angle), directions, most, SAVING * _size(whole))
        for angle in (whole[2], whole[2] + 0.5 * math.pi)
    ]
    best = min(covers, key=lambda rows: sum(map(_size, rows)))
    result = np.array(best)
    result.flags.writeable = False
    return result


def _parts(polygon: Array, angle: float) -> list[Array]:
    """Return trapezoids (4, 2) of a polygon that lie between lines across a direction [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    turned = polygon @ np.array([(c, -s), (s, c)])
    levels = np.unique(turned[:, 0])
    middles: list[float] = (0.5 * (levels[1:] + levels[:-1])).tolist()
    return [part @ np.array([(c, s), (-s, c)]) for part in trapezoids(turned, middles)]


def _joined(parts: list[Array], directions: Array, most: int, saving: float) -> list[Array]:
    """Return the rectangles (5,) around parts (k, 2), joined to be few.

    Each rectangle saves at least four times the area `saving` [m^2].
    """
    known: dict[tuple[int, ...], Array] = {
        (k,): _bounds(part, directions) for k, part in enumerate(parts)
    }
    costs: dict[frozenset[tuple[int, ...]], float] = {}
    while len(known) > 1:
        for first, second in combinations(known, 2):
            pair = frozenset((first, second))
            if pair not in costs:
                row = _bounds(np.concatenate([parts[k] for k in first + second]), directions)
                costs[pair] = _size(row) - _size(known[first]) - _size(known[second])
        first, second = min(combinations(known, 2), key=lambda pair: costs[frozenset(pair)])
        if len(known) <= most and costs[frozenset((first, second))] > saving:
            break
        del known[first], known[second]
        both = first + second
        known[both] = _bounds(np.concatenate([parts[k] for k in both]), directions)
    return list(known.values())


def _size(row: Array) -> float:
    """Return a quarter of the area of a rectangle [m^2]."""
    return float(row[3] * row[4])


def _bounds(points: Array, directions: Array) -> Array:
    """Return the smallest rectangle (5,) around points (k, 2), of some directions [rad]."""
    c, s = np.cos(directions)[:, None], np.sin(directions)[:, None]
    x, y = points[:, 0], points[:, 1]
    along, across = c * x + s * y, c * y - s * x
    low = np.stack((along.min(axis=1), across.min(axis=1)))
    high = np.stack((along.max(axis=1), across.max(axis=1)))
    half = np.maximum(0.5 * (high - low), LEAST_HALF)
    k = int((half[0] * half[1]).argmin())
    u, v = 0.5 * (low + high)[:, k]
    cos, sin = math.cos(directions[k]), math.sin(directions[k])
    return np.array([cos * u - sin * v, sin * u + cos * v, directions[k], *half[:, k]])
