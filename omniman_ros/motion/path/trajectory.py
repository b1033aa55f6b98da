"""Result of planning on the time base, with all that a new plan from any tick of it needs."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.motion.path.smoothing import Smoother


@dataclass(frozen=True)
class Ticks(Validated):
    """Positions at ticks before the smoothing, and their places on the route."""

    positions: Annotated[Array, Shape("k", "d")]  #: (k, d) positions q(u)
    section: Annotated[NDArray[np.intp], Shape("k")]  #: (k,) index of the route's section
    u: Annotated[Array, Shape("k")]  #: (k,) parameter of the section's curve [s]
    rate: Annotated[Array, Shape("k")]  #: (k,) rate u'
    progress: Annotated[Array, Shape("k")]  #: (k,) completed fraction of the route, 0 to 1

    def __len__(self) -> int:
        return len(self.u)

    def __getitem__(self, part: NDArray[np.intp]) -> "Ticks":
        return Ticks(*(getattr(self, name)[part] for name in self.__dataclass_fields__))


def concatenate(parts: Sequence[Ticks]) -> Ticks:
    """Concatenate ticks in time."""
    names = Ticks.__dataclass_fields__
    return Ticks(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


class Trajectory:
    """Motion on the time base: cubic polynomials between ticks, at rest after the last tick.

    Args:
        ticks: Positions before the smoothing, which end at rest.
        history: (smoother.memory, d) positions before the first tick; None if it starts at rest.

    Attributes:
        positions, velocities, accelerations: (k, d) at the ticks.
    """

    def __init__(
        self,
        start: float,
        dt: float,
        ticks: Ticks,
        smoother: Smoother,
        history: Array | None = None,
    ) -> None:
        self.start, self.dt, self.ticks = start, dt, ticks
        self._smoother = smoother
        if history is None:
            history = np.repeat(ticks.positions[:1], smoother.memory, axis=0)
        self._raw = np.vstack([history, ticks.positions])
        self.positions, self.velocities, self.accelerations = smoother.smooth(self._raw)
        self.positions[-1] = ticks.positions[-1]
        self.velocities[-1] = self.accelerations[-1] = 0.0
        # Lag of the smoothing: the robot is where q(u) was this many ticks before.
        self._lag = smoother.memory // 2

    @property
    def end(self) -> float:
        """Time of the last tick [s]."""
        return self.start + (len(self.ticks) - 1) * self.dt

    def index(self, now: float) -> int:
        """Return the index of the last tick at or before a time [s], at least 0."""
        return max(int(np.floor((now - self.start) / self.dt + 1e-6)), 0)

    def time(self, index: int) -> float:
        """Return the time of a tick [s]."""
        return self.start + index * self.dt

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, d) at any times (k,) [s]; at rest before the first tick."""
        last = len(self.ticks) - 1
        i = np.clip(np.floor((times - self.start) / self.dt + 1e-6), 0, last).astype(np.intp)
        s = np.clip(times - self.start - self.dt * i, 0.0, self.dt)[:, None]
        x, v, a = self.positions[i], self.velocities[i], self.accelerations[i]
        jerk = (self.accelerations[np.minimum(i + 1, last)] - a) / self.dt
        return (
            x + s * (v + s * (0.5 * a + s * jerk / 6.0)),
            v + s * (a + 0.5 * s * jerk),
            a + s * jerk,
        )

    def progress(self, now: float) -> float:
        """Return the completed fraction of the route, 0 to 1."""
        last = len(self.ticks) - 1
        i = min(self.index(now), last)
        return float(self.ticks.progress[i if i == last else max(i - self._lag, 0)])

    def rows(self, first: int, count: int) -> NDArray[np.intp]:
        """Return the indices of `count` ticks from `first` on; the last index after the end."""
        return np.minimum(np.arange(first, first + count), len(self.ticks) - 1)

    def continued(self, now: float, index: int, ticks: Ticks) -> "Trajectory":
        """Return this motion up to a tick, followed by other ticks from that tick on.

        Ticks before `now` [s] are dropped. The others start at the tick `index`.
        """
        first, memory = min(self.index(now), index), self._smoother.memory
        history = self._raw[np.minimum(np.arange(first, first + memory), len(self._raw) - 1)]
        kept = self.ticks[self.rows(first, index - first)]
        return Trajectory(
            self.start + first * self.dt,
            self.dt,
            concatenate([kept, ticks]),
            self._smoother,
            history,
        )
