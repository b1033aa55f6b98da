"""Validation of the feedback of the drives, and detection of wheels that do not rotate freely.

A robot that was not lifted, a blocked wheel and a dead motor are detected from speeds and currents
already at the first, low voltage.
"""

import math
from collections import deque

import numpy as np

from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.platform import Platform
from omniman_ros.identification.friction.level_samples import ExperimentError
from omniman_ros.identification.friction.voltage_plan import VoltagePlan

MIN_FREE_SPEED_FRACTION = 0.3  #: Ratio to the free speed below which a wheel is obstructed
STRAIN_FACTOR = 5.0  #: Ratio to the configured friction's current from which a wheel is strained
MIN_STRAIN_FRACTION = 0.15  #: Least current of a strained wheel over the largest current
MEDIAN_LENGTH = 9  #: Number of currents whose median is checked for strain: spikes do not count
MAX_PAUSE = 0.08  #: Pause from which a level is restarted [s]: drives may have ramped down
VOLTAGE_TOLERANCE_FRACTION = 0.3  #: Accepted deviation of a voltage, over its command
VOLTAGE_TOLERANCE = 0.5  #: Deviation of a voltage that is accepted in addition [V]
AT_REST_SPEED = 0.05  #: Speed below which a wheel counts as being at rest [rad/s]


class FeedbackMonitor:
    """Holds the latest feedback of the drives and checks it.

    Feedback of a wrong size, or that is not finite or not newer, raises an InputError; a check
    that fails raises an ExperimentError.
    """

    def __init__(self, robot: Platform, plan: VoltagePlan, now: float) -> None:
        motor, n = robot.motor, robot.wheel_count
        self._plan = plan
        self._names = robot.wheels.names
        self._back_emf = motor.gear_ratio * motor.torque_constant
        self._max_speed = motor.max_speed
        self._strain_limit = self._strain_limits(robot)
        self._recent_currents: deque[Array] = deque(maxlen=MEDIAN_LENGTH)
        self._received_at = {"wheel_states": now, "wheel_electrical": now}
        self.stamp = -math.inf  #: Time of the latest state, on the robot's clock [s]
        self.speed = np.full(n, math.inf)  #: (n,) latest speeds [rad/s]; infinite without a state
        self.current = np.zeros(n)  #: (n,) latest motor currents [A]

    def _strain_limits(self, robot: Platform) -> Array:
        """Return the currents (n,) [A] above which wheels do not rotate freely, ramps included."""
        friction, motor = robot.friction, robot.motor
        gain = motor.gear_efficiency * self._back_emf
        top_speed = self._plan.top_level / self._back_emf
        free = (np.array(friction.viscous) * top_speed + friction.coulomb) / gain
        acceleration = self._plan.stop_ramp_rate / self._back_emf
        ramp = np.array(robot.wheels.inertia) * acceleration / gain
        strain = np.maximum(STRAIN_FACTOR * free, MIN_STRAIN_FRACTION * motor.max_current)
        limit: Array = strain + 2.0 * ramp
        return limit

    def on_wheels(self, stamp: float, position: Array, velocity: Array, now: float) -> float:
        """Process a state of the wheels.

        Args:
            stamp: Time at which it was measured, on the robot's clock [s].
            position: (n,) positions, not wrapped [rad].
            velocity: (n,) speeds [rad/s].

        Returns:
            The time between this state and the one before, 0 for the first [s].
        """
        n = len(self._names)
        for label, values, bound in (
            ("positions", position, plausible.WHEEL_ANGLE),
            ("velocities", velocity, plausible.WHEEL_SPEED),
        ):
            if values.shape != (n,):
                raise InputError(f"wheel_states: {values.size} {label}, the robot has {n} wheels")
            plausible.demand(values, bound, f"wheel_states: {label}")
        if not (math.isfinite(stamp) and stamp > self.stamp):
            raise InputError(f"wheel_states: stamp {stamp:.6f} s is not after {self.stamp:.6f} s")
        pause = stamp - self.stamp if math.isfinite(self.stamp) else 0.0
        self.stamp, self.speed = stamp, velocity
        self._received_at["wheel_states"] = now
        return pause

    def on_electrical(self, voltage: Array, current: Array, now: float) -> None:
        """Process voltages (n,) [V] and currents (n,) [A] of the motors."""
        n = len(self._names)
        for label, values in (("voltages", voltage), ("currents", current)):
            if values.shape != (n,):
                raise InputError(
                    f"wheel_electrical: {values.size} {label}, the robot has {n} wheels"
                )
            plausible.demand(values, plausible.EFFORT, f"wheel_electrical: {label}")
        self.current = current
        self._received_at["wheel_electrical"] = now
        self._recent_currents.append(current)

    @property
    def is_at_rest(self) -> bool:
        """Whether no wheel rotates, according to the latest state."""
        return bool(np.abs(self.speed).max() < AT_REST_SPEED)

    def voltage_deviation(self, voltage: Array, level: float) -> str:
        """Describe a voltage, of (n,) [V], that is not as commanded [V]; empty if all are correct.

        Drives may ramp down by themselves if commands do not reach them in time. The voltages show
        that, the states do not.
        """
        commanded = level * self._plan.signs
        tolerance = VOLTAGE_TOLERANCE_FRACTION * np.abs(commanded) + VOLTAGE_TOLERANCE
        excess = np.abs(voltage - commanded) - tolerance
        k = int(excess.argmax())
        if excess[k] <= 0.0:
            return ""
        return (
            f"the drive of '{self._names[k]}' gives {voltage[k]:.2f} V where {commanded[k]:.2f} V "
            "are commanded"
        )

    def check(self, level: float, now: float) -> None:
        """Check that feedback arrives, and that no wheel is too fast or strained.

        Args:
            level: Commanded level [V].
        """
        for topic, received_at in self._received_at.items():
            if now - received_at > self._plan.feedback_timeout:
                raise ExperimentError(f"no {topic} for {now - received_at:.2f} s")
        if not np.isfinite(self.speed).all():
            return
        k = int(np.abs(self.speed).argmax())
        if abs(self.speed[k]) > self._max_speed:
            raise ExperimentError(
                f"wheel '{self._names[k]}' turns at {self.speed[k]:.2f} rad/s, above "
                f"motor.max_speed = {self._max_speed:g} rad/s"
            )
        if len(self._recent_currents) == MEDIAN_LENGTH:
            currents = np.abs(np.median(self._recent_currents, axis=0))
            k = int((currents - self._strain_limit).argmax())
            if currents[k] > self._strain_limit[k]:
                raise ExperimentError(
                    f"wheel '{self._names[k]}' draws {currents[k]:.2f} A at {level:.2f} V, above "
                    f"{self._strain_limit[k]:.2f} A: does it touch the floor, or is it blocked?"
                )

    def check_turning(self, level: float) -> None:
        """Check that all wheels rotate as fast as a constant voltage demands.

        Voltages below the check level are not judged: stiction may hold a wheel there.

        Args:
            level: Commanded level [V].
        """
        if not np.isfinite(self.speed).all() or abs(level) < self._plan.check_level - 1e-9:
            return
        free_speed = abs(level) / self._back_emf
        speeds = self.speed * self._plan.signs * math.copysign(1.0, level)
        k = int(speeds.argmin())
        if speeds[k] < MIN_FREE_SPEED_FRACTION * free_speed:
            voltage = level * self._plan.signs[k]
            raise ExperimentError(
                f"wheel '{self._names[k]}' turns at {self.speed[k]:.2f} rad/s at {voltage:.2f} V "
                f"and {self.current[k]:.2f} A, without load it should turn at about "
                f"{voltage / self._back_emf:.1f} rad/s: does it touch the floor, is it blocked, "
                "or is its motor off?"
            )
