"""The voltages of the friction experiment: levels, signs of the wheels, ramps and durations.

MPC 2021, below (24): with the wheels off the floor, each motor gets a constant voltage until the
speed is constant; then the current is measured. This is repeated for several voltages of both
signs.

The wheels rotate against one another: their signs are chosen so that the forces that the wheels
would exert on the floor cancel. A robot that was not lifted strains instead of driving away.
"""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.platform import Platform
from omniman_ros.identification.friction.friction_fit import MIN_SPEED

TOP_FRACTION = 0.95  #: Fraction of the motor's largest voltage and speed that the experiment uses
CHECK_SPEED_FRACTION = 0.25  #: Speed at the first, low voltage over the largest speed
MAX_SIGN_SEARCH_WHEELS = 12  #: Number of wheels up to which all combinations of signs are tried


@dataclass(frozen=True, eq=False)
class VoltagePlan:
    """The voltages of an experiment, and its durations of waiting and measuring."""

    levels: tuple[float, ...]  #: Voltages in the order in which they are applied, signed [V]
    check_level: float  #: Low voltage with which the experiment begins [V]
    signs: Array  #: (n,) +1 or -1, ratio of each wheel's voltage to the level
    ramp_rate: float  #: Rate of the voltages during the experiment [V/s]
    stop_ramp_rate: float  #: Rate of the voltages when the experiment ends early [V/s]
    settle_timeout: float = 6.0  #: Longest time until the speeds must be constant [s]
    min_measurement: float = 1.5  #: Shortest duration of a measurement [s]
    max_measurement: float = 20.0  #: Longest duration of a measurement [s]
    precision: float = 0.005  #: Relative standard error at which a measurement ends
    feedback_timeout: float = 0.3  #: Time without feedback after which the experiment ends [s]

    @property
    def top_level(self) -> float:
        """Largest magnitude of a level [V]."""
        return max(map(abs, self.levels))

    @property
    def longest_time(self) -> float:
        """Upper bound of the duration of the whole experiment [s]."""
        runs = len(self.levels) + 1
        ramps = 2.0 * self.top_level / self.ramp_rate
        return runs * (self.settle_timeout + self.max_measurement + ramps)


def balanced_signs(robot: Platform) -> Array:
    """Choose signs of equal wheel torques with the smallest force on a robot on the floor.

    Among the signs with the smallest force, those with the smallest moment are chosen. Wheel
    torques t result in the wrench J' t on the platform (power balance, CCTA 2017 (19)). With four
    equal Mecanum wheels they are those of the motion constraint, and the wrench is zero.

    Returns:
        (n,) signs +1 or -1, read-only.
    """
    jacobian = PlatformKinematics(robot.wheels).J
    n = min(robot.wheel_count, MAX_SIGN_SEARCH_WHEELS)

    codes = np.arange(2 ** (n - 1))[:, None]
    candidates = np.column_stack(
        [np.ones(len(codes)), 1.0 - 2.0 * (codes >> np.arange(n - 1) & 1)]
    )
    x, y, moment = np.round(candidates @ jacobian[:n], 6).T
    signs = np.ones(robot.wheel_count)
    signs[:n] = candidates[np.lexsort((np.abs(moment), np.round(np.hypot(x, y), 6)))[0]]
    signs.setflags(write=False)
    return signs


def make_plan(
    robot: Platform,
    levels: int = 6,
    rounds: int = 2,
    precision: float = 0.005,
    feedback_timeout: float = 0.3,
) -> VoltagePlan:
    """Plan the experiment for a robot.

    Each round goes from the highest voltage down to the lowest, so that the wheels already rotate
    at the voltages at which stiction might hold them; then it repeats this in the other direction.
    The speeds are denser at both ends (Chebyshev points), which determines a better than even
    spacing.

    Args:
        levels: Number of voltages in each direction, at least 3.
        rounds: Number of times that each voltage is applied.

    Raises:
        InputError: An argument is out of its range, or the robot is too slow to be measured.
    """
    if levels < 3 or rounds < 1:
        raise InputError(
            f"{levels} levels in {rounds} rounds: at least 3 levels in 1 round are needed"
        )
    if not 1e-4 <= precision <= 0.2:
        raise InputError(f"precision {precision:g} is not within 0.0001 to 0.2")
    if not feedback_timeout > 0.0:
        raise InputError(f"feedback timeout {feedback_timeout:g} s must be above 0")
    motor = robot.motor
    back_emf = motor.gear_ratio * motor.torque_constant
    highest = TOP_FRACTION * min(motor.max_voltage, motor.max_speed * back_emf)
    gain = motor.gear_efficiency * back_emf

    def friction_voltage(speed: float) -> float:
        """Return the voltage [V] that the configured friction requires at a speed [rad/s]."""
        friction = max(
            a * speed + b
            for a, b in zip(robot.friction.viscous, robot.friction.coulomb, strict=True)
        )
        return motor.resistance * friction / gain

    def voltage(speed: float) -> float:
        return min(back_emf * speed + friction_voltage(speed), highest)

    top = (highest - friction_voltage(highest / back_emf)) / back_emf
    low = max(0.1 * top, 1.3 * MIN_SPEED)
    if top < 3.0 * low:
        raise InputError(
            f"wheels of up to {top:.3g} rad/s are too slow: {3.0 * low:.3g} rad/s are needed"
        )
    middle, half = 0.5 * (top + low), 0.5 * (top - low)
    speeds = [middle + half * math.cos(math.pi * k / (levels - 1)) for k in range(levels)]
    down = [highest, *(voltage(speed) for speed in speeds[1:])]
    return VoltagePlan(
        levels=tuple((down + [-level for level in down]) * rounds),
        check_level=voltage(CHECK_SPEED_FRACTION * top),
        signs=balanced_signs(robot),
        ramp_rate=highest / 1.5,
        stop_ramp_rate=highest / 0.7,
        precision=precision,
        feedback_timeout=feedback_timeout,
    )
