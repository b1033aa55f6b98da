"""A preview of the platform's motion: timed poses, twists and accelerations in odom."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.core.hermite import Hermite

Array = NDArray[np.float64]

MAX_POINTS = 5000
"""Longest accepted preview."""


@dataclass(frozen=True)
class Setpoint:
    """One instant of a reference, x, x', x'' of CCTA 2017 V.B, each (3,) in the world frame."""

    pose: Array
    velocity: Array
    acceleration: Array


class Preview:
    """Points in time, joined by quintic (with accelerations) or cubic polynomials.

    Before its first point a preview waits there, after its last it stays there, both at rest.

    Args:
        times: (k,) [s] on the receiver's clock, strictly increasing.
        poses: (k, 3) x, y, theta in odom [m, m, rad]; headings are unwrapped here.
        velocities: (k, 3) world-frame velocities [m/s, m/s, rad/s].
        accelerations: (k, 3) world-frame accelerations, or None.

    Raises:
        InputError: Empty, too long, wrong shapes, not finite, huge, or times that do not
            increase.
    """

    def __init__(
        self, times: Array, poses: Array, velocities: Array, accelerations: Array | None = None
    ) -> None:
        k = len(times)
        if not 1 <= k <= MAX_POINTS:
            raise InputError(f"a preview has 1 to {MAX_POINTS} points, got {k}")
        for label, array in (("poses", poses), ("velocities", velocities)):
            if array.shape != (k, 3):
                raise InputError(f"preview: {label} of shape {array.shape}, expected ({k}, 3)")
        if accelerations is not None and accelerations.shape != (k, 3):
            raise InputError(f"preview: accelerations of shape {accelerations.shape}")
        plausible.demand(times, np.finfo(float).max, "preview: times")
        plausible.demand(poses[:, :2], plausible.LENGTH, "preview: positions")
        plausible.demand(poses[:, 2], plausible.ANGLE, "preview: headings")
        plausible.demand(velocities, plausible.SPEED, "preview: velocities")
        if accelerations is not None:
            plausible.demand(accelerations, plausible.ACCELERATION, "preview: accelerations")
        if k > 1 and not (np.diff(times) > 1e-6).all():
            raise InputError("preview: the points' times do not increase")
        unwrapped = np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])
        self._curve = Hermite(times, unwrapped, velocities, accelerations)

    @property
    def start(self) -> float:
        """Time of the first point [s]."""
        return self._curve.start

    @property
    def end(self) -> float:
        """Time of the last point [s]."""
        return self._curve.end

    @property
    def end_speed(self) -> float:
        """Largest entry of the last point's velocity [m/s or rad/s]: 0 if it ends at rest."""
        return self._curve.end_speed

    def sample(self, now: float) -> Setpoint:
        """The setpoint at `now` [s]."""
        return Setpoint(*self._curve.sample(now))
