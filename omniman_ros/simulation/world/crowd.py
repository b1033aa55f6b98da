"""The persons of a world."""

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.simulation.world.avoidance import half_planes
from omniman_ros.simulation.world.engine import Engine
from omniman_ros.simulation.world.model.elements import person_joints
from omniman_ros.simulation.world.scene import REACTIVE, Scene
from omniman_ros.simulation.world.surroundings import Neighbourhood
from omniman_ros.simulation.world.velocity_program import nearest_velocity
from omniman_ros.simulation.world.walker import HURRY, ReactiveWalk, ScriptedWalk

AGILITY = 12.0  #: Rate at which a person reaches the wanted velocity [1/s]
PERIOD = 0.05  #: Time between two decisions of a person [s]
FORCE_PERIOD = 0.005  #: Time between changes of a person's force [s], short against 1 / AGILITY
TINY = 1e-12  #: Force below which its direction does not matter [N]


class Crowd:
    """Walks persons along their way points, with a limited force.

    A scripted person gives way to nobody. A reactive one keeps clear of what is around by
    :mod:`~omniman_ros.simulation.world.avoidance`, and waits where that permits no way.

    Args:
        force: Largest force of a person [N].
    """

    def __init__(self, engine: Engine, scene: Scene, force: float) -> None:
        self._engine, self._force = engine, force
        self._persons = scene.persons
        joints = [person_joints(person.name) for person in scene.persons]
        self._dofs = np.array([[engine.dof(j) for j in pair] for pair in joints], dtype=np.intp)
        self._coordinates = np.array(
            [[engine.coordinate(j) for j in pair] for pair in joints], dtype=np.intp
        )
        self._origins = np.array([[person.x[0], person.y[0]] for person in scene.persons])
        self._gains = AGILITY * np.array([[person.mass] for person in scene.persons])
        self._wanted = np.zeros((len(joints), 2))
        self._walks = [
            ReactiveWalk(person) if person.behaviour == REACTIVE else ScriptedWalk(person)
            for person in scene.persons
        ]
        self._reactive = [
            k for k, person in enumerate(scene.persons) if person.behaviour == REACTIVE
        ]
        self._neighbourhood = Neighbourhood(engine, scene)
        self._every = max(1, round(PERIOD / engine.step_time))
        self._force_every = max(1, round(FORCE_PERIOD / engine.step_time))
        self._count = 0

    @property
    def positions(self) -> Array:
        """Positions in the world [m], (n, 2), in the order of the scene."""
        positions: Array = self._origins + self._engine.coordinates[self._coordinates]
        return positions

    @property
    def velocities(self) -> Array:
        """Velocities in the world [m/s], (n, 2)."""
        velocities: Array = self._engine.velocities[self._dofs]
        return velocities

    def update(self) -> None:
        """Set the forces of the next step."""
        if not self._persons:
            return
        count = self._count
        self._count += 1
        if count % self._every == 0:
            self._decide()
        if count % self._force_every == 0:
            self._push()

    def _push(self) -> None:
        forces = self._gains * (self._wanted - self.velocities)
        squares = forces * forces
        sizes = np.sqrt(squares[:, :1] + squares[:, 1:])
        forces *= np.minimum(self._force / np.maximum(sizes, TINY), 1.0)
        self._engine.applied[self._dofs] = forces

    def _decide(self) -> None:
        period = self._every * self._engine.step_time
        positions = self.positions
        for k, (x, y) in enumerate(positions.tolist()):
            self._wanted[k] = self._walks[k].velocity(x, y, period)
        if not self._reactive:
            return
        velocities, wishes = self.velocities, self._wanted.copy()
        self._neighbourhood.update(positions, velocities, wishes)
        for k in self._reactive:
            around = self._neighbourhood.around(k)
            planes = half_planes(positions[k], velocities[k], wishes[k], around)
            wish = float(wishes[k, 0]), float(wishes[k, 1])
            limit = HURRY * self._persons[k].speed
            hard, soft = planes[: around.fixed], planes[around.fixed :]
            self._wanted[k] = nearest_velocity(wish, limit, hard, soft)
