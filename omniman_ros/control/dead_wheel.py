"""Detection of a wheel whose motor gives no torque ("dead"): a silent wheel is probed.

With more than three wheels the floor drives a dead wheel at its proper speed, so neither speeds
nor the coupling residual reveal it. Its torque does: it is zero although the motion demands some.
But a healthy wheel may give none either: torques along the motion constraints (T' lambda) move
nothing, and differences between the drives' control loops shift them arbitrarily. Moreover, one
dead wheel makes another wheel idle (of four in forward motion, the opposite wheel of its axle).
Therefore a suspect is probed: a small torque along the constraints, which moves nothing,
alternates its sign, and a wheel that stays silent is dead.

A wheel whose torque differs from the probe's is not dead: a wheel that spins on ice does not
respond to the probe either, but its own motor rotates it. A wheel that responds only briefly is
not dead either: its control loop compensates each step of the probe within milliseconds.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated

Flags = NDArray[np.bool_]  #: One flag per wheel, (n,) bool

TORQUE_FILTER_TIME = 0.05  #: Time constant of the filter of the measured torques [s]
CLEARING_RATIO = 3.0  #: Ratio of a torque to the silent torque above which it clears a suspicion
#: Factor on the silent time of a rotating wheel from which hardly any torque is demanded. It is
#: used only where the constraints leave the wheel's torque open; elsewhere a healthy wheel gives
#: hardly any torque either, and the time does not count.
UNDEMANDED_PACE = 0.1
#: Reference speed up to which a wheel that follows it is not suspected [rad/s]
MIN_REFERENCE = 0.1
#: Speed error from which any wheel should give a torque, even if it brakes or its reference is at
#: rest [rad/s]. Without a constraint left, nothing else reveals a dead wheel of which the motion
#: demands a braking torque: the robot would drive another twist than commanded.
MIN_SPEED_ERROR = 0.3
PROBE_PAUSE = 2.0  #: Time for which a wheel that has responded is not probed again [s]
#: Signs of the four parts of a probe; they cancel any motion that the probe causes
PROBE_SIGNS = (1.0, -1.0, -1.0, 1.0)
#: Fraction of each part of a probe along the constraints in which the drive settles
SETTLING_FRACTION = 0.4
#: Fraction of a wheel's torque along the constraints from which a probe uses them
MIN_CONSTRAINT_FRACTION = 0.15
MIN_REPORTS = 2  #: Number of reports that each part of a probe needs
#: Fraction of the probe's torque that counts as a response, even in a single report
RESPONSE_FRACTION = 0.5


@dataclass(frozen=True)
class WheelHealthParameters(Validated):
    """Thresholds of dead and blocked wheels; torques are fractions of the largest torque."""

    asked_torque: float = parameter(
        0.01,
        "Demanded torque from which a measured torque is expected; below it, a wheel is probed "
        "ten times later.",
        low=1e-4,
        high=1,
    )
    silent_torque: float = parameter(
        0.005,
        "Measured torque up to which a wheel counts as silent: above the torque that a drive may "
        "report for a motor without current, below the friction of a rotating wheel.",
        low=1e-5,
        high=1,
    )
    suspicion_time: float = parameter(
        0.1,
        "Time for which a rotating wheel must be silent before it is probed.",
        unit="s",
        low=0.01,
        high=10,
    )
    probe_torque: float = parameter(
        0.04, "Torque of the probe, along the motion constraints.", low=1e-3, high=1
    )
    probe_time: float = parameter(
        0.3, "Duration of the probe; longer if reports are rare.", unit="s", low=0.02, high=10
    )
    blocked_torque: float = parameter(
        0.5,
        "Measured torque from which a wheel that stands still despite it counts as blocked.",
        low=0.01,
        high=1,
    )
    blocked_time: float = parameter(
        0.2, "Time for which a blocked wheel must stand still.", unit="s", low=0.005, high=10
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("asked_torque", "probe_torque"):
            if getattr(self, name) <= self.silent_torque:
                reason = f"must be above health.silent_torque = {self.silent_torque:g}"
                raise self._refusal(name, reason)


def _open_fraction(model: PlatformKinematics) -> Array:
    """Return the share (n,) of each wheel's torque that the constraints leave open: diag(T+ T)."""
    fraction: Array = np.einsum("ij,ji->i", model.T_pinv, model.T)
    return fraction


def torque_probe(model: PlatformKinematics, wheel: int, torque: float) -> Array:
    """Return wheel torques (n,) [N m] that probe one wheel and move the platform least.

    They are along the constraints, J' tau = 0, if these leave enough of the wheel's torque open.
    Otherwise (three wheels have no constraints) only this wheel gets a torque, whose alternating
    sign cancels the motion.
    """
    single = np.zeros(model.wheel_count)
    single[wheel] = 1.0
    internal = model.T_pinv @ model.T[:, wheel]
    fraction = float(internal[wheel])
    return torque * (internal / fraction if fraction >= MIN_CONSTRAINT_FRACTION else single)


class Probe:
    """Torques of alternating sign to add to the command, and the statistics of the response.

    Args:
        torque: Torques of the probe (n,) [N m].
        part: Duration of each of its four parts [s].
        settling_share: Fraction of each part in which the drive settles.

    Attributes:
        judged: (n,) bool: wheels whose torque in the probe is large enough to judge them.
    """

    def __init__(
        self, torque: Array, start: float, part: float, settling_share: float = SETTLING_FRACTION
    ) -> None:
        self._torque = torque
        self._settling_share = settling_share
        self._start = start
        self._part = part
        magnitude = np.abs(torque)
        self.judged: Flags = magnitude > 0.5 * float(magnitude.max())
        self._response_torque = RESPONSE_FRACTION * magnitude
        self._peak: Array = np.zeros_like(magnitude)
        self._sums = np.zeros((len(PROBE_SIGNS), len(torque)))
        self._counts = [0] * len(PROBE_SIGNS)

    def torque(self, now: float) -> Array:
        """Return the torques (n,) to add to the command at `now` [N m]."""
        k = int((now - self._start) / self._part)
        if 0 <= k < len(PROBE_SIGNS):
            return self._torque * PROBE_SIGNS[k]
        return np.zeros_like(self._torque)

    def update_torques(self, time: float, effort: Array) -> None:
        """Add torques (n,) [N m] that were measured at `time` [s]."""
        phase = (time - self._start) / self._part
        k = int(phase)
        if 0.0 <= phase < len(PROBE_SIGNS):
            self._peak = np.maximum(self._peak, np.abs(effort))
            if phase - k >= self._settling_share:
                self._sums[k] += effort
                self._counts[k] += 1

    def is_over(self, time: float) -> bool:
        """Return whether `time` [s] is after the probe."""
        return time - self._start >= self._part * len(PROBE_SIGNS)

    @property
    def responded(self) -> Flags:
        """(n,) bool: wheels that gave `RESPONSE_FRACTION` of the probe's torque at least once."""
        responded: Flags = self._peak > self._response_torque
        return responded

    def response(self) -> Array | None:
        """Return the RMS of each part's mean torque (n,) [N m]; None with too few reports.

        A wheel that follows its command shows at least the torque of the probe.
        """
        if min(self._counts) < MIN_REPORTS:
            return None
        means = self._sums / np.array(self._counts)[:, None]
        result: Array = np.sqrt((means * means).mean(axis=0))
        return result


class DeadWheelDetector:
    """Compares measured torques with demanded ones, and probes wheels that are silent.

    Args:
        limit: Largest torques (n,) [N m].

    Attributes:
        torque: Measured torques (n,), filtered [N m].
        reported: Whether the drives report torques: the last report has them, and since the start
            some were not zero.
    """

    def __init__(
        self, limit: Array, parameters: WheelHealthParameters, model: PlatformKinematics
    ) -> None:
        n = len(limit)
        self.torque: Array = np.zeros(n)
        self.reported = False
        # Duration of each wheel's silence [s]; below zero for a wheel that was probed lately.
        self._silent_for: Array = np.zeros(n)
        self._waiting = False
        self._suspects: Flags = np.zeros(n, dtype=bool)
        self._probe: Probe | None = None
        self._time: float | None = None
        self._gap = 0.0
        self._any_torque = False
        self.configure(limit, parameters, model)

    def configure(
        self, limit: Array, parameters: WheelHealthParameters, model: PlatformKinematics
    ) -> None:
        """Set new torque limits (n,) [N m], thresholds and kinematics."""
        self._limit = limit
        self._model = model
        constrained = _open_fraction(model) >= MIN_CONSTRAINT_FRACTION
        self._undemanded_pace = np.where(constrained, UNDEMANDED_PACE, 0.0)
        self._parameters = parameters
        self._silent_torque = parameters.silent_torque * limit
        self._max_silent_torque = float(self._silent_torque.max())
        self._min_demand = parameters.asked_torque * limit

    def update_torques(self, time: float, effort: Array | None) -> None:
        """Process the torques that the drives report.

        Args:
            effort: Torques (n,) [N m]. None, or a number that is not finite, means that the
                drives do not report them.
        """
        if effort is None or not math.isfinite(sum(effort.tolist())):
            self.reported = False
            return
        if self._time is not None and time > self._time:
            self._gap = time - self._time
            gain = self._gap / (self._gap + TORQUE_FILTER_TIME)
            self.torque = self.torque + (effort - self.torque) * gain
        self._time = time
        above_silence = float(np.abs(effort).max()) > self._max_silent_torque
        self._any_torque = self._any_torque or above_silence
        self.reported = self._any_torque
        if self._probe is not None:
            self._probe.update_torques(time, effort)

    def probe(self, now: float) -> Array | None:
        """Return the torques (n,) [N m] to add to the command at `now`, or None."""
        return None if self._probe is None else self._probe.torque(now)

    def rest(self) -> None:
        """Abandon a running probe, because nothing is demanded of the wheels."""
        self._probe = None

    def update(
        self, demand: Array, reference: Array, error: Array, now: float, dt: float
    ) -> tuple[int, ...]:
        """Return the indices of wheels found dead; call this once a tick while they are driven.

        Args:
            demand: Demanded torques (n,) [N m].
            reference: Demanded speeds (n,) [rad/s].
            error: Demanded minus measured speeds (n,) [rad/s].
        """
        if not self.reported:
            return ()  # a probe continues: a report may lack torques occasionally
        # Most of the time no wheel is silent, which plain floats show faster than arrays.
        quietest = min(map(abs, self.torque.tolist()))
        if not self._waiting and quietest >= self._max_silent_torque:
            return ()
        magnitude = np.abs(self.torque)
        silent = magnitude < self._silent_torque
        if not (self._waiting or True in silent.tolist()):
            return ()
        # Braking does not count: friction may do all of it, without a torque, unless it does not.
        driving_torque = demand * np.sign(reference)
        astray = np.abs(error) > MIN_SPEED_ERROR
        braking = (driving_torque < -self._min_demand) & ~astray
        if self._probe is not None:
            return self._judge(self._probe, braking)
        cleared = magnitude > CLEARING_RATIO * self._silent_torque
        demanded = astray | (driving_torque > self._min_demand)
        pace = np.where(demanded, 1.0, self._undemanded_pace)
        pace *= silent & ~braking & (astray | (np.abs(reference) > MIN_REFERENCE))
        pace[self._silent_for < 0.0] = 1.0
        silent_for = np.where(cleared, np.minimum(self._silent_for, 0.0), self._silent_for)
        self._silent_for = silent_for + dt * pace
        self._waiting = bool(self._silent_for.any())
        suspects = self._silent_for > self._parameters.suspicion_time
        if suspects.any():
            self._begin_probe(suspects, magnitude, now, dt)
        return ()

    def _begin_probe(self, suspects: Flags, magnitude: Array, now: float, dt: float) -> None:
        """Begin to probe the suspect with the smallest torque; this judges other suspects, too."""
        parameters = self._parameters
        wheel = int(np.where(suspects, magnitude, np.inf).argmin())
        probe_torque = parameters.probe_torque * float(self._limit[wheel])
        torque = torque_probe(self._model, wheel, probe_torque)
        part = max(parameters.probe_time / len(PROBE_SIGNS), 5.0 * max(dt, self._gap))
        # Where the platform yields, control loops compensate the probe: its beginning counts, too.
        constrained = _open_fraction(self._model)[wheel] >= MIN_CONSTRAINT_FRACTION
        settling_share = SETTLING_FRACTION if constrained else 0.0
        self._suspects, self._probe = suspects, Probe(torque, now, part, settling_share)

    def _judge(self, probe: Probe, braking: Flags) -> tuple[int, ...]:
        assert self._time is not None
        probed = self._suspects = self._suspects & probe.judged & ~braking
        if probed.any() and not probe.is_over(self._time):
            return ()
        self._probe = None
        response = probe.response() if probed.any() else None
        self._silent_for = np.minimum(self._silent_for, 0.0)
        if response is None:  # a wheel that is still silent is probed again, but not at once
            return ()
        self._silent_for[probed] = -PROBE_PAUSE
        silent = probed & (response < self._silent_torque) & ~probe.responded
        return tuple(np.flatnonzero(silent).tolist())
