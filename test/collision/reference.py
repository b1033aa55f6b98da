"""The robot as a physics engine reads it from its URDF, with distances of its own."""

from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np

from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.robots import robot_parameters

FAR = 100.0  #: Distance above which the engine need not find one [m]
BOX, CYLINDER = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
MESH = mujoco.mjtGeom.mjGEOM_MESH  #: Shapes of the engine


@dataclass(frozen=True)
class Shape:
    """A shape that is added to a body of the URDF."""

    body: str  #: Name of the body; "" for the world
    kind: int  #: Shape of the engine
    size: tuple  #: Its sizes, as the engine takes them; the corners of a convex mesh [m]
    position: tuple  #: Its centre in the frame of the body [m]
    yaw: float = 0.0  #: Its rotation about z of the body [rad]


def description(name="omniman"):
    """Return the description of a robot of the package."""
    return build(DescriptionParameters, robot_parameters(name))


class EngineBody:
    """Distances between the shapes of a URDF whose arm has capsules, and boxes beside them.

    Args:
        extra: Shapes that are added.

    Attributes:
        extra: Numbers of the shapes that were added.
    """

    def __init__(self, parameters, extra=()):
        spec = mujoco.MjSpec.from_string(parameters.urdf)
        spec.compiler.fusestatic = False
        spec.compiler.discardvisual = False
        for geom in spec.geoms:
            is_wheel = geom.parent.name.endswith("_wheel")
            if geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER and not is_wheel:
                geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
        for number, shape in enumerate(extra):
            body = spec.body(shape.body) if shape.body else spec.worldbody
            if shape.kind in (BOX, MESH):
                corners = np.array(shape.size)
                if shape.kind == BOX:
                    corners = np.array(list(product(*((-x, x) for x in shape.size))))
                spec.add_mesh(name=f"box {number}", uservert=corners.ravel())
                # The engine's own pair of capsule and box reports contacts, not the distance.
                kind = {"type": MESH, "meshname": f"box {number}"}
            else:
                kind = {"type": shape.kind, "size": [*shape.size, 0.0, 0.0][:3]}
            body.add_geom(
                name=f"extra {number}",
                **kind,
                pos=shape.position,
                quat=(np.cos(0.5 * shape.yaw), 0.0, 0.0, np.sin(0.5 * shape.yaw)),
            )
        self.model = spec.compile()
        self.model.opt.ccd_tolerance = 1e-12
        self.model.opt.ccd_iterations = 200
        self.data = mujoco.MjData(self.model)
        self.extra = [self.model.geom(f"extra {number}").id for number in range(len(extra))]

    def place(self, pose, q):
        """Put base_link at a pose (x, y, yaw), and the arm at joint angles (6,)."""
        x, y, yaw = pose
        base = self.model.body("base_link")
        base.pos[:2] = x, y
        base.quat[:] = np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)
        self.data.qpos[-len(q) :] = q
        mujoco.mj_kinematics(self.model, self.data)

    def shapes(self, body):
        """Return the numbers of the shapes of a body."""
        first, count = self.model.body(body).geomadr[0], self.model.body(body).geomnum[0]
        return range(first, first + count)

    def distance(self, first, second):
        """Return the least distance between two groups of shapes, by their numbers [m]."""
        return min(
            mujoco.mj_geomDistance(self.model, self.data, a, b, FAR, None)
            for a in first
            for b in second
        )
