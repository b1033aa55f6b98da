"""Who drives a robot, what is stopped and what would release it, from what its nodes say; no ROS.

What a report decides, it decides by keys and values. The nodes' own texts it shows as they are.
"""

import enum
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from omniman_ros.console.formatting import pose_text
from omniman_ros.core.arbiter import Source
from omniman_ros.core.planar import Triple
from omniman_ros.core.stop import StopState

CONTROLLER = "platform_controller"
MONITOR = "collision_monitor"
#: Age at which a node counts as silent, or as gone [s]: its diagnostics come once a second of the
#: robot's time, which may be simulated and slow
SILENCE = 10.0
ODOM_SILENCE = 2.0  #: Age at which `odom` counts as silent [s]; it comes 100 times a second
FINE = 10.0  #: Age below which tenths are told [s]
ERROR = 2  #: Level of an error in the diagnostics; 0 is ok, 1 a warning


class Trouble(enum.Enum):
    """What keeps a node from moving, and the robot from being healthy."""

    STOPPED = "stopped"
    ENDING = "ending"  #: It is stopped because it ends in order
    HOLDING = "holding"  #: Another node is stopped
    SILENT = "silent"  #: It is in the graph, and says nothing
    FAULTY = "faulty"  #: Its diagnostics have an error, without a stop


#: What releases a node from its trouble; `{of}` is the option with the robot's namespace, if any
RELEASES = {
    Trouble.STOPPED: "`omniman reset{of}`; a node refuses while emergency_stop is true, "
    "while its fault is present, and while it moves",
    Trouble.ENDING: "start the node that ends anew",
    Trouble.HOLDING: "the reset of the node that is stopped: `omniman reset{of}`",
    Trouble.SILENT: "start the silent node anew, then `omniman reset{of}`; on simulated time, "
    "the node that publishes /clock first",
    Trouble.FAULTY: "mend what the node says",
}
NO_ODOM = "give the robot wheel_states: start its drives, and platform_controller"
LIMITED = "clear the robot's way: the limit of collision_monitor is not latched"
UNCOMMANDED = "start platform_controller: the drives get no commands, and rest by themselves"
#: What makes a robot drive that stands and has no trouble; `{of}` as above
FREE = "drive: `omniman teleop{of}`, `omniman goal{of}`, or a publisher of cmd_vel"

#: Motions of which a node tells: name, node, and keys of state, progress and last words
MOTIONS = (
    ("goal", "mpc_planner", "state", "", "last"),
    ("path", "path_interpolator", "state", "path_progress", "last"),
    ("arm", "path_interpolator", "arm", "arm_progress", "arm_last"),
    ("whole body", "path_interpolator", "body", "body_progress", "body_last"),
    ("whole body", "whole_body_planner", "body", "body_progress", "body_last"),
    ("station", "station_keeper", "state", "", ""),
)
IDLE = "idle"  #: State of a motion that is none


@dataclass(frozen=True)
class Words:
    """The latest message of a node, on `stop_state` or in the diagnostics."""

    level: int  #: 0 ok, 1 warning, 2 error, 3 stale
    text: str
    values: Mapping[str, str]
    age: float = 0.0  #: Time since it was received [s]

    def number(self, key: str) -> float | None:
        """Return a finite number among the values; None if there is none of that key."""
        try:
            value = float(self.values.get(key, ""))
        except ValueError:
            return None
        return value if math.isfinite(value) else None


@dataclass(frozen=True, kw_only=True)
class RobotWords:
    """All that is known of a robot."""

    prefix: str = ""  #: Absolute namespace, without a slash at its end
    nodes: frozenset[str] = frozenset()  #: Full names of all nodes
    movers: frozenset[str] = frozenset()  #: Those that move something
    stops: Mapping[str, Words]  #: `stop_state` by full name
    diagnostics: Mapping[str, Words]  #: By full name
    source: str | None = None  #: `active_source`
    pose: Triple | None = None  #: In odom [m, m, rad]
    pose_age: float = math.inf  #: [s]
    speed: tuple[float, float] | None = None  #: Of the platform [m/s], and its yaw rate [rad/s]
    stands: bool = False  #: Whether that speed counts as rest
    joints: int = 0  #: Number of joints of an arm that reports them
    joints_age: float = math.inf  #: [s]

    def of(self, node: str) -> Words | None:
        """Return the diagnostics of a node by its name without namespace, unless it is silent."""
        words = self.diagnostics.get(f"{self.prefix}/{node}")
        return None if words is None or words.age > SILENCE else words


@dataclass(frozen=True)
class StatusReport:
    """What is told of a robot."""

    lines: tuple[str, ...]
    is_healthy: bool


def report(robot: RobotWords) -> StatusReport:
    """Return the report on a robot; an empty robot is one that does not answer."""
    troubles = {name: trouble(robot, name) for name in sorted(robot.movers)}
    releases = tuple(dict.fromkeys(_releases(robot, troubles)))
    is_healthy = not any(troubles.values()) and not _has_error(robot) and _is_located(robot)
    rows = [*_state_rows(robot), *_motion_rows(robot)]
    lines = [f"{name:<12}{plain(text)}" for name, text in rows]
    lines += ["", "nodes that move something"]
    width = max((len(name) for name in troubles), default=0)
    lines += [
        f"  {name:<{width}}  {plain(_mover_text(robot, name, found))}"
        for name, found in troubles.items()
    ]
    if warnings := list(_warnings(robot)):
        lines += ["", "warnings", *(f"  {name}: {plain(text)}" for name, text in warnings)]
    if releases:
        lines += ["", "to move" if is_healthy else "to move again"]
        lines += [f"  {text}" for text in releases]
    return StatusReport(tuple(lines), is_healthy)


def trouble(robot: RobotWords, name: str) -> Trouble | None:
    """Return what keeps a node that moves something from moving; None if nothing does."""
    words, stop = robot.diagnostics.get(name), robot.stops.get(name)
    is_ending = stop is not None and stop.values.get("ending") == str(True)
    if is_ending:
        return Trouble.ENDING
    if words is None or words.age > SILENCE:
        return Trouble.SILENT
    state = None if stop is None else stop.values.get("state")
    if state == StopState.STOPPED.value:
        return Trouble.STOPPED
    if state == StopState.HOLDING.value:
        return Trouble.HOLDING
    return Trouble.FAULTY if words.level >= ERROR else None


def plain(text: str) -> str:
    """Return a node's text without what a terminal would take for a command."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def _is_located(robot: RobotWords) -> bool:
    """Return whether the controller tells where the robot is, and who drives it."""
    return robot.pose_age <= ODOM_SILENCE and robot.source is not None


def _has_error(robot: RobotWords) -> bool:
    """Return whether a node that moves nothing has an error."""
    others = [words for name, words in robot.diagnostics.items() if name not in robot.movers]
    return any(words.level >= ERROR and words.age <= SILENCE for words in others)


def _releases(robot: RobotWords, troubles: Mapping[str, Trouble | None]) -> Iterator[str]:
    of = f" --namespace {robot.prefix}" if robot.prefix else ""
    found = {kind for kind in troubles.values() if kind is not None}
    if found & {Trouble.STOPPED, Trouble.ENDING, Trouble.SILENT}:
        found.discard(Trouble.HOLDING)  # it ends with the others' trouble
    if _has_error(robot):
        found.add(Trouble.FAULTY)
    yield from (text.format(of=of) for kind, text in RELEASES.items() if kind in found)
    if found:
        return
    if not _is_located(robot):
        yield NO_ODOM
    elif _limit(robot) == 0.0:
        yield LIMITED
    elif any(_is_uncommanded(robot, name) for name in troubles):
        yield UNCOMMANDED
    elif robot.source not in {source.value for source in Source}:
        yield FREE.format(of=of)


def _state_rows(robot: RobotWords) -> Iterator[tuple[str, str]]:
    if robot.source is None:
        yield "driven by", f"unknown: no {CONTROLLER} answers"
    else:
        yield "driven by", robot.source
    if robot.pose is None:
        yield "pose", "unknown: no odom"
    else:
        yield "pose", f"{pose_text(robot.pose)}, {_seconds(robot.pose_age)} old"
    if robot.speed is not None and robot.pose_age <= ODOM_SILENCE:
        linear, angular = robot.speed
        moving = f"{linear:.2f} m/s, {math.degrees(angular):+.0f} deg/s"
        yield "moves", "no: it stands" if robot.stands else moving
    limit = _limit(robot)
    if limit is not None:
        monitor = robot.of(MONITOR)
        yield "limit", f"{100.0 * limit:.0f} %" + (f", {monitor.text}" if monitor else "")
    if robot.joints:
        yield "joints", f"{robot.joints} of the arm, {_seconds(robot.joints_age)} old"


def _limit(robot: RobotWords) -> float | None:
    """Return the fraction of the speed limits that is left to the platform."""
    controller = robot.of(CONTROLLER)
    return None if controller is None else controller.number("motion_limit")


def _motions(robot: RobotWords) -> Iterator[tuple[str, str, str, Words, str]]:
    """Yield what nodes tell of motions: name, keys of state and progress, words, key of the last.

    The keys are those of `MOTIONS`.
    """
    for name, node, key, progress_key, last_key in MOTIONS:
        words = robot.of(node)
        if words is not None and key in words.values:
            yield name, key, progress_key, words, last_key


def _motion_rows(robot: RobotWords) -> Iterator[tuple[str, str]]:
    for name, key, progress_key, words, last_key in _motions(robot):
        state, progress = words.values[key], words.number(progress_key)
        parts = [state]
        if state != IDLE and progress is not None:
            parts.append(f"{100.0 * progress:.0f} %")
        if state != IDLE and words.number("distance_m") is not None:
            parts.append(f"{words.number('distance_m'):.2f} m left")
        last = words.values.get(last_key, "")
        yield name, ", ".join(parts) + (f" ({last})" if last and last != state else "")


def _mover_text(robot: RobotWords, name: str, found: Trouble | None) -> str:
    """Return the state of a node that moves something, and why it is in it, in its own words."""
    words, stop = robot.diagnostics.get(name), robot.stops.get(name)
    if found is None:
        if _is_uncommanded(robot, name):
            return "running; no commands reach it"
        return "running"
    if found is Trouble.SILENT:
        last = f"; its last state: {stop.text}" if stop else ""
        return _silence_text(words).replace("silent", "SILENT") + last
    if found is Trouble.FAULTY and words is not None:
        return f"FAULTY: {words.text}"
    reason = "" if stop is None else stop.values.get("reason", stop.text)
    return f"{found.value.upper()}: {reason}"


def _is_uncommanded(robot: RobotWords, name: str) -> bool:
    """Return whether simulated drives have come to rest because they get no commands."""
    words = robot.diagnostics.get(name)
    return words is not None and words.values.get("ramping_to_rest_by_itself") == str(True)


def _warnings(robot: RobotWords) -> Iterator[tuple[str, str]]:
    """Yield nodes that warn, and what of, unless another line tells it."""
    told = {words.values.get(last) for _, _, _, words, last in _motions(robot)}
    for name in sorted(robot.nodes | robot.diagnostics.keys()):
        words = robot.diagnostics.get(name)
        if name in robot.movers and trouble(robot, name) is not None:
            continue
        if words is None or words.age > SILENCE:
            yield name, _silence_text(words)
        elif words.level > 0 and words.text not in told:
            yield name, words.text


def _silence_text(words: Words | None) -> str:
    return "silent: nothing yet" if words is None else f"silent for {_seconds(words.age)}"


def _seconds(age: float) -> str:
    return f"{age:.1f} s" if age < FINE else f"{age:.0f} s"
