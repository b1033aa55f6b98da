"""A gear motor on a hinge of the physics world."""

from omniman_ros.simulation.plant.gear_motor import GearMotor

STANDSTILL = 1e-3  #: Speed below which a wheel is held by `breakaway` [rad/s]
BLOCKED_FRICTION = 1e4  #: Dry friction of a blocked wheel [N m]


class HingeMotor(GearMotor):
    """A gear motor as a torque, a damping and a dry friction at a hinge.

    The current falls with the mean speed of the step, w_mid = (w0 + w1) / 2, so half of its
    damping is at the end of the step, which the engine takes implicitly, and half at the start.
    The gear's loss is in proportion to the motor's torque and acts against the motion whether the
    motor drives or brakes: it is dry friction, (1 - eta) N K i or (1 / eta - 1) N K i. Where the
    wheel stands, friction and gear hold it.

    Attributes:
        torque: Torque to apply in the step [N m].
        damping: Damping at the end of the step [N m s/rad].
        dry: Dry friction in the step [N m].
    """

    def __init__(self) -> None:
        super().__init__()
        self.torque = self.damping = self.dry = 0.0
        self._gear_loss = 0.0

    def begin(self, command: float, step: float) -> None:
        """Set what acts at the hinge for a voltage requested from the amplifier [V]."""
        self._begin_current(command, step)
        speed = self.speed
        slope = 0.5 * (self.back_emf * self._slope + self.viscous)
        self.torque = self.back_emf * self._source - slope * speed
        self.damping = slope
        motor = self.back_emf * (self._source - self._slope * speed)
        lost = 1.0 - self.efficiency if motor * speed >= 0.0 else 1.0 / self.efficiency - 1.0
        self._gear_loss = lost * abs(motor)
        stands = abs(speed) < STANDSTILL
        self.dry = self._gear_loss + self.coulomb * (self.breakaway if stands else 1.0)
        if self.blocked:
            self.dry = BLOCKED_FRICTION

    def finish(self, step: float, speed: float) -> float:
        """Close the step [s] at a wheel speed [rad/s]; return the sum of all energies [J]."""
        mean = 0.5 * (self.speed + speed)
        self.speed = speed
        travel = mean * step
        self.mean_current = self._source - self._slope * mean
        electrical, copper = self._finish_current(step, travel)
        gear = self._gear_loss * abs(travel)
        shaft = self.viscous * mean * travel + self.coulomb * abs(travel)
        self.gear += gear
        self.shaft += shaft
        return abs(electrical) + copper + gear + shaft
