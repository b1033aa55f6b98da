"""Spheres that contain arm, tool and load, with the derivatives of their places."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.collision.arm_segments import ArmSegments
from omniman_ros.collision.convex_search import Indices
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.motion.whole_body.model import Mount

LOAD = "load"  #: Name of the load among the links


@dataclass(frozen=True)
class PlacedSpheres(Validated):
    """Spheres at some configurations of the arm, in base_link."""

    centre: Annotated[Array, Shape(..., "S", 3)]  #: Centres (..., S, 3) [m]
    #: Poses (..., 7, 4, 4) of the arm's base and links
    frames: Annotated[Array, Shape(..., 7, 4, 4)]


class BodySpheres:
    """Spheres that contain the cylinders of arm and tool, and the box of the load.

    A cylinder is cut into equal pieces of a largest length; a sphere around the middle of a piece
    contains it. The spheres are larger than the cylinders by at most the square root of r^2 + d^2
    / 4, less r, where d is the length of a piece.

    Attributes:
        radius: Radii (S,) [m].
        part: Number (S,) of the part in `names` that each sphere belongs to.
        names: Names of the links, from the arm's base on, then of the load.
        frame: Number (S,) of the arm's frame that carries each sphere, 0 for the base.
    """

    def __init__(
        self, mount: Mount, tool: ToolShape, load: LoadShape | None, spacing: float
    ) -> None:
        self._arm = arm = ArmSegments(mount, tool)
        zero = arm.frames(np.zeros(JOINTS))
        axes = arm.capsules(zero)
        lengths = np.linalg.norm(axes.end - axes.start, axis=0)
        counts = np.maximum(np.ceil(lengths / spacing), 1.0).astype(np.intp)
        owner = np.repeat(np.arange(len(counts)), counts)
        index = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
        fraction = (index + 0.5) / counts[owner]
        middle = axes.start[:, owner] + fraction * (axes.end - axes.start)[:, owner]
        radius = np.hypot(arm.radius[owner], 0.5 * lengths[owner] / counts[owner])
        part = arm.link[owner]
        self.names: tuple[str, ...] = arm.names
        if load is not None and load.is_carried:
            points, reach = _load_spheres(load, spacing)
            flange = zero[-1]
            middle = np.hstack((middle, flange[:3, :3] @ points + flange[:3, 3:]))
            radius = np.append(radius, np.full(points.shape[1], reach))
            part = np.append(part, np.full(points.shape[1], len(self.names)))
            self.names += (LOAD,)
        self.radius: Array = radius
        self.part: Indices = part
        self.frame: Indices = np.minimum(part, JOINTS)
        carriers = zero[self.frame]
        offset = middle.T - carriers[:, :3, 3]
        self._local: Array = np.einsum("sij,si->sj", carriers[:, :3, :3], offset)

    def place(self, q: Array) -> PlacedSpheres:
        """Return the spheres at joint angles (..., 6) [rad]."""
        return self.carried(self._arm.frames(q))

    def carried(self, frames: Array) -> PlacedSpheres:
        """Return the spheres for poses (..., 7, 4, 4) of the arm's base and links in base_link."""
        chosen = frames[..., self.frame, :3, :]
        centre = np.einsum("...sij,sj->...si", chosen[..., :3], self._local) + chosen[..., 3]
        return PlacedSpheres.unchecked(centre=centre, frames=frames)

    def joint_derivative(self, placed: PlacedSpheres) -> Array:
        """Return the derivatives (..., S, 3, 6) of the centres by the joint angles [m/rad]."""
        axis = placed.frames[..., :-1, :3, 2]
        origin = placed.frames[..., :-1, :3, 3]
        lever_arm = placed.centre[..., :, None, :] - origin[..., None, :, :]
        axis = axis[..., None, :, :] * (np.arange(JOINTS) < self.frame[:, None])[..., None]
        result = np.empty((*lever_arm.shape[:-2], 3, JOINTS))
        for row, first, second in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # axes x levers
            result[..., row, :] = (
                axis[..., first] * lever_arm[..., second]
                - axis[..., second] * lever_arm[..., first]
            )
        return result


def _load_spheres(load: LoadShape, spacing: float) -> tuple[Array, float]:
    """Return centres (3, n) in the frame of the flange and the radius of its spheres [m]."""
    size = np.array((load.length, load.width, load.height))
    counts = np.maximum(np.ceil(size / spacing), 1.0).astype(np.intp)
    cell = size / counts
    low = np.array((-0.5 * load.length, -0.5 * load.width, load.distance))
    lines = [a + c * (np.arange(n) + 0.5) for a, c, n in zip(low, cell, counts, strict=True)]
    points = np.stack(np.meshgrid(*lines, indexing="ij")).reshape(3, -1)
    return points, 0.5 * float(np.linalg.norm(cell))
