"""The result of planning on the time base, and what is needed to go on from any tick of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.path.smoothing import Smoother

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Ticks:
    """Positions at ticks before the smoothing, and where on the route they are.

    Attributes:
        positions: (k, d) q(u).
        section: (k,) index of the route's section.
        u: (k,) parameter of the section's curve [s].
        rate: (k,) u'.
        progress: (k,) 0 to 1.
    """

    positions: Array
    section: NDArray[np.intp]
    u: Array
    rate: Array
    progress: Array

    def __len__(self) -> int:
        return len(self.u)

    def __getitem__(self, part: NDArray[np.intp]) -> "Ticks":
        return Ticks(*(getattr(self, name)[part] for name in self.__dataclass_fields__))


def joined(parts: Sequence[Ticks]) -> Ticks:
    """Ticks one after the other."""
    names = Ticks.__dataclass_fields__
    return Ticks(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


class Trajectory:
    """x, x', x'' on the time base; cubic polynomials between ticks, at rest after the last.

    Args:
        start: Time of the first tick [s].
        dt: Tick [s].
        ticks: Where it goes, before the smoothing; it ends at rest.
        smoother: What makes it keep the jerk limits.
        history: (smoother.memory, d) positions before the first tick; None if it begins at rest.

    Attributes:
        positions, velocities, accelerations: (k, d) at the ticks.
    """

    def __init__(
        self, start: float, dt: float, ticks: Ticks, smoother: Smoother,
        history: Array | None = None,
    ) -> None:  # fmt: skip
        self.start, self.dt, self.ticks = start, dt, ticks
        self._smoother = smoother
        if history is None:
            history = np.repeat(ticks.positions[:1], smoother.memory, axis=0)
        self._raw = np.vstack([history, ticks.positions])
        self.positions, self.velocities, self.accelerations = smoother.smooth(self._raw)
        self.positions[-1] = ticks.positions[-1]
        self.velocities[-1] = self.accelerations[-1] = 0.0
        # The lag of the smoothing: so much later the robot is where q(u) was.
        self._lag = smoother.memory // 2

    @property
    def end(self) -> float:
        """Time of the last tick [s]."""
        return self.start + (len(self.ticks) - 1) * self.dt

    def index(self, now: float) -> int:
        """The last tick at or before a time, not before the first."""
        return max(int(np.floor((now - self.start) / self.dt + 1e-6)), 0)

    def time(self, index: int) -> float:
        """Time of a tick [s]."""
        return self.start + index * self.dt

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """x, x', x'' (k, d) at times (k,) [s], between ticks too; at rest before the first."""
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
        """How much of the route is behind, 0 to 1."""
        last = len(self.ticks) - 1
        i = min(self.index(now), last)
        return float(self.ticks.progress[i if i == last else max(i - self._lag, 0)])

    def rows(self, first: int, count: int) -> NDArray[np.intp]:
        """Indices of ticks from the first on; the last one stands for all after it."""
        return np.minimum(np.arange(first, first + count), len(self.ticks) - 1)

    def continued(self, now: float, index: int, ticks: Ticks) -> "Trajectory":
        """The same up to a tick, then other ticks, the first of them at that tick.

        What was before `now` [s] is forgotten.
        """
        first, memory = min(self.index(now), index), self._smoother.memory
        history = self._raw[np.minimum(np.arange(first, first + memory), len(self._raw) - 1)]
        kept = self.ticks[self.rows(first, index - first)]
        return Trajectory(
            self.start + first * self.dt, self.dt, joined([kept, ticks]), self._smoother, history
        )
