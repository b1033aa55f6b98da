"""Stability of the sampled coupling loop with delayed commands, computed from a linear model.

The loop, wheels off the floor: the controller samples epsilon at each tick and commands the wheel
speeds -k epsilon through T+, CCTA 2017 (25) and (14); the drives hold a command until the next one
and follow it by their velocity loops. As T T+ = I and equal wheels do not act on each other
there, the dynamics of epsilon are those of the angle of one wheel whose reference is -k times this
angle.

The model has what delays the loop: sampling, the time from a measurement to the command, the
delay, the motor with its inductance, the proportional-integral velocity loop with its period, and
the window over which the drive measures the velocity. Friction other than viscous, limits and the
resolution of the encoder are left out. One period of the controller is a linear map of the state;
the loop oscillates if an eigenvalue of the map lies outside of the unit circle.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.core.robot import Robot
from omniman_ros.lab.studies.closed_loop import LATENCY, PERIOD
from omniman_ros.simulation.plant.parameters import SimulationParameters

REFINEMENT = 20
"""Number of parts into which a period of the drives' loops is divided to integrate the motor."""
LOWEST_GAIN = 0.1
"""Lowest gain that is examined [1/s]."""
HIGHEST_GAIN = 4000.0
"""Highest gain that is examined [1/s]."""
GAIN_RATIO = 1.05
"""Ratio of two neighbouring gains between which the boundary is searched [-]."""
LONGEST_DELAY = 2.0
"""Longest delay that is examined [s]."""


class CouplingLoop:
    """Linear model of the coupling loop of a robot whose wheels are off the floor.

    Args:
        robot: Parameters of the robot and its drives, full names to values; all wheels have the
            values of the first.
    """

    def __init__(self, robot: Mapping[str, Any]) -> None:
        body = build(Robot, robot)
        simulation = build(SimulationParameters, robot)
        motor, firmware = body.motor, simulation.firmware
        self._step = simulation.plant.substep
        self._back_emf = back_emf = motor.torque_constant * motor.gear_ratio
        torque_constant = motor.gear_efficiency * back_emf
        inertia = body.wheels.inertia[0]
        mass = (body.body.mass + body.arm.mass) / body.wheel_count
        loaded = inertia + mass * body.wheels.radius[0] ** 2
        # The torque's share of the voltage: R / (eta K N) times the gain of the velocity loop.
        self._proportional = firmware.velocity_bandwidth * loaded
        self._damping = torque_constant * back_emf / motor.resistance
        self._volts = motor.resistance / torque_constant
        self._integral_time = firmware.integral_time
        self._window = max(round(firmware.observer_window / self._step), 1)
        inductance = max(motor.inductance, 1e-6)  # without any, the current follows at once
        rates = np.zeros((4, 4))  # of angle, speed and current; the voltage is held
        rates[0, 1] = 1.0
        rates[1, 1:3] = -body.friction.viscous[0] / inertia, torque_constant / inertia
        rates[2, 1:] = -back_emf / inductance, -motor.resistance / inductance, 1.0 / inductance
        half, identity = 0.5 * self._step / REFINEMENT * rates, np.eye(4)
        part = np.linalg.solve(identity - half, identity + half)
        self._motor: Array = np.linalg.matrix_power(part, REFINEMENT)[:3]

    def period_map(self, gain: float, delay: float) -> Array:
        """Return the map (s, s) of the state over one period of the controller.

        The state is angle, speed, current and integral of the velocity loop, past angles within
        the window of the velocity, and commands on their way.

        Args:
            gain: k_epsilon [1/s].
            delay: Additional delay of the commands, rounded to the drives' period [s].
        """
        steps = round(PERIOD / self._step)
        waiting, late = divmod(round((LATENCY + delay) / self._step), steps)
        size = 4 + self._window + waiting + 1
        state = list(np.eye(size))  # each component as a linear function of the initial state
        angle, speed, current, integral = state[:4]
        past, commands = state[4 : 4 + self._window], state[4 + self._window :]
        commands = [-gain * angle, *commands]
        for step in range(steps):
            reference = commands[waiting + 1] if step < late else commands[waiting]
            measured = (angle - past[-1]) / (self._window * self._step)
            error = reference - measured
            torque = self._proportional * error + integral
            voltage = self._back_emf * reference + self._volts * torque
            share = self._step / self._integral_time
            integral = integral + (self._proportional + self._damping) * share * error
            past = [angle, *past[:-1]]
            angle, speed, current = self._motor @ np.vstack([angle, speed, current, voltage])
        return np.vstack([angle, speed, current, integral, *past, *commands[: waiting + 1]])

    def growth(self, gain: float, delay: float) -> float:
        """Return the factor by which the slowest or least stable mode grows in a period [-].

        Args:
            gain: k_epsilon [1/s].
            delay: Additional delay of the commands [s].
        """
        return float(np.abs(np.linalg.eigvals(self.period_map(gain, delay))).max())

    def critical_gain(self, delay: float) -> float:
        """Return the lowest gain at which the loop oscillates; inf if there is none [1/s].

        Args:
            delay: Additional delay of the commands [s].
        """
        high = LOWEST_GAIN
        while self.growth(high, delay) < 1.0:
            high *= GAIN_RATIO
            if high > HIGHEST_GAIN:
                return math.inf
        low = high / GAIN_RATIO
        for _ in range(20):
            middle = math.sqrt(low * high)
            low, high = (middle, high) if self.growth(middle, delay) < 1.0 else (low, middle)
        return high

    def delay_margin(self, gain: float) -> float:
        """Return the longest delay of the commands with which the loop does not oscillate [s].

        It is a multiple of the period of the drives' loops, and at most `LONGEST_DELAY`.

        Args:
            gain: k_epsilon [1/s].

        Returns:
            The delay; NaN if the loop oscillates without any.
        """
        low, high = -1, round(LONGEST_DELAY / self._step) + 1
        while high - low > 1:
            middle = (low + high) // 2
            stable = self.growth(gain, middle * self._step) < 1.0
            low, high = (middle, high) if stable else (low, middle)
        return low * self._step if low >= 0 else math.nan
