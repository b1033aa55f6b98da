"""Setpoints of the arm, one a period: along previews, and always to a rest."""

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from omniman_ros.arm.guard import GuardError, JointGuard, JointLimits
from omniman_ros.arm.joint_preview import JointPreview
from omniman_ros.arm.reference import (
    FIRM,
    GENTLE,
    Motion,
    Reference,
    braking,
    stopping_time,
    straight,
)
from omniman_ros.core.errors import InputError

Array = NDArray[np.float64]

BRAKE_SHARE = 0.9
"""Share of the acceleration limits that braking takes: a path bends within a period."""
FURTHEST_AHEAD, AHEAD_OF_MOTION = 1.0, 0.1
"""A preview may begin so much later [s]: at rest, and while the arm moves."""
SILENT_PERIODS = 2.0
"""After so many periods of the previews without another, their source is silent."""
SAME = 2e-3
"""Begins of previews nearer to each other are one [s]: clocks are compared to no better."""
STEEP = 0.55
"""The same as FIRM for motions that gather speed as fast as they may, and are joined under way."""
SOON = 0.3
"""A preview that is joined gently in less time than this is joined gently [s]."""
CHECKED = 1.0
"""So much of a preview is checked when it comes [s]; each setpoint is checked anyway."""


class StreamState(Enum):
    """What the setpoints do."""

    HOLDING = "holding"
    FOLLOWING = "following"
    BRAKING = "braking"


@dataclass
class StreamSettings:
    """What may change while it runs.

    Attributes:
        start_distance: How far from the setpoint a preview may be when it comes [rad].
        lead: By how much the arm is behind its setpoints [s]: they are sent so much before their
            times. Fixed.
    """

    start_distance: float
    lead: float = 0.0


class JointStream:
    """Follows previews; brakes along them when they run out or when it is told to.

    A preview is trusted to its end. It is braked on while it lasts if its source has been silent
    for two of its periods and the rest is just long enough; else at its end, straight on. The next
    preview goes on from there if it is near enough; what is further away is refused.

    Each setpoint is that of the time at which the arm will be there, a lead after it is sent. A
    motion that begins earlier than that is joined under way.

    Args:
        limits: Of the joints; each setpoint is checked by a :class:`JointGuard`.
        settings: See there, live.
        period: Of the setpoints [s].

    Attributes:
        state: What the setpoints do.
        settings: As above.
    """

    def __init__(self, limits: JointLimits, settings: StreamSettings, period: float) -> None:
        self.settings = settings
        self.state = StreamState.HOLDING
        self._guard = JointGuard(limits, period)
        self._limits = limits
        self._period = period
        self._allowed = False
        self._reference: Reference | None = None
        # Of the last setpoint, when the arm is there: on the clock, on the reference.
        self._time = self._at = 0.0
        self._rate, self._each = 1.0, False
        self._newest = -math.inf
        self._arrived, self._interval = -math.inf, math.inf

    @property
    def limits(self) -> JointLimits:
        """Limits of the joints.

        A stop must not become longer than the way that was kept free for it: lower accelerations
        count from the next rest on.
        """
        return self._limits

    @limits.setter
    def limits(self, limits: JointLimits) -> None:
        self._limits = limits
        if not self.at_rest:
            kept = np.maximum(limits.acceleration, self._guard.limits.acceleration)
            limits = replace(limits, acceleration=kept)
        self._guard.limits = limits

    @property
    def setpoint(self) -> Array:
        """The last setpoint (n,) [rad]."""
        return self._guard.last

    @property
    def at_rest(self) -> bool:
        """Whether the setpoints stand."""
        return self.state is StreamState.HOLDING

    def begin(self, measured: Array, now: float) -> Array:
        """Hold where the arm is (n,) [rad]; return the first setpoint. Previews are taken.

        Raises:
            GuardError: The arm is not within its limits.
        """
        first = self._guard.begin(measured)
        self._rest()
        self._time, self._allowed = now + self.settings.lead, True
        return first

    def preview(self, preview: JointPreview, now: float) -> None:
        """Follow a preview from the last setpoint on.

        Raises:
            InputError: Previews are not taken now, or not this one: too old, too early, too far
                away, or more than the limits allow.
        """
        if not self._allowed:
            raise InputError("the arm is held")
        if preview.start < self._newest - SAME:
            raise InputError(f"out of order, {self._newest - preview.start:.3f} s back")
        if preview.end < now:
            raise InputError(f"over {now - preview.end:.3f} s ago")
        ahead = preview.start - now
        if ahead > (FURTHEST_AHEAD if self.at_rest else AHEAD_OF_MOTION):
            raise InputError(f"it begins {ahead:.3f} s ahead")
        begin = max(preview.start, self._time)
        before = self._motion()
        self._demand_near(preview, begin, before(begin)[0])
        reference = self._joining(preview, begin, before)
        if preview.start > self._newest:  # one that is repeated is no sign of life
            arrived = now + self.settings.lead
            self._interval = max(arrived - self._arrived, preview.start - self._newest)
            self._arrived = arrived
        self._newest, self._reference = preview.start, reference
        # On the preview, the last setpoint is where its time is.
        self._at, self._rate, self.state = self._time, 1.0, StreamState.FOLLOWING
        self._each = False

    def _joining(self, preview: JointPreview, begin: float, before: Motion) -> Reference:
        """Return a way onto a preview that the guard lets pass."""
        limits = self._guard.limits.acceleration
        gentle, firm, steep = (
            Reference(preview, begin, before, share * limits, self._period)
            for share in (GENTLE, FIRM, STEEP)
        )
        count = max(int(min(preview.end - self._time, CHECKED) / self._period), 1)
        steps: Array = self._time + self._period * np.arange(1.0, count + 1.0)
        soon = gentle.joined - begin <= SOON
        why: GuardError | None = None
        for reference in (gentle, firm, steep) if soon else (firm, gentle, steep):
            try:
                self._guard.examine(reference.positions_at(steps))
            except GuardError as error:
                why = why or error
            else:
                return reference
        raise InputError(str(why))

    def _demand_near(self, preview: JointPreview, begin: float, position: Array) -> None:
        place = preview.sample(begin)[0]
        if place.shape != position.shape:
            raise InputError(f"{place.size} joint angles, expected {position.size}")
        away = np.abs(place - position)
        k = int(away.argmax())
        if away[k] > self.settings.start_distance:
            name = self._guard.limits.names[k]
            raise InputError(
                f"{name}: {place[k]:.4g} rad is {away[k]:.3g} rad away from where it is led now"
            )

    def _motion(self) -> Motion:
        """What is done now, as it goes on without braking."""
        reference, at, rate, since = self._reference, self._at, self._rate, self._time
        if reference is None:
            place, rest = self.setpoint, np.zeros_like(self.setpoint)
            return lambda time: (place, rest, rest)
        reference.forget(at)

        def motion(time: float) -> tuple[Array, Array, Array]:
            position, velocity, acceleration = reference.sample(at + rate * (time - since))
            return position, rate * velocity, rate * rate * acceleration

        return motion

    def hold(self) -> None:
        """Brake along the preview, then hold; no other is taken."""
        self._allowed = False
        self.pause()

    def pause(self) -> bool:
        """Brake along the preview, then hold until the next comes; whether one was followed."""
        followed = self.state is StreamState.FOLLOWING
        if followed:
            self.state = StreamState.BRAKING
        return followed

    def release(self) -> None:
        """Take previews again; nothing moves by that."""
        self._allowed = True

    def tick(self, now: float, measured: Array | None) -> Array:
        """Return the setpoint (n,) [rad] to send at a time [s].

        Args:
            now: When it is sent, one period after the last.
            measured: Joint angles (n,) [rad]; None while they are not known and it brakes.

        Raises:
            GuardError: What comes next may not be sent. It brakes from the last setpoint on:
                call again with `measured` None.
        """
        reference = self._reference
        now = self._time = now + self.settings.lead
        if reference is None:
            return self._checked(self.setpoint, measured)
        if self.state is StreamState.FOLLOWING and self._runs_out(reference, now):
            self.state = StreamState.BRAKING
        if self.state is StreamState.BRAKING:
            return self._brake(reference, measured)
        setpoint = self._checked(reference.sample(now)[0], measured)
        self._at = now
        if now >= reference.end and not self._guard.velocity.any():
            self._rest()
        return setpoint

    def _runs_out(self, reference: Reference, now: float) -> bool:
        if now >= reference.end:
            # At rest there, what is left of joining it is gone on with.
            return bool(np.abs(reference.preview.sample(now)[1]).max() > 0.0)
        if now - self._arrived <= SILENT_PERIODS * self._interval:
            return False
        limits = BRAKE_SHARE * self._guard.limits.acceleration
        speeds = [np.abs(reference.sample(t)[1]) for t in (now, reference.end)]
        # Braking takes half of the reference's own time, and more where the path brakes as well.
        time = 0.75 * stopping_time(np.maximum(*speeds), limits)
        return time >= reference.end - now - self._period

    def _brake(self, reference: Reference, measured: Array | None) -> Array:
        try:
            setpoint = self._checked_on_path(reference, measured)
        except GuardError:  # it bends too much for that, or leads beyond a limit
            setpoint = self._checked(self._each_slower(), measured)
        if self._rate == 0.0:
            self._rest()
        return setpoint

    def _checked_on_path(self, reference: Reference, measured: Array | None) -> Array:
        if self._each:
            raise GuardError("the path is left already")
        setpoint = self._slower(reference)
        self._guard.examine(setpoint[None])
        return self._guard.check(setpoint, measured)

    def _slower(self, reference: Reference) -> Array:
        """Brake for a period; return where that leads (n,) [rad]."""
        _, velocity, acceleration = reference.sample(self._at)
        limits = BRAKE_SHARE * self._guard.limits.acceleration
        self._rate = braking(velocity, acceleration, self._rate, limits, self._period)
        self._at += self._period * self._rate
        return reference.sample(self._at)[0]

    def _each_slower(self) -> Array:
        """Brake each joint as hard as it may; return where that leads (n,) [rad].

        That is what the guard has kept the way to the position limits free for.
        """
        most = self._guard.limits.acceleration * self._period
        velocity = self._guard.velocity
        velocity = velocity - np.clip(velocity, -most, most)
        setpoint: Array = self.setpoint + self._period * velocity
        self._leave(setpoint, velocity)
        self._rate = float(velocity.any())
        return setpoint

    def _checked(self, setpoint: Array, measured: Array | None) -> Array:
        try:
            return self._guard.check(setpoint, measured)
        except GuardError:
            self._leave(self._guard.last, self._guard.velocity)
            self._allowed = False
            raise

    def _leave(self, position: Array, velocity: Array) -> None:
        """Leave what was followed, to brake from a setpoint with its rate on."""
        onward, limits = straight(position, velocity, 0.0), self._guard.limits
        rest = np.zeros_like(velocity)
        self._reference = Reference(
            onward, 0.0, lambda time: (position, velocity, rest), limits.acceleration, self._period
        )
        self._at, self._rate = 0.0, 1.0
        self._each, self.state = True, StreamState.BRAKING

    def _rest(self) -> None:
        self._reference, self.state, self._each = None, StreamState.HOLDING, False
        self._guard.limits = self._limits
        self._rate, self._newest, self._interval = 1.0, -math.inf, math.inf
        self._arrived = -math.inf
