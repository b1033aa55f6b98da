"""`omniman record`: record the robot's topics as a rosbag2 recording (MCAP), until Ctrl-C."""

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

from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import Session
from omniman_ros.console.terminal import YELLOW, paint, say, table
from omniman_ros.core.errors import InputError
from omniman_ros.extras import RECORDING
from omniman_ros.processes.process_group import redirect_signals
from omniman_ros.recording.topic_metadata import OfferedQos, TopicMetadata

DISCOVERY_PERIOD = 0.25  #: Time between two searches for new topics [s]
#: Time for recording the messages that have arrived when the recording ends [s]
FINAL_SPIN_TIME = 0.2
QUEUE_DEPTH = 5000  #: Messages of a topic that may wait for this process: 25 s at 200 Hz
#: Topics that robots in namespaces share
SHARED_TOPICS = ("/clock", "/diagnostics", "/tf", "/tf_static")


def run(args: argparse.Namespace) -> int:
    """Run `omniman record`.

    The exit code is 0 if every message that was received has been written; 1 if messages were
    lost, or none was received. CommandError is raised if a library is missing, or an option is
    refused.
    """
    if not RECORDING.is_available:
        raise CommandError(RECORDING.hint)
    from omniman_ros.recording.definitions import MessageDefinitions
    from omniman_ros.recording.writer import BagWriter

    if args.duration is not None and not (0.0 < args.duration < math.inf):
        raise CommandError(f"--duration must be above 0, got {args.duration:g}", 2)
    namespace = args.namespace.strip("/")
    name = datetime.now().strftime("recording_%Y-%m-%d_%H-%M-%S")
    folder = Path(args.output or name)
    try:
        writer = BagWriter(folder)
    except InputError as error:
        raise CommandError(str(error), 2) from error
    requested = [_full_name(topic, namespace) for topic in args.topics]
    signals: list[int] = []
    say(f"omniman record: writing to {folder}; Ctrl-C ends it")
    start = time.monotonic()
    with redirect_signals(signals.append), writer, Session("recorder") as session:
        recorder = TopicRecorder(
            session.node, writer, MessageDefinitions(install_prefixes()), requested, namespace
        )
        while not signals and not writer.failure:
            recorder.discover()
            remaining = math.inf
            if args.duration is not None:
                remaining = start + args.duration - time.monotonic()
            if remaining <= 0.0:
                break
            session.spin(min(DISCOVERY_PERIOD, remaining))
        session.spin(FINAL_SPIN_TIME)
    return report(folder, writer, recorder, time.monotonic() - start)


def _full_name(topic: str, namespace: str) -> str:
    if topic.startswith("/"):
        return topic
    return "/" + "/".join(part for part in (namespace, topic) if part)


def install_prefixes() -> list[Path]:
    """Return the prefixes of installed packages: those of ROS, and this Python's."""
    given = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [*(Path(prefix) for prefix in given if prefix), Path(sys.prefix)]


@dataclass
class TopicSubscription:
    """A subscription to a recorded topic, with its quality of service."""

    subscription: Subscription
    reliable: bool  #: Whether it asks for lost messages to be repeated
    transient_local: bool  #: Whether it asks for messages that were published before it existed


class TopicRecorder:
    """Subscribes to topics as they appear, and writes their messages.

    Each subscription has the best quality of service that all publishers of its topic offer.

    Args:
        requested: Full names of the topics to record; empty means all topics of the robot.
        namespace: Namespace of the robot; empty means all robots.

    Attributes:
        lost: Number of messages that the middleware reports as lost in transport, by topic.
        skipped: Topics that cannot be recorded, with the reason.
    """

    def __init__(
        self, node: Node, writer: Any, definitions: Any, requested: Sequence[str], namespace: str
    ) -> None:
        self._node, self._writer, self._definitions = node, writer, definitions
        self._requested, self._namespace = list(requested), namespace
        self._topics: dict[str, TopicSubscription] = {}
        self._reported_drops = 0
        self.lost: Counter[str] = Counter()
        self.skipped: dict[str, str] = {}

    @property
    def missing(self) -> list[str]:
        """Topics that were requested and have no publisher yet."""
        return [t for t in self._requested if t not in self._topics and t not in self.skipped]

    def discover(self) -> None:
        """Subscribe to new topics, adapt to new publishers, and report dropped messages."""
        added = []
        for name, types in self._node.get_topic_names_and_types():
            if name in self.skipped or not self._is_requested(name):
                continue
            publishers = self._node.get_publishers_info_by_topic(name)
            if not publishers:
                continue
            if name in self._topics:
                self._adapt(name, publishers)
            elif self._add(name, types, publishers):
                added.append(name)
        if added:
            say(f"recording {', '.join(added)}")
        self._report_drops()

    def _report_drops(self) -> None:
        dropped = self._writer.dropped.total()
        if dropped > self._reported_drops:
            reason = self._writer.failure or "the disk is too slow"
            warn(f"{reason}: {dropped} messages dropped so far")
            self._reported_drops = dropped

    def _is_requested(self, name: str) -> bool:
        if self._requested:
            return name in self._requested
        if any(part.startswith("_") for part in name.split("/")):
            return False  # hidden topics, such as those of actions
        is_inside = name.startswith(f"/{self._namespace}/")
        return not self._namespace or is_inside or name in SHARED_TOPICS

    def _add(
        self, name: str, types: Sequence[str], publishers: Sequence[TopicEndpointInfo]
    ) -> bool:
        try:
            if len(types) > 1:
                raise InputError(f"it has several types: {', '.join(types)}")
            message = message_type(types[0])
            definition, type_hash = self._definitions.lookup(types[0])
        except InputError as error:
            self.skipped[name] = str(error)
            warn(f"without {name}: {error}")
            return False
        offers = [offered_qos(publisher) for publisher in publishers]
        metadata = TopicMetadata(name, types[0], definition, type_hash, offers)
        self._writer.add_topic(metadata)
        self._topics[name] = self._subscribe(name, message, publishers)
        return True

    def _subscribe(
        self, name: str, message: type, publishers: Sequence[TopicEndpointInfo]
    ) -> TopicSubscription:
        reliable, transient_local = common_qos(publishers)
        durability = (
            DurabilityPolicy.TRANSIENT_LOCAL if transient_local else DurabilityPolicy.VOLATILE
        )
        qos = QoSProfile(
            depth=QUEUE_DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=durability,
        )
        put = self._writer.put

        def write(data: bytes) -> None:
            put(name, time.time_ns(), data)

        events = SubscriptionEventCallbacks(message_lost=self._count_lost(name))
        subscription = self._node.create_subscription(
            message, name, write, qos, raw=True, event_callbacks=events
        )
        return TopicSubscription(subscription, reliable, transient_local)

    def _count_lost(self, name: str) -> Callable[[Any], None]:
        def count(event: Any) -> None:
            self.lost[name] += event.total_count_change

        return count

    def _adapt(self, name: str, publishers: Sequence[TopicEndpointInfo]) -> None:
        topic = self._topics[name]
        reliable, transient_local = common_qos(publishers)
        if (topic.reliable and not reliable) or (topic.transient_local and not transient_local):
            message: Any = topic.subscription.msg_type
            self._node.destroy_subscription(topic.subscription)
            self._topics[name] = self._subscribe(name, message, publishers)


def common_qos(publishers: Sequence[TopicEndpointInfo]) -> tuple[bool, bool]:
    """Return whether all publishers are reliable, and whether all are transient local."""
    offers = [offered_qos(publisher) for publisher in publishers]
    return all(o.reliable for o in offers), all(o.transient_local for o in offers)


def offered_qos(publisher: TopicEndpointInfo) -> OfferedQos:
    """Return the quality of service that a publisher offers, as it is stored in a recording."""
    qos = publisher.qos_profile
    return OfferedQos(
        qos.reliability is ReliabilityPolicy.RELIABLE,
        qos.durability is DurabilityPolicy.TRANSIENT_LOCAL,
        qos.depth,
    )


def message_type(name: str) -> type:
    """Return the class of a message type PACKAGE/msg/NAME; InputError if not installed."""
    package, _, short_name = name.split("/")
    try:
        found: type = getattr(importlib.import_module(f"{package}.msg"), short_name)
    except (ImportError, AttributeError) as error:
        raise InputError(f"{name} is not installed here") from error
    return found


def report(folder: Path, writer: Any, recorder: TopicRecorder, seconds: float) -> int:
    """Report the messages written in a time [s], and those lost; the exit code is `run`'s."""
    rows: list[tuple[str, ...]] = [("topic", "messages", "Hz")]
    rows += [
        (name, str(count), f"{count / seconds:.1f}")
        for name, count in sorted(writer.written.items())
    ]
    total = writer.written.total()
    say("\n" + "\n".join(table(rows) if total else ["no message was received"]))
    say(
        f"omniman record: {total} messages in {seconds:.1f} s, {writer.size / 1e6:.1f} MB "
        f"in {folder}"
    )
    complete = True
    if writer.failure:
        warn(f"writing ended early: {writer.failure}")
        complete = False
    dropped = "dropped" if writer.failure else "dropped: the disk was too slow"
    for outcome, lost in ((dropped, writer.dropped), ("lost on the way here", recorder.lost)):
        if lost:
            worst = ", ".join(f"{name} {count}" for name, count in lost.most_common(5))
            warn(f"{lost.total()} messages {outcome} ({worst})")
            complete = False
    if recorder.missing:
        warn(f"nobody published {', '.join(recorder.missing)}")
    return 0 if complete and total else 1


def warn(text: str) -> None:
    """Write a warning to stderr."""
    say(paint(f"omniman record: {text}", YELLOW, sys.stderr), sys.stderr)
