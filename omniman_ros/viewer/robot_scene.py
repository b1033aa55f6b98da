"""The robot: platform, wheels, arm, and the ghost that shows where a simulated one really is."""

from collections.abc import Sequence

import numpy as np
import viser

from omniman_ros.core.body.model import Mount
from omniman_ros.core.robot import Robot
from omniman_ros.viewer import meshes
from omniman_ros.viewer.arm_shapes import ArmShape
from omniman_ros.viewer.floor_scene import ACCENT, GHOST, Colour
from omniman_ros.viewer.floor_shapes import disc, dome
from omniman_ros.viewer.meshes import Array, Mesh, rotation, wheel_rotations
from omniman_ros.viewer.state import Picture, Pose

ROBOT: Colour = (173, 181, 189)
CHASSIS: Colour = (73, 80, 87)
RUBBER: Colour = (38, 42, 46)
PLATES: Colour = (206, 212, 218)
TUBES: Colour = (214, 219, 224)
CAPS: Colour = (38, 108, 196)
FOOT: Colour = (134, 142, 150)
STAND_RADIUS = 0.09
"""Of the column below an arm that stands above the deck [m]."""


class RobotScene:
    """The robot and its ghost.

    Args:
        api: Where to.
        root: The frame that all stands on.
        robot: What it looks like.
        mount: Where the arm stands; None for a robot without one.
    """

    def __init__(self, api: viser.SceneApi, root: str, robot: Robot, mount: Mount | None) -> None:
        shape = meshes.body(robot)
        name = f"{root}/robot"
        self._robot = Stand(api, name)
        for part, mesh, colour in (
            ("chassis", shape.chassis, CHASSIS),
            ("deck", shape.deck, ROBOT),
            ("arrow", shape.arrow, ACCENT),
        ):
            solid(api, f"{name}/{part}", mesh, colour)
        self._ghost = Stand(api, f"{root}/ghost")
        # A little smaller: where the two agree, the ghost is hidden in the robot.
        for part, mesh in (("chassis", shape.chassis), ("deck", shape.deck)):
            solid(api, f"{root}/ghost/{part}", mesh, GHOST, 0.5, scale=0.985)
        kinds: dict[tuple[float, float], list[int]] = {}
        for i, kind in enumerate(zip(robot.wheels.radius, robot.wheels.roller_angle, strict=True)):
            kinds.setdefault(kind, []).append(i)
        self._wheels = [
            _Wheels(api, f"{name}/wheels_{k}", robot, members)
            for k, members in enumerate(kinds.values())
        ]
        self._arm = None if mount is None else _Arm(api, f"{name}/arm", mount, shape.height)

    def draw(self, picture: Picture) -> None:
        """Show a picture's robot."""
        self._robot.put(picture.odom)
        self._ghost.put(picture.truth)
        for wheels in self._wheels:
            wheels.turn(picture.wheel_angles)
        if self._arm is not None and picture.arm is not None:
            self._arm.show(picture.arm)


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
        self._angles: Array | None = None
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
        if self._angles is not None and np.array_equal(angles, self._angles):
            return
        self._angles = np.array(angles)
        rotations = wheel_rotations(self._headings, angles[self._members])
        for batch in self._batches:
            batch.batched_wxyzs = rotations.astype(np.float32)


class _Arm:
    """The arm: tubes and caps, two batches; hidden until it is shown first.

    Args:
        api: Where to.
        name: Of its frame.
        mount: Where it stands.
        deck: Height of the deck below it [m].
    """

    def __init__(self, api: viser.SceneApi, name: str, mount: Mount, deck: float) -> None:
        self._shape = ArmShape(mount)
        self._angles: Array | None = None
        self._frame = api.add_frame(name, show_axes=False, visible=False)
        if mount.z > deck:
            stand = disc(STAND_RADIUS, mount.z - deck)
            middle = 0.5 * (mount.z + deck)
            solid(api, f"{name}/stand", stand.moved(mount.x, mount.y, middle), CHASSIS, flat=False)
        still = self._shape.frames(np.zeros(6))
        parts = (
            ("tubes", disc(1.0, 1.0), self._shape.tubes, TUBES),
            ("caps", dome(), self._shape.caps, CAPS),
        )
        self._batches = []
        for part, mesh, instances, colour in parts:
            positions, rotations = self._shape.placed(instances, still)
            colours = np.tile(np.array(colour, dtype=np.uint8), (len(positions), 1))
            if part == "tubes":
                # What is screwed down, and the flange.
                colours[[0, -1]] = FOOT
            handle = api.add_batched_meshes_simple(
                f"{name}/{part}", mesh.vertices, mesh.triangles, rotations, positions,
                batched_scales=instances.scales, batched_colors=colours, lod="off",
                cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
            self._batches.append((handle, instances))

    def show(self, angles: Array) -> None:
        """Show it at joint angles (6,) [rad]."""
        self._frame.visible = True
        if self._angles is not None and np.array_equal(angles, self._angles):
            return
        self._angles = np.array(angles)
        frames = self._shape.frames(angles)
        for handle, parts in self._batches:
            positions, rotations = self._shape.placed(parts, frames)
            handle.batched_positions = positions.astype(np.float32)
            handle.batched_wxyzs = rotations.astype(np.float32)


def solid(
    api: viser.SceneApi, name: str, mesh: Mesh, colour: Colour, opacity: float | None = None,
    scale: float = 1.0, flat: bool = True,
) -> viser.MeshHandle:  # fmt: skip
    """Add a mesh of one colour."""
    return api.add_mesh_simple(
        name, mesh.vertices, mesh.triangles, color=colour, opacity=opacity, scale=scale,
        flat_shading=flat, cast_shadow=False, receive_shadow=False,
    )  # fmt: skip


class Stand:
    """A frame on the floor, hidden while it has no pose."""

    def __init__(self, api: viser.SceneApi, name: str) -> None:
        self._frame = api.add_frame(name, show_axes=False, visible=False)
        self._pose: Pose | None = None

    def put(self, pose: Pose | None) -> None:
        """Put it at a pose, or hide it."""
        if pose == self._pose:
            return
        self._pose = pose
        if pose is not None:
            self._frame.position = np.array([pose[0], pose[1], 0.0])
            self._frame.wxyz = rotation(pose[2])
        self._frame.visible = pose is not None
