"""The obstacles that the page has placed: ellipses on ways of constant velocity."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.planning.cases import Turned

Array = NDArray[np.float64]
Pair = tuple[float, float]

RADIUS = 0.25
"""Of a new obstacle [m]."""
SMALLEST, LARGEST = 0.02, 5.0
"""Semi-axes [m]."""
FASTEST = 3.0
"""Largest velocity, in x and in y [m/s]."""
MOST = 100
"""Obstacles of a page; more are refused."""


@dataclass(frozen=True)
class Member:
    """One obstacle.

    Attributes:
        number: Its own, never used again.
        semi_axes: [m].
        angle: Of its x axis [rad].
        home: Its way from a restart on.
        way: Its way now, over the time since `since`.
        since: In the crowd's time [s].
    """

    number: int
    semi_axes: Pair
    angle: float
    home: Turned
    way: Turned
    since: float

    def place(self, time: float) -> Pair:
        """Where it is (x, y) at a time of the crowd [m]."""
        x, y = self.way(time - self.since).tolist()
        return x, y

    def velocity(self, time: float) -> Pair:
        """How fast it is at a time of the crowd [m/s]."""
        return self.way.speed(time - self.since)


@dataclass(frozen=True)
class Rows:
    """All obstacles at an instant, in `odom`.

    Attributes:
        numbers: (M,) their own.
        centers: (M, 2) [m].
        semi_axes: (M, 2) [m].
        angles: (M,) of their x axes [rad].
        velocities: (M, 2) [m/s]; zero while they are held.
        courses: (M, 2) with which they go on once they are let go [m/s]; None: as `velocities`.
    """

    numbers: NDArray[np.int64]
    centers: Array
    semi_axes: Array
    angles: Array
    velocities: Array
    courses: Array | None = None

    @staticmethod
    def none() -> "Rows":
        """No obstacle."""
        flat = np.zeros((0, 2))
        return Rows(np.zeros(0, dtype=np.int64), flat, flat, np.zeros(0), flat)


class Crowd:
    """Obstacles that can be added, dragged, shaped, sent off, held and brought back.

    It has a time of its own, which stands while the crowd is held. Where an obstacle is put is
    where a restart brings it back to.
    """

    def __init__(self) -> None:
        self._members: dict[int, Member] = {}
        self._next = 0
        self._begun = 0.0
        self._held_at: float | None = None

    def __len__(self) -> int:
        """How many there are."""
        return len(self._members)

    def __contains__(self, number: object) -> bool:
        """Whether there is an obstacle of that number."""
        return number in self._members

    def __getitem__(self, number: int) -> Member:
        """The obstacle of a number.

        Raises:
            InputError: There is none.
        """
        if number not in self._members:
            raise InputError(f"there is no obstacle {number}")
        return self._members[number]

    @property
    def held(self) -> bool:
        """Whether all stand."""
        return self._held_at is not None

    def time(self, now: float) -> float:
        """The crowd's own time at a time of any steady clock [s]."""
        return now - self._begun if self._held_at is None else self._held_at

    def hold(self, now: float) -> None:
        """Let all stand where they are."""
        self._held_at = self.time(now)

    def go(self, now: float) -> None:
        """Let all go on."""
        if self._held_at is not None:
            self._begun, self._held_at = now - self._held_at, None

    def restart(self, now: float) -> None:
        """Bring all back to where they were put; they stand if they are held, else they go."""
        held = self.held
        self._begun, self._held_at = now, 0.0 if held else None
        self._members = {
            number: replace(member, way=member.home, since=0.0)
            for number, member in self._members.items()
        }

    def add(
        self, way: Turned, now: float, semi_axes: Pair = (RADIUS, RADIUS), angle: float = 0.0
    ) -> int:
        """Add an obstacle whose way begins now; returns its number.

        Raises:
            InputError: There are too many, or its place, shape or velocity cannot be.
        """
        if len(self) >= MOST:
            raise InputError(f"there are {MOST} obstacles already")
        number = self._next
        self._keep(Member(number, semi_axes, angle, way, way, self.time(now)))
        self._next += 1
        return number

    def put(self, number: int, place: Pair, now: float) -> None:
        """Put an obstacle at a place [m]; it goes on from there, and begins there from now on.

        Raises:
            InputError: There is none, or the place cannot be.
        """
        member, time = self[number], self.time(now)
        way = Turned(place, member.velocity(time))
        self._keep(replace(member, home=way, way=way, since=time))

    def send(self, number: int, velocity: Pair, now: float) -> None:
        """Give an obstacle a velocity [m/s].

        Raises:
            InputError: There is none, or it cannot be so fast.
        """
        member, time = self[number], self.time(now)
        home, way = Turned(member.home.place, velocity), Turned(member.place(time), velocity)
        self._keep(replace(member, home=home, way=way, since=time))

    def shape(self, number: int, semi_axes: Pair, angle: float) -> None:
        """Give an obstacle semi-axes [m] and a heading [rad].

        Raises:
            InputError: There is none, or it cannot be so small or large.
        """
        self._keep(replace(self[number], semi_axes=semi_axes, angle=angle))

    def delete(self, number: int | None) -> None:
        """Delete an obstacle, or all."""
        if number is None:
            self._members.clear()
        else:
            self._members.pop(number, None)

    def rows(self, now: float) -> Rows:
        """All of them at a time of the steady clock, by number."""
        members, time = list(self._members.values()), self.time(now)
        if not members:
            return Rows.none()
        velocities = np.array([member.velocity(time) for member in members])
        return Rows(
            np.array([member.number for member in members]),
            np.array([member.place(time) for member in members]),
            np.array([member.semi_axes for member in members]),
            np.array([member.angle for member in members]),
            np.zeros_like(velocities) if self.held else velocities,
            velocities,
        )

    def _keep(self, member: Member) -> None:
        if not all(SMALLEST <= axis <= LARGEST for axis in member.semi_axes):
            raise InputError(
                f"semi-axes {member.semi_axes} are not within {SMALLEST:g} to {LARGEST:g} m"
            )
        for way in (member.home, member.way):
            plausible.demand(np.array(way.place), plausible.LENGTH, "place")
            plausible.demand(np.array([way.velocity, way.then]), FASTEST, "velocity")
        if not math.isfinite(member.angle):
            raise InputError(f"angle {member.angle} is not finite")
        self._members[member.number] = member
