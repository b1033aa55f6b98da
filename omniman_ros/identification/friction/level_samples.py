"""The feedback that is recorded at one voltage, and the steady run that results from it."""

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import OmnimanError
from omniman_ros.core.platform import Platform
from omniman_ros.identification.friction.friction_fit import SteadyRun
from omniman_ros.identification.friction.robust_statistics import line_slopes, robust_mean
from omniman_ros.identification.friction.voltage_plan import VoltagePlan

INERTIA_FRACTION = 0.01  #: Ratio of inertia's to friction's torque below which a speed is constant
SPEED_DRIFT = 0.002  #: Relative change of the speed that always counts as constant [1/s]
WINDOW = 0.5  #: Duration over which the slope of the speed is estimated [s]
MIN_SAMPLES = 20  #: Smallest number of speeds in a window, and of currents in a mean
MAX_RELATIVE_MISMATCH = 0.05  #: Accepted difference of the speeds, over the speed
MAX_MISMATCH = 0.2  #: Difference of these speeds that is accepted in addition [rad/s]


class ExperimentError(OmnimanError):
    """The experiment cannot continue; the message gives the reason."""


class LevelSamples:
    """Collects the samples of one voltage level."""

    def __init__(self, robot: Platform, plan: VoltagePlan) -> None:
        motor = robot.motor
        back_emf = motor.gear_ratio * motor.torque_constant
        self._names = robot.wheels.names
        self._gain = motor.gear_efficiency * back_emf
        self._inertia = np.array(robot.wheels.inertia)
        self._slope_floor = SPEED_DRIFT * plan.top_level / back_emf
        self._speeds: list[tuple[float, Array]] = []
        self._positions: list[tuple[float, Array]] = []
        self._electrical: list[tuple[Array, Array]] = []
        #: (n,) currents at the first, low voltage [A]; zero until they are set
        self.reference_current = np.zeros(robot.wheel_count)

    def clear(self) -> None:
        """Discard all samples."""
        self._speeds, self._positions, self._electrical = [], [], []

    def add_speed(self, stamp: float, velocity: Array) -> None:
        """Add wheel speeds (n,) [rad/s] that were measured at a time [s]."""
        self._speeds.append((stamp, velocity))

    def add_position(self, stamp: float, position: Array) -> None:
        """Add wheel positions (n,) [rad] that were measured at a time [s]."""
        self._positions.append((stamp, position))

    def add_electrical(self, voltage: Array, current: Array) -> None:
        """Add motor voltages (n,) [V] and currents (n,) [A]."""
        self._electrical.append((voltage, current))

    @property
    def electrical_count(self) -> int:
        """Number of voltages and currents."""
        return len(self._electrical)

    @property
    def position_count(self) -> int:
        """Number of positions."""
        return len(self._positions)

    @property
    def are_enough(self) -> bool:
        """Whether there are enough samples for a mean."""
        return min(self.electrical_count, self.position_count) >= MIN_SAMPLES

    def are_steady(self, stamp: float) -> bool:
        """Return whether all speeds were constant within the window that ends at a time [s].

        Speeds from before the window are discarded.
        """
        while len(self._speeds) > 1 and self._speeds[1][0] < stamp - WINDOW:
            self._speeds.pop(0)
        is_full = bool(self._speeds) and stamp - self._speeds[0][0] >= WINDOW
        return is_full and bool(self.steady_wheels().all())

    def steady_wheels(self) -> NDArray[np.bool_]:
        """Return (n,) bool: wheels whose speed has no significant slope, given its noise."""
        if len(self._speeds) < MIN_SAMPLES:
            return np.zeros(len(self._names), dtype=bool)
        slope, error = line_slopes(
            [stamp for stamp, _ in self._speeds], [speed for _, speed in self._speeds]
        )
        friction = self._gain * np.abs(self.reference_current)
        limit = np.maximum(INERTIA_FRACTION * friction / self._inertia, self._slope_floor)
        steady: NDArray[np.bool_] = np.abs(slope) <= limit + 2.0 * error
        return steady

    def average(self) -> SteadyRun:
        """Average the samples; contradictory speeds raise an ExperimentError."""
        current, error, spikes = robust_mean(np.array([row for _, row in self._electrical]))
        voltage = np.median([row for row, _ in self._electrical], axis=0)
        speed, _ = line_slopes(
            [stamp for stamp, _ in self._positions], [row for _, row in self._positions]
        )
        reported = np.mean([row for _, row in self._speeds], axis=0)
        excess = np.abs(reported - speed) - MAX_RELATIVE_MISMATCH * np.abs(speed) - MAX_MISMATCH
        if excess.max() > 0.0:
            k = int(excess.argmax())
            raise ExperimentError(
                f"wheel_states disagree with themselves: wheel '{self._names[k]}' turns at "
                f"{speed[k]:.2f} rad/s by its positions and {reported[k]:.2f} rad/s by its "
                "velocities"
            )
        return SteadyRun(
            voltage, current, speed, error, self.steady_wheels(), self.electrical_count, spikes
        )
