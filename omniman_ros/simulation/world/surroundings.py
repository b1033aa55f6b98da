"""What persons who give way keep clear of."""

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.simulation.world.avoidance import (
    DIRECTION_COUNT,
    DIRECTIONS,
    AvoidedNeighbours,
    outline,
)
from omniman_ros.simulation.world.engine import Engine
from omniman_ros.simulation.world.model.platform import BASE
from omniman_ros.simulation.world.scene import REACTIVE, Scene
from omniman_ros.simulation.world.solids import fixed_solids, footprint

HORIZON = 2.5  #: How far ahead persons mind what moves, and the robot [s]
FIXED_HORIZON = 0.8  #: How far ahead persons mind what is fixed [s]; longer: they would creep
SIGHT = 4.0  #: Distance up to which fixed things are minded [m]


class Neighbourhood:
    """Finds what is around each person: fixed things, the robot with its arm, and what moves."""

    def __init__(self, engine: Engine, scene: Scene) -> None:
        self._engine, persons = engine, scene.persons
        solids = [solid for _, parts in fixed_solids(scene) for solid in parts]
        empty = np.zeros((0, DIRECTION_COUNT))
        self._fixed = np.array([*empty, *(outline(*footprint(solid)) for solid in solids)])
        self._fixed = self._fixed.reshape(len(solids), DIRECTION_COUNT)
        self._centres = np.array([solid.centre[:2] for solid in solids]).reshape(-1, 2)
        inner = self._fixed - self._centres @ DIRECTIONS.T
        self._sizes = inner.max(axis=1) if solids else np.zeros(0)
        self._bottoms = np.array([solid.centre[2] - 0.5 * solid.height for solid in solids])

        names = [BASE, *(each.name for each in (*scene.crates, *scene.loads))]
        self._shapes = [np.nonzero(engine.shapes_below(name))[0] for name in names]
        self._dofs = np.array([[engine.dof(name), engine.dof(name) + 1] for name in names])
        self._persons = persons
        # Of the persons, then of the other things that move.
        things = np.zeros(len(names))
        gives_way = [person.behaviour == REACTIVE for person in persons]
        self._shares = np.concatenate([np.where(gives_way, 0.5, 1.0), things + 1.0])
        clearances = [
            person.clearance if reacts else 0.0
            for person, reacts in zip(persons, gives_way, strict=True)
        ]
        self._clearances = np.concatenate([clearances, things])
        self._moving = empty
        self._positions = self._velocities = self._wishes = np.zeros((0, 2))

    def update(self, positions: Array, velocities: Array, wishes: Array) -> None:
        """Take positions [m], velocities and wishes [m/s] of the persons in the world, (n, 2)."""
        engine = self._engine
        persons = [
            outline(place[None, :], person.radius)
            for place, person in zip(positions, self._persons, strict=True)
        ]
        things = [outline(engine.corners(shapes)[:, :2]) for shapes in self._shapes]
        self._moving = np.array([*persons, *things])
        speeds = engine.velocities[self._dofs]
        self._velocities = np.concatenate([velocities, speeds])
        self._wishes = np.concatenate([wishes, speeds])
        self._positions = positions

    def around(self, k: int) -> AvoidedNeighbours:
        """Return what person `k` keeps clear of, as of the latest :meth:`update`."""
        person = self._persons[k]
        distances = np.linalg.norm(self._centres - self._positions[k], axis=1) - self._sizes
        is_near = (distances < SIGHT) & (self._bottoms < person.height)
        others = np.arange(len(self._moving)) != k
        fixed = int(is_near.sum())
        moving = len(self._moving) - 1
        rest = np.zeros((fixed, 2))
        return AvoidedNeighbours(
            outlines=np.concatenate([self._fixed[is_near], self._moving[others]]),
            velocities=np.concatenate([rest, self._velocities[others]]),
            wishes=np.concatenate([rest, self._wishes[others]]),
            reaches=person.radius
            + np.concatenate(
                [
                    np.full(fixed, person.clearance),
                    np.maximum(person.clearance, self._clearances[others]),
                ]
            ),
            horizons=np.repeat([FIXED_HORIZON, HORIZON], [fixed, moving]),
            fractions=np.concatenate([np.ones(fixed), self._shares[others]]),
            fixed=fixed,
        )
