"""Position and velocity of an obstacle from noisy, irregular observations of where it is."""

import math
from dataclasses import dataclass

from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import parameter

STEADY = 0.02
"""Share of the acceleration that the model of steady motion has."""
CORRELATION = 1.0
"""How long an acceleration lasts [s]: acceleration^2 times this is its spectral density."""
SOJOURN = (5.0, 0.5)
"""How long motion stays steady, and how long it stays agile [s]."""
DOUBT = 12.0
"""Square of the misfit, in standard deviations, beyond which an observation is doubted ..."""
GATE = 25.0
"""... and beyond which of even agile motion one that is confirmed is a sudden change."""
GAP = 1.0
"""After so long [s] without an observation one that a steady motion does not explain starts anew,
without confirmation."""
PATIENCE = 0.3
"""A doubted observation that nothing contradicted for so long [s] is believed."""
DOUBTS = 4
"""So many doubted observations in a row, each unlike the last, start anew as well."""
LEARNING = 0.08
"""Share of the newest sample in the learned noise, once there are many ..."""
TRUST = 5.0
"""... and how many samples the parameter counts for."""
LEARNING_SPAN = 0.5
"""Three observations within this time [s] tell noise from motion."""
CLIP = 9.0
"""A sample of the noise's variance counts at most as so many times what was learned before."""
NOISE_SHARE = 0.01, 10.0
"""The learned noise is within these shares of the parameter ..."""
LEAST_NOISE = 1e-4
"""... and not below this [m]."""


@dataclass(frozen=True)
class TrackingParameters:
    """How obstacles are observed, and how they may move."""

    noise: float = parameter(
        0.01, "Standard deviation of an observed position, before it is learned from them.",
        unit="m", low=1e-4, high=1.0,
    )  # fmt: skip
    acceleration: float = parameter(
        1.0, "How quickly obstacles change their velocity.", unit="m/s^2", low=0.01, high=100.0
    )
    growth: float = parameter(
        0.1, "Share of its speed by which the margin around a moving obstacle grows each second.",
        low=0.0, high=2.0,
    )  # fmt: skip
    max_speed: float = parameter(
        3.0, "Fastest that an obstacle moves; what jumps further is put there anew.",
        unit="m/s", low=0.01, high=100.0,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _State:
    """Mean, and the covariance that x and y share: of position, mixed, of velocity."""

    x: float
    y: float
    vx: float
    vy: float
    pp: float
    pv: float
    vv: float

    def predicted(self, dt: float, density: float) -> "_State":
        """The state dt [s] later; density: of the white acceleration noise [m^2/s^3]."""
        return _State(
            self.x + dt * self.vx,
            self.y + dt * self.vy,
            self.vx,
            self.vy,
            self.pp + dt * (2.0 * self.pv + dt * (self.vv + density * dt / 3.0)),
            self.pv + dt * (self.vv + 0.5 * density * dt),
            self.vv + density * dt,
        )

    def corrected(self, x: float, y: float, variance: float) -> "_State":
        """The state after an observation at x, y [m] of this variance [m^2]."""
        spread = self.pp + variance
        dx, dy = x - self.x, y - self.y
        k, kv = self.pp / spread, self.pv / spread
        # pp and pv in the form without a difference: it stays positive for any ratio.
        share = variance / spread
        return _State(
            self.x + k * dx, self.y + k * dy, self.vx + kv * dx, self.vy + kv * dy,
            share * self.pp, share * self.pv, max(self.vv - kv * self.pv, 0.0),
        )  # fmt: skip


def _mixed(a: _State, b: _State, weight: float) -> _State:
    """Mean and covariance of a mixture: a by its weight, b by the rest."""
    rest = 1.0 - weight
    dx, dy, dvx, dvy = b.x - a.x, b.y - a.y, b.vx - a.vx, b.vy - a.vy
    both = 0.5 * weight * rest  # x and y share a covariance: the mean over the two
    return _State(
        a.x + rest * dx, a.y + rest * dy, a.vx + rest * dvx, a.vy + rest * dvy,
        weight * a.pp + rest * b.pp + both * (dx * dx + dy * dy),
        weight * a.pv + rest * b.pv + both * (dx * dvx + dy * dvy),
        weight * a.vv + rest * b.vv + both * (dvx * dvx + dvy * dvy),
    )  # fmt: skip


class ObstacleTrack:
    """Estimates position and velocity of one obstacle from observations of its position.

    MPC 2021, 4.3, takes the velocity from the last two configurations; with 1 cm of noise at
    20 Hz that is wrong by 0.3 m/s. Here two Kalman filters of constant velocity with white
    acceleration noise, one for steady and one for agile motion, are mixed by how well each
    explains what is seen (interacting multiple models). The noise of the observations is learned
    from second differences, in which motion hardly shows.

    An observation far off is not used until a second one like it confirms it: then the obstacle
    has changed its velocity (a way it can have gone) or was put elsewhere (a jump beyond
    `max_speed`: it starts anew at rest with an uncertain velocity).

    Args:
        parameters: Noise, acceleration and largest speed.
        time: Of the first observation [s].
        x, y: First observed position [m].

    Attributes:
        position: (x, y) at `time` [m].
        velocity: (vx, vy) [m/s], not above `max_speed`.
        velocity_deviation: Standard deviation of either component [m/s].
        time: Time of the last observation that was used [s].
        observed: (x, y) of that observation, as it came [m].
        doubted: Time of an observation that waits for confirmation [s], or inf.
    """

    def __init__(self, parameters: TrackingParameters, time: float, x: float, y: float) -> None:
        self._parameters = parameters
        agile = parameters.acceleration**2 * CORRELATION
        self._densities = (STEADY**2 * agile, agile)
        self._noise = parameters.noise**2
        bounds = [(share * parameters.noise) ** 2 for share in NOISE_SHARE]
        self._noise_bounds = (max(bounds[0], LEAST_NOISE**2), max(bounds[1], LEAST_NOISE**2))
        self._samples = 0
        self._last: list[tuple[float, float, float]] = []
        self.restart(time, x, y)

    def restart(self, time: float, x: float, y: float) -> None:
        """Start anew at rest at x, y [m], with a velocity as uncertain as `max_speed`.

        The learned noise stays.
        """
        _demand_finite(time, x, y)
        self._last = [(time, x, y)]
        self._begin(time, x, y)

    def _begin(self, time: float, x: float, y: float) -> None:
        state = _State(x, y, 0.0, 0.0, self._noise, 0.0, self._parameters.max_speed**2)
        self._steady = self._agile = state
        self._odds = 0.5  # of steady motion
        self._publish(time, x, y)

    def _publish(self, time: float, x: float, y: float) -> None:
        """Set the attributes from the state after an observation."""
        self._doubtful: tuple[float, float, float] | None = None
        self._doubts = 0
        self.doubted = math.inf
        self.time, self.observed = time, (x, y)
        state = _mixed(self._steady, self._agile, self._odds)
        self.position = (state.x, state.y)
        self.velocity = _bounded(state.vx, state.vy, self._parameters.max_speed)
        self.velocity_deviation = min(math.sqrt(state.vv), self._parameters.max_speed)

    def observe(self, time: float, x: float, y: float) -> bool:
        """Take an observation in; False if it is not newer than the last one, and ignored.

        Args:
            time: When it was there [s].
            x, y: Where [m].

        Raises:
            InputError: One of them is not finite.
        """
        _demand_finite(time, x, y)
        if time <= self._last[-1][0]:
            return False
        self.settle(time)
        self._learn(time, x, y)
        if not self._use(time, x, y, sure=False):
            self._doubt(time, x, y)
        return True

    def settle(self, now: float) -> None:
        """Believe a doubted observation that nothing contradicted for `PATIENCE` until now [s]."""
        if self._doubtful is not None and now - self.doubted > PATIENCE:
            self._begin(*self._doubtful)

    def _learn(self, time: float, x: float, y: float) -> None:
        """Learn the variance of an observation from the misfit of the last three to a line."""
        if len(self._last) == 2:
            (t0, x0, y0), (t1, x1, y1) = self._last
            if time - t0 <= LEARNING_SPAN:
                ratio = (time - t1) / (t1 - t0)
                ex = x - x1 - ratio * (x1 - x0)
                ey = y - y1 - ratio * (y1 - y0)
                sum_squares = 2.0 * (1.0 + (1.0 + ratio) ** 2 + ratio**2)
                sample = min((ex * ex + ey * ey) / sum_squares, CLIP * self._noise)
                self._samples += 1
                gain = max(LEARNING, 1.0 / (self._samples + TRUST))
                low, high = self._noise_bounds
                learned = self._noise + gain * (sample - self._noise)
                self._noise = min(max(learned, low), high)
        self._last = [self._last[-1], (time, x, y)]

    def _use(self, time: float, x: float, y: float, sure: bool) -> bool:
        """Correct both filters by an observation; False, and unchanged, if it is far off.

        Args:
            time, x, y: The observation [s, m, m].
            sure: Whether it is confirmed: then it is far off only if agile motion would not do.
        """
        dt = time - self.time
        # A Markov chain in continuous time: the odds are forgotten, and never flip, over a gap.
        share = SOJOURN[0] / (SOJOURN[0] + SOJOURN[1])
        forgotten = 1.0 - math.exp(-dt / SOJOURN[0] - dt / SOJOURN[1])
        stay, come = 1.0 - (1.0 - share) * forgotten, share * forgotten
        # Probability of steady motion now, and how much of either came from steady motion.
        odds = self._odds * stay + (1.0 - self._odds) * come
        from_steady = self._odds * stay / odds
        to_agile = self._odds * (1.0 - stay) / (1.0 - odds)
        steady = _mixed(self._steady, self._agile, from_steady).predicted(dt, self._densities[0])
        agile = _mixed(self._steady, self._agile, to_agile).predicted(dt, self._densities[1])
        spreads = steady.pp + self._noise, agile.pp + self._noise
        misfits = (
            ((x - steady.x) ** 2 + (y - steady.y) ** 2) / spreads[0],
            ((x - agile.x) ** 2 + (y - agile.y) ** 2) / spreads[1],
        )
        if sure:
            far = min(misfits) > GATE
        elif dt > GAP:
            far = misfits[0] > GATE
        else:
            far = odds * misfits[0] * spreads[0] + (1.0 - odds) * misfits[1] * spreads[1] > (
                DOUBT * (odds * spreads[0] + (1.0 - odds) * spreads[1])
            )
        if far:
            return False
        # Ratio of the two likelihoods; the exponent is bounded against overflow.
        exponent = min(max(0.5 * (misfits[0] - misfits[1]), -500.0), 500.0)
        against = (1.0 - odds) * math.exp(exponent) * spreads[0] / spreads[1]
        self._odds = min(max(odds / (odds + against), 1e-6), 1.0 - 1e-6)
        self._steady = steady.corrected(x, y, self._noise)
        self._agile = agile.corrected(x, y, self._noise)
        self._publish(time, x, y)
        return True

    def _doubt(self, time: float, x: float, y: float) -> None:
        """Keep an observation that is far off, or believe it with the one before it."""
        first = self._doubtful
        self._doubts += 1
        if first is None and time - self.time <= GAP:
            self._doubtful, self.doubted = (time, x, y), time
        elif first is not None and self._confirmed(first, (time, x, y)):
            # A way that it can have gone is a change of velocity, at worst so sudden that only
            # what came after it counts; else it was put elsewhere.
            if not self._reachable((self.time, *self.position), first):
                self._begin(time, x, y)
            elif not (self._use(*first, sure=True) and self._use(time, x, y, sure=True)):
                self._begin(*first)
                if not self._use(time, x, y, sure=True):
                    self._begin(time, x, y)
        elif first is None or self._doubts >= DOUBTS:
            self._begin(time, x, y)
        else:
            self._doubtful, self.doubted = (time, x, y), time

    def _confirmed(
        self, first: tuple[float, float, float], second: tuple[float, float, float]
    ) -> bool:
        """Whether two doubted observations (time, x, y) belong together, away from the track."""
        (ax, ay), (bx, by) = self._misfit(*first), self._misfit(*second)
        aside = ax * bx + ay * by > 0.5 * (ax * ax + ay * ay)
        return aside and self._reachable(first, second)

    def _misfit(self, time: float, x: float, y: float) -> tuple[float, float]:
        dt = time - self.time
        return (
            x - self.position[0] - dt * self.velocity[0],
            y - self.position[1] - dt * self.velocity[1],
        )

    def _reachable(self, a: tuple[float, float, float], b: tuple[float, float, float]) -> bool:
        """Whether an obstacle can have gone from a to b (time, x, y) but for the noise."""
        way = self._parameters.max_speed * (b[0] - a[0]) + 4.0 * math.sqrt(self._noise)
        return math.hypot(b[1] - a[1], b[2] - a[2]) <= way


def _bounded(vx: float, vy: float, bound: float) -> tuple[float, float]:
    speed = math.hypot(vx, vy)
    return (vx, vy) if speed <= bound else (vx * bound / speed, vy * bound / speed)


def _demand_finite(time: float, x: float, y: float) -> None:
    if not math.isfinite(time + x + y):
        raise InputError(f"observation at ({x}, {y}) m, {time} s is not finite")
