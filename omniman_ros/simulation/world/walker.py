"""Persons who walk."""

import math

from omniman_ros.simulation.world.engine import Engine
from omniman_ros.simulation.world.model.things import person_joints
from omniman_ros.simulation.world.scene import Person

PULL = 6.0
"""Angular frequency with which a person follows the own pace, critically damped [rad/s]."""
PATIENCE = 0.3
"""Distance behind the own pace from which on a person waits for the way to be free [m]."""


class Walker:
    """Walks a person along the way points, with a limited force.

    A goal goes along the way at the person's speed, and the person is pulled to it by a spring and
    a damper. Who is held up pushes with the largest force and does not go on; nobody gives way.

    Args:
        engine: The engine.
        person: The person.
        force: Largest force [N].

    Attributes:
        name: Name of the person.
        radius: Radius of the person [m].
        force: Largest force [N].
    """

    def __init__(self, engine: Engine, person: Person, force: float) -> None:
        self._engine = engine
        self.name, self.radius, self.force = person.name, person.radius, force
        self._mass, self._speed = person.mass, person.speed
        self._points = tuple(zip(person.x, person.y, strict=True))
        joints = person_joints(person.name)
        self._dofs = [engine.dof(name) for name in joints]
        self._coordinates = [engine.coordinate(name) for name in joints]
        self._goal = self._points[0]
        self._next = 1 % len(self._points)

    @property
    def position(self) -> tuple[float, float]:
        """Position in the world [m]."""
        (x0, y0), (i, j) = self._points[0], self._coordinates
        values = self._engine.coordinates
        return x0 + float(values[i]), y0 + float(values[j])

    @property
    def velocity(self) -> tuple[float, float]:
        """Velocity in the world [m/s]."""
        i, j = self._dofs
        return float(self._engine.velocities[i]), float(self._engine.velocities[j])

    def update(self) -> None:
        """Set the force of the next step."""
        (x, y), (vx, vy) = self.position, self.velocity
        ux, uy = self._pace(x, y)
        gx, gy = self._goal
        stiffness, damping = self._mass * PULL * PULL, 2.0 * self._mass * PULL
        fx = stiffness * (gx - x) + damping * (ux - vx)
        fy = stiffness * (gy - y) + damping * (uy - vy)
        size = math.hypot(fx, fy)
        scale = self.force / size if size > self.force else 1.0
        i, j = self._dofs
        self._engine.applied[i] = scale * fx
        self._engine.applied[j] = scale * fy

    def _pace(self, x: float, y: float) -> tuple[float, float]:
        """Move the goal on, and return its velocity [m/s]."""
        gx, gy = self._goal
        if len(self._points) == 1 or math.hypot(gx - x, gy - y) > PATIENCE:
            return 0.0, 0.0
        px, py = self._points[self._next]
        left = math.hypot(px - gx, py - gy)
        stride = self._speed * self._engine.step_time
        if left <= stride:
            self._goal = px, py
            self._next = (self._next + 1) % len(self._points)
            return 0.0, 0.0
        ux, uy = self._speed * (px - gx) / left, self._speed * (py - gy) / left
        self._goal = gx + ux * self._engine.step_time, gy + uy * self._engine.step_time
        return ux, uy
