"""Pixels of points of the scene in a browser's window, for tests that use the mouse."""

import math
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np


def pixel(point, position, look_at, up, fov, width, height):
    """Return the pixel (x, y) of a point (3,) in an image, from its upper left corner.

    The camera is at `position`, looks at `look_at`, and sees an angle `fov` [rad] from the lower
    edge to the upper one.
    """
    ahead = np.asarray(look_at, dtype=float) - position
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    seen = np.asarray(point, dtype=float) - position
    depth = float(seen @ ahead)
    if depth <= 0.0:
        raise ValueError(f"{point} is behind the camera")
    focal = 0.5 * height / math.tan(0.5 * fov)
    return (
        0.5 * width + focal * float(seen @ right) / depth,
        0.5 * height + focal * float(seen @ down) / depth,
    )


def of_client(camera, point, width, height):
    """Return the pixel of a point of viser's world in the canvas of a client.

    The size is that of the page: the camera's own counts pixels of the screen.
    """
    return pixel(
        point, camera.position, camera.look_at, camera.up_direction, camera.fov, width, height
    )


def first_camera(robot):
    """Return the initial camera of a browser; the robot is at the origin."""
    from omniman_ros.viewer.page.scene import PageScene

    server = MagicMock()
    PageScene(server, robot, None, lambda event: None)
    camera = server.initial_camera
    return SimpleNamespace(
        position=np.array(camera.position),
        look_at=np.array(camera.look_at),
        fov=camera.fov,
        up_direction=np.array([0.0, 0.0, 1.0]),
    )
