"""Twists that the wheels of a platform reach at limited speed: a polytope, exactly."""

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import ParameterError

ROUND_OFF = 1e-9  #: Excess over a limit, relative to it, that is round-off


@dataclass(frozen=True)
class TwistPolytope:
    """Twists x'_R = (x', y', theta') at which no wheel exceeds its largest speed.

    In each row |J x'_R| <= phi'_max, with phi' = J x'_R of CCTA 2017 (9). Each wheel bounds the
    set by two opposite planes: it is convex, and symmetric about zero. Four equal Mecanum wheels
    at (+-a, +-b) give the octahedron |x'| + |y'| + (a + b) |theta'| <= r phi'_max.

    Raises:
        ParameterError: The largest speed is not a finite number above 0.
    """

    kinematics: PlatformKinematics
    max_speed: float  #: Largest wheel speed phi'_max [rad/s]

    def __post_init__(self) -> None:
        if not 0.0 < self.max_speed < np.inf:
            raise ParameterError("max_speed", self.max_speed, "must be finite and above 0 rad/s")

    @property
    def _normals(self) -> Array:
        """Rows (2 n, 3) of the planes `normals @ twist = 1`."""
        rows = self.kinematics.J / self.max_speed
        return np.vstack([rows, -rows])

    @cached_property
    def vertices(self) -> Array:
        """Vertices (K, 3) in base_link [m/s, m/s, rad/s], read-only."""
        vertices = _corners(self._normals, np.ones(2 * self.kinematics.wheel_count))
        vertices.flags.writeable = False
        return vertices

    @property
    def maxima(self) -> Array:
        """Largest value (3,) of each component of a twist [m/s, m/s, rad/s].

        The box that they span is the smallest one around the polytope, not one within it.
        """
        result: Array = self.vertices.max(axis=0)
        return result

    @property
    def faces(self) -> tuple[Array, ...]:
        """Faces, each by its corners (k, 3) in order around it [m/s, m/s, rad/s]."""
        size, faces = self.maxima, {}
        for normal in self._normals:
            on = np.flatnonzero(self.vertices @ normal > 1.0 - 1e3 * ROUND_OFF)
            if len(on) < 3:
                continue  # another wheel meets its limit before this one
            corners = self.vertices[on] / size
            middle = corners.mean(axis=0)
            first = corners[0] - middle
            second = np.cross(normal * size, first)
            angles = np.arctan2((corners - middle) @ second, (corners - middle) @ first)
            faces[tuple(on.tolist())] = size * corners[np.argsort(angles)]
        return tuple(faces.values())

    @property
    def volume(self) -> float:
        """Volume of the set [m^2 rad/s^3]: a cone from zero over each face."""
        total = 0.0
        for face in self.faces:
            first, second = face[1:-1] - face[0], face[2:] - face[0]
            total += abs(float((np.cross(first, second) @ face[0]).sum())) / 6.0
        return total

    def section(self, yaw_rate: float = 0.0) -> Array:
        """Return the corners (k, 2) of the set of (x', y') at a yaw rate, counter-clockwise.

        There are none if the yaw rate is out of reach.

        Args:
            yaw_rate: theta' [rad/s].
        """
        normals = self._normals
        corners = _corners(normals[:, :2], 1.0 - yaw_rate * normals[:, 2])
        x, y = (corners - corners.mean(axis=0) if len(corners) else corners).T
        ordered: Array = corners[np.argsort(np.arctan2(y, x))]
        return ordered

    def utilisation(self, twists: Array) -> Array:
        """Return the fraction (...) of the largest wheel speed that twists (..., 3) take.

        Twists of up to 1 are reachable. Divided by their utilisation, the others are, too, in the
        same direction.
        """
        result: Array = np.abs(twists @ self.kinematics.J.T).max(axis=-1) / self.max_speed
        return result


def _corners(normals: Array, bounds: Array) -> Array:
    """Return the corners (K, d) of the bounded set normals (h, d) @ z <= bounds (h,).

    Each corner is where d planes meet and no other is exceeded.
    """
    dimension = normals.shape[1]
    scale = np.linalg.norm(normals, axis=0)
    scaled = normals / scale
    chosen = np.array(list(itertools.combinations(range(len(normals)), dimension)))
    chosen = chosen[np.abs(np.linalg.det(scaled[chosen])) > ROUND_OFF]
    points = np.linalg.solve(scaled[chosen], bounds[chosen][..., None])[..., 0]
    points = points[(points @ scaled.T <= bounds + ROUND_OFF).all(axis=1)]
    size = np.abs(points).max(initial=ROUND_OFF)
    _, first = np.unique(np.round(points / size, 7), axis=0, return_index=True)
    result: Array = points[first] / scale
    return result
