"""What may be wrong with a wheel, and what is done about it: stop, or drive on without it."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.dead_wheel import DeadWheelDetector
from omniman_ros.core.errors import InputError
from omniman_ros.core.feedback import WheelFeedback
from omniman_ros.core.kinematics import MARGIN
from omniman_ros.core.limits import TwistLimits
from omniman_ros.core.platform_parameters import PlatformParameters
from omniman_ros.core.wheel_cascade import WheelCascade

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STANDING_SHARE = 0.1
"""A wheel slower than this part of its reference stands against it."""
LEAST_REFERENCE = 0.5
"""Speed that must be asked of a wheel to call it blocked [rad/s]: below, one that starts against
friction or its neighbours may stand as well."""


class LastingWatch:
    """Finds a wheel of which something has been true for long."""

    def __init__(self, count: int) -> None:
        self._lasted: Array = np.zeros(count)
        self._before: Flags = np.zeros(count, dtype=bool)
        self._any = False

    def clear(self) -> None:
        """Count anew."""
        if self._any:
            self._lasted = np.zeros_like(self._lasted)
            self._before = np.zeros_like(self._before)
            self._any = False

    def update(self, wrong: Flags | None, patience: float, dt: float) -> int | None:
        """Return the index of a wheel that was wrong for `patience` s, then count anew.

        A time counts if it was wrong at both ends.

        Args:
            wrong: (n,) bool, or None for no wheel.
            patience: How long it must last [s].
            dt: Time since the last call [s].
        """
        if wrong is None or True not in wrong.tolist():
            self.clear()
            return None
        self._any = True
        self._lasted = np.where(wrong & self._before, self._lasted + dt, 0.0)
        self._before = wrong
        worst = int(self._lasted.argmax())
        if self._lasted[worst] <= patience:
            return None
        self.clear()
        return worst


class WheelGuard:
    """Watches the wheels; knows which of them do not drive.

    A wheel that does not follow, that stands against a torque (blocked), or whose encoder is lost
    stops the robot. So does a dead one (no torque), unless `drive.dead_wheel` says to drive on
    and the others determine the twist well: then it becomes idle. A second one stops the robot.

    Attributes:
        dead: Indices of wheels found dead since the last reset, which stopped the robot or not.
        idle: Indices of wheels to drive without: told by `drive.dead`, or found dead.
        limits: Of the twist: those of the parameters, lower where wheels are idle.
    """

    def __init__(self, parameters: PlatformParameters, cascade: WheelCascade) -> None:
        n = parameters.robot.wheel_count
        self._following, self._blocked = LastingWatch(n), LastingWatch(n)
        self._detector = DeadWheelDetector(
            cascade.dynamics.torque_limit, parameters.health, cascade.kinematics
        )
        self.dead: tuple[int, ...] = ()
        self._found: tuple[int, ...] = ()
        self._seen = 0.0
        self.configure(parameters, cascade)

    def configure(self, parameters: PlatformParameters, cascade: WheelCascade) -> None:
        """Take over new thresholds and models, idle wheels included."""
        self._parameters = parameters
        self.idle = cascade.kinematics.idle
        limits = parameters.limits
        self.limits = reduced(limits, parameters.drive.dead_limits) if self.idle else limits
        self._names = parameters.robot.wheels.names
        limit = cascade.dynamics.torque_limit
        self._detector.configure(limit, parameters.health, cascade.kinematics)
        share = parameters.health.blocked_torque
        self._blocked_torque = np.where(limit > 0.0, share * limit, np.inf)  # idle: never
        self._least_blocked = float(self._blocked_torque.min())

    def reset(self) -> None:
        """Trust all wheels again but those that were told to be dead."""
        self.dead = self._found = ()
        self.idle = self.without(self._parameters)

    def without(self, parameters: PlatformParameters) -> tuple[int, ...]:
        """Indices of the wheels to drive without: those of the parameters and those found."""
        return tuple(sorted({*told(parameters), *self._found}))

    @property
    def torque_reported(self) -> bool:
        """Whether the drives report torques; without them no dead wheel is found."""
        return self._detector.reported

    @property
    def note(self) -> str:
        """What is to be said of the wheels while the robot drives, or an empty string."""
        if not self.idle:
            return ""
        found = "" if self._found else ", as drive.dead says"
        return f"{name_list(self._names, self.idle)} dead: driving on without{found}"

    def state(self, wheel: int) -> str:
        """What is known of a wheel: driving, dead, or idle (dead, and driven on without)."""
        if wheel in self.idle:
            return "idle"
        return "dead" if wheel in self.dead else "driving"

    def hear(self, time: float, effort: Array | None) -> None:
        """Take measured torques (n,) [N m] of a time [s], None where the drives report none.

        Raises:
            InputError: Wrong size.
        """
        n = len(self._names)
        if effort is not None and effort.shape != (n,):
            raise InputError(f"wheel_states: {effort.size} efforts for {n} wheels")
        self._detector.hear(time, effort)

    def probe(self, now: float) -> Array | None:
        """Torques (n,) [N m] to add to the command at `now` to ask a wheel, or None."""
        return self._detector.probe(now)

    def check(
        self, cascade: WheelCascade, feedback: WheelFeedback, driven: bool, now: float, dt: float
    ) -> str:
        """Why the robot must stop, or an empty string; `idle` may have grown.

        Args:
            cascade: With what was asked of the wheels in the last tick.
            feedback: What they said since.
            driven: Whether a source drives.
            now, dt: Time and since the last call [s].
        """
        if feedback.suspect is not None:
            wheel = self._names[feedback.suspect]
            return f"wheel '{wheel}': position and velocity disagree, its encoder is lost"
        drive, health = self._parameters.drive, self._parameters.health
        reference, speeds = cascade.reference, feedback.speeds
        late = _above(reference - speeds, drive.following_error)
        k = self._following.update(late, drive.following_time, dt)
        if k is not None:
            return f"wheel '{self._names[k]}' does not follow its setpoint"
        if not driven:
            self._detector.rest()
            self._blocked.clear()
            return ""
        if feedback.time != self._seen:  # a report that is held says nothing new
            passed, self._seen = feedback.time - self._seen, feedback.time
            k = self._blocked.update(self._stands(reference, speeds), health.blocked_time, passed)
            if k is not None:
                return f"wheel '{self._names[k]}' is blocked: torque, but no speed"
        dead = self._detector.update(cascade.asked, reference, now, dt)
        return self._lose(dead, cascade) if dead else ""

    def _stands(self, reference: Array, speeds: Array) -> Flags | None:
        """(n,) bool: wheels that stand though a torque pushes them where they are told to go."""
        torque = self._detector.torque
        if not self._detector.reported or _above(torque, self._least_blocked) is None:
            return None
        pushed, size = np.abs(torque) > self._blocked_torque, np.abs(reference)
        ahead = (torque * reference > 0.0) & (size > LEAST_REFERENCE)
        stands: Flags = pushed & ahead & (np.abs(speeds) < STANDING_SHARE * size)
        return stands

    def _lose(self, dead: tuple[int, ...], cascade: WheelCascade) -> str:
        """Do without wheels that were found dead, or say why the robot must stop."""
        self.dead = tuple(sorted({*self.dead, *dead}))
        lost = f"{name_list(self._names, dead)} dead: no torque"
        if self._parameters.drive.dead_wheel == "stop":
            return lost
        if self.idle or len(dead) > 1:
            return f"{lost}; it is not the only one"
        if cascade.kinematics.remains(dead) < MARGIN:
            return f"{lost}; the others do not determine the twist"
        self.idle = self._found = dead
        return ""


def _above(values: Array, bound: float) -> Flags | None:
    """(n,) bool: which magnitudes are above a bound; None for none, which is told sooner."""
    if max(map(abs, values.tolist())) <= bound:
        return None
    above: Flags = np.abs(values) > bound
    return above


def told(parameters: PlatformParameters) -> tuple[int, ...]:
    """Indices of the wheels that `drive.dead` names."""
    names = parameters.robot.wheels.names
    return tuple(i for i, name in enumerate(names) if name in parameters.drive.dead)


def name_list(names: tuple[str, ...], wheels: tuple[int, ...]) -> str:
    """Wheels by name with a verb: `wheel 'a' is`, `wheels 'a', 'b' are`."""
    listed = ", ".join(f"'{names[i]}'" for i in wheels)
    return f"wheels {listed} are" if len(wheels) > 1 else f"wheel {listed} is"


def reduced(limits: TwistLimits, share: float) -> TwistLimits:
    """Limits with velocities and accelerations times a share; stops stay as hard."""
    return replace(
        limits,
        linear_velocity=share * limits.linear_velocity,
        angular_velocity=share * limits.angular_velocity,
        linear_acceleration=share * limits.linear_acceleration,
        angular_acceleration=share * limits.angular_acceleration,
    )
