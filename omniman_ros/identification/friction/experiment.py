"""The friction experiment as a pure state machine: it selects voltages and times of measurement.

Source: MPC 2021, below (24). The caller passes times and feedback to it, and applies its voltages.
"""

import enum
import math

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Platform
from omniman_ros.identification.friction.feedback_monitor import MAX_PAUSE, FeedbackMonitor
from omniman_ros.identification.friction.friction_fit import SteadyRun
from omniman_ros.identification.friction.level_samples import ExperimentError, LevelSamples
from omniman_ros.identification.friction.voltage_plan import VoltagePlan

TURNING_CHECK_DELAY = 1.0  #: Time after a ramp from which all wheels must rotate [s]
VOLTAGE_CHECK_DELAY = 0.2  #: Time after a ramp from which voltages must be as commanded [s]
CHECK_PERIOD = 0.2  #: Time between two checks whether a speed is constant or a mean is precise [s]
NOISE_FLOOR = 2e-4  #: Standard error that is always precise enough, over the largest current
FOLLOW_TIME = 0.1  #: Time after a restart in which the voltages follow the speeds [s]
MAX_RESTARTS = 12  #: Total number of times that levels may be restarted
MAX_VOLTAGE_RESTARTS = 3  #: Times in a row that voltages may restart a level
REST_TIME = 0.2  #: Time at zero voltage after which wheels without speed count as resting [s]
REST_TIMEOUT = 3.0  #: Time at zero voltage after which the experiment ends anyway [s]


class ExperimentPhase(enum.Enum):
    """Phase of the experiment; the value is shown to the user."""

    RAMP = "ramp"
    SETTLE = "wait"
    MEASURE = "measure"
    END = "slow down"
    DONE = "done"


class FrictionExperiment:
    """Applies the voltages of a plan to the wheels, and collects the steady runs."""

    def __init__(self, robot: Platform, plan: VoltagePlan, now: float) -> None:
        self._plan = plan
        self._back_emf = robot.motor.gear_ratio * robot.motor.torque_constant
        self._current_floor = NOISE_FLOOR * robot.motor.max_current
        self._monitor = FeedbackMonitor(robot, plan, now)
        self._samples = LevelSamples(robot, plan)
        self._level = 0.0
        self._now = self._phase_start = self._last_check = self._last_motion = now
        self._follow_until = now
        self._ends_early = False
        self._disturbance = ""
        self._has_wrong_voltage = False
        self._voltage_restarts = 0
        self.restarts = 0  #: Number of times that a level was restarted because of a disturbance
        self.runs: list[SteadyRun] = []  #: Steady runs that were measured so far
        self.phase = ExperimentPhase.RAMP  #: Current phase
        self.level_index = -1  #: Index of the current level, -1 for the first, low voltage

    def on_wheels(self, stamp: float, position: Array, velocity: Array, now: float) -> None:
        """Process a state of the wheels, see :meth:`FeedbackMonitor.on_wheels`.

        Args:
            position: (n,) positions, not wrapped [rad].
            velocity: (n,) speeds [rad/s].
        """
        pause = self._monitor.on_wheels(stamp, position, velocity, now)
        if pause > MAX_PAUSE:
            self._disturbance = f"no wheel_states for {pause:.2f} s"
        if self.phase in (ExperimentPhase.SETTLE, ExperimentPhase.MEASURE):
            self._samples.add_speed(stamp, velocity)
        if self.phase is ExperimentPhase.MEASURE:
            self._samples.add_position(stamp, position)

    def on_electrical(self, voltage: Array, current: Array, now: float) -> None:
        """Process voltages and currents, see :meth:`FeedbackMonitor.on_electrical`."""
        self._monitor.on_electrical(voltage, current, now)
        if self.phase is ExperimentPhase.MEASURE:
            self._samples.add_electrical(voltage, current)
        if self._is_constant_for(VOLTAGE_CHECK_DELAY, now):
            deviation = self._monitor.voltage_deviation(voltage, self._level)
            if deviation:
                self._disturbance, self._has_wrong_voltage = deviation, True

    def _is_constant_for(self, delay: float, now: float) -> bool:
        """Return whether the voltage is constant, and was for a time [s] or until measuring."""
        return self.phase is ExperimentPhase.MEASURE or (
            self.phase is ExperimentPhase.SETTLE and now - self._phase_start > delay
        )

    @property
    def is_at_rest(self) -> bool:
        """Whether no wheel rotates, according to the latest state."""
        return self._monitor.is_at_rest

    @property
    def fraction(self) -> float:
        """Fraction of the experiment that is done, from 0 to 1."""
        return (self.level_index + 1) / (len(self._plan.levels) + 1)

    def end(self, now: float, at_once: bool = False) -> None:
        """End the experiment early, without a ramp if `at_once`; complete runs are kept."""
        if self.phase in (ExperimentPhase.END, ExperimentPhase.DONE):
            return
        self._begin(ExperimentPhase.END, now)
        self._ends_early, self._last_motion = True, now
        if at_once:
            self._level = 0.0

    def voltages(self, now: float) -> Array:
        """Return the voltages (n,) [V] to apply now; call this every 20 ms or more often.

        Raises:
            ExperimentError: The experiment cannot continue. Then call :meth:`end`, and continue to
                apply these voltages until `phase` is DONE.
        """
        step, self._now = max(now - self._now, 0.0), now
        if self.phase not in (ExperimentPhase.END, ExperimentPhase.DONE):
            self._supervise(now, step)
        if self.phase is ExperimentPhase.RAMP:
            self._ramp_to_level(now, step)
        elif self.phase is ExperimentPhase.SETTLE:
            self._settle(now)
        elif self.phase is ExperimentPhase.MEASURE:
            self._measure(now)
        elif self.phase is ExperimentPhase.END:
            self._ramp_to_rest(now, step)
        voltages: Array = self._level * self._plan.signs
        return voltages

    @property
    def _is_check(self) -> bool:
        return self.level_index < 0

    def _begin(self, phase: ExperimentPhase, now: float) -> None:
        self.phase, self._phase_start, self._last_check = phase, now, now
        self._samples.clear()

    def _supervise(self, now: float, step: float) -> None:
        if step > MAX_PAUSE:
            self._disturbance = f"no voltages were commanded for {step:.2f} s"
        self._monitor.check(self._level, now)
        if self._disturbance:
            self._restart_level(now)
        elif self._is_constant_for(TURNING_CHECK_DELAY, now):
            self._monitor.check_turning(self._level)

    def _restart_level(self, now: float) -> None:
        self.restarts += 1
        self._voltage_restarts = self._voltage_restarts + 1 if self._has_wrong_voltage else 0
        if self._voltage_restarts > MAX_VOLTAGE_RESTARTS:
            raise ExperimentError(
                f"{self._disturbance}, repeatedly: is its output off, is the motor dead, or "
                "does it receive commands from elsewhere?"
            )
        if self.restarts > MAX_RESTARTS:
            raise ExperimentError(
                f"{self._disturbance}; before that, {MAX_RESTARTS} levels were restarted: this "
                "machine or the connection to the drive is too slow"
            )
        self._disturbance, self._has_wrong_voltage = "", False
        self._begin(ExperimentPhase.RAMP, now)
        self._follow_until = now + FOLLOW_TIME

    def _ramp_to_level(self, now: float, step: float) -> None:
        """Ramp to the current level; after a restart, begin at the wheels' back-EMF."""
        if now < self._follow_until:
            self._follow_speed()
            return
        target = self._plan.check_level if self._is_check else self._plan.levels[self.level_index]
        self._ramp(target, self._plan.ramp_rate * step)
        if self._level == target:
            self._begin(ExperimentPhase.SETTLE, now)

    def _follow_speed(self) -> None:
        speed = float(np.median(self._monitor.speed * self._plan.signs))
        if math.isfinite(speed):
            top = self._plan.top_level
            self._level = min(max(speed * self._back_emf, -top), top)

    def _ramp_to_rest(self, now: float, step: float) -> None:
        rate = self._plan.stop_ramp_rate if self._ends_early else self._plan.ramp_rate
        self._ramp(0.0, rate * step)
        if self._level != 0.0:
            self._last_motion = now
        elapsed = now - self._last_motion
        is_settled = self.is_at_rest and elapsed > REST_TIME
        if self._level == 0.0 and (is_settled or elapsed > REST_TIMEOUT):
            self.phase = ExperimentPhase.DONE

    def _ramp(self, target: float, max_change: float) -> None:
        distance = target - self._level
        if abs(distance) <= max_change:
            self._level = target
        else:
            self._level += math.copysign(max_change, distance)

    def _settle(self, now: float) -> None:
        is_late = now - self._phase_start > self._plan.settle_timeout
        if now - self._last_check < CHECK_PERIOD and not is_late:
            return
        self._last_check = now
        if self._samples.are_steady(self._monitor.stamp) or is_late:
            self._begin(ExperimentPhase.MEASURE, now)

    def _measure(self, now: float) -> None:
        """Measure until the mean is precise enough, or the time is up."""
        elapsed = now - self._phase_start
        if now - self._last_check < CHECK_PERIOD or elapsed < self._plan.min_measurement:
            return
        self._last_check = now
        is_late = elapsed >= self._plan.max_measurement
        samples = self._samples
        if not samples.are_enough:
            if is_late:
                raise ExperimentError(
                    f"{samples.electrical_count} wheel_electrical and {samples.position_count} "
                    f"wheel_states in {elapsed:.1f} s: too few"
                )
            return
        run = samples.average()
        if (
            self._is_check
        ):  # this level only shows whether the wheels rotate: any precision will do
            samples.reference_current = run.current
        elif is_late or self._is_precise(run):
            self.runs.append(run)
        else:
            return
        self._begin_next_level(now)

    def _is_precise(self, run: SteadyRun) -> bool:
        reference = np.abs(self._samples.reference_current)
        limit = np.maximum(self._plan.precision * reference, self._current_floor)
        return bool((run.error <= limit).all())

    def _begin_next_level(self, now: float) -> None:
        self._voltage_restarts = 0
        self.level_index += 1
        is_last = self.level_index >= len(self._plan.levels)
        self._begin(ExperimentPhase.END if is_last else ExperimentPhase.RAMP, now)
        self._last_motion = now
