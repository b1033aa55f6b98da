"""Watch over the topics that tell a node what is around the robot."""

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from std_msgs.msg import Header

from omniman_ros.core.errors import InputError
from omniman_ros.core.source_monitor import SourceMonitor
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.timed_node import NoTimeError
from omniman_ros.nodes.topic_publishers import topic_publishers

M = TypeVar("M")

SURVEY_PERIOD = 0.25  #: Period at which is looked who publishes [s]
#: Time for which a robot must be blind until that is logged [s]: at the start it is, shortly
REPORT_DELAY = 1.0
#: Time after the start at which is logged what the robot sees by [s]: others start, too
START_TIME = 3.0


class SourceWatch:
    """Subscribes to the sources of a node, surveys who publishes them, and logs gaps."""

    def __init__(self, node: OmnimanNode, frames: FrameTransforms) -> None:
        self._node, self._frames = node, frames
        self._sources: list[tuple[SourceMonitor, Subscription]] = []
        self._began: float | None = None  # on simulated time, the clock may not run yet
        self._is_introduced = False
        self._blind: frozenset[str] = frozenset()
        self._reported, self._blind_since = self._blind, 0.0
        node.every(SURVEY_PERIOD, self._look)

    def subscribe(
        self,
        kind: type[M],
        source: SourceMonitor,
        headers: Callable[[M], Iterable[Header]],
        handler: Callable[[M], str | None],
        qos: QoSProfile,
    ) -> None:
        """Subscribe to a source; each message waits for the transforms of its `headers`."""

        def handle(message: M) -> str | None:
            try:
                refusal = handler(message)
            except NoTimeError:
                raise
            except InputError as error:
                source.refuse(str(error))
                raise
            if refusal:
                source.refuse(refusal)
            else:
                source.use(self._node.now())
            return refusal

        waiting = self._frames.deferred(source.topic, headers, handle)
        guarded = self._node.guarded(source.topic, waiting)
        subscription: Any = self._node.create_subscription(kind, source.topic, guarded, qos)
        self._sources.append((source, subscription))

    def survey(self) -> None:
        """Look who publishes."""
        for source, subscription in self._sources:
            source.survey(topic_publishers(self._node, subscription), self._node.now())

    def blind_reason(self) -> str:
        """Return why the robot does not know what is around it, or an empty string."""
        return "; ".join(self._reasons().values())

    def _reasons(self) -> dict[str, str]:
        now = self._node.now()
        found = {source.topic: source.blind_reason(now) for source, _ in self._sources}
        return {topic: reason for topic, reason in found.items() if reason}

    def _look(self) -> None:
        """Survey, and log by what the robot sees, and when it begins and ends to be blind."""
        self.survey()
        now, reasons = self._node.now(), self._reasons()
        self._began = now if self._began is None else self._began
        if not self._is_introduced and now - self._began >= START_TIME:
            self._is_introduced = True
            self._node.get_logger().info(self._sight())
        if self._blind != reasons.keys():
            self._blind, self._blind_since = frozenset(reasons), now
        if self._blind == self._reported or 0.0 <= now - self._blind_since < REPORT_DELAY:
            return
        self._reported = self._blind
        if reasons:
            self._node.warn("blind", f"the robot is blind: {'; '.join(reasons.values())}")
        else:
            self._node.get_logger().info("the robot is not blind any more")

    def _sight(self) -> str:
        parts = [
            f"{source.topic} of {' and '.join(sorted({p.name for p in source.publishers}))}"
            for source, _ in self._sources
            if source.publishers
        ]
        if parts:
            return f"the robot looks by {', '.join(parts)}"
        topics = " or ".join(source.topic for source, _ in self._sources)
        return (
            f"nobody publishes {topics}: the robot has no sensors, and drives as if it were alone"
        )
