"""Triangles of the robot, of persons and of boxes, in `odom`."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.core.platform import Platform
from omniman_ros.motion.whole_body.model import Mount
from omniman_ros.recording.film.film_log import Solid
from omniman_ros.viewer import meshes, style
from omniman_ros.viewer.arm_shapes import ArmShape, Parts, rotated
from omniman_ros.viewer.floor_shapes import disc, dome, marker
from omniman_ros.viewer.meshes import Mesh, revolved
from omniman_ros.viewer.style import Colour

PERSON_HEIGHT = 1.2  #: Height from which a round body is drawn as a person [m]
PERSON = style.rgb("#f0a252")  #: Colour of persons
POST = style.rgb("#f0a252")  #: Colour of other round bodies
BOX = style.rgb("#b8c0c8")  #: Colour of boxes
COLUMN_RADIUS = 0.09  #: Radius of the column below an arm that is mounted above the deck [m]
PERSON_PROFILE = (
    (0.0, 0.75),
    (0.02, 0.82),
    (0.10, 0.72),
    (0.45, 0.62),
    (0.68, 0.80),
    (0.76, 0.72),
    (0.80, 0.34),
    (0.83, 0.30),
    (0.86, 0.46),
    (0.91, 0.55),
    (0.96, 0.45),
    (1.0, 0.06),
)  #: Outline of a person: heights over the height, radii over the radius
PERSON_SIDES = 28  #: Number of corners of a person's cross-section
#: Rotation that turns x upwards
_TO_Z = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class Triangles:
    """Triangles of one colour each."""

    corners: Array  #: (t, 3, 3) corners, counter-clockwise as seen from outside [m]
    colours: Array  #: (t, 3) red, green and blue, 0 to 255

    @staticmethod
    def of_mesh(mesh: Mesh, colour: Colour) -> "Triangles":
        """Return the triangles of a mesh."""
        colours = np.tile(np.array(colour, float), (len(mesh.triangles), 1))
        return Triangles(mesh.vertices[mesh.triangles], colours)

    @staticmethod
    def join(parts: "list[Triangles]") -> "Triangles":
        """Return all triangles of some parts."""
        corners = [np.zeros((0, 3, 3)), *(part.corners for part in parts)]
        colours = [np.zeros((0, 3)), *(part.colours for part in parts)]
        return Triangles(np.concatenate(corners), np.concatenate(colours))

    def placed(self, x: float, y: float, theta: float) -> "Triangles":
        """Return the triangles in a frame in which theirs is at a pose [m, m, rad]."""
        c, s = math.cos(theta), math.sin(theta)
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return Triangles(self.corners @ rotation.T + np.array([x, y, 0.0]), self.colours)


class RobotBody:
    """The robot as triangles."""

    def __init__(self, robot: Platform, mount: Mount | None) -> None:
        shape = meshes.body(robot)
        fixed = [
            Triangles.of_mesh(shape.chassis, style.CHASSIS),
            Triangles.of_mesh(shape.deck, style.DECK),
            Triangles.of_mesh(shape.arrow, style.ACCENT),
        ]
        self._wheels = [_wheel(robot, i) for i in range(robot.wheel_count)]
        self._arm = None if mount is None else ArmShape(mount)
        self._tube, self._cap = disc(1.0, 1.0, around=20), dome()
        if mount is not None and mount.z > shape.height:
            column = disc(COLUMN_RADIUS, mount.z - shape.height)
            column = column.moved(mount.x, mount.y, 0.5 * (mount.z + shape.height))
            fixed.append(Triangles.of_mesh(column, style.CHASSIS))
        self._fixed = Triangles.join(fixed)
        self.goal_marker = _marker(robot)

    def at(self, pose: Triple, wheels: Array, joints: Array | None) -> Triangles:
        """Return the robot.

        Args:
            pose: Pose of base_link in `odom` [m, m, rad].
            joints: Joint angles (6,) [rad]; None to leave out the arm.
        """
        parts = [self._fixed]
        parts += [wheel(float(angle)) for wheel, angle in zip(self._wheels, wheels, strict=True)]
        if self._arm is not None and joints is not None:
            frames = self._arm.frames(joints)
            for mesh, instances, colour in (
                (self._tube, self._arm.tubes, style.ARM_TUBES),
                (self._cap, self._arm.caps, style.ARM_CAPS),
            ):
                parts.append(_instances(mesh, instances, frames, colour))
        return Triangles.join(parts).placed(*pose)


def solid_body(solid: Solid) -> Triangles:
    """Return a person, a post or a box."""
    low, high = solid.heights
    length, width = solid.size
    if not solid.is_round:
        mesh = meshes.prism(meshes.rounded(length, width, 0.0), low, high)
        colour = BOX
    elif high - low >= PERSON_HEIGHT:
        profile = np.array(PERSON_PROFILE)
        radius = 0.5 * min(length, width)
        upright = revolved(
            profile[:, 0] * (high - low), profile[:, 1] * radius, PERSON_SIDES
        ).rotated(_TO_Z)
        mesh, colour = upright.moved(0.0, 0.0, low), PERSON
    else:
        height = high - low
        cylinder = disc(1.0, 1.0)
        stretched = cylinder.vertices * np.array([0.5 * length, 0.5 * width, height])
        mesh = Mesh(stretched, cylinder.triangles).moved(0.0, 0.0, low + 0.5 * height)
        colour = POST
    return Triangles.of_mesh(mesh, colour).placed(*solid.place)


def ribbon(points: Array, width: float, colour: Colour) -> Triangles:
    """Return a line through points (k, 3) as a tube of four sides of a width [m]."""
    start, end = points[:-1], points[1:]
    way = end - start
    length = np.linalg.norm(way, axis=1)
    start, way, length = start[length > 0.0], way[length > 0.0], length[length > 0.0]
    along = way / length[:, None]
    helper = np.where(np.abs(along[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    side = np.cross(along, helper)
    side *= 0.5 * width / np.linalg.norm(side, axis=1)[:, None]
    up = np.cross(side, along)
    around = [side, up, -side, -up]
    faces = []
    for first, second in zip(around, around[1:] + around[:1], strict=True):
        a, b = start + first, start + second
        c, d = b + way, a + way
        faces += [np.stack((a, b, c), axis=1), np.stack((a, c, d), axis=1)]
    corners = np.concatenate(faces)
    return Triangles(corners, np.tile(np.array(colour, float), (len(corners), 1)))


def _marker(robot: Platform) -> Triangles:
    shape = marker(robot.body)
    light = style.rgb("#8fb0f0")
    return Triangles.join(
        [
            Triangles.of_mesh(shape.plate, light),
            *(Triangles.of_mesh(m, style.GOAL) for m in (shape.border, shape.arrow, shape.knob)),
        ]
    )


def _wheel(robot: Platform, i: int) -> Callable[[float], Triangles]:
    wheels = robot.wheels
    radius = wheels.radius[i]
    shape = meshes.wheel(radius, wheels.roller_angle[i])
    parts = Triangles.join(
        [
            Triangles.of_mesh(shape.rollers, style.RUBBER),
            Triangles.of_mesh(shape.plates, style.WHEEL_PLATES),
            Triangles.of_mesh(shape.mark, style.ACCENT),
        ]
    )

    def at(angle: float) -> Triangles:
        turned = parts.corners @ meshes.about_y(angle).T
        rolled = Triangles(turned + np.array([0.0, 0.0, radius]), parts.colours)
        return rolled.placed(wheels.x[i], wheels.y[i], wheels.heading[i])

    return at


def _instances(mesh: Mesh, parts: Parts, frames: tuple[Array, Array], colour: Colour) -> Triangles:
    positions, rotations = ArmShape.placed(parts, frames)
    scaled = mesh.vertices[None] * parts.scales[:, None]
    turned = rotated(np.broadcast_to(rotations[:, None], (*scaled.shape[:2], 4)), scaled)
    corners = (turned + positions[:, None])[:, mesh.triangles].reshape(-1, 3, 3)
    return Triangles(corners, np.tile(np.array(colour, float), (len(corners), 1)))
