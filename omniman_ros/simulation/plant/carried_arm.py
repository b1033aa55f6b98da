"""The true arm on the platform: a rigid body that its posture forms, for the plant.

The links are joined from the tool inwards, each in the frame of the link that carries it, without
any code of the controller. The data of the links are the manufacturer's.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Arm
from omniman_ros.description.inertia import Inertia
from omniman_ros.description.ur5 import ARM_MASS, BASE, links, tool_inertia
from omniman_ros.motion.whole_body.model import Mount


@dataclass(frozen=True)
class _Body:
    """Mass [kg], centre of mass (3,) [m] and tensor (3, 3) about it [kg m^2], in some frame."""

    mass: float
    centre: Array
    tensor: Array

    def joined(self, other: "_Body") -> "_Body":
        """Return this body and another one in the same frame as one (parallel axis theorem)."""
        mass = self.mass + other.mass
        apart = other.centre - self.centre
        reduced = self.mass * other.mass / mass
        tensor = self.tensor + other.tensor
        tensor = tensor + reduced * (apart @ apart * np.eye(3) - np.outer(apart, apart))
        return _Body(mass, self.centre + other.mass / mass * apart, tensor)

    def carried(self, place: Sequence[float], turn: Array) -> "_Body":
        """Return the body in the frame in which its own has a place (3,) [m] and a turn (3, 3)."""
        return _Body(self.mass, np.array(place) + turn @ self.centre, turn @ self.tensor @ turn.T)


def carried_arm(arm: Arm, mount: Mount, posture: Sequence[float]) -> Arm:
    """Return the arm with centre of mass and inertia of a posture, with respect to base_link.

    What the arm's mass is beyond the links' is the tool's. A lighter arm has lighter links.

    Args:
        posture: Joint angles (6,) [rad].
    """
    weight = min(1.0, arm.mass / ARM_MASS)
    x, y, z = arm.tool_centre
    body = _body_of(tool_inertia(max(arm.mass - ARM_MASS, 0.0), (x, y, z)), 1.0)
    for link, angle in zip(reversed(links()), reversed(posture), strict=True):
        body = _body_of(link.inertia, weight).joined(body)
        body = body.carried(link.place, _fixed_axes(link.rpy) @ _about(2, angle))
    body = _body_of(BASE.inertia, weight).joined(body).carried(BASE.place, _fixed_axes(BASE.rpy))
    body = body.carried((mount.x, mount.y, mount.z), _about(2, mount.yaw))
    x, y, z = body.centre.tolist()
    inertia = float(body.tensor[2, 2])
    return replace(arm, com_x=x, com_y=y, com_z=max(0.0, z), inertia=inertia)


def _body_of(inertia: Inertia, weight: float) -> _Body:
    axes = _fixed_axes(inertia.rpy)
    tensor = axes @ np.diag(inertia.moments) @ axes.T
    return _Body(weight * inertia.mass, np.array(inertia.centre), weight * tensor)


def _fixed_axes(rpy: Sequence[float]) -> Array:
    """Return the rotation (3, 3) about the fixed axes x, then y, then z [rad]."""
    roll, pitch, yaw = rpy
    result: Array = _about(2, yaw) @ _about(1, pitch) @ _about(0, roll)
    return result


def _about(axis: int, angle: float) -> Array:
    """Return the rotation (3, 3) about a coordinate axis by an angle [rad]."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    c, s = math.cos(angle), math.sin(angle)
    result = np.eye(3)
    result[i, i], result[i, j], result[j, i], result[j, j] = c, -s, s, c
    return result
