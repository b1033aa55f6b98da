"""Shapes on the floor beside the robot: markers of start and goal, obstacles, arrows."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Body
from omniman_ros.viewer.meshes import Mesh, joined, plate, prism, revolved, rounded

OBSTACLE_HEIGHT = 0.6  #: Height of an obstacle [m]
CIRCLE_POINTS = 32  #: Number of corners of the polygon that approximates a circle
BORDER_WIDTH = 0.05  #: Ratio of the width of a marker's border to the platform's width
ARROW_TIP_RATIO = 0.4  #: Distance of a marker's arrow tip from the front, over the width
KNOB_RADIUS = 0.16  #: Ratio of the radius of a marker's knob to the platform's width
LAYER_HEIGHT = 0.004  #: Thickness of each layer of a marker [m]


@dataclass(frozen=True)
class MarkerShape:
    """Marker of a pose on the floor, as meshes in the frame of the platform.

    It has a footprint with a border, an arrow, and a knob at the arrow's tip.
    """

    plate: Mesh
    border: Mesh
    arrow: Mesh
    knob: Mesh
    tip: float  #: Distance of the knob from the origin [m]


def marker(body: Body) -> MarkerShape:
    """Return the marker of a platform's pose."""
    length, width = body.length, body.width
    corner, edge = 0.12 * min(length, width), BORDER_WIDTH * width
    if body.outline is None:
        outer = rounded(length, width, corner)
        inner = rounded(length - 2.0 * edge, width - 2.0 * edge, corner)
    else:
        outer = body.outline
        inner = narrowed(outer, edge)
    tip, head, radius = 0.5 * length + ARROW_TIP_RATIO * width, 0.3 * width, KNOB_RADIUS * width
    base = tip - radius - head
    shaft = np.array([[0.0, -edge], [base, -edge], [base, edge], [0.0, edge]])
    point = np.array([[base, -0.6 * head], [tip - radius, 0.0], [base, 0.6 * head]])
    low, high = 2.0 * LAYER_HEIGHT, 3.0 * LAYER_HEIGHT
    return MarkerShape(
        plate(outer, LAYER_HEIGHT, low),
        band(outer, inner, high),
        joined(prism(shaft, low, high), prism(point, low, high)),
        disc(radius, 0.1 * width).moved(tip, 0.0, 0.05 * width),
        tip,
    )


def narrowed(outline: Array, edge: float) -> Array:
    """Return a counter-clockwise outline (k, 2) whose sides are moved inwards by `edge` [m].

    Where two sides meet at an acute angle, the corner moves by at most three edges.
    """
    sides = np.roll(outline, -1, axis=0) - outline
    normals = np.column_stack((-sides[:, 1], sides[:, 0])) / np.hypot(*sides.T)[:, None]
    between = normals + np.roll(normals, 1, axis=0)
    length = np.maximum(0.5 * (between**2).sum(axis=1), 0.4)
    result: Array = outline + edge * between / length[:, None]
    return result


def band(outer: Array, inner: Array, height: float) -> Mesh:
    """Return a flat band between two outlines (k, 2), visible from above, at a height [m]."""
    k = len(outer)
    flat = np.column_stack([np.concatenate([outer, inner]), np.full(2 * k, height)])
    i = np.arange(k)
    j = (i + 1) % k
    near, far = np.stack([i, j, j + k], axis=1), np.stack([i, j + k, i + k], axis=1)
    return Mesh(flat, np.concatenate([near, far]))


def disc(radius: float, height: float, around: int = CIRCLE_POINTS) -> Mesh:
    """Return an upright cylinder [m] about the origin, with a smooth wall and sharp edges."""
    half = 0.5 * height
    side = revolved(np.array([-half, half]), np.full(2, radius), around)
    # Only the wall is used: the ends have vertices of their own, which makes the edges sharp.
    wall = Mesh(side.vertices, side.triangles[: 2 * around]).rotated(_UPRIGHT)
    angles = 2.0 * math.pi * np.arange(around) / around
    circle = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    i = np.arange(1, around - 1)
    fan = np.stack([np.zeros(around - 2, int), i, i + 1], axis=1)
    return joined(
        wall,
        Mesh(np.column_stack([circle, np.full(around, half)]), fan),
        Mesh(np.column_stack([circle, np.full(around, -half)]), fan[:, ::-1]),
    )


def dome() -> Mesh:
    """Return a cap of radius 1 on the origin, with a round edge above a flat wall."""
    angles = np.linspace(0.0, 0.5 * math.pi, 6)
    flat, edge = 0.45, 0.25
    stations = np.concatenate([[0.0], flat + edge * np.sin(angles)])
    radii = np.concatenate([[1.0], 1.0 - edge * (1.0 - np.cos(angles))])
    return revolved(stations, radii, CIRCLE_POINTS).rotated(_UPRIGHT)


def obstacle() -> Mesh:
    """Return an upright cylinder on the floor, of radius 1 and height `OBSTACLE_HEIGHT` [m]."""
    return disc(1.0, OBSTACLE_HEIGHT).moved(0.0, 0.0, 0.5 * OBSTACLE_HEIGHT)


def arrow_head(length: float, thickness: float) -> Mesh:
    """Return the head of an arrow along x about the origin; its thickness is along z [m]."""
    x, y = 0.5 * length, 0.45 * length
    return prism(np.array([[-x, -y], [x, 0.0], [-x, y]]), -0.5 * thickness, 0.5 * thickness)


#: Rotation matrix that maps x to z (upwards)
_UPRIGHT = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
