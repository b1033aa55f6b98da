"""What a drive on the floor recorded: wheel positions, motor currents and voltages."""

from dataclasses import dataclass

import numpy as np

from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError


@dataclass(frozen=True, eq=False)
class FloorDrive:
    """Recording of one drive of n wheels, from rest to rest.

    Raises:
        InputError: Sizes do not match, times do not increase, or a position or current is not
            finite.
    """

    times: Array  #: (k,) times of the positions, increasing [s]
    positions: Array  #: (k, n) wheel positions, not wrapped [rad]
    electrical_times: Array  #: (m,) times of currents and voltages, same clock, increasing [s]
    currents: Array  #: (m, n) motor currents [A]
    voltages: Array  #: (m, n) motor voltages [V]; NaN where a drive does not report it

    def __post_init__(self) -> None:
        n = self.positions.shape[-1]
        for name, times, table in (
            ("positions", self.times, self.positions),
            ("currents", self.electrical_times, self.currents),
            ("voltages", self.electrical_times, self.voltages),
        ):
            if table.shape != (len(times), n) or len(times) < 2:
                raise InputError(
                    f"{name} of shape {table.shape} at {len(times)} times, {n} wheels"
                )
            if not (np.diff(times) > 0.0).all():
                raise InputError(f"the times of the {name} do not increase")
        plausible.demand(self.positions, plausible.WHEEL_ANGLE, "wheel positions")
        if not np.isfinite(self.currents).all():
            raise InputError("a current is not finite: the drives must report currents")

    @property
    def wheel_count(self) -> int:
        """Number of wheels n."""
        return int(self.positions.shape[1])

    @property
    def start(self) -> float:
        """Time from which on all signals are known [s]."""
        return float(max(self.times[0], self.electrical_times[0]))

    @property
    def end(self) -> float:
        """Time up to which all signals are known [s]."""
        return float(min(self.times[-1], self.electrical_times[-1]))
