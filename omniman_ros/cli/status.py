"""`omniman status`: tell who drives, what is stopped and why, and what would release it."""

import argparse
import math
import os
import re
import sys
import time
from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from omniman_ros.cli.status_report import SILENCE, RobotWords, Words, report
from omniman_ros.client.robot import Robot
from omniman_ros.client.telemetry import REST_RATE, REST_SPEED
from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import ANNOUNCEMENT_TIME, Session
from omniman_ros.console.terminal import is_terminal, say
from omniman_ros.nodes.registry import NODES
from omniman_ros.nodes.stop_interface import ALL_LATCHED, STOP_STATE, publisher_nodes
from omniman_ros.nodes.stoppable_nodes import find_stoppable_nodes
from omniman_ros.processes.process_group import redirect_signals

SEARCH_TIMEOUT = 6.0  #: Time within which a robot must be found [s]
#: Longest time for which all nodes of a robot that was found are listened to [s]: diagnostics come
#: once a second of the robot's time
LISTENING_TIME = 12.0
LOOK_PERIOD = 0.1  #: Time between two looks at who has been heard [s]
PAINT_PERIOD = 0.5  #: Time between two looks at what has changed [s]
CLEAR = "\033[H\033[J"  #: Escape sequence that clears a terminal
NUMBERS = re.compile(r"[-+]?[\d.]+")


class StatusListener:
    """Hears what the nodes of a robot say of themselves, with the times of it.

    It does not subscribe to `emergency_stop`: a button that waits for one subscriber must not
    take this one for a node that stops.
    """

    def __init__(self, session: Session, robot: Robot, namespace: str) -> None:
        bare = namespace.strip("/")
        self.prefix = f"/{bare}" if bare else ""
        self._node, self._robot = session.node, robot
        self._stops: dict[str, tuple[float, DiagnosticStatus]] = {}
        self._diagnostics: dict[str, tuple[float, DiagnosticStatus]] = {}
        self._seen: set[str] = set()  # in the graph, which may come after a node's messages
        for kind, topic, handler, qos in (
            (DiagnosticArray, "/diagnostics", self._on_diagnostics, 50),
            (DiagnosticStatus, f"{self.prefix}/{STOP_STATE}", self._on_stop_state, ALL_LATCHED),
        ):
            session.node.create_subscription(kind, topic, handler, qos)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.rpartition("/")[0] == self.prefix and status.name.startswith("/"):
                self._diagnostics[status.name] = (time.monotonic(), status)

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        self._stops[message.name] = (time.monotonic(), message)

    @property
    def elsewhere(self) -> list[str]:
        """Namespaces below that of the robot in which nodes move something."""
        found = find_stoppable_nodes(self._node, self.prefix)
        return sorted({name.rpartition("/")[0] for name in found} - {self.prefix})

    @property
    def is_found(self) -> bool:
        """Whether any node of the robot is there."""
        return bool(self._diagnostics or self._stops or self._movers())

    @property
    def known(self) -> frozenset[str]:
        """Full names of the nodes that were discovered or heard."""
        return self._nodes() | self._movers()

    @property
    def is_complete(self) -> bool:
        """Whether every node of the robot has been heard, and the platform."""
        is_heard = self._nodes() <= self._diagnostics.keys()
        is_heard = is_heard and self._movers() <= self._stops.keys()
        return is_heard and self._robot.pose.is_known and self._robot.active_source.is_known

    def words(self) -> RobotWords:
        """Return all that is known now."""
        self._forget_ended()
        robot = self._robot
        twist, joints = robot.twist, robot.joints
        speed = (math.hypot(*twist.value[:2]), twist.value.wz) if twist.is_known else None
        return RobotWords(
            prefix=self.prefix,
            nodes=self._nodes(),
            movers=self._movers(),
            stops=_words(self._stops),
            diagnostics=_words(self._diagnostics),
            source=self._source(),
            pose=robot.pose.value if robot.pose.is_known else None,
            pose_age=robot.pose.age,
            speed=speed,
            stands=speed is not None and speed[0] < REST_SPEED and abs(speed[1]) < REST_RATE,
            joints=len(joints.value) if joints.is_known else 0,
            joints_age=joints.age,
        )

    def _source(self) -> str | None:
        """Return who drives; None unless a controller is there that says so."""
        reading = self._robot.active_source
        is_told = self._node.count_publishers(f"{self.prefix}/active_source") > 0
        return reading.value if is_told and reading.is_known else None

    def _nodes(self) -> frozenset[str]:
        """Return the nodes of the package in the graph that publish diagnostics."""
        found = publisher_nodes(self._node, "/diagnostics")
        return frozenset(
            name
            for name in found
            if name.rpartition("/")[0] == self.prefix and name.rpartition("/")[2] in NODES
        )

    def _movers(self) -> frozenset[str]:
        """Return the nodes that move something: those of the graph, and those that were lost."""
        found = find_stoppable_nodes(self._node, self.prefix)
        present = {name for name in found if name.rpartition("/")[0] == self.prefix}
        return frozenset(present | self._stops.keys())

    def _forget_ended(self) -> None:
        """Forget nodes that have left the graph, except those that fell silent before.

        A node that ends says so to the graph. One that was killed stays in it for 20 s; it is
        remembered if it moved something.
        """
        present = self._nodes() | set(find_stoppable_nodes(self._node, self.prefix))
        now = time.monotonic()
        for name in self._seen - present:
            at, _ = self._diagnostics.get(name, (now, None))
            if now - at <= SILENCE or name not in self._stops:
                self._stops.pop(name, None)
                self._diagnostics.pop(name, None)
                self._seen.discard(name)
        self._seen |= present


def _words(heard: Mapping[str, tuple[float, DiagnosticStatus]]) -> dict[str, Words]:
    now = time.monotonic()
    return {
        name: Words(
            int.from_bytes(message.level, "little"),
            message.message,
            {item.key: item.value for item in message.values},
            now - at,
        )
        for name, (at, message) in heard.items()
    }


def run(args: argparse.Namespace) -> int:
    """Run `omniman status`.

    The exit code is 0 if the robot is healthy, and of `--watch` always; 1 if a node that moves
    something is stopped, holds, is silent or has an error, or if nothing tells where the robot
    is. CommandError if no robot answers.
    """
    signals: list[int] = []
    # Taking an events executor down can deadlock; see `nodes.rclpy_compat`.
    session = Session(f"status_{os.getpid()}", events=False)
    with (
        redirect_signals(signals.append),
        session,
        Robot(args.namespace, session.node, serve=session.spin) as robot,
    ):
        listener = StatusListener(session, robot, args.namespace)
        if args.watch:
            watch(session, listener, robot.domain, signals)
            return 0
        listen(session, listener, signals)
        if signals:
            raise KeyboardInterrupt
        if not listener.is_found:
            raise CommandError(absence(listener, robot.domain))
        told = report(listener.words())
        say("\n".join(told.lines))
        return 0 if told.is_healthy else 1


def listen(session: Session, listener: StatusListener, signals: list[int]) -> None:
    """Hear every node of a robot, as far as they speak.

    On a busy machine nodes are discovered one after the other: after each the next is waited for.
    """
    start = changed = session.now()
    known: frozenset[str] = frozenset()
    while not signals:
        session.spin(LOOK_PERIOD)
        elapsed = session.now() - start
        if listener.known != known:
            known, changed = listener.known, session.now()
        if elapsed > (LISTENING_TIME if listener.is_found else SEARCH_TIMEOUT):
            return
        if session.now() - changed > ANNOUNCEMENT_TIME and listener.is_complete:
            return


def absence(listener: StatusListener, domain: int) -> str:
    """Return a sentence on a robot that does not answer."""
    others = listener.elsewhere
    if others:
        return f"no robot in namespace '{listener.prefix or '/'}', but in {', '.join(others)}"
    return (
        f"no robot answers in ROS domain {domain}, namespace '{listener.prefix or '/'}': start "
        "`omniman up`, or set ROS_DOMAIN_ID to the robot's"
    )


def watch(session: Session, listener: StatusListener, domain: int, signals: list[int]) -> None:
    """Print the report whenever it changes, until a signal arrives.

    On a terminal it takes the place of the last one. Elsewhere it is printed below it, if it has
    changed otherwise than by its numbers.
    """
    listen(session, listener, signals)
    is_live, shown = is_terminal(sys.stdout), ""
    while not signals:
        is_found = listener.is_found
        lines = report(listener.words()).lines if is_found else (absence(listener, domain),)
        text = "\n".join(lines)
        key = text if is_live else NUMBERS.sub("", text)
        if key != shown:
            shown = key
            say(f"{CLEAR}{text}" if is_live else f"{time.strftime('--- %H:%M:%S')}\n{text}\n")
        session.spin(PAINT_PERIOD)
