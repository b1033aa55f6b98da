"""The drive unit of one wheel: modes, loops, limits and watchdog, run at each substep."""

import enum
from dataclasses import dataclass

from omniman_ros.core.robot import Robot
from omniman_ros.drive.parameters import Firmware

ENCODER_FILTER = 0.01
"""Time constant of the velocity from the back-EMF, s."""
ENCODER_PATIENCE = 0.1
"""How long it must differ from the encoder's, s."""
ENCODER_SHARE = 0.25
"""Part of the velocity that it may differ by, over the tolerance: motors are not all alike."""
VOLTAGE_SHARE = 0.1
"""The same for the velocity that the voltage stands for: nor are amplifiers."""


OPEN_SHARE = 0.01
"""Part of the largest current below which, against a voltage that should drive more, none flows:
the motor's circuit is open."""


class Mode(enum.Enum):
    """What a drive unit controls."""

    VELOCITY = "velocity"
    TORQUE = "torque"
    VOLTAGE = "voltage"
    OFF = "off"


@dataclass(frozen=True)
class DriveSettings:
    """What a drive unit knows of its motor, by commissioning: nominal values, not the plant's.

    Attributes:
        resistance, inductance: Of the motor, ohm and H.
        back_emf: K N, V s/rad or N m/A at the wheel.
        efficiency: Of the gear.
        max_voltage, max_current: Limits, V and A.
        inertia: The wheel's own and its share of the robot's mass, kg m^2 at the wheel.
        step: Period of the loops, s.
        firmware: Parameters.
    """

    resistance: float
    inductance: float
    back_emf: float
    efficiency: float
    max_voltage: float
    max_current: float
    inertia: float
    step: float
    firmware: Firmware

    @property
    def damping(self) -> float:
        """Torque that the motor at a fixed voltage loses per wheel speed, N m s/rad."""
        return self.efficiency * self.back_emf * self.back_emf / self.resistance


def drive_settings(robot: Robot, firmware: Firmware, step: float) -> tuple[DriveSettings, ...]:
    """Commission the drive units of a robot, one per wheel."""
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
    """One drive unit.

    Velocity mode: a proportional-integral loop on the measured velocity gives a torque, to which
    the feed-forward torque is added; voltage = K N reference + R current(torque). The motor's own
    back-EMF acts on the true speed and so damps the loop without the encoder's lag; the integral
    gain counts it in. The integral stands still while voltage or current are at their limits. At
    a reference of zero it fades: the motor brakes as a short-circuited one, friction holds, and a
    wheel at rest takes no current.

    When the mode is entered, and after a stop, the reference starts at the measured speed, the
    integral at the torque that the motor has, and the reference goes to the setpoint at
    `acceleration` until it has caught up.

    Torque mode: the torque is turned to a current by nominal K, N and gear efficiency, and a
    proportional-integral current loop (zero on the pole, closed-loop time constant
    `current_time`) gives the voltage on top of the back-EMF. Voltage mode: the voltage itself.

    Encoder and motor watch each other: a velocity that is not what voltage and current say of the
    back-EMF, for ENCODER_PATIENCE, means that the encoder or the motor is lost. Where a current
    flows, it is the encoder: the unit brakes with the motor shorted until a reset, as no velocity
    loop can stop it. Where none flows, the motor's circuit is open: the wheel cannot be driven or
    braked, nor run away, and the unit switches its output off until a reset. Such a fault is the
    axis's own (CiA 402: disable drive function); what the robot does is the controller's matter.

    A halt (without a valid command for a while, or in a quick stop) goes over to velocity mode and
    ramps the reference to zero. A unit that is off gives no voltage: its motor turns freely.
    """

    def __init__(self, settings: DriveSettings) -> None:
        self._settings = settings
        self.mode = Mode.VELOCITY
        self.setpoint = self.feedforward = self.voltage = 0.0
        self._goal = self._integral = self._reference = 0.0
        self._ramp = settings.firmware.acceleration  # 0: the reference follows the goal at once
        self._halted = True
        self._current = self._estimate = self._suspect = self._flow = 0.0
        self.lost = self.open_circuit = False

    def configure(self, settings: DriveSettings) -> None:
        """Take other settings; the state stays."""
        self._settings = settings

    def torque_of(self, current: float, velocity: float) -> float:
        """Torque at the wheel for a current, by nominal values, N m."""
        torque = self._settings.back_emf * current
        efficiency = self._settings.efficiency
        return torque * efficiency if torque * velocity >= 0 else torque / efficiency

    def current_for(self, torque: float, velocity: float) -> float:
        """Current for a torque at the wheel, by nominal values, A."""
        efficiency = self._settings.efficiency
        motor = torque / efficiency if torque * velocity >= 0 else torque * efficiency
        return motor / self._settings.back_emf

    def command_velocity(
        self, velocity: float, torque: float, measured: float, current: float
    ) -> None:
        """Take a setpoint in rad/s and a feed-forward torque in N m; enter velocity mode.

        Args:
            velocity, torque: Setpoint and feed-forward.
            measured, current: Measured velocity and current, from which the mode is entered.
        """
        if self.mode is not Mode.VELOCITY:
            self._enter_velocity(measured, current, torque)
        elif self._halted:
            self._ramp = self._settings.firmware.acceleration
        self._halted = False
        self._goal, self.feedforward = velocity, torque

    def command_torque(self, torque: float, measured: float, current: float) -> None:
        """Take a torque at the wheel, N m; enter torque mode."""
        if self.mode is not Mode.TORQUE:
            self.mode = Mode.TORQUE
            self.setpoint = torque
            error = self._current_goal(measured) - current
            back_emf = self._settings.back_emf * measured
            self._integral = self.voltage - back_emf - self._proportional() * error
        self.setpoint = torque

    def command_voltage(self, voltage: float) -> None:
        """Take a voltage, V; enter voltage mode."""
        self.mode = Mode.VOLTAGE
        self.setpoint = voltage

    def halt(self, deceleration: float, measured: float, current: float) -> None:
        """Go over to velocity mode and ramp to rest at a deceleration, rad/s^2."""
        if self.mode is Mode.VELOCITY:
            self._integral += self.feedforward
            # from where it is, without speeding up first
            same = self._reference * measured > 0
            if not same or abs(measured) < abs(self._reference):
                self._reference = measured
        else:
            self._enter_velocity(measured, current, 0.0)
        self._goal = self.feedforward = 0.0
        self._ramp, self._halted = deceleration, True

    def release(self) -> None:
        """Go off, until the next command; encoder and motor are trusted again."""
        self.mode = Mode.OFF
        self.setpoint = self.feedforward = self._integral = 0.0
        self.reset()

    def _enter_velocity(self, measured: float, current: float, feedforward: float) -> None:
        self.mode = Mode.VELOCITY
        self._reference = measured
        self._integral = self.torque_of(current, measured) - feedforward
        self._ramp = self._settings.firmware.acceleration

    def update(self, velocity: float, current: float) -> float:
        """Run the loops once.

        Args:
            velocity: Measured velocity, rad/s.
            current: Measured current, A.

        Returns:
            Voltage to give to the motor until the next run, V.
        """
        if self.mode is Mode.OFF:  # the terminals have the back-EMF: where the next mode begins
            self.voltage = self._settings.back_emf * velocity
            return self.voltage
        self._watch(velocity, current)
        if self.lost or self.open_circuit:
            voltage = 0.0
        elif self.mode is Mode.VELOCITY:
            voltage = self._velocity_loop(velocity, current)
        elif self.mode is Mode.TORQUE:
            voltage = self._current_loop(velocity, current)
        else:
            voltage = self.setpoint
        limit = self._settings.max_voltage
        self.voltage = min(max(voltage, -limit), limit)
        return self.voltage

    def reset(self) -> None:
        """Trust encoder and motor again."""
        self.lost = self.open_circuit = False
        self._suspect = 0.0

    def _watch(self, velocity: float, current: float) -> None:
        """Compare the encoder with the back-EMF; a motor at its current limit tells nothing."""
        settings = self._settings
        rise, self._current = (current - self._current) / settings.step, current
        if abs(current) > 0.98 * settings.max_current:
            self._suspect, self._estimate = 0.0, velocity
            return
        drop = settings.resistance * current + settings.inductance * rise
        seen = (self.voltage - drop) / settings.back_emf
        gain = min(settings.step / ENCODER_FILTER, 1.0)
        self._estimate += (seen - self._estimate) * gain
        self._flow += (current - self._flow) * gain
        uncertain = VOLTAGE_SHARE * abs(self.voltage) / settings.back_emf
        allowed = settings.firmware.encoder_tolerance + ENCODER_SHARE * abs(self._estimate)
        off = abs(self._estimate - velocity) > allowed + uncertain
        self._suspect = self._suspect + settings.step if off else 0.0
        if self._suspect > ENCODER_PATIENCE and not (self.lost or self.open_circuit):
            self.open_circuit = abs(self._flow) < OPEN_SHARE * settings.max_current
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
        push = firmware.velocity_bandwidth * settings.inertia * error
        wanted = self.current_for(self.feedforward + push + self._integral, velocity)
        limited = min(max(wanted, -settings.max_current), settings.max_current)
        voltage = settings.back_emf * reference + settings.resistance * limited
        saturated = (
            wanted != limited
            or abs(voltage) > settings.max_voltage
            or (abs(current) > 0.98 * settings.max_current and current * push > 0)
        )
        if not reference and not self._goal:
            self._integral -= self._integral * settings.step / (0.5 * firmware.integral_time)
        elif not saturated or push * self._integral < 0:
            gain = push + settings.damping * error
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
        push = settings.resistance * settings.step / settings.firmware.current_time * error
        voltage = settings.back_emf * velocity + self._proportional() * error + self._integral
        if abs(voltage) < settings.max_voltage or push * voltage < 0:
            self._integral += push
        return voltage
