"""Meshes of the platform: vertices [m] and triangles, built with numpy alone.

The frame of a wheel is at its centre: x in its rolling direction, y along its axle, z up.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.convex_pieces import convex_pieces
from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Platform

Triangles = NDArray[np.int64]  #: Indices (t, 3) of the vertices of triangles


ROLLERS = 9  #: Number of rollers of a wheel
CORE_RADIUS = 0.82  #: Ratio of the distance between roller axes and axle to the wheel's radius
OVERLAP = 1.2  #: Ratio of a roller's length to the length at which neighbouring rollers just meet
ROLLER_POINTS_AROUND = 12  #: Number of vertices of a roller around its axis
ROLLER_POINTS_ALONG = 7  #: Number of vertices of a roller along its axis
MIN_WIDTH = 0.35  #: Smallest ratio of a wheel's width to its radius, for Omni rollers
GROUND_CLEARANCE = 0.5  #: Height of the chassis above the floor over the largest radius


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh."""

    vertices: Array  #: (v, 3) [m]
    triangles: Triangles  #: (t, 3) indices of vertices, counter-clockwise as seen from outside

    def rotated(self, rotation: Array) -> "Mesh":
        """Return the mesh rotated by a matrix (3, 3)."""
        return Mesh(self.vertices @ rotation.T, self.triangles)

    def moved(self, x: float, y: float, z: float) -> "Mesh":
        """Return the mesh translated [m]."""
        return Mesh(self.vertices + np.array([x, y, z]), self.triangles)


def joined(*meshes: Mesh) -> Mesh:
    """Join meshes into one."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(
            [mesh.triangles + offset for mesh, offset in zip(meshes, offsets, strict=False)]
        ),
    )


def about_y(angle: float) -> Array:
    """Return the rotation matrix (3, 3) about y by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rotation(theta: float) -> Array:
    """Return the quaternion (w, x, y, z) of a rotation about z by an angle [rad]."""
    return np.array([math.cos(0.5 * theta), 0.0, 0.0, math.sin(0.5 * theta)])


def wheel_rotations(headings: Array, angles: Array) -> Array:
    """Return the quaternions (n, 4) of wheels with headings (n,), rolled by angles (n,) [rad]."""
    ch, sh = np.cos(0.5 * headings), np.sin(0.5 * headings)
    ca, sa = np.cos(0.5 * angles), np.sin(0.5 * angles)
    return np.stack([ch * ca, -sh * sa, ch * sa, sh * ca], axis=1)


def revolved(stations: Array, radii: Array, around: int) -> Mesh:
    """Return a closed solid about x, of radii (k,) at increasing stations (k,) [m]."""
    k = len(stations)
    angles = 2.0 * math.pi * np.arange(around) / around
    circle = np.stack([np.zeros(around), np.cos(angles), np.sin(angles)], axis=1)
    rings = stations[:, None, None] * np.array([1.0, 0.0, 0.0]) + radii[:, None, None] * circle
    ends = np.array([[stations[0], 0.0, 0.0], [stations[-1], 0.0, 0.0]])
    index = np.arange(k * around).reshape(k, around)
    here, there = index, np.roll(index, -1, axis=1)
    sides = [
        np.stack([here[:-1], there[1:], here[1:]], axis=-1).reshape(-1, 3),
        np.stack([here[:-1], there[:-1], there[1:]], axis=-1).reshape(-1, 3),
    ]
    first, last = np.full(around, k * around), np.full(around, k * around + 1)
    caps = [
        np.stack([first, there[0], here[0]], axis=-1),
        np.stack([last, here[-1], there[-1]], axis=-1),
    ]
    return Mesh(np.concatenate([rings.reshape(-1, 3), ends]), np.concatenate([*sides, *caps]))


def sphere() -> Mesh:
    """Return a sphere of radius 1 about the origin."""
    angles = np.linspace(0.0, math.pi, 9)
    return revolved(-np.cos(angles), np.sin(angles), 16)


def prism(outline: Array, bottom: float, top: float) -> Mesh:
    """Return an upright, sharp-edged prism of a convex, counter-clockwise outline (k, 2) [m]."""
    k = len(outline)
    low = np.column_stack([outline, np.full(k, bottom)])
    high = np.column_stack([outline, np.full(k, top)])
    fan = np.stack([np.zeros(k - 2, int), np.arange(1, k - 1), np.arange(2, k)], axis=1)
    i = np.arange(k)
    j = (i + 1) % k
    sides = np.concatenate([np.stack([i, j, j + k], axis=1), np.stack([i, j + k, i + k], axis=1)])
    return joined(
        Mesh(low, fan[:, ::-1]), Mesh(high, fan), Mesh(np.concatenate([low, high]), sides)
    )


def rounded(length: float, width: float, corner: float) -> Array:
    """Return the outline (k, 2) of a rectangle about the origin with rounded corners [m]."""
    corner = min(corner, 0.5 * length, 0.5 * width)
    angles = np.linspace(0.0, 0.5 * math.pi, 5)
    parts = []
    for quarter, (sx, sy) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)]):
        centre = np.array([sx * (0.5 * length - corner), sy * (0.5 * width - corner)])
        directions = angles + quarter * 0.5 * math.pi
        parts.append(centre + corner * np.stack([np.cos(directions), np.sin(directions)], axis=1))
    return np.concatenate(parts)


@dataclass(frozen=True)
class WheelShape:
    """Meshes of a wheel: rollers, the plates that hold them, and a mark that shows rotation."""

    rollers: Mesh
    plates: Mesh
    mark: Mesh


def wheel(radius: float, roller_angle: float) -> WheelShape:
    """Return the meshes of a wheel whose rollers form a cylinder of its radius.

    The axis of the roller on the floor points along (cos gamma, sin gamma), gamma = `roller_angle`
    [rad], 0 for an Omni wheel: the wheel drives the motion along this axis (CCTA 2017 (8)).

    Args:
        radius: Radius r [m].
    """
    core = CORE_RADIUS * radius
    reach = core * math.sin(math.pi / ROLLERS) * OVERLAP
    # Without the bound, a roller along the axle would be infinitely long.
    half = min(reach / max(math.cos(roller_angle), 1e-3), radius)
    stations = np.linspace(-half, half, ROLLER_POINTS_ALONG)
    radii = radius - np.hypot(core, stations * math.cos(roller_angle))
    roller = revolved(stations, np.maximum(radii, 0.02 * radius), ROLLER_POINTS_AROUND)
    c, s = math.cos(roller_angle), math.sin(roller_angle)
    on_floor = roller.rotated(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])).moved(
        0.0, 0.0, -core
    )
    steps = 2.0 * math.pi * np.arange(ROLLERS) / ROLLERS
    width = wheel_width(radius, roller_angle)
    rim = radius - float(radii.max()) * 1.1
    thin = 0.06 * radius
    along_y = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    plate = revolved(np.array([-thin, thin]), np.full(2, rim), 24).rotated(along_y)
    drum = revolved(np.array([-0.5 * width, 0.5 * width]), np.full(2, 0.35 * radius), 16).rotated(
        along_y
    )
    spoke = prism(rounded(0.16 * radius, width + 4.4 * thin, 0.0), 0.15 * rim, 0.98 * rim)
    return WheelShape(
        joined(*(on_floor.rotated(about_y(step)) for step in steps)),
        joined(drum, *(plate.moved(0.0, side * (0.5 * width + thin), 0.0) for side in (-1, 1))),
        spoke,
    )


def wheel_width(radius: float, roller_angle: float) -> float:
    """Return the distance between the plates of a wheel [m]."""
    reach = CORE_RADIUS * radius * math.sin(math.pi / ROLLERS) * OVERLAP
    along_axle = 2.0 * min(abs(math.tan(roller_angle)) * reach, radius)
    return max(0.8 * along_axle, MIN_WIDTH * radius)


@dataclass(frozen=True)
class BodyShape:
    """Meshes of a platform without wheels."""

    chassis: Mesh  #: Body between the wheels
    deck: Mesh  #: Plate above the wheels
    arrow: Mesh  #: Arrow on the deck that points to the front
    height: float  #: Height of the deck's upper side [m]


def body(robot: Platform) -> BodyShape:
    """Return the platform's meshes; heights are derived from the wheels.

    A platform with an outline of its own is a plate above the wheels, with nothing below it.
    """
    wheels, box, outline = robot.wheels, robot.body, robot.body.outline
    radius = max(wheels.radius)
    inner = 2.0 * min(
        abs(y) - 0.5 * wheel_width(r, gamma) - 0.2 * r
        for y, r, gamma in zip(wheels.y, wheels.radius, wheels.roller_angle, strict=True)
    )
    width = inner if inner > 0.25 * box.width else 0.25 * box.width
    low, high = 2.0 * radius + 0.1 * radius, 2.0 * radius + 0.5 * radius
    corner = 0.12 * min(box.length, box.width)
    size = 0.16 * min(box.length, box.width)
    front = 0.5 * box.length - 0.7 * size
    arrow = np.array([[front, 0.0], [front - size, size], [front - size, -size]])
    if outline is None:
        chassis = prism(rounded(0.92 * box.length, width, corner), GROUND_CLEARANCE * radius, low)
        deck = prism(rounded(box.length, box.width, corner), low, high)
    else:
        middle = 0.5 * (low + high)
        chassis, deck = plate(outline, low, middle), plate(outline, middle, high)
    return BodyShape(chassis, deck, prism(arrow, high, high + 0.01 * box.length), high)


def plate(outline: Array, bottom: float, top: float) -> Mesh:
    """Return an upright prism of a counter-clockwise outline (k, 2), convex or not [m]."""
    return joined(*(prism(piece, bottom, top) for piece in convex_pieces(outline)))
