"""Joint setpoints of the arm, one per period: along previews, and to rest when they end."""

import contextlib
import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.ur.allowed_speed import REACTION_TIME, AllowedSpeed
from omniman_ros.ur.blended_preview import (
    FIRM_FRACTION,
    GENTLE_FRACTION,
    BlendedPreview,
    Motion,
    braked_rate,
    stopping_time,
    straight_preview,
)
from omniman_ros.ur.joint_guard import GuardError, JointGuard, JointLimits
from omniman_ros.ur.joint_preview import JointPreview

#: Fraction of the acceleration limits that braking uses, as the path may curve within a period
BRAKING_FRACTION = 0.9
MAX_LEAD_AT_REST = 1.0  #: How far in the future a preview may begin while the arm is at rest [s]
MAX_LEAD_IN_MOTION = 0.1  #: How far in the future a preview may begin while the arm moves [s]
#: Number of preview periods without a new preview after which their source counts as silent
SILENT_PERIODS = 2.0
#: Difference up to which two previews count as starting at the same time [s].
#: Clocks do not agree more closely.
START_TOLERANCE = 2e-3
#: Fraction of the acceleration limits for joining a motion that accelerates at its limits
STEEP_FRACTION = 0.55
SHORT_JOINING_TIME = 0.3  #: Joining time up to which a preview is joined gently [s]
#: Length of the part of a preview that is checked on arrival [s].
#: Each setpoint is checked again before it is sent.
CHECKED_TIME = 1.0


class GeneratorState(Enum):
    """State of the setpoints."""

    HOLDING = "holding"
    FOLLOWING = "following"
    BRAKING = "braking"


@dataclass
class GeneratorSettings:
    """Settings of the generator."""

    #: Largest distance of a new preview from the setpoint [rad]; may change at any time
    start_distance: float
    #: Time by which setpoints are sent before they are due, because the arm lags behind them by as
    #: much [s]; it must not change.
    lead: float = 0.0


class JointSetpointGenerator:
    """Follows previews, and brakes along them when they run out or a stop is requested.

    A preview is followed up to its end. If its source has been silent for two of its periods, the
    generator brakes along it as soon as the remainder is just long enough for that; otherwise it
    brakes beyond the end, with a constant direction. The next preview is joined from there if it
    is near enough, and refused if it is not.

    Each setpoint is that of the time at which the arm will reach it, one lead after it is sent. A
    motion that begins earlier is joined in motion.

    A setpoint that comes too late is not that of the reference: the arm has gone on by its last
    step meanwhile. :meth:`coast` follows it, and the next tick joins the reference from there.

    Where less than the whole speed is allowed, the generator brakes along a preview that is
    faster, and refuses previews that stay so.
    """

    def __init__(self, limits: JointLimits, settings: GeneratorSettings, period: float) -> None:
        self.settings = settings
        self.allowed = AllowedSpeed()
        self.state = GeneratorState.HOLDING
        self._guard = JointGuard(limits, period)
        self._limits = limits
        self._period = period
        self._accepts = False
        self._reference: BlendedPreview | None = None
        # The time at which the arm reaches the last setpoint, on the clock and on the reference.
        self._time = self._progress = 0.0
        self._rate = 1.0  # rate of progress on the reference
        self._off_path = False  # whether each joint brakes by itself
        self._has_coasted = False  # whether the last setpoint continued the last step
        self._rejoined = -math.inf  # when the reference is joined that was left by coasting
        self._newest_start = -math.inf
        self._arrival, self._interval = -math.inf, math.inf

    @property
    def limits(self) -> JointLimits:
        """Limits of the joints.

        A stop must not need more than the distance reserved for it, so lower accelerations apply
        from the next rest on.
        """
        return self._limits

    @limits.setter
    def limits(self, limits: JointLimits) -> None:
        self._limits = limits
        if not self.at_rest:
            acceleration = np.maximum(limits.acceleration, self._guard.limits.acceleration)
            limits = replace(limits, acceleration=acceleration)
        self._guard.limits = limits

    @property
    def setpoint(self) -> Array:
        """Last setpoint (n,) [rad]."""
        return self._guard.last

    @property
    def at_rest(self) -> bool:
        """Whether the setpoints stand still."""
        return self.state is GeneratorState.HOLDING

    def begin(self, measured: Array, now: float) -> Array:
        """Begin at rest at measured angles (n,) [rad], and return them as first setpoint."""
        first = self._guard.begin(measured)
        self._come_to_rest()
        self._time, self._accepts = now + self.settings.lead, True
        return first

    def follow(self, preview: JointPreview, now: float) -> None:
        """Follow a preview from the last setpoint on.

        Raises:
            InputError: No preview is accepted now, or this one is too old, too early or too far
                away, or exceeds the limits.
        """
        if not self._accepts:
            raise InputError("the arm holds and accepts no previews")
        if preview.start < self._newest_start - START_TOLERANCE:
            raise InputError(
                f"out of order, {self._newest_start - preview.start:.3f} s before the last preview"
            )
        if preview.end < now:
            raise InputError(f"the preview ended {now - preview.end:.3f} s ago")
        ahead = preview.start - now
        if ahead > (MAX_LEAD_AT_REST if self.at_rest else MAX_LEAD_IN_MOTION):
            raise InputError(f"the preview begins {ahead:.3f} s ahead")
        begin = max(preview.start, self._time)
        previous = self._current_motion()
        self._check_distance(preview, begin, previous(begin)[0])
        if self.allowed.is_exceeded(preview.sample(begin + REACTION_TIME)[1], self._limits):
            raise InputError(
                f"faster than {self.allowed.value:.0%} of the speed limits, which are left"
            )
        reference = self._join(preview, begin, previous)
        if self._has_coasted or self._time < self._rejoined:
            self._rejoined = reference.joined
        if preview.start > self._newest_start:  # a repeated preview is no sign of life
            arrival = now + self.settings.lead
            self._interval = max(arrival - self._arrival, preview.start - self._newest_start)
            self._arrival = arrival
        self._newest_start = preview.start
        self._adopt(reference)

    def _adopt(self, reference: BlendedPreview) -> None:
        """Follow a reference that begins with the present motion: progress equals time again."""
        self._reference, self._progress, self._rate = reference, self._time, 1.0
        self.state, self._off_path, self._has_coasted = GeneratorState.FOLLOWING, False, False

    def _join(self, preview: JointPreview, begin: float, previous: Motion) -> BlendedPreview:
        """Return the preview, joined as gently as the guard allows, or raise InputError."""
        limits = self._guard.limits.acceleration
        gentle, firm, steep = (
            BlendedPreview(preview, begin, previous, fraction * limits, self._period)
            for fraction in (GENTLE_FRACTION, FIRM_FRACTION, STEEP_FRACTION)
        )
        count = max(int(min(preview.end - self._time, CHECKED_TIME) / self._period), 1)
        steps: Array = self._time + self._period * np.arange(1.0, count + 1.0)
        is_short = gentle.joined - begin <= SHORT_JOINING_TIME
        refusal: GuardError | None = None
        for reference in (gentle, firm, steep) if is_short else (firm, gentle, steep):
            try:
                self._guard.examine(reference.positions_at(steps))
            except GuardError as error:
                refusal = refusal or error
            else:
                return reference
        raise InputError(str(refusal))

    def _check_distance(self, preview: JointPreview, begin: float, position: Array) -> None:
        start = preview.sample(begin)[0]
        if start.shape != position.shape:
            raise InputError(f"must be {position.size} joint angles, got {start.size}")
        distance = np.abs(start - position)
        k = int(distance.argmax())
        is_rejoining = self._has_coasted or self._time < self._rejoined
        allowed = self._limits.distance if is_rejoining else self.settings.start_distance
        if (distance > allowed).any():
            name = self._guard.limits.names[k]
            raise InputError(
                f"{name}: {start[k]:.4g} rad is {distance[k]:.3g} rad away from the setpoint"
            )

    def _current_motion(self) -> Motion:
        """Return the present motion, continued without braking."""
        reference, progress = self._reference, self._progress
        rate, start = self._rate, self._time
        if self._has_coasted:
            return straight_preview(self.setpoint, self._guard.velocity, start).sample
        if reference is None:
            position, zero = self.setpoint, np.zeros_like(self.setpoint)
            return lambda time: (position, zero, zero)
        reference.discard_past(progress)

        def motion(time: float) -> tuple[Array, Array, Array]:
            position, velocity, acceleration = reference.sample(progress + rate * (time - start))
            return position, rate * velocity, rate * rate * acceleration

        return motion

    def hold(self) -> None:
        """Brake along the preview, then hold; refuse previews until :meth:`release`."""
        self._accepts = False
        self.pause()

    def pause(self) -> bool:
        """Brake along the preview, then hold; return whether a preview was followed."""
        was_following = self.state is GeneratorState.FOLLOWING
        if was_following:
            self.state = GeneratorState.BRAKING
        return was_following

    def release(self) -> None:
        """Accept previews again; the arm does not move."""
        self._accepts = True

    def tick(self, now: float, measured: Array | None) -> Array:
        """Return the setpoint (n,) [rad] to send at a time [s].

        Args:
            now: When the setpoint is sent, one period after the last one [s].
            measured: Joint angles (n,) [rad]; None while they are unknown and the arm brakes.

        Raises:
            GuardError: The next setpoint must not be sent. The generator then brakes from the last
                setpoint on: call again with `measured` None.
        """
        if self._has_coasted:
            self._rejoin()
        reference = self._reference
        now = self._time = now + self.settings.lead
        self.allowed.step(self._guard.velocity, self._limits, self._period)
        if reference is None:
            return self._checked(self.setpoint, measured)
        if self.state is GeneratorState.FOLLOWING and (
            self._runs_out(reference, now)
            or self.allowed.is_exceeded(reference.sample(now)[1], self._limits)
        ):
            self.state = GeneratorState.BRAKING
        if self.state is GeneratorState.BRAKING:
            return self._brake(reference, measured)
        setpoint = self._checked(reference.sample(now)[0], measured)
        self._progress = now
        if now >= reference.end and not self._guard.velocity.any():
            self._come_to_rest()
        return setpoint

    def coast(self, now: float) -> Array:
        """Return the setpoint (n,) [rad] of a time that has passed: one more step like the last.

        Raises:
            GuardError: A joint limit is too near; call :meth:`tick` with `measured` None then.
        """
        if self._reference is None:
            return self.tick(now, None)
        self._time = now + self.settings.lead
        self.allowed.step(self._guard.velocity, self._limits, self._period)
        setpoint = self.setpoint + self._period * self._guard.velocity
        self._guard.examine(setpoint[None])
        self._has_coasted = True
        return self._guard.check(setpoint, None)

    def _rejoin(self) -> None:
        """Join the reference from where the arm has coasted to; brake if that is impossible."""
        reference, previous = self._reference, self._current_motion()
        assert reference is not None
        self._has_coasted = False
        if self.state is GeneratorState.FOLLOWING:
            with contextlib.suppress(InputError):
                self._adopt(self._join(reference.preview, self._time, previous))
                assert self._reference is not None
                self._rejoined = self._reference.joined
                return
        self._leave_path(self.setpoint, self._guard.velocity)

    def _runs_out(self, reference: BlendedPreview, now: float) -> bool:
        if now >= reference.end:
            # A preview that ends at rest is joined to the end, however long that takes.
            return bool(np.abs(reference.preview.sample(now)[1]).max() > 0.0)
        if now - self._arrival <= SILENT_PERIODS * self._interval:
            return False
        limits = BRAKING_FRACTION * self._guard.limits.acceleration
        speeds = [np.abs(reference.sample(t)[1]) for t in (now, reference.end)]
        # Braking covers half of the reference's time, and more where the path itself brakes.
        stop_time = 0.75 * stopping_time(np.maximum(*speeds), limits)
        return stop_time >= reference.end - now - self._period

    def _brake(self, reference: BlendedPreview, measured: Array | None) -> Array:
        try:
            setpoint = self._checked_on_path(reference, measured)
        except GuardError:  # the path curves too much, or leads beyond a limit
            setpoint = self._checked(self._brake_joints(), measured)
        if self._rate == 0.0:
            self._come_to_rest()
        return setpoint

    def _checked_on_path(self, reference: BlendedPreview, measured: Array | None) -> Array:
        if self._off_path:
            raise GuardError("the reference path was left before")
        setpoint = self._brake_on_path(reference)
        self._guard.examine(setpoint[None])
        return self._guard.check(setpoint, measured)

    def _brake_on_path(self, reference: BlendedPreview) -> Array:
        """Brake for one period along the path; return the setpoint (n,) [rad]."""
        _, velocity, acceleration = reference.sample(self._progress)
        limits = BRAKING_FRACTION * self._guard.limits.acceleration
        self._rate = braked_rate(velocity, acceleration, self._rate, limits, self._period)
        self._progress += self._period * self._rate
        return reference.sample(self._progress)[0]

    def _brake_joints(self) -> Array:
        """Brake each joint for one period at its limit; return the setpoint (n,) [rad].

        The guard has reserved the distance for this stop before the position limits.
        """
        max_change = self._guard.limits.acceleration * self._period
        velocity = self._guard.velocity
        velocity = velocity - np.clip(velocity, -max_change, max_change)
        setpoint: Array = self.setpoint + self._period * velocity
        self._leave_path(setpoint, velocity)
        self._rate = float(velocity.any())
        return setpoint

    def _checked(self, setpoint: Array, measured: Array | None) -> Array:
        try:
            return self._guard.check(setpoint, measured)
        except GuardError:
            self._leave_path(self._guard.last, self._guard.velocity)
            self._accepts = False
            raise

    def _leave_path(self, position: Array, velocity: Array) -> None:
        """Leave the reference; brake from a setpoint (n,) [rad] and its velocity [rad/s] on."""
        straight, limits = straight_preview(position, velocity, 0.0), self._guard.limits
        zero = np.zeros_like(velocity)
        self._reference = BlendedPreview(
            straight,
            0.0,
            lambda time: (position, velocity, zero),
            limits.acceleration,
            self._period,
        )
        self._progress, self._rate = 0.0, 1.0
        self._off_path, self.state = True, GeneratorState.BRAKING

    def _come_to_rest(self) -> None:
        self._reference, self.state, self._off_path = None, GeneratorState.HOLDING, False
        self._guard.limits = self._limits
        self._rate, self._newest_start, self._interval = 1.0, -math.inf, math.inf
        self._arrival = -math.inf
