"""The experiment that measures friction: what voltages to give, when to measure, for how long.

MPC 2021, below (24): wheels off the floor, a constant voltage on each motor, wait until the speed
is constant, measure; again for several voltages of both signs. A pure state machine: whoever has
the robot gives it times and measurements and passes on its voltages.

The wheels turn against one another: each one's sign is chosen so that the forces which they would
have on the floor cancel. A robot that was not lifted strains, and does not drive away; it is
found by wheels that do not turn as they should at the first, low voltage.
"""

import enum
import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError, OmnimanError
from omniman_ros.core.friction_identification import LEAST_SPEED, SteadyRun, robust_mean
from omniman_ros.core.kinematics import PlatformKinematics
from omniman_ros.core.robot import Robot

Array = NDArray[np.float64]

TOP_SHARE = 0.95
"""Of the largest voltage and speed, how much is used."""
CHECK_SHARE = 0.25
"""Speed of the first, low voltage over the largest."""
TURNING = 0.3
"""Share of the speed without any friction below which a wheel is held by something."""
STRAIN, STRAIN_SHARE = 5.0, 0.15
"""Current of a wheel that something holds: over the configured friction's, and at least over the
largest current."""
RECENT = 9
"""Currents whose median is looked at for that: single spikes are none."""
HELD_AFTER = 1.0
"""Time after a ramp from which on that is looked at [s]."""
INERTIA_SHARE = 0.01
"""Torque of inertia over that of friction below which a speed is constant."""
DRIFT = 0.002
"""Change of the speed in a second, over the largest, that is constant in any case [1/s]."""
WINDOW = 0.5
"""Time over which the slope of the speed is taken [s]."""
LEAST_SAMPLES = 20
"""Speeds in a window, and currents in a mean, at least."""
LOOK = 0.2
"""Time between two looks at slope or error [s]."""
NOISE_FLOOR = 2e-4
"""Standard error of a mean current that is good enough in any case, over the largest current."""
HELD_UP = 0.08
"""Pause in voltages or states from which on a level is begun again [s]: the drives may have
ramped down by themselves."""
FOLLOW = 0.1
"""Time after that in which the voltages follow the speeds, so that no current jumps [s]."""
VOLTS_SHARE, VOLTS_OFF = 0.3, 0.5
"""Difference of a voltage to the one that was asked for, over that and at least [V], from which
on the drive does not give what it was asked for."""
GIVEN_AFTER = 0.2
"""Time after a ramp from which on its voltage must be given [s]."""
MOST_AGAIN, MOST_OFF_AGAIN = 12, 3
"""How often a level may be begun again, in all and because of its voltages."""
STILL = 0.05
"""Speed below which a wheel rests [rad/s]."""
MOST_WHEELS = 12
"""Wheels up to which all combinations of signs are tried."""


class ExperimentError(OmnimanError):
    """The experiment cannot go on; the message says why, for the user."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What is given to the motors, and how long it is waited and measured.

    Attributes:
        levels: Voltages one after the other, signed [V].
        check: Low voltage with which it begins [V].
        signs: (n,) +1 or -1: the wheels' voltages over the level.
        ramp, stop_ramp: Rate of the voltages in the experiment, and to end it early [V/s].
        settle: Longest time until the speed must be constant [s].
        shortest, longest: Time of a measurement [s].
        precision: Standard error of a mean current over the friction's, where a measurement ends.
        silence: Time without feedback at which it ends [s].
    """

    levels: tuple[float, ...]
    check: float
    signs: Array
    ramp: float
    stop_ramp: float
    settle: float = 6.0
    shortest: float = 1.5
    longest: float = 20.0
    precision: float = 0.005
    silence: float = 0.3

    @property
    def longest_time(self) -> float:
        """Bound of the whole experiment's time [s]."""
        top = max(map(abs, self.levels))
        runs = len(self.levels) + 1
        return runs * (self.settle + self.longest + 2.0 * top / self.ramp)


def balanced_signs(robot: Robot) -> Array:
    """Signs (n,) of equal wheel torques that push a robot on the floor least, then turn it least.

    Wheel torques t make the wrench J' t on the platform (power balance, CCTA 2017 (19)). With
    four equal Mecanum wheels they are those of the motion constraint, and the wrench is zero.
    """
    jacobian = PlatformKinematics(robot.wheels).J
    n = min(robot.wheel_count, MOST_WHEELS)

    codes = np.arange(2 ** (n - 1))[:, None]
    tried = np.column_stack([np.ones(len(codes)), 1.0 - 2.0 * (codes >> np.arange(n - 1) & 1)])
    x, y, turn = np.round(tried @ jacobian[:n], 6).T
    signs = np.ones(robot.wheel_count)
    signs[:n] = tried[np.lexsort((np.abs(turn), np.round(np.hypot(x, y), 6)))[0]]
    signs.setflags(write=False)
    return signs


def make_plan(
    robot: Robot, levels: int = 6, rounds: int = 2, precision: float = 0.005, silence: float = 0.3
) -> Plan:
    """Plan the experiment for a robot.

    Each round goes from the highest voltage down to the lowest, so that wheels turn already where
    stiction might hold them, and then the other way. Speeds are denser at both ends (Chebyshev's
    points), which tells a better than even ones do.

    Args:
        robot: As configured.
        levels: Voltages in each direction, at least 3.
        rounds: How often each is given.
        precision, silence: See :class:`Plan`.

    Raises:
        InputError: An argument is out of its range, or the robot is too slow to be measured.
    """
    if levels < 3 or rounds < 1:
        raise InputError(f"{levels} levels in {rounds} rounds: at least 3 in 1 are needed")
    if not 1e-4 <= precision <= 0.2:
        raise InputError(f"precision {precision:g} is not within 0.0001 to 0.2")
    if not silence > 0.0:
        raise InputError(f"silence {silence:g} s must be above 0")
    motor = robot.motor
    back_emf = motor.gear_ratio * motor.torque_constant
    highest = TOP_SHARE * min(motor.max_voltage, motor.max_speed * back_emf)
    gain = motor.gear_efficiency * back_emf

    def drop(speed: float) -> float:
        """Voltage that friction as configured takes at a speed."""
        friction = max(
            a * speed + b
            for a, b in zip(robot.friction.viscous, robot.friction.coulomb, strict=True)
        )
        return motor.resistance * friction / gain

    def volts(speed: float) -> float:
        """Voltage for a speed; never above the highest."""
        return min(back_emf * speed + drop(speed), highest)

    top = (highest - drop(highest / back_emf)) / back_emf
    low = max(0.1 * top, 1.3 * LEAST_SPEED)
    if top < 3.0 * low:
        raise InputError(
            f"wheels of up to {top:.3g} rad/s are too slow: {3.0 * low:.3g} rad/s are needed"
        )
    middle, half = 0.5 * (top + low), 0.5 * (top - low)
    speeds = [middle + half * math.cos(math.pi * k / (levels - 1)) for k in range(levels)]
    down = [highest, *(volts(speed) for speed in speeds[1:])]
    return Plan(
        levels=tuple((down + [-level for level in down]) * rounds),
        check=volts(CHECK_SHARE * top),
        signs=balanced_signs(robot),
        ramp=highest / 1.5,
        stop_ramp=highest / 0.7,
        precision=precision,
        silence=silence,
    )


class Phase(enum.Enum):
    """What is being done."""

    RAMP = "ramp"
    SETTLE = "wait"
    MEASURE = "measure"
    END = "slow down"
    DONE = "done"


class FrictionExperiment:
    """Leads wheels through a plan.

    Args:
        robot: As configured.
        plan: From :func:`make_plan`.
        now: Time [s].

    Attributes:
        runs: What was measured so far.
        phase: What is being done.
        reached: Index of the level, -1 for the first, low voltage.
    """

    def __init__(self, robot: Robot, plan: Plan, now: float) -> None:
        motor, n = robot.motor, robot.wheel_count
        self._plan = plan
        self._names = robot.wheels.names
        self._back_emf = motor.gear_ratio * motor.torque_constant
        self._gain = motor.gear_efficiency * self._back_emf
        self._max_speed, self._max_current = motor.max_speed, motor.max_current
        self._inertia = np.array(robot.wheels.inertia)
        self._slope_floor = DRIFT * max(map(abs, plan.levels)) / self._back_emf
        self._strain = self._current_limit(robot)
        self._recent: deque[Array] = deque(maxlen=RECENT)
        self._reference = np.zeros(n)
        self._level, self._now = 0.0, now
        self._since = self._looked = self._moved = now
        self._wheels_at = self._electrical_at = now
        self._speed = np.full(n, math.inf)
        self._current = np.zeros(n)
        self._stamp = -math.inf
        self._speeds: list[tuple[float, Array]] = []
        self._positions: list[tuple[float, Array]] = []
        self._samples: list[tuple[Array, Array]] = []
        self._early = False
        self._again, self._off_again, self._trouble, self._off_volts = 0, 0, "", ""
        self._follow_until = now
        self.runs: list[SteadyRun] = []
        self.phase = Phase.RAMP
        self.reached = -1

    def _current_limit(self, robot: Robot) -> Array:
        """Currents (n,) [A] above which wheels do not turn freely, ramps included."""
        friction, top = robot.friction, max(map(abs, self._plan.levels)) / self._back_emf
        free = (np.array(friction.viscous) * top + friction.coulomb) / self._gain
        ramp = self._inertia * self._plan.stop_ramp / self._back_emf / self._gain
        limit: Array = np.maximum(STRAIN * free, STRAIN_SHARE * self._max_current) + 2.0 * ramp
        return limit

    # ---- what is measured ---------------------------------------------------------------------

    def on_wheels(self, stamp: float, position: Array, velocity: Array, now: float) -> None:
        """Take a state of the wheels.

        Args:
            stamp: When it was measured, on the robot's clock [s].
            position: (n,), not wrapped [rad].
            velocity: (n,) [rad/s].
            now: Time [s].

        Raises:
            InputError: It is not finite, or its stamp is not after the one before.
        """
        n = len(self._names)
        for label, values, bound in (
            ("positions", position, plausible.WHEEL_ANGLE),
            ("velocities", velocity, plausible.WHEEL_SPEED),
        ):
            if values.shape != (n,):
                raise InputError(f"wheel_states: {values.size} {label}, the robot has {n} wheels")
            plausible.demand(values, bound, f"wheel_states: {label}")
        if not (math.isfinite(stamp) and stamp > self._stamp):
            raise InputError(f"wheel_states: stamp {stamp:.6f} s is not after {self._stamp:.6f} s")
        if stamp - self._stamp > HELD_UP and math.isfinite(self._stamp):
            self._trouble = f"no wheel_states for {stamp - self._stamp:.2f} s"
        self._stamp, self._speed, self._wheels_at = stamp, velocity, now
        if self.phase in (Phase.SETTLE, Phase.MEASURE):
            self._speeds.append((stamp, velocity))
            if self.phase is Phase.MEASURE:
                self._positions.append((stamp, position))

    def on_electrical(self, voltage: Array, current: Array, now: float) -> None:
        """Take voltages (n,) [V] and currents (n,) [A] of the motors.

        Raises:
            InputError: Wrong size or not finite.
        """
        n = len(self._names)
        for label, values in (("voltages", voltage), ("currents", current)):
            if values.shape != (n,):
                raise InputError(
                    f"wheel_electrical: {values.size} {label}, the robot has {n} wheels"
                )
            plausible.demand(values, plausible.EFFORT, f"wheel_electrical: {label}")
        self._electrical_at, self._current = now, current
        self._recent.append(current)
        if self.phase is Phase.MEASURE:
            self._samples.append((voltage, current))
        if self.phase is Phase.MEASURE or (
            self.phase is Phase.SETTLE and now - self._since > GIVEN_AFTER
        ):
            self._check_given(voltage)

    def _check_given(self, voltage: Array) -> None:
        """Compare voltages (n,) with those that are asked for: drives may ramp down by themselves.

        What they can do without a sign in the states, where commands do not reach them in time.
        """
        asked = self._level * self._plan.signs
        off = np.abs(voltage - asked) - VOLTS_SHARE * np.abs(asked) - VOLTS_OFF
        k = int(off.argmax())
        if off[k] > 0.0:
            self._off_volts = self._trouble = (
                f"the drive of '{self._names[k]}' gives {voltage[k]:.2f} V where {asked[k]:.2f} V "
                "are asked for"
            )

    # ---- what is done -------------------------------------------------------------------------

    @property
    def at_rest(self) -> bool:
        """Whether no wheel turns, by what was heard last."""
        return bool(np.abs(self._speed).max() < STILL)

    @property
    def fraction(self) -> float:
        """How much of it is done, from 0 to 1."""
        return (self.reached + 1) / (len(self._plan.levels) + 1)

    def end(self, now: float, at_once: bool = False) -> None:
        """End early: ramp down, or drop the voltage at once where the drives stop by themselves.

        What was measured in full stays.
        """
        if self.phase in (Phase.END, Phase.DONE):
            return
        self._begin(Phase.END, now)
        self._early, self._moved = True, now
        if at_once:
            self._level = 0.0

    def volts(self, now: float) -> Array:
        """Voltages (n,) [V] to be given now; call it every 20 ms or more often.

        Raises:
            ExperimentError: It cannot go on. Then call :meth:`end`, and go on to give these
                voltages until `phase` is DONE.
        """
        step, self._now = max(now - self._now, 0.0), now
        if self.phase not in (Phase.END, Phase.DONE):
            if step > HELD_UP:
                self._trouble = f"no voltages were given for {step:.2f} s"
            self._watch(now)
            if self._trouble:
                self._begin_again(now)
        if self.phase is Phase.RAMP:
            if now < self._follow_until:
                self._follow()
                return self._level * self._plan.signs
            self._ramp(self._target, self._plan.ramp * step)
            if self._level == self._target:
                self._begin(Phase.SETTLE, now)
        elif self.phase is Phase.SETTLE:
            self._settle(now)
        elif self.phase is Phase.MEASURE:
            self._measure(now)
        elif self.phase is Phase.END:
            self._ramp(0.0, (self._plan.stop_ramp if self._early else self._plan.ramp) * step)
            if self._level != 0.0:
                self._moved = now
            rested = self.at_rest and now - self._moved > 0.2
            if self._level == 0.0 and (rested or now - self._moved > 3.0):
                self.phase = Phase.DONE
        volts: Array = self._level * self._plan.signs
        return volts

    @property
    def _target(self) -> float:
        return self._plan.check if self.reached < 0 else self._plan.levels[self.reached]

    def _ramp(self, target: float, most: float) -> None:
        distance = target - self._level
        self._level = target if abs(distance) <= most else self._level + math.copysign(
            most, distance
        )  # fmt: skip

    def _begin_again(self, now: float) -> None:
        """Begin the level again after something that may have disturbed it.

        Raises:
            ExperimentError: It was too often.
        """
        self._again += 1
        self._off_again = self._off_again + 1 if self._off_volts else 0
        if self._off_again > MOST_OFF_AGAIN:
            raise ExperimentError(
                f"{self._trouble}, again and again: is its output off, is the motor dead, or does "
                "it take commands from elsewhere?"
            )
        if self._again > MOST_AGAIN:
            raise ExperimentError(
                f"{self._trouble}; before that, {MOST_AGAIN} levels were begun again: this "
                "machine or the way to the drive is too slow"
            )
        self._trouble = self._off_volts = ""
        self._begin(Phase.RAMP, now)
        self._follow_until = now + FOLLOW

    def _follow(self) -> None:
        """Give what the wheels' back-EMF is."""
        speed = float(np.median(self._speed * self._plan.signs))
        if math.isfinite(speed):
            top = max(map(abs, self._plan.levels))
            self._level = min(max(speed * self._back_emf, -top), top)

    def _begin(self, phase: Phase, now: float) -> None:
        self.phase, self._since, self._looked = phase, now, now
        self._speeds, self._positions, self._samples = [], [], []

    @property
    def begun_again(self) -> int:
        """How often a level was begun again, because something was held up."""
        return self._again

    def _watch(self, now: float) -> None:
        """Raise where something is wrong with feedback or wheels."""
        for name, heard in (
            ("wheel_states", self._wheels_at), ("wheel_electrical", self._electrical_at)
        ):  # fmt: skip
            if now - heard > self._plan.silence:
                raise ExperimentError(f"no {name} for {now - heard:.2f} s")
        if not np.isfinite(self._speed).all():
            return
        k = int(np.abs(self._speed).argmax())
        if abs(self._speed[k]) > self._max_speed:
            raise ExperimentError(
                f"wheel '{self._names[k]}' turns at {self._speed[k]:.2f} rad/s, above "
                f"motor.max_speed = {self._max_speed:g} rad/s"
            )
        if len(self._recent) == RECENT:
            currents = np.abs(np.median(self._recent, axis=0))
            k = int((currents - self._strain).argmax())
            if currents[k] > self._strain[k]:
                raise ExperimentError(
                    f"wheel '{self._names[k]}' draws {currents[k]:.2f} A at {self._level:.2f} V, "
                    f"above {self._strain[k]:.2f} A: does it touch the floor, or is it blocked?"
                )
        settled = self.phase is Phase.MEASURE or (
            self.phase is Phase.SETTLE and now - self._since > HELD_AFTER
        )
        # Lower voltages may leave a wheel to its stiction.
        if self._trouble or not settled or abs(self._level) < self._plan.check - 1e-9:
            return
        free = abs(self._level) / self._back_emf
        speeds = self._speed * self._plan.signs * math.copysign(1.0, self._level)
        k = int(speeds.argmin())
        if speeds[k] < TURNING * free:
            volts = self._level * self._plan.signs[k]
            raise ExperimentError(
                f"wheel '{self._names[k]}' turns at {self._speed[k]:.2f} rad/s at {volts:.2f} V "
                f"and {self._current[k]:.2f} A, without load it should at about "
                f"{volts / self._back_emf:.1f} rad/s: does it touch the floor, is it blocked, or "
                "is its motor off?"
            )

    def _settle(self, now: float) -> None:
        """Wait until the speeds are constant, or it takes too long."""
        late = now - self._since > self._plan.settle
        if now - self._looked < LOOK and not late:
            return
        self._looked = now
        while len(self._speeds) > 1 and self._speeds[1][0] < self._stamp - WINDOW:
            self._speeds.pop(0)
        whole = bool(self._speeds) and self._stamp - self._speeds[0][0] >= WINDOW
        if late or (whole and self._constant().all()):
            self._begin(Phase.MEASURE, now)

    def _constant(self) -> NDArray[np.bool_]:
        """Which wheels' speeds have no slope that matters, as far as their noise tells (n,)."""
        if len(self._speeds) < LEAST_SAMPLES:
            return np.zeros(len(self._names), dtype=bool)
        slope, error = _line([row[0] for row in self._speeds], [row[1] for row in self._speeds])
        friction = self._gain * np.abs(self._reference)
        limit = np.maximum(INERTIA_SHARE * friction / self._inertia, self._slope_floor)
        constant: NDArray[np.bool_] = np.abs(slope) <= limit + 2.0 * error
        return constant

    def _measure(self, now: float) -> None:
        """Measure until it is precise enough, or it takes too long."""
        elapsed = now - self._since
        if now - self._looked < LOOK or elapsed < self._plan.shortest:
            return
        self._looked = now
        enough = min(len(self._samples), len(self._positions)) >= LEAST_SAMPLES
        if not enough and elapsed < self._plan.longest:
            return
        if not enough:
            raise ExperimentError(
                f"{len(self._samples)} wheel_electrical and {len(self._positions)} wheel_states "
                f"in {elapsed:.1f} s: too few"
            )
        run = self._run()
        if self.reached < 0:
            self._reference = run.current
        wanted = np.maximum(
            self._plan.precision * np.abs(self._reference), NOISE_FLOOR * self._max_current
        )
        first = self.reached < 0  # no more than a look
        if not first and (run.error > wanted).any() and elapsed < self._plan.longest:
            return
        if not first:
            self.runs.append(run)
        self._off_again = 0
        self.reached += 1
        self._begin(Phase.RAMP if self.reached < len(self._plan.levels) else Phase.END, now)
        self._moved = now

    def _run(self) -> SteadyRun:
        """Means of what was measured.

        Raises:
            ExperimentError: Positions and velocities do not agree.
        """
        current, error, spikes = robust_mean(np.array([row[1] for row in self._samples]))
        voltage = np.median([row[0] for row in self._samples], axis=0)
        speed, _ = _line([row[0] for row in self._positions], [row[1] for row in self._positions])
        told = np.mean([row[1] for row in self._speeds], axis=0)
        off = np.abs(told - speed) - 0.05 * np.abs(speed) - 0.2
        if off.max() > 0.0:
            k = int(off.argmax())
            raise ExperimentError(
                f"wheel_states disagree with themselves: wheel '{self._names[k]}' turns at "
                f"{speed[k]:.2f} rad/s by its positions and {told[k]:.2f} rad/s by its velocities"
            )
        return SteadyRun(
            voltage, current, speed, error, self._constant(), len(self._samples), spikes
        )


def _line(times: list[float], values: list[Array]) -> tuple[Array, Array]:
    """Slopes (n,) of the columns of (k, n) values over times (k,), and their standard errors."""
    at = np.array(times) - times[0]
    at = at - at.mean()
    table = np.array(values)
    table = table - table.mean(axis=0)
    spread = float(at @ at)
    slope = at @ table / spread
    rest = table - np.outer(at, slope)
    error = np.sqrt((rest * rest).sum(axis=0) / max(len(at) - 2, 1) / spread)
    return slope, error
