"""A trial: one row of the table, played once against the running robot and judged."""

import math
from dataclasses import dataclass, field

from omniman_ros.console.errors import CommandError
from omniman_ros.core.arrays import Array
from omniman_ros.lab.faults.driver import ARM_SPEED, RAMP, SPEED
from omniman_ros.lab.faults.injections import EmergencyStop
from omniman_ros.lab.faults.judge import StopMeasurement, judge_stop, largest_change
from omniman_ros.lab.faults.player import Player
from omniman_ros.lab.faults.rows import GoingOn, RequiredOutcome, Row, Subject
from omniman_ros.lab.faults.running_robot import RunningRobot

STILL_PLATFORM, STILL_ARM = 0.01, 0.05
"""Speeds below which platform [m/s] and arm [rad/s] are at rest; the arm's servo dies down."""
LARGEST_SPEED = 1.05  #: largest speed of the platform, 5 % above the robot's limit [m/s]
DECELERATION = 1.2  #: deceleration limit of the robot [m/s^2]; that of its drives is 1.14 m/s^2
ARM_DECELERATION = 5.0  #: deceleration limit of the arm [rad/s^2]
PROTECTIVE_DECELERATION = 15.0  #: deceleration of the arm in a stop by its controller [rad/s^2]
#: Factor by which a measured deceleration may exceed its limit: the drives follow with a lag
TOLERANCE = 1.25
#: Time by which a stop may last longer than a straight ramp from the reaction on [s]
REST_MARGIN = 0.4
OBSERVED_REST = 0.5  #: time for which the robot is observed at rest [s]
HARMLESS_TIME = 1.0  #: time for which the robot is observed after a harmless fault [s]
MOVED = 2e-3  #: way beyond which a robot that ought to stand has moved [m or rad]
STEADY = 0.3  #: time for which the robot must have had its speed before a fault [s]
READY_TIMEOUT = 40.0  #: longest time until a robot whose processes were started is ready [s]
SPEED_TIMEOUT = RAMP + 2.5  #: longest time until the robot has its speed [s]
ATTEMPTS = 15  #: number of attempts to bring the robot to speed
#: Time for which the machine held drives or arm up beyond which a trial is not judged, whether it
#: passed or failed [s]; their reports are 10 ms apart.
LONGEST_HOLD_UP = 0.04
RESUME_TIMEOUT = 5.0  #: longest time until a robot that goes on by itself has done so [s]


@dataclass
class Trial:
    """What was measured in a trial."""

    platform: StopMeasurement  #: stop of the platform
    arm: StopMeasurement  #: stop of the arm
    failures: list[str]  #: what was not as it must be; empty if the trial passed
    held_up: float = 0.0  #: longest time for which the machine held drives or arm up [s]
    #: Number of stops before the fault, each with its reason
    false_stops: list[str] = field(default_factory=list)
    recovery: float = math.nan  #: time until the robot was ready again [s]

    @property
    def is_judged(self) -> bool:
        """Whether the trial tells anything about the robot: the machine did not hold it up."""
        return self.held_up <= LONGEST_HOLD_UP


def play(player: Player[RunningRobot], row: Row) -> Trial:
    """Play a row once, and judge it."""
    false_stops, recovery = settle(player, row)
    robot = player.robot
    start = robot.now
    player.inject(row.injection)
    ramp = SPEED / DECELERATION * TOLERANCE
    watched = row.unnoticed + row.reaction + ramp + REST_MARGIN + row.slowly + OBSERVED_REST
    stops = row.platform or row.arm
    end = start + (watched if stops else HARMLESS_TIME)
    robot.observe(end)
    stopped, source = robot.stopped, robot.source
    held_up = robot.truth.longest_hold_up
    platform, arm = (
        judge_stop(samples[:, 0], samples[:, 1], start, end, still)
        for samples, still in (
            (robot.truth.platform, STILL_PLATFORM),
            (robot.truth.arm, STILL_ARM),
        )
    )
    failures = [
        *_stop_failures(row, platform, arm),
        *_state_failures(row, stopped, source),
    ]
    failures += _later_failures(player, row)
    player.driver.halt()
    return Trial(platform, arm, failures, held_up, false_stops, recovery)


def settle(player: Player[RunningRobot], row: Row) -> tuple[list[str], float]:
    """Bring the robot to speed: start what has ended, reset what is stopped, and drive.

    Returns:
        Reasons of stops on the way, and the time until the robot was ready [s].
    """
    robot, began = player.robot, player.robot.session.now()
    recovery, false_stops = math.nan, list[str]()
    for _ in range(ATTEMPTS):
        player.driver.halt()
        player.repair()
        if not robot.release(READY_TIMEOUT):
            raise CommandError(f"the robot cannot be reset: {robot.reasons}")
        recovery = recovery if recovery == recovery else robot.session.now() - began
        robot.wait(lambda: max(robot.truth.speeds) < STILL_ARM, READY_TIMEOUT)
        robot.pause(1.3)  # a source that lost control must have been silent
        robot.truth.clear()
        robot.pause(0.05)
        player.prepare(row.injection)
        player.driver.begin_motion(row.motion)
        if robot.wait(lambda: _at_speed(player), SPEED_TIMEOUT):
            robot.pause(STEADY)
            if robot.is_released and _at_speed(player):
                return false_stops, recovery
        false_stops.append("; ".join(robot.reasons[name] for name in robot.stopped) or "no speed")
    raise CommandError(f"the robot does not come to speed: {', '.join(false_stops)}")


def _at_speed(player: Player[RunningRobot]) -> bool:
    platform, arm = player.robot.truth.speeds
    return platform > 0.95 * SPEED and arm > 0.95 * ARM_SPEED


def _stop_failures(row: Row, platform: StopMeasurement, arm: StopMeasurement) -> list[str]:
    """Return what was wrong with the stops themselves."""
    failures = []
    bound = row.unnoticed + row.reaction
    of_arm = PROTECTIVE_DECELERATION if row.subject is Subject.ARM else ARM_DECELERATION
    for name, stop, must, deceleration in (
        ("platform", platform, row.platform, DECELERATION),
        ("arm", arm, row.arm, of_arm),
    ):
        if must:
            longest = bound + stop.speed / deceleration * TOLERANCE + REST_MARGIN + row.slowly
            if not stop.reaction <= bound:
                failures.append(f"{name}: reaction after {stop.reaction:.3f} s, {bound:g} allowed")
            if not stop.rest <= longest:
                failures.append(f"{name}: rest after {stop.rest:.3f} s, {longest:.2f} allowed")
        if stop.deceleration > deceleration * TOLERANCE:
            failures.append(
                f"{name}: deceleration {stop.deceleration:.2f}, {deceleration:g} limit"
            )
    if row.outcome is RequiredOutcome.UNHARMED:
        failures += [
            f"{name}: braked after {stop.reaction:.3f} s"
            for name, stop in (("platform", platform), ("arm", arm))
            if math.isfinite(stop.reaction)
        ]
    if platform.fastest > LARGEST_SPEED:
        failures.append(f"platform: {platform.fastest:.2f} m/s, {LARGEST_SPEED:g} allowed")
    return failures


def _state_failures(row: Row, stopped: set[str], source: str) -> list[str]:
    """Return which nodes do not report what they must."""
    failures = [f"{name} is not stopped" for name in row.stopped if name not in stopped]
    if row.outcome is not RequiredOutcome.LATCHED:
        failures += [f"{name} is stopped" for name in sorted(stopped)]
    if row.source and source != row.source:
        failures.append(f"active_source is {source}, not {row.source}")
    return failures


def _later_failures(player: Player[RunningRobot], row: Row) -> list[str]:
    """Return what goes wrong once the fault is removed, while the sources go on."""
    robot, failures = player.robot, []
    since = robot.now
    if row.outcome is RequiredOutcome.LATCHED:
        if isinstance(row.injection, EmergencyStop):
            failures += _refusal_failures(player, row)
        player.remove(row.injection)
        robot.observe(robot.now + OBSERVED_REST)
        failures += _motion_failures(player, since, "before a reset", row.leftover)
        since = robot.now
        robot.release(0.0 if row.going_on is GoingOn.RESTART else READY_TIMEOUT)
        robot.observe(robot.now + OBSERVED_REST)
        return failures + _motion_failures(player, since, "by a reset")
    player.remove(row.injection)
    if row.outcome is RequiredOutcome.ENDED:
        robot.observe(robot.now + OBSERVED_REST)
        return _motion_failures(player, since, "by itself")
    goes_on = row.outcome is RequiredOutcome.PAUSED and row.going_on is not GoingOn.RESTART
    if goes_on and not robot.wait(lambda: robot.truth.speeds[0] > 0.5 * SPEED, RESUME_TIMEOUT):
        failures.append("the platform does not go on")
    return failures


def _refusal_failures(player: Player[RunningRobot], row: Row) -> list[str]:
    """Return which nodes grant a reset while the emergency stop is pressed."""
    for name in row.stopped:
        player.robot.services.trigger(name, "reset")
    player.robot.pause(OBSERVED_REST)
    granted = [name for name in row.stopped if name not in player.robot.stopped]
    return [f"{name} was reset although the emergency stop is pressed" for name in granted]


def _motion_failures(
    player: Player[RunningRobot], since: float, when: str, allowed: float = MOVED
) -> list[str]:
    """Return what has moved by more than is allowed [m or rad] since a time [s]."""

    def way(samples: Array) -> float:
        return largest_change(samples[:, 0], samples[:, 2:], since, math.inf)

    truth = player.robot.truth
    moved = (("platform", way(truth.platform)), ("arm", way(truth.arm)))
    return [f"{name}: moved by {by:.4f} {when}" for name, by in moved if by > allowed]
