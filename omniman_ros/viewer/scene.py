"""The robot in space: what of the picture stands on the floor."""

import math
from collections.abc import Sequence

import numpy as np
import viser

from omniman_ros.core.robot import Robot
from omniman_ros.viewer import meshes
from omniman_ros.viewer.meshes import Mesh, rotation, wheel_rotations
from omniman_ros.viewer.state import JUMP, Array, Picture, Pose, segments

Colour = tuple[int, int, int]

ROBOT: Colour = (173, 181, 189)
CHASSIS: Colour = (73, 80, 87)
RUBBER: Colour = (38, 42, 46)
PLATES: Colour = (206, 212, 218)
ACCENT: Colour = (253, 126, 20)
GHOST: Colour = (34, 139, 230)
PATH: Colour = (43, 138, 62)
TRAIL: Colour = (73, 80, 87)
PLAN: Colour = (194, 37, 156)
OBSTACLE: Colour = (156, 54, 23)

LIFT = 0.004
"""Height of the lowest line above the floor; each next one is that much higher [m]."""


class _Wheels:
    """All wheels of one shape, each part of them one batch: single handles cost ten times that.

    Args:
        api: Where to.
        name: Of the batches.
        robot: Whose wheels.
        members: Indices of the wheels of this shape.
    """

    def __init__(
        self, api: viser.SceneApi, name: str, robot: Robot, members: Sequence[int]
    ) -> None:
        wheels = robot.wheels
        self._members = list(members)
        self._headings = np.array(wheels.heading)[self._members]
        radius = wheels.radius[members[0]]
        shape = meshes.wheel(radius, wheels.roller_angle[members[0]])
        positions = np.array([[wheels.x[i], wheels.y[i], radius] for i in members])
        still = wheel_rotations(self._headings, np.zeros(len(members)))
        self._batches = [
            api.add_batched_meshes_simple(
                f"{name}/{part}", mesh.vertices, mesh.triangles, still, positions,
                batched_colors=colour, flat_shading=flat, lod="off", cast_shadow=False,
                receive_shadow=False,
            )
            for part, mesh, colour, flat in (
                ("rollers", shape.rollers, RUBBER, False),
                ("plates", shape.plates, PLATES, True),
                ("mark", shape.mark, ACCENT, True),
            )
        ]  # fmt: skip

    def turn(self, angles: Array) -> None:
        """Show all wheels at their angles (n,) [rad]."""
        rotations = wheel_rotations(self._headings, angles[self._members])
        for batch in self._batches:
            batch.batched_wxyzs = rotations.astype(np.float32)


class _Line:
    """A line on the floor that is sent again only when it has changed."""

    def __init__(
        self, api: viser.SceneApi, name: str, colour: Colour, width: float, layer: int,
        jump: float = math.inf,
    ) -> None:  # fmt: skip
        self._version = 0
        self._height = LIFT * layer
        self._jump = jump
        self._handle = api.add_line_segments(
            name, np.zeros((1, 2, 3)), colour, thickness=width, thickness_units="screen",
            visible=False,
        )  # fmt: skip

    def show(self, points: Array, version: int) -> None:
        """Show points (k, 2) [m]."""
        if version == self._version:
            return
        self._version = version
        flat = segments(points, self._jump)
        if len(flat):
            full = np.full((len(flat), 2, 3), self._height, dtype=np.float32)
            full[:, :, :2] = flat
            self._handle.points = full
        self._handle.visible = bool(len(flat))


class Scene:
    """Floor, robot, ghost and lines.

    Args:
        server: The page's.
        robot: What it looks like.
    """

    def __init__(self, server: viser.ViserServer, robot: Robot) -> None:
        self._server = server
        api = server.scene
        api.configure_default_lights(enabled=True, cast_shadow=False)
        # All stands on this frame: to follow the robot it is the world that moves, so that every
        # browser keeps its own view.
        self._world = api.add_frame("/world", show_axes=False)
        api.add_grid(
            "/world/floor", infinite_grid=True, cell_size=0.5, section_size=1.0,
            cell_thickness=0.6, section_thickness=1.0, cell_color=(222, 226, 230),
            section_color=(190, 196, 202), fade_distance=40.0, shadow_opacity=0.0,
        )  # fmt: skip
        api.add_frame("/world/odom", axes_length=0.3, axes_radius=0.008, origin_radius=0.012)
        shape = meshes.body(robot)
        self._robot = api.add_frame("/world/robot", show_axes=False, visible=False)
        for name, mesh, colour in (
            ("chassis", shape.chassis, CHASSIS),
            ("deck", shape.deck, ROBOT),
            ("arrow", shape.arrow, ACCENT),
        ):
            self._solid(f"/world/robot/{name}", mesh, colour)
        self._ghost = api.add_frame("/world/ghost", show_axes=False, visible=False)
        # A little smaller: where the two agree, the ghost is hidden in the robot.
        for name, mesh in (("chassis", shape.chassis), ("deck", shape.deck)):
            self._solid(f"/world/ghost/{name}", mesh, GHOST, 0.5, scale=0.985)
        kinds: dict[tuple[float, float], list[int]] = {}
        for i, kind in enumerate(zip(robot.wheels.radius, robot.wheels.roller_angle, strict=True)):
            kinds.setdefault(kind, []).append(i)
        self._wheels = [
            _Wheels(api, f"/world/robot/wheels_{k}", robot, members)
            for k, members in enumerate(kinds.values())
        ]
        self._path = _Line(api, "/world/path", PATH, 3.0, 1)
        self._truth_trail = _Line(api, "/world/ghost_trail", GHOST, 2.0, 2, JUMP)
        self._odom_trail = _Line(api, "/world/trail", TRAIL, 2.0, 3, JUMP)
        self._reference = _Line(api, "/world/reference", ACCENT, 4.0, 4)
        self._plan = _Line(api, "/world/plan", PLAN, 4.0, 5)
        self._obstacles = _Line(api, "/world/obstacles", OBSTACLE, 4.0, 6)
        size = max(robot.body.length, robot.body.width)
        server.initial_camera.position = (-1.5 * size, -1.6 * size, 1.6 * size)
        server.initial_camera.look_at = (0.0, 0.0, 0.0)

    def _solid(
        self, name: str, mesh: Mesh, colour: Colour, opacity: float | None = None,
        scale: float = 1.0,
    ) -> None:  # fmt: skip
        self._server.scene.add_mesh_simple(
            name, mesh.vertices, mesh.triangles, color=colour, opacity=opacity, scale=scale,
            flat_shading=True, cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def draw(self, picture: Picture, follow: bool) -> None:
        """Show the robot and the ghost where they are; if asked to, keep the robot in sight."""
        if follow and picture.odom is not None:
            self._world.position = np.array([-picture.odom[0], -picture.odom[1], 0.0])
        _place(self._robot, picture.odom)
        _place(self._ghost, picture.truth)
        for wheels in self._wheels:
            wheels.turn(picture.wheel_angles)

    def draw_lines(self, picture: Picture) -> None:
        """Show what lies on the floor; less often, as a long line is sent as a whole."""
        for line, what in (
            (self._path, picture.path),
            (self._reference, picture.reference),
            (self._plan, picture.plan),
            (self._obstacles, picture.obstacles),
            (self._odom_trail, picture.odom_trail),
            (self._truth_trail, picture.truth_trail),
        ):
            line.show(what.points, what.version)


def _place(frame: viser.FrameHandle, pose: Pose | None) -> None:
    if pose is not None:
        frame.position = np.array([pose[0], pose[1], 0.0])
        frame.wxyz = rotation(pose[2])
    frame.visible = pose is not None
