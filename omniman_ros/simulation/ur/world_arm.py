"""An arm whose joints are in a physics world, beyond a link."""

import threading
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.simulation.arm_link.frames import ArmSetpoint, ArmState
from omniman_ros.simulation.ur.arm import CYCLE, JOINTS, SimulatedArm, UrArmParameters

#: Time from a cycle until its setpoint is due [s]: the world learns of it first
LEAD = 2.0 * CYCLE
TIME_TOLERANCE = 1e-6  #: Time before an instant at which it counts as reached [s]
RETRY_CYCLES = 12  #: Number of cycles between two attempts to connect
WAIT = 0.1  #: Longest real time of one wait for the world, until other states are checked [s]
LOCKSTEP_SILENCE = 5.0  #: Real time after which a world on simulated time counts as silent [s]
SILENCE = 2.0  #: Time without a state after which a world on real time counts as silent [s]


class ArmLink(Protocol):
    """The controller's end of the link; see `ArmLinkClient`."""

    failure: str  #: Why there is no connection

    @property
    def is_open(self) -> bool:
        """Whether there is a connection."""

    def open(self) -> bool:
        """Try to connect; return whether that succeeded."""

    def receive(self) -> list[ArmState]:
        """Return the states that have arrived."""

    def send(self, setpoint: ArmSetpoint) -> None:
        """Send a setpoint."""

    def wait(self, timeout: float) -> bool:
        """Wait until something has arrived, up to `timeout` [s]; return whether it has."""

    def close(self, reason: str) -> None:
        """Close the connection."""


@dataclass(frozen=True)
class _Sent:
    """A setpoint that the world has not yet answered, and the acceleration towards it."""

    setpoint: ArmSetpoint
    acceleration: Array


class WorldArm:
    """Joints in a physics world, an `ArmBody`.

    The reference is a :class:`SimulatedArm` in the controller, with the lag and the limits of the
    joints. The world moves its joints along that reference, :data:`LEAD` later, and measures them.
    With simulated time, a cycle waits for the state at its own instant and takes no later one, so
    that it always knows the same, however busy the machine is.
    """

    def __init__(self, parameters: UrArmParameters, link: ArmLink, is_lockstep: bool) -> None:
        self.reference = SimulatedArm(parameters)  #: The motion that the joints are told to make
        self.dynamics = self.reference.dynamics
        self.q: Array = self.reference.q.copy()  #: Measured angles (6,) [rad]
        self.qd: Array = np.zeros(JOINTS)  #: Measured speeds (6,) [rad/s]
        self.torque: Array = np.zeros(JOINTS)  #: Measured torques, the mean of a cycle (6,) [N m]
        self.is_connected = False  #: Whether the joints answer
        self._link, self._is_lockstep = link, is_lockstep
        self._sent: deque[_Sent] = deque()
        self._arrived: deque[ArmState] = deque()
        self._answered: _Sent | None = None
        self._sequence, self._begins_anew = 0, True
        self._last_speed: Array = np.zeros(JOINTS)
        self._time = self._answer_time = 0.0
        self._until_retry = 0
        self._closing = threading.Event()

    @property
    def failure(self) -> str:
        """Why the joints do not answer, or an empty string."""
        return "" if self.is_connected else self._link.failure

    @property
    def still(self) -> bool:
        """Whether the reference is at rest; the platform may shake the joints."""
        return self.reference.still

    @property
    def lost_motion(self) -> Array:
        """By how much the joints are behind their reference at the same instant (6,) [rad]."""
        if self._answered is None:
            return np.zeros(JOINTS)
        return np.array(self._answered.setpoint.positions) - self.q

    @property
    def unexpected_torque(self) -> Array:
        """Torques beyond those that the reference took by the controller's model (6,) [N m]."""
        if self._answered is None or self._answered.setpoint.braked:
            return np.zeros(JOINTS)
        # The torque is the mean of the cycle before, of which this is the middle.
        acceleration = self._answered.acceleration
        middle = self.qd - 0.5 * CYCLE * acceleration
        q = self.q - 0.5 * CYCLE * middle
        return self.torque - self.dynamics.torque(q, middle, acceleration)

    def measure(self, time: float) -> None:
        """Take what the world has measured up to a cycle, at its instant [s]."""
        self._time = time
        if not (self._link.is_open or self.is_connected):
            self._connect()
        self._receive()
        if self._is_lockstep:
            self._await()
        elif self.is_connected and time - self._answer_time > SILENCE:
            self._link.close(f"the world has been silent for {SILENCE} s")
        if self.is_connected and not self._link.is_open:
            self.is_connected = False
            self._forget()

    def _connect(self) -> None:
        self._until_retry -= 1
        if self._until_retry < 0 and not self._link.open():
            self._until_retry = RETRY_CYCLES

    def _await(self) -> None:
        waits = 0
        while self._link.is_open and self._sent and self._is_due(self._sent[0].setpoint):
            if not self._link.wait(WAIT):
                waits += 1
                if self._closing.is_set():
                    return
                if waits * WAIT >= LOCKSTEP_SILENCE:
                    self._link.close(f"the world has been silent for {LOCKSTEP_SILENCE} s")
            self._receive()

    def _is_due(self, setpoint: ArmSetpoint) -> bool:
        return setpoint.due <= self._time + TIME_TOLERANCE

    def _receive(self) -> None:
        """Take the states that have arrived, in lockstep as far as the time has come."""
        self._arrived.extend(self._link.receive())
        while self._arrived:
            state = self._arrived[0]
            answered = [sent for sent in self._sent if sent.setpoint.sequence <= state.sequence]
            if self._is_lockstep and answered and not self._is_due(answered[-1].setpoint):
                return  # the world is ahead
            self._arrived.popleft()
            for _ in answered:
                self._answered = self._sent.popleft()
            self.q, self.qd = np.array(state.positions), np.array(state.velocities)
            self.torque = np.array(state.torques)
            self._answer_time = self._time
            if not self.is_connected:
                self._forget()
                self.is_connected = True

    def _forget(self) -> None:
        self._sent.clear()
        self._arrived.clear()
        self._answered = None
        self.give_way()

    def follow(self, target: Array, dt: float) -> None:
        """Follow target angles (6,) [rad] for a time dt [s]."""
        self.reference.follow(target, dt)
        self._send(dt)

    def brake(self, dt: float) -> None:
        """Decelerate by the drives for a time [s], all joints in proportion."""
        self.reference.brake(dt)
        self._send(dt)

    def lock(self) -> None:
        """Hold the joints by their brakes for a cycle."""
        self.reference.place(self.q, np.zeros(JOINTS))
        self._begins_anew = True
        self._send(CYCLE, braked=True)
        self._begins_anew = True

    def give_way(self) -> None:
        """Go on from where the joints are, instead of from their reference.

        A joint that something holds up, or throws back, is to rest; the others go on.
        """
        planned = self.reference.qd
        slower = np.minimum(np.abs(self.qd), np.abs(planned))
        kept = np.where(self.qd * planned > 0.0, np.copysign(slower, planned), 0.0)
        self.reference.place(self.q, kept)
        self._begins_anew = True

    def _send(self, dt: float, braked: bool = False) -> None:
        """Send the state of the reference in the middle of its last step, as a setpoint.

        The reference has a constant speed in each step. A motion that passes the middles of the
        steps at these speeds has its accelerations instead of jumps.
        """
        if not self.is_connected:
            return
        speed = self.reference.qd
        acceleration = (speed - self._last_speed) / dt
        if self._begins_anew:
            acceleration = np.zeros(JOINTS)
        self._sequence += 1
        setpoint = ArmSetpoint(
            self._sequence,
            self._time + LEAD,
            tuple((self.reference.q - 0.5 * dt * speed).tolist()),
            tuple(speed.tolist()),
            begins_anew=self._begins_anew,
            braked=braked,
        )
        self._sent.append(_Sent(setpoint, acceleration))
        self._last_speed, self._begins_anew = speed.copy(), False
        self._link.send(setpoint)

    def close(self) -> None:
        """Close the link, and end a wait for the world."""
        self._closing.set()
        self._link.close("closed")
