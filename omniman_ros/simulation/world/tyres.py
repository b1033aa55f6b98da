"""What the floor does to the wheels: loads, the drag of rolling rollers, slippery patches."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Platform
from omniman_ros.simulation.plant.parameters import PlantParameters
from omniman_ros.simulation.world.engine import Engine
from omniman_ros.simulation.world.model.wheels import body_name


@dataclass(frozen=True, slots=True)
class _Tyre:
    hinge: int  #: Index of the velocity of the hinge on which it rolls freely
    wheel: int  #: Number of its wheel
    radius: float  #: Its radius [m]


class TyreContacts:
    """Contacts of all tyres with the floor.

    A roller's drag is as in the plant: in proportion to its load, against its rolling, and smooth
    about zero. It acts as damping of the roller's hinge, which the engine takes implicitly.
    """

    def __init__(self, engine: Engine, names: Sequence[str]) -> None:
        self._engine = engine
        self._loads = [0.0 for _ in names]
        #: Energy lost since the start, by the drag of the rollers and by slip on the floor [J]
        self.drag_loss = self.slip_loss = 0.0
        parties = engine.parties()
        wheels = {body_name(name): k for k, name in enumerate(names)}
        self._shapes, hinges, radii = engine.tyres()
        self._wheels = [wheels[parties[shape]] for shape in self._shapes]
        # By shape; None for those that are not tyres.
        self._tyres: list[_Tyre | None] = [None] * len(parties)
        for shape, hinge, wheel, radius in zip(
            self._shapes.tolist(), hinges.tolist(), self._wheels, radii.tolist(), strict=True
        ):
            self._tyres[shape] = _Tyre(hinge, wheel, radius)
        self._rolling: list[int] = []

    @property
    def loads(self) -> Array:
        """Load of each wheel in the latest step [N], (n,)."""
        return np.array(self._loads)

    def configure(self, robot: Platform, plant: PlantParameters) -> None:
        """Set friction and drag of the wheels, and the slippery patch."""
        self._drag = tuple(robot.friction.roller)
        self._width = plant.roller_velocity
        self._friction = robot.friction.mu
        low = np.array([plant.patch_x_min, plant.patch_y_min])
        high = np.array([plant.patch_x_max, plant.patch_y_max])
        self._patch = (low, high, plant.patch_mu) if (high > low).all() else None
        self._engine.shape_friction[self._shapes, 0] = self._friction

    def update_grip(self) -> None:
        """Set the grip of each tyre by the floor below it."""
        if self._patch is None:
            return
        low, high, patch_friction = self._patch
        below = self._engine.shape_positions[self._shapes, :2]
        slippery = ((below >= low) & (below <= high)).all(axis=1)
        grip = np.where(slippery, patch_friction, self._friction)
        self._engine.shape_friction[self._shapes, 0] = grip

    def update(self) -> list[int]:
        """Take loads and losses of the step; return the contacts that are no tyres'."""
        engine, step, tyres = self._engine, self._engine.step_time, self._tyres
        damping, velocities = engine.damping, engine.velocities
        forces, slips = engine.forces.tolist(), engine.slips.tolist()
        loads, others = [0.0] * len(self._loads), []
        work, drag, square = 0.0, self._drag, self._width * self._width
        # A few contacts: numbers are faster than arrays.
        for hinge in self._rolling:
            damping[hinge] = 0.0
        rolling = self._rolling = []
        shapes, rows = engine.contacts()
        for k, ((first, second), row) in enumerate(
            zip(shapes.tolist(), rows.tolist(), strict=True)
        ):
            tyre = tyres[first] or tyres[second]
            if tyre is None:
                others.append(k)
                continue
            if row < 0:
                continue
            hinge, radius, normal = tyre.hinge, tyre.radius, forces[row]
            loads[tyre.wheel] += normal
            work += forces[row + 1] * slips[row + 1] + forces[row + 2] * slips[row + 2]
            spin = velocities.item(hinge)
            lever = radius * spin
            drag_damping = (
                drag[tyre.wheel] * radius * radius * normal / math.sqrt(lever * lever + square)
            )
            damping[hinge] = drag_damping
            rolling.append(hinge)
            self.drag_loss += step * drag_damping * spin * spin
        self.slip_loss -= step * work
        self._loads = loads
        return others
