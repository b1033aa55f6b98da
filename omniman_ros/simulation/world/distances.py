"""Distances between a robot in any posture and upright obstacles, by the physics engine."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.polygon import trapezoids
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.description.platform_shape import platform_top
from omniman_ros.simulation.world.solids import ellipse_corners, prism_corners

#: Corners of a square, (4, 2)
CORNERS: Array = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
ACCURACY = 1e-9  #: Accuracy of a distance [m]


@dataclass(frozen=True)
class Prism:
    """An upright obstacle with an elliptic outline."""

    semi_axes: tuple[float, float]  #: Semi-axes of the ellipse [m]
    angle: float  #: Direction of its first axis [rad]
    heights: tuple[float, float]  #: Heights of its lower and its upper side [m]


class ConfigurationDistances:
    """Distances between the shapes of a robot's URDF and prisms, each placed at will.

    The platform is the box of the body's length and width from the floor to the deck's top, too. A
    platform with an outline of its own is a prism with this outline instead.
    """

    def __init__(self, description: DescriptionParameters, prisms: Sequence[Prism]) -> None:
        spec = mujoco.MjSpec.from_string(description.urdf)
        spec.compiler.fusestatic, spec.compiler.discardvisual = False, False
        body, top = description.robot.body, platform_top(description.robot, description.mount.z)
        base, box = spec.body("base_link"), 0.5 * np.array([body.length, body.width])
        outlines = [box * CORNERS] if body.outline is None else trapezoids(body.outline)
        for k, outline in enumerate(outlines):
            _add_hull(spec, base, f"platform {k}", prism_corners(outline, (0.0, top)))
        for k, prism in enumerate(prisms):
            name = f"prism {k}"
            _add_hull(spec, spec.worldbody.add_body(name=name), name, _points(prism))
        self._model = model = spec.compile()
        model.opt.ccd_tolerance = ACCURACY
        self._data = mujoco.MjData(model)
        self._prisms = [int(model.body(f"prism {k}").geomadr[0]) for k in range(len(prisms))]
        self._robot = [k for k in range(model.ngeom) if k not in self._prisms]
        platform = [int(model.geom(f"platform {k}").id) for k in range(len(outlines))]
        if body.outline is not None:  # boxes of the URDF cover it from outside
            cover = set(np.flatnonzero(model.geom_bodyid == model.body("base_link").id))
            self._robot = [k for k in self._robot if k not in cover - set(platform)]

    def place(self, pose: Array, posture: Array, places: Array) -> None:
        """Place the robot at a pose (3,) and a posture (6,), and the prisms at (M, 2) [m, rad].

        Args:
            pose: (3,) pose of base_link [m, m, rad].
            posture: (6,) joint angles of the arm [rad].
            places: (M, 2) centres of the prisms [m].
        """
        base = self._model.body("base_link")
        base.pos[:2] = pose[:2]
        base.quat[:] = math.cos(0.5 * pose[2]), 0.0, 0.0, math.sin(0.5 * pose[2])
        for k, (x, y) in enumerate(places.tolist()):
            self._model.body(f"prism {k}").pos[:2] = x, y
        self._data.qpos[-len(posture) :] = posture
        mujoco.mj_kinematics(self._model, self._data)

    def distances(self, reach: float) -> Array:
        """Return the distance (M,) of each prism from the robot [m]; at most `reach` [m]."""
        rest = self._model, self._data
        result: Array = np.array(
            [
                min(mujoco.mj_geomDistance(*rest, one, prism, reach, None) for one in self._robot)
                for prism in self._prisms
            ]
        )
        return result


def _points(prism: Prism) -> Array:
    """Return the corners (k, 3) of a prism around the origin [m]."""
    outline = ellipse_corners(prism.semi_axes, prism.angle)
    return prism_corners(outline, prism.heights)


def _add_hull(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, points: Array) -> None:
    spec.add_mesh(name=name, uservert=points.ravel())
    body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)
