"""The most recent seconds of some signals, for the plots."""

import numpy as np

from omniman_ros.core.arrays import Array

PLOT_SPAN = 15.0  #: Time that a plot covers [s]
SAMPLE_RATE = 20.0  #: Sample rate of the plots [Hz]


class SignalWindow:
    """The most recent seconds of some signals, sampled at an even rate.

    A value that arrives sooner replaces the previous one.

    Args:
        rate: Sample rate [Hz]; a value that arrives sooner replaces the previous one.
    """

    def __init__(self, signals: int, span: float = PLOT_SPAN, rate: float = SAMPLE_RATE) -> None:
        self._span = span
        # Half a period is left for the jitter of a caller that samples at exactly this rate.
        self._min_interval = 0.5 / rate
        self._times = np.full(round(span * rate), -np.inf)
        self._values = np.full((len(self._times), signals), np.nan)

    def sample(self, now: float, values: Array) -> None:
        """Add values (n,) at a time [s]; unknown values are NaN."""
        if now - self._times[-1] >= self._min_interval:
            self._times[:-1] = self._times[1:]
            self._values[:-1] = self._values[1:]
            self._times[-1] = now
        self._values[-1] = values

    def clear(self) -> None:
        """Discard all samples."""
        self._times[:] = -np.inf
        self._values[:] = np.nan

    def columns(self, now: float) -> tuple[Array, ...]:
        """Return the times (k,) relative to `now` [s, negative], then each signal (k,)."""
        first = int(np.searchsorted(self._times, now - self._span))
        return (self._times[first:] - now, *self._values[first:].T)
