"""The camera of a film: a pinhole that looks at a point, and how it is placed."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array

NEAREST = 0.2  #: Distance along the view in front of which nothing is drawn [m]
FIELD_OF_VIEW = math.radians(36.0)  #: Angle that the width of the image spans [rad]
ELEVATION = math.radians(38.0)  #: Angle by which the camera looks down [rad]
LEAST_DISTANCE = 4.5  #: Least distance of the camera from the point it looks at [m]
#: Distance at which the search for the least distance that shows all points begins [m]
_FARTHEST = 200.0
_HALVINGS = 30  #: Number of halvings of that search
#: Angle between the direction across the drive and the view, seen from above [rad]
OBLIQUENESS = math.radians(-22.0)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera without roll."""

    target: Array  #: (3,) point in the middle of the image [m]
    azimuth: float  #: Direction of the view in the plane, from x [rad]
    elevation: float  #: Angle by which the camera looks down [rad]
    distance: float  #: Distance from the target [m]
    size: tuple[int, int]  #: Width and height of the image [px]

    @property
    def axes(self) -> Array:
        """Rows (3, 3): to the right, down and along the view, as unit vectors in `odom`."""
        ca, sa = math.cos(self.azimuth), math.sin(self.azimuth)
        ce, se = math.cos(self.elevation), math.sin(self.elevation)
        return np.array([[sa, -ca, 0.0], [-se * ca, -se * sa, -ce], [ce * ca, ce * sa, -se]])

    @property
    def position(self) -> Array:
        """Position (3,) of the camera [m]."""
        return np.asarray(self.target - self.distance * self.axes[2])

    def project(self, points: Array) -> tuple[Array, Array]:
        """Return where points are in the image.

        Args:
            points: (..., 3) in `odom` [m].

        Returns:
            (..., 2) places in the image, x to the right, y down [px], and (...) distances along
            the view [m], below `NEAREST` for what is not in front of the camera.
        """
        local = (points - self.position) @ self.axes.T
        width, height = self.size
        depth = local[..., 2]
        focal = 0.5 * width / math.tan(0.5 * FIELD_OF_VIEW)
        scale = focal / np.maximum(depth, NEAREST)
        places = local[..., :2] * scale[..., None] + np.array([0.5 * width, 0.5 * height])
        return places, depth


def fitted_camera(points: Array, size: tuple[int, int], margins: Array) -> Camera:
    """Return the camera that looks across the drive and shows all points, as near as it can.

    Args:
        points: (k, 3) points to be shown in `odom`, of which the plane part tells the direction
            of the drive [m].
        size: Width and height of the image [px].
        margins: (2, 2) free pixels at the left and the right, at the top and the bottom.
    """
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    _, directions = np.linalg.eigh(flat.T @ flat)
    along = math.atan2(directions[1, 1], directions[0, 1])
    # Of the two sides, the one from which the robot's x axis points away from the camera.
    across = math.remainder(along + 0.5 * math.pi, math.pi)
    azimuth = across + OBLIQUENESS
    target = 0.5 * (points.min(axis=0) + points.max(axis=0))
    low, high = LEAST_DISTANCE, _FARTHEST
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        camera = Camera(target, azimuth, ELEVATION, middle, size)
        shown, camera = _centred(camera, points, margins)
        low, high = (low, middle) if shown else (middle, high)
    return _centred(Camera(target, azimuth, ELEVATION, high, size), points, margins)[1]


def _centred(camera: Camera, points: Array, margins: Array) -> tuple[bool, Camera]:
    """Return the camera moved so that points (k, 3) [m] are central, and whether it shows all."""
    size = np.array(camera.size, dtype=float)
    middle = 0.5 * (margins[:, 0] + size - margins[:, 1])
    focal = 0.5 * size[0] / math.tan(0.5 * FIELD_OF_VIEW)
    for _ in range(3):
        places, depth = camera.project(points)
        off = 0.5 * (places.min(axis=0) + places.max(axis=0)) - middle
        move = off * camera.distance / focal
        target = camera.target + move @ camera.axes[:2]
        camera = Camera(target, camera.azimuth, camera.elevation, camera.distance, camera.size)
    places, depth = camera.project(points)
    fits = (places >= margins[:, 0]).all() and (places <= size - margins[:, 1]).all()
    return bool(fits and (depth > NEAREST).all()), camera
