"""The robot: platform, wheels, arm, and a ghost at the true pose of a simulated robot."""

from collections.abc import Sequence

import numpy as np
import viser

from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Platform
from omniman_ros.motion.whole_body.model import Mount
from omniman_ros.viewer import meshes, style
from omniman_ros.viewer.arm_shapes import ArmShape
from omniman_ros.viewer.floor_shapes import disc, dome
from omniman_ros.viewer.meshes import Mesh, rotation, wheel_rotations
from omniman_ros.viewer.style import Colour
from omniman_ros.viewer.view_state import Pose, ViewState

COLUMN_RADIUS = 0.09  #: Radius of the column below an arm that is mounted above the deck [m]


class RobotScene:
    """The robot and its ghost."""

    def __init__(
        self, api: viser.SceneApi, root: str, robot: Platform, mount: Mount | None
    ) -> None:
        shape = meshes.body(robot)
        name = f"{root}/robot"
        self._robot = FloorFrame(api, name)
        for part, mesh, colour in (
            ("chassis", shape.chassis, style.CHASSIS),
            ("deck", shape.deck, style.DECK),
            ("arrow", shape.arrow, style.ACCENT),
        ):
            add_mesh(api, f"{name}/{part}", mesh, colour)
        self._ghost = FloorFrame(api, f"{root}/ghost")
        # The ghost is a little smaller, so that the robot hides it where the two coincide.
        for part, mesh in (("chassis", shape.chassis), ("deck", shape.deck)):
            add_mesh(api, f"{root}/ghost/{part}", mesh, style.GHOST, 0.5, scale=0.985)
        kinds: dict[tuple[float, float], list[int]] = {}
        for i, kind in enumerate(zip(robot.wheels.radius, robot.wheels.roller_angle, strict=True)):
            kinds.setdefault(kind, []).append(i)
        self._wheels = [
            _Wheels(api, f"{name}/wheels_{k}", robot, members)
            for k, members in enumerate(kinds.values())
        ]
        self._arm = None if mount is None else _Arm(api, f"{name}/arm", mount, shape.height)

    def draw(self, state: ViewState) -> None:
        """Draw the robot and its ghost."""
        self._robot.place(state.odom)
        self._ghost.place(state.truth)
        for wheels in self._wheels:
            wheels.show(state.wheel_angles)
        if self._arm is not None and state.arm is not None:
            self._arm.show(state.arm)


class _Wheels:
    """All wheels of one shape; each part is one batch, at a tenth of the cost of single meshes."""

    def __init__(
        self, api: viser.SceneApi, name: str, robot: Platform, members: Sequence[int]
    ) -> None:
        wheels = robot.wheels
        self._members = list(members)
        self._angles: Array | None = None
        self._headings = np.array(wheels.heading)[self._members]
        radius = wheels.radius[members[0]]
        shape = meshes.wheel(radius, wheels.roller_angle[members[0]])
        positions = np.array([[wheels.x[i], wheels.y[i], radius] for i in members])
        zero_pose = wheel_rotations(self._headings, np.zeros(len(members)))
        self._batches = [
            api.add_batched_meshes_simple(
                f"{name}/{part}",
                mesh.vertices,
                mesh.triangles,
                zero_pose,
                positions,
                batched_colors=colour,
                flat_shading=flat,
                lod="off",
                cast_shadow=False,
                receive_shadow=False,
            )
            for part, mesh, colour, flat in (
                ("rollers", shape.rollers, style.RUBBER, False),
                ("plates", shape.plates, style.WHEEL_PLATES, True),
                ("mark", shape.mark, style.ACCENT, True),
            )
        ]

    def show(self, angles: Array) -> None:
        """Draw the wheels at the angles (n,) of all wheels of the robot [rad]."""
        if self._angles is not None and np.array_equal(angles, self._angles):
            return
        self._angles = np.array(angles)
        rotations = wheel_rotations(self._headings, angles[self._members])
        for batch in self._batches:
            batch.batched_wxyzs = rotations.astype(np.float32)


class _Arm:
    """The arm as two batches, tubes and caps; hidden until its first pose is known."""

    def __init__(self, api: viser.SceneApi, name: str, mount: Mount, deck: float) -> None:
        self._shape = ArmShape(mount)
        self._angles: Array | None = None
        self._frame = api.add_frame(name, show_axes=False, visible=False)
        if mount.z > deck:
            column = disc(COLUMN_RADIUS, mount.z - deck)
            middle = 0.5 * (mount.z + deck)
            add_mesh(
                api,
                f"{name}/stand",
                column.moved(mount.x, mount.y, middle),
                style.CHASSIS,
                flat=False,
            )
        zero_pose = self._shape.frames(np.zeros(6))
        parts = (
            ("tubes", disc(1.0, 1.0), self._shape.tubes, style.ARM_TUBES),
            ("caps", dome(), self._shape.caps, style.ARM_CAPS),
        )
        self._batches = []
        for part, mesh, instances, colour in parts:
            positions, rotations = self._shape.placed(instances, zero_pose)
            colours = np.tile(np.array(colour, dtype=np.uint8), (len(positions), 1))
            if part == "tubes":
                # The first tube is the foot, the last one the flange.
                colours[[0, -1]] = style.ARM_FOOT
            handle = api.add_batched_meshes_simple(
                f"{name}/{part}",
                mesh.vertices,
                mesh.triangles,
                rotations,
                positions,
                batched_scales=instances.scales,
                batched_colors=colours,
                lod="off",
                cast_shadow=False,
                receive_shadow=False,
            )
            self._batches.append((handle, instances))

    def show(self, angles: Array) -> None:
        """Draw the arm at joint angles (6,) [rad]."""
        self._frame.visible = True
        if self._angles is not None and np.array_equal(angles, self._angles):
            return
        self._angles = np.array(angles)
        frames = self._shape.frames(angles)
        for handle, parts in self._batches:
            positions, rotations = self._shape.placed(parts, frames)
            handle.batched_positions = positions.astype(np.float32)
            handle.batched_wxyzs = rotations.astype(np.float32)


def add_mesh(
    api: viser.SceneApi,
    name: str,
    mesh: Mesh,
    colour: Colour,
    opacity: float | None = None,
    scale: float = 1.0,
    flat: bool = True,
) -> viser.MeshHandle:
    """Add a mesh of one colour, without shadows."""
    return api.add_mesh_simple(
        name,
        mesh.vertices,
        mesh.triangles,
        color=colour,
        opacity=opacity,
        scale=scale,
        flat_shading=flat,
        cast_shadow=False,
        receive_shadow=False,
    )


class FloorFrame:
    """A frame on the floor, hidden while it has no pose."""

    def __init__(self, api: viser.SceneApi, name: str) -> None:
        self._frame = api.add_frame(name, show_axes=False, visible=False)
        self._pose: Pose | None = None

    def place(self, pose: Pose | None) -> None:
        """Place the frame at a pose, or hide it if the pose is None."""
        if pose == self._pose:
            return
        self._pose = pose
        if pose is not None:
            self._frame.position = np.array([pose[0], pose[1], 0.0])
            self._frame.wxyz = rotation(pose[2])
        self._frame.visible = pose is not None
