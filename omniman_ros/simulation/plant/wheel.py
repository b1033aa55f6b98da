"""One wheel of the plant: its gear motor, and the roller on the floor.

In a step of length h the wheel's speed goes from w0 to w1, w_mid is the mean, and the chassis goes
from u0 to u1. Over the step, all forces and the current i are constant, so with the work of each
taken at the mean speeds the energy balance is exact, whatever the forces are:

    inertia (w1 - w0) / h = gear(N K i) - viscous w_mid - dry - sum over contacts of arm * force

:class:`~omniman_ros.simulation.plant.gear_motor.GearMotor` explains current and gear. Coulomb
friction and the gear's loss are set-valued at w1 = 0: there the wheel sticks, and they have the
value that holds it, within their bounds. Where that would feed energy in, because the wheel
reverses or stops within the step, they follow w_mid instead.
"""

from omniman_ros.simulation.plant.contact import ContactFriction
from omniman_ros.simulation.plant.gear_motor import GearMotor


class Wheel(GearMotor):
    """State and constants of one driven wheel, and the equation of the step that is being solved.

    Attributes:
        axis, free: Contact along the roller's axis (it slips) and across it (it rolls).
        roller, slip: Energies that the contact converted since the start [J].
    """

    def __init__(self) -> None:
        super().__init__()
        self.axis, self.free = ContactFriction(), ContactFriction()
        self.inertia = 1.0  #: Moment of inertia of wheel, gear and rotor about the axle [kg m^2]
        self.roller = self.slip = 0.0
        self._base = self._load = self._speed0 = 0.0
        self._rate = self._torque_ratio = 1.0
        self._gain = (0.0, 0.0, 0.0)
        self._direction = 0
        self._drives = True
        self._at_mean = False

    @property
    def kinetic(self) -> float:
        """Kinetic energy of the wheel [J]."""
        return 0.5 * self.inertia * self.speed * self.speed

    def set_speed(self, speed: float) -> None:
        """Set the wheel speed [rad/s]."""
        self.speed = self._speed0 = speed

    def begin(self, command: float, step: float, ux: float, uy: float, yaw_rate: float) -> None:
        """Start a step [s]: requested voltage [V], and twist of the body, in the step's frame."""
        speed0 = self.speed
        self._rate = self.inertia / step
        self.axis.begin(self.axis.slip_speed(ux, uy, yaw_rate, speed0))
        self.free.begin(self.free.slip_speed(ux, uy, yaw_rate, speed0))
        self._begin_current(command, step)
        self._speed0 = speed0
        self._at_mean = False
        if self.blocked:
            self._direction = 0
        elif speed0 != 0.0:
            self._direction = 1 if speed0 > 0 else -1
        self._drives = (self._source - self._slope * speed0) * self._direction >= 0

    def reduce(self, system: list[float]) -> None:
        """Add the wheel, with its own speed eliminated, to the equations of the body.

        `system` has the upper triangle of the symmetric matrix (11, 12, 13, 22, 23, 33) and the
        right side (1, 2, 3) of the equation for the twist at the end of the step.
        """
        axis, free = self.axis, self.free
        axis.linearise()
        free.linearise()
        a1, a2, a3 = axis.row
        b1, b2, b3 = free.row
        ka, pa = axis.slope, axis.offset
        kb, pb = free.slope, free.offset
        m11 = ka * a1 * a1 + kb * b1 * b1
        m12 = ka * a1 * a2 + kb * b1 * b2
        m13 = ka * a1 * a3 + kb * b1 * b3
        m22 = ka * a2 * a2 + kb * b2 * b2
        m23 = ka * a2 * a3 + kb * b2 * b3
        m33 = ka * a3 * a3 + kb * b3 * b3
        ga, gb = ka * axis.arm, kb * free.arm
        g1, g2, g3 = ga * a1 + gb * b1, ga * a2 + gb * b2, ga * a3 + gb * b3
        h1 = h2 = h3 = 0.0
        if self._direction:
            self._torque_ratio = self.efficiency if self._drives else 1.0 / self.efficiency
            torque_per_current = self.back_emf * self._torque_ratio
            damping = 0.5 * (torque_per_current * self._slope + self.viscous)
            inverse = 1.0 / (self._rate + damping + ga * axis.arm + gb * free.arm)
            dry = self._direction * self.coulomb
            base = inverse * (
                (self._rate - damping) * self._speed0
                + torque_per_current * self._source
                - dry
                - axis.arm * pa
                - free.arm * pb
            )
            h1, h2, h3 = g1 * inverse, g2 * inverse, g3 * inverse
            m11 -= g1 * h1
            m12 -= g1 * h2
            m13 -= g1 * h3
            m22 -= g2 * h2
            m23 -= g2 * h3
            m33 -= g3 * h3
        else:
            base = -self._speed0 if self._at_mean else 0.0
        self._base, self._gain = base, (h1, h2, h3)
        system[0] += m11
        system[1] += m12
        system[2] += m13
        system[3] += m22
        system[4] += m23
        system[5] += m33
        system[6] += a1 * pa + b1 * pb + g1 * base
        system[7] += a2 * pa + b2 * pb + g2 * base
        system[8] += a3 * pa + b3 * pb + g3 * base

    def resolve(self, ux: float, uy: float, yaw_rate: float, tolerance: float) -> bool:
        """Set the twist at the end of the step; return whether all laws hold.

        `tolerance` is the allowed deviation of a contact force, as a fraction of its bound.
        """
        axis, free = self.axis, self.free
        h1, h2, h3 = self._gain
        speed = self.speed = self._base + h1 * ux + h2 * uy + h3 * yaw_rate
        settled = axis.resolve(axis.slip_speed(ux, uy, yaw_rate, speed), tolerance)
        settled &= free.resolve(free.slip_speed(ux, uy, yaw_rate, speed), tolerance)
        mean = 0.5 * (self._speed0 + speed)
        self.mean_current = self._source - self._slope * mean
        self._load = axis.arm * axis.force + free.arm * free.force
        settled &= self._check_shaft(mean, self.back_emf * self.mean_current)
        return settled if self.open_circuit else self._amplify(mean) and settled

    def _check_shaft(self, mean: float, torque: float) -> bool:
        """Return whether the wheel rotates or sticks as assumed; if not, change the assumption."""
        direction, at_mean = self._direction, self._at_mean
        if direction:
            if (mean if at_mean else self.speed) * direction < 0.0:
                self._direction = 0
                return False
            self._at_mean = at_mean or mean * direction < 0.0
            drives = torque * direction >= 0.0
            if drives is not self._drives:
                self._drives = drives
                # at zero current both are right
                return abs(torque) * (1.0 / self.efficiency - self.efficiency) < 1e-9
            return self._at_mean is at_mean
        if self.blocked:
            return True
        ahead, back = self._behind_gear(torque)
        rest = self._holding_torque(0.0, mean)
        limit = self.coulomb * self.breakaway
        if ahead + rest > limit:
            self._direction = 1
        elif back + rest < -limit:
            self._direction = -1
        else:
            self._at_mean = at_mean or (torque + rest) * mean < 0.0
            return self._at_mean is at_mean
        self._drives = torque * self._direction >= 0.0
        return False

    def _holding_torque(self, torque: float, mean: float) -> float:
        """Return the torque of the dry friction that holds the wheel [N m]."""
        return torque + self._rate * (self._speed0 - self.speed) - self.viscous * mean - self._load

    def _behind_gear(self, torque: float) -> tuple[float, float]:
        """Return the torque behind the gear for forward and for backward rotation [N m]."""
        driving, driven = self.efficiency * torque, torque / self.efficiency
        return (driving, driven) if torque > 0.0 else (driven, driving)

    def finish(self, step: float, ux: float, uy: float, yaw_rate: float) -> float:
        """Close the step; return the sum of the magnitudes of the converted energies [J]."""
        mean = 0.5 * (self._speed0 + self.speed)
        current = self.mean_current
        torque = self.back_emf * current
        viscous = self.viscous * mean
        if self._direction:
            gear, dry = torque * (1.0 - self._torque_ratio), self.coulomb * self._direction
        else:  # gear and shaft share the holding torque in proportion to their bounds
            holding = self._holding_torque(torque, mean)
            bound = abs(torque - self._behind_gear(torque)[0 if holding > 0.0 else 1])
            total = bound + self.coulomb
            gear = holding * bound / total if total and not self.blocked else 0.0
            dry = holding - gear
        travel = mean * step
        gear *= travel
        shaft = (viscous + dry) * travel
        slip = -self.axis.force * self.axis.slip_speed(ux, uy, yaw_rate, mean) * step
        roller = -self.free.force * self.free.slip_speed(ux, uy, yaw_rate, mean) * step
        self.gear += gear
        self.shaft += shaft
        self.slip += slip
        self.roller += roller
        electrical, copper = self._finish_current(step, travel)
        return abs(electrical) + copper + abs(gear) + abs(shaft) + abs(slip) + abs(roller)
