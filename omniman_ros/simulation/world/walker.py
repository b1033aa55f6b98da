"""How persons want to walk."""

import math

from omniman_ros.simulation.world.scene import Person
from omniman_ros.simulation.world.velocity_program import Velocity

APPROACH = 3.0  #: Velocity per distance with which a scripted person returns to the path [1/s]
HURRY = 1.2  #: Ratio of the highest velocity of a person to the walking speed [-]
WAITING_DISTANCE = 0.5  #: Distance above which the script waits for the person [m]
RETURN = 1.0  #: Velocity per distance to a single way point [1/s]; a larger one oscillates
ARRIVAL = 0.25  #: Distance from which on a reactive person has reached a way point [m]


class ScriptedWalk:
    """The walk of a person who minds nobody.

    A goal goes along the way points at the walking speed, and the person goes after it. Who is
    held up pushes on, and the goal waits.
    """

    def __init__(self, person: Person) -> None:
        self._speed = person.speed
        self._points = tuple(zip(person.x, person.y, strict=True))
        self._goal = self._points[0]
        self._next = 1 % len(self._points)

    def velocity(self, x: float, y: float, period: float) -> Velocity:
        """Return the velocity [m/s] wanted at a position [m]; the goal moves on by a period."""
        ux, uy = self._pace(x, y, period)
        gx, gy = self._goal
        wish = ux + APPROACH * (gx - x), uy + APPROACH * (gy - y)
        return _limited(wish, HURRY * self._speed)

    def _pace(self, x: float, y: float, period: float) -> Velocity:
        gx, gy = self._goal
        if math.hypot(gx - x, gy - y) > WAITING_DISTANCE:
            return 0.0, 0.0
        px, py = self._points[self._next]
        left = math.hypot(px - gx, py - gy)
        if left <= self._speed * period:
            self._goal = px, py
            self._next = (self._next + 1) % len(self._points)
            return 0.0, 0.0
        ux, uy = self._speed * (px - gx) / left, self._speed * (py - gy) / left
        self._goal = gx + ux * period, gy + uy * period
        return ux, uy


class ReactiveWalk:
    """The walk that a person who gives way would take if nothing were in the way.

    The person goes straight to the next way point, from wherever giving way has led.
    """

    def __init__(self, person: Person) -> None:
        self._speed = person.speed
        self._points = tuple(zip(person.x, person.y, strict=True))
        self._next = 1 % len(self._points)

    def velocity(self, x: float, y: float, period: float) -> Velocity:
        """Return the wanted velocity; as :meth:`ScriptedWalk.velocity`."""
        px, py = self._points[self._next]
        if len(self._points) == 1:
            return _limited((RETURN * (px - x), RETURN * (py - y)), self._speed)
        if math.hypot(px - x, py - y) < ARRIVAL:
            self._next = (self._next + 1) % len(self._points)
            px, py = self._points[self._next]
        left = math.hypot(px - x, py - y)
        scale = self._speed / left if left else 0.0
        return scale * (px - x), scale * (py - y)


def _limited(wish: Velocity, largest: float) -> Velocity:
    """Return a velocity, reduced if it is larger than `largest`."""
    size = math.hypot(*wish)
    scale = largest / size if size > largest else 1.0
    return scale * wish[0], scale * wish[1]
