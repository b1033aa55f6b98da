"""A preview of the platform's motion: timed poses, twists and accelerations in odom."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError

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
        self._times = times
        self._list = times.tolist()
        self._poses = np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])
        self._velocities = velocities
        self._accelerations = accelerations
        self._segment = 0

    @property
    def start(self) -> float:
        """Time of the first point [s]."""
        return float(self._list[0])

    @property
    def end(self) -> float:
        """Time of the last point [s]."""
        return float(self._list[-1])

    @property
    def end_speed(self) -> float:
        """Largest entry of the last point's velocity [m/s or rad/s]: 0 if it ends at rest."""
        return float(np.abs(self._velocities[-1]).max())

    def sample(self, now: float) -> Setpoint:
        """The setpoint at `now` [s]; the segment of the last call is tried first."""
        if now < self.start or now >= self.end:
            return Setpoint(self._poses[0 if now < self.start else -1], np.zeros(3), np.zeros(3))
        times, i = self._list, self._segment
        if not times[i] <= now < times[i + 1]:
            i = int(np.searchsorted(self._times, now, side="right")) - 1
            self._segment = i
        return self._polynomial(i, now - times[i], times[i + 1] - times[i])

    def _polynomial(self, i: int, t: float, span: float) -> Setpoint:
        """Hermite polynomial of segment i, t seconds into its span."""
        x0, x1 = self._poses[i], self._poses[i + 1]
        v0, v1 = self._velocities[i], self._velocities[i + 1]
        gap = x1 - x0 - v0 * span
        lift = (v1 - v0) * span
        u = t / span
        if self._accelerations is None:
            c2, c3 = 3.0 * gap - lift, lift - 2.0 * gap
            c4 = c5 = np.zeros(3)
        else:
            a0, a1 = self._accelerations[i], self._accelerations[i + 1]
            c2 = 0.5 * a0 * span * span
            gap, lift, bend = gap - c2, lift - 2.0 * c2, (a1 - a0) * span * span
            c3 = 10.0 * gap - 4.0 * lift + 0.5 * bend
            c4 = -15.0 * gap + 7.0 * lift - bend
            c5 = 6.0 * gap - 3.0 * lift + 0.5 * bend
        pose = x0 + v0 * t + u * u * (c2 + u * (c3 + u * (c4 + u * c5)))
        velocity = v0 + u / span * (2 * c2 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5)))
        acceleration = (2 * c2 + u * (6 * c3 + u * (12 * c4 + u * 20 * c5))) / (span * span)
        return Setpoint(pose, velocity, acceleration)
