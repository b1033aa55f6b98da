"""Check of motions for collisions of the robot with itself."""

from dataclasses import dataclass

import numpy as np

from omniman_ros.collision.body_geometry import BodyGeometry
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated
from omniman_ros.motion.path.timed_curve import TimedCurve

#: Largest travel of a part relative to another between two samples of the first look [m]
MAX_DISPLACEMENT = 0.1
#: How much nearer than at the start two parts may come that start within the margin [m]
LEAVING = 0.001
#: Largest number of samples of a motion; a motion that needs more is refused
MAX_SAMPLES = 100_000


@dataclass(frozen=True, kw_only=True)
class SelfCollisionOptions(Validated):
    """Options of the check."""

    check: bool = parameter(
        True, "Whether motions of the arm are refused that bring it against the robot itself."
    )
    margin: float = parameter(
        0.005,
        "Distance that the parts of the robot keep from one another.",
        unit="m",
        low=0.001,
        high=0.2,
    )


@dataclass(frozen=True)
class Approach:
    """The first place of a motion where two parts of the robot come too near."""

    parts: tuple[str, str]  #: Names of the two parts
    time: float  #: Time from the start of the motion [s]
    #: Least distance of the two on the whole motion [m]: below zero, minus the depth; zero for two
    #: boxes, whose depth is not known.
    distance: float

    def __str__(self) -> str:
        first, second = self.parts
        if self.distance > 0.0:
            end = f"would come within {1e3 * self.distance:.1f} mm of {first}"
        elif self.distance < 0.0:
            end = f"would touch {first} and be {-1e3 * self.distance:.1f} mm deep in it"
        else:
            end = f"would touch {first}"
        return f"{second} {end}, {self.time:.2f} s after the start"


class SelfCollisionCheck:
    """Finds out whether a motion brings parts of the robot together, also between its samples.

    Between two samples, the distance of two parts changes by no more than the travel of one
    relative to the other, which is that of the joints between them times the length of the part
    of the arm that they turn. A stretch of time is halved until its two ends and the travel
    between them prove that the distance does not fall below half the margin, or one of its ends
    is within the margin.

    Parts that are within the margin at the start, where the arm may have been put by hand, may
    part, but not come nearer.
    """

    def __init__(self, body: BodyGeometry, options: SelfCollisionOptions) -> None:
        self._body, self.options = body, options

    def require_clear(self, curve: TimedCurve) -> None:
        """Require that a motion, joints [rad] its last six axes, keeps the robot's parts apart.

        Raises:
            InputError: Two parts would come too near; the message says which, when and how near.
        """
        approach = self.first_approach(curve) if self.options.check else None
        if approach is not None:
            raise InputError(f"collision of the robot with itself: {approach}")

    def first_approach(self, curve: TimedCurve) -> Approach | None:
        """Return where a motion first brings two parts too near; None if it does not.

        Raises:
            InputError: The motion is too long to be checked.
        """
        body, margin = self._body, self.options.margin
        if not body.pairs:
            return None
        times = self._first_look(curve)
        distances = self._distances(curve, times)
        least = np.minimum(margin, distances[0] - LEAVING)
        while True:
            near = distances < least
            if near.any():
                first = int(near.any(axis=1).argmax())
                pair = int((distances - least)[first].argmin())
                depth = float(distances[:, pair].min())
                return Approach(body.pairs[pair], float(times[first]), depth)
            displacement = self._displacement(curve, times)
            # The distance in between is at least this much below that at the ends.
            bound = 0.5 * (distances[:-1] + distances[1:] - displacement)
            unproved = ((bound < least - 0.5 * margin) & (displacement > 0.0)).any(axis=1)
            if not unproved.any():
                return None
            if len(times) > MAX_SAMPLES:
                raise InputError("it is too long to be checked for collisions with the robot")
            added = 0.5 * (times[:-1] + times[1:])[unproved]
            where = np.flatnonzero(unproved) + 1
            times = np.insert(times, where, added)
            distances = np.insert(distances, where, self._distances(curve, added), axis=0)

    def _first_look(self, curve: TimedCurve) -> Array:
        """Return times [s] between which the parts travel by about `MAX_DISPLACEMENT` at most."""
        times = np.linspace(0.0, curve.duration, 2 + min(len(curve.times), MAX_SAMPLES // 10))
        pieces = np.ceil(self._displacement(curve, times).max(axis=1) / MAX_DISPLACEMENT)
        pieces = np.clip(pieces, 1, 1 + MAX_SAMPLES // len(times)).astype(np.intp)
        inner = [
            start + (end - start) * np.arange(count) / count
            for start, end, count in zip(times[:-1], times[1:], pieces.tolist(), strict=True)
        ]
        return np.concatenate([*inner, times[-1:]])

    def _distances(self, curve: TimedCurve, times: Array) -> Array:
        """Return the distances (k, P) of all pairs at times (k,) [m]."""
        reach = 2.0 * MAX_DISPLACEMENT
        return self._body.self_distances(curve.sample(times)[0][:, -6:], reach)

    def _displacement(self, curve: TimedCurve, times: Array) -> Array:
        """Return bounds (k - 1, P) of the travel of the pairs' parts between times (k,) [m].

        The speed of a joint between two samples is at most the larger of those at the samples
        plus the change that the larger of the accelerations makes in half the time.
        """
        _, speed, acceleration = (np.abs(part[:, -6:]) for part in curve.sample(times))
        dt = np.diff(times)[:, None]
        fastest = np.maximum(speed[:-1], speed[1:])
        fastest += 0.5 * dt * np.maximum(acceleration[:-1], acceleration[1:])
        return dt * (fastest @ self._body.lever_arms.T)
