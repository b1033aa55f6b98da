"""Previews of the platform's motion: timed poses, velocities and accelerations in odom."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.core import plausible, round_off, se2
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.hermite import Hermite
from omniman_ros.core.validated import Validated

MAX_POINTS = 5000  #: Largest number of points in a preview


@dataclass(frozen=True)
class Setpoint(Validated):
    """One instant of a reference: x, x', x'' of CCTA 2017 V.B in the world frame."""

    pose: Annotated[Array, Shape(3)]  #: Pose (3,) [m, m, rad]
    velocity: Annotated[Array, Shape(3)]  #: Velocity (3,) [m/s, m/s, rad/s]
    acceleration: Annotated[Array, Shape(3)]  #: Acceleration (3,) [m/s^2, m/s^2, rad/s^2]


class Preview:
    """A sampled future motion, interpolated by quintic (with accelerations) or cubic polynomials.

    Before its first point a preview rests at that point, after its last point at the last one.
    Round-off of its source counts for nothing: see `round_off`.

    Args:
        times: Times (k,) on the receiver's clock [s], increasing.
        poses: Poses (k, 3) x, y, theta in odom [m, m, rad]; headings are unwrapped here.
        velocities: World-frame velocities (k, 3) [m/s, m/s, rad/s].
        accelerations: World-frame accelerations (k, 3) [m/s^2, m/s^2, rad/s^2], or None.

    Raises:
        InputError: There are no points or too many, a shape is wrong, a number is not plausible,
            or the times do not increase.
    """

    def __init__(
        self, times: Array, poses: Array, velocities: Array, accelerations: Array | None = None
    ) -> None:
        k = len(times)
        if not 1 <= k <= MAX_POINTS:
            raise InputError(f"a preview has 1 to {MAX_POINTS} points, got {k}")
        for label, array in (("poses", poses), ("velocities", velocities)):
            if array.shape != (k, 3):
                raise InputError(f"preview: {label} have shape {array.shape}, expected ({k}, 3)")
        if accelerations is not None and accelerations.shape != (k, 3):
            shape = accelerations.shape
            raise InputError(f"preview: accelerations have shape {shape}, expected ({k}, 3)")
        plausible.demand(times, np.finfo(float).max, "preview: times")
        plausible.demand(poses[:, :2], plausible.LENGTH, "preview: positions")
        plausible.demand(poses[:, 2], plausible.ANGLE, "preview: headings")
        plausible.demand(velocities, plausible.SPEED, "preview: velocities")
        if accelerations is not None:
            plausible.demand(accelerations, plausible.ACCELERATION, "preview: accelerations")
        unwrapped = np.column_stack([poses[:, :2], se2.nearest_turns(poses[:, 2], poses[0, 2])])
        times, rows = round_off.distinct(times, unwrapped)
        velocities = round_off.ended(velocities[rows])
        accelerations = None if accelerations is None else accelerations[rows]
        self._curve = Hermite(times, unwrapped[rows], velocities, accelerations)

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
        """Largest magnitude in the last point's velocity [m/s or rad/s]; 0 if it ends at rest."""
        return self._curve.end_speed

    def sample(self, now: float) -> Setpoint:
        """Return the setpoint at `now` [s]."""
        pose, velocity, acceleration = self._curve.sample(now)
        return Setpoint.unchecked(pose=pose, velocity=velocity, acceleration=acceleration)
