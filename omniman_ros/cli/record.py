"""`omniman record`: what the robot says into a rosbag2 recording (MCAP), until Ctrl-C."""

import argparse
import importlib
import math
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from omniman_ros.bag import availability
from omniman_ros.bag.topic import Offer, Topic
from omniman_ros.cli.children import signals_to
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.session import Session
from omniman_ros.cli.terminal import YELLOW, paint, say, table
from omniman_ros.core.errors import InputError

LOOK = 0.25
"""Time between two looks for new topics [s]."""
LAST = 0.2
"""Time for what has arrived when the end comes [s]."""
DEPTH = 5000
"""Messages of a topic that may wait for this process, 25 s at 200 Hz."""
SHARED = ("/clock", "/diagnostics", "/tf", "/tf_static")
"""Topics that robots in namespaces have together."""


def run(args: argparse.Namespace) -> int:
    """Run `omniman record`.

    Returns:
        0 if all that was heard has been written; 1 if some was lost, or nothing was heard.
    """
    if not availability.is_available():
        raise CommandError(availability.HINT)
    from omniman_ros.bag.definitions import Definitions
    from omniman_ros.bag.writer import BagWriter

    if args.duration is not None and not (0.0 < args.duration < math.inf):
        raise CommandError(f"--duration must be above 0, got {args.duration:g}", 2)
    namespace = args.namespace.strip("/")
    name = datetime.now().strftime("recording_%Y-%m-%d_%H-%M-%S")
    folder = Path(args.output or name)
    try:
        writer = BagWriter(folder)
    except InputError as error:
        raise CommandError(str(error), 2) from error
    wanted = [_absolute(topic, namespace) for topic in args.topics]
    signals: list[int] = []
    say(f"omniman record: writing to {folder}; Ctrl-C ends it")
    started = time.monotonic()
    with signals_to(signals.append), writer, Session("recorder") as session:
        definitions = Definitions(prefixes())
        ears = Ears(session.node, writer, definitions, wanted, namespace)
        while not signals and not writer.failure:
            ears.look()
            left = math.inf
            if args.duration is not None:
                left = started + args.duration - time.monotonic()
            if left <= 0.0:
                break
            session.spin(min(LOOK, left))
        session.spin(LAST)
    return report(folder, writer, ears, time.monotonic() - started)


def _absolute(topic: str, namespace: str) -> str:
    if topic.startswith("/"):
        return topic
    return "/" + "/".join(part for part in (namespace, topic) if part)


def prefixes() -> list[Path]:
    """Folders in which packages are installed: a ROS machine's, and this Python's."""
    given = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [*(Path(prefix) for prefix in given if prefix), Path(sys.prefix)]


# ---- what is heard --------------------------------------------------------------------------


@dataclass
class Ear:
    """A subscription, and whether it asks for repetition and for what was said before."""

    subscription: Subscription
    reliable: bool
    latched: bool


class Ears:
    """Subscribes to topics as they appear, with the quality of service that they are offered with.

    Args:
        node: That subscribes.
        writer: Gets all that is heard.
        definitions: Of message types.
        wanted: Whole names of topics; empty: all of the robot.
        namespace: Of the robot; empty: all robots.

    Attributes:
        lost: Messages that did not reach this process, as the middleware tells, by topic.
        left_out: Topics that cannot be recorded, with the reason.
    """

    def __init__(
        self, node: Node, writer: Any, definitions: Any, wanted: Sequence[str], namespace: str
    ) -> None:
        self._node, self._writer, self._definitions = node, writer, definitions
        self._wanted, self._namespace = list(wanted), namespace
        self._ears: dict[str, Ear] = {}
        self._told_drops = 0
        self.lost: Counter[str] = Counter()
        self.left_out: dict[str, str] = {}

    @property
    def missing(self) -> list[str]:
        """Topics that were asked for and have no publisher yet."""
        return [t for t in self._wanted if t not in self._ears and t not in self.left_out]

    def look(self) -> None:
        """Subscribe to what is new, tell of it, and tell of what was dropped."""
        fresh = []
        for name, kinds in self._node.get_topic_names_and_types():
            if name in self.left_out or not self._is_wanted(name):
                continue
            publishers = self._node.get_publishers_info_by_topic(name)
            if not publishers:
                continue
            if name not in self._ears:
                fresh += [name] if self._begin(name, kinds, publishers) else []
            else:
                self._follow(name, publishers)
        if fresh:
            say(f"hearing {', '.join(fresh)}")
        dropped = self._writer.dropped.total()
        if dropped > self._told_drops:
            why = self._writer.failure or "the disk is too slow"
            warn(f"{why}: {dropped} messages dropped so far")
            self._told_drops = dropped

    def _is_wanted(self, name: str) -> bool:
        if self._wanted:
            return name in self._wanted
        if any(part.startswith("_") for part in name.split("/")):
            return False  # hidden: the topics of actions
        inside = name.startswith(f"/{self._namespace}/")
        return not self._namespace or inside or name in SHARED

    def _begin(
        self, name: str, kinds: Sequence[str], publishers: Sequence[TopicEndpointInfo]
    ) -> bool:
        try:
            if len(kinds) > 1:
                raise InputError(f"it has several types: {', '.join(kinds)}")
            message = message_type(kinds[0])
            text, digest = self._definitions.of(kinds[0])
        except InputError as error:
            self.left_out[name] = str(error)
            warn(f"without {name}: {error}")
            return False
        offers = [offer(publisher) for publisher in publishers]
        self._writer.add(Topic(name, kinds[0], text, digest, offers))
        self._ears[name] = self._listen(name, message, publishers)
        return True

    def _listen(self, name: str, message: type, publishers: Sequence[TopicEndpointInfo]) -> Ear:
        reliable, latched = common(publishers)
        qos = QoSProfile(
            depth=DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        put = self._writer.put

        def keep(data: bytes) -> None:
            put(name, time.time_ns(), data)

        events = SubscriptionEventCallbacks(message_lost=self._count_lost(name))
        subscription = self._node.create_subscription(
            message, name, keep, qos, raw=True, event_callbacks=events
        )
        return Ear(subscription, reliable, latched)

    def _count_lost(self, name: str) -> Callable[[Any], None]:
        def count(event: Any) -> None:
            self.lost[name] += event.total_count_change

        return count

    def _follow(self, name: str, publishers: Sequence[TopicEndpointInfo]) -> None:
        """Ask for less where a new publisher offers less: it would not be heard else."""
        ear = self._ears[name]
        reliable, latched = common(publishers)
        if (ear.reliable and not reliable) or (ear.latched and not latched):
            message: Any = ear.subscription.msg_type
            self._node.destroy_subscription(ear.subscription)
            self._ears[name] = self._listen(name, message, publishers)


def common(publishers: Sequence[TopicEndpointInfo]) -> tuple[bool, bool]:
    """Whether all publishers are reliable, and whether all are latched (transient local)."""
    offers = [offer(publisher) for publisher in publishers]
    return all(o.reliable for o in offers), all(o.latched for o in offers)


def offer(publisher: TopicEndpointInfo) -> Offer:
    """What a publisher offers, as a recording has it."""
    qos = publisher.qos_profile
    return Offer(
        qos.reliability is ReliabilityPolicy.RELIABLE,
        qos.durability is DurabilityPolicy.TRANSIENT_LOCAL,
        qos.depth,
    )


def message_type(kind: str) -> type:
    """Class of a message type, PACKAGE/msg/NAME.

    Raises:
        InputError: It is not installed.
    """
    package, _, name = kind.split("/")
    try:
        found: type = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise InputError(f"{kind} is not installed here") from error
    return found


# ---- what is told ---------------------------------------------------------------------------


def report(folder: Path, writer: Any, ears: Ears, seconds: float) -> int:
    """Say what was written and what not; returns the exit code."""
    rows: list[tuple[str, ...]] = [("topic", "messages", "Hz")]
    rows += [
        (name, str(count), f"{count / seconds:.1f}")
        for name, count in sorted(writer.written.items())
    ]
    total = writer.written.total()
    say("\n" + "\n".join(table(rows) if total else ["nothing was heard"]))
    say(
        f"omniman record: {total} messages in {seconds:.1f} s, {writer.size / 1e6:.1f} MB "
        f"in {folder}"
    )
    complete = True
    if writer.failure:
        warn(f"writing ended early: {writer.failure}")
        complete = False
    why = "dropped" if writer.failure else "dropped: the disk was too slow"
    for what, lost in ((why, writer.dropped),
                       ("lost on the way here", ears.lost)):  # fmt: skip
        if lost:
            worst = ", ".join(f"{name} {count}" for name, count in lost.most_common(5))
            warn(f"{lost.total()} messages {what} ({worst})")
            complete = False
    if ears.missing:
        warn(f"nobody published {', '.join(ears.missing)}")
    return 0 if complete and total else 1


def warn(text: str) -> None:
    """Say what went wrong, on stderr."""
    say(paint(f"omniman record: {text}", YELLOW, sys.stderr), sys.stderr)
