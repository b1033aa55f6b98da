"""How far along a route a robot sees: the places that a straight motion reaches."""

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.planning.obstacles.environment import Environment
from omniman_ros.planning.route.route import Route
from omniman_ros.surroundings.grid_map import Mask

SIGHT = 2.5  #: Part of the route after the robot that is looked at [s]
SIGHT_STEP = 0.1  #: Part of the route between two places that are looked at [s]
DETOUR = 0.3  #: Excess of the way over the straight line above which a place may be hidden [m]
SIGHT_GAP = 0.02  #: Gap around the inscribed disc that a straight motion keeps [m]
SAME_GAP = 1e-3  #: Difference up to which a disc is no nearer to an obstacle than now [m]


def is_seen(place: Array, other: Array, environment: Environment) -> bool:
    """Return whether a straight motion leads from a place (2,) to another one in odom [m]."""
    return not _hidden(place, (other - place)[None], environment)[0]


def seen_until(route: Route, position: float, place: Array, environment: Environment) -> float:
    """Return the position on a route [s] before the first one that is hidden from a place (2,).

    A position is hidden if the disc inscribed in the robot would come within SIGHT_GAP of an
    obstacle, or nearer if it is nearer now, on the straight line to it, and if the way on the
    route is longer than that line by more than DETOUR. Ellipses count as discs of their lesser
    semi-axes at rest. It is infinity where nothing is hidden within SIGHT.

    Args:
        position: Position of the robot on the route [s].
        place: (2,) place of base_link in odom [m].
    """
    positions = np.arange(position, min(position + SIGHT, route.duration), SIGHT_STEP) + SIGHT_STEP
    ahead = route.at(positions)[:, :2] - place
    if not len(positions):
        return np.inf
    way = np.vstack([np.zeros(2), ahead])
    length = np.cumsum(np.hypot(*np.diff(way, axis=0).T))
    hidden = _hidden(place, ahead, environment) & (length > np.hypot(*ahead.T) + DETOUR)
    return float(positions[int(hidden.argmax())] - SIGHT_STEP) if hidden.any() else np.inf


def _hidden(place: Array, ahead: Array, environment: Environment) -> Mask:
    """Return whether straight motions from a place (2,) by (K, 2) [m] lead too near to a thing."""
    reach = float(np.hypot(*ahead.T).max()) + environment.footprint.radius + SIGHT_GAP
    walls, known = environment.walls, environment.ellipses
    walls = walls.near(place, reach + walls.radius)
    centers = np.concatenate([walls.centers, known.centers])
    radii = np.concatenate([np.full(len(walls), walls.radius), known.semi_axes.min(axis=1)])
    offset = centers - place
    keep = radii + float(environment.footprint.whole.half.min()) + SIGHT_GAP
    keep = np.minimum(keep, np.hypot(*offset.T) - SAME_GAP)
    squares = np.maximum((ahead * ahead).sum(axis=1), np.finfo(float).tiny)
    fraction = np.clip(ahead @ offset.T / squares[:, None], 0.0, 1.0)  # (K, M)
    nearest = fraction[..., None] * ahead[:, None] - offset
    near: Mask = ((nearest * nearest).sum(axis=2) < keep * np.maximum(keep, 0.0)).any(axis=1)
    return near
