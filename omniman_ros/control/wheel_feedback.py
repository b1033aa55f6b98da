"""Validation of wheel feedback, and its conversion to wheel rotations for the odometry."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.control.encoder import Unwrapper, VelocityObserver
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.errors import InputError
from omniman_ros.core.validated import Validated

#: Bandwidth of the observer that estimates wheel speeds if the drives report none [rad/s]
OBSERVER_BANDWIDTH = 60.0
#: Time constant with which disagreement of reported speeds and positions is forgotten [s]
DISAGREEMENT_TIME = 0.5
MAX_DISAGREEMENT = 0.3  #: Constant part of the disagreement that is allowed [rad]
#: Part of the allowed disagreement that grows with the speed.
#:
#: It is a fraction of the rotation at the reported speed in `DISAGREEMENT_TIME`.
DISAGREEMENT_SPEED_FRACTION = 0.2
MAX_GAP = 0.5  #: Longest time between two reports over which speeds tell the motion [s]
#: Rotation in excess of twice that at the largest speed above which positions jumped [rad]
MAX_JUMP = 0.3


@dataclass(frozen=True)
class WheelStep(Validated):
    """Motion of the wheels between two reports."""

    moved: Annotated[Array, Shape("n")]  #: Rotation of each wheel (n,) [rad]
    speeds: Annotated[Array, Shape("n")]  #: Speed of each wheel (n,) at the second report [rad/s]
    dt: float  #: Time between the reports [s]
    #: Rotation of each wheel (n,) that may be missing in `moved` [rad]; None if the reports follow
    #: each other closely.
    unknown: Annotated[Array | None, Shape("n")]
    warning: str  #: What is not known of the motion, or empty


class WheelFeedback:
    """Converts reports of the drives to steps for the odometry.

    Args:
        span: Range after which positions wrap around [rad]; 0 if they do not.
        max_speed: Largest speed of a wheel [rad/s]; positions that change much faster count as
            reset by the drive.

    Attributes:
        max_speed: May be changed at any time.
        speeds: Last wheel speeds (n,) [rad/s].
        time: Time of their measurement [s].
        received: Whether a report was received since the start or the last `forget`.
        restarted: Whether a drive is known to have restarted since the last discontinuity.
        suspect: Index of a wheel whose reported speed disagrees with its position (a frozen
            encoder), or None.
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
        """Discard all reports: the next one counts as the first."""
        self.received = self.restarted = False
        self.suspect: int | None = None
        self._drift: Array = np.zeros(self._count)
        self._uncertainty: Array = np.zeros(self._count)
        self._arrival = -math.inf
        self._unwrapper = Unwrapper(self._span) if self._span > 0.0 else None
        # Positions of foreign drives often wrap around, and nobody says so.
        self._span_hint = "" if self._span > 0.0 else " (encoder_span, if they wrap around)"
        self._position: Array | None = None
        self._observer.reset()
        self.speeds = np.zeros(self._count)

    def note_restart(self) -> None:
        """Take note that a drive has restarted.

        Its position may continue as if the wheel had rested meanwhile, so that the positions do
        not tell the motion over the next discontinuity.
        """
        self.restarted = self.received

    def age(self, now: float) -> float:
        """Return the age of the last report at `now` [s], by its older time: arrival or stamp."""
        return now - min(self._arrival, self.time)

    def update(
        self, time: float, now: float, position: Array | None, velocity: Array | None
    ) -> WheelStep | None:
        """Return the step from the last report of the drives to this one; None for the first.

        Args:
            position: Wheel positions (n,) [rad], or None if they are not reported.
            velocity: Wheel speeds (n,) [rad/s], or None if they are not reported.

        Raises:
            InputError: An array has the wrong size or values that are not finite or implausibly
                large, both arrays are missing, or the report is not newer than the last one.
        """
        self._validate(time, position, velocity)
        dt = time - self.time if self.received else 0.0
        moved = self._moved(position)
        fault = self._discontinuity(moved, dt)
        if fault:
            self._observer.reset()
        if velocity is None:
            assert self._position is not None
            velocity = self._observer.update(self._position, dt)
        first = not self.received
        last_speeds, self.speeds = self.speeds, np.array(velocity, dtype=float)
        self.time, self._arrival, self.received = time, now, True
        if first:
            return None
        if fault:
            return self._step_over(fault, moved, last_speeds, dt)
        integrated = (0.5 * dt) * (last_speeds + self.speeds)
        if moved is None:
            moved = integrated
        else:
            largest = dt * np.maximum(np.abs(last_speeds), np.abs(self.speeds))
            self._compare(integrated - moved, largest, dt)
        return WheelStep.unchecked(
            moved=moved, speeds=self.speeds, dt=dt, unknown=None, warning=""
        )

    def _step_over(
        self, fault: str, moved: Array | None, last_speeds: Array, dt: float
    ) -> WheelStep:
        """Return the step over a discontinuity.

        Encoders count on while nobody listens. The change of the positions is the motion if each
        wheel has turned as if at speeds between those before and after, and zero: those of drives
        that went on, or came to rest. Positions that the drives have begun anew differ from that;
        those of a drive that is known to have restarted do not count.
        """
        still = np.zeros(self._count)
        low, high = (
            dt * extreme.reduce((last_speeds, self.speeds, still))
            for extreme in (np.minimum, np.maximum)
        )
        is_known = moved is not None and bool(
            ((moved >= low - MAX_JUMP) & (moved <= high + MAX_JUMP)).all()
        )
        if self._unwrapper is not None and float((high - low).max()) > 0.5 * self._span:
            is_known = False  # whole turns may be missing
        if self.restarted:
            is_known, self.restarted = False, False
            fault += ", a drive has restarted"
        if moved is not None and is_known:
            warning = f"wheel_states: {fault}, the positions tell the motion since then"
            return WheelStep(moved, self.speeds, dt, still, warning)
        warning = f"wheel_states: {fault}, the motion since the last report is ignored"
        return WheelStep(still, self.speeds, dt, high - low, warning)

    def _validate(self, time: float, position: Array | None, velocity: Array | None) -> None:
        """Check the content of a report, and that it is newer than the last one."""
        if position is None and velocity is None:
            raise InputError("wheel_states: has neither positions nor velocities")
        for label, array, bound in (
            ("positions", position, plausible.WHEEL_ANGLE),
            ("velocities", velocity, plausible.WHEEL_SPEED),
        ):
            if array is None:
                continue
            if array.shape != (self._count,):
                raise InputError(
                    f"wheel_states: has {array.size} {label} for {self._count} wheels"
                )
            plausible.demand(array, bound, f"wheel_states: {label}")
        if self.received and time <= self.time:
            lag = f"{self.time - time:.4f} s before the last report"
            raise InputError(f"wheel_states: out of order, {lag}")

    def _moved(self, position: Array | None) -> Array | None:
        """Unwrap and store positions; return the rotation (n,) [rad] since the last ones."""
        if position is not None and self._unwrapper is not None:
            position = self._unwrapper.update(position)
        before = self._position
        self._position = None if position is None else np.array(position, dtype=float)
        return None if self._position is None or before is None else self._position - before

    def _compare(self, difference: Array, largest: Array, dt: float) -> None:
        """Set `suspect` to the wheel whose reported speed and position disagree most, if any.

        A report may have been delayed by any time up to that since the previous report, and
        delayed reports arrive together: the rotation at the reported speed is uncertain by the
        largest rotation in a step.

        Args:
            difference: Rotation by the speeds minus that by the positions in this step (n,) [rad].
            largest: Largest possible rotation in this step (n,) [rad].
        """
        decay = math.exp(-dt / DISAGREEMENT_TIME)
        self._drift = self._drift * decay + difference
        self._uncertainty = np.maximum(self._uncertainty * decay, largest)
        allowed = MAX_DISAGREEMENT + DISAGREEMENT_SPEED_FRACTION * DISAGREEMENT_TIME * np.abs(
            self.speeds
        )
        excess = np.abs(self._drift) - allowed - self._uncertainty
        worst = int(excess.argmax())
        self.suspect = worst if excess[worst] > 0.0 else None

    def _discontinuity(self, moved: Array | None, dt: float) -> str:
        """Return why the motion in a step is unknown, or an empty string if it is known."""
        if dt > MAX_GAP:
            return f"no report for {dt:.2f} s"
        if moved is not None and float(np.abs(moved).max()) > 2.0 * self.max_speed * dt + MAX_JUMP:
            return "positions jumped" + self._span_hint
        return ""
