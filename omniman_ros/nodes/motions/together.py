"""All that moves, on one base of time that may be slowed down."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.path.interpolator import PathState, RefusedError
from omniman_ros.core.path.pace import Demand, Pace
from omniman_ros.core.path.parameters import TICK
from omniman_ros.nodes.motions.scaling_port import ScalingPort

Array = NDArray[np.float64]
SLOWEST = 0.1
"""An end of the node waits for what is driven at this pace or faster."""


class Core(Protocol):
    """What follows a motion."""

    state: PathState

    def demand(self, times: Array) -> Demand | None:
        """What it asks of its limits at motion times (k,) [s]."""
        ...

    def progress(self, now: float) -> float:
        """How much is behind, 0 to 1."""
        ...

    def remaining(self, now: float) -> float:
        """Time to the end [s]."""
        ...

    def pause(self, now: float) -> None:
        """Come to rest on the way."""
        ...

    def resume(self, now: float) -> None:
        """Go on from a pause."""
        ...

    def cancel(self, now: float) -> None:
        """Come to rest on the way, and forget it."""
        ...


class Together:
    """Motion time of several motions, and requests for all of them.

    Args:
        cores: What moves, in the order in which it is named in answers.
        clock: Time [s].
        scaling: How fast the arm's controller lets time pass.
        timeout: Silence after which the scaling is forgotten while nothing moves [s].

    Attributes:
        pace: How fast time passes for the motions.
    """

    def __init__(
        self, cores: Sequence[Core], clock: Callable[[], float], scaling: ScalingPort,
        timeout: Callable[[], float],
    ) -> None:  # fmt: skip
        self._cores, self._clock, self._timeout = tuple(cores), clock, timeout
        self._scaling = scaling
        self.pace = Pace(self._demand, TICK)
        self._held_still = False

    @property
    def moving(self) -> tuple[Core, ...]:
        """Those that are not idle."""
        return tuple(core for core in self._cores if core.state is not PathState.IDLE)

    @property
    def idle(self) -> bool:
        """Whether nothing moves."""
        return not self.moving

    @property
    def state(self) -> PathState:
        """What the first of those does that move."""
        return next((core.state for core in self.moving), PathState.IDLE)

    def now(self) -> float:
        """Motion time now [s]; time itself where nothing was slowed."""
        now = self._clock()
        if self.idle:
            if self._scaling.silent > self._timeout():
                self._scaling.forget()
            self._held_still = False
            self.pace.reset(now, self._scaling.value)
        return self.pace.motion(now)

    def set_pace(self, most: float) -> None:
        """Aim for the pace that the arm's controller and the motions (0 to 1) leave."""
        now = self._clock()
        self.pace.refresh(now)  # what moves may have changed since
        self.pace.aim(0.0 if self._held_still else min(self._scaling.value, most), now)

    def sample_times(self, horizon: float) -> Array:
        """Times (k,) on the ticks [s], from the last one on, that reach so far [s]."""
        first = np.floor(self._clock() / TICK + 1e-6)
        count = max(int(horizon / TICK), 1) + 1
        times: Array = TICK * (first + np.arange(count, dtype=float))
        return times

    def release(self) -> None:
        """Something begins: nothing is held still any more."""
        self._held_still = False

    def pause(self) -> None:
        """Come to rest.

        Raises:
            RefusedError: Nothing that moves can.
        """
        now = self.now()
        self._ask([lambda c=core: c.pause(now) for core in self._asked()])
        self._held_still = self.pace.stands(self._clock())

    def resume(self) -> None:
        """Go on.

        Raises:
            RefusedError: Nothing rests.
        """
        now = self.now()
        self._ask([lambda c=core: c.resume(now) for core in self._asked()])
        self._held_still = False

    def cancel(self) -> None:
        """Come to rest, and forget all motions.

        Raises:
            RefusedError: Nothing moves.
        """
        now = self.now()
        self._ask([lambda c=core: c.cancel(now) for core in self._asked()])

    def _asked(self) -> tuple[Core, ...]:
        return self.moving or self._cores[:1]

    def _ask(self, requests: Sequence[Callable[[], None]]) -> None:
        """Ask all; it is refused if it fits none."""
        refusals = []
        for request in requests:
            try:
                request()
            except RefusedError as error:
                refusals.append(error)
        if len(refusals) == len(requests):
            raise refusals[-1]

    def progress(self) -> float:
        """How much is behind of what goes on, 0 to 1: of the part that has most before it."""
        now = self.now()
        return min(core.progress(now) for core in self.moving)

    def remaining(self) -> float:
        """Time of a stop or of the rest of the motions [s], as fast as they are driven now."""
        now = self.now()
        pace = max(min(self.pace.rate(self._clock()), self._scaling.value), SLOWEST)
        return max((core.remaining(now) for core in self._cores), default=0.0) / pace

    def _demand(self, times: Array) -> Demand:
        parts = [part for part in (core.demand(times) for core in self._cores) if part]
        if not parts:
            return Demand.none(len(times))
        whole, *others = parts
        for part in others:
            whole = whole.beside(part)
        return whole
