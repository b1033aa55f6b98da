"""Monitor the health of the wheels: stop the robot, or drive on without dead wheels."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from omniman_ros.control.dead_wheel import DeadWheelDetector
from omniman_ros.control.kinematics import MIN_REMAINING_FRACTION
from omniman_ros.control.limits import TwistLimits
from omniman_ros.control.odometry import REST_SPEED
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.control.wheel_cascade import WheelCascade
from omniman_ros.control.wheel_feedback import WheelFeedback
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError

#: State of a wheel that the platform drives without, see :meth:`WheelHealthMonitor.state`
IDLE = "idle"

Flags = NDArray[np.bool_]  #: One flag per wheel, (n,) bool

#: Fraction of its reference speed below which a wheel counts as standing still despite a torque
REST_SPEED_FRACTION = 0.1
#: Reference speed above which a wheel at rest can count as blocked [rad/s]. Below it, a wheel that
#: starts against friction or against the other wheels may be at rest, too.
MIN_BLOCKED_REFERENCE = 0.5
#: Fraction of J's smallest singular value below which the driving wheels determine the twist
#: weakly: limits fall in proportion, and the drives run in velocity mode. The gain from a speed
#: error to torque grows with 1 / share^2, so that wheels under torque control swing once they lose
#: grip.
MIN_SINGULAR_VALUE_RATIO = 0.5


class PersistenceMonitor:
    """Finds a wheel for which a condition has been true for long enough."""

    def __init__(self, count: int) -> None:
        self._duration: Array = np.zeros(count)
        self._before: Flags = np.zeros(count, dtype=bool)
        self._any = False

    def clear(self) -> None:
        """Restart the count for all wheels."""
        if self._any:
            self._duration = np.zeros_like(self._duration)
            self._before = np.zeros_like(self._before)
            self._any = False

    def update(self, condition: Flags | None, min_duration: float, dt: float) -> int | None:
        """Return the index of a wheel that is found, or None; the count of that wheel begins anew.

        A period counts if the condition was true at both its ends.

        Args:
            condition: (n,) bool, or None if the condition is true for no wheel.
        """
        if condition is None or True not in condition.tolist():
            self.clear()
            return None
        self._any = True
        self._duration = np.where(condition & self._before, self._duration + dt, 0.0)
        self._before = condition
        worst = int(self._duration.argmax())
        if self._duration[worst] <= min_duration:
            return None
        self.clear()
        return worst


class WheelHealthMonitor:
    """Watches the wheels and decides which of them the platform drives without.

    The robot stops for a wheel that does not follow its setpoint, that stands still despite a
    torque (blocked), or whose encoder is lost. It also stops for a dead wheel (a wheel without
    torque), unless `drive.dead_wheel` is `drive_on` and the wheels left determine the twist well:
    then the dead wheel becomes idle. That holds for every further wheel as well.

    Attributes:
        dead: Indices of wheels found dead since the last reset, whether or not they stopped the
            robot.
        idle: Indices of wheels to drive without: named by `drive.dead`, or found dead.
        limit_scale: Factor on the velocity and acceleration limits [-]: 1, or less if wheels are
            idle.
        all_blocked: Whether all driving wheels were found blocked at once: the robot is held.
        weak: Whether the driving wheels determine the twist weakly, see WEAK_SHARE.
    """

    def __init__(self, parameters: PlatformParameters, cascade: WheelCascade) -> None:
        n = parameters.robot.wheel_count
        self._following, self._blocked = PersistenceMonitor(n), PersistenceMonitor(n)
        self._detector = DeadWheelDetector(
            cascade.dynamics.torque_limit, parameters.health, cascade.kinematics
        )
        self.dead: tuple[int, ...] = ()
        self.all_blocked = False
        self._found: tuple[int, ...] = ()
        self._report_time = 0.0
        self.configure(parameters, cascade)

    def configure(self, parameters: PlatformParameters, cascade: WheelCascade) -> None:
        """Set new thresholds and models, idle wheels included."""
        self._parameters = parameters
        self.idle = cascade.kinematics.idle
        fraction = cascade.kinematics.remaining_fraction(self.idle)
        self.weak = fraction < MIN_SINGULAR_VALUE_RATIO
        dead_limits = parameters.drive.dead_limits * min(1.0, fraction / MIN_SINGULAR_VALUE_RATIO)
        self.limit_scale = dead_limits if self.idle else 1.0
        self.limits = scaled_limits(parameters.limits, self.limit_scale)
        self._names = parameters.robot.wheels.names
        torque_limit = cascade.dynamics.torque_limit
        self._detector.configure(torque_limit, parameters.health, cascade.kinematics)
        blocked_torque = parameters.health.blocked_torque * torque_limit
        # Idle wheels have no torque limit: they are never blocked.
        self._blocked_torque = np.where(torque_limit > 0.0, blocked_torque, np.inf)
        self._min_blocked_torque = float(self._blocked_torque.min())

    def reset(self) -> None:
        """Count all wheels as healthy again except those that `drive.dead` names."""
        self.dead = self._found = ()
        self.all_blocked = False
        self.idle = self.idle_wheels(self._parameters)

    def idle_wheels(self, parameters: PlatformParameters) -> tuple[int, ...]:
        """Return the indices of wheels to drive without: those named and those found dead."""
        return tuple(sorted({*dead_wheel_indices(parameters), *self._found}))

    @property
    def torque_reported(self) -> bool:
        """Whether the drives report torques; without them no dead wheel is found."""
        return self._detector.reported

    @property
    def notice(self) -> str:
        """Sentence about the idle wheels for log and status; empty if there are none."""
        if not self.idle:
            return ""
        mode = (
            ", in velocity mode" if self.weak and self._parameters.drive.mode != "velocity" else ""
        )
        source = "" if self._found else ", as drive.dead says"
        return f"{name_list(self._names, self.idle)} dead: driving on without{mode}{source}"

    @property
    def summary(self) -> str:
        """Sentence about all wheels."""
        if self.stopping:
            return f"{name_list(self._names, sorted({*self.dead, *self.idle}))} dead"
        return self.notice or "all wheels drive"

    @property
    def stopping(self) -> bool:
        """Whether a wheel was found dead without which the robot does not drive on."""
        return not set(self.dead) <= set(self.idle)

    def state(self, wheel: int) -> str:
        """Return the state of a wheel: driving, dead, or idle (dead, and driven on without)."""
        if wheel in self.idle:
            return IDLE
        return "dead" if wheel in self.dead else "driving"

    def update_torques(self, time: float, effort: Array | None) -> None:
        """Process the torques that the drives report.

        Args:
            effort: Torques (n,) [N m], or None if the drives report none.

        Raises:
            InputError: The array has the wrong size.
        """
        n = len(self._names)
        if effort is not None and effort.shape != (n,):
            raise InputError(f"wheel_states: has {effort.size} efforts for {n} wheels")
        self._detector.update_torques(time, effort)

    def probe(self, now: float) -> Array | None:
        """Return the torques (n,) [N m] of a probe to add to the command at `now`, or None."""
        return self._detector.probe(now)

    def check(
        self, cascade: WheelCascade, feedback: WheelFeedback, driven: bool, now: float, dt: float
    ) -> str:
        """Return why the robot must stop, if it must; call this once a tick. `idle` may grow.

        Args:
            cascade: Cascade with the wheel speeds and torques that the last tick demanded.
        """
        if feedback.suspect is not None:
            wheel = self._names[feedback.suspect]
            return f"wheel '{wheel}': position and velocity disagree, its encoder is lost"
        drive, health = self._parameters.drive, self._parameters.health
        reference, speeds = cascade.reference, feedback.speeds
        error = reference - speeds
        not_following = _above(error, drive.following_error)
        wheel_index = self._following.update(not_following, drive.following_time, dt)
        if wheel_index is not None:
            return f"wheel '{self._names[wheel_index]}' does not follow its setpoint"
        if not driven:
            self._detector.rest()
            self._blocked.clear()
            return ""
        if feedback.time != self._report_time:  # a repeated report has no new information
            elapsed = feedback.time - self._report_time
            self._report_time = feedback.time
            standing = self._standing(reference, speeds)
            wheel_index = self._blocked.update(standing, health.blocked_time, elapsed)
            if wheel_index is not None and standing is not None:
                return self._blocked_reason(wheel_index, standing)
        dead = self._detector.update(cascade.demanded_torque, reference, error, now, dt)
        return self._exclude(dead, cascade) if dead else ""

    def _blocked_reason(self, wheel: int, standing: Flags) -> str:
        driving = len(self._names) - len(self.idle)
        self.all_blocked = int(standing.sum()) == driving
        if self.all_blocked:
            return "the robot is held: all wheels stand still despite their torques"
        return f"wheel '{self._names[wheel]}' is blocked: torque, but no speed"

    def rest_notice(self, reference: Array, speeds: Array) -> str:
        """Return a clause about the wheels that stand still despite their reference speeds.

        Args:
            reference: Demanded speeds (n,) [rad/s].
            speeds: Measured speeds (n,) [rad/s].
        """
        resting = np.abs(speeds) <= np.maximum(REST_SPEED_FRACTION * np.abs(reference), REST_SPEED)
        if resting.all():
            return "all wheels stand still"
        if not resting.any():
            return "all wheels turn"
        return f"{name_list(self._names, np.flatnonzero(resting).tolist())} at rest"

    def _standing(self, reference: Array, speeds: Array) -> Flags | None:
        torque = self._detector.torque
        if not self._detector.reported or _above(torque, self._min_blocked_torque) is None:
            return None
        speed = np.abs(reference)
        driven = (torque * reference > 0.0) & (speed > MIN_BLOCKED_REFERENCE)
        driven &= np.abs(torque) > self._blocked_torque
        standing: Flags = driven & (np.abs(speeds) < REST_SPEED_FRACTION * speed)
        return standing

    def _exclude(self, dead: tuple[int, ...], cascade: WheelCascade) -> str:
        self.dead = tuple(sorted({*self.dead, *dead}))
        loss = f"{name_list(self._names, dead)} dead: no torque"
        if self._parameters.drive.dead_wheel == "stop":
            return loss
        idle = tuple(sorted({*self.idle, *dead}))
        if cascade.kinematics.remaining_fraction(idle) < MIN_REMAINING_FRACTION:
            return f"{loss}; the others do not determine the twist well"
        self._found = tuple(sorted({*self._found, *dead}))
        self.idle = idle
        return ""


def _above(values: Array, bound: float) -> Flags | None:
    if max(map(abs, values.tolist())) <= bound:
        return None
    above: Flags = np.abs(values) > bound
    return above


def dead_wheel_indices(parameters: PlatformParameters) -> tuple[int, ...]:
    """Return the indices of the wheels that `drive.dead` names."""
    names = parameters.robot.wheels.names
    return tuple(i for i, name in enumerate(names) if name in parameters.drive.dead)


def name_list(names: tuple[str, ...], wheels: Sequence[int]) -> str:
    """Return wheels by name with a verb: `wheel 'a' is`, `wheels 'a', 'b' are`."""
    listed = ", ".join(f"'{names[i]}'" for i in wheels)
    return f"wheels {listed} are" if len(wheels) > 1 else f"wheel {listed} is"


def scaled_limits(limits: TwistLimits, scale: float) -> TwistLimits:
    """Scale the velocity and acceleration limits; decelerations and jerks keep their limits."""
    return replace(
        limits,
        linear_velocity=scale * limits.linear_velocity,
        angular_velocity=scale * limits.angular_velocity,
        linear_acceleration=scale * limits.linear_acceleration,
        angular_acceleration=scale * limits.angular_acceleration,
    )
