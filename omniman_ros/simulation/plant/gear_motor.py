"""A wheel's gear motor: amplifier, winding, gear losses and shaft friction of one drive.

In a step of length h the wheel's speed goes from w0 to w1, and w_mid is the mean. The current is
constant over the step, i the mean of its values at both ends, so with

    voltage = R i + L di/dt + K N w_mid,      i the mean current, (i0 + i1) / 2

the electrical energy equals the losses and the work at the wheel exactly (MPC 2021 (21), (22);
CCTA 2017 (21), (22)). Gear: eta N K i while the motor drives the wheel, N K i / eta while it is
driven.
"""

from collections.abc import Sequence

from omniman_ros.core.platform import Platform
from omniman_ros.simulation.plant.parameters import SimulationParameters, flags, per_wheel


class GearMotor:
    """State and constants of one drive, and what its amplifier does in a step.

    Attributes:
        resistance, inductance: Resistance [ohm] and inductance [H] of the motor.
        back_emf: Constant K N, at the wheel [V s/rad] or [N m/A].
        efficiency: Efficiency of the gear, 0 to 1.
        gain: Ratio of the applied to the requested voltage.
        max_voltage, max_current: Limits of the amplifier [V], [A].
        viscous, coulomb: Viscous [N m s/rad] and Coulomb [N m] friction at the axle.
        breakaway: Ratio of the torque that moves a wheel at rest to `coulomb`.
        blocked, open_circuit: Whether the wheel is blocked, and the motor circuit open (faults).
        speed, angle: Wheel speed [rad/s] and angle [rad].
        last_angle: Angle one step before [rad].
        current, mean_current: Motor current at the end of the step, and its mean over it [A].
        voltage: Voltage at the motor's terminals [V], constant over the step.
        electrical, copper, gear, shaft: Energies since the start [J].
    """

    def __init__(self) -> None:
        self.resistance = self.back_emf = self.efficiency = self.gain = 1.0
        self.inductance = self.viscous = self.coulomb = 0.0
        self.max_voltage = self.max_current = self.breakaway = 1.0
        self.blocked = self.open_circuit = False
        self.speed = self.angle = self.last_angle = 0.0
        self.current = self.mean_current = self.voltage = 0.0
        self.electrical = self.copper = self.gear = self.shaft = 0.0
        self._source = self._slope = 0.0
        self._requested = self._lag = 0.0
        self._limited = 0

    @property
    def inductive(self) -> float:
        """Energy in the motor's inductance [J]."""
        return 0.5 * self.inductance * self.current * self.current

    def _begin_current(self, command: float, step: float) -> None:
        """Start a step of length `step` [s] with a voltage requested from the amplifier [V]."""
        if self.open_circuit:
            self.copper += self.inductive  # free-wheeling
            self.current = self.voltage = self._source = self._slope = 0.0
        else:
            self._requested = min(max(self.gain * command, -self.max_voltage), self.max_voltage)
            self._lag = 2.0 * self.inductance / step
            self._amplify(self.speed)

    def _amplify(self, mean: float) -> bool:
        """Set the voltage, and the mean current as source - slope * w_mid.

        A chopper, far faster than the step, lowers the voltage so far that the current at the end
        of the step keeps its limit, unless the back-EMF alone drives more.

        Returns:
            Whether the amplifier limits the current as before: above, below or not at all.
        """
        previous, lag = self._limited, self._lag
        impedance = self.resistance + lag
        # mean currents for which the current at the end is at its limits
        high = 0.5 * (self.max_current + self.current) if lag else self.max_current
        low = high - (1.0 if lag else 2.0) * self.max_current
        middle = self.back_emf * mean - lag * self.current
        limited = min(max(self._requested, middle + impedance * low), middle + impedance * high)
        voltage = self.voltage = min(max(limited, -self.max_voltage), self.max_voltage)
        if limited == self._requested or limited != voltage:
            self._limited = 0
            self._source = (voltage + lag * self.current) / impedance
            self._slope = self.back_emf / impedance
        else:
            self._limited = 1 if limited < self._requested else -1
            self._source, self._slope = (high if limited < self._requested else low), 0.0
        return self._limited == previous

    def _finish_current(self, step: float, travel: float) -> tuple[float, float]:
        """Close the step; return the energies drawn, and lost in the winding, in it [J]."""
        current = self.mean_current
        electrical = self.voltage * current * step
        copper = self.resistance * current * current * step
        self.electrical += electrical
        self.copper += copper
        lagging = self.inductance > 0.0 and not self.open_circuit
        self.current = 2.0 * current - self.current if lagging else current
        self.last_angle = self.angle
        self.angle += travel
        return electrical, copper


def configure_motors(
    motors: Sequence[GearMotor], robot: Platform, parameters: SimulationParameters
) -> None:
    """Set the constants of a robot's gear motors; their state stays as it is.

    Raises:
        ParameterError: An array has neither one value nor one per wheel, or a wheel is unknown;
            nothing is changed then.
    """
    plant, mismatch, faults = parameters.plant, parameters.mismatch, parameters.faults
    motor, friction, names = robot.motor, robot.friction, robot.wheels.names
    n = robot.wheel_count
    friction_scale = per_wheel("mismatch.friction", mismatch.friction, n)
    constant = per_wheel("mismatch.torque_constant", mismatch.torque_constant, n)
    gain = per_wheel("mismatch.amplifier_gain", mismatch.amplifier_gain, n)
    dead = flags("faults.dead_motor", faults.dead_motor, names)
    stuck = flags("faults.stuck_wheel", faults.stuck_wheel, names)
    # A current that settles within a quarter of a step is assumed to settle at once.
    settles = motor.inductance < 0.25 * plant.substep * motor.resistance
    for k, wheel in enumerate(motors):
        wheel.resistance = motor.resistance
        wheel.inductance = 0.0 if settles else motor.inductance
        wheel.back_emf = motor.torque_constant * motor.gear_ratio * constant[k]
        wheel.efficiency, wheel.gain = motor.gear_efficiency, gain[k]
        wheel.max_voltage, wheel.max_current = motor.max_voltage, motor.max_current
        wheel.viscous = friction.viscous[k] * friction_scale[k]
        wheel.coulomb = friction.coulomb[k] * friction_scale[k]
        wheel.breakaway = plant.breakaway
        wheel.blocked, wheel.open_circuit = stuck[k], dead[k]
