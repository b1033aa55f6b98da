"""Base of all nodes: rate-limited warnings, and diagnostics."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import PurePath
from typing import Any, ParamSpec

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from omniman_ros.core.errors import InputError
from omniman_ros.core.repairs import noted_repairs
from omniman_ros.core.throttle import Throttle
from omniman_ros.nodes.timed_node import NoTimeError, TimedNode
from omniman_ros.nodes.topic_publishers import ForeignTypes, topic_publishers

P = ParamSpec("P")

WARNING_PERIOD = 1.0  #: Shortest time between two warnings on one subject [s]


class OmnimanNode(TimedNode):
    """A node that warns at a limited rate, reports diagnostics, and comes to rest at its end.

    It warns of publishers whose quality of service keeps its subscriptions from receiving them.
    """

    def __init__(self, name: str, **options: Any) -> None:
        self._mismatched: dict[str, Subscription] = {}
        super().__init__(name, **options)
        self._throttle = Throttle(WARNING_PERIOD)
        self._repaired: set[str] = set()
        #: Publishers whose last message must be delivered before the node ends
        self.final_publishers: list[Publisher] = []
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._status = (b"", "")
        self.foreign_types = ForeignTypes(self, self.warn)
        self.every(1.0, self._each_second)
        self.every(0.1, self.report_changes)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, qos_profile: Any, **options: Any
    ) -> Subscription:
        """Create a subscription as rclpy does, and note publishers that do not match it."""
        subscription: Subscription | None = None

        def note(_: object) -> None:
            if subscription is not None:
                self._mismatched[topic] = subscription

        if options.get("event_callbacks") is None:
            options["event_callbacks"] = SubscriptionEventCallbacks(incompatible_qos=note)
        subscription = super().create_subscription(
            msg_type, topic, callback, qos_profile, **options
        )
        return subscription

    def _warn_of_mismatches(self) -> None:
        """Name the publishers that were found not to match; their names come a moment later."""
        while self._mismatched:
            topic, subscription = self._mismatched.popitem()
            for publisher in topic_publishers(self, subscription):
                if publisher.mismatch:
                    self.warn(
                        f"{topic} of {publisher.name}",
                        f"{topic} of {publisher.name} cannot be received: {publisher.mismatch}",
                    )

    def warn(self, subject: str, text: str) -> None:
        """Log a warning, at most once a second per subject, and count it for the diagnostics."""
        suppressed = self._throttle.allow(subject, self.now())
        if suppressed is not None:
            more = f" (and {suppressed} more like it)" if suppressed else ""
            self.get_logger().warning(text + more)

    @property
    def warning_counts(self) -> Mapping[str, int]:
        """Number of warnings per subject since the start."""
        return self._throttle.counts

    def guarded(self, subject: str, handler: Callable[P, str | None]) -> Callable[P, None]:
        """Wrap a handler of messages so that a message that is not used leads to a warning.

        What is repaired in a message leads to a warning at the first one of the subject.

        Args:
            handler: Handles a message, and what the subscription passes with it. It returns why
                the message is not used, or nothing; or it raises an InputError about the message's
                content.
        """

        def callback(*args: P.args, **kwargs: P.kwargs) -> None:
            with noted_repairs() as repairs:
                try:
                    refusal = handler(*args, **kwargs)
                except NoTimeError:
                    return  # the start of every simulation, and no fault of the message
                except InputError as error:
                    self.warn(subject, f"{subject} ignored: {error}")
                    return
            if refusal:
                self.warn(f"{subject} refused", f"{subject} not used: {refusal}")
            if repairs and subject not in self._repaired:
                self._repaired.add(subject)
                self.warn(f"{subject} repaired", f"{subject}: {repairs[0]}")

        return callback

    def status(self) -> tuple[bytes, str, Iterable[tuple[str, object]]]:
        """Return level, message and values for the diagnostics; nodes override this."""
        return DiagnosticStatus.OK, "running", ()

    def status_message(
        self, level: bytes, message: str, values: Iterable[tuple[str, object]]
    ) -> DiagnosticStatus:
        """Return a status of this node on its robot; the hardware is the robot, by its name."""
        robot = self.get_parameter("robot").value if self.has_parameter("robot") else ""
        return DiagnosticStatus(
            level=level,
            name=self.get_fully_qualified_name(),
            message=message,
            hardware_id=PurePath(robot).stem,
            values=[KeyValue(key=key, value=str(value)) for key, value in values],
        )

    def _each_second(self) -> None:
        """Do what is due once a second: rclpy warns of nodes with many timers."""
        self.foreign_types.check()
        self.report()

    def report(self) -> None:
        """Publish the diagnostics."""
        self._warn_of_mismatches()
        level, message, values = self.status()
        self._status = (level, message)
        counts = [(f"warned: {name}", count) for name, count in self.warning_counts.items()]
        array = DiagnosticArray(status=[self.status_message(level, message, [*values, *counts])])
        array.header.stamp = self.stamp()
        self._diagnostics.publish(array)

    def report_changes(self) -> None:
        """Publish the diagnostics if level or message have changed since the last report."""
        level, message, _ = self.status()
        if (level, message) != self._status:
            self.report()

    def begin_shutdown(self, reason: str) -> None:
        """Begin to come to rest; a node that moves something overrides this."""

    @property
    def finished(self) -> bool:
        """Whether the node has come to rest after :meth:`begin_shutdown`."""
        return True

    @property
    def stop_timeout(self) -> float:
        """How long coming to rest may take [s]."""
        return 0.0
