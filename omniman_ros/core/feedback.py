"""Wheel feedback: validated, unwrapped, and never older than it says."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.encoder import Unwrapper, VelocityObserver
from omniman_ros.core.errors import InputError

Array = NDArray[np.float64]

OBSERVER_BANDWIDTH = 60.0
"""Of the observer that stands in for a drive that reports no speed [rad/s]."""
DISAGREEMENT_TIME = 0.5
"""Time over which reported speeds and positions are compared [s]."""
DISAGREEMENT = 0.3
"""What they may differ by in that time [rad] ..."""
DISAGREEMENT_SHARE = 0.2
"""... and over the way that the speed makes in it."""
GAP = 0.5
"""Longest gap between two reports that still counts as one motion [s]."""


@dataclass(frozen=True)
class WheelStep:
    """What one report adds: turn (n,) [rad], speed (n,) [rad/s], time [s], and a warning."""

    moved: Array
    speeds: Array
    dt: float
    warning: str


class WheelFeedback:
    """Turns reports of the drives into steps for the odometry.

    Args:
        count: Number of wheels n.
        span: Range after which positions wrap [rad]; 0 if they do not.
        max_speed: Fastest that a wheel turns [rad/s]; positions that jump further were set anew.

    Attributes:
        max_speed: As above, live.
        speeds: (n,) last speeds [rad/s].
        time: When they were measured [s].
        heard: Whether there is any feedback to act on.
        suspect: Index of a wheel whose reported speed is not that of its position, or None: a
            frozen encoder.
    """

    def __init__(self, count: int, span: float, max_speed: float) -> None:
        self._count = count
        self._span = span
        self.max_speed = max_speed
        self._observer = VelocityObserver(OBSERVER_BANDWIDTH)
        self.speeds: Array = np.zeros(count)
        self.time = -math.inf
        self.forget()

    def forget(self) -> None:
        """Start anew: the next report is the first."""
        self.heard = False
        self.suspect: int | None = None
        self._drift: Array = np.zeros(self._count)
        self._unsure: Array = np.zeros(self._count)
        self._arrival = -math.inf
        self._unwrapper = Unwrapper(self._span) if self._span > 0.0 else None
        self._position: Array | None = None
        self._observer.reset()
        self.speeds = np.zeros(self._count)

    def age(self, now: float) -> float:
        """Age of the last report [s], by its arrival and by its stamp, the stricter."""
        return now - min(self._arrival, self.time)

    def update(
        self, time: float, now: float, position: Array | None, velocity: Array | None
    ) -> WheelStep | None:
        """Take a report in; None for the first one.

        Raises:
            InputError: Wrong size, not finite, neither positions nor speeds, or not newer.
        """
        if position is None and velocity is None:
            raise InputError("wheel_states: neither positions nor velocities")
        for label, array, bound in (
            ("positions", position, plausible.WHEEL_ANGLE),
            ("velocities", velocity, plausible.WHEEL_SPEED),
        ):
            if array is None:
                continue
            if array.shape != (self._count,):
                raise InputError(f"wheel_states: {array.size} {label} for {self._count} wheels")
            plausible.demand(array, bound, f"wheel_states: {label}")
        if self.heard and time <= self.time:
            raise InputError(f"wheel_states: out of order, {self.time - time:.4f} s back")
        dt = time - self.time if self.heard else 0.0
        if position is not None and self._unwrapper is not None:
            position = self._unwrapper.update(position)
        before = self._position
        self._position = None if position is None else np.array(position, dtype=float)
        moved = None if self._position is None or before is None else self._position - before
        broken = self._broken(moved, dt)
        if broken:
            self._observer.reset()
        if velocity is None and position is not None:
            velocity = self._observer.update(position, dt)
        assert velocity is not None
        first = not self.heard
        last_speeds, self.speeds = self.speeds, np.array(velocity, dtype=float)
        self.time, self._arrival, self.heard = time, now, True
        if first:
            return None
        if broken:
            warning = f"wheel_states: {broken}, step left out"
            return WheelStep(np.zeros(self._count), self.speeds, dt, warning)
        way = (0.5 * dt) * (last_speeds + self.speeds)
        if moved is None:
            moved = way
        else:
            longest = dt * np.maximum(np.abs(last_speeds), np.abs(self.speeds))
            self._compare(way - moved, longest, dt)
        return WheelStep(moved, self.speeds, dt, "")

    def _compare(self, apart: Array, way: Array, dt: float) -> None:
        """Find a wheel whose speed and position drift apart.

        A report may have been held up anywhere in the time since the one before it, and what was
        held up then comes at once: so long the way that the speed makes is not known to more.

        Args:
            apart: (n,) way by the speeds less way by the positions in this step [rad].
            way: (n,) longest way in it [rad].
            dt: Its time [s].
        """
        kept = math.exp(-dt / DISAGREEMENT_TIME)
        self._drift = self._drift * kept + apart
        self._unsure = np.maximum(self._unsure * kept, way)
        allowed = DISAGREEMENT + DISAGREEMENT_SHARE * DISAGREEMENT_TIME * np.abs(self.speeds)
        excess = np.abs(self._drift) - allowed - self._unsure
        worst = int(excess.argmax())
        self.suspect = worst if excess[worst] > 0.0 else None

    def _broken(self, moved: Array | None, dt: float) -> str:
        """Why the step is not one motion, or an empty string."""
        if dt > GAP:
            return f"{dt:.2f} s gap"
        if moved is not None and float(np.abs(moved).max()) > 2.0 * self.max_speed * dt + 0.3:
            return "positions jumped"
        return ""
