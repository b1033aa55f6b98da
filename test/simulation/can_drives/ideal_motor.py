"""Motor without a plant: inertia, torque constant, resistance, and a record of its commands."""

import math


class IdealMotor:
    """A brushed motor with an ideal amplifier; it implements `simulation.can_drives.motor.Motor`.

    Attributes:
        order: Name and numbers of the last command.
    """

    def __init__(
        self, inertia=1e-4, torque_constant=0.05, resistance=0.5, supply=24.0, max_current=20.0
    ):
        self.inertia, self.torque_constant = inertia, torque_constant
        self.resistance, self.supply, self.max_current = resistance, supply, max_current
        self.position = self.velocity = self.torque = self.current = self.voltage = 0.0
        self.lost = False
        self.order = ("released",)

    def follow_velocity(self, velocity, torque=0.0):
        self._take("velocity", velocity, torque)

    def follow_torque(self, torque):
        self._take("torque", torque)

    def follow_voltage(self, voltage):
        self._take("voltage", voltage)

    def halt(self, deceleration):
        self._take("halt", deceleration)

    def release(self):
        self._take("released")

    def _take(self, name, *numbers):
        assert all(math.isfinite(number) for number in numbers), (name, numbers)
        self.order = (name, *numbers)

    def step(self, dt):
        """Turn for a time, s."""
        name, *numbers = self.order
        k = self.torque_constant
        if name == "velocity":
            current = (numbers[0] - self.velocity) * self.inertia / dt / k
        elif name == "halt":
            speed = max(abs(self.velocity) - numbers[0] * dt, 0.0)
            speed = math.copysign(speed, self.velocity)
            current = (speed - self.velocity) * self.inertia / dt / k
        elif name == "torque":
            current = numbers[0] / k
        elif name == "voltage":
            current = (numbers[0] - k * self.velocity) / self.resistance
        else:
            current = 0.0
        self.current = min(max(current, -self.max_current), self.max_current)
        self.torque = k * self.current
        self.voltage = self.resistance * self.current + k * self.velocity
        before = self.velocity
        self.velocity += self.torque / self.inertia * dt
        self.position += 0.5 * (before + self.velocity) * dt


def play(drive, motor, start, end, step=0.001, heard=None):
    """Let a drive and its motor run from a time to another; return (time, message) of all sent.

    Args:
        heard: Message that the drive receives at each step, or None.
    """
    sent = []
    for k in range(1, round((end - start) / step) + 1):
        now = start + k * step
        motor.step(step)
        if heard is not None:
            sent += [(now, message) for message in drive.receive(heard, now)]
        sent += [(now, message) for message in drive.advance(now)]
    return sent
