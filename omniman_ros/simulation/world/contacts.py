"""Contacts of the robot with what is around it."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.simulation.world.engine import Engine
from omniman_ros.simulation.world.model.floor import FLOOR
from omniman_ros.simulation.world.model.platform import BASE

MEMORY = 5.0  #: Time for which an ended contact is reported, in filter time constants


@dataclass(frozen=True)
class RobotContact(Validated):
    """A contact of a part of the robot with something else; not of a wheel with the floor."""

    part: str  #: Link of the robot
    element: str  #: Element of the scene, or the floor
    #: Where they touch, or last touched, in the world [m], (3,)
    position: Annotated[Array, Shape(3)]
    #: Force on the robot in the world, low-pass filtered [N], (3,)
    force: Annotated[Array, Shape(3)]
    #: Integral of the force, unfiltered, since the contact began [N s], (3,)
    impulse: Annotated[Array, Shape(3)]
    touches: bool  #: Whether they touch now
    part_speed: float  #: Speed of the part's point when it first touched [m/s]
    element_speed: float  #: Speed of the other's point [m/s]


@dataclass
class _Contact:
    position: Array
    part_speed: float
    element_speed: float
    force: Array = field(default_factory=lambda: np.zeros(3))
    now: Array = field(default_factory=lambda: np.zeros(3))
    impulse: Array = field(default_factory=lambda: np.zeros(3))
    age: float = 0.0


class RobotContacts:
    """Contacts of the robot, from step to step."""

    def __init__(self, engine: Engine, time_constant: float) -> None:
        self._engine, self._time_constant = engine, time_constant
        self._parties = engine.parties()
        self._is_robot = engine.shapes_below(BASE)
        self._contacts: dict[tuple[str, str], _Contact] = {}

    def deepest(self) -> tuple[float, str]:
        """Return how deep the robot is in something [m], and in what; 0 if it touches nothing."""
        depth, name = 0.0, ""
        shapes, _ = self._engine.contacts()
        for (first, second), distance in zip(shapes, self._engine.distances, strict=True):
            parties = {self._parties[first], self._parties[second]}
            is_other = self._is_robot[first] != self._is_robot[second]
            if is_other and FLOOR not in parties and -distance > depth:
                depth = -float(distance)
                name = self._parties[second if self._is_robot[first] else first]
        return depth, name

    def update(self, indices: Iterable[int]) -> None:
        """Take the contacts of a step that are no tyre's, by their indices in the engine."""
        for contact in self._contacts.values():
            contact.now = np.zeros(3)
            contact.age += self._engine.step_time
        for k in indices:
            self._add(int(k))
        if self._contacts:
            self._filter()

    def _add(self, k: int) -> None:
        shapes, rows = self._engine.contacts()
        first, second = shapes[k]
        row = rows[k]
        if self._is_robot[first] == self._is_robot[second] or row < 0:
            return
        position, axes = self._engine.contact_frame(k)
        on_second = axes.T @ self._engine.forces[row : row + 3]
        own, other, force = first, second, -on_second
        if self._is_robot[second]:
            own, other, force = second, first, on_second
        key = self._parties[own], self._parties[other]
        contact = self._contacts.get(key)
        if contact is None:
            speeds = [np.linalg.norm(self._engine.velocity(k, position)) for k in (own, other)]
            contact = _Contact(position.copy(), float(speeds[0]), float(speeds[1]))
            self._contacts[key] = contact
        contact.position, contact.now, contact.age = position.copy(), contact.now + force, 0.0

    def _filter(self) -> None:
        step = self._engine.step_time
        gain = step / (self._time_constant + step)
        for key, contact in list(self._contacts.items()):
            contact.force = contact.force + gain * (contact.now - contact.force)
            contact.impulse = contact.impulse + step * contact.now
            if contact.age > MEMORY * self._time_constant:
                del self._contacts[key]

    def __call__(self) -> tuple[RobotContact, ...]:
        """Return the contacts of the latest step and those that ended shortly before."""
        return tuple(
            RobotContact(
                part,
                element,
                contact.position,
                contact.force,
                contact.impulse,
                contact.age == 0.0,
                contact.part_speed,
                contact.element_speed,
            )
            for (part, element), contact in self._contacts.items()
        )
