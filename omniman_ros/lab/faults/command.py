"""`omniman fault NAME`: inject a fault of the table into a simulation that runs."""

import argparse
import math
from collections.abc import Callable, Iterable
from signal import SIGKILL

from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import ANNOUNCEMENT_TIME, Session
from omniman_ros.console.terminal import say
from omniman_ros.lab.faults.driver import SPEED
from omniman_ros.lab.faults.found_robot import FoundRobot, demand_simulation
from omniman_ros.lab.faults.injections import (
    BRIDGE,
    DRIVES,
    MONITOR,
    STREAMER,
    STREAMING_PROCESS,
    ServiceStop,
    Setting,
    Signal,
    TwistFault,
)
from omniman_ros.lab.faults.page import reaction
from omniman_ros.lab.faults.player import Player
from omniman_ros.lab.faults.rows import Row
from omniman_ros.lab.faults.table import ROWS
from omniman_ros.processes.process_group import redirect_signals

LEAD = 2.0  #: time for which the platform drives before its twists fail [s]
CONNECTING = 0.5  #: time in which publishers and subscribers find each other [s]
OBSERVED = 3.0  #: time for which the robot is observed after a fault that does not last [s]
CLOCK_TIMEOUT = 5.0  #: longest time until the first message on /clock [s]
LOOK_PERIOD = 0.1  #: time between two looks at what the robot reports [s]
HINTS = {
    BRIDGE: "omniman up --drive can",
    DRIVES: "omniman up --drive can",
    MONITOR: "omniman up --collision-monitor",
}  #: What starts a node that is not always there


def run(args: argparse.Namespace) -> int:
    """Run `omniman fault`.

    The exit code is 0 if the fault was injected, whatever the robot does; CommandError is raised
    if it cannot be, or if the robot is not a simulation.
    """
    if args.list:
        say("\n".join(listed()))
        return 0
    row = row_of(args.name)
    duration = math.inf if args.duration is None else args.duration
    if not duration > 0.0:
        raise CommandError(f"--duration must be above 0, got {duration:g}", 2)
    with Session("fault_finder", args.namespace) as session:
        session.spin(ANNOUNCEMENT_TIME)  # a real drive must not be overlooked
        nodes = nodes_of(session)
        has_clock = session.node.count_publishers("/clock") > 0
    demand_simulation(nodes)
    demand_needed(row, nodes)
    signals: list[int] = []
    with (
        redirect_signals(signals.append),
        Session("fault", args.namespace, sim_time=has_clock) as session,
    ):
        robot = FoundRobot(session, args.namespace)
        if not robot.wait(lambda: session.now() > 0.0, CLOCK_TIMEOUT):
            raise CommandError("/clock has a publisher, and stands")
        inject(robot, row, duration, lambda: bool(signals))
    return 0


def listed() -> list[str]:
    """Return the lines of a list of all faults and of what is expected."""
    width = max(len(row.short_name) for row in ROWS)
    lines = []
    for row in ROWS:
        where = ", in the laboratory only" if row.needs_laboratory else ""
        outcome = f"{row.outcome.value}{where}"
        lines.append(f"{row.short_name:<{width}}  {row.fault} -> {outcome}")
    return lines


def row_of(name: str | None) -> Row:
    """Return the row with a short name; CommandError if it cannot be injected from a terminal."""
    for row in ROWS:
        if row.short_name == name:
            if row.needs_laboratory:
                raise CommandError(
                    f"{name}: in the laboratory only: omniman bench faults --row '{row.name}'", 2
                )
            return row
    raise CommandError(f"there is no fault '{name}'; see omniman fault --list", 2)


def nodes_of(session: Session) -> list[str]:
    """Return the names of the nodes in the session's namespace."""
    own = session.node.get_namespace()
    found = session.node.get_node_names_and_namespaces()
    return [name for name, namespace in found if namespace == own]


def demand_needed(row: Row, nodes: Iterable[str]) -> None:
    """Raise CommandError unless the node of a fault runs."""
    match row.injection:
        case Signal(process, _, _):
            needed = STREAMER if process == STREAMING_PROCESS else process
        case Setting(node=needed) | ServiceStop(needed):
            pass
        case _:
            return
    if needed not in nodes:
        hint = f": {HINTS[needed]}" if needed in HINTS else ""
        raise CommandError(f"{row.short_name} needs {needed}, which does not run{hint}")


def inject(robot: FoundRobot, row: Row, duration: float, is_ended: Callable[[], bool]) -> None:
    """Inject a fault, say what the robot reports, and remove it at the end.

    Args:
        duration: How long the fault lasts [s], unless it is over at once.
        is_ended: Whether the user has ended it.
    """
    player, injection = Player(robot), row.injection
    say(f"{row.short_name}: {row.fault}")
    expected = [f"the robot {row.outcome.value}", reaction(row), row.told]
    say(f"expected: {'; '.join(text for text in expected if text)}")
    player.prepare(injection)
    robot.pause(CONNECTING)
    if isinstance(injection, TwistFault):
        say(f"driving forward at {SPEED:g} m/s")
        player.driver.begin_twist((SPEED, 0.0, 0.0))
        robot.pause(LEAD)
    watch = _Watch(robot)
    try:
        player.inject(injection)
        over = isinstance(injection, ServiceStop) or (
            isinstance(injection, Signal)
            and (injection.number is SIGKILL or injection.resume is not None)
        )
        say("injected" if over else "injected; Ctrl-C removes it")
        watch.follow(min(duration, OBSERVED) if over else duration, is_ended)
    finally:
        player.driver.halt()
        player.remove(injection)
        watch.follow(CONNECTING, lambda: False)
    platform, arm = robot.truth.speeds
    say(f"{'over' if over else 'removed'}: platform {platform:.2f} m/s, arm {arm:.2f} rad/s")
    say(f"to drive on: {row.going_on.value}")


class _Watch:
    """Says what a robot reports when it changes."""

    def __init__(self, robot: FoundRobot) -> None:
        self._robot, self._said = robot, self._reports(robot)
        for text in sorted(self._said):
            say(f"  before: {text}")

    @staticmethod
    def _reports(robot: FoundRobot) -> set[str]:
        stopped = {f"{name} {robot.reasons[name]}" for name in robot.stopped}
        return stopped | ({f"active_source: {robot.source}"} if robot.source else set())

    def follow(self, seconds: float, is_ended: Callable[[], bool]) -> None:
        """Say changes for some time [s], or until the user has ended it."""
        session = self._robot.session
        end = session.now() + seconds
        while session.now() < end and not is_ended():
            self._robot.pause(LOOK_PERIOD)
            self._robot.truth.clear()
            reports = self._reports(self._robot)
            for text in sorted(reports - self._said):
                say(f"  {text}")
            self._said = reports
