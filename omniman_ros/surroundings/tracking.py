"""Estimation of an obstacle's position and velocity from noisy, irregular observations."""

import math
from dataclasses import dataclass

from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated

STEADY_FACTOR = 0.02  #: Ratio of the accelerations of the models of steady and of agile motion [-]
#: Duration of an acceleration [s]: acceleration^2 times this is its spectral density
CORRELATION_TIME = 1.0
STEADY_TIME = 5.0  #: Mean time for which motion stays steady [s]
AGILE_TIME = 0.5  #: Mean time for which motion stays agile [s]
DOUBT_GATE = 12.0  #: Squared misfit, in standard deviations, above which an observation is doubted
#: Squared misfit to agile motion above which a confirmed observation is a sudden change
CHANGE_GATE = 25.0
#: Time without observations after which an observation that does not fit steady motion restarts
#: the track without confirmation [s].
LONG_GAP = 1.0
#: Time after which a doubted observation is accepted if no other one has contradicted it [s]
CONFIRMATION_TIME = 0.3
#: Number of successive doubted observations, each unlike the last, that restart the track
MAX_DOUBTS = 4
#: Weight of the newest sample in the learned noise, once there are many samples [-]
LEARNING_GAIN = 0.08
PRIOR_SAMPLES = 5.0  #: Number of samples by which the parameter of the noise is weighted
#: Longest time of three observations in which noise can be distinguished from motion [s]
LEARNING_SPAN = 0.5
SAMPLE_LIMIT = 9.0  #: Largest sample of the noise's variance, over the variance learned before [-]
MIN_NOISE_FACTOR = 0.01  #: Smallest ratio of the learned noise to the parameter [-]
MAX_NOISE_FACTOR = 10.0  #: Largest ratio of the learned noise to the parameter [-]
MIN_NOISE = 1e-4  #: Smallest learned noise [m]


@dataclass(frozen=True)
class TrackingParameters(Validated):
    """Noise of observations, and limits of the motion of obstacles."""

    noise: float = parameter(
        0.01,
        "Standard deviation of an observed position, until it is learned from observations.",
        unit="m",
        low=1e-4,
        high=1.0,
    )
    acceleration: float = parameter(
        1.0, "Typical acceleration of obstacles.", unit="m/s^2", low=0.01, high=100.0
    )
    growth: float = parameter(
        0.1,
        "Share of its speed by which the margin around a moving obstacle grows each second.",
        low=0.0,
        high=2.0,
    )
    max_speed: float = parameter(
        3.0,
        "Largest speed of an obstacle; the track of an obstacle that moves faster restarts.",
        unit="m/s",
        low=0.01,
        high=100.0,
    )


@dataclass(frozen=True, slots=True)
class _State:
    """Mean and covariance of position and velocity; x and y have the same covariance."""

    x: float
    y: float
    vx: float
    vy: float
    pp: float
    pv: float
    vv: float

    def predicted(self, dt: float, density: float) -> "_State":
        """Return the state dt [s] later for a density of white acceleration noise [m^2/s^3]."""
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
        """Return the state after an observation at x, y [m] of a variance [m^2]."""
        spread = self.pp + variance
        dx, dy = x - self.x, y - self.y
        k, kv = self.pp / spread, self.pv / spread
        # pp and pv are computed without a difference, and so stay positive for any ratio.
        fraction = variance / spread
        return _State(
            self.x + k * dx,
            self.y + k * dy,
            self.vx + kv * dx,
            self.vy + kv * dy,
            fraction * self.pp,
            fraction * self.pv,
            max(self.vv - kv * self.pv, 0.0),
        )


def _mixed(a: _State, b: _State, weight: float) -> _State:
    """Return mean and covariance of a mixture of a, with a weight, and b, with the rest."""
    rest = 1.0 - weight
    dx, dy, dvx, dvy = b.x - a.x, b.y - a.y, b.vx - a.vx, b.vy - a.vy
    spread = 0.5 * weight * rest  # mean over x and y, which have the same covariance
    return _State(
        a.x + rest * dx,
        a.y + rest * dy,
        a.vx + rest * dvx,
        a.vy + rest * dvy,
        weight * a.pp + rest * b.pp + spread * (dx * dx + dy * dy),
        weight * a.pv + rest * b.pv + spread * (dx * dvx + dy * dvy),
        weight * a.vv + rest * b.vv + spread * (dvx * dvx + dvy * dvy),
    )


class ObstacleTrack:
    """Estimates position and velocity of one obstacle from observations of its position.

    MPC 2021, 4.3, computes the velocity from the last two configurations; with 1 cm of noise at
    20 Hz its error is 0.3 m/s. Here two Kalman filters of constant velocity with white
    acceleration noise, one for steady and one for agile motion, are weighted by the likelihood of
    the observations (interacting multiple models). Their noise is learned from second differences,
    on which motion has little influence.

    An observation with a large misfit is not used until a similar one confirms it. Then the
    obstacle has changed its velocity (if its speed suffices for the distance) or was moved (a jump
    faster than `max_speed`: the track restarts at rest with an uncertain velocity).

    Attributes:
        position: (x, y) at `time` [m].
        velocity: (vx, vy) [m/s], not above `max_speed`.
        velocity_deviation: Standard deviation of either component [m/s].
        covariance: Variance of either component of the position [m^2], its covariance with that of
            the velocity [m^2/s], and the latter's variance [m^2/s^2].
        time: Time of the last observation that was used [s].
        observed: (x, y) of that observation, unfiltered [m].
        doubted: Time of an observation that waits for confirmation [s], or infinity.
    """

    def __init__(self, parameters: TrackingParameters, time: float, x: float, y: float) -> None:
        self._parameters = parameters
        agile = parameters.acceleration**2 * CORRELATION_TIME
        self._densities = (STEADY_FACTOR**2 * agile, agile)
        self._noise = parameters.noise**2
        bounds = [(f * parameters.noise) ** 2 for f in (MIN_NOISE_FACTOR, MAX_NOISE_FACTOR)]
        self._noise_bounds = (max(bounds[0], MIN_NOISE**2), max(bounds[1], MIN_NOISE**2))
        self._samples = 0
        self._last: list[tuple[float, float, float]] = []
        self.restart(time, x, y)

    def restart(self, time: float, x: float, y: float) -> None:
        """Restart the track at rest at x, y [m], with a velocity as uncertain as `max_speed`.

        The learned noise stays.
        """
        _demand_finite(time, x, y)
        self._last = [(time, x, y)]
        self._begin(time, x, y)

    def _begin(self, time: float, x: float, y: float) -> None:
        state = _State(x, y, 0.0, 0.0, self._noise, 0.0, self._parameters.max_speed**2)
        self._steady = self._agile = state
        self._odds = 0.5  # probability of steady motion
        self._publish(time, x, y)

    def _publish(self, time: float, x: float, y: float) -> None:
        self._doubtful: tuple[float, float, float] | None = None
        self._doubts = 0
        self.doubted = math.inf
        self.time, self.observed = time, (x, y)
        state = _mixed(self._steady, self._agile, self._odds)
        self.position = (state.x, state.y)
        self.velocity = _bounded(state.vx, state.vy, self._parameters.max_speed)
        self.velocity_deviation = min(math.sqrt(state.vv), self._parameters.max_speed)
        self.covariance = (state.pp, state.pv, state.vv)

    def observe(self, time: float, x: float, y: float) -> bool:
        """Use an observation; return False if it is ignored, as it is not newer than the last one.

        Raises:
            InputError: A value is not finite.
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
        """Accept a doubted observation that none has contradicted for CONFIRMATION_TIME."""
        if self._doubtful is not None and now - self.doubted > CONFIRMATION_TIME:
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
                sample = min((ex * ex + ey * ey) / sum_squares, SAMPLE_LIMIT * self._noise)
                self._samples += 1
                gain = max(LEARNING_GAIN, 1.0 / (self._samples + PRIOR_SAMPLES))
                low, high = self._noise_bounds
                learned = self._noise + gain * (sample - self._noise)
                self._noise = min(max(learned, low), high)
        self._last = [self._last[-1], (time, x, y)]

    def _use(self, time: float, x: float, y: float, sure: bool) -> bool:
        """Correct both filters by an observation; return False and change nothing on a misfit.

        A `sure` observation is confirmed: then its misfit is too large only if it does not fit
        agile motion either.
        """
        dt = time - self.time
        # A Markov chain in continuous time: over a gap the odds decay towards their mean.
        fraction = STEADY_TIME / (STEADY_TIME + AGILE_TIME)
        forgotten = 1.0 - math.exp(-dt / STEADY_TIME - dt / AGILE_TIME)
        stay, come = 1.0 - (1.0 - fraction) * forgotten, fraction * forgotten
        # Probability of steady motion now, and of steady motion before for either motion now.
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
            far = min(misfits) > CHANGE_GATE
        elif dt > LONG_GAP:
            far = misfits[0] > CHANGE_GATE
        else:
            far = odds * misfits[0] * spreads[0] + (1.0 - odds) * misfits[1] * spreads[1] > (
                DOUBT_GATE * (odds * spreads[0] + (1.0 - odds) * spreads[1])
            )
        if far:
            return False
        # Ratio of the two likelihoods; the exponent is limited to prevent an overflow.
        exponent = min(max(0.5 * (misfits[0] - misfits[1]), -500.0), 500.0)
        against = (1.0 - odds) * math.exp(exponent) * spreads[0] / spreads[1]
        self._odds = min(max(odds / (odds + against), 1e-6), 1.0 - 1e-6)
        self._steady = steady.corrected(x, y, self._noise)
        self._agile = agile.corrected(x, y, self._noise)
        self._publish(time, x, y)
        return True

    def _doubt(self, time: float, x: float, y: float) -> None:
        """Store an observation with a large misfit, or accept it if it confirms the one before."""
        first = self._doubtful
        self._doubts += 1
        if first is None and time - self.time <= LONG_GAP:
            self._doubtful, self.doubted = (time, x, y), time
        elif first is not None and self._confirmed(first, (time, x, y)):
            # If its speed suffices for the distance, the obstacle has changed its velocity, at
            # worst so suddenly that only later observations count; otherwise it was moved.
            if not self._reachable((self.time, *self.position), first):
                self._begin(time, x, y)
            elif not (self._use(*first, sure=True) and self._use(time, x, y, sure=True)):
                self._begin(*first)
                if not self._use(time, x, y, sure=True):
                    self._begin(time, x, y)
        elif first is None or self._doubts >= MAX_DOUBTS:
            self._begin(time, x, y)
        else:
            self._doubtful, self.doubted = (time, x, y), time

    def _confirmed(
        self, first: tuple[float, float, float], second: tuple[float, float, float]
    ) -> bool:
        """Return whether two doubted observations (time, x, y) agree in being off the track."""
        (ax, ay), (bx, by) = self._misfit(*first), self._misfit(*second)
        agree = ax * bx + ay * by > 0.5 * (ax * ax + ay * ay)
        return agree and self._reachable(first, second)

    def _misfit(self, time: float, x: float, y: float) -> tuple[float, float]:
        """Return the difference (x, y) of an observation from the predicted position [m]."""
        dt = time - self.time
        return (
            x - self.position[0] - dt * self.velocity[0],
            y - self.position[1] - dt * self.velocity[1],
        )

    def _reachable(self, a: tuple[float, float, float], b: tuple[float, float, float]) -> bool:
        """Return whether an obstacle can have moved from a to b (time, x, y), noise included."""
        distance = self._parameters.max_speed * (b[0] - a[0]) + 4.0 * math.sqrt(self._noise)
        return math.hypot(b[1] - a[1], b[2] - a[2]) <= distance


class ReportedMotion:
    """Position and velocity of one obstacle as its source reports them: it tracks it itself.

    A second filter behind that of the source would only add its delay. The attributes are those
    of `ObstacleTrack`.

    Args:
        parameters: Limits of the motion.
        time: Time of the report [s].
        place: (x, y) [m].
        velocity: (vx, vy) [m/s]; a faster one than `max_speed` is reduced to it.
        deviation: Standard deviation of either component of the velocity [m/s].
    """

    doubted = math.inf

    def __init__(
        self,
        parameters: TrackingParameters,
        time: float,
        place: tuple[float, float],
        velocity: tuple[float, float],
        deviation: float,
    ) -> None:
        self._max_speed = parameters.max_speed
        self.time, self.position, self.observed = time, place, place
        self.velocity = _bounded(*velocity, self._max_speed)
        self.velocity_deviation = min(deviation, self._max_speed)

    def settle(self, now: float) -> None:
        """Do nothing: no report waits for confirmation."""

    def restart(self, time: float, x: float, y: float) -> None:
        """Restart at rest at x, y [m], with a velocity as uncertain as `max_speed`."""
        self.time, self.position, self.observed = time, (x, y), (x, y)
        self.velocity, self.velocity_deviation = (0.0, 0.0), self._max_speed


def _bounded(vx: float, vy: float, bound: float) -> tuple[float, float]:
    """Return a velocity scaled down to a largest speed [m/s]."""
    speed = math.hypot(vx, vy)
    return (vx, vy) if speed <= bound else (vx * bound / speed, vy * bound / speed)


def _demand_finite(time: float, x: float, y: float) -> None:
    if not math.isfinite(time + x + y):
        raise InputError(f"observation at ({x}, {y}) m, {time} s is not finite")
