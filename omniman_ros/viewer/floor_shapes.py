"""Shapes of what stands on the floor beside the robot: start and goal, obstacles, arrows."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.robot import Body
from omniman_ros.viewer.meshes import Array, Mesh, joined, prism, revolved, rounded

HEIGHT = 0.6
"""Of an obstacle [m]."""
ROUND = 32
"""Corners of what is round."""
BORDER = 0.05
"""Width of a marker's border over the platform's width."""
AHEAD = 0.4
"""How far the tip of a marker's arrow is ahead of the platform's front, over its width."""
KNOB = 0.16
"""Radius of a marker's knob over the platform's width."""
THIN = 0.004
"""Height of a marker's layers [m]."""


@dataclass(frozen=True)
class MarkerShape:
    """A pose on the floor: footprint, its border and arrow, and a knob at the arrow's tip.

    Attributes:
        plate, border, arrow, knob: In the frame of the platform.
        tip: Distance of the knob from the middle [m].
    """

    plate: Mesh
    border: Mesh
    arrow: Mesh
    knob: Mesh
    tip: float


def marker(body: Body) -> MarkerShape:
    """The marker of a platform's pose."""
    length, width = body.length, body.width
    corner, edge = 0.12 * min(length, width), BORDER * width
    outer = rounded(length, width, corner)
    inner = rounded(length - 2.0 * edge, width - 2.0 * edge, corner)
    tip, head, radius = 0.5 * length + AHEAD * width, 0.3 * width, KNOB * width
    base = tip - radius - head
    shaft = np.array([[0.0, -edge], [base, -edge], [base, edge], [0.0, edge]])
    point = np.array([[base, -0.6 * head], [tip - radius, 0.0], [base, 0.6 * head]])
    low, high = 2.0 * THIN, 3.0 * THIN
    return MarkerShape(
        prism(outer, THIN, low),
        band(outer, inner, high),
        joined(prism(shaft, low, high), prism(point, low, high)),
        disc(radius, 0.1 * width).moved(tip, 0.0, 0.05 * width),
        tip,
    )


def band(outer: Array, inner: Array, height: float) -> Mesh:
    """A flat band between two outlines (k, 2) [m] of as many points, seen from above."""
    k = len(outer)
    flat = np.column_stack([np.concatenate([outer, inner]), np.full(2 * k, height)])
    i = np.arange(k)
    j = (i + 1) % k
    near, far = np.stack([i, j, j + k], axis=1), np.stack([i, j + k, i + k], axis=1)
    return Mesh(flat, np.concatenate([near, far]))


def disc(radius: float, height: float, around: int = ROUND) -> Mesh:
    """An upright cylinder about the origin [m], smooth around and with a sharp edge."""
    half = 0.5 * height
    side = revolved(np.array([-half, half]), np.full(2, radius), around)
    # Only its wall: the vertices of the ends are others, so that light breaks at the edge.
    wall = Mesh(side.vertices, side.triangles[: 2 * around]).turned(_UPRIGHT)
    angles = 2.0 * math.pi * np.arange(around) / around
    circle = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    i = np.arange(1, around - 1)
    fan = np.stack([np.zeros(around - 2, int), i, i + 1], axis=1)
    return joined(
        wall,
        Mesh(np.column_stack([circle, np.full(around, half)]), fan),
        Mesh(np.column_stack([circle, np.full(around, -half)]), fan[:, ::-1]),
    )


def dome(flat: float = 0.45, height: float = 0.7) -> Mesh:
    """A cap of radius 1 upon the origin, with a round edge.

    Args:
        flat: Height of its wall.
        height: Its whole height.
    """
    turn = np.linspace(0.0, 0.5 * math.pi, 6)
    edge = height - flat
    stations = np.concatenate([[0.0], flat + edge * np.sin(turn)])
    radii = np.concatenate([[1.0], 1.0 - edge * (1.0 - np.cos(turn))])
    return revolved(stations, radii, ROUND).turned(_UPRIGHT)


def obstacle() -> Mesh:
    """A cylinder of radius 1 and an obstacle's height that stands on the floor."""
    return disc(1.0, HEIGHT).moved(0.0, 0.0, 0.5 * HEIGHT)


def dart(length: float, thickness: float) -> Mesh:
    """The head of an arrow along x about the origin [m]."""
    x, y = 0.5 * length, 0.45 * length
    return prism(np.array([[-x, -y], [x, 0.0], [-x, y]]), -0.5 * thickness, 0.5 * thickness)


_UPRIGHT = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""Turns x upwards."""
