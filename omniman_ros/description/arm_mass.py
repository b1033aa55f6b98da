"""Mass, centre of mass and inertia of the arm on the platform, by posture."""

import math
from dataclasses import replace

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Arm
from omniman_ros.description.inertia import Inertia
from omniman_ros.description.transforms import transform
from omniman_ros.description.ur5 import ARM_MASS, BASE, links, tool_inertia
from omniman_ros.motion.whole_body.model import Mount


class ArmMass:
    """Composes the arm's links and its tool to the body that the platform carries.

    The links have the masses of the description. The tool with its load has what the mass of the
    arm exceeds theirs by; an arm that is lighter than the links has them all lighter by one
    factor. Of the arm, only its mass and the centre of its tool count.
    """

    def __init__(self, arm: Arm, mount: Mount) -> None:
        self._arm = arm
        moving, fraction = links(), min(1.0, arm.mass / ARM_MASS)
        x, y, z = arm.tool_centre
        tool = tool_inertia(max(arm.mass - ARM_MASS, 0.0), (x, y, z))
        base = mount.pose @ transform(BASE.place, BASE.rpy)
        self._base = base
        self._places = [transform(link.place, link.rpy) for link in moving]
        # The tool is fixed to the last link: the same frame twice.
        bodies = [BASE.inertia, *(link.inertia for link in moving)]
        self._masses = np.array([fraction * body.mass for body in bodies] + [tool.mass])
        self._centres = np.array([[*body.centre, 1.0] for body in (*bodies, tool)])
        scale = [fraction] * len(bodies) + [1.0]
        self._tensors = np.array(
            [k * _tensor(body) for k, body in zip(scale, (*bodies, tool), strict=True)]
        )

    @property
    def mass(self) -> float:
        """Mass of arm and tool [kg]."""
        return float(self._masses.sum())

    def weighted_centres(self, q: Array) -> Array:
        """Return the mass [kg] times the homogeneous centre (4,) of each body, base to tool.

        They (8, 4) are in base_link, in a posture (6,) [rad].
        """
        weighted: Array = self._masses[:, None] * _times(self._poses(q), self._centres)
        return weighted

    def _poses(self, q: Array) -> Array:
        """Return the poses (8, 4, 4) of base, links and tool in base_link."""
        frame = self._base
        frames = [frame]
        for place, angle in zip(self._places, q.tolist(), strict=True):
            c, s = math.cos(angle), math.sin(angle)
            frame = frame @ place
            x, y = frame[:, 0].copy(), frame[:, 1].copy()
            frame[:, 0], frame[:, 1] = c * x + s * y, c * y - s * x
            frames.append(frame)
        return np.array([*frames, frame])

    def at(self, q: Array) -> Arm:
        """Return the arm as a body at rest in a posture (6,) [rad]."""
        poses, mass = self._poses(q), self.mass
        points = _times(poses, self._centres)[:, :3]
        centre = self._masses @ points / mass
        upright = poses[:, 2, :3]  # The vertical in each body's own axes.
        own = np.einsum("ki,kij,kj->", upright, self._tensors, upright)
        apart = self._masses @ ((points[:, :2] - centre[:2]) ** 2).sum(axis=1)
        x, y, z = centre.tolist()
        # A centre below the floor is that of a mount whose height is unknown.
        return replace(self._arm, com_x=x, com_y=y, com_z=max(0.0, z), inertia=float(own + apart))


def _times(poses: Array, points: Array) -> Array:
    """Return homogeneous points (k, 4) at poses (k, 4, 4)."""
    moved: Array = np.einsum("kij,kj->ki", poses, points)
    return moved


def _tensor(body: Inertia) -> Array:
    """Return the tensor of inertia about the centre of mass, in the link's axes (3, 3)."""
    axes = transform(body.centre, body.rpy)[:3, :3]
    tensor: Array = axes @ np.diag(body.moments) @ axes.T
    return tensor
