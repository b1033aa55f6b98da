"""Persons who walk."""

import math

from omniman_ros.simulation.world.engine import Engine
from omniman_ros.simulation.world.model.things import person_joints
from omniman_ros.simulation.world.scene import Person

AGILITY = 12.0
"""Rate at which a person reaches the wanted velocity [1/s]."""
APPROACH = 3.0
"""Velocity per distance with which a person returns to the own way [1/s]."""
HURRY = 1.2
"""Highest velocity of a person who returns to the own way, over the walking speed."""
PATIENCE = 0.5
"""Distance behind the own pace from which on a person waits for the way to be free [m]."""


class Walker:
    """Walks a person along the way points, with a limited force.

    A goal goes along the way at the walking speed, and the person goes after it. Who is held up
    pushes on, and the goal waits; nobody gives way.

    Args:
        engine: The engine.
        person: The person.
        force: Largest force [N].
    """

    def __init__(self, engine: Engine, person: Person, force: float) -> None:
        self._engine, self._force = engine, force
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
        wx, wy = _limited(ux + APPROACH * (gx - x), uy + APPROACH * (gy - y), HURRY * self._speed)
        gain = AGILITY * self._mass
        fx, fy = _limited(gain * (wx - vx), gain * (wy - vy), self._force)
        i, j = self._dofs
        self._engine.applied[i] = fx
        self._engine.applied[j] = fy

    def _pace(self, x: float, y: float) -> tuple[float, float]:
        """Move the goal on, and return its velocity [m/s]."""
        gx, gy = self._goal
        if math.hypot(gx - x, gy - y) > PATIENCE:
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


def _limited(x: float, y: float, largest: float) -> tuple[float, float]:
    """Return a vector, shortened if it is longer than `largest`."""
    size = math.hypot(x, y)
    scale = largest / size if size > largest else 1.0
    return scale * x, scale * y
