"""The platform's motion in the world, and putting it elsewhere."""

import math
from collections.abc import Sequence

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import OmnimanError
from omniman_ros.simulation.plant.imu import BaseMotion
from omniman_ros.simulation.world.engine import Engine
from omniman_ros.simulation.world.model.platform import BASE


class Base:
    """Pose and twist of base_link.

    Args:
        deck: Height of the platform's upper side, above which loads lie on it [m].
    """

    def __init__(self, engine: Engine, loads: Sequence[str], deck: float) -> None:
        self._engine, self._deck = engine, deck
        self._body = engine.body(BASE)
        self._at, self._dof = engine.coordinate(BASE), engine.dof(BASE)
        self._loads = [(engine.coordinate(name), engine.dof(name)) for name in loads]
        self._heading = 0.0

    @property
    def frame(self) -> tuple[Array, Array]:
        """Position (3,) [m] and rotation (3, 3) of base_link in the world."""
        return self._engine.pose(self._body)

    @property
    def pose(self) -> Array:
        """Pose (x, y, heading) in the world [m, m, rad], (3,); the heading is not wrapped."""
        position, _ = self.frame
        return np.array([position[0], position[1], self._heading])

    @property
    def motion(self) -> BaseMotion:
        """Motion in all six directions."""
        _, rotation = self.frame
        velocities, dof = self._engine.velocities, self._dof
        # The engine has a free body's velocity in the world's axes, its rate in the body's.
        velocity, rate = velocities[dof : dof + 3] @ rotation, velocities[dof + 3 : dof + 6].copy()
        return BaseMotion(rotation.copy(), velocity, rate)

    @property
    def twist(self) -> Array:
        """Twist (vx, vy, w) in base_link [m/s, m/s, rad/s], (3,)."""
        _, rotation = self.frame
        velocities, dof = self._engine.velocities, self._dof
        vx, vy, _ = velocities[dof : dof + 3] @ rotation
        return np.array([vx, vy, velocities[dof + 5]])

    def follow(self) -> None:
        """Follow the heading after a step; one that is not finite raises an OmnimanError."""
        heading = self._engine.heading(self._body)
        if not math.isfinite(heading):
            raise OmnimanError("the physics world has diverged: its state is not finite")
        self._heading += math.remainder(heading - self._heading, math.tau)

    def put(self, pose: Sequence[float] | Array) -> None:
        """Put the robot upright at a pose (3,) [m, m, rad]; its planar motion continues.

        What lies on the robot is moved with it.
        """
        x, y, heading = (float(value) for value in pose)
        place, velocity = self._engine.coordinates, self._engine.velocities
        old, at, dof = self.pose, self._at, self._dof
        turn = heading - old[2]
        for start, first in self._loads:
            if place[start + 2] > self._deck:
                offset = _rotated(turn, place[start : start + 2] - old[:2])
                place[start : start + 2] = offset + (x, y)
                place[start + 3 : start + 7] = _turned(turn, place[start + 3 : start + 7])
                velocity[first : first + 2] = _rotated(turn, velocity[first : first + 2])
        place[at : at + 7] = x, y, 0.0, math.cos(0.5 * heading), 0.0, 0.0, math.sin(0.5 * heading)
        velocity[dof : dof + 2] = _rotated(turn, velocity[dof : dof + 2])
        velocity[dof + 2 : dof + 5] = 0.0
        self._heading = heading
        self._engine.refresh()


def _rotated(angle: float, vector: Array) -> Array:
    """Return a vector (2,) rotated to the left by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    x, y = vector
    return np.array([c * x - s * y, s * x + c * y])


def _turned(angle: float, quaternion: Array) -> Array:
    """Return a rotation (w, x, y, z), (4,), followed by one about the vertical [rad]."""
    c, s = math.cos(0.5 * angle), math.sin(0.5 * angle)
    w, x, y, z = quaternion
    return np.array([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])
