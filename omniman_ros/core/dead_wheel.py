"""Finds a wheel whose motor gives no torque: silence raises a suspicion, a probe decides.

With more than three wheels the floor turns a dead one at its proper speed, so neither speeds nor
the coupling residual tell. Its torque does: it is zero though the motion asks for some. But a
healthy wheel may give none either: torques along the motion constraints (T' lambda) move nothing,
loops that differ shift them at will, and behind one dead wheel another one idles, too (of four
in forward motion, the opposite one of its axle). So a suspect is asked: a small torque along the
constraints, which moves nothing, alternates its sign, and who stays silent is dead. (Not who
gives another torque: a wheel that spins on ice does not answer either, but turns itself. Nor who
answers for a moment only: there its loop takes each step of the probe back within milliseconds.)
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.kinematics import PlatformKinematics
from omniman_ros.core.parameters import parameter

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

FILTER = 0.05
"""Time constant of measured and asked torques [s]."""
HYSTERESIS = 3.0
"""A torque this much above silence clears a suspicion."""
UNASKED_PACE = 0.1
"""Pace of a suspicion against a wheel that turns, but is asked for next to nothing. Only where
constraints leave its torque open: else next to nothing is what it gives."""
LEAST_SPEED = 0.1
"""A wheel that is told to turn slower is not suspected [rad/s]."""
PAUSE = 2.0
"""Time for which a wheel that has answered is not asked again [s]."""
SIGNS = (1.0, -1.0, -1.0, 1.0)
"""Signs of the four parts of a probe: what it moves, if anything, it moves back."""
SETTLE = 0.4
"""Share of each part of a probe along the constraints that is left to the drive to settle."""
LEAST_SHARE = 0.15
"""Least part of a wheel's torque that lies along the constraints for these to be used."""
LEAST_REPORTS = 2
"""Reports that each part of a probe needs."""
MOMENT = 0.5
"""A torque of this part of the probe's, if only in one report of it, is an answer."""


@dataclass(frozen=True)
class WheelHealthParameters:
    """When a wheel is said to be dead or blocked. Torques are shares of its largest."""

    asked_torque: float = parameter(
        0.01, "Torque asked of a wheel from which a measured one is expected; asked for less, it "
        "is suspected ten times later.", low=1e-4, high=1,
    )  # fmt: skip
    silent_torque: float = parameter(
        0.005, "Measured torque up to which a wheel counts as giving none: what a drive may "
        "report of a motor without current, less than the friction of a turning wheel.",
        low=1e-5, high=1,
    )  # fmt: skip
    suspicion_time: float = parameter(
        0.1,
        "How long a turning wheel must give none before it is probed.",
        unit="s",
        low=0.01,
        high=10,
    )
    probe_torque: float = parameter(
        0.04, "Torque of the probe, along the motion constraints.", low=1e-3, high=1
    )
    probe_time: float = parameter(
        0.3, "Length of the probe; longer where reports are rare.", unit="s", low=0.02, high=10
    )
    blocked_torque: float = parameter(
        0.5, "Measured torque from which a wheel that stands against it is blocked.",
        low=0.01, high=1,
    )  # fmt: skip
    blocked_time: float = parameter(0.2, "How long it must stand.", unit="s", low=0.005, high=10)

    def __post_init__(self) -> None:
        for name in ("asked_torque", "probe_torque"):
            if getattr(self, name) <= self.silent_torque:
                reason = f"not above health.silent_torque = {self.silent_torque:g}"
                raise ParameterError(f"health.{name}", getattr(self, name), reason)


def _open_share(model: PlatformKinematics) -> Array:
    """Part (n,) of each wheel's torque that the constraints leave open: diagonal of T+ T."""
    share: Array = np.einsum("ij,ji->i", model.T_pinv, model.T)
    return share


def torque_probe(model: PlatformKinematics, wheel: int, torque: float) -> Array:
    """Wheel torques (n,) that ask one wheel for a torque [N m] and move the platform least.

    They are along the constraints, J' tau = 0, where these have enough of the wheel; else (three
    wheels have none) it is the one wheel's torque, which the probe's changes of sign make up for.

    Args:
        model: Kinematics of the wheels that drive.
        wheel: Index of the wheel.
        torque: Its torque [N m].
    """
    alone = np.zeros(model.wheel_count)
    alone[wheel] = 1.0
    internal = model.T_pinv @ model.T[:, wheel]
    share = float(internal[wheel])
    return torque * (internal / share if share >= LEAST_SHARE else alone)


class Probe:
    """One question to the wheels: torques of changing sign, and what is measured meanwhile.

    Args:
        torque: (n,) torques of the probe [N m].
        start: When it starts [s].
        part: Length of each of its four parts [s].
        settle: Share of each part that is left to the drive to settle.

    Attributes:
        asks: (n,) bool: wheels that are asked for enough to be judged.
    """

    def __init__(self, torque: Array, start: float, part: float, settle: float = SETTLE) -> None:
        self._torque = torque
        self._settle = settle
        self._start = start
        self._part = part
        size = np.abs(torque)
        self.asks: Flags = size > 0.5 * float(size.max())
        self._moment = MOMENT * size
        self._peak: Array = np.zeros_like(size)
        self._sums = np.zeros((len(SIGNS), len(torque)))
        self._counts = [0] * len(SIGNS)

    def torque(self, now: float) -> Array:
        """Torques (n,) to add to the command at `now` [N m]."""
        k = int((now - self._start) / self._part)
        return self._torque * SIGNS[k] if 0 <= k < len(SIGNS) else np.zeros_like(self._torque)

    def hear(self, time: float, effort: Array) -> None:
        """Take measured torques (n,) [N m] of a time [s]."""
        phase = (time - self._start) / self._part
        k = int(phase)
        if 0.0 <= phase < len(SIGNS):
            self._peak = np.maximum(self._peak, np.abs(effort))
            if phase - k >= self._settle:
                self._sums[k] += effort
                self._counts[k] += 1

    def over(self, time: float) -> bool:
        """Whether what was measured at `time` comes after the probe."""
        return time - self._start >= self._part * len(SIGNS)

    @property
    def flinched(self) -> Flags:
        """(n,) bool: wheels that gave a good part of the probe's torque for a moment at least."""
        flinched: Flags = self._peak > self._moment
        return flinched

    def answer(self) -> Array | None:
        """RMS over the parts of the mean torque (n,) in each [N m]; None: too few reports.

        A wheel that obeys shows at least the torque of the probe.
        """
        if min(self._counts) < LEAST_REPORTS:
            return None
        means = self._sums / np.array(self._counts)[:, None]
        result: Array = np.sqrt((means * means).mean(axis=0))
        return result


class DeadWheelDetector:
    """Watches measured torques against asked ones, and asks who is silent.

    Attributes:
        torque: (n,) measured torques, filtered [N m].
        reported: Whether the drives report torques: they did in the last report, and some were
            not zero since the start.
    """

    def __init__(
        self, limit: Array, parameters: WheelHealthParameters, model: PlatformKinematics
    ) -> None:
        n = len(limit)
        self.torque: Array = np.zeros(n)
        self.reported = False
        self._lasted: Array = np.zeros(n)  # below zero: a wheel that was asked lately
        self._waiting = False
        self._suspects: Flags = np.zeros(n, dtype=bool)
        self._probe: Probe | None = None
        self._time: float | None = None
        self._gap = 0.0
        self._moved = False
        self.configure(limit, parameters, model)

    def configure(
        self, limit: Array, parameters: WheelHealthParameters, model: PlatformKinematics
    ) -> None:
        """Take over largest torques (n,) [N m], thresholds, and which wheels drive, and how."""
        self._limit = limit
        self._model = model
        self._unasked = np.where(_open_share(model) >= LEAST_SHARE, UNASKED_PACE, 0.0)
        self._parameters = parameters
        self._silence = parameters.silent_torque * limit
        self._loudest_silence = float(self._silence.max())
        self._least_asked = parameters.asked_torque * limit

    def hear(self, time: float, effort: Array | None) -> None:
        """Take the torques (n,) [N m] that were measured at a time [s].

        None, or with a number that is not finite: the drives do not report them.
        """
        if effort is None or not math.isfinite(sum(effort.tolist())):
            self.reported = False
            return
        if self._time is not None and time > self._time:
            self._gap = time - self._time
            self.torque = self.torque + (effort - self.torque) * (self._gap / (self._gap + FILTER))
        self._time = time
        self._moved = self._moved or float(np.abs(effort).max()) > self._loudest_silence
        self.reported = self._moved
        if self._probe is not None:
            self._probe.hear(time, effort)

    def probe(self, now: float) -> Array | None:
        """Torques (n,) [N m] to add to the command at `now`, or None."""
        return None if self._probe is None else self._probe.torque(now)

    def rest(self) -> None:
        """Nothing is asked of the wheels: a question that was begun is dropped."""
        self._probe = None

    def update(self, asked: Array, reference: Array, now: float, dt: float) -> tuple[int, ...]:
        """Judge the wheels; call it once a tick while they are driven.

        Args:
            asked: (n,) torques asked for [N m].
            reference: (n,) speeds asked for [rad/s].
            now, dt: Time and since the last call [s].

        Returns:
            Indices of the wheels found dead.
        """
        if not self.reported:
            return ()  # a probe takes its course: a report may lack torques now and then
        # Most of the time nobody is quiet; plain floats tell it sooner than arrays.
        if not self._waiting and min(map(abs, self.torque.tolist())) >= self._loudest_silence:
            return ()
        size = np.abs(self.torque)
        quiet = size < self._silence
        if not (self._waiting or True in quiet.tolist()):
            return ()
        # Braking is left out: friction may do all of it, without a torque.
        ahead = asked * np.sign(reference)
        if self._probe is not None:
            return self._judge(self._probe, ahead < -self._least_asked)
        loud = size > HYSTERESIS * self._silence
        pace = np.where(ahead > self._least_asked, 1.0, self._unasked)
        pace *= quiet & (ahead > -self._least_asked) & (np.abs(reference) > LEAST_SPEED)
        pace[self._lasted < 0.0] = 1.0
        self._lasted = np.where(loud, np.minimum(self._lasted, 0.0), self._lasted) + dt * pace
        self._waiting = bool(self._lasted.any())
        suspects = self._lasted > self._parameters.suspicion_time
        if suspects.any():
            self._ask(suspects, size, now, dt)
        return ()

    def _ask(self, suspects: Flags, size: Array, now: float, dt: float) -> None:
        """Begin a probe of the quietest suspect, which judges others along with it."""
        p = self._parameters
        wheel = int(np.where(suspects, size, np.inf).argmin())
        torque = torque_probe(self._model, wheel, p.probe_torque * float(self._limit[wheel]))
        part = max(p.probe_time / len(SIGNS), 5.0 * max(dt, self._gap))
        # Where the platform gives way, loops take the probe back: its begin counts, too.
        settle = SETTLE if _open_share(self._model)[wheel] >= LEAST_SHARE else 0.0
        self._suspects, self._probe = suspects, Probe(torque, now, part, settle)

    def _judge(self, probe: Probe, braking: Flags) -> tuple[int, ...]:
        """Wheels that the probe shows dead, once it is over."""
        assert self._time is not None
        asked = self._suspects = self._suspects & probe.asks & ~braking
        if asked.any() and not probe.over(self._time):
            return ()
        self._probe = None
        answer = probe.answer() if asked.any() else None
        self._lasted = np.minimum(self._lasted, 0.0)
        if answer is None:  # whoever is still quiet is asked again, but not at once
            return ()
        self._lasted[asked] = -PAUSE
        silent = asked & (answer < self._silence) & ~probe.flinched
        return tuple(np.flatnonzero(silent).tolist())
