"""What the floor does to the wheels: loads, the drag of rolling rollers, slippery patches."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.core.robot import Robot
from omniman_ros.simulation.plant.parameters import PlantParameters
from omniman_ros.simulation.world.engine import Engine
from omniman_ros.simulation.world.model.wheels import body_name


class TyreContacts:
    """Contacts of all tyres with the floor.

    A roller's drag is as in the plant: in proportion to its load, against its rolling, and smooth
    about zero. It acts as damping of the roller's hinge, which the engine takes implicitly.

    Args:
        engine: The engine.
        names: Names of the wheels.

    Attributes:
        loads: Load of each wheel in the latest step [N], (n,).
        drag_loss: Energy lost by the drag of the rollers since the start [J].
        slip_loss: Energy lost by slip on the floor since the start [J].
    """

    def __init__(self, engine: Engine, names: Sequence[str]) -> None:
        self._engine = engine
        self.loads: Array = np.zeros(len(names))
        self.drag_loss = self.slip_loss = 0.0
        parties = engine.parties()
        wheels = {body_name(name): k for k, name in enumerate(names)}
        self._shapes, self._hinges, self._radii = engine.tyres()
        self._wheels = np.array([wheels[parties[shape]] for shape in self._shapes])
        # Tyre of each shape, -1 for other shapes.
        self._tyre_of = np.full(len(parties), -1)
        self._tyre_of[self._shapes] = np.arange(len(self._shapes))

    def configure(self, robot: Robot, plant: PlantParameters) -> None:
        """Set friction and drag of the wheels, and the slippery patch."""
        self._drag = np.asarray(robot.friction.roller)[self._wheels] * self._radii**2
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

    def update(self) -> NDArray[np.intp]:
        """Take loads and losses of the step, and set the drag for the next.

        Returns:
            Indices of the contacts that are not those of tyres.
        """
        engine, step = self._engine, self._engine.step_time
        shapes, rows = engine.contacts()
        parties = self._tyre_of[shapes]
        tyres = np.maximum(parties[:, 0], parties[:, 1])
        others = np.nonzero(tyres < 0)[0]
        loaded = np.nonzero(np.minimum(tyres, rows) >= 0)[0]
        if len(loaded) < len(tyres):
            tyres, rows = tyres[loaded], rows[loaded]
        forces, slips = engine.forces, engine.slips
        normal = forces[rows]
        loads = np.bincount(self._wheels[tyres], normal, len(self.loads))
        self.loads = loads.astype(np.float64, copy=False)
        along = rows + 1
        across = rows + 2
        work = forces[along] @ slips[along] + forces[across] @ slips[across]
        self.slip_loss -= step * float(work)
        hinges = self._hinges[tyres]
        spin = engine.velocities[hinges]
        speed = spin * self._radii[tyres]
        damping = self._drag[tyres] * normal / np.sqrt(speed * speed + self._width**2)
        engine.damping[self._hinges] = 0.0
        engine.damping[hinges] = damping
        self.drag_loss += step * float((damping * spin) @ spin)
        return others
