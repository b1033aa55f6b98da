"""Stretches of a stream: positions, velocities and accelerations at given times."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.motion.path.pace import Pace


@dataclass(frozen=True)
class Window(Validated):
    """A stretch of a stream of d axes: the motion (k, d) at its times, in SI units."""

    times: Annotated[Array, Shape("k")]  #: Times (k,) [s]
    positions: Annotated[Array, Shape("k", "d")]
    velocities: Annotated[Array, Shape("k", "d")]
    accelerations: Annotated[Array, Shape("k", "d")]

    def columns(self, columns: slice) -> "Window":
        """Return the same stretch for some of the axes."""
        arrays = (self.positions, self.velocities, self.accelerations)
        return Window(self.times, *(array[:, columns] for array in arrays))

    def slowed(self, start: float, rate: float) -> "Window":
        """Return the same path, driven from `start` [s] on at a constant rate above 0."""
        times = start + (self.times - self.times[0]) / rate
        return Window(times, self.positions, self.velocities * rate, self.accelerations * rate**2)


def paced_window(
    pace: Pace, sample: Callable[[Array], tuple[Array, Array, Array]], times: Array
) -> Window:
    """Sample a motion that is driven at a pace.

    Args:
        sample: Returns x, x', x'' (k, d) of the motion at motion times (k,) [s].
        times: (k,) increasing [s].
    """
    paced = pace.sample(times)
    return Window(times, *paced.apply(*sample(paced.motion)))
