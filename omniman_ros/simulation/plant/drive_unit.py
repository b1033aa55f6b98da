"""Drive unit of one wheel: modes, control loops, limits and watchdog, run at each substep."""

import enum
from dataclasses import dataclass

from omniman_ros.core.platform import Platform
from omniman_ros.simulation.plant.parameters import FirmwareParameters

BACK_EMF_TIME_CONSTANT = 0.01  #: Time constant of the velocity by the back-EMF [s]
MISMATCH_TIME = 0.1  #: Time for which it must differ from the encoder's for a fault [s]
VELOCITY_TOLERANCE_FRACTION = 0.25  #: Allowed difference over the velocity: motors differ
VOLTAGE_TOLERANCE_FRACTION = 0.1  #: Allowed difference over the no-load velocity
OPEN_CIRCUIT_FRACTION = 0.01  #: Ratio to the largest current below which a circuit is open
SATURATION_FRACTION = 0.98  #: Ratio to the largest current from which it is limited


class DriveUnitMode(enum.Enum):
    """Quantity that a drive unit controls."""

    VELOCITY = "velocity"
    TORQUE = "torque"
    VOLTAGE = "voltage"
    OFF = "off"


@dataclass(frozen=True)
class DriveSettings:
    """Nominal values that a drive unit knows of its motor from commissioning."""

    resistance: float  #: Resistance of the motor [ohm]
    inductance: float  #: Inductance of the motor [H]
    back_emf: float  #: Torque constant times gear ratio, K N, at the wheel [V s/rad] or [N m/A]
    efficiency: float  #: Efficiency of the gear
    max_voltage: float  #: Limit of the voltage [V]
    max_current: float  #: Limit of the current [A]
    inertia: float  #: Inertia of wheel and its fraction of the robot, at the wheel [kg m^2]
    step: float  #: Period of the loops [s]
    firmware: FirmwareParameters  #: Parameters of the loops

    @property
    def damping(self) -> float:
        """Decrease of the motor's torque per wheel speed at a fixed voltage [N m s/rad]."""
        return self.efficiency * self.back_emf * self.back_emf / self.resistance


def drive_settings(
    robot: Platform, firmware: FirmwareParameters, step: float
) -> tuple[DriveSettings, ...]:
    """Return the settings of a robot's drive units, one per wheel."""
    motor, wheels = robot.motor, robot.wheels
    mass = (robot.body.mass + robot.arm.mass) / robot.wheel_count
    return tuple(
        DriveSettings(
            resistance=motor.resistance,
            inductance=motor.inductance,
            back_emf=motor.torque_constant * motor.gear_ratio,
            efficiency=motor.gear_efficiency,
            max_voltage=motor.max_voltage,
            max_current=motor.max_current,
            inertia=inertia + mass * radius * radius,
            step=step,
            firmware=firmware,
        )
        for inertia, radius in zip(wheels.inertia, wheels.radius, strict=True)
    )


class DriveUnit:
    """Drive unit of one wheel: control loops, limits and fault detection.

    Velocity mode: a proportional-integral loop on the measured velocity gives a torque, to which
    the feed-forward torque is added; voltage = K N reference + R current(torque). The motor's own
    back-EMF acts on the true speed and so damps the loop without the encoder's lag; the integral
    gain includes this damping. The integral is held while voltage or current are at their limits.
    At a reference of zero it decays: the motor brakes like a short-circuited one, friction holds,
    and a wheel at rest draws no current.

    When the mode is entered, and after a stop, the reference starts at the measured speed, the
    integral at the torque that the motor has, and the reference goes to the setpoint at
    `acceleration` until it has caught up.

    Torque mode: the torque is converted into a current by nominal K, N and gear efficiency, and a
    proportional-integral current loop (zero on the pole, closed-loop time constant
    `current_time`) gives the voltage on top of the back-EMF. Voltage mode: the voltage is set.

    Encoder and motor are compared: if the measured velocity differs from the one that voltage and
    current imply by the back-EMF for MISMATCH_TIME, the encoder or the motor is faulty. If a
    current flows, it is the encoder: the unit brakes with the motor shorted until a reset, as no
    velocity loop can stop it. If none flows, the motor's circuit is open: the wheel cannot be
    driven or braked, nor run away, and the unit switches its output off until a reset. Such a
    fault stops this axis only (CiA 402: disable drive function); the controller decides what the
    robot does.

    A halt (after a time without a valid command, or in a quick stop) enters velocity mode and
    ramps the reference to zero. A unit that is off applies no voltage: its motor rotates freely.
    """

    def __init__(self, settings: DriveSettings) -> None:
        self._settings = settings
        self.mode = DriveUnitMode.VELOCITY
        self.setpoint = self.feedforward = self.voltage = 0.0
        self._goal = self._integral = self._reference = 0.0
        self._ramp = settings.firmware.acceleration  # 0: the reference follows the goal at once
        self._is_halted = True
        self._current = self._estimate = self._mismatch_duration = self._mean_current = 0.0
        self.lost = self.open_circuit = False

    def configure(self, settings: DriveSettings) -> None:
        """Replace the settings; the state is kept."""
        self._settings = settings

    def torque_of(self, current: float, velocity: float) -> float:
        """Return the torque at the wheel for a current, by nominal values [N m]."""
        torque = self._settings.back_emf * current
        efficiency = self._settings.efficiency
        return torque * efficiency if torque * velocity >= 0 else torque / efficiency

    def current_for(self, torque: float, velocity: float) -> float:
        """Return the current for a torque at the wheel, by nominal values [A]."""
        efficiency = self._settings.efficiency
        motor = torque / efficiency if torque * velocity >= 0 else torque * efficiency
        return motor / self._settings.back_emf

    def command_velocity(
        self, velocity: float, torque: float, measured: float, current: float
    ) -> None:
        """Set a velocity [rad/s] and a feed-forward torque [N m]; enter the mode as measured.

        Args:
            current: Measured current, from which the mode is entered [A].
        """
        if self.mode is not DriveUnitMode.VELOCITY:
            self._enter_velocity(measured, current, torque)
        elif self._is_halted:
            self._ramp = self._settings.firmware.acceleration
        self._is_halted = False
        self._goal, self.feedforward = velocity, torque

    def command_torque(self, torque: float, measured: float, current: float) -> None:
        """Set a torque at the wheel [N m]; enter torque mode."""
        if self.mode is not DriveUnitMode.TORQUE:
            self.mode = DriveUnitMode.TORQUE
            self.setpoint = torque
            error = self._current_goal(measured) - current
            back_emf = self._settings.back_emf * measured
            self._integral = self.voltage - back_emf - self._proportional() * error
        self.setpoint = torque

    def command_voltage(self, voltage: float) -> None:
        """Set a voltage [V]; enter voltage mode."""
        self.mode = DriveUnitMode.VOLTAGE
        self.setpoint = voltage

    def halt(self, deceleration: float, measured: float, current: float) -> None:
        """Enter velocity mode and ramp to rest at a deceleration [rad/s^2]."""
        if self.mode is DriveUnitMode.VELOCITY:
            self._integral += self.feedforward
            # Begin at the measured velocity if that is lower, so that the wheel never speeds up.
            has_same_sign = self._reference * measured > 0
            if not has_same_sign or abs(measured) < abs(self._reference):
                self._reference = measured
        else:
            self._enter_velocity(measured, current, 0.0)
        self._goal = self.feedforward = 0.0
        self._ramp, self._is_halted = deceleration, True

    def release(self) -> None:
        """Switch off until the next command, and clear the faults of encoder and motor."""
        self.mode = DriveUnitMode.OFF
        self.setpoint = self.feedforward = self._integral = 0.0
        self.reset()

    def _enter_velocity(self, measured: float, current: float, feedforward: float) -> None:
        self.mode = DriveUnitMode.VELOCITY
        self._reference = measured
        self._integral = self.torque_of(current, measured) - feedforward
        self._ramp = self._settings.firmware.acceleration

    def update(self, velocity: float, current: float) -> float:
        """Return the voltage to apply to the motor until the next run [V], as measured.

        Args:
            velocity: Measured velocity [rad/s].
            current: Measured current [A].
        """
        if self.mode is DriveUnitMode.OFF:
            # The terminals have the back-EMF, at which the next mode begins.
            self.voltage = self._settings.back_emf * velocity
            return self.voltage
        self._watch(velocity, current)
        if self.lost or self.open_circuit:
            voltage = 0.0
        elif self.mode is DriveUnitMode.VELOCITY:
            voltage = self._velocity_loop(velocity, current)
        elif self.mode is DriveUnitMode.TORQUE:
            voltage = self._current_loop(velocity, current)
        else:
            voltage = self.setpoint
        limit = self._settings.max_voltage
        self.voltage = min(max(voltage, -limit), limit)
        return self.voltage

    def reset(self) -> None:
        """Clear the faults of encoder and motor."""
        self.lost = self.open_circuit = False
        self._mismatch_duration = 0.0

    def _watch(self, velocity: float, current: float) -> None:
        """Compare the encoder with the back-EMF, except while the current is limited."""
        settings = self._settings
        rise, self._current = (current - self._current) / settings.step, current
        if abs(current) > SATURATION_FRACTION * settings.max_current:
            self._mismatch_duration, self._estimate = 0.0, velocity
            return
        drop = settings.resistance * current + settings.inductance * rise
        implied_velocity = (self.voltage - drop) / settings.back_emf
        gain = min(settings.step / BACK_EMF_TIME_CONSTANT, 1.0)
        self._estimate += (implied_velocity - self._estimate) * gain
        self._mean_current += (current - self._mean_current) * gain
        uncertain = VOLTAGE_TOLERANCE_FRACTION * abs(self.voltage) / settings.back_emf
        allowed = settings.firmware.encoder_tolerance + VELOCITY_TOLERANCE_FRACTION * abs(
            self._estimate
        )
        differs = abs(self._estimate - velocity) > allowed + uncertain
        self._mismatch_duration = self._mismatch_duration + settings.step if differs else 0.0
        if self._mismatch_duration > MISMATCH_TIME and not (self.lost or self.open_circuit):
            threshold = OPEN_CIRCUIT_FRACTION * settings.max_current
            self.open_circuit = abs(self._mean_current) < threshold
            self.lost = self.lost or not self.open_circuit

    def _velocity_loop(self, velocity: float, current: float) -> float:
        settings = self._settings
        firmware = settings.firmware
        if self._ramp:
            change = self._ramp * settings.step
            distance = self._goal - self._reference
            if abs(distance) <= change:
                self._reference, self._ramp = self._goal, 0.0
            else:
                self._reference += change if distance > 0 else -change
        else:
            self._reference = self._goal
        reference = self._reference
        error = reference - velocity
        proportional = firmware.velocity_bandwidth * settings.inertia * error
        torque = self.feedforward + proportional + self._integral
        unlimited = self.current_for(torque, velocity)
        limited = min(max(unlimited, -settings.max_current), settings.max_current)
        voltage = settings.back_emf * reference + settings.resistance * limited
        is_limited_current = abs(current) > SATURATION_FRACTION * settings.max_current
        saturated = (
            unlimited != limited
            or abs(voltage) > settings.max_voltage
            or (is_limited_current and current * proportional > 0)
        )
        if not reference and not self._goal:
            self._integral -= self._integral * settings.step / (0.5 * firmware.integral_time)
        elif not saturated or proportional * self._integral < 0:
            gain = proportional + settings.damping * error
            self._integral += gain * settings.step / firmware.integral_time
        return voltage

    def _current_goal(self, velocity: float) -> float:
        limit = self._settings.max_current
        return min(max(self.current_for(self.setpoint, velocity), -limit), limit)

    def _proportional(self) -> float:
        return self._settings.inductance / self._settings.firmware.current_time

    def _current_loop(self, velocity: float, current: float) -> float:
        settings = self._settings
        error = self._current_goal(velocity) - current
        increment = settings.resistance * settings.step / settings.firmware.current_time * error
        voltage = settings.back_emf * velocity + self._proportional() * error + self._integral
        if abs(voltage) < settings.max_voltage or increment * voltage < 0:
            self._integral += increment
        return voltage
